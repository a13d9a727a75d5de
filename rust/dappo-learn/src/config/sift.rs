//! From a TOML table to a type, with everything in the table that the type refuses.

use serde::de::DeserializeOwned;
use toml::{Table, Value};

use super::nearest::nearest;
use crate::faults::Faults;

/// A step on the way from the table to a value.
#[derive(Debug, Clone)]
enum Step {
    Key(String),
    Index(usize),
}

/// Types a table. What its type refuses is removed from it and listed; every key of the type must have a default.
pub(super) fn sift<T: DeserializeOwned>(table: &mut Table) -> (Result<T, String>, Faults) {
    let mut faults = Faults::default();
    if typed::<T>(table.clone()).is_err() {
        let refused: Vec<String> = table
            .iter()
            .filter(|(key, value)| find::<T>(&[Step::Key((*key).clone())], value, &mut faults))
            .map(|(key, _)| key.clone())
            .collect();
        for key in refused {
            prune::<T>(table, &key);
        }
    }
    (typed(table.clone()), faults)
}

fn typed<T: DeserializeOwned>(table: Table) -> Result<T, String> {
    table.try_into().map_err(|error: toml::de::Error| error.message().to_owned())
}

/// Removes what is refused of one entry, and keeps the rest, on which other faults may depend.
fn prune<T: DeserializeOwned>(table: &mut Table, key: &str) {
    let Some(value) = table.remove(key) else { return };
    if let Value::Table(entries) = value {
        let kept: Table = entries
            .into_iter()
            .filter(|(inner, value)| {
                let alone = Table::from_iter([(inner.clone(), value.clone())]);
                typed::<T>(Table::from_iter([(key.to_owned(), Value::Table(alone))])).is_ok()
            })
            .collect();
        // An unknown section is refused even when it is empty.
        let alone = Table::from_iter([(key.to_owned(), Value::Table(kept.clone()))]);
        if typed::<T>(alone).is_ok() {
            table.insert(key.to_owned(), Value::Table(kept));
        }
    }
}

/// Notes the faults at `path`, which holds `value`; returns whether there are any. A value is tried alone, so that
/// nothing else can be the reason.
fn find<T: DeserializeOwned>(path: &[Step], value: &Value, faults: &mut Faults) -> bool {
    let Err(message) = typed::<T>(alone(path, value.clone())) else { return false };
    // An unknown key, and all below it.
    let unknown = path.iter().position(
        |step| matches!(step, Step::Key(key) if message.starts_with(&format!("unknown field `{key}`"))),
    );
    if let Some(at) = unknown {
        let key = name(&path[..=at]);
        if !faults.concern(&key) {
            let meant = nearest::<T>(&key).map(|meant| format!("; did you mean `{meant}`?"));
            faults.add(&key, format!("is not a setting{}", meant.unwrap_or_else(|| format!(": {message}"))));
        }
        return true;
    }
    let inner = |step: Step| [path, &[step]].concat();
    let parts: Vec<(Vec<Step>, &Value)> = match value {
        Value::Table(table) => {
            table.iter().map(|(key, value)| (inner(Step::Key(key.clone())), value)).collect()
        }
        Value::Array(array) => {
            array.iter().enumerate().map(|(index, value)| (inner(Step::Index(index)), value)).collect()
        }
        _ => Vec::new(),
    };
    // A setting of a section may need the others of its section, and then lacks them alone.
    let is_section = value.is_table();
    let refused = parts.iter().filter(|(path, value)| {
        let lacks = |message: &String| is_section && message.starts_with("missing field");
        typed::<T>(alone(path, (*value).clone())).is_err_and(|message| !lacks(&message))
    });
    let mut found = false;
    for (path, value) in refused {
        found |= find::<T>(path, value, faults);
    }
    if !found {
        faults.add(&name(path), format!("cannot be used: {message}"));
    }
    true
}

/// A table with nothing but the value at the end of a path.
fn alone(path: &[Step], value: Value) -> Table {
    let wrapped = path.iter().skip(1).rev().fold(value, |value, step| match step {
        Step::Key(key) => Value::Table(Table::from_iter([(key.clone(), value)])),
        Step::Index(_) => Value::Array(vec![value]),
    });
    match path.first() {
        Some(Step::Key(key)) => Table::from_iter([(key.clone(), wrapped)]),
        _ => Table::new(),
    }
}

/// The dotted key of a path.
fn name(path: &[Step]) -> String {
    let mut name = String::new();
    for step in path {
        match step {
            Step::Key(key) if name.is_empty() => name.push_str(key),
            Step::Key(key) => name = format!("{name}.{key}"),
            Step::Index(index) => name = format!("{name}[{index}]"),
        }
    }
    name
}
