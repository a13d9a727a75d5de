//! What a person or a program sees of a long command, and how it is stopped.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressStyle};
use pyo3::prelude::*;
use serde::Serialize;

use super::Caller;
use super::console::write_note;

/// A progress bar, unless hidden.
pub fn bar(length: u64, is_shown: bool) -> ProgressBar {
    let bar = if is_shown { ProgressBar::new(length) } else { ProgressBar::hidden() };
    if let Ok(style) = ProgressStyle::with_template("{bar:24} {percent:>3}%  {msg}  {elapsed} < {eta}") {
        bar.set_style(style);
    }
    bar
}

/// Shows a progress bar, or passes objects to a program, and forwards Ctrl-C.
pub struct Watch<'a> {
    bar: ProgressBar,
    /// Gets the objects.
    objects: Option<&'a Caller>,
    interrupted: Arc<AtomicBool>,
}

impl<'a> Watch<'a> {
    /// A progress bar of `length` steps, or with `json` objects for `caller`.
    pub fn new(length: u64, json: bool, caller: &'a Caller) -> PyResult<Self> {
        let (bar, objects) = (bar(length, !json), json.then_some(caller));
        Ok(Self { bar, objects, interrupted: caller.watch()? })
    }

    /// Hands an object to a program; returns whether there is one.
    pub fn object(&self, object: &impl Serialize) -> bool {
        self.objects.inspect(|caller| caller.object(object)).is_some()
    }

    /// Changes the number of steps.
    pub fn set_length(&self, length: u64) {
        self.bar.set_length(length);
    }

    /// Moves the bar on a terminal.
    pub fn step(&self, position: u64, message: String) {
        self.bar.set_position(position);
        self.bar.set_message(message);
    }

    /// Prints a line where no terminal shows a bar.
    pub fn line(&self, message: &str) {
        if self.objects.is_none() && self.bar.is_hidden() {
            write_note(message);
        }
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }

    /// Whether to stop.
    pub fn is_interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }
}
