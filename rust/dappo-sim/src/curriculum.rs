//! Which damage classes a run meets, and when: class distributions and stages of a curriculum.

use serde::{Deserialize, Serialize};

use crate::damage::DamageSpace;
use crate::error::SimError;

/// Probability of each damage class, kept as a cumulative sum.
#[derive(Debug, Clone, PartialEq)]
pub struct ClassDistribution {
    cumulative: Vec<f64>,
}

impl ClassDistribution {
    /// A distribution over C classes from weights of at least 0, `[C]`.
    pub fn from_weights(weights: &[f64]) -> Result<Self, SimError> {
        let total: f64 = weights.iter().sum();
        if weights.iter().any(|w| !w.is_finite() || *w < 0.0) || !total.is_finite() || total <= 0.0 {
            return Err(SimError::Config(
                "class weights must be finite, not negative, and not all zero".to_owned(),
            ));
        }
        let mut sum = 0.0;
        let cumulative = weights
            .iter()
            .map(|weight| {
                sum += weight / total;
                sum
            })
            .collect();
        Ok(Self { cumulative })
    }

    /// The same probability for each of `classes` classes.
    #[must_use]
    pub fn uniform(classes: usize) -> Self {
        Self { cumulative: (1..=classes).map(|i| i as f64 / classes as f64).collect() }
    }

    /// Number of classes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.cumulative.len()
    }

    /// Whether the distribution has no class.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.cumulative.is_empty()
    }

    /// Sums of the probabilities up to each class, `[C]`; the last is 1 up to rounding.
    #[must_use]
    pub fn cumulative(&self) -> &[f64] {
        &self.cumulative
    }

    /// The class at the quantile `u` of [0, 1).
    #[must_use]
    pub fn at(&self, u: f64) -> usize {
        let last = self.cumulative.len() - 1;
        // A weight of zero repeats the previous sum, so "first sum above u" never picks it; rounding may
        // leave the final sum below u, in which case the last class of positive weight is drawn.
        let found = self.cumulative.partition_point(|&sum| sum <= u);
        if found <= last {
            return found;
        }
        let top = self.cumulative[last];
        self.cumulative.partition_point(|&sum| sum < top)
    }
}

/// How a stage weighs the damage classes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "expected \"uniform\", a damage such as \"healthy\", or weights of some of the strata `healthy`, `single` and `multiple`"
)]
pub enum ClassMix {
    /// `"uniform"` or one damage specification such as `"healthy"`.
    Named(String),
    /// Weights of the strata; uniform within each.
    Strata(Strata),
}

/// Weights of the classes by their number of damaged limbs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Strata {
    /// Weight of the healthy class.
    #[serde(default)]
    pub healthy: f64,
    /// Weight of all classes with one damage together.
    #[serde(default)]
    pub single: f64,
    /// Weight of all classes with two or more damages together.
    #[serde(default)]
    pub multiple: f64,
}

impl Strata {
    /// Fails for weights that are no distribution of any robot's classes.
    pub fn check(&self) -> Result<(), SimError> {
        let weights = [self.healthy, self.single, self.multiple];
        if weights.iter().all(|weight| (0.0..=1e9).contains(weight)) && weights.iter().sum::<f64>() > 0.0 {
            return Ok(());
        }
        Err(SimError::Config(format!(
            "the weights are healthy = {}, single = {}, multiple = {}, expected numbers from 0 to 1e9, not all of them 0",
            self.healthy, self.single, self.multiple
        )))
    }
}

impl ClassMix {
    /// The class that all robots have; `None` if they have several.
    pub fn only_class(&self, space: &DamageSpace) -> Result<Option<usize>, SimError> {
        match self {
            Self::Named(name) if name == "uniform" => Ok(None),
            Self::Named(spec) => space.parse(spec).map(Some),
            Self::Strata(_) => Ok(None),
        }
    }

    /// The probabilities of all classes of `space`.
    pub fn distribution(&self, space: &DamageSpace) -> Result<ClassDistribution, SimError> {
        let classes = space.classes();
        match self {
            Self::Named(_) => match self.only_class(space)? {
                None => Ok(ClassDistribution::uniform(classes.len())),
                Some(class) => {
                    let mut weights = vec![0.0; classes.len()];
                    weights[class] = 1.0;
                    ClassDistribution::from_weights(&weights)
                }
            },
            Self::Strata(strata) => {
                let of = |damages: usize| match damages {
                    0 => (0, strata.healthy),
                    1 => (1, strata.single),
                    _ => (2, strata.multiple),
                };
                let mut sizes = [0_usize; 3];
                for class in classes {
                    sizes[of(class.damages.len()).0] += 1;
                }
                strata.check()?;
                for (name, size, weight) in
                    [("single", sizes[1], strata.single), ("multiple", sizes[2], strata.multiple)]
                {
                    if size == 0 && weight > 0.0 {
                        return Err(SimError::Config(format!(
                            "the stratum `{name}` has the weight {weight}, but no damage class is in it: \
                             at most {} limbs of this robot are damaged",
                            space.max_damaged_limbs()
                        )));
                    }
                }
                let weight = |damages: usize| {
                    let (stratum, weight) = of(damages);
                    weight / sizes[stratum] as f64
                };
                ClassDistribution::from_weights(
                    &classes.iter().map(|c| weight(c.damages.len())).collect::<Vec<_>>(),
                )
            }
        }
    }
}

/// One stage of a curriculum.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Name shown in metrics.
    pub name: String,
    /// Share of the run's env steps, relative to the other stages.
    #[serde(default = "one")]
    pub budget: f64,
    /// The damage classes of this stage.
    pub mix: ClassMix,
}

fn one() -> f64 {
    1.0
}

/// The active stage when the share `progress` (0 to 1) of the run is done.
///
/// Returns 0 for an empty curriculum.
#[must_use]
pub fn stage_at(stages: &[Stage], progress: f64) -> usize {
    let total: f64 = stages.iter().map(|stage| stage.budget).sum();
    let mut sum = 0.0;
    for (index, stage) in stages.iter().enumerate() {
        sum += stage.budget / total;
        // The tolerance keeps equal budgets from slipping by one iteration through rounding.
        if progress < sum - 1e-12 {
            return index;
        }
    }
    stages.len().saturating_sub(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hexapod() -> DamageSpace {
        DamageSpace::new(6, vec!["jammed_joint".into(), "missing_toe".into()], 2).unwrap()
    }

    fn probabilities(distribution: &ClassDistribution) -> Vec<f64> {
        let c = &distribution.cumulative;
        (0..c.len()).map(|i| if i == 0 { c[0] } else { c[i] - c[i - 1] }).collect()
    }

    #[test]
    fn strata_share_their_weight_equally_among_their_classes() {
        // Stage III of the Hexapod curriculum: 42 % healthy, 28 % single, 30 % multiple.
        let mix = ClassMix::Strata(Strata { healthy: 0.42, single: 0.28, multiple: 0.30 });
        let p = probabilities(&mix.distribution(&hexapod()).unwrap());
        assert!((p[0] - 0.42).abs() < 1e-12);
        assert!((p[1] - 0.28 / 12.0).abs() < 1e-12 && (p[12] - 0.28 / 12.0).abs() < 1e-12);
        assert!((p[13] - 0.30 / 60.0).abs() < 1e-12 && (p[72] - 0.30 / 60.0).abs() < 1e-12);
    }

    #[test]
    fn a_class_of_weight_zero_is_never_drawn() {
        let distribution = ClassDistribution::from_weights(&[0.0, 1.0, 0.0, 3.0, 0.0]).unwrap();
        assert_eq!(distribution.at(0.0), 1);
        assert_eq!(distribution.at(0.2499), 1);
        assert_eq!(distribution.at(0.25), 3);
        assert_eq!(distribution.at(1.0 - f64::EPSILON), 3);
        assert_eq!(distribution.at(1.0), 3);
    }

    #[test]
    fn weights_that_are_no_distribution_are_rejected() {
        for weights in [&[0.0, 0.0][..], &[1.0, -1.0], &[f64::NAN, 1.0], &[f64::INFINITY, 1.0], &[]] {
            assert!(ClassDistribution::from_weights(weights).is_err(), "{weights:?}");
        }
    }

    #[test]
    fn a_stratum_without_classes_bears_no_weight() {
        let single = DamageSpace::new(4, vec!["jammed_joint".into()], 1).unwrap();
        let mix = |multiple| ClassMix::Strata(Strata { healthy: 1.0, single: 1.0, multiple });
        assert_eq!(mix(0.0).distribution(&single).unwrap().len(), 5);
        let message = mix(0.5).distribution(&single).unwrap_err().to_string();
        assert!(message.contains("`multiple` has the weight 0.5"), "{message}");
        let healthy = DamageSpace::new(4, Vec::new(), 0).unwrap();
        assert!(mix(0.0).distribution(&healthy).unwrap_err().to_string().contains("`single`"));
    }

    #[test]
    fn strata_with_weights_that_are_no_distribution_are_rejected() {
        for (healthy, single) in [(0.0, 0.0), (-1.0, 2.0), (f64::NAN, 1.0), (f64::INFINITY, 1.0)] {
            assert!(Strata { healthy, single, multiple: 0.0 }.check().is_err(), "{healthy} {single}");
        }
    }

    #[test]
    fn stages_follow_their_budgets() {
        let stage =
            |name: &str, budget| Stage { name: name.into(), budget, mix: ClassMix::Named("uniform".into()) };
        let stages = [stage("I", 1.0), stage("II", 1.0), stage("III", 2.0)];
        let at = |progress| stage_at(&stages, progress);
        assert_eq!([at(0.0), at(0.24), at(0.25), at(0.49), at(0.5), at(1.0)], [0, 0, 1, 1, 2, 2]);
    }
}
