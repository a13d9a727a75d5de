//! Checkpoints: a folder with everything that the rest of a run depends on.
//!
//! A checkpoint is written under a temporary name, synced and renamed, so that a kill at any moment leaves
//! the previous ones. Its `manifest.json` lists every file with length and CRC-32; a checkpoint that does
//! not match, or holds anything else, is refused by name.

mod env_state;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::engine::RolloutEngine;
use crate::envs::Sizes;
use crate::episodes::EpisodeTracker;
use crate::error::{LearnError, Result};
use crate::files::{
    self, Files, TEXT_BYTES, TemporaryFolder, io, is_file_name, open_regular, own_folder, read_regular,
    read_text, remove_folder, replace_folder, sweep, write_new,
};
use crate::ppo::{Ppo, PpoConfig};

pub use env_state::EnvState;

const FORMAT: &str = "dappo-batch checkpoint 1";
const MANIFEST: &str = "manifest.json";
/// The files of all kinds of checkpoints. A folder with anything else in it is never removed.
const FILES: [&str; 12] = [
    MANIFEST,
    "learner.toml",
    "policy.bpk",
    "value.bpk",
    "policy_adam.bpk",
    "value_adam.bpk",
    "value_batch.bpk",
    "envs.bin",
    "session.toml",
    "net.bpk",
    "adam.bpk",
    "best.bpk",
];
/// Where earlier versions wrote a checkpoint before it got its number.
const EARLIER_TEMPORARY: &str = ".new.tmp";
/// The longest file that is read, bytes: burn's arrays end at 10 GiB.
const LONGEST: u64 = 1 << 34;

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

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest<P> {
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

/// A checkpoint on disk whose files have been verified.
#[derive(Debug, Clone)]
pub struct Checkpoint<P = Progress> {
    /// Its folder.
    pub folder: PathBuf,
    /// Where the run stood.
    pub progress: P,
    files: Vec<FileEntry>,
}

impl<P: Position> Checkpoint<P> {
    /// Writes a checkpoint: `fill` puts its files into the folder it is given. Older ones beyond `keep` go.
    pub fn write(
        checkpoints: &Path,
        robot: &str,
        progress: P,
        keep: usize,
        fill: impl FnOnce(&Path) -> Result<()>,
    ) -> Result<()> {
        own_folder(checkpoints)?;
        sweep(checkpoints, |stem| std::str::from_utf8(stem).is_ok_and(|stem| number(stem).is_some()));
        let earlier = checkpoints.join(EARLIER_TEMPORARY);
        if is_ours(&earlier) {
            remove_folder(&earlier)?;
        }
        let folder = checkpoints.join(format!("{:08}", progress.number()));
        let temporary = TemporaryFolder::create(&folder)?;
        fill(temporary.path())?;
        let manifest =
            Manifest { format: FORMAT.into(), robot: robot.into(), progress, files: list(temporary.path())? };
        let text = serde_json::to_string_pretty(&manifest)
            .map_err(|error| broken(temporary.path(), error.to_string()))?;
        write_new(&temporary.path().join(MANIFEST), text.as_bytes())?;
        replace_folder(temporary, &folder)?;
        let mut ours = numbered(checkpoints)?;
        ours.retain(|folder| is_ours(folder));
        ours.iter().rev().skip(keep).try_for_each(|old| remove_folder(old))
    }

    /// Opens the newest checkpoint of a run and verifies it.
    pub fn newest(checkpoints: &Path, robot: &str) -> Result<Self> {
        let newest = numbered(checkpoints)?.pop();
        let folder = newest.ok_or_else(|| broken(checkpoints, "the folder holds no checkpoint".into()))?;
        let checkpoint = Self::open(&folder, robot)?;
        let (name, found) = (number_of(&folder), checkpoint.progress.number());
        if name != Some(found) {
            let message = format!("it holds number {found}; rename it to {found:08}, or remove it");
            return Err(broken(&folder, message));
        }
        Ok(checkpoint)
    }

    /// Opens one checkpoint and verifies it.
    pub fn open(folder: &Path, robot: &str) -> Result<Self> {
        if fs::symlink_metadata(folder).map_err(io(folder))?.is_symlink() {
            let message = "it is a symbolic link; put the checkpoint itself in its place";
            return Err(broken(folder, message.into()));
        }
        let path = folder.join(MANIFEST);
        let text = read_text(&path)
            .map_err(|error| broken(&path, format!("it cannot be read ({error}); this is no checkpoint")))?;
        let manifest: Manifest<P> = serde_json::from_str(&text).map_err(|error| {
            broken(&path, format!("it is truncated or foreign ({error}); use an older checkpoint"))
        })?;
        if manifest.format != FORMAT {
            return Err(broken(&path, format!("its format is `{}`, expected `{FORMAT}`", manifest.format)));
        }
        if manifest.robot != robot {
            return Err(broken(
                &path,
                format!("it belongs to robot `{}`, expected `{robot}`", manifest.robot),
            ));
        }
        check_names(folder, &manifest.files)?;
        for file in &manifest.files {
            verify(&folder.join(&file.name), file)?;
        }
        Ok(Self { folder: folder.to_owned(), progress: manifest.progress, files: manifest.files })
    }
}

/// Only what the manifest lists can be read, and only as it lists it.
impl<P> Files for Checkpoint<P> {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn read(&self, name: &str, limit: u64) -> Result<Vec<u8>> {
        let path = self.path(name);
        let expected = self.files.iter().find(|file| file.name == name);
        let expected = expected
            .ok_or_else(|| broken(&path, format!("{MANIFEST} does not list it; use an older checkpoint")))?;
        let bytes = read_regular(&path, limit).map_err(|error| unreadable(&path, &error))?;
        expected.check(&path, bytes.len() as u64, crc32fast::hash(&bytes))?;
        Ok(bytes)
    }
}

impl Checkpoint {
    /// Whether a run has a checkpoint.
    pub fn any(checkpoints: &Path) -> Result<bool> {
        Ok(!numbered(checkpoints)?.is_empty())
    }

    /// CRC-32 of the manifest, which lists the CRC-32 of every file: equal for equal checkpoints.
    pub fn fingerprint(&self) -> Result<String> {
        let path = self.folder.join(MANIFEST);
        let bytes = read_regular(&path, TEXT_BYTES).map_err(io(&path))?;
        Ok(format!("{:08x}", crc32fast::hash(&bytes)))
    }

    /// Reads the learner onto a device. It must have seen observations and taken actions of the same lengths.
    pub fn learner(&self, config: &PpoConfig, sizes: Sizes, device: &Device) -> Result<Ppo> {
        Ppo::load_for(self, config, Some(sizes), device)
    }

    /// Reads the envs and brings those of `engine` into their state; returns the sums over their running episodes.
    pub fn restore_envs(&self, engine: &mut dyn RolloutEngine) -> Result<EpisodeTracker> {
        let state = EnvState::load(self)?;
        engine
            .restore(&state.envs)
            .map_err(|error| broken(&self.folder, format!("its envs are not those of this run ({error})")))?;
        Ok(state.episodes)
    }
}

fn broken(path: &Path, message: String) -> LearnError {
    LearnError::Checkpoint { path: path.to_owned(), message }
}

const ADVICE: &str = "remove this checkpoint to go on from the one before";

fn unreadable(path: &Path, error: &std::io::Error) -> LearnError {
    broken(path, format!("it cannot be read ({error}); {ADVICE}"))
}

impl FileEntry {
    fn check(&self, path: &Path, bytes: u64, crc32: u32) -> Result<()> {
        if bytes != self.bytes {
            return Err(broken(path, format!("it has {bytes} bytes, expected {}; {ADVICE}", self.bytes)));
        }
        if crc32 != self.crc32 {
            return Err(broken(
                path,
                format!("its CRC-32 is {crc32:08x}, expected {:08x}; {ADVICE}", self.crc32),
            ));
        }
        Ok(())
    }
}

/// Fails unless the folder holds what its manifest lists, and nothing else.
fn check_names(folder: &Path, files: &[FileEntry]) -> Result<()> {
    let path = folder.join(MANIFEST);
    let mut listed = BTreeSet::from([MANIFEST]);
    for file in files {
        if !is_file_name(&file.name) {
            return Err(broken(
                &path,
                format!("it lists `{}`, expected names of files in its folder", file.name),
            ));
        }
        if !listed.insert(&file.name) {
            return Err(broken(&path, format!("it lists `{}` twice", file.name)));
        }
    }
    files::check_names(folder, |name| listed.contains(name)).map_err(|path| {
        broken(&path, format!("{MANIFEST} does not list it; remove it, or use an older checkpoint"))
    })
}

/// Compares a file with what the manifest says of it, without taking it into memory.
fn verify(path: &Path, expected: &FileEntry) -> Result<()> {
    let (file, length) = open_regular(path).map_err(|error| unreadable(path, &error))?;
    if length != expected.bytes {
        return expected.check(path, length, expected.crc32);
    }
    if length > LONGEST {
        return Err(broken(path, format!("it has {length} bytes, expected at most {LONGEST}; {ADVICE}")));
    }
    let (mut hasher, mut file) = (crc32fast::Hasher::new(), file.take(length));
    let (mut buffer, mut bytes) = (vec![0; 1 << 16], 0);
    loop {
        let count = file.read(&mut buffer).map_err(|error| unreadable(path, &error))?;
        if count == 0 {
            return expected.check(path, bytes, hasher.finalize());
        }
        hasher.update(&buffer[..count]);
        bytes += count as u64;
    }
}

/// Lists the files of a new checkpoint.
fn list(folder: &Path) -> Result<Vec<FileEntry>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(io(folder))? {
        let path = entry.map_err(io(folder))?.path();
        let bytes = read_regular(&path, LONGEST).map_err(io(&path))?;
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        files.push(FileEntry { name, bytes: bytes.len() as u64, crc32: crc32fast::hash(&bytes) });
    }
    files.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(files)
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

/// Whether a folder holds files of checkpoints alone.
fn is_ours(folder: &Path) -> bool {
    let is_folder = fs::symlink_metadata(folder).is_ok_and(|found| found.is_dir());
    is_folder
        && fs::read_dir(folder).is_ok_and(|mut entries| {
            entries.all(|entry| entry.is_ok_and(|entry| FILES.iter().any(|name| entry.file_name() == **name)))
        })
}
