//! The kernels of the MLP against the same net composed of burn's own operations.

use burn::tensor::{Device, Tensor, TensorData};
use dappo_nn::{
    Mlp,
    kernels::{self, Level, MlpPass},
};
use dappo_sim::rng::{Purpose, Stream};

use crate::{TOLERANCE, normals, values};

fn net(sizes: &[usize], device: &Device) -> Mlp {
    let mut stream = Stream::new(1, 0, Purpose::Weights);
    let mut net = Mlp::new(sizes, 1.0, &mut || stream.normal(), device);
    // Biases start at 0, which would hide errors in them.
    for (index, layer) in net.layers.iter_mut().enumerate() {
        layer.bias = layer.bias.take().map(|bias| {
            bias.map(|bias| {
                let values = normals(bias.dims()[0], 100 + index as u64);
                let tensor = Tensor::from_data(TensorData::from(values.as_slice()), &bias.device());
                if bias.device().is_autodiff() { tensor.require_grad() } else { tensor }
            })
        });
    }
    net
}

/// Output and parameter gradients of Σ weights · net(x), layer after layer, by autodiff.
fn composed(net: &Mlp, x: Tensor<2>, weights: Tensor<2>) -> [Vec<f32>; 2] {
    let out = net.forward(x);
    let gradients = (out.clone() * weights).sum().backward();
    let mut flat = Vec::new();
    for layer in &net.layers {
        flat.extend(values(layer.weight.val().grad(&gradients).unwrap()));
        flat.extend(values(layer.bias.as_ref().unwrap().val().grad(&gradients).unwrap()));
    }
    [values(out), flat]
}

/// The same by the kernels.
fn fused(pass: &mut MlpPass, net: &Mlp, x: &[f32], weights: &[f32]) -> [Vec<f32>; 2] {
    let parameters = net.parameters().unwrap();
    let order: Vec<i32> = (0..(x.len() / net.sizes()[0]) as i32).collect();
    let outputs = net.sizes()[net.sizes().len() - 1];
    let (out, gradient) = pass.gradient(&parameters, x, &order, |rows, out, gradient| {
        let first = rows[0] as usize * outputs;
        gradient.copy_from_slice(&weights[first..first + gradient.len()]);
        out.to_vec()
    });
    [out.concat(), gradient.to_vec()]
}

fn assert_equal(name: &str, got: &[f32], expected: &[f32]) {
    let scale = expected.iter().fold(0.0_f32, |scale, x| scale.max(x.abs()));
    let error = got.iter().zip(expected).fold(0.0_f32, |e, (a, b)| e.max((a - b).abs()));
    assert_eq!(got.len(), expected.len(), "{name}");
    assert!(error <= TOLERANCE * scale, "{name}: {error} of {scale}");
}

#[test]
fn outputs_and_gradients_equal_the_composed_net_for_every_shape_and_batch_size() {
    let device = Device::flex().autodiff();
    let shapes: [&[usize]; 5] =
        [&[119, 100, 200, 100, 8], &[65, 33, 1], &[7, 3], &[4, 1, 1, 2], &[5, 16, 16, 16, 16, 3]];
    for sizes in shapes {
        let net = net(sizes, &device);
        assert_eq!(net.sizes(), sizes);
        let (inputs, outputs) = (sizes[0], sizes[sizes.len() - 1]);
        // One pass for all sizes: what a larger minibatch left behind must not show in a smaller one.
        let mut pass = MlpPass::new(Level::best(), sizes.to_vec());
        for batch in [1100, 257, 255, 31, 1] {
            let (x, weights) = (normals(batch * inputs, 2), normals(batch * outputs, 3));
            let tensor = |values: &[f32], width: usize| {
                Tensor::<2>::from_data(TensorData::new(values.to_vec(), [batch, width]), &device)
            };
            let expected = composed(&net, tensor(&x, inputs), tensor(&weights, outputs));
            let got = fused(&mut pass, &net, &x, &weights);
            let name = format!("{sizes:?} batch {batch}");
            assert_equal(&format!("{name}, output"), &got[0], &expected[0]);
            assert_equal(&format!("{name}, gradient"), &got[1], &expected[1]);
            assert_equal(&format!("{name}, acting"), &net.frozen().unwrap().apply(&x).unwrap(), &expected[0]);
        }
    }
}

#[test]
fn a_minibatch_is_the_rows_that_it_names_in_their_order() {
    let net = net(&[6, 5, 2], &Device::flex());
    let x = normals(6 * 40, 4);
    let order = [39, 0, 7, 7];
    let picked: Vec<f32> = order.iter().flat_map(|row| &x[row * 6..row * 6 + 6]).copied().collect();
    let pass = MlpPass::new(Level::best(), net.sizes());
    let order = order.map(|row| row as i32);
    let got = pass.evaluate(&net.parameters().unwrap(), x.as_slice(), &order, |_, out| out.to_vec()).concat();
    assert_equal("picked rows", &got, &net.frozen().unwrap().apply(&picked).unwrap());
}

#[test]
fn rows_of_another_width_are_rejected() {
    let message =
        net(&[6, 5, 2], &Device::flex()).frozen().unwrap().apply(&[0.0; 7]).unwrap_err().to_string();
    assert!(message.contains("7 elements, expected 6"), "{message}");
}

/// Output and parameter gradient of a 100-200-100 net.
fn run_kernels(level: Level, rows: usize) -> [Vec<f32>; 2] {
    let sizes = [19, 100, 200, 100, 8];
    let parameters: Vec<f32> =
        normals(kernels::parameter_count(&sizes).unwrap(), 5).into_iter().map(|x| 0.1 * x).collect();
    let (x, out_gradient) = (normals(rows * 19, 6), normals(rows * 8, 7));
    let mut pass = MlpPass::new(level, sizes.to_vec());
    let order: Vec<i32> = (0..rows as i32).collect();
    let (out, gradient) = pass.gradient(&parameters, x.as_slice(), &order, |rows, out, gradient| {
        let first = rows[0] as usize * 8;
        gradient.copy_from_slice(&out_gradient[first..first + gradient.len()]);
        out.to_vec()
    });
    [out.concat(), gradient.to_vec()]
}

#[test]
fn one_two_and_five_threads_give_the_same_bits() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run_kernels(Level::best(), 5000))
    };
    let expected = run(1);
    assert!(run(2) == expected, "2 threads differ from 1");
    assert!(run(5) == expected, "5 threads differ from 1");
}

#[test]
fn every_instruction_set_of_this_machine_gives_the_same_numbers() {
    let expected = run_kernels(Level::available()[0], 700);
    for level in Level::available() {
        for (got, expected) in run_kernels(level, 700).iter().zip(&expected) {
            let scale = expected.iter().fold(0.0_f32, |scale, x| scale.max(x.abs()));
            let error = got.iter().zip(expected).fold(0.0_f32, |e, (a, b)| e.max((a - b).abs()));
            assert!(error <= 1e-6 * scale, "{level:?}: {error} of {scale}");
        }
    }
}
