//! `metrics.csv`: a column for each metric.

use serde_json::Value;

use super::line::Line;
use crate::csv_table::lines;

/// The names of the columns: the metrics of all lines. Those of an earlier version may be fewer.
pub(super) fn header(all: &[Line]) -> Vec<u8> {
    lines([columns(all).into_iter().map(ToOwned::to_owned).collect()]).into_bytes()
}

/// One row for each line; a metric without a value leaves its cell empty.
pub(super) fn rows(all: &[Line]) -> Vec<u8> {
    let columns = columns(all);
    let row =
        |line: &Line| columns.iter().map(|name| line.get(name).map_or_else(String::new, cell)).collect();
    lines(all.iter().map(row)).into_bytes()
}

fn columns(all: &[Line]) -> Vec<&str> {
    let mut columns: Vec<&str> = Vec::new();
    // The newest lines have the most.
    for (name, _) in all.iter().rev().flat_map(|line| &line.0) {
        if !columns.contains(&name.as_str()) {
            columns.push(name);
        }
    }
    columns
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
    use std::slice;

    use super::*;

    #[test]
    fn cells_with_commas_and_quotes_are_quoted_and_missing_values_are_empty() {
        let line = Line::parse(r#"{"z": 1, "stage": "a, \"b\"", "reward": null, "a": 0.5}"#).unwrap();
        assert_eq!(header(slice::from_ref(&line)), b"z,stage,reward,a\n");
        assert_eq!(rows(&[line]), b"1,\"a, \"\"b\"\"\",,0.5\n");
    }

    #[test]
    fn lines_of_an_earlier_version_stand_in_the_columns_of_the_newest() {
        let lines = [r#"{"a": 1, "gone": 2, "time": 3}"#, r#"{"a": 4, "new": 5, "time": 6}"#];
        let lines = lines.map(|text| Line::parse(text).unwrap());
        assert_eq!(header(&lines), b"a,new,time,gone\n");
        assert_eq!(rows(&lines), b"1,,3,2\n4,5,6,\n");
    }
}
