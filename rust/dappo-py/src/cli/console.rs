//! Writing to the terminal.
//!
//! What cannot be written to standard output makes the command fail, but only at its end: the run folder of a
//! training is completed all the same. A closed pipe is no failure: its reader needs no more.

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

/// Stores that something could not be written.
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
    // If this fails, there is nowhere left to report it.
    let _ = writeln!(io::stderr().lock(), "{line}");
}

/// Prints an error to standard error.
pub fn error(message: &str) {
    note!("error: {message}");
}
