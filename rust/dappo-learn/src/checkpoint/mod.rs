//! Checkpoints: a folder with everything that the rest of a run depends on.
//!
//! A checkpoint is written under a temporary name, synced and renamed, so that a kill at any moment leaves
//! the previous ones. Its `manifest.json` lists every file with length and CRC-32; a checkpoint that does
//! not match is refused by name.

mod env_state;

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::engine::RolloutEngine;
use crate::envs::Sizes;
use crate::episodes::EpisodeTracker;
use crate::error::{LearnError, Result};
use crate::files::{io, write_new};
use crate::ppo::{Ppo, PpoConfig};

pub use env_state::EnvState;

const FORMAT: &str = "dappo-batch checkpoint 1";
const MANIFEST: &str = "manifest.json";
/// Where a checkpoint is written before it gets its number.
const TEMPORARY: &str = ".new.tmp";

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

#[derive(Debug, Serialize, Deserialize)]
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
        let name = format!("{:08}", progress.number());
        let (temporary, folder) = (checkpoints.join(TEMPORARY), checkpoints.join(&name));
        remove_folder(&temporary)?;
        fs::create_dir_all(&temporary).map_err(io(&temporary))?;
        fill(&temporary)?;
        let manifest =
            Manifest { format: FORMAT.into(), robot: robot.into(), progress, files: list(&temporary)? };
        let text =
            serde_json::to_string_pretty(&manifest).map_err(|error| broken(&temporary, error.to_string()))?;
        write_new(&temporary.join(MANIFEST), text.as_bytes())?;
        remove_folder(&folder)?;
        fs::rename(&temporary, &folder).map_err(io(&folder))?;
        sync_folder(checkpoints)?;
        for old in numbered(checkpoints)?.into_iter().rev().skip(keep) {
            remove_folder(&old)?;
        }
        Ok(())
    }

    /// Opens the newest checkpoint of a run and verifies it.
    pub fn newest(checkpoints: &Path, robot: &str) -> Result<Self> {
        let newest = numbered(checkpoints)?.pop();
        let folder = newest.ok_or_else(|| broken(checkpoints, "the folder holds no checkpoint".into()))?;
        Self::open(&folder, robot)
    }

    /// Opens one checkpoint and verifies it.
    pub fn open(folder: &Path, robot: &str) -> Result<Self> {
        let path = folder.join(MANIFEST);
        let text = fs::read_to_string(&path)
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
        for file in &manifest.files {
            verify(&folder.join(&file.name), file)?;
        }
        Ok(Self { folder: folder.to_owned(), progress: manifest.progress })
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
        fs::read(&path).map(|bytes| format!("{:08x}", crc32fast::hash(&bytes))).map_err(io(&path))
    }

    /// Reads the learner onto a device. It must have seen observations and taken actions of the same lengths.
    pub fn learner(&self, config: &PpoConfig, sizes: Sizes, device: &Device) -> Result<Ppo> {
        let ppo = Ppo::load(&self.folder, config, device)?;
        for (what, got, expected) in [
            ("length of an observation", ppo.actor_critic().obs_dim(), sizes.obs_dim),
            ("length of an action", ppo.actor_critic().action_dim(), sizes.action_dim),
        ] {
            if got != expected {
                let (got, expected) = (got.to_string(), expected.to_string());
                return Err(LearnError::Mismatch { path: self.folder.clone(), what, got, expected });
            }
        }
        Ok(ppo)
    }

    /// Reads the envs and brings those of `engine` into their state; returns the sums over their running episodes.
    pub fn restore_envs(&self, engine: &mut dyn RolloutEngine) -> Result<EpisodeTracker> {
        let state = EnvState::load(&self.folder)?;
        engine
            .restore(&state.envs)
            .map_err(|error| broken(&self.folder, format!("its envs are not those of this run ({error})")))?;
        Ok(state.episodes)
    }
}

fn broken(path: &Path, message: String) -> LearnError {
    LearnError::Checkpoint { path: path.to_owned(), message }
}

fn verify(path: &Path, expected: &FileEntry) -> Result<()> {
    let advice = "remove this checkpoint to go on from the one before";
    let bytes =
        fs::read(path).map_err(|error| broken(path, format!("it cannot be read ({error}); {advice}")))?;
    if bytes.len() as u64 != expected.bytes {
        return Err(broken(
            path,
            format!("it has {} bytes, expected {}; {advice}", bytes.len(), expected.bytes),
        ));
    }
    let found = crc32fast::hash(&bytes);
    if found != expected.crc32 {
        return Err(broken(
            path,
            format!("its CRC-32 is {found:08x}, expected {:08x}; {advice}", expected.crc32),
        ));
    }
    Ok(())
}

/// Lists the files of a new checkpoint and waits until they are on the disk.
fn list(folder: &Path) -> Result<Vec<FileEntry>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(io(folder))? {
        let path = entry.map_err(io(folder))?.path();
        let bytes = fs::read(&path).map_err(io(&path))?;
        File::open(&path).and_then(|file| file.sync_all()).map_err(io(&path))?;
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        files.push(FileEntry { name, bytes: bytes.len() as u64, crc32: crc32fast::hash(&bytes) });
    }
    files.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(files)
}

/// Checkpoint folders in ascending order.
fn numbered(checkpoints: &Path) -> Result<Vec<PathBuf>> {
    if !checkpoints.exists() {
        return Ok(Vec::new());
    }
    let mut found = Vec::new();
    for entry in fs::read_dir(checkpoints).map_err(io(checkpoints))? {
        let path = entry.map_err(io(checkpoints))?.path();
        let is_number =
            path.file_name().is_some_and(|name| name.to_string_lossy().bytes().all(|c| c.is_ascii_digit()));
        if path.is_dir() && is_number {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

fn remove_folder(folder: &Path) -> Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(io(folder)(error)),
        _ => Ok(()),
    }
}

/// Makes a rename durable; only Unix can sync a folder.
fn sync_folder(folder: &Path) -> Result<()> {
    if cfg!(unix) {
        File::open(folder).and_then(|file| file.sync_all()).map_err(io(folder))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("dappo-checkpoint-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        path
    }

    fn write(at: &Path, iteration: u64, content: &str) {
        let progress = Progress { iteration, env_steps: iteration * 10, stage: 0 };
        Checkpoint::write(at, "ant", progress, 2, |folder| {
            write_new(&folder.join("weights"), content.as_bytes())
        })
        .unwrap();
    }

    #[test]
    fn the_newest_checkpoint_is_found_and_old_ones_go() {
        let at = folder("newest");
        for iteration in [1, 2, 3] {
            write(&at, iteration, "content");
        }
        assert_eq!(Checkpoint::<Progress>::newest(&at, "ant").unwrap().progress.iteration, 3);
        assert_eq!(numbered(&at).unwrap().len(), 2);
        fs::remove_dir_all(at).unwrap();
    }

    #[test]
    fn a_half_written_checkpoint_is_ignored() {
        let at = folder("half");
        write(&at, 1, "content");
        fs::create_dir_all(at.join(TEMPORARY)).unwrap();
        fs::write(at.join(TEMPORARY).join("weights"), "cont").unwrap();
        assert_eq!(Checkpoint::<Progress>::newest(&at, "ant").unwrap().progress.iteration, 1);
        fs::remove_dir_all(at).unwrap();
    }

    #[test]
    fn damaged_and_foreign_checkpoints_are_refused_by_name() {
        let at = folder("refused");
        write(&at, 1, "content");
        let weights = at.join("00000001/weights");
        let message = |expected_robot: &str| {
            Checkpoint::<Progress>::newest(&at, expected_robot).unwrap_err().to_string()
        };
        assert!(message("hexapod").contains("belongs to robot `ant`"));
        fs::write(&weights, "conte").unwrap();
        assert!(message("ant").contains("weights") && message("ant").contains("5 bytes, expected 7"));
        fs::write(&weights, "consent").unwrap();
        assert!(message("ant").contains("CRC-32"));
        fs::remove_file(&weights).unwrap();
        assert!(message("ant").contains("weights"));
        fs::write(at.join("00000001").join(MANIFEST), "{\"format\": \"dap").unwrap();
        assert!(message("ant").contains("truncated or foreign"));
        fs::remove_dir_all(at).unwrap();
    }
}
