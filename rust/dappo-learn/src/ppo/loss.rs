//! The losses of PPO as functions of tensors, and what adapts from one update to the next.

use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

use crate::nn::actor_critic::LN_SQRT_TAU;

/// Bounds of the KL weight β and the learning-rate factor, and the step between values of either.
const MAX_KL_COEF: f64 = 35.0;
const HIGH_KL_COEF: f64 = 30.0;
const LR_FACTORS: [f64; 2] = [0.1, 10.0];
const ADAPTATION_STEP: f64 = 1.5;

/// What one update measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PpoLosses {
    /// The policy's loss, penalties included: mean over the minibatches of the last epoch.
    pub policy_loss: f64,
    /// Mean squared error of the value net: mean over the minibatches of the last epoch.
    pub value_loss: f64,
    /// KL(old ‖ new) over the batch after the last epoch.
    pub kl: f64,
    /// The KL weight β that the next update will use.
    pub kl_coef: f64,
    /// The policy's learning rate that the next update will use, adaptive factor included.
    pub learning_rate: f64,
    /// Entropy of the policy after the update, nats.
    pub entropy: f64,
    /// Share of the variance of the returns that the values of the rollout explained.
    pub explained_variance: f64,
    /// Share of the batch whose probability ratio ended outside 1 ± ε.
    pub clip_fraction: f64,
    /// Passes made for the policy.
    pub epochs_run: usize,
}

/// The KL weight β and the learning-rate factor, steered by the KL divergence of every update.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Adaptation {
    /// β.
    pub kl_coef: f64,
    /// Multiplies the policy's learning rate.
    pub lr_factor: f64,
}

impl Default for Adaptation {
    fn default() -> Self {
        Self { kl_coef: 1.0, lr_factor: 1.0 }
    }
}

impl Adaptation {
    /// The values for the next update, after one whose divergence was `kl`.
    ///
    /// Above 2 d*, β grows by a half up to 35, and beyond 30 the learning rate shrinks as well; below
    /// d*/2 the opposite happens, with bounds 1/35 and 1/30. The factor stays within 0.1 and 10.
    #[must_use]
    pub fn after(self, kl: f64, kl_target: f64) -> Self {
        let Self { mut kl_coef, mut lr_factor } = self;
        if kl > 2.0 * kl_target {
            kl_coef = (kl_coef * ADAPTATION_STEP).min(MAX_KL_COEF);
            if kl_coef > HIGH_KL_COEF {
                lr_factor = (lr_factor / ADAPTATION_STEP).max(LR_FACTORS[0]);
            }
        } else if kl < kl_target / 2.0 {
            kl_coef = (kl_coef / ADAPTATION_STEP).max(1.0 / MAX_KL_COEF);
            if kl_coef < 1.0 / HIGH_KL_COEF {
                lr_factor = (lr_factor * ADAPTATION_STEP).min(LR_FACTORS[1]);
            }
        }
        Self { kl_coef, lr_factor }
    }
}

/// Log-density of actions under a diagonal Gaussian.
///
/// # Shapes
/// actions, mean `[M, A]`, `log_std` `[A]`; returns `[M, 1]`
#[must_use]
pub fn log_prob(actions: Tensor<2>, mean: Tensor<2>, log_std: Tensor<1>) -> Tensor<2> {
    let log_std = log_std.unsqueeze::<2>();
    let z = (actions - mean) * log_std.clone().neg().exp();
    (z.square().mul_scalar(-0.5) - log_std).sub_scalar(LN_SQRT_TAU).sum_dim(1)
}

/// The clipped surrogate E[min(ρ Â, clip(ρ, 1 ± ε) Â)] of probability ratios ρ.
///
/// # Shapes
/// ratio, advantages `[M, 1]`; returns `[1]`
#[must_use]
pub fn surrogate(ratio: Tensor<2>, advantages: Tensor<2>, clip_range: f64) -> Tensor<1> {
    let clipped = ratio.clone().clamp(1.0 - clip_range, 1.0 + clip_range);
    (ratio * advantages.clone()).min_pair(clipped * advantages).mean()
}

/// KL(old ‖ new) of diagonal Gaussians, exact, averaged over the rows.
///
/// # Shapes
/// means `[M, A]`, log-stds `[A]`; returns `[1]`
#[must_use]
pub fn kl_divergence(
    old_mean: Tensor<2>,
    old_log_std: Tensor<1>,
    mean: Tensor<2>,
    log_std: Tensor<1>,
) -> Tensor<1> {
    let (old_log_std, log_std) = (old_log_std.unsqueeze::<2>(), log_std.unsqueeze::<2>());
    let difference = log_std.clone() - old_log_std.clone();
    let precision = log_std.mul_scalar(-2.0).exp();
    let squares = old_log_std.mul_scalar(2.0).exp() + (old_mean - mean).square();
    let per_component = squares * precision.mul_scalar(0.5) + difference.sub_scalar(0.5);
    per_component.sum_dim(1).mean()
}

/// β KL + η max(0, KL − 2 d*)².
#[must_use]
pub fn kl_penalty(kl: Tensor<1>, kl_coef: f64, kl_target: f64, kl_hinge: f64) -> Tensor<1> {
    let excess = kl.clone().sub_scalar(2.0 * kl_target).clamp_min(0.0);
    kl.mul_scalar(kl_coef) + excess.square().mul_scalar(kl_hinge)
}

/// Entropy of a diagonal Gaussian, nats.
#[must_use]
pub fn entropy(log_std: &[f32]) -> f64 {
    log_std.iter().map(|log_std| f64::from(*log_std) + 0.5 + LN_SQRT_TAU).sum()
}
