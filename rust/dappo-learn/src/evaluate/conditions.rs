//! What decides what an episode of each damage class is; evaluations that are compared must agree in it.

use dappo_sim::vector_env::StepRange;

use crate::config::Config;
use crate::envs::EnvFactory;
use crate::error::{LearnError, Result};

/// Settings of an evaluation by name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Conditions(Vec<(&'static str, String)>);

impl Conditions {
    /// The conditions under which a run is evaluated.
    pub fn new(config: &Config, factory: &dyn EnvFactory) -> Result<Self> {
        let (space, damage) = (factory.space(), &config.damage);
        let steps = |steps: StepRange| format!("{} to {}", steps.first, steps.last);
        let optional = |range: Option<StepRange>| range.map_or_else(|| "none".to_owned(), steps);
        Ok(Self(vec![
            ("robot", factory.robot().name.clone()),
            ("damage.types", space.types().join(", ")),
            ("damage.max_damaged_limbs", space.max_damaged_limbs().to_string()),
            ("damage.max_damages_per_limb", space.max_damages_per_limb().to_string()),
            ("damage.severity", damage.severity.to_string()),
            ("damage.severity_levels", damage.severity_levels.to_string()),
            ("damage.onset", steps(damage.onset)),
            ("damage.duration", optional(damage.duration)),
            ("damage.pause", optional(damage.pause)),
            ("damage.code_delay", steps(damage.code_delay)),
            ("damage.options", damage.options.to_string().trim().to_owned()),
            ("env.physics", factory.integrator().to_owned()),
            ("env.max_episode_steps", factory.env_config(config)?.max_episode_steps.to_string()),
        ]))
    }

    /// Refuses a run `name` with other conditions than these, which are those of `own_name`.
    pub fn check(&self, own_name: &str, name: &str, other: &Self) -> Result<()> {
        let differs = |(one, two): &(&(&str, String), &(&str, String))| one != two;
        let Some(((key, expected), (_, got))) = self.0.iter().zip(&other.0).find(differs) else {
            return Ok(());
        };
        Err(LearnError::Invalid(format!(
            "{name} cannot be evaluated together with {own_name}: its `{key}` is `{got}`, expected `{expected}`"
        )))
    }
}

/// Refuses a run, by its name and configuration, that is no other seed of the learner of `runs`.
pub fn check_seeds<'a>(
    runs: impl IntoIterator<Item = (String, &'a Config)>,
    (name, config): (&str, &Config),
) -> Result<()> {
    for (other, of_other) in runs {
        if of_other.env.observe_damage != config.env.observe_damage {
            return Err(LearnError::Invalid(format!(
                "{other} is a run of {} and {name} one of {}; several runs are seeds of one learner, another one \
                 goes behind --compare",
                of_other.learner(),
                config.learner()
            )));
        }
        if of_other.seed == config.seed {
            return Err(LearnError::Invalid(format!(
                "{other} and {name} were both trained with seed {}; the runs of one learner must differ in their seeds",
                config.seed
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_one_learner_differ_in_their_seeds_alone() {
        let run = |seed, observe_damage| {
            let mut config = Config { seed, ..Config::default() };
            config.env.observe_damage = observe_damage;
            config
        };
        let (first, second) = (run(0, true), run(1, true));
        let runs = || [("a".to_owned(), &first), ("b".to_owned(), &second)];
        check_seeds([], ("a", &first)).unwrap();
        check_seeds(runs(), ("c", &run(2, true))).unwrap();
        let refused = |config: Config| check_seeds(runs(), ("c", &config)).unwrap_err().to_string();
        assert!(refused(run(1, true)).contains("b and c were both trained with seed 1"));
        assert!(refused(run(2, false)).contains("a is a run of DA-PPO and c one of PPO-Unaware"));
    }
}
