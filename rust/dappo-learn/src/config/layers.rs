//! Layers of a configuration: TOML tables laid over one another before they are typed.

use super::Config;
use crate::error::LearnError;
use crate::ppo::PpoConfig;

/// TOML tables laid over one another; later layers win key by key.
#[derive(Debug, Clone, Default)]
pub struct Layers {
    table: toml::Table,
}

impl Layers {
    /// Lays a TOML text over what is there; `source` names it in errors.
    pub fn add_toml(&mut self, text: &str, source: &str) -> Result<(), LearnError> {
        let table: toml::Table = text.parse().map_err(|error: toml::de::Error| {
            LearnError::Invalid(format!("cannot read {source}: {}", error.to_string().trim_end()))
        })?;
        merge(&mut self.table, table);
        Ok(())
    }

    /// Sets one value by its dotted key.
    pub fn set(&mut self, key: &str, value: impl Into<toml::Value>) -> Result<(), LearnError> {
        let mut table = &mut self.table;
        let mut parts: Vec<&str> = key.split('.').collect();
        let last = parts.pop().filter(|part| !part.is_empty());
        let last = last.ok_or_else(|| {
            LearnError::Invalid(format!("`{key}` is no key; expected for example ppo.gamma"))
        })?;
        for part in parts {
            table = table
                .entry(part)
                .or_insert_with(|| toml::Value::Table(toml::Table::new()))
                .as_table_mut()
                .ok_or_else(|| {
                    LearnError::Invalid(format!("`{key}` cannot be set: `{part}` is a value, not a section"))
                })?;
        }
        table.insert(last.to_owned(), value.into());
        Ok(())
    }

    /// Sets one `key=value` of the command line; the value is TOML, or a plain word.
    pub fn set_assignment(&mut self, assignment: &str) -> Result<(), LearnError> {
        let (key, value) = assignment.split_once('=').ok_or_else(|| {
            LearnError::Invalid(format!(
                "`{assignment}` is no assignment; expected key=value, for example ppo.gamma=0.99"
            ))
        })?;
        let parsed = format!("value = {value}")
            .parse::<toml::Table>()
            .ok()
            .and_then(|mut table| table.remove("value"));
        self.set(key.trim(), parsed.unwrap_or_else(|| toml::Value::String(value.trim().to_owned())))
    }

    /// The layers as settings of any kind.
    pub fn typed<T: serde::de::DeserializeOwned>(self) -> Result<T, LearnError> {
        self.table.try_into().map_err(|error: toml::de::Error| {
            LearnError::Invalid(format!("configuration refused: {}", error.to_string().trim_end()))
        })
    }

    /// The typed and checked configuration. `ppo.preset` chooses the values that `[ppo]` does not give, and
    /// without `horizon` it follows from the number of envs.
    pub fn resolve(mut self) -> Result<Config, LearnError> {
        if let Some(ppo) = self.table.get_mut("ppo").and_then(toml::Value::as_table_mut) {
            let name = ppo.remove("preset").unwrap_or_else(|| "paper".into());
            let name =
                name.as_str().ok_or_else(|| LearnError::Invalid("`ppo.preset` must be a name".into()))?;
            let preset = toml::Table::try_from(PpoConfig::preset(name)?)
                .map_err(|error| LearnError::Invalid(format!("cannot write the preset `{name}`: {error}")))?;
            let given = std::mem::replace(ppo, preset);
            merge(ppo, given);
        }
        let horizon_is_given = self.table.contains_key("horizon");
        let mut config: Config = self.typed()?;
        if !horizon_is_given {
            config.horizon = horizon_for(config.env.num_envs);
        }
        config.check()?;
        Ok(config)
    }
}

/// Steps an iteration: from many envs a batch of 32 768 transitions, of at least 16 steps so that advantage
/// estimates mean something; from few envs at least 4096, within 512 steps so that updates come often.
fn horizon_for(num_envs: usize) -> usize {
    let of_many = (32_768 / num_envs.max(1)).clamp(16, 128);
    let of_few = (4096 / num_envs.max(1)).min(512);
    of_many.max(of_few)
}

fn merge(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(base)), toml::Value::Table(over)) => merge(base, over),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Layers with the one key that has no default, and `text` over it.
    fn toy(text: &str) -> Layers {
        let mut layers = Layers::default();
        layers.set("robot", "toy").unwrap();
        layers.add_toml(text, "test").unwrap();
        layers
    }

    #[test]
    fn later_layers_win_key_by_key() {
        let mut layers = toy("seed = 1\n[env]\nnum_envs = 8\nreward = 'gym'");
        layers.add_toml("[env]\nnum_envs = 16", "b").unwrap();
        layers.set_assignment("ppo.gamma=0.99").unwrap();
        layers.set_assignment("env.physics=euler").unwrap();
        let config = layers.resolve().unwrap();
        assert_eq!((config.seed, config.env.num_envs), (1, 16));
        assert_eq!(config.env.reward.as_deref(), Some("gym"));
        assert_eq!(config.env.physics.as_deref(), Some("euler"));
        assert!((config.ppo.gamma - 0.99).abs() < 1e-12);
    }

    #[test]
    fn the_resolved_configuration_reads_back_as_itself() {
        let ant = include_str!("../../../../configs/ant.toml");
        let hexapod = include_str!("../../../../configs/hexapod.toml");
        for text in [ant, hexapod, ""] {
            let config = toy(text).resolve().unwrap();
            let mut again = Layers::default();
            again.add_toml(&config.to_toml().unwrap(), "config.toml").unwrap();
            assert_eq!(again.resolve().unwrap(), config);
        }
    }

    #[test]
    fn the_horizon_follows_from_the_number_of_envs_unless_it_is_given() {
        let horizon = |text: &str| toy(text).resolve().unwrap().horizon;
        assert_eq!(horizon("[env]\nnum_envs = 32"), 128);
        assert_eq!(horizon("[env]\nnum_envs = 1024"), 32);
        assert_eq!(horizon("[env]\nnum_envs = 4096"), 16);
        assert_eq!(horizon("[env]\nnum_envs = 1"), 512);
        assert_eq!(horizon("horizon = 7\n[env]\nnum_envs = 1"), 7);
    }

    #[test]
    fn unknown_keys_and_impossible_values_are_refused() {
        for (text, part) in [
            ("sead = 1", "sead"),
            ("[env]\nnum_env = 3", "num_env"),
            ("[env]\nnum_envs = 0", "env.num_envs"),
            ("total_steps = 0", "total_steps"),
            ("[ppo]\nprest = 'paper'", "prest"),
            ("[ppo]\npreset = 'papre'", "papre"),
            ("[damage]\nseverity = 1.5", "severity"),
            ("curriculum = []", "curriculum"),
            ("[env]\nbackend = 'brax'", "unknown variant `brax`, expected one of `auto`, `lanes`, `mujoco`"),
            ("[env]\nprecision = 'f16'", "unknown variant `f16`, expected `f32` or `f64`"),
            (
                "[env]\ndevice = 'tpu'",
                "unknown variant `tpu`, expected one of `auto`, `cpu`, `cuda`, `warp-cpu`",
            ),
            ("[env]\nnjmax = 0", "env.njmax"),
            ("[evaluation]\nprecision = 'double'", "expected `f32` or `f64`"),
            ("seed = 'one'", "seed"),
        ] {
            let message = toy(text).resolve().unwrap_err().to_string();
            assert!(message.contains(part), "{text} gave: {message}");
        }
        assert!(Layers::default().resolve().unwrap_err().to_string().contains("`robot` is missing"));
        assert!(Layers::default().set_assignment("seed").is_err());
        assert!(Layers::default().set("", 1).is_err());
    }
}
