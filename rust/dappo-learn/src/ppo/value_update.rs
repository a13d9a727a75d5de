//! The value net's part of an update.

use burn::optim::{GradientsParams, ModuleOptimizer};
use burn::tensor::{Device, Tensor};
use dappo_sim::rng::Stream;

use super::PpoConfig;
use super::minibatch::{ValueBatch, shuffled};
use crate::error::{Result, check_finite};
use crate::nn::{Mlp, scalar};

/// The value net and what trains it.
pub(super) struct ValueUpdate<'a> {
    pub config: &'a PpoConfig,
    /// The device without autodiff.
    pub device: &'a Device,
    pub value: &'a mut Mlp,
    pub optimizer: &'a mut ModuleOptimizer,
}

impl ValueUpdate<'_> {
    /// Passes over the current and the previous batch; returns the mean loss of the last one.
    pub fn run(
        mut self,
        current: &ValueBatch,
        previous: Option<&ValueBatch>,
        mut stream: Stream,
    ) -> Result<f64> {
        let batch = current.union(previous);
        let mut loss = 0.0;
        for epoch in 1..=self.config.value_epochs {
            let minibatches =
                shuffled(batch.rows(), self.config.value_minibatch_size, &mut stream, self.device);
            let count = minibatches.len() as f64;
            let mut sum = Tensor::<1>::zeros([1], self.device);
            for rows in minibatches {
                let (obs, returns) = batch.select(&rows);
                sum = sum + self.step(obs, returns);
            }
            loss = check_finite(format!("value loss of epoch {epoch}"), scalar(sum)? / count)?;
        }
        Ok(loss)
    }

    /// One gradient step of the value net; returns the loss before it.
    fn step(&mut self, obs: Tensor<2>, returns: Tensor<2>) -> Tensor<1> {
        let value = &*self.value;
        let loss = (value.forward(obs) - returns).square().mean();
        let gradients = GradientsParams::from_grads(loss.backward(), value);
        let learning_rate = self.config.value_learning_rate;
        *self.value = self.optimizer.step(learning_rate, value.clone(), gradients);
        loss.without_autodiff()
    }
}
