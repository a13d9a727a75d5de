//! Writing to the terminal.
//!
//! What cannot be written to standard output makes the command fail, but only at its end: whoever waits for a training
//! wants its run folder all the same. A closed pipe is no failure: whoever read it has seen enough.

use std::io::{self, ErrorKind, Write};
use std::sync::{Mutex, PoisonError};

/// Prints a formatted line to standard output.
macro_rules! print_line {
    ($($text:tt)*) => { $crate::cli::console::write_line(&format!($($text)*)) };
}
pub(crate) use print_line;

/// Prints a formatted note to standard error.
macro_rules! note {
    ($($text:tt)*) => { $crate::cli::console::write_note(&format!($($text)*)) };
}
pub(crate) use note;

/// Why something could not be written, the first time.
static FAILURE: Mutex<Option<io::Error>> = Mutex::new(None);

/// Prints a text to standard output.
pub fn print(text: &str) {
    let mut out = io::stdout().lock();
    remember(out.write_all(text.as_bytes()).and_then(|()| out.flush()));
}

/// Prints a line to standard output.
pub fn write_line(line: &str) {
    print(&format!("{line}\n"));
}

/// Notes that something could not be written.
pub fn remember(written: io::Result<()>) {
    if let Err(error) = written
        && error.kind() != ErrorKind::BrokenPipe
    {
        FAILURE.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }
}

/// Fails if something could not be written since the last call.
pub fn finish() -> Result<(), String> {
    remember(io::stdout().lock().flush());
    let failure = FAILURE.lock().unwrap_or_else(PoisonError::into_inner).take();
    failure.map_or(Ok(()), |failure| Err(format!("cannot write to standard output: {failure}")))
}

/// Prints a note to standard error.
pub fn write_note(line: &str) {
    // Where this fails there is no place left to say so.
    let _ = writeln!(io::stderr().lock(), "{line}");
}

/// Prints an error to standard error.
pub fn error(message: &str) {
    note!("error: {message}");
}

/// Rows of cells, in columns as wide as their longest cell.
pub struct Table {
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table with these headers. Columns whose header begins with `<` are aligned to the left, others to the right.
    pub fn new(headers: &[&str]) -> Self {
        Self { rows: vec![headers.iter().map(ToString::to_string).collect()] }
    }

    /// Adds a row.
    pub fn row<const COLUMNS: usize>(&mut self, cells: [String; COLUMNS]) {
        self.rows.push(cells.into());
    }

    /// Prints it to standard output.
    pub fn print(&self) {
        self.lines().iter().for_each(|line| write_line(line));
    }

    fn lines(&self) -> Vec<String> {
        let headers = self.rows.first().map_or(&[][..], Vec::as_slice);
        let is_left: Vec<bool> = headers.iter().map(|header| header.starts_with('<')).collect();
        let shown = |cell: &String| cell.trim_start_matches('<').to_owned();
        let width = |column: usize| {
            self.rows.iter().filter_map(|row| row.get(column)).map(|cell| shown(cell).chars().count()).max()
        };
        let widths: Vec<usize> = (0..headers.len()).filter_map(width).collect();
        let line = |row: &Vec<String>| {
            let cells = row.iter().zip(&widths).zip(&is_left).map(|((cell, &width), &left)| {
                let cell = shown(cell);
                if left { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
            });
            cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
        };
        self.rows.iter().map(line).collect()
    }
}
