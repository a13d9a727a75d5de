//! Writing to the terminal. A closed pipe is no error: whoever read it has seen enough.

use std::io::Write;

/// Prints a text to standard output.
pub fn print(text: &str) {
    let _ = std::io::stdout().lock().write_all(text.as_bytes());
}

/// Prints a line to standard output.
pub fn print_line(line: &str) {
    let mut out = std::io::stdout().lock();
    let _ = writeln!(out, "{line}");
    let _ = out.flush();
}

/// Prints a note to standard error.
pub fn note(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Prints an error to standard error.
pub fn error(message: &str) {
    note(&format!("error: {message}"));
}
