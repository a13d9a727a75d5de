//! Tables as text, in columns as wide as their longest cell.

/// A table with a header line. Columns whose header begins with `<` are aligned to the left, others to the right.
pub fn table<const COLUMNS: usize>(
    headers: [&str; COLUMNS],
    rows: impl IntoIterator<Item = [String; COLUMNS]>,
) -> String {
    let header = headers.map(|header| header.trim_start_matches('<').to_owned());
    let rows: Vec<[String; COLUMNS]> = std::iter::once(header).chain(rows).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let line = |row: &[String; COLUMNS]| {
        let cells = row.iter().enumerate().map(|(column, cell)| {
            let width = width(column);
            if headers[column].starts_with('<') {
                format!("{cell:<width$}")
            } else {
                format!("{cell:>width$}")
            }
        });
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned() + "\n"
    };
    rows.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_wide_as_their_longest_cell_and_lines_end_without_spaces() {
        let rows = [["10", "a", "–"], ["9", "länger", "± 1"]].map(|row| row.map(str::to_owned));
        assert_eq!(
            table(["n", "<name", "<error"], rows),
            "\
            \x20n  name    error\n\
            10  a       –\n\
            \x209  länger  ± 1\n"
        );
        assert_eq!(table(["class", "<name"], []), "class  name\n");
    }
}
