//! Reading the records of a dataset in any order, a window at a time.

use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use dappo_learn::error::{FileKind, LearnError, Result};
use dappo_learn::files::{io, open_regular};

use super::header::DatasetHeader;
use super::npy::HEADER_BYTES;
use super::part::count_records;
use crate::{PairSource, Twin, Window};

/// The most windows that a dataset is divided into for training: a list of them has 4 GiB.
const MOST_WINDOWS: usize = 1 << 28;

/// A file of records.
struct Shelf {
    path: PathBuf,
    file: File,
    /// Number of its first rollout.
    first: usize,
    count: usize,
}

/// A folder of records, read in place: the operating system keeps in memory what is used often.
pub struct Dataset {
    header: DatasetHeader,
    shelves: Vec<Shelf>,
    rollouts: usize,
    /// Offset of each field in a record, by name.
    offsets: Vec<(&'static str, usize)>,
}

impl Dataset {
    /// Opens a folder.
    pub fn open(folder: &Path) -> Result<Self> {
        let header = DatasetHeader::read(folder)?;
        let mut shelves = Vec::new();
        for entry in fs::read_dir(folder).map_err(io(folder))? {
            let path = entry.map_err(io(folder))?.path();
            if let Some(first) = first_rollout(&path) {
                shelves.push(Shelf::open(path, &header, first)?);
            }
        }
        shelves.retain(|shelf| shelf.count > 0);
        shelves.sort_by_key(|shelf| shelf.first);
        for pair in shelves.windows(2) {
            if pair[0].first.saturating_add(pair[0].count) > pair[1].first {
                return Err(FileKind::Dataset.unusable(
                    &pair[1].path,
                    format!(
                        "its first rollout is also in {}, which holds {} from number {} on; move one of them away",
                        pair[0].path.display(),
                        pair[0].count,
                        pair[0].first
                    ),
                ));
            }
        }
        let rollouts = shelves.iter().fold(0_usize, |sum, shelf| sum.saturating_add(shelf.count));
        if rollouts > MOST_WINDOWS / header.subject.classes() {
            return Err(FileKind::Dataset.unusable(
                folder,
                format!(
                    "it holds {rollouts} rollouts of {} classes, expected at most {MOST_WINDOWS} windows",
                    header.subject.classes()
                ),
            ));
        }
        if rollouts == 0 {
            return Err(FileKind::Dataset.unusable(folder, "it holds no rollout yet"));
        }
        let mut end = 0;
        let fields = header.fields();
        let offsets = fields.iter().map(|field| {
            end += field.bytes();
            (field.name(), end - field.bytes())
        });
        Ok(Self { offsets: offsets.collect(), header, shelves, rollouts })
    }

    /// What the records are.
    #[must_use]
    pub fn header(&self) -> &DatasetHeader {
        &self.header
    }

    /// Whether the robot was out of its range of heights when the window began: a run would have ended before.
    pub fn fallen(&self, rollout: usize, class: usize) -> Result<bool> {
        let mut bytes = [0; 4];
        self.bytes(rollout, "fallen", 4 * class, &mut bytes)?;
        Ok(u32::from_le_bytes(bytes) != 0)
    }

    fn has(&self, name: &str) -> bool {
        self.offsets.iter().any(|(known, _)| *known == name)
    }

    /// Reads from byte `begin` of a field on.
    fn bytes(&self, rollout: usize, name: &str, begin: usize, into: &mut [u8]) -> Result<()> {
        let mut index = rollout;
        for shelf in &self.shelves {
            if index < shelf.count {
                let record = HEADER_BYTES as u64 + index as u64 * self.header.record_bytes();
                let field = self.offsets.iter().find(|(known, _)| *known == name).map_or(0, |(_, at)| *at);
                return shelf
                    .file
                    .read_exact_at(into, record + (field + begin) as u64)
                    .map_err(io(&shelf.path));
            }
            index -= shelf.count;
        }
        Err(LearnError::Invalid(format!(
            "rollout {rollout} does not exist; the dataset holds {}",
            self.rollouts
        )))
    }

    /// The first `timesteps` rows of a class in a field `[C, T, width]`.
    fn rows(
        &self,
        (rollout, class): (usize, usize),
        name: &str,
        width: usize,
        timesteps: usize,
        into: &mut Vec<f32>,
    ) -> Result<()> {
        let mut bytes = vec![0; 4 * timesteps * width];
        self.bytes(rollout, name, 4 * class * self.header.timesteps * width, &mut bytes)?;
        into.clear();
        into.extend(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])));
        Ok(())
    }
}

impl PairSource for Dataset {
    fn rollouts(&self) -> usize {
        self.rollouts
    }

    fn classes(&self) -> usize {
        self.header.subject.classes()
    }

    fn twin(&self) -> Option<Twin> {
        self.header.twin
    }

    fn timesteps(&self) -> usize {
        self.header.timesteps
    }

    fn obs_dim(&self) -> usize {
        self.header.obs_dim
    }

    fn action_dim(&self) -> usize {
        self.header.action_dim
    }

    fn read(&self, rollout: usize, class: usize, timesteps: usize, window: &mut Window) -> Result<()> {
        let (classes, most) = (self.header.subject.classes(), self.header.timesteps);
        if class >= classes || timesteps > most {
            return Err(LearnError::Invalid(format!(
                "class {class} with {timesteps} steps does not exist; the dataset holds {classes} classes with {most}"
            )));
        }
        self.rows((rollout, class), "damaged", self.obs_dim(), timesteps, &mut window.damaged)?;
        self.rows((rollout, class), "actions", self.action_dim(), timesteps, &mut window.actions)?;
        window.twin.clear();
        if self.header.twin.is_none() {
            return Ok(());
        }
        let (field, class) = if self.has("twin") { ("twin", class) } else { ("damaged", 0) };
        self.rows((rollout, class), field, self.obs_dim(), timesteps, &mut window.twin)
    }
}

impl Shelf {
    fn open(path: PathBuf, header: &DatasetHeader, first: usize) -> Result<Self> {
        let (file, _) = open_regular(&path).map_err(io(&path))?;
        let count = count_records(&path, &file, &header.fields(), header.record_bytes())?;
        Ok(Self { path, file, first, count })
    }
}

/// The number in the name of a file of records.
pub(super) fn first_rollout(path: &Path) -> Option<usize> {
    path.file_name()?.to_str()?.strip_prefix("rollouts-")?.strip_suffix(".npy")?.parse().ok()
}
