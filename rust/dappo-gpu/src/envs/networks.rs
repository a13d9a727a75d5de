//! The networks that act in a rollout.

use cubecl::client::Client;

use super::Envs;
use super::buffer::{Buffer, cube, cubes};
use super::episode::halves;
use super::rollout::Buffers;
use crate::engine::Number;
use crate::networks::{TILE, gather, layer, prepare, sample};

/// A tanh MLP with a linear output layer.
#[derive(Debug, Clone, Copy)]
pub struct Net<'a> {
    /// Inputs, units of the hidden layers, outputs.
    pub sizes: &'a [usize],
    /// Layer by layer: the weight, row-major `[inputs, outputs]`, then the bias.
    pub parameters: &'a [f32],
}

/// What acts in a rollout.
#[derive(Debug, Clone, Copy)]
pub struct Networks<'a> {
    /// Chooses the means of the actions.
    pub policy: Net<'a>,
    /// Estimates values; it is given privileged entries, too.
    pub value: Net<'a>,
    /// Logarithm of the standard deviations of the actions, `[nu]`.
    pub log_std: &'a [f32],
    /// Means and scales that entries of an observation are standardised with, and the bound of what results; `None` if
    /// they pass as they are.
    pub statistics: Option<(&'a [f32], &'a [f32], f32)>,
    /// Factor of the damage code.
    pub code_scale: f32,
}

/// A net on the device.
pub(super) struct Uploaded<'a> {
    sizes: &'a [usize],
    parameters: Buffer,
    statistics: Buffer,
    clip: f32,
    code_scale: f32,
}

impl<'a> Uploaded<'a> {
    /// A net for observations with so many entries before the damage code.
    pub(super) fn new(client: &Client, networks: &Networks<'a>, net: Net<'a>, observed: usize) -> Self {
        let (statistics, clip) = networks.statistics.map_or_else(
            || ([vec![0.0; observed], vec![1.0; observed]].concat(), f32::MAX),
            |(mean, scale, clip)| ([mean, scale].concat(), clip),
        );
        Self {
            sizes: net.sizes,
            parameters: Buffer::of(client, net.parameters),
            statistics: Buffer::of(client, &statistics),
            clip,
            code_scale: networks.code_scale,
        }
    }
}

impl Envs {
    /// Sends rows of observations from `first` on through a net; its outputs go to `out`, from `at` on.
    pub(super) fn run(
        &self,
        net: &Uploaded<'_>,
        obs: &Buffer,
        first: usize,
        out: &Buffer,
        at: usize,
        rows: usize,
    ) {
        let (client, plan) = (&self.client, &self.task.plan);
        let observed = plan.obs_len() - plan.code;
        let inputs = net.sizes[0];
        let mut input = Buffer::empty::<f32>(client, rows * inputs);
        // SAFETY: as in `step`.
        unsafe {
            prepare::launch_unchecked(
                client,
                cubes(rows * inputs),
                cube(),
                obs.arg(),
                net.statistics.arg(),
                input.arg(),
                first,
                rows,
                net.clip,
                net.code_scale,
                observed,
                inputs - plan.code,
                plan.code,
            );
        }
        let (mut start, last) = (0, net.sizes.len() - 2);
        for (index, pair) in net.sizes.windows(2).enumerate() {
            let [inputs, outputs] = [pair[0], pair[1]];
            let is_hidden = index < last;
            let output = if is_hidden { Buffer::empty::<f32>(client, rows * outputs) } else { out.clone() };
            // SAFETY: as in `step`.
            unsafe {
                layer::launch_unchecked(
                    client,
                    cubes(rows.div_ceil(TILE) * outputs),
                    cube(),
                    input.arg(),
                    net.parameters.arg(),
                    output.arg(),
                    start,
                    if is_hidden { 0 } else { at },
                    rows,
                    inputs,
                    outputs,
                    is_hidden,
                );
            }
            start += (inputs + 1) * outputs;
            input = output;
        }
    }

    /// Samples the actions of a step from their means.
    pub(super) fn sample<F: Number>(
        &self,
        log_std: &[f32],
        std: &Buffer,
        buffers: &Buffers,
        step: usize,
        number: u64,
    ) {
        let nu = log_std.len();
        let half_log_tau = 0.5 * std::f64::consts::TAU.ln();
        let constant = log_std.iter().map(|log_std| f64::from(*log_std) + half_log_tau).sum::<f64>() as f32;
        let [low, high] = halves(number);
        let row = step * self.len;
        // SAFETY: as in `step`.
        unsafe {
            sample::launch_unchecked::<F>(
                &self.client,
                cubes(self.len),
                cube(),
                self.noise_keys.arg(),
                std.arg(),
                buffers.means.arg(),
                buffers.actions.arg(),
                buffers.log_probs.arg(),
                row * nu,
                row,
                self.len,
                low,
                high,
                constant,
                nu,
            );
        }
    }

    /// Copies rows of observations into a buffer of their own.
    pub(super) fn gather(&self, from: &Buffer, rows: &[u32], to: &Buffer) {
        let width = self.task.plan.obs_len();
        // SAFETY: as in `step`.
        unsafe {
            gather::launch_unchecked(
                &self.client,
                cubes(rows.len() * width),
                cube(),
                from.arg(),
                Buffer::of(&self.client, rows).arg(),
                to.arg(),
                rows.len(),
                width,
            );
        }
    }
}
