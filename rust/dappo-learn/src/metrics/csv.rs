//! `metrics.csv`: a column for each metric.

use serde_json::Value;

use super::line::Line;
use crate::csv_table::lines;

/// The names of the columns.
pub(super) fn header(line: &Line) -> Vec<u8> {
    lines([line.0.iter().map(|(name, _)| name.clone()).collect()]).into_bytes()
}

/// One row; a metric without a value leaves its cell empty.
pub(super) fn row(line: &Line) -> Vec<u8> {
    lines([line.0.iter().map(|(_, value)| cell(value)).collect()]).into_bytes()
}

fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
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
