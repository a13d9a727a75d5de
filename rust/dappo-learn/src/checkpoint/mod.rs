//! Checkpoints: a folder with everything that the rest of a run depends on.
//!
//! A checkpoint is a [sealed folder](crate::files::sealed): a kill at any moment leaves the previous ones. Its
//! `manifest.json` lists every file with length and CRC-32; a checkpoint that does not match, or holds anything else,
//! is refused by name.

mod env_state;
#[cfg(test)]
mod tests;

use std::fs;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use dappo_nn::PolicyState;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::engine::RolloutEngine;
use crate::episodes::EpisodeTracker;
use crate::error::{FileKind, Result};
use crate::files::sealed::{
    Checksum, Manifest, Seal, SealedFolder, UnsealedFolder, check_replaceable, crc32,
};
use crate::files::{Files, check_folder, io, own_folder, remove_folder, sweep};
use crate::ppo::{Ppo, PpoConfig};
use crate::sizes::Sizes;

pub use env_state::EnvState;

/// Where earlier versions wrote a checkpoint before it got its number.
const EARLIER_TEMPORARY: &str = ".new.tmp";

/// Where a training of some kind stood.
pub trait Position: Copy + Serialize + DeserializeOwned {
    /// What its checkpoints are numbered by.
    fn number(&self) -> u64;
}

/// Where a run stood.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Progress {
    /// Iterations done.
    pub iteration: u64,
    /// Env steps done.
    pub env_steps: u64,
    /// Index of the curriculum stage.
    pub stage: usize,
}

impl Position for Progress {
    fn number(&self) -> u64 {
        self.iteration
    }
}

/// The contents of `manifest.json`.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CheckpointManifest<P> {
    format: String,
    robot: String,
    progress: P,
    files: Vec<FileEntry>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileEntry {
    name: String,
    bytes: u64,
    crc32: u32,
}

impl<P: Position> Manifest for CheckpointManifest<P> {
    const NAME: &'static str = "manifest.json";
    const FORMAT: &'static str = "dappo-batch checkpoint 1";
    const KIND: &'static str = "a checkpoint";
    const FILES: FileKind = FileKind::Checkpoint;
    const ADVICE: &'static str = "remove this checkpoint to resume from the one before";
    /// The files of all kinds of checkpoints.
    const UNLISTED: &'static [&'static str] = &[
        "learner.toml",
        "policy.bpk",
        "value.bpk",
        "policy_adam.bpk",
        "value_adam.bpk",
        "value_batch.bpk",
        "envs.safetensors",
        "envs.bin",
        "session.toml",
        "net.bpk",
        "adam.bpk",
        "best.bpk",
    ];

    fn seals(&self) -> Vec<(String, Seal)> {
        let seal = |file: &FileEntry| Seal { bytes: Some(file.bytes), checksum: Checksum::Crc32(file.crc32) };
        self.files.iter().map(|file| (file.name.clone(), seal(file))).collect()
    }
}

/// A checkpoint on disk whose files have been verified.
#[derive(Debug, Clone)]
pub struct Checkpoint<P = Progress> {
    /// Where the run stood.
    pub progress: P,
    sealed: SealedFolder<CheckpointManifest<P>>,
}

impl<P: Position> Checkpoint<P> {
    /// Writes a checkpoint: `fill` writes its files into the folder it is given. Older ones beyond `keep` are
    /// removed.
    pub fn write(
        checkpoints: &Path,
        robot: &str,
        progress: P,
        keep: usize,
        fill: impl FnOnce(&Path) -> Result<()>,
    ) -> Result<()> {
        own_folder(checkpoints)?;
        sweep(checkpoints, |stem| std::str::from_utf8(stem).is_ok_and(|stem| number(stem).is_some()));
        let is_ours = |folder: &Path| check_replaceable::<CheckpointManifest<P>>(folder).is_ok();
        let earlier = checkpoints.join(EARLIER_TEMPORARY);
        if is_ours(&earlier) {
            remove_folder(&earlier)?;
        }
        let folder = UnsealedFolder::create(&checkpoints.join(format!("{:08}", progress.number())))?;
        fill(folder.path())?;
        let files = folder.list(crc32)?.into_iter();
        let files = files.map(|(name, (bytes, crc32))| FileEntry { name, bytes, crc32 }).collect();
        let format = CheckpointManifest::<P>::FORMAT.to_owned();
        folder.seal(&CheckpointManifest { format, robot: robot.into(), progress, files })?;
        folder.commit()?;
        let mut ours = numbered(checkpoints)?;
        ours.retain(|folder| is_ours(folder));
        ours.iter().rev().skip(keep).try_for_each(|old| remove_folder(old))
    }

    /// Opens the newest checkpoint of a run and verifies it.
    pub fn newest(checkpoints: &Path, robot: &str) -> Result<Self> {
        let newest = numbered(checkpoints)?.pop();
        let folder = newest
            .ok_or_else(|| FileKind::Checkpoint.unusable(checkpoints, "the folder holds no checkpoint"))?;
        let checkpoint = Self::open(&folder, robot)?;
        let (name, found) = (number_of(&folder), checkpoint.progress.number());
        if name != Some(found) {
            let message = format!("it holds number {found}; rename it to {found:08}, or remove it");
            return Err(FileKind::Checkpoint.unusable(&folder, message));
        }
        Ok(checkpoint)
    }

    /// Opens one checkpoint and verifies it.
    pub fn open(folder: &Path, robot: &str) -> Result<Self> {
        let sealed = SealedFolder::<CheckpointManifest<P>>::open(folder)?;
        let found = &sealed.manifest().robot;
        if found != robot {
            let message = format!("it belongs to robot `{found}`, expected `{robot}`");
            return Err(FileKind::Checkpoint.unusable(sealed.manifest_path(), message));
        }
        Ok(Self { progress: sealed.manifest().progress, sealed })
    }
}

impl<P: Position> Files for Checkpoint<P> {
    fn path(&self, name: &str) -> PathBuf {
        self.sealed.path(name)
    }

    fn has(&self, name: &str) -> bool {
        self.sealed.has(name)
    }

    fn read(&self, name: &str, limit: u64) -> Result<Vec<u8>> {
        self.sealed.read(name, limit)
    }
}

impl Checkpoint {
    /// Whether a run has a checkpoint.
    pub fn any(checkpoints: &Path) -> Result<bool> {
        Ok(!numbered(checkpoints)?.is_empty())
    }

    /// CRC-32 of the manifest, which lists the CRC-32 of every file: equal for equal checkpoints.
    #[must_use]
    pub fn fingerprint(&self) -> String {
        self.sealed.fingerprint()
    }

    /// Reads the learner onto a device. It must have seen observations and taken actions of the same lengths.
    pub fn learner(&self, config: &PpoConfig, sizes: Sizes, device: &Device) -> Result<Ppo> {
        Ppo::load_for(self, config, Some(sizes), device)
    }

    /// Reads the envs and sets those of `engine` to their state; returns the sums over their running episodes, and what
    /// the policy, whose memory has so many units, remembers of them.
    pub fn restore_envs(
        &self,
        engine: &mut dyn RolloutEngine,
        units: usize,
    ) -> Result<(EpisodeTracker, PolicyState)> {
        let state = EnvState::load(self)?;
        if state.memory.units() != units {
            let message =
                format!("its envs hold {} units of a memory, expected {units}", state.memory.units());
            return Err(FileKind::Checkpoint.unusable(self.sealed.folder(), message));
        }
        engine.restore(&state.envs).map_err(|error| {
            FileKind::Checkpoint
                .unusable(self.sealed.folder(), format!("its envs are not those of this run ({error})"))
        })?;
        Ok((state.episodes, state.memory))
    }
}

/// The number that is written as this name; `None` for any other name, such as `1` or `notes`.
fn number(name: &str) -> Option<u64> {
    let number = name.parse().ok()?;
    (format!("{number:08}") == name).then_some(number)
}

fn number_of(folder: &Path) -> Option<u64> {
    number(folder.file_name()?.to_str()?)
}

/// Folders with the names of checkpoints, in ascending order, and links with such names.
fn numbered(checkpoints: &Path) -> Result<Vec<PathBuf>> {
    check_folder(checkpoints)?;
    if !checkpoints.exists() {
        return Ok(Vec::new());
    }
    let mut found = Vec::new();
    for entry in fs::read_dir(checkpoints).map_err(io(checkpoints))? {
        let entry = entry.map_err(io(checkpoints))?;
        let kind = entry.file_type().map_err(io(checkpoints))?;
        if let (false, Some(number)) = (kind.is_file(), number_of(&entry.path())) {
            found.push((number, entry.path()));
        }
    }
    found.sort();
    Ok(found.into_iter().map(|(_, path)| path).collect())
}
