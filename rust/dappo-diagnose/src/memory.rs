//! What a training of diagnosers takes of the memory, estimated before anything is taken.

use dappo_learn::memory::{COPIES, FLOAT, parameters};
use dappo_nn::diagnoser::DiagnoserSizes;
use dappo_sim::SimError;
use dappo_sim::memory::Bytes;

use crate::{DiagnoserConfig, PairSource, Subject};

/// Copies of the parameters of a diagnoser while it learns: more than of a policy, as its gradient is summed in parts.
const DIAGNOSER_COPIES: usize = COPIES + 8;

/// Fails if this many trainings of diagnosers at once do not fit the memory.
pub(crate) fn check_diagnosers(
    configs: &[DiagnoserConfig],
    at_once: usize,
    source: &dyn PairSource,
    subject: &Subject,
) -> Result<(), SimError> {
    let needs = configs.iter().map(|config| (of_diagnoser(config, source, subject), config));
    let (needed, largest) = largest_together(needs.collect(), at_once);
    let Some(DiagnoserConfig { embedding, lstm, hidden, minibatch_size, .. }) = largest else {
        return Ok(());
    };
    let network = format!(
        "an embedding of {embedding}, an LSTM of {lstm}, hidden layers {hidden:?} and minibatches of {minibatch_size}"
    );
    needed.require(&match at_once.min(configs.len()) {
        1 => format!("the training of a diagnoser with {network}"),
        count => format!("{count} trainings of diagnosers at once, the largest with {network}"),
    })
}

/// What the `count` largest of some things take together, and the largest.
fn largest_together<T>(mut needs: Vec<(Bytes, T)>, count: usize) -> (Bytes, Option<T>) {
    needs.sort_by(|(one, _), (other, _)| other.cmp(one));
    let sum = needs.iter().take(count).fold(Bytes::default(), |sum, (bytes, _)| sum.and(*bytes));
    (sum, needs.into_iter().next().map(|(_, largest)| largest))
}

/// The memory of the training of a diagnoser.
fn of_diagnoser(config: &DiagnoserConfig, source: &dyn PairSource, subject: &Subject) -> Bytes {
    let sizes = DiagnoserSizes {
        inputs: 2 * source.obs_dim() + source.action_dim(),
        embedding: config.embedding,
        lstm: config.lstm,
        hidden: config.hidden.clone(),
        outputs: config.head.outputs(subject),
    };
    let samples = Bytes::of(config.rollouts.unwrap_or(source.rollouts()), source.classes());
    // The input, the gates and states of the LSTM with their gradients, a step; and the dense layers.
    let step = Bytes::of(config.timesteps, 2 * sizes.inputs + 12 * sizes.lstm)
        .and(Bytes::of(3, sizes.dense().iter().sum()));
    let minibatch = Bytes::of(config.minibatch_size, 1).min(samples);
    let activations = minibatch.product(step);
    let network = parameters(sizes.parameter_count()).times(DIAGNOSER_COPIES * FLOAT);
    network.and(activations.times(FLOAT)).and(samples.times(32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Head, Window};

    /// Data of 100 rollouts of 40 classes.
    struct Data;

    impl PairSource for Data {
        fn rollouts(&self) -> usize {
            100
        }

        fn classes(&self) -> usize {
            40
        }

        fn timesteps(&self) -> usize {
            50
        }

        fn obs_dim(&self) -> usize {
            30
        }

        fn action_dim(&self) -> usize {
            8
        }

        fn read(&self, _: usize, _: usize, _: usize, _: &mut Window) -> dappo_learn::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn the_largest_trainings_count_that_run_at_once() {
        let needs = || [3, 9, 1, 5].map(|size| (Bytes::of(size, 1), size)).to_vec();
        assert_eq!(largest_together(needs(), 1), (Bytes::of(9, 1), Some(9)));
        assert_eq!(largest_together(needs(), 3), (Bytes::of(17, 1), Some(9)));
        assert_eq!(largest_together(needs(), 64), (Bytes::of(18, 1), Some(9)));
        let subject = subject();
        let huge = DiagnoserConfig { embedding: 1 << 24, lstm: 1 << 24, ..DiagnoserConfig::default() };
        let refuse = |configs: &[DiagnoserConfig], at_once| {
            check_diagnosers(configs, at_once, &Data, &subject).unwrap_err().to_string()
        };
        let both = [DiagnoserConfig::default(), huge];
        let message = refuse(&both, 8);
        assert!(
            message
                .contains("for 2 trainings of diagnosers at once, the largest with an embedding of 16777216")
        );
        assert!(refuse(&both, 1).contains("for the training of a diagnoser with an embedding of 16777216"));
        check_diagnosers(&both[..1], 8, &Data, &subject).unwrap();
    }

    fn subject() -> Subject {
        let codes = (0..40).map(|class: u8| vec![class & 1, class >> 1 & 1, class >> 2 & 1]).collect();
        let class_names = (0..40).map(|class| format!("class {class}")).collect();
        Subject { robot: "toy".into(), class_names, codes }
    }

    #[test]
    fn a_head_of_limbs_has_an_output_for_each_bit_of_the_damage_code() {
        let of = |head| {
            let config = DiagnoserConfig { head, hidden: vec![64], ..DiagnoserConfig::default() };
            of_diagnoser(&config, &Data, &subject())
        };
        // 37 outputs fewer, of 65 parameters each in 16 copies and of three numbers in each of 64 samples.
        let difference = Bytes::of(37, 4 * (16 * 65 + 3 * 64));
        assert_eq!(of(Head::Limbs).and(difference), of(Head::Classes));
    }
}
