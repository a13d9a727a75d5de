//! Networks: a tanh MLP, the Gaussian policy and value nets made of it, and the diagnoser's LSTM; on CPUs
//! they run as fused operations.

pub mod actor_critic;
mod adam;
mod device;
pub mod diagnoser;
mod fused;
mod host;
mod init;
pub mod kernels;
pub mod lstm;
pub mod mlp;

pub use actor_critic::{ActorCritic, Decision, GaussianPolicy};
pub use adam::fused_adam;
pub use device::{LearnerDevice, cpu};
pub use diagnoser::DiagnoserNet;
pub(crate) use host::{read, scalar};
pub use lstm::EmbeddedLstm;
pub use mlp::Mlp;
