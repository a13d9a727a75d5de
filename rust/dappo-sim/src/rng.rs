//! Philox4x32-10: random numbers as a pure function of (key, episode, purpose, index).
//!
//! A counter-based generator has no state to hand around, so a result cannot depend on the number of
//! threads, the order of resets or the backend. Source: Salmon et al., "Parallel random numbers: as
//! easy as 1, 2, 3", SC 2011; the tests hold the vectors published with Random123.

const MULTIPLIERS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];
const ROUNDS: usize = 10;

/// One block of four random words.
#[must_use]
#[inline]
fn philox4x32(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for round in 0..ROUNDS {
        if round > 0 {
            key = [key[0].wrapping_add(WEYL[0]), key[1].wrapping_add(WEYL[1])];
        }
        let p0 = u64::from(MULTIPLIERS[0]) * u64::from(counter[0]);
        let p1 = u64::from(MULTIPLIERS[1]) * u64::from(counter[2]);
        counter = [
            (p1 >> 32) as u32 ^ counter[1] ^ key[0],
            p1 as u32,
            (p0 >> 32) as u32 ^ counter[3] ^ key[1],
            p0 as u32,
        ];
    }
    counter
}

/// What a stream of random numbers is for. Streams of different purposes never share a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// Noise of the initial state of an episode.
    InitialState = 0,
    /// The damage class of an episode.
    DamageClass = 1,
    /// The step at which the damage strikes.
    Onset = 2,
    /// Exploration noise of the policy.
    ActionNoise = 3,
    /// Initial weights of a network.
    Weights = 4,
    /// Order of the policy's samples in an epoch.
    Shuffle = 5,
    /// Keys of the envs of a training or evaluation run.
    EnvKeys = 6,
    /// Substituted damage codes in evaluations.
    DamageCode = 7,
    /// Order of the value net's samples in an epoch.
    ValueShuffle = 8,
    /// Resamples of damage classes and seeds in comparisons.
    Bootstrap = 9,
    /// When the damage strikes a robot to be diagnosed, and when the diagnosis begins.
    Timing = 10,
    /// Which rollouts a diagnoser is trained on, and which it is validated on.
    Split = 11,
    /// Order of a diagnoser's samples in an epoch.
    DiagnoserShuffle = 12,
    /// Units that a training step of a diagnoser leaves out.
    Dropout = 13,
    /// What is random about a robot and its world in an episode, besides damage.
    Events = 14,
    /// Commands of an episode.
    Command = 15,
    /// Sudden changes of a robot's velocity.
    Push = 16,
    /// Noise of observations.
    ObservationNoise = 17,
    /// Noise of what the value net alone observes.
    PrivilegedNoise = 18,
    /// Faults of sensors.
    SensorFaults = 20,
    /// Times in which actions do not arrive.
    ActionDropout = 21,
    /// How long damage lasts, and how long until it returns.
    DamageDuration = 22,
    /// The compiled variant of an episode.
    Variant = 24,
    /// What the compiled variants of a robot are.
    VariantNumbers = 25,
    /// By how much damage codes are late.
    CodeDelay = 26,
}

/// A stream of random numbers: `key` identifies the run or env, `episode` the episode (or iteration).
#[derive(Debug, Clone)]
pub struct Stream {
    key: [u32; 2],
    episode: u64,
    purpose: Purpose,
    block: u32,
    buffer: [u32; 4],
    used: usize,
    spare_normal: Option<f64>,
}

impl Stream {
    /// Opens the stream at its beginning.
    #[must_use]
    pub fn new(key: u64, episode: u64, purpose: Purpose) -> Self {
        let key = [key as u32, (key >> 32) as u32];
        Self { key, episode, purpose, block: 0, buffer: [0; 4], used: 4, spare_normal: None }
    }

    /// The next 32 random bits.
    pub fn next_u32(&mut self) -> u32 {
        if self.used == 4 {
            let episode = [self.episode as u32, (self.episode >> 32) as u32];
            self.buffer = philox4x32([self.block, self.purpose as u32, episode[0], episode[1]], self.key);
            self.block = self.block.wrapping_add(1);
            self.used = 0;
        }
        self.used += 1;
        self.buffer[self.used - 1]
    }

    /// Fills `words` with what as many calls of [`Stream::next_u32`] would return, several times as fast.
    pub fn fill(&mut self, words: &mut [u32]) {
        let buffered = (4 - self.used).min(words.len());
        let (first, rest) = words.split_at_mut(buffered);
        first.fill_with(|| self.next_u32());
        let (blocks, last) = rest.as_chunks_mut::<4>();
        let (key, episode) = (self.key, [self.episode as u32, (self.episode >> 32) as u32]);
        for block in blocks {
            *block = philox4x32([self.block, self.purpose as u32, episode[0], episode[1]], key);
            self.block = self.block.wrapping_add(1);
        }
        last.fill_with(|| self.next_u32());
    }

    /// The next 64 random bits.
    fn next_u64(&mut self) -> u64 {
        u64::from(self.next_u32()) | u64::from(self.next_u32()) << 32
    }

    /// Uniform in [0, 1) with 53 random bits.
    pub fn uniform(&mut self) -> f64 {
        unit(self.next_u64())
    }

    /// Calls `visit` with each item and what [`Stream::uniform`] would return for it, several times as fast.
    pub fn uniform_for_each<T>(&mut self, items: &mut [T], mut visit: impl FnMut(&mut T, f64)) {
        const MOST: usize = 16;
        let mut words = [0; 2 * MOST];
        for items in items.chunks_mut(MOST) {
            let words = &mut words[..2 * items.len()];
            self.fill(words);
            for (item, [low, high]) in items.iter_mut().zip(words.as_chunks().0) {
                visit(item, unit(u64::from(*low) | u64::from(*high) << 32));
            }
        }
    }

    /// Uniform integer in [0, `bound`); 0 when `bound` is 0. The bias is below 2⁻³² · bound.
    pub fn below(&mut self, bound: u64) -> u64 {
        ((u128::from(self.next_u64()) * u128::from(bound)) >> 64) as u64
    }

    /// Shuffles `items` (Fisher and Yates).
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last as u64 + 1) as usize);
        }
    }

    /// Standard normal by Box and Muller (1958).
    pub fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare_normal.take() {
            return spare;
        }
        // 1 − u lies in (0, 1], so that the logarithm is finite.
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * self.uniform()).sin_cos();
        self.spare_normal = Some(radius * sin);
        radius * cos
    }
}

/// The 53 highest of 64 random bits as a number in [0, 1).
fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

/// Independent keys for `count` envs of one run.
#[must_use]
pub fn env_keys(seed: u64, count: usize) -> Vec<u64> {
    let mut stream = Stream::new(seed, 0, Purpose::EnvKeys);
    (0..count).map(|_| stream.next_u64()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn philox_equals_the_vectors_published_with_random123() {
        // kat_vectors of Random123, lines "philox4x32 10".
        let ones = u32::MAX;
        assert_eq!(philox4x32([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(philox4x32([ones; 4], [ones; 2]), [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]);
        assert_eq!(
            philox4x32([0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344], [0xa409_3822, 0x299f_31d0]),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]
        );
    }

    #[test]
    fn uniforms_and_normals_have_the_moments_of_their_distributions() {
        let count = 200_000_u32;
        let mut stream = Stream::new(7, 0, Purpose::InitialState);
        let moments = |draws: &[f64]| {
            let mean = draws.iter().sum::<f64>() / f64::from(count);
            (mean, draws.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / f64::from(count))
        };
        let (mean, variance) = moments(&(0..count).map(|_| stream.uniform()).collect::<Vec<_>>());
        assert!((mean - 0.5).abs() < 4.0 * (1.0_f64 / 12.0 / f64::from(count)).sqrt(), "mean {mean}");
        assert!((variance - 1.0 / 12.0).abs() < 1e-3, "variance {variance}");
        let (mean, variance) = moments(&(0..count).map(|_| stream.normal()).collect::<Vec<_>>());
        assert!(mean.abs() < 4.0 / (f64::from(count)).sqrt(), "mean {mean}");
        assert!((variance - 1.0).abs() < 4.0 * (2.0 / f64::from(count)).sqrt(), "variance {variance}");
    }

    #[test]
    fn integers_below_a_bound_are_uniform() {
        let mut stream = Stream::new(3, 1, Purpose::DamageClass);
        let mut counts = [0_u32; 33];
        for _ in 0..33_000 {
            counts[stream.below(33) as usize] += 1;
        }
        let chi_square: f64 = counts.iter().map(|&c| (f64::from(c) - 1000.0).powi(2) / 1000.0).sum();
        // 99.9 % quantile of χ² with 32 degrees of freedom (scipy.stats.chi2.ppf(.999, 32)).
        assert!(chi_square < 62.487, "χ² = {chi_square}");
    }

    #[test]
    fn words_filled_at_once_are_those_drawn_one_by_one() {
        for (drawn, length) in [(0, 0), (0, 9), (1, 2), (1, 30), (3, 8), (4, 1)] {
            let (mut one_by_one, mut at_once) =
                (Stream::new(7, 3, Purpose::Dropout), Stream::new(7, 3, Purpose::Dropout));
            for _ in 0..drawn {
                assert_eq!(one_by_one.next_u32(), at_once.next_u32());
            }
            let mut words = vec![0; length];
            at_once.fill(&mut words);
            assert!(words.iter().all(|&word| word == one_by_one.next_u32()));
            assert_eq!(at_once.next_u64(), one_by_one.next_u64());
        }
    }

    #[test]
    fn all_orders_of_a_shuffle_are_equally_frequent() {
        let mut stream = Stream::new(4, 0, Purpose::Split);
        let mut counts = std::collections::BTreeMap::new();
        for _ in 0..6000 {
            let mut items = [0, 1, 2];
            stream.shuffle(&mut items);
            *counts.entry(items).or_insert(0_u32) += 1;
        }
        let chi_square: f64 = counts.values().map(|&c| (f64::from(c) - 1000.0).powi(2) / 1000.0).sum();
        // 99.9 % quantile of χ² with 5 degrees of freedom (scipy.stats.chi2.ppf(.999, 5)).
        assert!(counts.len() == 6 && chi_square < 20.515, "χ² = {chi_square}");
    }

    #[test]
    fn streams_of_different_purpose_episode_or_key_differ() {
        let first = |key, episode, purpose| Stream::new(key, episode, purpose).next_u64();
        let base = first(1, 2, Purpose::InitialState);
        assert_ne!(base, first(2, 2, Purpose::InitialState));
        assert_ne!(base, first(1, 3, Purpose::InitialState));
        assert_ne!(base, first(1, 2, Purpose::DamageClass));
    }
}
