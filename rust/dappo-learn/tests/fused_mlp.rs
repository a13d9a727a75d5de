//! The fused MLP operation against the same net composed of burn's own operations.

#![allow(clippy::unwrap_used, reason = "helpers of a test may fail loudly, as tests do")]

use burn::tensor::{Device, Tensor, TensorData};
use dappo_learn::nn::Mlp;
use dappo_learn::nn::kernels::{self, Level};
use dappo_sim::rng::{Purpose, Stream};

/// Largest difference, relative to the largest reference value.
const TOLERANCE: f32 = 2e-6;

fn normals(count: usize, seed: u64) -> Vec<f32> {
    let mut stream = Stream::new(seed, 0, Purpose::Weights);
    (0..count).map(|_| stream.normal() as f32).collect()
}

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

fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_into_vec().unwrap()
}

/// Output, input gradient and parameter gradients of Σ weights · net(x).
fn run(net: &Mlp, x: &Tensor<2>, weights: &Tensor<2>, fused: bool) -> Vec<(String, Vec<f32>)> {
    let x = x.clone().require_grad();
    let out = if fused { net.forward(x.clone()) } else { net.forward_composed(x.clone()) };
    let gradients = (out.clone() * weights.clone()).sum().backward();
    let mut results = vec![
        ("output".to_owned(), values(out)),
        ("input gradient".to_owned(), values(x.grad(&gradients).unwrap())),
    ];
    for (index, layer) in net.layers.iter().enumerate() {
        let weight = layer.weight.val().grad(&gradients).unwrap();
        let bias = layer.bias.as_ref().unwrap().val().grad(&gradients).unwrap();
        results.push((format!("weight gradient {index}"), values(weight)));
        results.push((format!("bias gradient {index}"), values(bias)));
    }
    results
}

#[test]
fn outputs_and_all_gradients_equal_the_composed_net_for_every_shape_and_batch_size() {
    let device = Device::flex().autodiff();
    let shapes: [&[usize]; 5] =
        [&[119, 100, 200, 100, 8], &[65, 33, 1], &[7, 3], &[4, 1, 1, 2], &[5, 16, 16, 16, 16, 3]];
    for sizes in shapes {
        let net = net(sizes, &device);
        assert_eq!(net.sizes(), sizes);
        let (inputs, outputs) = (sizes[0], sizes[sizes.len() - 1]);
        for batch in [1, 31, 255, 257, 1100] {
            let tensor = |width: usize, seed| {
                let data = TensorData::new(normals(batch * width, seed), [batch, width]);
                Tensor::<2>::from_data(data, &device)
            };
            let (x, weights) = (tensor(inputs, 2), tensor(outputs, 3));
            let fused = run(&net, &x, &weights, true);
            let composed = run(&net, &x, &weights, false);
            let largest = |xs: &[f32]| xs.iter().fold(0.0_f32, |scale, x| scale.max(x.abs()));
            // Gradients of single parameters may cancel to almost nothing over a batch.
            let gradient_scale = composed[2..].iter().map(|(_, xs)| largest(xs)).fold(0.0, f32::max);
            for (index, ((name, got), (_, expected))) in fused.iter().zip(&composed).enumerate() {
                let scale = if index < 2 { largest(expected) } else { gradient_scale };
                let error = got.iter().zip(expected).fold(0.0_f32, |e, (a, b)| e.max((a - b).abs()));
                assert!(error <= TOLERANCE * scale, "{sizes:?} batch {batch}, {name}: {error} of {scale}");
            }
        }
    }
}

#[test]
fn the_fused_operation_accepts_transposed_and_sliced_inputs() {
    let device = Device::flex();
    let net = net(&[6, 5, 2], &device);
    let data = TensorData::new(normals(6 * 40, 4), [6, 40]);
    let x = Tensor::<2>::from_data(data, &device).transpose().narrow(0, 3, 30);
    let (got, expected) = (values(net.forward(x.clone())), values(net.forward_composed(x)));
    for (got, expected) in got.iter().zip(&expected) {
        assert!((got - expected).abs() < 2e-6, "{got}, expected {expected}");
    }
}

/// Output, kept activations, input gradient and parameter gradient of a 100-200-100 net.
fn run_kernels(level: Level, rows: usize) -> [Vec<f32>; 4] {
    let sizes = [19, 100, 200, 100, 8];
    let parameters: Vec<f32> =
        normals(kernels::parameter_count(&sizes), 5).into_iter().map(|x| 0.1 * x).collect();
    let (x, out_gradient) = (normals(rows * 19, 6), normals(rows * 8, 7));
    let mut out = vec![0.0; rows * 8];
    let mut hidden = vec![0.0; rows * kernels::hidden_width(&sizes)];
    let mut dx = vec![0.0; rows * 19];
    kernels::forward(level, &sizes, &parameters, &x, &mut out, Some(&mut hidden));
    let gradient = kernels::backward(level, &sizes, &parameters, &x, &hidden, &out_gradient, Some(&mut dx));
    [out, hidden, dx, gradient]
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
