//! Layers of a configuration: TOML tables laid over one another before they are typed.

use std::collections::BTreeMap;

use serde::de::DeserializeOwned;

use super::Config;
use super::assignment::Assignment;
use super::sift::sift;
use crate::error::LearnError;
use crate::faults::Faults;
use crate::ppo::PpoConfig;

/// Parts of a dotted key at most. No setting has this many, and deep nesting would need a deep stack.
const KEY_PARTS: usize = 16;

/// TOML tables laid over one another; later layers win key by key.
#[derive(Debug, Clone, Default)]
pub struct Layers {
    table: toml::Table,
    /// The file or flag that each value comes from, by dotted key.
    sources: BTreeMap<String, String>,
}

impl Layers {
    /// What a user has given one by one.
    pub fn of(assignments: &[Assignment]) -> Result<Self, LearnError> {
        let mut layers = Self::default();
        layers.assign(assignments)?;
        Ok(layers)
    }

    /// Lays a TOML text over what is there; `source` names it in errors.
    pub fn add_toml(&mut self, text: &str, source: &str) -> Result<(), LearnError> {
        let table: toml::Table = text.parse().map_err(|error: toml::de::Error| {
            LearnError::Invalid(format!("cannot read {source}: {}", error.to_string().trim_end()))
        })?;
        lay(&mut self.table, table, "", Some(source), &mut self.sources);
        Ok(())
    }

    /// Sets one value by its dotted key. A table is laid over the section of this key.
    pub fn set(&mut self, key: &str, value: impl Into<toml::Value>) -> Result<(), LearnError> {
        let parts: Vec<&str> = key.split('.').map(str::trim).collect();
        if parts.iter().any(|part| part.is_empty()) || parts.len() > KEY_PARTS {
            return Err(LearnError::Invalid(format!(
                "`{}` is not a key; expected for example ppo.gamma",
                shortened(key)
            )));
        }
        let mut table = &mut self.table;
        let (last, sections) = parts.split_last().unwrap_or((&"", &[]));
        for part in sections {
            table = table
                .entry(*part)
                .or_insert_with(|| toml::Value::Table(toml::Table::new()))
                .as_table_mut()
                .ok_or_else(|| {
                    LearnError::Invalid(format!("`{key}` cannot be set: `{part}` is a value, not a section"))
                })?;
        }
        let over = toml::Table::from_iter([((*last).to_owned(), value.into())]);
        lay(table, over, &sections.join("."), None, &mut self.sources);
        Ok(())
    }

    /// Sets one `key=value` of the command line; the value is TOML, or a plain word.
    fn set_assignment(&mut self, assignment: &str) -> Result<(), LearnError> {
        let (key, value) = assignment.split_once('=').ok_or_else(|| {
            LearnError::Invalid(format!(
                "`{}` is not an assignment; expected key=value, for example ppo.gamma=0.99",
                shortened(assignment)
            ))
        })?;
        let value = value.trim();
        let parsed = format!("value = {value}").parse::<toml::Table>();
        let value = match parsed.map(|mut table| (table.remove("value"), table.is_empty())) {
            Ok((Some(value), true)) => value,
            // Quoted or bracketed text is TOML.
            _ if value.starts_with(['"', '\'', '[', '{']) || value.contains('\n') => {
                return Err(LearnError::Invalid(format!(
                    "the value of `{}` is not TOML: {}",
                    key.trim(),
                    shortened(value)
                )));
            }
            _ => toml::Value::String(value.to_owned()),
        };
        self.set(key, value)
    }

    /// Sets what a user has given one by one.
    pub fn assign(&mut self, assignments: &[Assignment]) -> Result<(), LearnError> {
        assignments.iter().try_for_each(|assignment| match assignment {
            Assignment::Text(text) => self.set_assignment(text),
            Assignment::Value(key, value) => self.set(key, value.clone()),
        })
    }

    /// What is there for a dotted key.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<&toml::Value> {
        let mut parts = key.split('.');
        let first = self.table.get(parts.next()?);
        parts.fold(first, |value, part| value?.get(part))
    }

    /// The layers as settings of any kind. An error lists all that is wrong with their names and types.
    pub fn typed<T: DeserializeOwned>(mut self) -> Result<T, LearnError> {
        let (typed, mut faults) = sift(&mut self.table);
        faults.locate(|key| self.source(key));
        faults.end()?;
        typed.map_err(LearnError::Invalid)
    }

    /// The typed and checked configuration. `ppo.preset` chooses the values that `[ppo]` does not give, and
    /// without `horizon` it follows from the number of envs.
    pub fn resolve(mut self) -> Result<Config, LearnError> {
        let mut faults = self.lay_preset()?;
        let horizon_is_given = self.table.contains_key("horizon");
        let (typed, found) = sift::<Config>(&mut self.table);
        faults.extend(found);
        let Ok(mut config) = typed else {
            faults.locate(|key| self.source(key));
            faults.end()?;
            return typed.map_err(LearnError::Invalid);
        };
        if !horizon_is_given {
            config.horizon = horizon_for(config.env.num_envs);
        }
        // What cannot be typed has its default by now, which passes every rule.
        faults.extend(config.faults());
        faults.locate(|key| self.source(key));
        faults.end()?;
        Ok(config)
    }

    /// Inserts the values of `ppo.preset` below those of `[ppo]`.
    fn lay_preset(&mut self) -> Result<Faults, LearnError> {
        let mut faults = Faults::default();
        let Some(ppo) = self.table.get_mut("ppo").and_then(toml::Value::as_table_mut) else {
            return Ok(faults);
        };
        let mut preset = PpoConfig::default();
        match ppo.remove("preset").unwrap_or_else(|| "paper".into()) {
            toml::Value::String(name) => match PpoConfig::preset(&name) {
                Ok(named) => preset = named,
                Err(error) => faults.add("ppo.preset", format!("cannot be used: {error}")),
            },
            other => faults.add("ppo.preset", format!("is {other}, expected the name of a preset")),
        }
        for (key, value) in preset.to_table()? {
            ppo.entry(key).or_insert(value);
        }
        Ok(faults)
    }

    /// Where a setting comes from: itself, or the section or list that it is in.
    fn source(&self, key: &str) -> Option<String> {
        let mut key = key.split('[').next().unwrap_or(key);
        let below = self.sources.range(key.to_owned()..).next();
        if let Some((_, source)) = below.filter(|(found, _)| is_within(found, key)) {
            return Some(source.clone());
        }
        loop {
            key = key.rsplit_once('.')?.0;
            if let Some(source) = self.sources.get(key) {
                return Some(source.clone());
            }
        }
    }
}

fn is_within(key: &str, section: &str) -> bool {
    key.strip_prefix(section).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// Lays a table over the one of a section, and notes where its values come from; `None` stands for the command line.
fn lay(
    base: &mut toml::Table,
    over: toml::Table,
    section: &str,
    source: Option<&str>,
    sources: &mut BTreeMap<String, String>,
) {
    for (name, value) in over {
        let key = if section.is_empty() { name.clone() } else { format!("{section}.{name}") };
        match (base.get_mut(&name), value) {
            (Some(toml::Value::Table(base)), toml::Value::Table(over)) => {
                lay(base, over, &key, source, sources);
            }
            (_, value) => {
                sources.retain(|known, _| !is_within(known, &key));
                if let Some(source) = source {
                    note_source(sources, key, &value, source);
                }
                base.insert(name, value);
            }
        }
    }
}

/// Notes where a value comes from, a table's entry by entry.
fn note_source(sources: &mut BTreeMap<String, String>, key: String, value: &toml::Value, source: &str) {
    match value {
        toml::Value::Table(table) if !table.is_empty() => {
            for (name, value) in table {
                note_source(sources, format!("{key}.{name}"), value, source);
            }
        }
        _ => {
            sources.insert(key, source.to_owned());
        }
    }
}

/// The beginning of a text that is too long for an error message.
fn shortened(text: &str) -> String {
    const MOST: usize = 80;
    let mut short: String = text.chars().take(MOST).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    short
}
/// Steps an iteration: from many envs a batch of 32 768 transitions, of at least 16 steps so that advantage
/// estimates are meaningful; from few envs at least 4096, within 512 steps so that updates are frequent.
fn horizon_for(num_envs: usize) -> usize {
    let of_many = (32_768 / num_envs.max(1)).clamp(16, 128);
    let of_few = (4096 / num_envs.max(1)).min(512);
    of_many.max(of_few)
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
        let hexapod = include_str!("../../../../configs/hexapod_curriculum.toml");
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
    fn unknown_keys_and_impossible_values_are_rejected() {
        for (text, part) in [
            ("sead = 1", "`sead` is not a setting; did you mean `seed`?"),
            ("[env]\nnum_env = 3", "`env.num_env`"),
            ("[env]\nnum_envs = 0", "`env.num_envs` is 0"),
            ("[env]\nnum_envs = 9_223_372_036_854_775_807", "`env.num_envs` is 9223372036854775807"),
            ("horizon = 1_000_000_000\n[env]\nnum_envs = 16_777_216", "their product"),
            ("total_steps = 0", "`total_steps` is 0"),
            ("total_steps = -1", "`total_steps`"),
            ("seed = -1", "`seed`"),
            ("[ppo]\nprest = 'paper'", "`ppo.prest`"),
            ("[ppo]\npreset = 'papre'", "papre"),
            ("[ppo]\npreset = 1", "`ppo.preset` is 1"),
            ("[damage]\nseverity = 1.5", "`damage.severity` is 1.5"),
            ("[damage]\nseverity = [0.5, 1.5]", "`damage.severity` is [0.5, 1.5]"),
            ("[damage]\nseverity = [0.5]", "expected a range [low, high]"),
            ("[damage]\nseverity = 'full'", "expected a number, or a range [low, high]"),
            ("[damage]\nseverity = [0.5, 1.0]\nseverity_levels = 1", "`damage.severity_levels` is 1"),
            ("[damage]\nseverity = nan", "`damage.severity` is NaN"),
            ("[damage]\nonset = { first = 3, last = 2 }", "`damage.onset` is 3 to 2"),
            ("[damage]\nonset = { first = 3 }", "`damage` cannot be used: missing field `last`"),
            ("[damage.onset]\nfirst = 0\nlast = 9_223_372_036_854_775_807", "`damage.onset` is 0 to"),
            ("[checkpoint]\nevery = 0", "`checkpoint.every` is 0"),
            ("[checkpoint]\nkeep = 0", "`checkpoint.keep` is 0"),
            ("[evaluation]\nepisodes = 0", "`evaluation.episodes` is 0"),
            ("[evaluation]\nevery = 0", "`evaluation.every` is 0"),
            ("curriculum = []", "`curriculum` has no stage"),
            ("curriculum = [{ name = 'a' }]", "`curriculum[0]` cannot be used: missing field `mix`"),
            ("curriculum = [{ name = 'a', mix = { healty = 1.0 } }]", "`healthy`, `single` and `multiple`"),
            ("curriculum = [{ name = 'a', mix = {} }]", "not all of them 0"),
            ("curriculum = [{ name = 'a', mix = { single = inf } }]", "single = inf"),
            ("curriculum = [{ name = 'a', mix = 'uniform', budget = inf }]", "`curriculum[0].budget` is inf"),
            ("[env]\nbackend = 'brax'", "unknown variant `brax`, expected one of `auto`, `lanes`, `mujoco`"),
            ("[env]\nprecision = 'f16'", "unknown variant `f16`, expected `f32` or `f64`"),
            (
                "[env]\ndevice = 'tpu'",
                "unknown variant `tpu`, expected one of `auto`, `cpu`, `gpu`, `cuda`, `warp-cpu`",
            ),
            ("[env]\nnjmax = 0", "`env.njmax` is 0"),
            ("[env]\nthreads = 1_000_000", "`env.threads` is 1000000"),
            ("[evaluation]\nprecision = 'double'", "expected `f32` or `f64`"),
            ("seed = 'one'", "`seed`"),
            ("env = 3", "`env` cannot be used"),
        ] {
            let message = toy(text).resolve().unwrap_err().to_string();
            assert!(message.contains(part), "{text} gave: {message}");
        }
        assert!(Layers::default().resolve().unwrap_err().to_string().contains("`robot` is missing"));
        assert!(Layers::default().set_assignment("seed").is_err());
    }

    #[test]
    fn no_number_of_the_learner_is_taken_that_is_no_number_or_out_of_range() {
        let numbers = toml::Table::try_from(PpoConfig::default()).unwrap();
        for (key, value) in numbers {
            let bad: &[&str] = match value {
                toml::Value::Float(_) => &["nan", "inf", "-inf", "-1e30", "1e30"],
                toml::Value::Integer(_) => &["0", "-1", "9_223_372_036_854_775_807", "1.5", "nan"],
                _ => continue,
            };
            for bad in bad {
                let refused = toy(&format!("[ppo]\n{key} = {bad}")).resolve();
                let message = refused.expect_err(&format!("{key} = {bad}")).to_string();
                assert!(message.contains(&format!("`ppo.{key}`")), "{key} = {bad} gave: {message}");
            }
        }
    }

    #[test]
    fn all_faults_come_at_once_with_the_file_that_each_is_in() {
        let mut layers = toy("sead = 1\n[env]\nnum_envs = 0\nreward = 3\n[nothing]\na = 1\nb = 2");
        layers.add_toml("[ppo]\ngama = 0.9\nhidden = [0, 'x', 8]\nclip_range = 0.3", "other.toml").unwrap();
        layers.set_assignment("ppo.gamma=2").unwrap();
        let message = layers.resolve().unwrap_err().to_string();
        let lines: Vec<&str> = message.lines().collect();
        assert_eq!(lines[0], "7 settings cannot be used:");
        for (source, part) in [
            ("test: ", "`sead` is not a setting"),
            ("test: ", "`env.num_envs` is 0, expected a whole number of at least 1"),
            ("test: ", "`env.reward` cannot be used: invalid type: integer `3`, expected a string"),
            ("test: ", "`nothing` is not a setting"),
            ("other.toml: ", "`ppo.gama` is not a setting"),
            ("other.toml: ", "`ppo.hidden[1]` cannot be used: invalid type: string \"x\", expected usize"),
            ("", "`ppo.gamma` is 2, expected a number in [0, 1)"),
        ] {
            let wanted = format!("  {source}{part}");
            assert!(lines.iter().any(|line| line.starts_with(&wanted)), "no `{wanted}` in: {message}");
        }
    }

    #[test]
    fn a_section_that_is_set_as_a_whole_keeps_its_other_settings_and_says_where_each_comes_from() {
        let mut layers = toy("[ppo]\ngamma = 0.9\nhidden = [8]\n[damage.onset]\nfirst = 3\nlast = 5");
        layers.set_assignment("ppo={learning_rate=0.0001, hidden=[16]}").unwrap();
        layers.set_assignment("damage={onset={last=9}}").unwrap();
        let config = layers.clone().resolve().unwrap();
        assert_eq!((config.ppo.learning_rate, config.ppo.gamma), (1e-4, 0.9));
        assert_eq!(config.ppo.hidden, [16]);
        assert_eq!((config.damage.onset.first, config.damage.onset.last), (3, 9));
        layers.set_assignment("ppo={clip_range=-1.0, hidden=[0]}").unwrap();
        layers.add_toml("ppo = { gamma = 2 }", "other.toml").unwrap();
        let message = layers.resolve().unwrap_err().to_string();
        for line in ["  `ppo.clip_range` is -1", "  `ppo.hidden[0]` is 0", "  other.toml: `ppo.gamma` is 2"] {
            assert!(message.lines().any(|found| found.starts_with(line)), "no `{line}` in: {message}");
        }
        // Of a section that gives way to a value, and the other way round, nothing is left.
        let mut layers = toy("[env.reward]\na = 1");
        layers.set_assignment("env.reward=gym").unwrap();
        assert!(layers.sources.is_empty(), "{:?}", layers.sources);
        layers.resolve().unwrap();
    }

    #[test]
    fn keys_and_values_of_assignments_that_are_none_are_rejected() {
        for assignment in ["=1", "ppo.=1", ".ppo=1", "ppo..gamma=1", "robot=[", "robot='a", "robot={"] {
            let refused = toy("").set_assignment(assignment);
            assert!(matches!(refused, Err(LearnError::Invalid(_))), "{assignment}");
        }
        let deep = format!("{}=1", vec!["a"; 100_000].join("."));
        let message = toy("").set_assignment(&deep).unwrap_err().to_string();
        assert!(message.len() < 200, "{message}");
    }

    #[test]
    fn deeply_nested_toml_is_rejected_and_ends_no_stack() {
        let nested = format!("{}1{}", "[".repeat(200_000), "]".repeat(200_000));
        assert!(toy("").set_assignment(&format!("robot={nested}")).is_err());
        assert!(toy("").add_toml(&format!("robot = {nested}"), "deep.toml").is_err());
        let dotted = format!("{} = 1", vec!["a"; 200_000].join("."));
        assert!(toy("").add_toml(&dotted, "deep.toml").is_err());
        let tables = format!("[{}]", vec!["a"; 200_000].join("."));
        assert!(toy("").add_toml(&tables, "deep.toml").is_err());
    }
}
