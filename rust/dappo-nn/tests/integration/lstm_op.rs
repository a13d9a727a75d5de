//! The fused LSTM operation against the same layers composed of burn's own operations, and against PyTorch.

use burn::module::Param;
use burn::tensor::{Device, Tensor, TensorData};
use dappo_nn::{
    EmbeddedLstm,
    kernels::{
        Level,
        lstm::{self, LstmSizes},
    },
};
use dappo_sim::rng::{Purpose, Stream};

use crate::{TOLERANCE, normals, values};

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn sizes(inputs: usize, embedding: usize, hidden: usize) -> LstmSizes {
    LstmSizes { inputs, embedding, hidden }
}

fn net(sizes: LstmSizes, device: &Device) -> EmbeddedLstm {
    let mut stream = Stream::new(1, 0, Purpose::Weights);
    let mut net = EmbeddedLstm::new(sizes, &mut || stream.normal(), device);
    // Most biases start at 0, which would hide errors in them.
    net.embedding.bias =
        Some(Param::from_tensor(tensor(normals(sizes.embedding, 8), [sizes.embedding], device)));
    let gates = 4 * sizes.hidden;
    net.input.bias = Some(Param::from_tensor(tensor(normals(gates, 9), [gates], device)));
    net
}

/// Output and all parameter gradients of Σ weights · net(x).
fn run(net: &EmbeddedLstm, x: &Tensor<3>, weights: &Tensor<2>, fused: bool) -> Vec<(&'static str, Vec<f32>)> {
    let out = if fused { net.forward(x.clone()) } else { net.forward_composed(x.clone()) };
    let gradients = (out.clone() * weights.clone()).sum().backward();
    let bias =
        |bias: &Option<Param<Tensor<1>>>| values(bias.as_ref().unwrap().val().grad(&gradients).unwrap());
    vec![
        ("output", values(out)),
        ("embedding weight", values(net.embedding.weight.val().grad(&gradients).unwrap())),
        ("embedding bias", bias(&net.embedding.bias)),
        ("input weight", values(net.input.weight.val().grad(&gradients).unwrap())),
        ("bias", bias(&net.input.bias)),
        ("recurrent weight", values(net.recurrent.val().grad(&gradients).unwrap())),
    ]
}

fn largest(values: &[f32]) -> f32 {
    values.iter().fold(0.0, |scale, x| scale.max(x.abs()))
}

fn largest_error(got: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(got.len(), expected.len());
    got.iter().zip(expected).fold(0.0, |error, (a, b)| error.max((a - b).abs()))
}

#[test]
fn outputs_and_all_gradients_equal_the_composed_layers_for_every_shape_and_batch_size() {
    let device = Device::flex().autodiff();
    for (sizes, steps) in [
        (sizes(111, 512, 32), 50),
        (sizes(53, 40, 7), 10),
        (sizes(3, 2, 1), 1),
        (sizes(1, 5, 16), 2),
        (sizes(230, 64, 33), 5),
    ] {
        let net = net(sizes, &device);
        assert_eq!(net.sizes(), sizes);
        for batch in [1, 7, 9, 64, 130] {
            let x = tensor(normals(batch * steps * sizes.inputs, 2), [batch, steps, sizes.inputs], &device);
            let weights = tensor(normals(batch * sizes.hidden, 3), [batch, sizes.hidden], &device);
            let (fused, composed) = (run(&net, &x, &weights, true), run(&net, &x, &weights, false));
            // Gradients of single parameters may cancel to almost nothing over windows and steps.
            let gradient_scale = composed[1..].iter().map(|(_, xs)| largest(xs)).fold(0.0, f32::max);
            for (index, ((name, got), (_, expected))) in fused.iter().zip(&composed).enumerate() {
                let scale = if index == 0 { largest(expected) } else { gradient_scale };
                let error = largest_error(got, expected);
                assert!(error <= TOLERANCE * scale, "{sizes:?}, {batch} windows, {name}: {error} of {scale}");
            }
        }
    }
}

/// sin(a i + b) for i = 0, 1, 2 …
fn sines(count: usize, a: f64, b: f64, scale: f64) -> Vec<f32> {
    (0..count).map(|i| (scale * (a * i as f64 + b).sin()) as f32).collect()
}

#[test]
fn outputs_and_gradients_equal_pytorch() {
    // torch.nn.Linear(3, 4) and torch.nn.LSTM(4, 2) in float64, with the weights below, transposed as PyTorch
    // has them, and bias_hh_l0 = 0; (y[:, -1] * w).sum().backward().
    let device = Device::flex().autodiff();
    let mut net = net(sizes(3, 4, 2), &device);
    net.embedding.weight = Param::from_tensor(tensor(sines(12, 1.3, 0.1, 1.0), [3, 4], &device));
    net.embedding.bias = Some(Param::from_tensor(tensor(sines(4, 0.7, 0.2, 0.5), [4], &device)));
    net.input.weight = Param::from_tensor(tensor(sines(32, 0.9, 0.3, 1.0), [4, 8], &device));
    net.input.bias = Some(Param::from_tensor(tensor(sines(8, 1.1, 0.4, 0.5), [8], &device)));
    net.recurrent = Param::from_tensor(tensor(sines(16, 1.7, 0.5, 1.0), [2, 8], &device));
    let x = tensor(sines(18, 0.37, 0.0, 1.0), [2, 3, 3], &device);
    let weights = tensor(sines(4, 2.0, 1.0, 1.0), [2, 2], &device);
    let expected: [&[f32]; 6] = [
        &[-0.766_408_2, -0.161_992_5, -0.354_779_8, -0.204_969_4],
        &[
            -0.183_536_1,
            -0.411_831_9,
            -0.317_540_9,
            0.025_479_1,
            -0.143_826_9,
            -0.345_712_4,
            -0.276_802_2,
            0.008_926_4,
            -0.084_651_5,
            -0.232_802_2,
            -0.198_599_6,
            -0.008_834_5,
        ],
        &[-0.034_580_6, 0.288_927, 0.386_118_9, 0.180_864_8],
        &[
            0.173_228_4,
            -0.027_381_9,
            0.062_385_9,
            -0.055_451_3,
            -0.179_432_5,
            0.011_333_0,
            0.078_482_4,
            0.102_120_1,
        ],
        &[
            0.117_765_6,
            0.012_505_9,
            0.061_164_9,
            -0.107_803_4,
            -0.150_698,
            0.181_722_8,
            0.078_811_6,
            0.006_925_8,
        ],
        &[
            0.001_825_9,
            0.002_865_4,
            0.015_333_9,
            0.011_973_9,
            0.015_727_6,
            -0.065_104_4,
            0.009_764_8,
            -0.003_407_0,
            -0.040_775_5,
            -0.004_384_7,
            -0.046_804_3,
            0.037_118_3,
            0.070_009_7,
            -0.004_380_1,
            -0.049_235_3,
            -0.023_974_4,
        ],
    ];
    for fused in [true, false] {
        for ((name, got), expected) in run(&net, &x, &weights, fused).iter().zip(expected) {
            // Of the input weight's gradient, the first row.
            let error = largest_error(&got[..expected.len()], expected);
            assert!(error <= 1e-6, "fused {fused}, {name}: {error}, {got:?}");
        }
    }
}

#[test]
fn the_fused_operation_accepts_sliced_inputs_and_works_without_autodiff() {
    let device = Device::flex();
    let net = net(sizes(4, 6, 3), &device);
    let x = tensor(normals(20 * 5 * 6, 4), [20, 5, 6], &device).narrow(0, 3, 11).narrow(2, 1, 4);
    let (got, expected) = (values(net.forward(x.clone())), values(net.forward_composed(x)));
    assert!(largest_error(&got, &expected) < 2e-6);
}

/// Output and parameter gradient of the kernels.
fn run_kernels(level: Level, windows: usize) -> [Vec<f32>; 2] {
    let (sizes, steps) = (sizes(19, 24, 12), 6);
    let parameters: Vec<f32> =
        normals(sizes.parameter_count().unwrap(), 5).into_iter().map(|x| 0.3 * x).collect();
    let (x, out_gradient) = (normals(windows * steps * 19, 6), normals(windows * 12, 7));
    let mut out = vec![0.0; windows * 12];
    let kept = lstm::forward(level, sizes, steps, &parameters, &x, &mut out, true).unwrap();
    let mut again = vec![0.0; windows * 12];
    assert!(lstm::forward(level, sizes, steps, &parameters, &x, &mut again, false).is_none());
    assert_eq!(again, out);
    [out, lstm::backward(level, sizes, steps, &parameters, &x, &kept, &out_gradient)]
}

#[test]
fn one_two_and_five_threads_give_the_same_bits() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run_kernels(Level::best(), 333))
    };
    let expected = run(1);
    assert!(run(2) == expected, "2 threads differ from 1");
    assert!(run(5) == expected, "5 threads differ from 1");
}

#[test]
fn every_instruction_set_of_this_machine_gives_the_same_numbers() {
    let expected = run_kernels(Level::available()[0], 70);
    for level in Level::available() {
        for (got, expected) in run_kernels(level, 70).iter().zip(&expected) {
            let (scale, error) = (largest(expected), largest_error(got, expected));
            assert!(error <= 2e-6 * scale, "{level:?}: {error} of {scale}");
        }
    }
}
