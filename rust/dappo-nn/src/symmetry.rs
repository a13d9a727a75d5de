//! Nets that are their own mirror images: the reflection of the input gives the reflection of the output.
//!
//! The units of a hidden layer are pairs that take each other's place under the reflection. A layer has the symmetry if
//! each weight equals that between the mirror images of its ends, with the sign of both; tanh is odd and keeps it. Such
//! weights stay so with gradients of which the same holds, whatever moves them component by component, as Adam does.
//! The average of a gradient and its mirror image is one, and it is the gradient for the transitions and their mirror
//! images together. See Abdolhosseini et al. (2019), "On learning symmetric locomotion".

use burn::optim::GradientsParams;
use burn::tensor::Tensor;
use dappo_sim::task::{Image, Reflection};

use crate::error::Result;
use crate::{GaussianPolicy, Lstm, Mlp, read};

/// The symmetry of an [`Mlp`].
#[derive(Debug, Clone)]
pub struct MlpSymmetry {
    /// Reflections of the input, of the units of each hidden layer, and of the output.
    levels: Vec<Reflection>,
}

/// The symmetry of an [`Lstm`], each of whose units has a mirror image.
#[derive(Debug, Clone)]
pub struct LstmSymmetry {
    input: Reflection,
    hidden: Reflection,
    gates: Reflection,
}

/// The symmetry of a [`GaussianPolicy`], whose standard deviations are those of the mirror images, too.
#[derive(Debug, Clone)]
pub struct PolicySymmetry {
    memory: Option<LstmSymmetry>,
    mean: MlpSymmetry,
    action: Reflection,
}

impl MlpSymmetry {
    /// The symmetry of a net with hidden layers of these widths. The last unit of an odd number is its own mirror image.
    #[must_use]
    pub fn new(input: Reflection, hidden: &[usize], output: Reflection) -> Self {
        let inner = hidden.iter().map(|width| pairs(*width));
        Self { levels: [input].into_iter().chain(inner).chain([output]).collect() }
    }

    /// `[inputs, hidden…, outputs]` of the nets that it is for.
    #[must_use]
    pub fn sizes(&self) -> Vec<usize> {
        self.levels.iter().map(Reflection::len).collect()
    }

    /// The reflections of the input, of the units of each hidden layer, and of the output.
    #[must_use]
    pub fn levels(&self) -> &[Reflection] {
        &self.levels
    }

    /// Gives the second weight of each pair of mirror images the value of the first one.
    ///
    /// # Shapes
    /// parameters as [`Mlp::parameters`] lays them out
    pub fn impose(&self, parameters: &mut [f32]) {
        self.each_pair(parameters, |first, _, sign| [first, sign * first]);
    }

    /// Replaces gradients by the averages with their mirror images.
    pub fn average(&self, net: &Mlp, gradients: &mut GradientsParams) -> Result<()> {
        let mut gradient = net.take_gradient(gradients)?;
        self.average_flat(&mut gradient);
        net.register_gradient(&gradient, gradients);
        Ok(())
    }

    /// Replaces both weights of each pair of mirror images by their average.
    ///
    /// # Shapes
    /// gradient laid out as [`Mlp::parameters`]
    fn average_flat(&self, gradient: &mut [f32]) {
        self.each_pair(gradient, mean_of_pair);
    }

    /// Replaces weights and their mirror images by what `of` makes of both and the sign between them. It must not change
    /// what it has made, except that a weight which is its own mirror image with the sign −1 becomes 0.
    fn each_pair(&self, parameters: &mut [f32], of: impl Fn(f32, f32, f32) -> [f32; 2]) {
        let mut rest = parameters;
        for pair in self.levels.windows(2) {
            let (inputs, outputs) = (pair[0].entries(), pair[1].entries());
            let (weight, after) = std::mem::take(&mut rest).split_at_mut(inputs.len() * outputs.len());
            let (bias, after) = after.split_at_mut(outputs.len());
            rest = after;
            each_pair_of_layer(weight, inputs, outputs, &of);
            each_pair_of_layer(bias, &[Image { of: 0, sign: 1.0 }], outputs, &of);
        }
    }
}

/// The reflection of the units of a layer. The last unit of an odd number is its own mirror image.
fn pairs(width: usize) -> Reflection {
    let (half, even) = (width / 2, width / 2 * 2);
    let image = |unit| if unit < even { (unit + half) % even } else { unit };
    Reflection::new((0..width).map(|unit| Image { of: image(unit), sign: 1.0 }).collect())
}

impl LstmSymmetry {
    /// The symmetry of an LSTM of so many units. The last unit of an odd number is its own mirror image.
    #[must_use]
    pub fn new(input: Reflection, units: usize) -> Self {
        let hidden = pairs(units);
        let of_gate = |gate: usize| {
            let images = hidden.entries().iter();
            images.map(move |image| Image { of: gate * units + image.of, sign: image.sign })
        };
        let gates = Reflection::new((0..4).flat_map(of_gate).collect());
        Self { input, hidden, gates }
    }

    /// The reflection of the hidden state.
    #[must_use]
    pub fn hidden(&self) -> &Reflection {
        &self.hidden
    }

    /// Gives the second weight of each pair of mirror images the value of the first one.
    ///
    /// # Shapes
    /// parameters as [`Lstm::parameters`] lays them out
    pub fn impose(&self, parameters: &mut [f32]) {
        self.each_pair(parameters, &|first, _, sign| [first, sign * first]);
    }

    /// Replaces gradients by the averages with their mirror images.
    fn average(&self, lstm: &Lstm, gradients: &mut GradientsParams) -> Result<()> {
        lstm.change_gradient(gradients, |gradient| self.average_flat(gradient))
    }

    /// Replaces both weights of each pair of mirror images by their average.
    ///
    /// # Shapes
    /// gradient laid out as [`Lstm::parameters`]
    pub fn average_flat(&self, gradient: &mut [f32]) {
        self.each_pair(gradient, &mean_of_pair);
    }

    fn each_pair(&self, parameters: &mut [f32], of: &impl Fn(f32, f32, f32) -> [f32; 2]) {
        let (input, gates) = (self.input.entries(), self.gates.entries());
        let (weight, rest) = parameters.split_at_mut(input.len() * gates.len());
        let (bias, recurrent) = rest.split_at_mut(gates.len());
        each_pair_of_layer(weight, input, gates, of);
        each_pair_of_layer(bias, &[Image { of: 0, sign: 1.0 }], gates, of);
        each_pair_of_layer(recurrent, self.hidden.entries(), gates, of);
    }
}

/// Both weights of a pair as their average.
fn mean_of_pair(first: f32, second: f32, sign: f32) -> [f32; 2] {
    let mean = 0.5 * (first + sign * second);
    [mean, sign * mean]
}

/// The same for a matrix `[inputs, outputs]`.
fn each_pair_of_layer(
    weight: &mut [f32],
    inputs: &[Image],
    outputs: &[Image],
    of: &impl Fn(f32, f32, f32) -> [f32; 2],
) {
    let width = outputs.len();
    for (input, row) in inputs.iter().enumerate().filter(|(input, row)| *input <= row.of) {
        let (before, image_row) = weight.split_at_mut(row.of * width);
        if input < row.of {
            let row_here = &mut before[input * width..][..width];
            for (here, column) in row_here.iter_mut().zip(outputs) {
                let image = &mut image_row[column.of];
                [*here, *image] = of(*here, *image, row.sign * column.sign);
            }
            continue;
        }
        for (output, column) in outputs.iter().enumerate() {
            let (here, sign) = (image_row[output], row.sign * column.sign);
            if output < column.of {
                [image_row[output], image_row[column.of]] = of(here, image_row[column.of], sign);
            } else if output == column.of && sign < 0.0 {
                image_row[output] = 0.0;
            }
        }
    }
}

impl PolicySymmetry {
    /// The symmetry of a policy with hidden layers of these widths and a memory of so many units, or 0.
    #[must_use]
    pub fn new(input: Reflection, memory: usize, hidden: &[usize], action: Reflection) -> Self {
        let memory = (memory > 0).then(|| LstmSymmetry::new(input.clone(), memory));
        let input = match &memory {
            None => input,
            Some(memory) => input.followed_by(memory.hidden()),
        };
        Self { memory, mean: MlpSymmetry::new(input, hidden, action.clone()), action }
    }

    /// That of the memory, if there is one.
    #[must_use]
    pub fn memory(&self) -> Option<&LstmSymmetry> {
        self.memory.as_ref()
    }

    /// That of the net for the mean.
    #[must_use]
    pub fn mean(&self) -> &MlpSymmetry {
        &self.mean
    }

    /// Replaces gradients by the averages with their mirror images.
    pub fn average(&self, policy: &GaussianPolicy, gradients: &mut GradientsParams) -> Result<()> {
        self.mean.average(&policy.mean, gradients)?;
        if let (Some(symmetry), Some(memory)) = (&self.memory, &policy.memory) {
            symmetry.average(memory, gradients)?;
        }
        if let Some(gradient) = gradients.remove::<1>(policy.log_std.id) {
            let device = gradient.device();
            let mean = self.average_log_std(&read(gradient)?);
            gradients.register(policy.log_std.id, Tensor::<1>::from_data(mean.as_slice(), &device));
        }
        Ok(())
    }

    /// The average of a gradient of the standard deviations and its mirror image.
    ///
    /// # Shapes
    /// gradient `[A]`; returns `[A]`
    #[must_use]
    pub fn average_log_std(&self, gradient: &[f32]) -> Vec<f32> {
        let images = self.action.entries().iter().map(|image| gradient[image.of]);
        gradient.iter().zip(images).map(|(x, image)| 0.5 * (x + image)).collect()
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use dappo_sim::rng::{Purpose, Stream};

    use super::*;
    use crate::FrozenMlp;
    use crate::kernels::{Level, MlpPass, parameter_count};

    /// Entries 0 and 1 take each other's place, 2 changes its sign, 3 and 4 stay.
    fn input() -> Reflection {
        let images = [(1, 1.0), (0, 1.0), (2, -1.0), (3, 1.0), (4, 1.0)];
        Reflection::new(images.map(|(of, sign)| Image { of, sign }).to_vec())
    }

    fn output() -> Reflection {
        Reflection::new([(1, -1.0), (0, -1.0), (2, -1.0)].map(|(of, sign)| Image { of, sign }).to_vec())
    }

    fn reflected(reflection: &Reflection, rows: &[f32]) -> Vec<f32> {
        let mut images = vec![0.0; rows.len()];
        for (image, row) in images.chunks_exact_mut(reflection.len()).zip(rows.chunks_exact(reflection.len()))
        {
            reflection.apply(row, image);
        }
        images
    }

    fn normals(count: usize, seed: u64) -> Vec<f32> {
        let mut stream = Stream::new(seed, 0, Purpose::Weights);
        (0..count).map(|_| stream.normal() as f32).collect()
    }

    #[test]
    fn the_reflection_of_the_input_gives_the_reflection_of_the_output_for_even_and_odd_layers() {
        for hidden in [&[6, 8][..], &[7], &[1, 5], &[]] {
            let symmetry = MlpSymmetry::new(input(), hidden, output());
            let sizes = symmetry.sizes();
            let count = parameter_count(&sizes).unwrap();
            let mut parameters = normals(count, 3);
            symmetry.impose(&mut parameters);
            let imposed = parameters.clone();
            symmetry.impose(&mut parameters);
            assert_eq!(parameters, imposed);
            symmetry.average_flat(&mut parameters);
            assert_eq!(parameters, imposed, "a symmetric net is its own average");
            assert!(parameters.iter().filter(|x| **x != 0.0).count() > count / 2);
            let net = FrozenMlp::new(sizes, parameters).unwrap();
            let rows = normals(40, 4);
            let got = net.apply(&reflected(&input(), &rows)).unwrap();
            let expected = reflected(&output(), &net.apply(&rows).unwrap());
            for (got, expected) in got.iter().zip(&expected) {
                assert!((got - expected).abs() < 1e-5, "{hidden:?}: {got}, expected {expected}");
            }
        }
    }

    #[test]
    fn passes_of_half_the_operations_give_the_outputs_and_the_average_gradient_at_every_level() {
        let one = Reflection::identity(1);
        for (hidden, output) in
            [(&[6, 8][..], output()), (&[7, 5], output()), (&[1, 40], one), (&[], output())]
        {
            let symmetry = MlpSymmetry::new(input(), hidden, output);
            let sizes = symmetry.sizes();
            let mut parameters = normals(parameter_count(&sizes).unwrap(), 3);
            symmetry.impose(&mut parameters);
            let outputs = sizes[sizes.len() - 1];
            for count in [1, 37, 300, 700] {
                let (rows, targets) = (normals(5 * count, 4), normals(outputs * count, 5));
                let order: Vec<i32> = (0..count as i32).rev().collect();
                let run = |mut pass: MlpPass| {
                    let (out, gradient) =
                        pass.gradient(&parameters, rows.as_slice(), &order, |rows, out, gradient| {
                            for (row, gradient) in rows.iter().zip(gradient.chunks_exact_mut(outputs)) {
                                gradient.copy_from_slice(&targets[*row as usize * outputs..][..outputs]);
                            }
                            out.to_vec()
                        });
                    (out.concat(), gradient.to_vec())
                };
                for level in Level::available() {
                    let (expected_out, mut expected) = run(MlpPass::new(level, sizes.clone()));
                    symmetry.average_flat(&mut expected);
                    let (out, mut gradient) = run(MlpPass::mirrored(level, symmetry.levels()));
                    for (got, expected) in [(&out, &expected_out), (&gradient, &expected)] {
                        assert_eq!(got.len(), expected.len());
                        let scale = expected.iter().fold(0.0_f32, |scale, x| scale.max(x.abs()));
                        for (got, expected) in got.iter().zip(expected) {
                            let error = (got - expected).abs();
                            assert!(error < 2e-6 * scale, "{level:?} {sizes:?} {count}: {got}, {expected}");
                        }
                    }
                    let exact = gradient.clone();
                    symmetry.average_flat(&mut gradient);
                    assert_eq!(gradient, exact, "the gradient is its own average to the last bit");
                }
            }
        }
    }

    /// With the loss Σ |net(x) − y|², the average gradient is half of that for both x, y and their mirror images.
    #[test]
    fn the_average_gradient_is_that_for_rows_and_mirror_images_together() {
        let symmetry = MlpSymmetry::new(input(), &[6], output());
        let mut stream = Stream::new(8, 0, Purpose::Weights);
        let device = Device::flex().autodiff();
        let net = Mlp::new(&symmetry.sizes(), 1.0, &mut || stream.normal(), &device);
        let mut parameters = net.parameters().unwrap();
        symmetry.impose(&mut parameters);
        let net = net.with_parameters(&parameters);
        let (rows, targets) = (normals(35, 5), normals(21, 6));
        let gradient = |rows: Vec<f32>, targets: Vec<f32>| {
            let count = rows.len() / 5;
            let tensor =
                |values, width| Tensor::<2>::from_data(TensorData::new(values, [count, width]), &device);
            let loss = (net.forward(tensor(rows, 5)) - tensor(targets, 3)).square().sum();
            GradientsParams::from_grads(loss.backward(), &net)
        };
        let images = (reflected(&input(), &rows), reflected(&output(), &targets));
        let mut alone = gradient(rows.clone(), targets.clone());
        let mut both = gradient([rows, images.0].concat(), [targets, images.1].concat());
        symmetry.average(&net, &mut alone).unwrap();
        let (got, expected) = (net.take_gradient(&mut alone).unwrap(), net.take_gradient(&mut both).unwrap());
        assert_eq!(got.len(), parameters.len());
        for (got, expected) in got.iter().zip(expected) {
            assert!((got - expected / 2.0).abs() < 1e-4, "{got}, expected {}", expected / 2.0);
        }
    }
}
