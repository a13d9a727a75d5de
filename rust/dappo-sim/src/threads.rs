//! Worker threads.
//!
//! What computes in parallel does so in the pool that it is called in, see [`ThreadPool::install`]. Nothing
//! computes in rayon's global pool: its size is not chosen here, and a forked process, which has none of its
//! threads, cannot replace it.

use std::process;
use std::sync::OnceLock;
use std::thread;

use crate::error::SimError;

/// The number of cores that this process may use.
#[must_use]
pub fn available() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// A fixed number of worker threads, in this process and in those that are forked from it.
pub struct ThreadPool {
    threads: usize,
    first: Generation,
}

impl ThreadPool {
    /// Starts so many threads, one for each core for `None`.
    pub fn new(threads: Option<usize>) -> Result<Self, SimError> {
        let threads = threads.unwrap_or_else(available);
        Ok(Self { threads, first: Generation::new(threads)? })
    }

    /// Number of threads.
    #[must_use]
    pub fn num_threads(&self) -> usize {
        self.threads
    }

    /// Runs `work` in the pool: parallel operations inside of it use these threads and no others.
    ///
    /// It fails only in a forked process that cannot start threads.
    pub fn install<T: Send>(&self, work: impl FnOnce() -> T + Send) -> Result<T, SimError> {
        let mut generation = &self.first;
        while generation.process != process::id() {
            generation = generation.next(self.threads)?;
        }
        Ok(match &generation.pool {
            Some(pool) => pool.install(work),
            // `pool` is taken by `drop` alone.
            None => work(),
        })
    }
}

/// The threads of one process. A fork copies the memory of a pool but none of its threads, so that a wait for
/// them never ends.
///
/// No lock is held while threads start. That of `next` is held only while a generation that is complete is put into it.
struct Generation {
    process: u32,
    pool: Option<rayon::ThreadPool>,
    /// The threads of a process that was forked from this one.
    next: OnceLock<Box<Generation>>,
}

impl Generation {
    fn new(threads: usize) -> Result<Self, SimError> {
        let failed = |reason: String| SimError::Threads { threads, reason };
        if threads == 0 {
            return Err(failed("at least one is needed".into()));
        }
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|index| format!("dappo-worker-{index}"))
            .build()
            .map_err(|error| failed(error.to_string()))?;
        Ok(Self { process: process::id(), pool: Some(pool), next: OnceLock::new() })
    }

    fn next(&self, threads: usize) -> Result<&Self, SimError> {
        if let Some(next) = self.next.get() {
            return Ok(next);
        }
        let made = Box::new(Self::new(threads)?);
        Ok(self.next.get_or_init(|| made))
    }
}

impl Drop for Generation {
    fn drop(&mut self) {
        if self.process != process::id() {
            // Ending a pool takes locks, which threads that are not there may hold.
            std::mem::forget(self.pool.take());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_runs_in_the_threads_of_its_pool_and_no_others() {
        let pool = ThreadPool::new(Some(2)).unwrap();
        let names = pool
            .install(|| rayon::broadcast(|_| thread::current().name().unwrap_or_default().to_owned()))
            .unwrap();
        assert_eq!(names, ["dappo-worker-0", "dappo-worker-1"]);
        assert_eq!(pool.num_threads(), 2);
    }

    #[test]
    fn no_threads_are_rejected() {
        let error = ThreadPool::new(Some(0)).err().unwrap().to_string();
        assert_eq!(error, "cannot start 0 worker threads: at least one is needed");
    }
}
