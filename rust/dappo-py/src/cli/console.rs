//! Writing to the terminal.
//!
//! What cannot be written to standard output makes the command fail, but only at its end: whoever waits for a training
//! wants its run folder all the same. A closed pipe is no failure: whoever read it has seen enough.

use std::io::{self, ErrorKind, Write};
use std::sync::{Mutex, PoisonError};

/// Why something could not be written, the first time.
static FAILURE: Mutex<Option<io::Error>> = Mutex::new(None);

/// Prints a text to standard output.
pub fn print(text: &str) {
    let mut out = io::stdout().lock();
    remember(out.write_all(text.as_bytes()).and_then(|()| out.flush()));
}

/// Prints a line to standard output.
pub fn print_line(line: &str) {
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

/// Whether everything could be written since the last call; says so on standard error if not.
pub fn finish() -> bool {
    remember(io::stdout().lock().flush());
    let failure = FAILURE.lock().unwrap_or_else(PoisonError::into_inner).take();
    if let Some(failure) = &failure {
        error(&format!("cannot write to standard output: {failure}"));
    }
    failure.is_none()
}

/// Prints a note to standard error.
pub fn note(line: &str) {
    // Where this fails there is no place left to say so.
    let _ = writeln!(io::stderr().lock(), "{line}");
}

/// Prints an error to standard error.
pub fn error(message: &str) {
    note(&format!("error: {message}"));
}
