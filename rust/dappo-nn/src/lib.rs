//! Networks: a tanh MLP, the Gaussian policy and value nets made of it, the LSTMs of recurrent policies and diagnosers;
//! what trains them, and what is left of them for acting.
//!
//! Parameters, optimiser states and files are burn's, on every device. On CPUs forward and backward passes and Adam are
//! written out in [`kernels`]: a policy of 40 thousand parameters is smaller than what a general tensor operation costs.
//!
//! ```text
//! ActorCritic ── frozen(normalizer) ──▶ FrozenActorCritic { Policy, log-std, value net }
//! trained by the learner                what envs, evaluations, controllers, exports and devices take
//! ```

mod actor_critic;
mod adam;
mod device;
pub mod diagnoser;
pub mod error;
mod frozen;
mod host;
mod init;
mod input;
pub mod kernels;
pub mod lstm;
mod lstm_op;
mod memory;
pub mod minibatch;
mod mlp;
mod normalizer;
mod policy;
pub mod records;
mod standardizer;
mod symmetry;

pub use actor_critic::{ActorCritic, ActorCriticSizes, GaussianPolicy};
pub use adam::{Gradients, adam};
pub use device::{LearnerDevice, cpu};
pub use diagnoser::DiagnoserNet;
pub use error::{NnError, Result};
pub use frozen::{Decision, FrozenActorCritic, unprivileged};
pub use host::{read, scalar};
pub use input::InputTransform;
pub use lstm::EmbeddedLstm;
pub use memory::{FrozenLstm, Lstm, PolicyState, with_hidden};
pub use mlp::{FrozenMlp, Mlp};
pub use normalizer::{CLIP, Normalizer};
pub use policy::Policy;
pub use standardizer::Standardizer;
pub use symmetry::{LstmSymmetry, MlpSymmetry, PolicySymmetry};

/// ln √(2π), the constant of a normal log-density.
pub const LN_SQRT_TAU: f64 = 0.918_938_533_204_672_7;
