//! The losses of PPO as functions of tensors, and what adapts from one update to the next.

use burn::tensor::Tensor;
use dappo_nn::LN_SQRT_TAU;
use serde::{Deserialize, Serialize};

/// Bounds of the KL weight β and the learning-rate factor, and the step between values of either.
const MAX_KL_COEF: f64 = 35.0;
const HIGH_KL_COEF: f64 = 30.0;
const MIN_LR_FACTOR: f64 = 0.1;
const ADAPTATION_STEP: f64 = 1.5;
/// Bound of ln ρ from above. Such a ratio means a policy that has moved by several standard deviations; much
/// beyond, `exp` overflows and the training diverges. At the bound the ratio no longer depends on the policy.
pub(super) const MAX_LOG_RATIO: f64 = 20.0;

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
    /// Share of the rows that the KL divergence was measured on whose probability ratio ended outside 1 ± ε.
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
    /// d*/2 the opposite happens, with bounds 1/35 and 1/30. The factor stays within 0.1 and
    /// `max_lr_factor`, 10 in the paper's preset.
    #[must_use]
    pub fn after(self, kl: f64, kl_target: f64, max_lr_factor: f64) -> Self {
        let Self { mut kl_coef, mut lr_factor } = self;
        if kl > 2.0 * kl_target {
            kl_coef = (kl_coef * ADAPTATION_STEP).min(MAX_KL_COEF);
            if kl_coef > HIGH_KL_COEF {
                lr_factor = (lr_factor / ADAPTATION_STEP).max(MIN_LR_FACTOR);
            }
        } else if kl < kl_target / 2.0 {
            kl_coef = (kl_coef / ADAPTATION_STEP).max(1.0 / MAX_KL_COEF);
            if kl_coef < 1.0 / HIGH_KL_COEF {
                lr_factor = (lr_factor * ADAPTATION_STEP).min(max_lr_factor);
            }
        }
        Self { kl_coef, lr_factor }
    }
}

/// What weighs the terms of the policy's loss in one update.
#[derive(Debug, Clone, Copy)]
pub(super) struct Objective {
    /// ε of the clipped surrogate.
    pub clip_range: f64,
    /// β.
    pub kl_coef: f64,
    /// d*.
    pub kl_target: f64,
    /// η.
    pub kl_hinge: f64,
}

impl Objective {
    /// β KL + η max(0, KL − 2 d*)².
    pub fn kl_penalty(&self, kl: f64) -> f64 {
        self.kl_coef * kl + self.kl_hinge * self.excess(kl).powi(2)
    }

    /// The derivative of the penalty, β + 2 η max(0, KL − 2 d*).
    pub fn kl_slope(&self, kl: f64) -> f64 {
        self.kl_coef + 2.0 * self.kl_hinge * self.excess(kl)
    }

    fn excess(&self, kl: f64) -> f64 {
        (kl - 2.0 * self.kl_target).max(0.0)
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

/// The probability ratios ρ, whose logarithm is at most 20.
///
/// # Shapes
/// `log_prob`, `old_log_prob` `[M, 1]`; returns `[M, 1]`
#[must_use]
pub fn ratio(log_prob: Tensor<2>, old_log_prob: Tensor<2>) -> Tensor<2> {
    (log_prob - old_log_prob).clamp_max(MAX_LOG_RATIO).exp()
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
///
/// # Shapes
/// kl `[1]`; returns `[1]`
#[must_use]
pub fn kl_penalty(kl: Tensor<1>, kl_coef: f64, kl_target: f64, kl_hinge: f64) -> Tensor<1> {
    let excess = kl.clone().sub_scalar(2.0 * kl_target).clamp_min(0.0);
    kl.mul_scalar(kl_coef) + excess.square().mul_scalar(kl_hinge)
}

/// Entropy of a diagonal Gaussian with standard deviations of these logarithms, `[A]`, nats.
#[must_use]
pub fn entropy(log_std: &[f32]) -> f64 {
    log_std.iter().map(|log_std| f64::from(*log_std) + 0.5 + LN_SQRT_TAU).sum()
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;

    // actions = np.array([[.3, -.2], [-.5, .8], [1.1, .1]]); mean = np.array([[.1, .0], [-.3, .4], [.9, -.4]])
    // old_mean = np.array([[.0, .1], [-.2, .5], [.7, -.3]]); ls = np.array([-.5, -.3]); ols = np.array([-.4, -.45])
    const ACTION: [f32; 6] = [0.3, -0.2, -0.5, 0.8, 1.1, 0.1];
    const MEAN: [f32; 6] = [0.1, 0.0, -0.3, 0.4, 0.9, -0.4];
    const OLD_MEAN: [f32; 6] = [0.0, 0.1, -0.2, 0.5, 0.7, -0.3];
    const LOG_STD: [f32; 2] = [-0.5, -0.3];
    const OLD_LOG_STD: [f32; 2] = [-0.4, -0.45];

    fn rows(values: &[f32], width: usize) -> Tensor<2> {
        let data = TensorData::new(values.to_vec(), [values.len() / width, width]);
        Tensor::from_data(data, &Device::flex())
    }

    fn vector(values: &[f32]) -> Tensor<1> {
        Tensor::from_data(TensorData::new(values.to_vec(), [values.len()]), &Device::flex())
    }

    fn assert_close<const D: usize>(got: Tensor<D>, expected: &[f64]) {
        let got: Vec<f32> = got.into_data().try_into_vec().unwrap();
        assert_eq!(got.len(), expected.len());
        for (got, expected) in got.iter().zip(expected) {
            assert!((f64::from(*got) - expected).abs() < 1e-6, "{got}, expected {expected}");
        }
    }

    #[test]
    fn log_densities_equal_numpy() {
        // (-.5 * ((actions - mean) / np.exp(ls)) ** 2 - ls - .5 * np.log(2 * np.pi)).sum(1)
        let got = log_prob(rows(&ACTION, 2), rows(&MEAN, 2), vector(&LOG_STD));
        assert_close(got, &[-1.128_685_079, -1.238_012_207, -1.320_007_553]);
    }

    #[test]
    fn the_surrogate_equals_numpy_on_both_sides_of_the_clip_range() {
        // r = np.array([.5, 1.5, 1.1, .7]); a = np.array([1., 1., -2., -1.])
        // np.minimum(r * a, np.clip(r, .8, 1.2) * a).mean()
        let got = surrogate(rows(&[0.5, 1.5, 1.1, 0.7], 1), rows(&[1.0, 1.0, -2.0, -1.0], 1), 0.2);
        assert_close(got, &[-0.325]);
    }

    #[test]
    fn the_kl_divergence_equals_numpy_quadrature_of_its_definition() {
        // x = np.linspace(-12, 12, 200001); p, q = densities of old and new
        // sum over components of np.trapezoid(p * (np.log(p) - np.log(q)), x), mean over rows
        let (old, new) = (rows(&OLD_MEAN, 2), rows(&MEAN, 2));
        let kl = kl_divergence(old.clone(), vector(&OLD_LOG_STD), new, vector(&LOG_STD));
        assert_close(kl, &[0.067_403_901_707]);
        let zero = kl_divergence(old.clone(), vector(&LOG_STD), old, vector(&LOG_STD));
        assert_close(zero, &[0.0]);
    }

    #[test]
    fn the_hinge_acts_only_above_twice_the_target() {
        // 1.7 * kl + 50 * max(0, kl - .02) ** 2
        assert_close(kl_penalty(vector(&[0.015]), 1.7, 0.01, 50.0), &[0.0255]);
        assert_close(kl_penalty(vector(&[0.05]), 1.7, 0.01, 50.0), &[0.13]);
    }

    #[test]
    fn the_entropy_equals_numpy() {
        // (ls + .5 * np.log(2 * np.pi * np.e)).sum()
        assert!((entropy(&LOG_STD) - 2.037_877_066).abs() < 1e-6);
    }

    #[test]
    fn beta_and_the_learning_rate_factor_follow_the_divergence() {
        let start = Adaptation::default();
        assert_eq!(start, Adaptation { kl_coef: 1.0, lr_factor: 1.0 });
        assert_eq!(start.after(0.0201, 0.01, 10.0), Adaptation { kl_coef: 1.5, lr_factor: 1.0 });
        assert_eq!(start.after(0.0049, 0.01, 10.0), Adaptation { kl_coef: 1.0 / 1.5, lr_factor: 1.0 });
        for kl in [0.005, 0.01, 0.02] {
            assert_eq!(start.after(kl, 0.01, 10.0), start, "kl {kl} lies in the dead band");
        }
        let high = Adaptation { kl_coef: 25.0, lr_factor: 1.0 };
        assert_eq!(high.after(1.0, 0.01, 10.0), Adaptation { kl_coef: 35.0, lr_factor: 1.0 / 1.5 });
        let low = Adaptation { kl_coef: 0.04, lr_factor: 1.0 };
        assert_eq!(low.after(0.0, 0.01, 10.0), Adaptation { kl_coef: 1.0 / 35.0, lr_factor: 1.5 });
    }

    #[test]
    fn beta_and_the_factor_stay_within_their_bounds() {
        let many = |kl| (0..50).fold(Adaptation::default(), |a, _| a.after(kl, 0.01, 10.0));
        assert_eq!(many(1.0), Adaptation { kl_coef: 35.0, lr_factor: 0.1 });
        assert_eq!(many(0.0), Adaptation { kl_coef: 1.0 / 35.0, lr_factor: 10.0 });
        let capped = (0..50).fold(Adaptation::default(), |a, _| a.after(0.0, 0.01, 1.0));
        assert_eq!(capped, Adaptation { kl_coef: 1.0 / 35.0, lr_factor: 1.0 });
    }
}
