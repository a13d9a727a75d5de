//! All faults of some settings, so that they can be fixed at once.

use std::fmt::{self, Display};

/// Something wrong with a setting.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// Dotted key of the setting, for example `ppo.gamma`.
    pub key: String,
    /// What is wrong, the key and the expected value included.
    pub text: String,
    /// The file or flag that the setting comes from, where that is known.
    pub source: Option<String>,
}

/// A collection of faults, filled by rules.
#[derive(Debug, Default, thiserror::Error)]
pub struct Faults {
    found: Vec<Fault>,
    /// What comes before the keys of the rules.
    section: String,
}

impl Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.source {
            Some(source) => write!(f, "{source}: {}", self.text),
            None => f.write_str(&self.text),
        }
    }
}

/// One fault as a sentence, several as a list.
impl Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let [only] = self.found.as_slice() {
            return only.fmt(f);
        }
        write!(f, "{} settings cannot be used:", self.found.len())?;
        self.found.iter().try_for_each(|fault| write!(f, "\n  {fault}"))
    }
}

impl Faults {
    /// Adds a fault; `why` follows the key.
    pub fn add(&mut self, key: &str, why: impl Display) {
        let key = format!("{}{key}", self.section);
        self.found.push(Fault { text: format!("`{key}` {why}"), key, source: None });
    }

    /// Adds a value outside its range.
    pub fn rule(&mut self, key: &str, value: impl Display, expected: &str, holds: bool) {
        if !holds {
            self.add(key, format!("is {value}, expected {expected}"));
        }
    }

    /// A number of things: from 1 to `most`.
    pub fn count(&mut self, key: &str, value: u64, most: u64) {
        self.rule(
            key,
            value,
            &format!("a whole number of at least 1 and at most {most}"),
            (1..=most).contains(&value),
        );
    }

    /// A number above 0 and at most `most`.
    pub fn positive(&mut self, key: &str, value: f64, most: f64) {
        let expected = format!("a number above 0 and at most {most}");
        self.rule(key, value, &expected, value > 0.0 && value <= most);
    }

    /// Applies the rules of a section, whose keys begin with `name` and a dot.
    pub fn section(&mut self, name: &str, rules: impl FnOnce(&mut Self)) {
        let outer = self.section.clone();
        self.section = format!("{outer}{name}.");
        rules(self);
        self.section = outer;
    }

    /// Whether a fault of this setting, or of a part of it, is known.
    #[must_use]
    pub(crate) fn concern(&self, key: &str) -> bool {
        self.found.iter().any(|fault| {
            [(key, &fault.key as &str), (&fault.key, key)].iter().any(|(whole, part)| {
                part.strip_prefix(*whole).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
            })
        })
    }

    /// Adds those of `others` that are no consequence of what is known.
    pub(crate) fn extend(&mut self, others: Self) {
        let new: Vec<Fault> = others.found.into_iter().filter(|fault| !self.concern(&fault.key)).collect();
        self.found.extend(new);
    }

    /// Adds the source of every fault.
    pub(crate) fn locate(&mut self, source: impl Fn(&str) -> Option<String>) {
        for fault in &mut self.found {
            fault.source = source(&fault.key);
        }
    }

    /// Fails with all faults, if there are any.
    pub fn end(self) -> Result<(), Self> {
        if self.found.is_empty() { Ok(()) } else { Err(self) }
    }
}
