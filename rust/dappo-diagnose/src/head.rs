//! The two heads of a diagnoser: one of all classes, or the damage of every limb separately.

use burn::tensor::{Tensor, activation};
use serde::{Deserialize, Serialize};
use strum::{EnumString, IntoStaticStr, VariantNames};

use super::Subject;

/// What the outputs of the network mean.
///
/// Either head has a row of targets for every class, and a class's score is the logarithm of the
/// probability of that row. The loss is minus the score of the true class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[derive(EnumString, IntoStaticStr, VariantNames)]
#[strum(serialize_all = "lowercase")]
pub enum Head {
    /// One output a class, of which exactly one is true: softmax and cross-entropy (paper).
    Classes,
    /// One output a bit of the damage code, independently true or not: sigmoids and binary cross-entropy.
    /// Every class has a code, so this head also predicts combinations of damages that were not in the
    /// training data.
    Limbs,
}

impl Head {
    /// Outputs of the network, W.
    #[must_use]
    pub fn outputs(self, subject: &Subject) -> usize {
        match self {
            Self::Classes => subject.classes(),
            Self::Limbs => subject.code_length(),
        }
    }

    /// The targets of all classes: the identity, or the damage codes.
    ///
    /// # Shapes
    /// returns `[C, W]`
    pub(super) fn targets(self, subject: &Subject) -> Vec<f32> {
        let classes = subject.classes();
        match self {
            Self::Classes => {
                (0..classes * classes).map(|at| f32::from(u8::from(at % (classes + 1) == 0))).collect()
            }
            Self::Limbs => subject.codes.iter().flatten().map(|&bit| f32::from(bit)).collect(),
        }
    }

    /// Mean over the samples of minus the score of the true class.
    ///
    /// # Shapes
    /// outputs `[B, W]`, targets of the true classes `[B, W]`; returns `[1]`
    pub(super) fn loss(self, outputs: Tensor<2>, targets: Tensor<2>) -> Tensor<1> {
        let samples = outputs.dims()[0] as f64;
        let log_probability = match self {
            Self::Classes => targets * activation::log_softmax(outputs, 1),
            // ln σ(−z) = ln σ(z) − z, so that t ln σ(z) + (1 − t) ln σ(−z) = ln σ(z) − (1 − t) z.
            Self::Limbs => activation::log_sigmoid(outputs.clone()) - (-targets + 1.0) * outputs,
        };
        -log_probability.sum() / samples
    }

    /// The logarithm of every class's probability; those of `Limbs` do not sum to 1, as the bits can also
    /// combine to no class at all.
    ///
    /// # Shapes
    /// outputs `[N, W]`, targets of all classes `[C, W]`; returns `[N, C]`
    pub(super) fn scores(self, outputs: &[f32], targets: &[f32], subject: &Subject) -> Vec<f64> {
        let width = self.outputs(subject);
        let mut scores = Vec::with_capacity(outputs.len() / width * subject.classes());
        for row in outputs.chunks_exact(width) {
            let row: Vec<f64> = row.iter().map(|x| f64::from(*x)).collect();
            match self {
                Self::Classes => {
                    let total = ln_sum_exp(&row);
                    scores.extend(row.iter().map(|z| z - total));
                }
                Self::Limbs => {
                    let ln_true: Vec<f64> = row.iter().map(|&z| ln_sigmoid(z)).collect();
                    let ln_false: Vec<f64> = row.iter().map(|&z| ln_sigmoid(-z)).collect();
                    let score = |code: &[f32]| -> f64 {
                        let bits = code.iter().zip(ln_true.iter().zip(&ln_false));
                        bits.map(|(bit, (yes, no))| if *bit > 0.5 { yes } else { no }).sum()
                    };
                    scores.extend(targets.chunks_exact(width).map(score));
                }
            }
        }
        scores
    }
}

/// ln Σ eˣ without overflow.
fn ln_sum_exp(xs: &[f64]) -> f64 {
    let largest = xs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    largest + xs.iter().map(|x| (x - largest).exp()).sum::<f64>().ln()
}

/// ln σ(z) = −ln(1 + e⁻ᶻ) without overflow.
fn ln_sigmoid(z: f64) -> f64 {
    z.min(0.0) - (-z.abs()).exp().ln_1p()
}

/// Turns scores into probabilities that sum to 1 over the classes.
///
/// # Shapes
/// scores `[N, C]`; returns `[N, C]`
pub(super) fn probabilities(scores: &[f64], classes: usize) -> Vec<f32> {
    let mut all = Vec::with_capacity(scores.len());
    for row in scores.chunks_exact(classes) {
        let total = ln_sum_exp(row);
        all.extend(row.iter().map(|score| (score - total).exp() as f32));
    }
    all
}

/// The class of the highest score, the first of equals.
pub(super) fn best<T: PartialOrd>(scores: &[T]) -> usize {
    let mut best = 0;
    for (class, score) in scores.iter().enumerate() {
        if *score > scores[best] {
            best = class;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;
    use dappo_nn::{read, scalar};

    fn subject(codes: &[&[u8]]) -> Subject {
        Subject {
            robot: "biped".into(),
            class_names: (0..codes.len()).map(|class| format!("class {class}")).collect(),
            codes: codes.iter().map(|code| code.to_vec()).collect(),
        }
    }

    fn check(got: &[f64], expected: &[f64]) {
        assert_eq!(got.len(), expected.len());
        for (got, expected) in got.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-6, "{got}, expected {expected}");
        }
    }

    /// Loss and its gradient for samples of these classes.
    fn loss(head: Head, outputs: &[f32], classes: &[usize], subject: &Subject) -> (f64, Vec<f64>) {
        let device = Device::flex().autodiff();
        let shape = [classes.len(), head.outputs(subject)];
        let all = head.targets(subject);
        let targets: Vec<f32> =
            classes.iter().flat_map(|class| &all[class * shape[1]..][..shape[1]]).copied().collect();
        let outputs =
            Tensor::<2>::from_data(TensorData::new(outputs.to_vec(), shape), &device).require_grad();
        let targets = Tensor::from_data(TensorData::new(targets, shape), &device);
        let loss = head.loss(outputs.clone(), targets);
        let gradient = read(outputs.grad(&loss.backward()).unwrap()).unwrap();
        (scalar(loss).unwrap(), gradient.into_iter().map(f64::from).collect())
    }

    #[test]
    fn the_class_head_is_softmax_with_the_cross_entropy_of_pytorch() {
        // F.cross_entropy and F.log_softmax in float64.
        let subject = subject(&[&[0, 0], &[1, 0], &[0, 1]]);
        let outputs = [1.0, 2.0, 0.5, -1.0, 0.0, 3.0];
        let (loss, gradient) = loss(Head::Classes, &outputs, &[1, 0], &subject);
        check(&[loss], &[2.265_126_343_9]);
        check(
            &gradient,
            &[
                0.115_611_948_8,
                -0.185_734_140_4,
                0.070_122_191_6,
                -0.491_426_087_2,
                0.023_306_311_3,
                0.468_119_775_9,
            ],
        );
        let scores = Head::Classes.scores(&outputs, &Head::Classes.targets(&subject), &subject);
        check(
            &scores,
            &[
                -1.464_368_784_1,
                -0.464_368_784_1,
                -1.964_368_784_1,
                -4.065_883_903_8,
                -3.065_883_903_8,
                -0.065_883_903_8,
            ],
        );
        let sums: Vec<f64> =
            probabilities(&scores, 3).chunks(3).map(|row| row.iter().map(|p| f64::from(*p)).sum()).collect();
        check(&sums, &[1.0, 1.0]);
        assert_eq!((best(&scores[..3]), best(&scores[3..])), (1, 2));
    }

    #[test]
    fn the_limb_head_has_pytorchs_binary_cross_entropy_and_scores_every_code() {
        // F.binary_cross_entropy_with_logits(reduction="sum") / 2 and torch.softmax(scores) in float64.
        let subject = subject(&[&[0, 0], &[1, 0], &[0, 1], &[1, 1]]);
        let outputs = [2.0, -1.0, 0.5, -3.0];
        let (loss, gradient) = loss(Head::Limbs, &outputs, &[3, 0], &subject);
        check(&[loss], &[1.231_427_017_2]);
        check(&gradient, &[-0.059_601_461, -0.365_529_289_3, 0.311_229_665_6, 0.023_712_936_6]);
        let scores = Head::Limbs.scores(&outputs, &Head::Limbs.targets(&subject), &subject);
        check(
            &scores,
            &[
                -2.440_189_698_6,
                -0.440_189_698_6,
                -3.440_189_698_6,
                -1.440_189_698_6, //
                -1.022_664_335_8,
                -0.522_664_335_8,
                -4.022_664_335_8,
                -3.522_664_335_8,
            ],
        );
        let got: Vec<f64> = probabilities(&scores[..4], 4).into_iter().map(f64::from).collect();
        check(&got, &[0.087_144_318_7, 0.643_914_259_9, 0.032_058_603_3, 0.236_882_818_1]);
    }

    #[test]
    fn extreme_outputs_stay_finite() {
        let subject = subject(&[&[0, 0], &[1, 0], &[0, 1]]);
        for head in [Head::Classes, Head::Limbs] {
            let outputs = vec![500.0, -500.0, 0.0][..head.outputs(&subject)].to_vec();
            let (loss, gradient) = loss(head, &outputs, &[2], &subject);
            assert!((loss - if head == Head::Classes { 500.0 } else { 1000.0 }).abs() < 1e-3, "{loss}");
            assert!(gradient.iter().all(|x| x.is_finite()));
            let scores = head.scores(&outputs, &head.targets(&subject), &subject);
            assert!(probabilities(&scores, 3).iter().all(|p| p.is_finite()));
        }
    }
}
