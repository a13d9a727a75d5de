//! `metrics.csv`: a column for each metric.

use serde_json::Value;

use super::line::Line;

/// The names of the columns.
pub(super) fn header(line: &Line) -> Vec<u8> {
    joined(line.0.iter().map(|(name, _)| quoted(name)))
}

/// One row; a metric without a value leaves its cell empty.
pub(super) fn row(line: &Line) -> Vec<u8> {
    joined(line.0.iter().map(|(_, value)| cell(value)))
}

fn joined(cells: impl Iterator<Item = String>) -> Vec<u8> {
    (cells.collect::<Vec<_>>().join(",") + "\n").into_bytes()
}

fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => quoted(text),
        other => quoted(&other.to_string()),
    }
}

/// A cell as RFC 4180 wants it: names of stages may hold anything.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_with_commas_and_quotes_are_quoted_and_missing_values_are_empty() {
        let line = Line::parse(r#"{"z": 1, "stage": "a, \"b\"", "reward": null, "a": 0.5}"#).unwrap();
        assert_eq!(header(&line), b"z,stage,reward,a\n");
        assert_eq!(row(&line), b"1,\"a, \"\"b\"\"\",,0.5\n");
    }
}
