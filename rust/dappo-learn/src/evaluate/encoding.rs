//! What a policy is told about the damage in an evaluation. The env keeps its true damage.

use std::borrow::Cow;

use dappo_sim::DamageSpace;
use dappo_sim::rng::{Purpose, Stream};
use dappo_sim::vector_env::VectorEnv;
use serde::Serialize;

use crate::error::{LearnError, Result};

/// Which damage code the policy observes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Encoding {
    /// The code of the damage in force.
    True,
    /// The code of the healthy robot: all zeros.
    Zero,
    /// The code of another class, drawn uniformly among the other classes once an episode.
    Wrong,
    /// Noise: every entry is 0 or 1 with equal probability, drawn anew each step.
    Random,
}

impl Encoding {
    /// All encodings; the first is the default.
    pub const ALL: [Self; 4] = [Self::True, Self::Zero, Self::Wrong, Self::Random];

    /// Name on the command line and in results.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::True => "true",
            Self::Zero => "zero",
            Self::Wrong => "wrong",
            Self::Random => "random",
        }
    }

    /// The encoding of this name.
    pub fn parse(name: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|encoding| encoding.name() == name).ok_or_else(|| LearnError::Config {
            key: "encoding",
            got: format!("`{name}`"),
            expected: "`true`, `zero`, `wrong` or `random`",
        })
    }

    /// Name of a results file with this encoding: `STEM.EXTENSION` for the truth, `STEM.ENCODING.EXTENSION` else.
    #[must_use]
    pub fn file_name(self, stem: &str, extension: &str) -> String {
        match self {
            Self::True => format!("{stem}.{extension}"),
            other => format!("{stem}.{}.{extension}", other.name()),
        }
    }

    /// Refuses an encoding that a policy with codes of `code_length` entries cannot be given.
    pub fn check(self, code_length: usize, space: &DamageSpace) -> Result<()> {
        if self != Self::True && code_length == 0 {
            return Err(LearnError::Invalid(format!(
                "the policy does not observe the damage, so that it cannot be given the encoding `{}`; expected `true`",
                self.name()
            )));
        }
        if self == Self::Wrong && space.classes().len() < 2 {
            return Err(LearnError::Invalid(
                "the encoding `wrong` needs at least 2 damage classes, the robot has 1".into(),
            ));
        }
        Ok(())
    }
}

/// Replaces the damage codes on their way from the envs to the policy.
pub(super) struct Encoder {
    obs_dim: usize,
    code_length: usize,
    /// `None` leaves the codes of the envs as they are.
    source: Option<Source>,
}

/// Where other codes come from.
enum Source {
    /// Codes that are held, `[N, code_length]`.
    Held(Vec<f32>),
    /// Fair bits from one stream an env, `[N]`.
    Noise(Vec<Stream>),
}

impl Encoder {
    /// Codes for the episodes of `env`, of which each has a key and a damage class.
    ///
    /// # Shapes
    /// - `keys`: `[N]`, `classes`: `[N]`
    pub fn new(
        encoding: Encoding,
        env: &VectorEnv,
        space: &DamageSpace,
        keys: &[u64],
        classes: &[usize],
    ) -> Result<Self> {
        let (obs_dim, code_length) = (env.obs_dim(), env.code_length());
        encoding.check(code_length, space)?;
        // The episodes of one key, one in each class, share their start state but not their draws.
        let streams = || {
            let one = |(&key, &class): (&u64, &usize)| Stream::new(key, class as u64, Purpose::DamageCode);
            keys.iter().zip(classes).map(one)
        };
        let source = match encoding {
            Encoding::True => None,
            Encoding::Zero => Some(Source::Held(vec![0.0; keys.len() * code_length])),
            Encoding::Wrong => {
                let codes = space.codes();
                let code = |(mut stream, &class): (Stream, &usize)| {
                    let other = another_class(&mut stream, class, space.classes().len());
                    codes[other * code_length..(other + 1) * code_length].to_vec()
                };
                Some(Source::Held(streams().zip(classes).flat_map(code).collect()))
            }
            Encoding::Random => Some(Source::Noise(streams().collect())),
        };
        Ok(Self { obs_dim, code_length, source })
    }

    /// The codes of given classes, each for as many episodes in a row.
    ///
    /// # Shapes
    /// - `told`: `[N / episodes]`
    pub fn told(env: &VectorEnv, space: &DamageSpace, told: &[usize]) -> Result<Self> {
        let (obs_dim, code_length) = (env.obs_dim(), env.code_length());
        Encoding::Wrong.check(code_length, space)?;
        let (codes, episodes) = (space.codes(), env.num_envs() / told.len().max(1));
        let code = |&class: &usize| codes[class * code_length..(class + 1) * code_length].repeat(episodes);
        Ok(Self { obs_dim, code_length, source: Some(Source::Held(told.iter().flat_map(code).collect())) })
    }

    /// The observations of the next step as the policy sees them: the code is the end of each row.
    ///
    /// # Shapes
    /// - `obs`: `[N, obs_dim]`; returns the same shape
    pub fn encode<'a>(&mut self, obs: &'a [f32]) -> Cow<'a, [f32]> {
        let Some(source) = &mut self.source else { return Cow::Borrowed(obs) };
        let robot = self.obs_dim - self.code_length;
        let mut rows = obs.to_vec();
        let codes = rows.chunks_exact_mut(self.obs_dim).map(|row| &mut row[robot..]);
        match source {
            Source::Held(held) => {
                codes.zip(held.chunks_exact(self.code_length)).for_each(|(code, held)| {
                    code.copy_from_slice(held);
                });
            }
            Source::Noise(streams) => {
                codes.zip(streams).for_each(|(code, stream)| code.fill_with(|| fair_bit(stream)));
            }
        }
        Cow::Owned(rows)
    }
}

/// A class drawn uniformly among the classes other than `class`.
fn another_class(stream: &mut Stream, class: usize, classes: usize) -> usize {
    let drawn = stream.below(classes as u64 - 1) as usize;
    if drawn < class { drawn } else { drawn + 1 }
}

fn fair_bit(stream: &mut Stream) -> f32 {
    (stream.next_u32() & 1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_class_is_uniform_among_the_other_classes() {
        for class in [0, 2, 4] {
            let mut counts = [0_u32; 5];
            for key in 0..4000 {
                let mut stream = Stream::new(key, class as u64, Purpose::DamageCode);
                counts[another_class(&mut stream, class, 5)] += 1;
            }
            assert_eq!(counts[class], 0);
            let others = counts.iter().enumerate().filter(|(other, _)| *other != class);
            let chi_square: f64 =
                others.map(|(_, &count)| (f64::from(count) - 1000.0).powi(2) / 1000.0).sum();
            // 99.9 % quantile of χ² with 3 degrees of freedom (scipy.stats.chi2.ppf(.999, 3)).
            assert!(chi_square < 16.266, "χ² = {chi_square} for class {class}");
        }
    }

    #[test]
    fn the_bits_of_the_noise_are_fair() {
        let mut stream = Stream::new(5, 3, Purpose::DamageCode);
        let ones: f32 = (0..40_000).map(|_| fair_bit(&mut stream)).sum();
        // Binomial(40000, 1/2) has the standard deviation 100.
        assert!((ones - 20_000.0).abs() < 400.0, "{ones} ones");
    }

    #[test]
    fn names_lead_back_to_their_encodings() {
        for encoding in Encoding::ALL {
            assert_eq!(Encoding::parse(encoding.name()).unwrap(), encoding);
            let json = serde_json::to_string(&encoding).unwrap();
            assert_eq!(json, format!("\"{}\"", encoding.name()));
        }
        let message = Encoding::parse("nonsense").unwrap_err().to_string();
        assert_eq!(message, "encoding is `nonsense`, expected `true`, `zero`, `wrong` or `random`");
    }

    #[test]
    fn results_of_other_encodings_do_not_overwrite_the_true_ones() {
        assert_eq!(Encoding::True.file_name("per_class", "csv"), "per_class.csv");
        assert_eq!(Encoding::Wrong.file_name("per_class", "csv"), "per_class.wrong.csv");
    }
}
