//! Tables as CSV (RFC 4180), with `\n` at the end of a line.

use std::borrow::Cow;

/// A table with a header line.
pub fn table<C: AsRef<str>>(columns: &[C], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let header = columns.iter().map(|name| name.as_ref().to_owned()).collect();
    lines(std::iter::once(header).chain(rows))
}

/// Rows alone.
pub fn lines(rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let line = |row: Vec<String>| row.iter().map(|cell| quoted(cell)).collect::<Vec<_>>().join(",") + "\n";
    rows.into_iter().map(line).collect()
}

/// A cell with commas, quotes or line breaks is quoted.
fn quoted(text: &str) -> Cow<'_, str> {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\"")).into()
    } else {
        text.into()
    }
}

/// A number with this many decimals; nothing for NaN.
#[must_use]
pub fn number(value: f64, decimals: usize) -> String {
    if value.is_nan() { String::new() } else { format!("{value:.decimals$}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_quoted_where_rfc_4180_wants_it_and_numbers_that_are_none_are_empty() {
        let row = |cells: [&str; 3]| cells.map(str::to_owned).to_vec();
        let rows = [row(["a b", "c,d", ""]), row(["say \"e\"", "f\ng", "h"])];
        assert_eq!(table(&["x", "y", "z"], rows), "x,y,z\na b,\"c,d\",\n\"say \"\"e\"\"\",\"f\ng\",h\n");
        assert_eq!([number(0.125, 2), number(-1.0, 4), number(f64::NAN, 4)], ["0.12", "-1.0000", ""]);
    }
}
