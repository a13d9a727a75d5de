//! The last hidden state of an LSTM behind a linear embedding as one operation; its backward pass needs
//! gates, cell and hidden states of every step.
//!
//! burn calls an extension trait through its `Dispatch` type. The trait is implemented for the Flex backend, and for
//! `Autodiff<Flex>` by recording a node whose state keeps what the backward pass needs. Other backends are not listed and
//! would panic: networks send them down a path of burn's own operations.

use std::sync::Arc;

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::{Tensor, TensorData};

use crate::kernels::Level;
use crate::kernels::lstm::{self, Activations, LstmSizes};

/// The operation that burn's backends gain.
#[backend_extension(Flex, Autodiff)]
pub trait LstmOp: Backend {
    /// The last hidden state of an LSTM behind a linear embedding. There is no gradient of `x`.
    ///
    /// # Shapes
    /// x `[B, T, F]`, parameters `[sizes.parameter_count()]`; returns `[B, H]`
    fn embedded_lstm(
        x: FloatTensor<Self>,
        parameters: FloatTensor<Self>,
        sizes: LstmSizes,
    ) -> FloatTensor<Self>;
}

/// Applies [`LstmOp::embedded_lstm`]. Both tensors must live on a Flex device, with autodiff or without.
pub(crate) fn embedded_lstm(x: Tensor<3>, parameters: Tensor<1>, sizes: LstmSizes) -> Tensor<2> {
    let out = <Dispatch as LstmOp>::embedded_lstm(x.into_dispatch(), parameters.into_dispatch(), sizes);
    Tensor::from_dispatch(out)
}

/// Runs the kernel; with `keep`, also returns what the backward pass needs.
fn run_forward(
    x: &FlexTensor,
    parameters: &FlexTensor,
    sizes: LstmSizes,
    keep: bool,
) -> (FlexTensor, Option<Activations>) {
    let (windows, steps) = (x.shape()[0], x.shape()[1]);
    let mut out = vec![0.0; windows * sizes.hidden];
    let kept =
        lstm::forward(Level::chosen(), sizes, steps, parameters.storage(), x.storage(), &mut out, keep);
    (FlexTensor::from_data(TensorData::new(out, [windows, sizes.hidden])), kept)
}

impl LstmOp for Flex {
    fn embedded_lstm(x: FlexTensor, parameters: FlexTensor, sizes: LstmSizes) -> FlexTensor {
        run_forward(&x.to_contiguous(), &parameters.to_contiguous(), sizes, false).0
    }
}

/// What the backward pass needs from the forward pass.
#[derive(Debug, Clone)]
struct SavedForBackward {
    x: FlexTensor,
    parameters: FlexTensor,
    sizes: LstmSizes,
    kept: Arc<Activations>,
}

#[derive(Debug)]
struct LstmBackward;

impl Backward<Flex, 1> for LstmBackward {
    type State = SavedForBackward;

    fn backward(self, ops: Ops<SavedForBackward, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let out_gradient = gradients.consume::<Flex>(&ops.node).to_contiguous();
        let SavedForBackward { x, parameters, sizes, kept } = ops.state;
        let [Some(node)] = ops.parents else { return };
        let gradient = lstm::backward(
            Level::chosen(),
            sizes,
            x.shape()[1],
            parameters.storage(),
            x.storage(),
            &kept,
            out_gradient.storage(),
        );
        let shape = [gradient.len()];
        gradients.register::<Flex>(node.id, FlexTensor::from_data(TensorData::new(gradient, shape)));
    }
}

impl<C: CheckpointStrategy> LstmOp for Autodiff<Flex, C> {
    fn embedded_lstm(
        x: FloatTensor<Self>,
        parameters: FloatTensor<Self>,
        sizes: LstmSizes,
    ) -> FloatTensor<Self> {
        let prepared = LstmBackward.prepare::<C>([parameters.node()]).compute_bound().stateful();
        let x = x.into_primitive().to_contiguous();
        let parameters = parameters.into_primitive().to_contiguous();
        let is_tracked = matches!(prepared, OpsKind::Tracked(_));
        let (out, kept) = run_forward(&x, &parameters, sizes, is_tracked);
        match prepared {
            OpsKind::Tracked(prepared) => {
                let kept = Arc::new(kept.unwrap_or_default());
                prepared.finish(SavedForBackward { x, parameters, sizes, kept }, out)
            }
            OpsKind::UnTracked(prepared) => prepared.finish(out),
        }
    }
}
