//! Where Python objects and commands compute.

use dappo_learn::LearnError;
use dappo_learn::config::MOST_THREADS;
use dappo_sim::ThreadPool;
use pyo3::prelude::*;

use crate::errors::{Kind, OrRaise, raise};

/// The worker threads of a Python object or a command.
pub struct Pool(ThreadPool);

impl Pool {
    /// Starts this many threads, one for each core for `None`; refuses 0 and more than [`MOST_THREADS`].
    pub fn new(threads: Option<usize>) -> PyResult<Self> {
        if let Some(threads) = threads.filter(|threads| !(1..=MOST_THREADS).contains(threads)) {
            let message = format!("`threads` is {threads}, expected a whole number from 1 to {MOST_THREADS}");
            return Err(raise(Kind::Config, message));
        }
        ThreadPool::new(threads).map(Self).or_raise()
    }

    /// Number of threads.
    pub fn num_threads(&self) -> usize {
        self.0.num_threads()
    }

    /// Runs `work` in the pool while this thread waits without the GIL, which `work` takes where it needs Python.
    pub fn run<T, E>(&self, py: Python<'_>, work: impl FnOnce() -> Result<T, E> + Send) -> PyResult<T>
    where
        T: Send,
        E: Send + Into<LearnError>,
    {
        py.detach(|| self.0.install(work)).or_raise()?.map_err(E::into).or_raise()
    }
}
