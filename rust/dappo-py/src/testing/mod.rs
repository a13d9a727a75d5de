//! Parts of the engine on their own, for tests and research; no command needs them.

pub mod exported_networks;
pub mod lane_worlds;
pub mod rollout;
