//! The policy's loss and its gradients with respect to the means and the log-stds, row by row.

use dappo_nn::LN_SQRT_TAU;

use super::batch::PolicyBatch;
use super::loss;

const MAX_LOG_RATIO: f32 = loss::MAX_LOG_RATIO as f32;

/// The current and the old standard deviations, in the forms that every row needs.
pub(super) struct Gaussian {
    inverse_std: Vec<f32>,
    inverse_variance: Vec<f32>,
    old_variance: Vec<f32>,
    /// ln of the normalising constant of the density.
    log_constant: f32,
    /// The part of KL(old ‖ current) that all rows share.
    shared_kl: f64,
}

impl Gaussian {
    /// # Shapes
    /// current and old logarithms of the standard deviations `[A]`
    pub fn new(log_std: &[f32], old_log_std: &[f32]) -> Self {
        let pairs = log_std.iter().zip(old_log_std).map(|(new, old)| (f64::from(*new), f64::from(*old)));
        let shared_kl = pairs.map(|(new, old)| new - old + 0.5 * (2.0 * (old - new)).exp() - 0.5).sum();
        Self {
            inverse_std: log_std.iter().map(|x| (-x).exp()).collect(),
            inverse_variance: log_std.iter().map(|x| (-2.0 * x).exp()).collect(),
            old_variance: old_log_std.iter().map(|x| (2.0 * x).exp()).collect(),
            log_constant: log_std.iter().map(|x| f64::from(*x) + LN_SQRT_TAU).sum::<f64>() as f32,
            shared_kl,
        }
    }

    fn actions(&self) -> usize {
        self.inverse_std.len()
    }

    /// ln ρ, with ρ the probability of an action under the current policy over that under the old one.
    fn log_ratio(&self, action: &[f32], mean: &[f32], old_log_prob: f32) -> f32 {
        let components = action.iter().zip(mean).zip(&self.inverse_std);
        let squares: f32 = components.map(|((a, mean), inverse)| ((a - mean) * inverse).powi(2)).sum();
        -0.5 * squares - self.log_constant - old_log_prob
    }

    /// KL(old ‖ current) summed over rows.
    ///
    /// # Shapes
    /// rows of the batch `[R]`, means of the current policy there `[R, A]`
    pub fn kl_sum(&self, batch: &PolicyBatch, rows: &[i32], means: &[f32]) -> f64 {
        let width = self.actions();
        let of_row = |(index, mean): (&i32, &[f32])| {
            let components = mean.iter().zip(row(batch.means, *index, width)).zip(&self.inverse_variance);
            components.map(|((new, old), inverse)| (new - old).powi(2) * inverse).sum::<f32>()
        };
        let distances: f64 = rows.iter().zip(means.chunks_exact(width)).map(of_row).map(f64::from).sum();
        0.5 * distances + self.shared_kl * rows.len() as f64
    }

    /// Number of rows whose ratio lies outside 1 ± `clip_range`.
    ///
    /// # Shapes
    /// rows of the batch `[R]`, means of the current policy there `[R, A]`
    pub fn clipped(&self, batch: &PolicyBatch, rows: &[i32], means: &[f32], clip_range: f64) -> usize {
        let outside = |(index, mean): &(&i32, &[f32])| {
            let action = row(batch.actions, **index, mean.len());
            let ratio = ratio(self.log_ratio(action, mean, batch.log_probs[**index as usize]));
            (ratio - 1.0).abs() > clip_range as f32
        };
        rows.iter().zip(means.chunks_exact(self.actions())).filter(outside).count()
    }

    /// The gradients of the policy's loss with respect to the means of some rows.
    ///
    /// With z = (a − μ) / σ and c = β + 2 η max(0, KL − 2 d*), a row's share of the gradient is
    ///
    /// ```text
    /// ∂/∂μ    = −s z / σ      + c (μ − μ_old) / σ²
    /// ∂/∂ln σ = −s (z² − 1)   + c (1 − (σ_old² + (μ − μ_old)²) / σ²)
    /// ```
    ///
    /// where s is Â ρ, or 0 where the clip range or the bound of ln ρ takes hold.
    ///
    /// # Shapes
    /// rows `[M]`, means and gradients `[M, A]`
    pub fn gradients(
        &self,
        weights: Weights,
        batch: &PolicyBatch,
        rows: &[i32],
        means: &[f32],
        gradients: &mut [f32],
    ) -> Sums {
        let width = self.actions();
        let (low, high) = (1.0 - weights.clip_range, 1.0 + weights.clip_range);
        let mut sums =
            Sums { surrogate: 0.0, kl: self.kl_sum(batch, rows, means), log_std_gradient: vec![0.0; width] };
        for ((index, mean), gradient) in
            rows.iter().zip(means.chunks_exact(width)).zip(gradients.chunks_exact_mut(width))
        {
            let (action, old_mean) = (row(batch.actions, *index, width), row(batch.means, *index, width));
            let advantage = batch.advantages[*index as usize];
            let log_ratio = self.log_ratio(action, mean, batch.log_probs[*index as usize]);
            let ratio = ratio(log_ratio);
            let (free, clipped) = (ratio * advantage, ratio.clamp(low, high) * advantage);
            sums.surrogate += f64::from(free.min(clipped));
            let slope = if free <= clipped && !is_bounded(log_ratio) { free } else { 0.0 };
            let of_row = gradient
                .iter_mut()
                .zip(&mut sums.log_std_gradient)
                .zip(action.iter().zip(mean).zip(old_mean));
            let of_policy = self.inverse_std.iter().zip(&self.inverse_variance).zip(&self.old_variance);
            for (
                ((gradient, sum), ((action, mean), old_mean)),
                ((inverse, inverse_variance), old_variance),
            ) in of_row.zip(of_policy)
            {
                let (z, moved) = ((action - mean) * inverse, mean - old_mean);
                *gradient = weights.row * (weights.kl * moved * inverse_variance - slope * z * inverse);
                let spread = (old_variance + moved * moved) * inverse_variance;
                *sum += weights.row * (weights.kl * (1.0 - spread) - slope * (z * z - 1.0));
            }
        }
        sums
    }
}

/// What multiplies the terms of every row.
#[derive(Clone, Copy)]
pub(super) struct Weights {
    /// c, the derivative of the KL penalty.
    pub kl: f32,
    /// ε.
    pub clip_range: f32,
    /// 1 / number of rows of the minibatch.
    pub row: f32,
}

/// What is summed over rows.
pub(super) struct Sums {
    /// The clipped surrogate min(ρ Â, clip(ρ, 1 ± ε) Â).
    pub surrogate: f64,
    /// KL(old ‖ current).
    pub kl: f64,
    /// The gradient with respect to the log-stds, `[A]`.
    pub log_std_gradient: Vec<f32>,
}

/// ρ of ln ρ, which is bounded first.
fn ratio(log_ratio: f32) -> f32 {
    if is_bounded(log_ratio) { MAX_LOG_RATIO } else { log_ratio }.exp()
}

/// Whether the bound takes hold, which it does not of NaN: that must show.
fn is_bounded(log_ratio: f32) -> bool {
    log_ratio > MAX_LOG_RATIO
}

/// Row `index` of a row-major matrix.
fn row(matrix: &[f32], index: i32, width: usize) -> &[f32] {
    &matrix[index as usize * width..][..width]
}

#[cfg(test)]
mod tests {
    use super::super::loss::Objective;
    use super::*;

    // a = np.array([[.3, -.2], [-.5, .8], [1.1, .1]]); m = np.array([[.1, .0], [-.3, .4], [.9, -.4]])
    // om = np.array([[.0, .1], [-.2, .5], [.7, -.3]]); ols = np.array([-.4, -.45]); ls = np.array([-.5, -.3])
    // def loss(m, ls):
    //     lp = (-.5 * ((a - m) / np.exp(ls)) ** 2 - ls - .5 * np.log(2 * np.pi)).sum(1)
    //     r = np.exp(np.minimum(lp - old, 20))
    //     s = np.minimum(r * adv, np.clip(r, .8, 1.2) * adv).mean()
    //     kl = (ls - ols + (np.exp(2 * ols) + (m - om) ** 2) / (2 * np.exp(2 * ls)) - .5).sum(1).mean()
    //     return 1.7 * kl + 50 * max(0, kl - .02) ** 2 - s        # kl = .067
    // gradients: (loss(x + h) - loss(x - h)) / 2h with h = 1e-5, all arrays np.longdouble
    const ACTIONS: [f32; 6] = [0.3, -0.2, -0.5, 0.8, 1.1, 0.1];
    const MEANS: [f32; 6] = [0.1, 0.0, -0.3, 0.4, 0.9, -0.4];
    const OLD_MEANS: [f32; 6] = [0.0, 0.1, -0.2, 0.5, 0.7, -0.3];
    const LOG_STD: [f32; 2] = [-0.5, -0.3];
    const OLD_LOG_STD: [f32; 2] = [-0.4, -0.45];

    fn batch(old_log_probs: &[f32; 3], advantages: [f32; 3]) -> PolicyBatch<'_> {
        PolicyBatch {
            obs: &[],
            actions: &ACTIONS,
            means: &OLD_MEANS,
            log_probs: old_log_probs,
            advantages: advantages.to_vec(),
            sequences: None,
        }
    }

    /// Compares the loss, to a share of 1e-6 of it, and its gradients with respect to the means and the log-stds.
    fn assert_equal(batch: &PolicyBatch, expected_loss: f64, expected: [f64; 8]) {
        let objective = Objective { clip_range: 0.2, kl_coef: 1.7, kl_target: 0.01, kl_hinge: 50.0 };
        let mut mean_gradient = [0.0; 6];
        let gaussian = Gaussian::new(&LOG_STD, &OLD_LOG_STD);
        let kl = gaussian.kl_sum(batch, &[0, 1, 2], &MEANS) / 3.0;
        let weights = Weights { kl: objective.kl_slope(kl) as f32, clip_range: 0.2, row: 1.0 / 3.0 };
        let sums = gaussian.gradients(weights, batch, &[0, 1, 2], &MEANS, &mut mean_gradient);
        let loss = objective.kl_penalty(sums.kl / 3.0) - sums.surrogate / 3.0;
        assert!((loss / expected_loss - 1.0).abs() < 1e-6, "{loss}, expected {expected_loss}");
        for (got, expected) in mean_gradient.iter().chain(&sums.log_std_gradient).zip(expected) {
            assert!((f64::from(*got) - expected).abs() < 2e-6, "{got}, expected {expected}");
        }
    }

    #[test]
    fn loss_and_gradients_equal_finite_differences_of_numpy() {
        // old = np.array([-1.5, -1.3, -1.2]); adv = np.array([1., -2., .5])
        // r is 1.45, 1.06 and .89: the first is clipped
        const LOSS: f64 = 0.388_423_742_8;
        const GRADIENTS: [f64; 8] = [
            0.583_559_853,
            -0.391_171_867,
            -0.969_175_080,
            0.125_799_366,
            1.086_756_989,
            -0.525_843_717,
            -2.276_486_176,
            1.129_852_179,
        ];
        assert_equal(&batch(&[-1.5, -1.3, -1.2], [1.0, -2.0, 0.5]), LOSS, GRADIENTS);
    }

    #[test]
    fn beyond_the_bound_of_the_ratio_they_equal_those_of_numpy_too() {
        // old = np.array([-1.5, -100., -22.]); adv = np.array([1., -2., -.5])
        // lp - old is .37, 98.8 and 20.7: nothing but the KL penalty has a gradient
        const LOSS: f64 = 404_304_329.335_101_66;
        const GRADIENTS: [f64; 8] = [
            0.583_559_886,
            -0.391_171_925,
            -0.583_559_886,
            -0.391_171_925,
            1.167_119_772,
            -0.391_171_925,
            -1.776_056_451,
            1.551_880_414,
        ];
        let batch = batch(&[-1.5, -100.0, -22.0], [1.0, -2.0, -0.5]);
        assert_equal(&batch, LOSS, GRADIENTS);
        let gaussian = Gaussian::new(&LOG_STD, &OLD_LOG_STD);
        assert_eq!(gaussian.clipped(&batch, &[0, 1, 2], &MEANS, 0.2), 3);
    }

    #[test]
    fn a_ratio_that_is_no_number_stays_none() {
        assert!(ratio(f32::NAN).is_nan());
        assert_eq!(ratio(f32::INFINITY), 20.0_f32.exp());
        assert_eq!(ratio(f32::NEG_INFINITY), 0.0);
    }
}
