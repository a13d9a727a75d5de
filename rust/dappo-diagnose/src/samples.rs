//! Which samples train and which validate, and how minibatches of them are read.

use dappo_learn::error::{LearnError, Result};
use dappo_nn::{Normalizer, Standardizer};
use dappo_sim::rng::{Purpose, Stream};
use rayon::prelude::*;

use super::{DiagnoserConfig, Method, PairSource, Window};

/// The standardiser sees at most this many windows.
const STANDARDIZER_WINDOWS: usize = 4096;
/// Windows read at once while it does.
const STANDARDIZER_BATCH: usize = 256;

/// One window of a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sample {
    /// Its rollout.
    pub rollout: usize,
    /// Its damage class.
    pub class: usize,
}

/// A division of rollouts. Windows of one rollout share its initial state and its healthy twin, so they stay
/// together: a rollout that is trained on does not show how well unseen ones are diagnosed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Split {
    /// Rollouts trained on, in ascending order.
    pub train: Vec<usize>,
    /// Rollouts validated on, in ascending order.
    pub validation: Vec<usize>,
}

impl Split {
    /// Draws `used` of `available` rollouts and divides them, as a function of `seed`. With one seed, more
    /// rollouts include the fewer ones.
    #[must_use]
    pub fn new(available: usize, used: usize, validation_fraction: f64, seed: u64) -> Self {
        let mut order: Vec<usize> = (0..available).collect();
        Stream::new(seed, 0, Purpose::Split).shuffle(&mut order);
        order.truncate(used);
        let most = order.len().saturating_sub(1).max(1);
        let count = ((validation_fraction * order.len() as f64).round() as usize).clamp(1, most);
        let mut train = order.split_off(count.min(order.len()));
        order.sort_unstable();
        train.sort_unstable();
        Self { train, validation: order }
    }

    /// The split of a source by a configuration.
    #[must_use]
    pub fn of(config: &DiagnoserConfig, source: &dyn PairSource) -> Self {
        let available = source.rollouts();
        let used = config.rollouts.unwrap_or(available);
        Self::new(available, used, config.validation_fraction, config.seed)
    }
}

/// The windows of all classes but `held_out` in `rollouts`, rollout by rollout.
pub(super) fn samples(rollouts: &[usize], classes: usize, held_out: &[usize]) -> Vec<Sample> {
    let kept: Vec<usize> = (0..classes).filter(|class| !held_out.contains(class)).collect();
    rollouts.iter().flat_map(|&rollout| kept.iter().map(move |&class| Sample { rollout, class })).collect()
}

/// Reads windows of a source as inputs of the network.
#[derive(Clone, Copy)]
pub(super) struct Reader<'a> {
    pub source: &'a dyn PairSource,
    pub method: Method,
    pub timesteps: usize,
}

impl Reader<'_> {
    /// Numbers of one time step, F.
    pub fn input_dim(&self) -> usize {
        self.method.input_dim(self.source.obs_dim(), self.source.action_dim())
    }

    /// Reads samples in parallel; `None` leaves them unchanged.
    ///
    /// # Shapes
    /// returns `[samples, T, F]`
    pub fn read(&self, samples: &[Sample], standardizer: Option<&Standardizer>) -> Result<Vec<f32>> {
        let length = self.timesteps * self.input_dim();
        let (obs_dim, action_dim) = (self.source.obs_dim(), self.source.action_dim());
        let mut inputs = vec![0.0; samples.len() * length];
        inputs.par_chunks_mut(length.max(1)).zip(samples).try_for_each_init(
            Window::default,
            |window, (out, sample)| {
                self.source.read(sample.rollout, sample.class, self.timesteps, window)?;
                self.method.write(window, obs_dim, action_dim, out)?;
                if let Some(standardizer) = standardizer {
                    standardizer.apply(out);
                }
                Ok::<(), LearnError>(())
            },
        )?;
        Ok(inputs)
    }

    /// The standardiser of an evenly spaced subset of the samples.
    pub fn standardizer(&self, samples: &[Sample]) -> Result<Standardizer> {
        let gap = samples.len().div_ceil(STANDARDIZER_WINDOWS).max(1);
        let chosen: Vec<Sample> = samples.iter().step_by(gap).copied().collect();
        let mut statistics = Normalizer::new(self.input_dim(), 0)?;
        for chosen in chosen.chunks(STANDARDIZER_BATCH) {
            statistics.update(&self.read(chosen, None)?)?;
        }
        Ok(Standardizer::new(&statistics))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rollouts_either_train_or_validate_and_the_share_is_kept() {
        let split = Split::new(100, 50, 0.2, 3);
        assert_eq!((split.train.len(), split.validation.len()), (40, 10));
        let mut all = [split.train.clone(), split.validation.clone()].concat();
        all.sort_unstable();
        all.dedup();
        assert!(all.len() == 50 && all.iter().all(|&rollout| rollout < 100));
        assert!(split.train.is_sorted() && split.validation.is_sorted());
        assert_eq!(split, Split::new(100, 50, 0.2, 3));
        assert_ne!(split, Split::new(100, 50, 0.2, 4));
    }

    #[test]
    fn more_rollouts_of_one_seed_include_the_fewer() {
        let used = |count| {
            let split = Split::new(100, count, 0.2, 3);
            [split.train, split.validation].concat()
        };
        let many = used(60);
        assert!(used(20).iter().all(|rollout| many.contains(rollout)));
    }

    #[test]
    fn both_sides_get_a_rollout_whatever_the_share() {
        for share in [0.001, 0.999] {
            let split = Split::new(2, 2, share, 0);
            assert_eq!((split.train.len(), split.validation.len()), (1, 1));
        }
    }

    #[test]
    fn held_out_classes_are_left_out_of_every_rollout() {
        let sample = |rollout, class| Sample { rollout, class };
        assert_eq!(samples(&[4, 7], 3, &[1]), [sample(4, 0), sample(4, 2), sample(7, 0), sample(7, 2)]);
    }
}
