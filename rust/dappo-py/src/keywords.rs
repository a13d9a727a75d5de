//! Arguments of commands from the keywords of a Python call, in the structs that the command line fills.
//!
//! Names, defaults, ranges and conflicts are those that the structs declare for the command line.

use std::path::PathBuf;
use std::str::FromStr;

use clap::{Arg, Args, ValueEnum};
use dappo_diagnose::Span;
use dappo_learn::config::Assignment;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyDict, PyFloat, PyInt, PyMapping, PySequence, PyString, PyTuple};
use pyo3::{Borrowed, IntoPyObjectExt};

use crate::errors::{Kind, raise};
use crate::kinds::{Count, Named, OneOf, RobotChanged, Whole};

/// Entries of a sequence at most.
const MOST_ITEMS: usize = 100_000;
/// Parts of a setting's key, and levels of sequences and mappings in its value, at most.
const DEEPEST: usize = 16;

/// The keywords of a call, and the arguments that they may be.
pub struct Keywords<'py> {
    given: Bound<'py, PyDict>,
    command: clap::Command,
}

/// Reads the arguments of a command.
pub fn read<T: Args + FromKeywords>(given: &Bound<'_, PyDict>) -> PyResult<T> {
    let command = T::augment_args(clap::Command::new("command"));
    let keywords = Keywords { given: given.clone(), command };
    keywords.check()?;
    T::from_keywords(&keywords, "")
}

impl<'py> Keywords<'py> {
    /// The value of a keyword; a command takes None as if it had not been given.
    fn get(&self, name: &str) -> PyResult<Option<Bound<'py, PyAny>>> {
        Ok(self.given.get_item(name)?.filter(|value| !value.is_none()))
    }

    fn is_given(&self, name: &str) -> PyResult<bool> {
        let is_false = |value: &Bound<'_, PyAny>| {
            value.is_exact_instance_of::<PyBool>() && !value.is_truthy().unwrap_or(true)
        };
        Ok(self.get(name)?.is_some_and(|value| !is_false(&value)))
    }

    fn argument(&self, name: &str) -> Option<&Arg> {
        self.command.get_arguments().find(|argument| argument.get_id() == name)
    }

    /// Refuses names that are none, and arguments that exclude each other.
    fn check(&self) -> PyResult<()> {
        for name in self.given.keys() {
            let name: String = name.extract()?;
            let Some(argument) = self.argument(&name) else {
                let known: Vec<_> =
                    self.command.get_arguments().map(|known| known.get_id().as_str()).collect();
                let known = known.join(", ");
                return Err(raise(
                    Kind::Config,
                    format!("there is no argument `{name}`; expected one of {known}"),
                ));
            };
            if self.is_given(&name)? {
                for other in self.command.get_arg_conflicts_with(argument) {
                    if self.is_given(other.get_id().as_str())? {
                        let other = other.get_id();
                        return Err(raise(
                            Kind::Config,
                            format!("{name} cannot be used together with {other}"),
                        ));
                    }
                }
            }
        }
        Ok(())
    }

    /// The value that the command line takes where there is none.
    fn default_of<T: FromStr>(&self, name: &str) -> PyResult<T> {
        let defaults = self.argument(name).map(Arg::get_default_values).unwrap_or_default();
        let default = defaults.first().and_then(|text| text.to_str()?.parse().ok());
        default.ok_or_else(|| raise(Kind::Config, format!("{name} is missing")))
    }
}

/// A part of the arguments: a field of a struct, or a struct.
pub trait FromKeywords: Sized {
    /// Reads it from the keyword `name`; a struct has keywords of its own.
    fn from_keywords(keywords: &Keywords<'_>, name: &str) -> PyResult<Self>;
}

/// Arguments of which some are settings of a configuration.
pub trait Flags {
    /// The settings that were given.
    fn flags(&self) -> Vec<Assignment>;
}

/// A setting, if it was given.
pub fn flag<T: Clone + Into<toml::Value>>(key: &str, value: Option<&T>) -> Option<Assignment> {
    value.map(|value| Assignment::Value(key.to_owned(), value.clone().into()))
}

/// Defines arguments of the command line that can be read from keywords, too. `=> "KEY"` makes one a flag of that
/// setting.
macro_rules! arguments {
    (
        $(#[$meta:meta])*
        pub struct $name:ident { $($(#[$attribute:meta])* pub $field:ident: $kind:ty $(=> $key:literal)?,)* }
    ) => {
        $(#[$meta])*
        #[derive(Debug, clap::Args)]
        pub struct $name { $($(#[$attribute])* pub $field: $kind,)* }

        impl $crate::keywords::FromKeywords for $name {
            fn from_keywords(
                keywords: &$crate::keywords::Keywords<'_>,
                _: &str,
            ) -> pyo3::PyResult<Self> {
                Ok(Self {
                    $($field: $crate::keywords::FromKeywords::from_keywords(keywords, stringify!($field))?,)*
                })
            }
        }

        impl $crate::keywords::Flags for $name {
            fn flags(&self) -> Vec<dappo_learn::config::Assignment> {
                let flags: [Option<dappo_learn::config::Assignment>; _] =
                    [$($($crate::keywords::flag($key, self.$field.as_ref()),)?)*];
                flags.into_iter().flatten().collect()
            }
        }
    };
}
pub(crate) use arguments;

/// A single value.
pub trait FromValue: Sized {
    /// Reads it from a Python object; errors name it `name`.
    fn from_value(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Self>;
}

impl<T: FromValue + FromStr> FromKeywords for T {
    fn from_keywords(keywords: &Keywords<'_>, name: &str) -> PyResult<Self> {
        match keywords.get(name)? {
            Some(value) => T::from_value(&value, name),
            None => keywords.default_of(name),
        }
    }
}

impl<T: FromValue> FromKeywords for Option<T> {
    fn from_keywords(keywords: &Keywords<'_>, name: &str) -> PyResult<Self> {
        keywords.get(name)?.map(|value| T::from_value(&value, name)).transpose()
    }
}

impl<T: FromValue> FromKeywords for Vec<T> {
    fn from_keywords(keywords: &Keywords<'_>, name: &str) -> PyResult<Self> {
        let values = match keywords.get(name)? {
            Some(values) => items(&values, name)?,
            None => Vec::new(),
        };
        if values.is_empty() && keywords.argument(name).is_some_and(Arg::is_required_set) {
            return Err(raise(Kind::Config, format!("{name} must have at least one entry")));
        }
        values.iter().map(|value| T::from_value(value, name)).collect()
    }
}

impl FromKeywords for Vec<Assignment> {
    fn from_keywords(keywords: &Keywords<'_>, name: &str) -> PyResult<Self> {
        keywords.get(name)?.map_or_else(|| Ok(Vec::new()), |value| assignments(&value, name))
    }
}

impl FromKeywords for bool {
    fn from_keywords(keywords: &Keywords<'_>, name: &str) -> PyResult<Self> {
        keywords.get(name)?.map_or(Ok(false), |value| checked("boolean", &value, name)?.extract())
    }
}

impl FromValue for PathBuf {
    fn from_value(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Self> {
        checked("folder", value, name)?.extract()
    }
}

impl FromValue for String {
    fn from_value(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Self> {
        // A robot may be given by its path.
        let path =
            if value.hasattr("__fspath__")? { Some(checked("folder", value, name)?.str()?) } else { None };
        let text = path.as_ref().map_or(value, |path| path.as_any());
        checked("text", text, name)?.extract()
    }
}

impl<const MIN: i64, const MAX: i64> FromValue for Whole<MIN, MAX> {
    fn from_value(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Self> {
        let bounds = [MIN.into_bound_py_any(value.py())?, MAX.into_bound_py_any(value.py())?];
        let number: i64 = checked_with("integer", value, name, bounds)?.extract()?;
        Self::try_from(number).map_err(|error| raise(Kind::Config, format!("{name}: {error}")))
    }
}

impl<T: Named> FromValue for OneOf<T> {
    fn from_value(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Self> {
        let chosen = chosen(value, name, T::VARIANTS)?;
        chosen.parse().map_err(|error| raise(Kind::Config, format!("{name}: {error}")))
    }
}

impl FromValue for RobotChanged {
    fn from_value(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Self> {
        let variants = Self::value_variants().iter().filter_map(ValueEnum::to_possible_value);
        let names: Vec<String> = variants.map(|variant| variant.get_name().to_owned()).collect();
        let chosen = chosen(value, name, &names.iter().map(String::as_str).collect::<Vec<_>>())?;
        <Self as ValueEnum>::from_str(&chosen, false)
            .map_err(|error| raise(Kind::Config, format!("{name}: {error}")))
    }
}

impl<'py> FromPyObject<'_, 'py> for RobotChanged {
    type Error = PyErr;

    fn extract(name: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        Self::from_value(&name, "robot_changed")
    }
}

impl FromValue for Span {
    fn from_value(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Self> {
        let steps = items(value, name)?;
        let [first, last] = steps.as_slice() else {
            return Err(wrong(value, name, "a pair of the first and the last step"));
        };
        let step = |value| Ok::<_, PyErr>(Count::<0>::from_value(value, name)?.get() as u32);
        Ok(Self { first: step(first)?, last: step(last)? })
    }
}

/// One of several names.
fn chosen(value: &Bound<'_, PyAny>, name: &str, names: &[&str]) -> PyResult<String> {
    checked_with("choice", value, name, [names.into_bound_py_any(value.py())?])?.extract()
}

/// Settings of a mapping, whose keys may be dotted and whose values may be mappings again.
pub fn assignments(settings: &Bound<'_, PyAny>, what: &str) -> PyResult<Vec<Assignment>> {
    let mut found = Vec::new();
    flatten(settings, what, "", 1, &mut found)?;
    Ok(found)
}

fn flatten(
    settings: &Bound<'_, PyAny>,
    what: &str,
    section: &str,
    depth: usize,
    found: &mut Vec<Assignment>,
) -> PyResult<()> {
    check_depth(what, depth)?;
    for (key, value) in entries(settings, what)? {
        let name = format!("{section}{key}");
        if value.cast::<PyMapping>().is_ok_and(|mapping| !mapping.is_empty().unwrap_or(true)) {
            flatten(&value, what, &format!("{name}."), depth + 1, found)?;
        } else {
            let value = toml_value(&value, &name, depth)?;
            found.push(Assignment::Value(name, value));
        }
    }
    Ok(())
}

/// Keys and values of a mapping.
fn entries<'py>(mapping: &Bound<'py, PyAny>, what: &str) -> PyResult<Vec<(String, Bound<'py, PyAny>)>> {
    let items = checked("mapping", mapping, what)?.call_method0("items")?;
    let entries = items.try_iter()?.map(|item| {
        let (key, value): (Bound<'py, PyAny>, Bound<'py, PyAny>) = item?.extract()?;
        Ok((String::from_value(&key, &format!("a key of {what}"))?, value))
    });
    entries.collect()
}

/// A value as TOML has it.
fn toml_value(value: &Bound<'_, PyAny>, name: &str, depth: usize) -> PyResult<toml::Value> {
    check_depth(name, depth)?;
    if value.hasattr("dtype")? && value.hasattr("tolist")? {
        // A number or an array of NumPy.
        let plain = value.call_method0("tolist")?;
        return toml_value(&plain, name, depth + 1);
    }
    if let Ok(value) = value.cast::<PyBool>() {
        return Ok(toml::Value::Boolean(value.is_true()));
    }
    if value.is_instance_of::<PyInt>() {
        let number = value.extract().map_err(|_| wrong(value, name, "between -2**63 and 2**63 - 1"))?;
        return Ok(toml::Value::Integer(number));
    }
    if value.is_instance_of::<PyFloat>() {
        return Ok(toml::Value::Float(value.extract()?));
    }
    if value.is_instance_of::<PyString>() || value.hasattr("__fspath__")? {
        return Ok(toml::Value::String(String::from_value(value, name)?));
    }
    if value.cast::<PyMapping>().is_ok() {
        let entries = entries(value, name)?.into_iter();
        let table = entries.map(|(key, entry)| Ok((key, toml_value(&entry, name, depth + 1)?)));
        return Ok(toml::Value::Table(table.collect::<PyResult<_>>()?));
    }
    if value.cast::<PySequence>().is_ok() && !value.is_instance_of::<PyBytes>() {
        let entries = items(value, name)?;
        let array = entries.iter().map(|entry| toml_value(entry, name, depth + 1));
        return Ok(toml::Value::Array(array.collect::<PyResult<_>>()?));
    }
    Err(wrong(value, name, "a value that TOML has, such as a number or a text"))
}

fn check_depth(name: &str, depth: usize) -> PyResult<()> {
    if depth <= DEEPEST {
        return Ok(());
    }
    Err(raise(Kind::Config, format!("{name} is nested too deeply, at most {DEEPEST} levels are possible")))
}

/// The entries of a sequence; a range may be endless in practice.
fn items<'py>(value: &Bound<'py, PyAny>, name: &str) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let sequence = checked("sequence", value, name)?;
    // The length of a long range is an error of its own.
    if !sequence.len().is_ok_and(|length| length <= MOST_ITEMS) {
        return Err(wrong(value, name, &format!("a sequence of at most {MOST_ITEMS} entries")));
    }
    sequence.try_iter()?.collect()
}

/// The value after a check of `dappo_batch._checks`, which are those of the whole package.
fn checked<'py>(check: &str, value: &Bound<'py, PyAny>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    checked_with(check, value, name, [])
}

/// The same for a check with more arguments.
fn checked_with<'py>(
    check: &str,
    value: &Bound<'py, PyAny>,
    name: &str,
    more: impl IntoIterator<Item = Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = value.py();
    let arguments: Vec<_> = [value.clone(), name.into_bound_py_any(py)?].into_iter().chain(more).collect();
    py.import("dappo_batch._checks")?.getattr(check)?.call1(PyTuple::new(py, arguments)?)
}

/// The error about a value that is not what it must be.
fn wrong(value: &Bound<'_, PyAny>, name: &str, expected: &str) -> PyErr {
    let checks = value.py().import("dappo_batch._checks");
    let shown = checks.and_then(|checks| checks.call_method1("shown", (value,))?.extract::<String>());
    match shown {
        Ok(shown) => raise(Kind::Config, format!("{name} must be {expected}, got {shown}")),
        Err(error) => error,
    }
}

/// Refuses settings that no command takes, before there is one.
#[pyfunction]
#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
pub fn check_settings(settings: Bound<'_, PyAny>, what: &str) -> PyResult<()> {
    assignments(&settings, what).map(drop)
}
