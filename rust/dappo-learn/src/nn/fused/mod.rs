//! Networks as single burn operations on CPUs, with hand-written backward passes.
//!
//! burn calls an extension trait through its `Dispatch` type. The trait is implemented for the Flex
//! backend, and for `Autodiff<Flex>` by recording a node whose state keeps what the backward pass needs.
//! Other backends are not listed and would panic: networks send them down a path of burn's own operations.

mod lstm;

pub(super) use lstm::embedded_lstm;
