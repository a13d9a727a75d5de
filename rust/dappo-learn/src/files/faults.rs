//! Ends a process, or fills its disk, at any of its calls to the file system.

use std::cell::Cell;
use std::io::{Error, ErrorKind, Result};

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

pub fn check() -> Result<()> {
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
