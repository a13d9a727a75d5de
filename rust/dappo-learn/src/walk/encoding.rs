//! How the damage code that a policy observes is made from the active damage, which is unchanged.

use dappo_sim::rng::Stream;
use serde::Serialize;
use strum::{EnumString, IntoStaticStr, VariantNames};

use crate::error::{LearnError, Result};

/// Which damage code the policy observes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[derive(EnumString, IntoStaticStr, VariantNames)]
#[strum(serialize_all = "lowercase")]
pub enum Encoding {
    /// The code of the active damage.
    True,
    /// The code of the healthy robot: all zeros.
    Zero,
    /// The code of another class, drawn uniformly among the other classes once an episode.
    Wrong,
    /// Noise: every entry is 0 or 1 with equal probability, drawn in each step.
    Random,
}

impl Encoding {
    /// Name on the command line and in results.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// Name of a results file with this encoding: `STEM.EXTENSION` for the true code,
    /// `STEM.ENCODING.EXTENSION` else.
    #[must_use]
    pub fn file_name(self, stem: &str, extension: &str) -> String {
        match self {
            Self::True => format!("{stem}.{extension}"),
            other => format!("{stem}.{}.{extension}", other.name()),
        }
    }

    /// Refuses an encoding that a policy with codes of `code_length` entries cannot be given, on a robot with
    /// so many damage classes.
    pub fn check(self, code_length: usize, classes: usize) -> Result<()> {
        if self != Self::True && code_length == 0 {
            return Err(LearnError::Invalid(format!(
                "the policy does not observe the damage, so that it cannot be given the encoding `{}`; expected `true`",
                self.name()
            )));
        }
        if self == Self::Wrong && classes < 2 {
            return Err(LearnError::Invalid(
                "the encoding `wrong` needs at least 2 damage classes, the robot has 1".into(),
            ));
        }
        Ok(())
    }
}

/// A class drawn uniformly among the classes other than `class`.
pub(super) fn another_class(stream: &mut Stream, class: usize, classes: usize) -> usize {
    let drawn = stream.below(classes as u64 - 1) as usize;
    if drawn < class { drawn } else { drawn + 1 }
}

/// An entry of a code of noise.
pub(super) fn fair_bit(stream: &mut Stream) -> f32 {
    (stream.next_u32() & 1) as f32
}

#[cfg(test)]
mod tests {
    use dappo_sim::rng::Purpose;

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
        assert_eq!(Encoding::VARIANTS, ["true", "zero", "wrong", "random"]);
        for name in Encoding::VARIANTS {
            let encoding: Encoding = name.parse().unwrap();
            assert_eq!(encoding.name(), *name);
            assert_eq!(serde_json::to_string(&encoding).unwrap(), format!("\"{name}\""));
        }
    }

    #[test]
    fn results_of_other_encodings_do_not_overwrite_the_true_ones() {
        assert_eq!(Encoding::True.file_name("per_class", "csv"), "per_class.csv");
        assert_eq!(Encoding::Wrong.file_name("per_class", "csv"), "per_class.wrong.csv");
    }
}
