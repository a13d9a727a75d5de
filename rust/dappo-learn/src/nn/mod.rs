//! Networks: a tanh MLP, its fused CPU operation, and the Gaussian policy and value nets made of it.

pub mod actor_critic;
mod fused;
mod host;
pub mod kernels;
pub mod mlp;

pub use actor_critic::{ActorCritic, Decision, GaussianPolicy};
pub(crate) use host::{read, scalar};
pub use mlp::Mlp;
