//! Reads the entries of a table and reports the faults of each.

use std::ops::RangeInclusive;

use toml::{Table, Value};

/// One table of a robot file while it is checked.
pub(super) struct Entries<'a, 'f> {
    table: &'a Table,
    /// Place of the table; empty for the file itself.
    place: String,
    found: &'f mut Vec<String>,
    known: Vec<&'static str>,
}

impl<'a, 'f> Entries<'a, 'f> {
    pub fn new(table: &'a Table, place: String, found: &'f mut Vec<String>) -> Self {
        Self { table, place, found, known: Vec::new() }
    }

    /// Adds a fault.
    pub fn fault(&mut self, what: &str) {
        let place = if self.place.is_empty() { String::new() } else { format!("{}: ", self.place) };
        self.found.push(format!("{place}{what}"));
    }

    fn get(&mut self, key: &'static str) -> Option<&'a Value> {
        self.known.push(key);
        self.table.get(key)
    }

    /// A required entry that `read` understands.
    fn required<T>(
        &mut self,
        key: &'static str,
        expected: &str,
        read: impl FnOnce(&'a Value) -> Option<T>,
    ) -> Option<T> {
        let Some(value) = self.get(key) else {
            self.fault(&format!("the entry `{key}` is missing; expected {expected}"));
            return None;
        };
        let result = read(value);
        if result.is_none() {
            self.fault(&format!("`{key}` is {}, expected {expected}", shown(value)));
        }
        result
    }

    fn optional<T>(
        &mut self,
        key: &'static str,
        expected: &str,
        read: impl FnOnce(&'a Value) -> Option<T>,
    ) -> Option<T> {
        if self.table.contains_key(key) {
            return self.required(key, expected, read);
        }
        self.known.push(key);
        None
    }

    pub fn text(&mut self, key: &'static str) -> Option<&'a str> {
        self.required(key, "a text in quotes", text)
    }

    pub fn optional_text(&mut self, key: &'static str) -> Option<&'a str> {
        self.optional(key, "a text in quotes", text)
    }

    pub fn whole(&mut self, key: &'static str, range: RangeInclusive<i64>) -> Option<i64> {
        let expected = format!("a whole number from {} to {}", range.start(), range.end());
        self.required(key, &expected, |value| value.as_integer().filter(|whole| range.contains(whole)))
    }

    pub fn optional_whole(&mut self, key: &'static str, range: RangeInclusive<i64>) -> Option<i64> {
        if self.table.contains_key(key) {
            return self.whole(key, range);
        }
        self.known.push(key);
        None
    }

    /// An optional whole number, one of a few.
    pub fn optional_whole_of(&mut self, key: &'static str, choices: &[i64]) -> Option<i64> {
        let listed: Vec<String> = choices.iter().map(i64::to_string).collect();
        let expected = format!("one of {}", listed.join(", "));
        self.optional(key, &expected, |value| value.as_integer().filter(|whole| choices.contains(whole)))
    }

    /// An optional `true` or `false`.
    pub fn optional_flag(&mut self, key: &'static str) -> Option<bool> {
        self.optional(key, "true or false", Value::as_bool)
    }

    /// An optional text, one of a few.
    pub fn optional_choice(&mut self, key: &'static str, choices: &[&str]) -> Option<&'a str> {
        let quoted: Vec<String> = choices.iter().map(|choice| format!("{choice:?}")).collect();
        let expected = format!("one of {}", quoted.join(", "));
        self.optional(key, &expected, |value| value.as_str().filter(|text| choices.contains(text)))
    }

    pub fn optional_number(&mut self, key: &'static str, range: RangeInclusive<f64>) -> Option<f64> {
        if self.table.contains_key(key) {
            return self.number(key, range);
        }
        self.known.push(key);
        None
    }

    pub fn optional_positive(&mut self, key: &'static str, most: f64) -> Option<f64> {
        if self.table.contains_key(key) {
            return self.positive(key, most);
        }
        self.known.push(key);
        None
    }

    /// An optional `[low, high]`.
    pub fn optional_range(&mut self, key: &'static str) -> Option<[f64; 2]> {
        self.optional(key, "[low, high], two numbers with low < high", |value| {
            match value.as_array()?.iter().map(number).collect::<Option<Vec<f64>>>()?[..] {
                [low, high] if low < high && low.is_finite() && high.is_finite() => Some([low, high]),
                _ => None,
            }
        })
    }

    /// A required text, one of a few.
    pub fn choice(&mut self, key: &'static str, choices: &[&str]) -> Option<&'a str> {
        let quoted: Vec<String> = choices.iter().map(|choice| format!("{choice:?}")).collect();
        let expected = format!("one of {}", quoted.join(", "));
        self.required(key, &expected, |value| value.as_str().filter(|text| choices.contains(text)))
    }

    /// A required `[low, high]` with low ≤ high, both within a range.
    pub fn span(&mut self, key: &'static str, range: RangeInclusive<f64>) {
        let (least, most) = (range.start(), range.end());
        let expected = format!("[low, high], two numbers from {least} to {most} with low <= high");
        self.required(key, &expected, |value| {
            match value.as_array()?.iter().map(number).collect::<Option<Vec<f64>>>()?[..] {
                [low, high] if low <= high && range.contains(&low) && range.contains(&high) => Some(()),
                _ => None,
            }
        });
    }

    /// An optional `[low, high]` with low ≤ high, both within a range.
    pub fn optional_span(&mut self, key: &'static str, range: RangeInclusive<f64>) {
        if self.table.contains_key(key) {
            self.span(key, range);
        } else {
            self.known.push(key);
        }
    }

    /// A required `[low, high]` of whole numbers with low ≤ high, both within a range.
    pub fn whole_span(&mut self, key: &'static str, range: RangeInclusive<i64>) {
        let (least, most) = (range.start(), range.end());
        let expected = format!("[low, high], two whole numbers from {least} to {most} with low <= high");
        self.required(key, &expected, |value| {
            match value.as_array()?.iter().map(Value::as_integer).collect::<Option<Vec<i64>>>()?[..] {
                [low, high] if low <= high && range.contains(&low) && range.contains(&high) => Some(()),
                _ => None,
            }
        });
    }

    /// An optional list of the first entries of an array of `most`, or the first one as a number.
    pub fn optional_leading(&mut self, key: &'static str, most: usize, range: RangeInclusive<f64>) {
        let expected = format!(
            "a number, or a list of up to {most} numbers, each from {} to {}",
            range.start(),
            range.end()
        );
        self.optional(key, &expected, |value| {
            let values = value.as_array().map_or(std::slice::from_ref(value), Vec::as_slice);
            let fits = |value| number(value).is_some_and(|number| range.contains(&number));
            ((1..=most).contains(&values.len()) && values.iter().all(fits)).then_some(())
        });
    }

    pub fn number(&mut self, key: &'static str, range: RangeInclusive<f64>) -> Option<f64> {
        let expected = format!("a number from {} to {}", range.start(), range.end());
        self.required(key, &expected, |value| number(value).filter(|number| range.contains(number)))
    }

    pub fn positive(&mut self, key: &'static str, most: f64) -> Option<f64> {
        let expected = format!("a number above 0 and at most {most}");
        self.required(key, &expected, |value| number(value).filter(|number| *number > 0.0 && *number <= most))
    }

    pub fn table(&mut self, key: &'static str) -> Option<&'a Table> {
        self.required(key, &format!("a table [{key}]"), Value::as_table)
    }

    pub fn optional_table(&mut self, key: &'static str) -> Option<&'a Table> {
        self.optional(key, &format!("a table [{key}]"), Value::as_table)
    }

    /// An optional table, or several of them in an array.
    pub fn optional_one_or_more(&mut self, key: &'static str) -> Vec<&'a Table> {
        let expected = format!("a table [{key}], or a list of them");
        let tables = self.optional(key, &expected, |value| match value {
            Value::Table(table) => Some(vec![table]),
            Value::Array(tables) if !tables.is_empty() => tables.iter().map(Value::as_table).collect(),
            _ => None,
        });
        tables.unwrap_or_default()
    }

    /// An optional array of tables `[[key]]`.
    pub fn optional_tables(&mut self, key: &'static str) -> Option<&'a [Value]> {
        self.optional(key, &format!("tables [[{key}]]"), |value| value.as_array().map(Vec::as_slice))
    }

    pub fn list(&mut self, key: &'static str) -> Option<&'a [Value]> {
        self.required(key, "a list", |value| value.as_array().map(Vec::as_slice))
    }

    /// A list of at least `least` texts.
    pub fn texts(&mut self, key: &'static str, least: usize) -> Vec<&'a str> {
        let Some(values) = self.list(key) else { return Vec::new() };
        if values.len() < least {
            self.fault(&format!("`{key}` is empty, expected a list of texts"));
        }
        if let Some(other) = values.iter().find(|value| text(value).is_none()) {
            self.fault(&format!("`{key}` must be a list of texts in quotes, got {} in it", shown(other)));
        }
        values.iter().filter_map(text).collect()
    }

    /// An optional list of at least `least` texts; empty if it is missing.
    pub fn optional_texts(&mut self, key: &'static str, least: usize) -> Vec<&'a str> {
        if self.table.contains_key(key) {
            return self.texts(key, least);
        }
        self.known.push(key);
        Vec::new()
    }

    /// The tables of `terms`, with their places in the list.
    pub fn terms(&mut self) -> Vec<(usize, &'a Table)> {
        let Some(values) = self.list("terms") else { return Vec::new() };
        if values.is_empty() {
            self.fault("`terms` is empty, expected a list of tables such as { term = \"NAME\" }");
        }
        for (index, value) in values.iter().enumerate().filter(|(_, value)| !value.is_table()) {
            self.fault(&format!(
                "term {index} is {}, expected a table such as {{ term = \"NAME\" }}",
                shown(value)
            ));
        }
        values.iter().enumerate().filter_map(|(index, value)| Some((index, value.as_table()?))).collect()
    }

    /// Names of the entries that were looked for after `first`.
    pub fn known_after(&self, first: &str) -> String {
        let others: Vec<&str> = self.known.iter().copied().filter(|key| *key != first).collect();
        others.join(", ")
    }

    /// Reports the unknown entries.
    pub fn finish(&mut self) {
        let unknown: Vec<String> =
            self.table.keys().filter(|key| !self.known.contains(&key.as_str())).take(8).cloned().collect();
        if !unknown.is_empty() {
            let known = self.known.join(", ");
            self.fault(&format!("unknown entries {}; expected {known}", unknown.join(", ")));
        }
    }
}

/// A text with something in it.
fn text(value: &Value) -> Option<&str> {
    value.as_str().filter(|text| !text.trim().is_empty())
}

/// A number, written with or without a point.
pub(super) fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
}

/// A value for a message, cut where it is long.
pub(super) fn shown(value: &Value) -> String {
    match value {
        Value::Table(_) => "a table".into(),
        Value::Array(_) => "a list".into(),
        Value::String(text) => {
            let short: String = text.chars().take(60).collect();
            format!("{short:?}")
        }
        Value::Float(number) if number.abs() >= 1e15 && number.is_finite() => format!("{number:e}"),
        other => other.to_string(),
    }
}
