//! Films of walks: Rust walks, `dappo_batch.render` draws.

use std::path::Path;

use dappo_learn::walk::Episode;
use indicatif::ProgressBar;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyCFunction, PyDict, PyTuple};

use super::Caller;
use crate::cli::console::note;
use crate::cli::progress::bar;
use crate::factory::{TableFactory, to_python};

/// What acts, as far as the captions show it.
pub enum Walker {
    /// A controller, whose events are shown, and the names of its damage classes.
    Controller(Vec<String>),
    /// A policy; the text describes it.
    Policy(&'static str),
}

/// An episode whose positions were kept.
pub struct Film<'a> {
    pub episode: &'a Episode,
    pub walker: Walker,
    /// Compiled its robot.
    pub factory: &'a TableFactory,
}

/// Refuses a file that could not be written, or too many frames of a strip, before a walk is spent on it.
pub fn check(py: Python<'_>, path: &Path, strip: Option<usize>) -> PyResult<()> {
    match strip {
        Some(frames) => render(py)?.call_method1("check", (path, frames)).map(drop),
        None => render(py)?.call_method1("check", (path,)).map(drop),
    }
}

/// Refuses a camera that the robot does not have, before a walk is spent on it.
pub fn check_camera(py: Python<'_>, factory: &TableFactory, camera: &str) -> PyResult<()> {
    render(py)?.call_method1("check_camera", (factory.table(py), camera)).map(drop)
}

/// Refuses to open a window where there is no screen, before a walk is spent on it.
pub fn check_screen(py: Python<'_>) -> PyResult<()> {
    render(py)?.call_method0("check_screen").map(drop)
}

/// Refuses to serve a page where packages are missing or the address is wrong, before a walk is spent on it.
pub fn check_browser(py: Python<'_>, host: &str, port: u16) -> PyResult<()> {
    render(py)?.call_method1("check_browser", (host, port)).map(drop)
}

fn render(py: Python<'_>) -> PyResult<Bound<'_, PyModule>> {
    py.import("dappo_batch.render")
}

impl Film<'_> {
    /// Draws it into a file; `strip` is the number of frames of a PNG.
    pub fn write(
        &self,
        py: Python<'_>,
        path: &Path,
        camera: &str,
        strip: Option<usize>,
        caller: &Caller,
    ) -> PyResult<()> {
        caller.leave_to_python(py)?;
        let bar = bar(0, matches!(caller, Caller::Terminal));
        let keywords = PyDict::new(py);
        keywords.set_item("camera", camera)?;
        if let Some(strip) = strip {
            keywords.set_item("strip", strip)?;
        }
        keywords.set_item("progress", progress(py, bar.clone())?)?;
        let written = render(py)?.getattr("write")?.call((path, self.in_python(py)?), Some(&keywords));
        bar.finish_and_clear();
        let frames: usize = written?.extract()?;
        let steps = self.episode.steps;
        note!("{}: frames {frames}, steps {steps}", path.display());
        Ok(())
    }

    /// Shows it in a window until that is closed.
    pub fn show(&self, py: Python<'_>, camera: &str, caller: &Caller) -> PyResult<()> {
        caller.leave_to_python(py)?;
        render(py)?.call_method1("view", (self.in_python(py)?, camera)).map(drop)
    }

    /// Serves a page with it until interrupted.
    pub fn serve(
        &self,
        py: Python<'_>,
        (host, port): (&str, u16),
        camera: &str,
        caller: &Caller,
    ) -> PyResult<()> {
        caller.leave_to_python(py)?;
        render(py)?.call_method1("browse", (self.in_python(py)?, host, port, camera)).map(drop)
    }

    fn in_python<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let (positions, states) = (&self.episode.positions, self.episode.steps + 1);
        let qpos = PyArray1::from_slice(py, positions).reshape([states, positions.len() / states])?;
        let about = PyDict::new(py);
        about.set_item("damage", self.episode.class)?;
        about.set_item("onset", self.episode.onset)?;
        about.set_item("forward_velocity", PyArray1::from_slice(py, &self.episode.velocities))?;
        match &self.walker {
            Walker::Controller(known_names) => {
                about.set_item("events", to_python(py, &self.episode.events)?)?;
                about.set_item("known_names", known_names)?;
            }
            Walker::Policy(note) => about.set_item("note", note)?,
        }
        render(py)?.getattr("Walk")?.call((self.factory.table(py), qpos), Some(&about))
    }
}

/// What `write` calls after every frame with the number of frames drawn and that of all.
fn progress(py: Python<'_>, bar: ProgressBar) -> PyResult<Bound<'_, PyCFunction>> {
    PyCFunction::new_closure(py, None, None, move |arguments: &Bound<'_, PyTuple>, _| -> PyResult<()> {
        let (drawn, all) = arguments.extract::<(u64, u64)>()?;
        bar.set_length(all);
        bar.set_message(format!("frame {drawn}/{all}"));
        bar.set_position(drawn);
        Ok(())
    })
}
