//! Settings that a user gives one by one.

/// A setting with its dotted key.
#[derive(Debug, Clone, PartialEq)]
pub enum Assignment {
    /// `key=value`, as on a command line; the value is TOML, or a plain word.
    Text(String),
    /// Key and value, as a program has them.
    Value(String, toml::Value),
}

impl From<String> for Assignment {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<&str> for Assignment {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}
