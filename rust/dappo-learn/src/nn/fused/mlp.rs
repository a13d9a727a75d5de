//! The tanh MLP as one operation; its backward pass needs the hidden activations.

use std::sync::Arc;

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::{Tensor, TensorData};

use crate::nn::kernels::{self, Level};

/// The operation that burn's backends gain.
#[backend_extension(Flex, Autodiff)]
pub trait FusedMlp: Backend {
    /// A tanh MLP with a linear output layer.
    ///
    /// # Shapes
    /// x `[N, sizes[0]]`, parameters `[kernels::parameter_count(sizes)]`; returns `[N, sizes[last]]`
    fn tanh_mlp(x: FloatTensor<Self>, parameters: FloatTensor<Self>, sizes: Vec<usize>) -> FloatTensor<Self>;
}

/// Applies [`FusedMlp::tanh_mlp`]. Both tensors must live on a Flex device, with autodiff or without.
pub(in crate::nn) fn tanh_mlp(x: Tensor<2>, parameters: Tensor<1>, sizes: Vec<usize>) -> Tensor<2> {
    let out = <Dispatch as FusedMlp>::tanh_mlp(x.into_dispatch(), parameters.into_dispatch(), sizes);
    Tensor::from_dispatch(out)
}

/// Runs the kernel; with `keep`, also returns the hidden activations.
fn run_forward(
    x: &FlexTensor,
    parameters: &FlexTensor,
    sizes: &[usize],
    keep: bool,
) -> (FlexTensor, Vec<f32>) {
    let rows = x.shape()[0];
    let outputs = sizes[sizes.len() - 1];
    let mut out = vec![0.0; rows * outputs];
    let mut hidden = vec![0.0; if keep { rows * kernels::hidden_width(sizes) } else { 0 }];
    kernels::forward(
        Level::best(),
        sizes,
        parameters.storage(),
        x.storage(),
        &mut out,
        keep.then_some(hidden.as_mut_slice()),
    );
    (FlexTensor::from_data(TensorData::new(out, [rows, outputs])), hidden)
}

impl FusedMlp for Flex {
    fn tanh_mlp(x: FlexTensor, parameters: FlexTensor, sizes: Vec<usize>) -> FlexTensor {
        run_forward(&x.to_contiguous(), &parameters.to_contiguous(), &sizes, false).0
    }
}

/// What the backward pass needs from the forward pass.
#[derive(Debug, Clone)]
struct Saved {
    x: FlexTensor,
    parameters: FlexTensor,
    sizes: Vec<usize>,
    hidden: Arc<Vec<f32>>,
}

#[derive(Debug)]
struct FusedMlpBackward;

impl Backward<Flex, 2> for FusedMlpBackward {
    type State = Saved;

    fn backward(self, ops: Ops<Saved, 2>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let out_gradient = gradients.consume::<Flex>(&ops.node).to_contiguous();
        let Saved { x, parameters, sizes, hidden } = ops.state;
        let [x_node, parameters_node] = ops.parents;
        let mut x_gradient = vec![0.0; if x_node.is_some() { x.shape().num_elements() } else { 0 }];
        let parameter_gradient = kernels::backward(
            Level::best(),
            &sizes,
            parameters.storage(),
            x.storage(),
            &hidden,
            out_gradient.storage(),
            x_node.is_some().then_some(x_gradient.as_mut_slice()),
        );
        if let Some(node) = x_node {
            let gradient = FlexTensor::from_data(TensorData::new(x_gradient, x.shape()));
            gradients.register::<Flex>(node.id, gradient);
        }
        if let Some(node) = parameters_node {
            let shape = [parameter_gradient.len()];
            let gradient = FlexTensor::from_data(TensorData::new(parameter_gradient, shape));
            gradients.register::<Flex>(node.id, gradient);
        }
    }
}

impl<C: CheckpointStrategy> FusedMlp for Autodiff<Flex, C> {
    fn tanh_mlp(x: FloatTensor<Self>, parameters: FloatTensor<Self>, sizes: Vec<usize>) -> FloatTensor<Self> {
        let prepared =
            FusedMlpBackward.prepare::<C>([x.node(), parameters.node()]).compute_bound().stateful();
        let x = x.into_primitive().to_contiguous();
        let parameters = parameters.into_primitive().to_contiguous();
        match prepared {
            OpsKind::Tracked(prepared) => {
                let (out, hidden) = run_forward(&x, &parameters, &sizes, true);
                prepared.finish(Saved { x, parameters, sizes, hidden: Arc::new(hidden) }, out)
            }
            OpsKind::UnTracked(prepared) => prepared.finish(run_forward(&x, &parameters, &sizes, false).0),
        }
    }
}
