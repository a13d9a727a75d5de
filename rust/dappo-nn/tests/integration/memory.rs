//! The LSTM of a recurrent policy: kernels against burn's own operations, steps against sequences, and its symmetry.

use burn::module::Param;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor, TensorData};
use dappo_nn::kernels::Level;
use dappo_nn::kernels::lstm_sequence::{self, Sequences, parameter_count};
use dappo_nn::{
    ActorCritic, ActorCriticSizes, FrozenLstm, Lstm, LstmSymmetry, Normalizer, Policy, PolicyState,
};
use dappo_sim::rng::{Purpose, Stream};
use dappo_sim::task::{Image, Reflection};

use crate::{TOLERANCE, normals, values};

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn lstm(inputs: usize, units: usize, device: &Device) -> Lstm {
    let mut stream = Stream::new(1, 0, Purpose::Weights);
    let mut lstm = Lstm::new(inputs, units, &mut || stream.normal(), device);
    // Most biases start at 0, which would hide errors in them.
    lstm.input.bias = Some(Param::from_tensor(tensor(normals(4 * units, 9), [4 * units], device)));
    lstm
}

/// 1 in every fifth step, at different steps of each sequence.
fn begins(rows: usize, steps: usize) -> Vec<f32> {
    let begins = |(row, step): (usize, usize)| if (3 * row + step).is_multiple_of(5) { 1.0 } else { 0.0 };
    (0..rows).flat_map(|row| (0..steps).map(move |step| (row, step))).map(begins).collect()
}

#[test]
fn hidden_states_and_all_gradients_equal_burns_with_states_and_beginnings_at_every_level() {
    let device = Device::flex();
    for (inputs, units, steps) in [(111, 32, 32), (5, 7, 11), (1, 1, 1), (3, 16, 2)] {
        let lstm = lstm(inputs, units, &device.clone().autodiff());
        let parameters = lstm.parameters().unwrap();
        for rows in [1, 8, 70] {
            let (x, state) = (normals(rows * steps * inputs, 2), normals(rows * 2 * units, 3));
            let (begins, weights) = (begins(rows, steps), normals(rows * steps * units, 4));
            let hidden = lstm.forward(
                tensor(x.clone(), [rows, steps, inputs], &device),
                &tensor(state.clone(), [rows, 2, units], &device),
                &tensor(begins.clone(), [rows, steps], &device),
            );
            let sum = (hidden.clone() * tensor(weights.clone(), [rows, steps, units], &device)).sum();
            let mut gradients = GradientsParams::from_grads(sum.backward(), &lstm);
            let mut expected_gradient = Vec::new();
            expected_gradient.extend(values(gradients.remove::<2>(lstm.input.weight.id).unwrap()));
            let bias = lstm.input.bias.as_ref().unwrap();
            expected_gradient.extend(values(gradients.remove::<1>(bias.id).unwrap()));
            expected_gradient.extend(values(gradients.remove::<2>(lstm.recurrent.id).unwrap()));
            let expected_hidden = values(hidden);
            for level in Level::available() {
                let sequences = Sequences { steps, x: &x, state: &state, begins: &begins };
                let mut hidden = vec![0.0; weights.len()];
                let kept = lstm_sequence::forward(level, units, &parameters, sequences, &mut hidden);
                let gradient = lstm_sequence::backward(level, units, &parameters, sequences, &kept, &weights);
                for (got, expected) in [(&hidden, &expected_hidden), (&gradient, &expected_gradient)] {
                    let scale = expected.iter().fold(1.0_f32, |scale, x| scale.max(x.abs()));
                    assert_eq!(got.len(), expected.len());
                    for (got, expected) in got.iter().zip(expected) {
                        let error = (got - expected).abs();
                        assert!(
                            error <= TOLERANCE * scale,
                            "{level:?}: {got}, expected {expected} of {scale}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn steps_go_through_the_hidden_states_of_the_sequence() {
    let (device, rows, steps, inputs, units) = (Device::flex(), 70, 6, 4, 9);
    let lstm = lstm(inputs, units, &device);
    let (x, begins) = (normals(rows * steps * inputs, 2), begins(rows, steps));
    let expected = values(lstm.forward(
        tensor(x.clone(), [rows, steps, inputs], &device),
        &Tensor::zeros([rows, 2, units], &device),
        &tensor(begins.clone(), [rows, steps], &device),
    ));
    let frozen = lstm.frozen().unwrap();
    assert_eq!((frozen.inputs(), frozen.units()), (inputs, units));
    let mut state = PolicyState::new(rows, units);
    for step in 0..steps {
        for row in (0..rows).filter(|row| begins[row * steps + step] == 1.0) {
            state.begin(row);
        }
        let now: Vec<f32> =
            x.chunks_exact(steps * inputs).flat_map(|x| &x[step * inputs..][..inputs]).copied().collect();
        frozen.step(&now, &mut state).unwrap();
        for (row, hidden) in state.hidden().chunks_exact(units).enumerate() {
            let expected = &expected[(row * steps + step) * units..][..units];
            for (got, expected) in hidden.iter().zip(expected) {
                assert!((got - expected).abs() < TOLERANCE, "{got}, expected {expected}");
            }
        }
    }
    assert!(frozen.step(&normals(inputs, 1), &mut state).is_err());
    assert!(FrozenLstm::new(units, vec![0.0; 4 * units * (units + 1)]).is_err());
    assert!(FrozenLstm::new(units, vec![0.0; parameter_count(inputs, units).unwrap() + 1]).is_err());
}

#[test]
fn an_lstm_with_the_symmetry_remembers_the_mirror_image_of_mirror_images() {
    // Entries 0 and 1 take each other's place, 2 changes its sign.
    let images = [(1, 1.0), (0, 1.0), (2, -1.0)];
    let input = Reflection::new(images.map(|(of, sign)| Image { of, sign }).to_vec());
    for units in [6, 7] {
        let lstm = lstm(3, units, &Device::flex());
        let symmetry = LstmSymmetry::new(input.clone(), units);
        let mut parameters = lstm.parameters().unwrap();
        symmetry.impose(&mut parameters);
        let frozen = lstm.with_parameters(&parameters).frozen().unwrap();
        let [mut state, mut mirrored] = [PolicyState::new(1, units), PolicyState::new(1, units)];
        for step in 0..4 {
            let row = normals(3, step);
            let mut image = [0.0; 3];
            input.apply(&row, &mut image);
            frozen.step(&row, &mut state).unwrap();
            frozen.step(&image, &mut mirrored).unwrap();
            let mut expected = vec![0.0; units];
            symmetry.hidden().apply(&state.hidden(), &mut expected);
            assert_ne!(mirrored.hidden(), state.hidden());
            for (got, expected) in mirrored.hidden().iter().zip(expected) {
                assert!((got - expected).abs() < 1e-6, "{got}, expected {expected}");
            }
        }
    }
}

#[test]
fn a_recurrent_policy_acts_on_what_it_remembers_and_is_refused_where_nothing_is() {
    let mut stream = Stream::new(3, 0, Purpose::Weights);
    let sizes = ActorCriticSizes { obs_dim: 4, privileged: 1, memory: 5, hidden: &[8], action_dim: 2 };
    let networks = ActorCritic::new(sizes, -0.5, &mut || stream.normal(), &Device::flex());
    assert_eq!((networks.obs_dim(), networks.privileged(), networks.memory()), (4, 1, 5));
    let mut normalizer = Normalizer::new(4, 0).unwrap();
    normalizer.update(&normals(40, 6)).unwrap();
    let frozen = networks.frozen(&normalizer).unwrap();
    let policy: &Policy = &frozen.policy;
    let (obs, seen) = (normals(8, 5), |obs: &[f32]| [&obs[..3], &obs[4..7]].concat());
    let mut state = policy.initial_state(2);
    let values = frozen.values(&obs, &state).unwrap();
    let first = frozen.act(&obs, &[0.0; 4], &mut state.clone()).unwrap();
    assert_eq!((&first.values, first.hidden.len()), (&values, 10));
    assert_eq!(policy.step(&seen(&obs), &mut state).unwrap(), first.means);
    // The same observation again, which follows itself now; and in the first episode for the second robot.
    state.begin(1);
    let second = frozen.act(&obs, &[0.0; 4], &mut state).unwrap();
    assert_ne!(second.means[..2], first.means[..2]);
    assert_eq!(second.means[2..], first.means[2..]);
    let message = policy.mean_actions(&seen(&obs)).unwrap_err().to_string();
    assert!(message.contains("`ppo.lstm` = 5"), "{message}");
    assert!(policy.step(&seen(&obs), &mut PolicyState::default()).is_err());
}
