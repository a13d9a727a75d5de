//! For the tests of all crates that write files: ends a process, or fills its disk, at any of its calls to
//! the file system. Nothing else makes a plan, and without one a call only reads a cell of its thread.

use std::cell::Cell;
use std::io::{Error, ErrorKind, Result};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::{env, fs, process};

/// A folder that is removed after the test.
pub struct Scratch(pub PathBuf);

impl Scratch {
    /// A new one; where there is no room for it, the test fails at its first file.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "a folder is made")]
    pub fn new() -> Self {
        static NUMBER: AtomicUsize = AtomicUsize::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = env::temp_dir().join(format!("dappo-files-{}-{number}", process::id()));
        let _ = fs::create_dir_all(&path);
        Self(path)
    }

    /// Its contents, in order.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.0).into_iter().flatten().flatten();
        let mut names: Vec<_> =
            entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// What happens at the chosen call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The process ends: neither this call nor any later one has an effect, except for half of a write.
    Kill,
    /// The disk is full for this call alone.
    Full,
}

thread_local! {
    /// Calls until the fault, and the fault.
    static PLAN: Cell<Option<(usize, Fault)>> = const { Cell::new(None) };
    static IS_REACHED: Cell<bool> = const { Cell::new(false) };
}

/// Does `work` with a fault at its call number `call`, from 0; `None` if it makes fewer calls.
pub fn at<T>(call: usize, fault: Fault, work: impl FnOnce() -> T) -> Option<T> {
    PLAN.set(Some((call, fault)));
    IS_REACHED.set(false);
    let result = work();
    PLAN.set(None);
    IS_REACHED.get().then_some(result)
}

/// Does `work` with a fault at every call in turn, each time from a state that `prepare` makes, and has the outcome
/// examined.
pub fn everywhere<S, T>(
    mut prepare: impl FnMut() -> S,
    mut work: impl FnMut(&S) -> T,
    mut examine: impl FnMut(&S, T, Fault, usize),
) -> usize {
    let mut calls = 0;
    for fault in [Fault::Kill, Fault::Full] {
        for call in 0.. {
            let state = prepare();
            let Some(result) = at(call, fault, || work(&state)) else { break };
            examine(&state, result, fault, call);
            calls = calls.max(call + 1);
        }
    }
    calls
}

/// Fails if planned.
pub(super) fn check() -> Result<()> {
    match PLAN.get() {
        None => Ok(()),
        Some((0, fault)) => {
            IS_REACHED.set(true);
            if fault == Fault::Kill {
                return Err(Error::other("the process has ended"));
            }
            PLAN.set(None);
            Err(Error::from(ErrorKind::StorageFull))
        }
        Some((left, fault)) => {
            PLAN.set(Some((left - 1, fault)));
            Ok(())
        }
    }
}
