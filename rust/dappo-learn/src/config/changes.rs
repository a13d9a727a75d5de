//! Settings that can change when a run is resumed, and those that cannot.

use serde::Serialize;

use super::{Assignment, Config, Layers};
use crate::error::{LearnError, Result};

/// A setting that changed when a run went on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    /// Its dotted key.
    pub key: String,
    /// Its value until then; `None` if it was absent.
    pub from: Option<toml::Value>,
    /// Its value from then on.
    pub to: Option<toml::Value>,
}

/// The configuration of a run with some settings changed; refuses those that its checkpoints have built
/// in.
pub fn change(config: &Config, assignments: &[Assignment]) -> Result<Config> {
    let mut layers = Layers::default();
    layers.add_toml(&config.to_toml()?, "the configuration of the run")?;
    layers.assign(assignments)?;
    if layers.get("ppo.preset").is_some() {
        return Err(LearnError::Invalid(
            "`ppo.preset` cannot change in a run: it chooses values for a new one; change the settings by their own keys"
                .into(),
        ));
    }
    let changed = layers.resolve()?;
    let refused = changes(config, &changed)?
        .into_iter()
        .find_map(|change| built_in(&change).map(|reason| (change, reason)));
    let Some((Change { key, from, to }, reason)) = refused else { return Ok(changed) };
    let show = |value: Option<toml::Value>| value.map_or("its default".to_owned(), |value| value.to_string());
    Err(LearnError::Invalid(format!(
        "`{key}` cannot change in a run, from {} to {}: {reason}; train a new run with it",
        show(from),
        show(to)
    )))
}

/// The settings in which two configurations differ, in the order of their keys.
pub fn changes(from: &Config, to: &Config) -> Result<Vec<Change>> {
    let table = |config: &Config| {
        toml::Table::try_from(config).map_err(|error| LearnError::Invalid(error.to_string()))
    };
    let mut found = Vec::new();
    compare("", &table(from)?, &table(to)?, &mut found);
    Ok(found)
}

fn compare(section: &str, from: &toml::Table, to: &toml::Table, found: &mut Vec<Change>) {
    let keys = from.keys().chain(to.keys().filter(|key| !from.contains_key(*key)));
    for name in keys {
        let key = if section.is_empty() { name.clone() } else { format!("{section}.{name}") };
        match (from.get(name), to.get(name)) {
            (Some(toml::Value::Table(from)), Some(toml::Value::Table(to))) => compare(&key, from, to, found),
            (from, to) if from == to => {}
            (from, to) => found.push(Change { key, from: from.cloned(), to: to.cloned() }),
        }
    }
}

/// Why a setting cannot change in a run; `None` for those that can.
fn built_in(Change { key, to, .. }: &Change) -> Option<&'static str> {
    let (section, name) = key.split_once('.').unwrap_or(("", key));
    match (section, name) {
        ("", "robot") => Some("its networks and episodes are those of this robot"),
        ("", "seed") => Some("its random streams depend on this seed"),
        ("env", "num_envs") => Some("its checkpoints hold the states of so many envs"),
        ("env", "device" | "backend" | "precision" | "physics") => {
            Some("its checkpoints hold states of this simulator")
        }
        ("env", "reward") => Some("its value net and its metrics are of this reward"),
        ("env", "observe_damage" | "history") => Some("its networks have inputs for these observations"),
        ("damage", name)
            if !["min_class_steps", "onset", "duration", "pause", "code_delay"]
                .iter()
                .any(|free| name.starts_with(free)) =>
        {
            Some("its networks and episodes are those of robots with these damages")
        }
        ("ppo", "hidden" | "lstm") => Some("its networks have these layers"),
        // Symmetric networks go on as ordinary ones, for example with a robot that has changed on one side.
        ("ppo", "symmetry") if *to != Some(false.into()) => {
            Some("its networks are not their own mirror images")
        }
        ("ppo", "code_scale") => Some("its networks have learned with this scale"),
        ("ppo", "initial_log_variance") => Some("its policy has begun with it"),
        ("", "horizon" | "total_steps" | "curriculum")
        | ("env", "threads" | "max_episode_steps" | "njmax" | "nconmax")
        | ("damage" | "ppo" | "checkpoint" | "evaluation", _) => None,
        _ => Some("its checkpoints depend on it"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> Config {
        let mut layers = Layers::default();
        layers.set("robot", "ant").unwrap();
        layers.add_toml("[env]\nnum_envs = 8\n[ppo]\npreset = 'batch'\nhidden = [16]", "test").unwrap();
        layers.resolve().unwrap()
    }

    fn changed(assignments: &[&str]) -> Result<Config> {
        change(&config(), &assignments.iter().map(|&text| text.into()).collect::<Vec<_>>())
    }

    #[test]
    fn settings_of_a_user_keep_the_robot_file_of_a_run_unless_they_name_another_robot() {
        let kept = Config { robot_file: Some("copy.toml".into()), ..config() };
        assert_eq!(kept.clone().with(&[]).unwrap(), kept);
        let severe = kept.clone().with(&["damage.severity=0.5".into()]).unwrap();
        assert_eq!(
            (severe.damage.severity, &severe.robot_file),
            (dappo_sim::Severity::Same(0.5), &kept.robot_file)
        );
        let other = kept.with(&[Assignment::Value("robot".into(), "hexapod".into())]).unwrap();
        assert_eq!((other.robot.as_str(), other.robot_file), ("hexapod", None));
    }

    #[test]
    fn settings_of_learning_saving_and_evaluation_change_and_are_listed_with_both_values() {
        let to = changed(&["ppo.learning_rate=0.0001", "checkpoint.every=5", "env.max_episode_steps=70"]);
        let to = to.unwrap();
        assert_eq!((to.ppo.learning_rate, to.checkpoint.every), (1e-4, 5));
        let change = |key: &str, from: Option<toml::Value>, to: toml::Value| Change {
            key: key.into(),
            from,
            to: Some(to),
        };
        assert_eq!(
            changes(&config(), &to).unwrap(),
            [
                change("checkpoint.every", Some(20.into()), 5.into()),
                change("env.max_episode_steps", None, 70.into()),
                change("ppo.learning_rate", Some(1e-3.into()), 1e-4.into()),
            ]
        );
        for assignment in [
            "horizon=64",
            "total_steps=9",
            "curriculum=[{ name = 'healthy', mix = 'healthy' }]",
            "env.njmax=50",
            "damage.onset.last=20",
            "evaluation.episodes=9",
            "ppo.epochs=3",
            "ppo.minibatch_size=64",
        ] {
            assert_eq!(
                changes(&config(), &changed(&[assignment]).unwrap()).unwrap().len(),
                1,
                "{assignment}"
            );
        }
    }

    #[test]
    fn what_checkpoints_have_built_in_is_rejected_by_name_with_both_values_and_a_reason() {
        let message = changed(&["ppo.gamma=0.9", "ppo.hidden=[32]"]).unwrap_err().to_string();
        assert_eq!(
            message,
            "`ppo.hidden` cannot change in a run, from [16] to [32]: its networks have these layers; train a new run with it"
        );
        for (assignment, key) in [
            ("robot=hexapod", "robot"),
            ("seed=1", "seed"),
            ("env.num_envs=16", "env.num_envs"),
            ("env.backend=mujoco", "env.backend"),
            ("env.device=cuda", "env.device"),
            ("env.precision=f64", "env.precision"),
            ("env.physics=euler", "env.physics"),
            ("env.reward=gym", "env.reward"),
            ("env.observe_damage=false", "env.observe_damage"),
            ("damage.types=['weak_motor']", "damage.types"),
            ("damage.max_damaged_limbs=1", "damage.max_damaged_limbs"),
            ("damage.severity=0.5", "damage.severity"),
            ("damage.options.jammed_joint.range_deg=1", "damage.options"),
            ("ppo.code_scale=1", "ppo.code_scale"),
            ("ppo.initial_log_variance=0", "ppo.initial_log_variance"),
            ("ppo.preset=paper", "ppo.preset"),
        ] {
            let message = changed(&[assignment]).unwrap_err().to_string();
            assert!(message.starts_with(&format!("`{key}` cannot change in a run")), "{message}");
        }
    }

    #[test]
    fn a_section_as_an_inline_table_changes_what_it_names() {
        let to = changed(&["ppo={learning_rate=0.0001}"]).unwrap();
        let found = changes(&config(), &to).unwrap();
        assert_eq!(found.iter().map(|change| change.key.as_str()).collect::<Vec<_>>(), ["ppo.learning_rate"]);
        let message = changed(&["ppo={hidden=[32]}"]).unwrap_err().to_string();
        assert!(message.starts_with("`ppo.hidden` cannot change in a run"), "{message}");
    }

    #[test]
    fn a_setting_that_keeps_its_value_is_no_change_and_bad_values_are_rejected_as_ever() {
        assert_eq!(changed(&["ppo.hidden=[16]", "seed=0", "ppo.learning_rate=0.001"]).unwrap(), config());
        assert!(changed(&["ppo.gama=0.9"]).unwrap_err().to_string().contains("gama"));
        assert!(changed(&["ppo.clip_range=2"]).unwrap_err().to_string().contains("`ppo.clip_range` is 2"));
        assert!(changed(&["ppo.clip_range"]).unwrap_err().to_string().contains("is not an assignment"));
    }
}
