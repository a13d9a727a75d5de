//! A line of metrics as its entries, in the order in which they were written.

use std::fmt;

use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use serde_json::Value;

/// The entry with the time at which a line was written, s since 1970.
pub(super) const TIME: &str = "unix_seconds";

/// The entries of a JSON object. `serde_json::Map` would sort them by name.
pub(super) struct Line(pub Vec<(String, Value)>);

impl Line {
    /// Reads a line; `None` for one that a kill cut short.
    pub fn parse(text: &str) -> Option<Self> {
        serde_json::from_str(text).ok()
    }

    /// An entry.
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.0.iter().find(|(name, _)| name == key).map(|(_, value)| value)
    }

    /// A count.
    pub fn count(&self, key: &str) -> Option<u64> {
        self.get(key)?.as_u64()
    }
}

impl<'de> Deserialize<'de> for Line {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;

        impl<'de> Visitor<'de> for Entries {
            type Value = Line;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("a JSON object")
            }

            fn visit_map<M: MapAccess<'de>>(self, mut map: M) -> Result<Line, M::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(Line(entries))
            }
        }

        deserializer.deserialize_map(Entries)
    }
}
