//! Saving a learner into a directory and loading it back, bit-identical.
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
use dappo_nn::kernels::{lstm_sequence, parameter_count};
use dappo_nn::{ActorCritic, ActorCriticSizes, Normalizer, cpu, read};
use dappo_sim::rng::{Purpose, Stream};
use serde::{Deserialize, Serialize};

use super::batch::ValueBatch;
use super::loss::Adaptation;
use super::{Ppo, PpoConfig, optimizer, trainable};
use crate::error::Result;
use crate::files::{Files, TEXT_BYTES, write_new};
use crate::records::{load_module, load_optimizer, read_numbers, save_module, save_optimizer, unreadable};
use crate::sizes::Sizes;

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
    /// Entries of an observation that the value net alone is given.
    #[serde(default)]
    privileged: usize,
    action_dim: usize,
    hidden: Vec<usize>,
    /// Units of the policy's memory.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    lstm: Option<usize>,
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
    /// Writes everything that the learner owns into the directory `dir`, which has none of its files yet.
    pub fn save(&self, dir: &Path) -> Result<()> {
        let header = Header {
            format: FORMAT,
            obs_dim: self.actor_critic.obs_dim(),
            privileged: self.actor_critic.privileged(),
            action_dim: self.actor_critic.action_dim(),
            hidden: self.config.hidden.clone(),
            lstm: self.config.lstm,
            seed: self.seed.to_string(),
            updates: self.updates,
            value_batch_rows: self.previous.as_ref().map_or(0, ValueBatch::rows),
            adaptation: self.adaptation,
            normalizer: self.normalizer.clone(),
        };
        let path = dir.join(LEARNER);
        let text = toml::to_string(&header).map_err(|error| unreadable(&path, error))?;
        write_new(&path, text.as_bytes())?;
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
        Self::load_for(dir, config, None, device)
    }

    /// The same from any folder. The learner must have seen observations and taken actions of these lengths.
    pub(crate) fn load_for<F: Files + ?Sized>(
        files: &F,
        config: &PpoConfig,
        sizes: Option<Sizes>,
        device: &Device,
    ) -> Result<Self> {
        config.check()?;
        let header = read_header(files, config, sizes)?;
        let path = files.path(LEARNER);
        let seed = header.seed.parse().map_err(|error| unreadable(&path, error))?;
        let device = device.clone().without_autodiff();
        let actor_critic = trainable(read_networks(files, &header, &device)?, config.gradients());
        let previous = read_value_batch(files, &header)?;
        Ok(Self {
            config: config.clone(),
            device,
            seed,
            updates: header.updates,
            policy_optimizer: load_optimizer(optimizer(config), &actor_critic.policy, files, POLICY_ADAM)?,
            value_optimizer: load_optimizer(optimizer(config), &actor_critic.value, files, VALUE_ADAM)?,
            actor_critic,
            adaptation: header.adaptation,
            normalizer: header.normalizer,
            previous,
            mirror: None,
        })
    }
}

/// Reads the header and checks it: it determines how much memory the rest takes.
fn read_header<F: Files + ?Sized>(files: &F, config: &PpoConfig, sizes: Option<Sizes>) -> Result<Header> {
    let path = files.path(LEARNER);
    let text =
        String::from_utf8(files.read(LEARNER, TEXT_BYTES)?).map_err(|error| unreadable(&path, error))?;
    let header: Header = toml::from_str(&text).map_err(|error| unreadable(&path, error))?;
    header.normalizer.check().map_err(|error| unreadable(&path, error))?;
    let mismatch = |what: &str, got: &str, expected: &str| {
        unreadable(&path, format!("{what} is {got}, expected {expected}"))
    };
    if header.hidden != config.hidden {
        return Err(mismatch("hidden", &format!("{:?}", header.hidden), &format!("{:?}", config.hidden)));
    }
    if header.lstm != config.lstm {
        let units = |lstm: Option<usize>| lstm.unwrap_or(0).to_string();
        return Err(mismatch("lstm", &units(header.lstm), &units(config.lstm)));
    }
    let code_length = header.normalizer.code_length();
    let Header { obs_dim, privileged, action_dim, .. } = header;
    let known = sizes.unwrap_or(Sizes { obs_dim, privileged, code_length, action_dim });
    for (what, got, expected) in [
        ("format", header.format as usize, FORMAT as usize),
        ("length of an observation", header.obs_dim, known.obs_dim),
        ("number of privileged entries of an observation", header.privileged, known.privileged),
        ("length of an action", header.action_dim, known.action_dim),
        ("length of the damage code", code_length, known.code_length),
        ("length of the normaliser", header.normalizer.obs_dim(), header.obs_dim),
    ] {
        if got != expected {
            return Err(mismatch(what, &got.to_string(), &expected.to_string()));
        }
    }
    let Adaptation { kl_coef, lr_factor } = header.adaptation;
    for (what, value) in [("kl_coef", kl_coef), ("lr_factor", lr_factor)] {
        if !(value.is_finite() && value > 0.0) {
            return Err(unreadable(&path, format!("{what} is {value}, expected a finite number above 0")));
        }
    }
    if header.obs_dim.saturating_sub(code_length) <= header.privileged || header.action_dim == 0 {
        return Err(unreadable(
            &path,
            "the policy's observation or an action has length 0, expected at least 1",
        ));
    }
    Ok(header)
}

fn read_networks<F: Files + ?Sized>(files: &F, header: &Header, device: &Device) -> Result<ActorCritic> {
    let &Header { obs_dim, privileged, action_dim, ref hidden, lstm, .. } = header;
    let sizes = ActorCriticSizes { obs_dim, privileged, memory: lstm.unwrap_or(0), hidden, action_dim };
    let memory = match sizes.memory {
        0 => Some(0),
        units => lstm_sequence::parameter_count(sizes.seen(), units),
    };
    let numbers = parameter_count(&sizes.mean())
        .and_then(|numbers| numbers.checked_add(action_dim))
        .and_then(|numbers| numbers.checked_add(memory?));
    let policy_file = read_numbers(files, POLICY, numbers)?;
    let value_file = read_numbers(files, VALUE, parameter_count(&sizes.value()))?;
    // Any weights do, as the records replace them.
    let mut filler = Stream::new(0, 0, Purpose::Weights);
    let ActorCritic { policy, value } = ActorCritic::new(sizes, 0.0, &mut || filler.normal(), device);
    Ok(ActorCritic {
        policy: load_module(policy, &files.path(POLICY), policy_file)?,
        value: load_module(value, &files.path(VALUE), value_file)?,
    })
}

fn read_value_batch<F: Files + ?Sized>(files: &F, header: &Header) -> Result<Option<ValueBatch>> {
    let rows = header.value_batch_rows;
    if rows == 0 {
        return Ok(None);
    }
    let width = header.obs_dim.checked_add(header.lstm.unwrap_or(0));
    let numbers = width.and_then(|width| width.checked_add(1)?.checked_mul(rows));
    let bytes = read_numbers(files, VALUE_BATCH, numbers)?;
    let filler = ValueBatchRecord::of(&vec![0.0; rows * width.unwrap_or(0)], &vec![0.0; rows]);
    let record = load_module(filler, &files.path(VALUE_BATCH), bytes)?;
    Ok(Some(ValueBatch { obs: read(record.obs.val())?, returns: read(record.returns.val())? }))
}
