//! Saving a learner into a directory and loading it back, to the bit.
//!
//! | file | holds |
//! |---|---|
//! | `learner.toml` | shapes, seed, number of updates, β and learning-rate factor, normaliser |
//! | `policy.bpk`, `value.bpk` | weights, as burnpack records |
//! | `policy_adam.bpk`, `value_adam.bpk` | Adam's moments |
//! | `value_batch.bpk` | the batch of the last update, which the next one trains the value net on |
//!
//! Scalars are TOML because its numbers survive a round trip exactly. Weights must be loaded from
//! burnpack records: these keep parameter ids, by which Adam's moments find their parameters.

use std::path::Path;

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use dappo_sim::rng::{Purpose, Stream};
use serde::{Deserialize, Serialize};

use super::batch::ValueBatch;
use super::loss::Adaptation;
use super::{Ppo, PpoConfig, adam};
use crate::cpu;
use crate::error::{LearnError, Result};
use crate::nn::{ActorCritic, read};
use crate::normalizer::Normalizer;
use crate::records::{load_module, load_optimizer, save_module, save_optimizer, unreadable};

const FORMAT: u32 = 1;
const LEARNER: &str = "learner.toml";
const POLICY: &str = "policy.bpk";
const VALUE: &str = "value.bpk";
const POLICY_ADAM: &str = "policy_adam.bpk";
const VALUE_ADAM: &str = "value_adam.bpk";
const VALUE_BATCH: &str = "value_batch.bpk";

/// The contents of `learner.toml`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    format: u32,
    obs_dim: usize,
    action_dim: usize,
    hidden: Vec<usize>,
    /// As text: TOML's integers end at 2⁶³.
    seed: String,
    updates: u64,
    /// 0 before the first update.
    value_batch_rows: usize,
    adaptation: Adaptation,
    normalizer: Normalizer,
}

/// A value batch as a module, so that checkpoints store it as they store networks.
#[derive(Module, Debug)]
struct ValueBatchRecord {
    /// `[B, O]`.
    obs: Param<Tensor<2>>,
    /// `[B, 1]`.
    returns: Param<Tensor<2>>,
}

impl ValueBatchRecord {
    fn of(obs: &[f32], returns: &[f32]) -> Self {
        let rows = returns.len();
        let constant = |values: &[f32]| {
            let data = TensorData::new(values.to_vec(), [rows, values.len() / rows]);
            Param::from_tensor(Tensor::from_data(data, &cpu())).set_require_grad(false)
        };
        Self { obs: constant(obs), returns: constant(returns) }
    }
}

impl Ppo {
    /// Writes everything that the learner owns into the existing directory `dir`.
    pub fn save(&self, dir: &Path) -> Result<()> {
        let header = Header {
            format: FORMAT,
            obs_dim: self.actor_critic.obs_dim(),
            action_dim: self.actor_critic.action_dim(),
            hidden: self.config.hidden.clone(),
            seed: self.seed.to_string(),
            updates: self.updates,
            value_batch_rows: self.previous.as_ref().map_or(0, ValueBatch::rows),
            adaptation: self.adaptation,
            normalizer: self.normalizer.clone(),
        };
        let path = dir.join(LEARNER);
        let text = toml::to_string(&header).map_err(|error| unreadable(&path, error))?;
        std::fs::write(&path, text).map_err(|source| LearnError::Io { path, source })?;
        save_module(&self.actor_critic.policy, &dir.join(POLICY))?;
        save_module(&self.actor_critic.value, &dir.join(VALUE))?;
        save_optimizer(&self.policy_optimizer, &dir.join(POLICY_ADAM))?;
        save_optimizer(&self.value_optimizer, &dir.join(VALUE_ADAM))?;
        self.previous.as_ref().map_or(Ok(()), |batch| {
            save_module(&ValueBatchRecord::of(&batch.obs, &batch.returns), &dir.join(VALUE_BATCH))
        })
    }

    /// Reads a learner from a directory that [`Ppo::save`] wrote. Settings other than `hidden` may differ
    /// from those it was saved with.
    pub fn load(dir: &Path, config: &PpoConfig, device: &Device) -> Result<Self> {
        config.check()?;
        let header = read_header(dir)?;
        let path = dir.join(LEARNER);
        if header.hidden != config.hidden {
            let (got, expected) = (format!("{:?}", header.hidden), format!("{:?}", config.hidden));
            return Err(LearnError::Mismatch { path, what: "hidden", got, expected });
        }
        let seed = header.seed.parse().map_err(|error| unreadable(&path, error))?;
        let device = device.clone().autodiff();
        let actor_critic = read_networks(dir, &header, &device)?;
        let previous = read_value_batch(dir, &header)?;
        Ok(Self {
            config: config.clone(),
            device,
            seed,
            updates: header.updates,
            actor_critic,
            policy_optimizer: load_optimizer(adam(), &dir.join(POLICY_ADAM))?,
            value_optimizer: load_optimizer(adam(), &dir.join(VALUE_ADAM))?,
            adaptation: header.adaptation,
            normalizer: header.normalizer,
            previous,
        })
    }
}

fn read_header(dir: &Path) -> Result<Header> {
    let path = dir.join(LEARNER);
    let text =
        std::fs::read_to_string(&path).map_err(|source| LearnError::Io { path: path.clone(), source })?;
    let header: Header = toml::from_str(&text).map_err(|error| unreadable(&path, error))?;
    for (what, got, expected) in [
        ("format", header.format as usize, FORMAT as usize),
        ("length of the normaliser", header.normalizer.obs_dim(), header.obs_dim),
    ] {
        if got != expected {
            let (got, expected) = (got.to_string(), expected.to_string());
            return Err(LearnError::Mismatch { path, what, got, expected });
        }
    }
    Ok(header)
}

fn read_networks(dir: &Path, header: &Header, device: &Device) -> Result<ActorCritic> {
    let Header { obs_dim, action_dim, hidden, .. } = header;
    // Any weights do, as the records replace them.
    let mut filler = Stream::new(0, 0, Purpose::Weights);
    let ActorCritic { policy, value } =
        ActorCritic::new(*obs_dim, hidden, *action_dim, 0.0, &mut || filler.normal(), device);
    Ok(ActorCritic {
        policy: load_module(policy, &dir.join(POLICY))?,
        value: load_module(value, &dir.join(VALUE))?,
    })
}

fn read_value_batch(dir: &Path, header: &Header) -> Result<Option<ValueBatch>> {
    let rows = header.value_batch_rows;
    if rows == 0 {
        return Ok(None);
    }
    let filler = ValueBatchRecord::of(&vec![0.0; rows * header.obs_dim], &vec![0.0; rows]);
    let record = load_module(filler, &dir.join(VALUE_BATCH))?;
    Ok(Some(ValueBatch { obs: read(record.obs.val())?, returns: read(record.returns.val())? }))
}
