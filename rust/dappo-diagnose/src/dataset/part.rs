//! One file of a dataset while it is being written.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

use dappo_learn::error::{FileKind, LearnError, Result};
use dappo_learn::files::{io, lock_in_place, put, step};

use super::header::DatasetHeader;
use super::npy::{self, Field, HEADER_BYTES};

/// One of several equal pieces of a dataset, so that several processes or machines can collect it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    /// Reads `i/n`, i from 0 to n − 1.
    pub fn parse(text: &str) -> Result<Self> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((index, count)) if index < count => Ok(Self { index, count }),
            _ => Err(LearnError::Config {
                key: "shard",
                got: format!("`{text}`"),
                expected: "i/n with i from 0 to n − 1, for example 0/4",
            }),
        }
    }

    /// The rollouts of this piece.
    #[must_use]
    pub fn range(self, rollouts: usize) -> Range<usize> {
        let first = |index: usize| (index as u128 * rollouts as u128 / self.count as u128) as usize;
        first(self.index)..first(self.index + 1)
    }
}

/// One rollout: all damage classes from the same start.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Record {
    /// Observations of the damaged robots, `[C, T, O]`.
    pub damaged: Vec<f32>,
    /// Their actions, `[C, T, A]`.
    pub actions: Vec<f32>,
    /// Observations of their twins, `[C, T, O]`; empty if class 0 is the twin of all, or without twins.
    pub twin: Vec<f32>,
    /// Steps before the damage.
    pub onset: u32,
    /// Steps between the damage and the window; to its end without twins.
    pub delay: u32,
    /// Whether each robot had fallen when the window began, `[C]`; without twins, whether it fell at its end, before the
    /// delay was over.
    pub fallen: Vec<bool>,
}

/// Writes a list of f32 or u32 as its bytes on disk.
macro_rules! put {
    ($bytes:expr, $values:expr) => {
        $bytes.extend($values.into_iter().flat_map(|value| value.to_le_bytes()))
    };
}

impl Record {
    fn write(&self, bytes: &mut Vec<u8>) {
        put!(bytes, &self.damaged);
        put!(bytes, &self.actions);
        put!(bytes, &self.twin);
        put!(bytes, [self.onset, self.delay]);
        put!(bytes, self.fallen.iter().map(|&fallen| u32::from(fallen)));
    }
}

/// A file of records that grows at its end; this process alone writes it.
#[derive(Debug)]
pub struct Part {
    path: PathBuf,
    file: File,
    fields: Vec<Field>,
    record_bytes: usize,
    count: usize,
}

impl Part {
    /// Opens the file whose first rollout is `first`, behind the last complete record if there are any.
    pub fn open(folder: &Path, header: &DatasetHeader, first: usize) -> Result<Self> {
        let path = folder.join(format!("rollouts-{first:06}.npy"));
        let Some(file) = lock_in_place(&path)? else {
            return Err(FileKind::Dataset.unusable(
                path,
                "another process is collecting these rollouts; wait for its end, or collect another shard",
            ));
        };
        let (fields, record_bytes) = (header.fields(), header.record_bytes() as usize);
        let count = count_records(&path, &file, &fields, header.record_bytes())?;
        let mut part = Self { path, file, fields, record_bytes, count };
        part.rewind().map_err(io(&part.path))?;
        Ok(part)
    }

    /// Records in the file.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Cuts off what a kill or a full disk has left behind the last complete record.
    fn rewind(&mut self) -> std::io::Result<()> {
        self.write_count()?;
        step(|| self.file.set_len((HEADER_BYTES + self.count * self.record_bytes) as u64))?;
        self.file.seek(SeekFrom::End(0)).map(|_| ())
    }

    fn write_count(&mut self) -> std::io::Result<()> {
        self.file.seek(SeekFrom::Start(0))?;
        put(&mut self.file, &npy::header(&self.fields, self.count))?;
        self.file.seek(SeekFrom::End(0)).map(|_| ())
    }

    /// Appends records. If that fails, those before are safe and the file is valid.
    pub fn append(&mut self, records: &[Record]) -> Result<()> {
        let mut bytes = Vec::with_capacity(records.len() * self.record_bytes);
        records.iter().for_each(|record| record.write(&mut bytes));
        debug_assert_eq!(bytes.len(), records.len() * self.record_bytes, "bytes of the records");
        // The records must be on the disk before the header counts them.
        let written =
            put(&mut self.file, &bytes).and_then(|()| step(|| self.file.sync_data())).and_then(|()| {
                self.count += records.len();
                self.write_count()
            });
        written.map_err(|source| {
            // Whether or not the room can be given back, the header holds how far the file is valid.
            let _ = self.rewind();
            FileKind::Dataset.unusable(
                &self.path,
                format!(
                    "writing failed ({source}); its {} rollouts are safe: make room, then give the same command again",
                    self.count
                ),
            )
        })
    }
}

/// The number of complete records in a file.
pub(super) fn count_records(path: &Path, file: &File, fields: &[Field], record_bytes: u64) -> Result<usize> {
    let length = file.metadata().map_err(io(path))?.len();
    let mut begin = Vec::with_capacity(HEADER_BYTES);
    file.take(HEADER_BYTES as u64).read_to_end(&mut begin).map_err(io(path))?;
    let is_short = length <= HEADER_BYTES as u64;
    if is_short && npy::is_unfinished(fields, &begin) {
        return Ok(0);
    }
    // Records are on the disk before the header counts them.
    let complete = (length.saturating_sub(HEADER_BYTES as u64) / record_bytes) as usize;
    let counted = npy::count(fields, &begin).or_else(|| npy::is_torn(fields, &begin).then_some(complete));
    match counted {
        Some(count) if count <= complete => Ok(count),
        Some(count) => Err(FileKind::Dataset.unusable(
            path,
            format!(
                "it has {length} bytes, expected those of {count} rollouts; it was truncated after it was written: \
                 move it away"
            ),
        )),
        None => Err(FileKind::Dataset
            .unusable(path, "its header does not fit the dataset.json next to it; move the file away")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use std::fs;
    use std::sync::Barrier;
    use std::thread;

    use super::super::{Dataset, PolicyId};
    use crate::{PairSource, Subject, Timing, Twin};
    use dappo_learn::files::testing::Scratch;
    use dappo_learn::files::testing::everywhere;

    fn small_header() -> DatasetHeader {
        let policy = PolicyId { run: "runs/a".into(), fingerprint: "0".into(), env_steps: 1 };
        DatasetHeader {
            format: DatasetHeader::format(),
            subject: Subject {
                robot: "biped".into(),
                class_names: vec!["healthy".into(), "broken".into()],
                codes: vec![vec![0], vec![1]],
            },
            severity: dappo_sim::Severity::Same(1.0),
            seed: 0,
            timesteps: 3,
            obs_dim: 40,
            action_dim: 2,
            timing: Timing::default(),
            twin: Some(Twin::default()),
            expert: policy.clone(),
            policy,
            backend: "lanes".into(),
            precision: "f32".into(),
        }
    }

    /// Rollouts that differ.
    fn record(rollout: usize) -> Record {
        let rows = |numbers: usize| vec![rollout as f32; numbers];
        Record {
            damaged: rows(2 * 3 * 40),
            actions: rows(2 * 3 * 2),
            twin: Vec::new(),
            onset: 0,
            delay: 0,
            fallen: vec![false, true],
        }
    }

    /// Collects the missing ones of twelve rollouts, in blocks.
    fn collect(folder: &Path) -> Result<()> {
        let header = small_header();
        header.write_or_match(folder)?;
        let mut part = Part::open(folder, &header, 0)?;
        while part.count() < 12 {
            let block = part.count()..(part.count() + 5).min(12);
            part.append(&block.map(record).collect::<Vec<_>>())?;
        }
        Ok(())
    }

    #[test]
    fn a_fault_at_any_call_leaves_a_dataset_that_the_same_command_goes_on_with() {
        let whole = Scratch::new();
        collect(&whole.0).unwrap();
        let expected = fs::read(whole.0.join("rollouts-000000.npy")).unwrap();
        assert_eq!(expected.len() as u64, HEADER_BYTES as u64 + 12 * small_header().record_bytes());
        let calls = everywhere(
            Scratch::new,
            |folder| collect(&folder.0),
            |folder, result, fault, call| {
                assert!(result.is_err(), "{fault:?} at {call}");
                let path = folder.0.join("rollouts-000000.npy");
                if path.exists() {
                    match Dataset::open(&folder.0) {
                        Ok(data) => {
                            for rollout in 0..data.rollouts() {
                                let mut window = crate::Window::default();
                                data.read(rollout, 1, 3, &mut window).unwrap();
                                assert_eq!(
                                    window.damaged,
                                    vec![rollout as f32; 3 * 40],
                                    "{fault:?} at {call}"
                                );
                            }
                        }
                        Err(error) => assert!(error.to_string().contains("holds no rollout yet"), "{error}"),
                    }
                }
                collect(&folder.0).unwrap();
                assert_eq!(fs::read(path).unwrap(), expected, "{fault:?} at {call}");
                assert_eq!(folder.names(), ["dataset.json", "rollouts-000000.npy"], "{fault:?} at {call}");
            },
        );
        assert!(calls > 12, "{calls}");
    }

    #[test]
    fn a_shard_is_collected_by_one_process_and_other_shards_at_the_same_time() {
        let (folder, header) = (Scratch::new(), small_header());
        let mut part = Part::open(&folder.0, &header, 0).unwrap();
        let refused = Part::open(&folder.0, &header, 0).unwrap_err().to_string();
        assert!(refused.contains("another process is collecting these rollouts"), "{refused}");
        Part::open(&folder.0, &header, 6).unwrap();
        part.append(&[record(0)]).unwrap();
        drop(part);
        assert_eq!(Part::open(&folder.0, &header, 0).unwrap().count(), 1);
    }

    #[test]
    fn the_folder_is_the_same_wherever_the_run_of_its_policy_lies() {
        let (folder, header) = (Scratch::new(), small_header());
        header.write_or_match(&folder.0).unwrap();
        let mut moved = header.clone();
        moved.expert.run = "/elsewhere/a".into();
        moved.write_or_match(&folder.0).unwrap();
        moved.expert.fingerprint = "1".into();
        let refused = moved.write_or_match(&folder.0).unwrap_err().to_string();
        assert!(refused.contains("records with `expert`"), "{refused}");
    }

    #[test]
    fn a_header_of_an_earlier_version_calls_the_policy_before_the_window_walker() {
        let (folder, header) = (Scratch::new(), small_header());
        header.write_or_match(&folder.0).unwrap();
        let path = folder.0.join("dataset.json");
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains("\"policy\": {"), "{text}");
        fs::write(&path, text.replace("\"policy\": {", "\"walker\": {")).unwrap();
        assert_eq!(DatasetHeader::read(&folder.0).unwrap(), header);
        header.write_or_match(&folder.0).unwrap();
    }

    #[test]
    fn of_pieces_with_different_settings_that_begin_together_only_those_of_one_setting_go_on() {
        for _ in 0..50 {
            let folder = Scratch::new();
            let begin = Barrier::new(4);
            let header = |seed| DatasetHeader { seed, ..small_header() };
            let outcomes: Vec<Result<()>> = thread::scope(|scope| {
                let pieces = [0, 1, 0, 1].map(|seed| {
                    let (folder, begin) = (&folder, &begin);
                    scope.spawn(move || {
                        begin.wait();
                        header(seed).write_or_match(&folder.0)
                    })
                });
                pieces.map(|piece| piece.join().unwrap()).into()
            });
            let kept = DatasetHeader::read(&folder.0).unwrap().seed;
            for (seed, outcome) in [0, 1, 0, 1].into_iter().zip(outcomes) {
                match outcome {
                    Ok(()) => assert_eq!(seed, kept),
                    Err(error) => {
                        assert_ne!(seed, kept, "{error}");
                        assert!(error.to_string().contains("records with `seed`"), "{error}");
                    }
                }
            }
            assert_eq!(folder.names(), ["dataset.json"]);
        }
    }

    #[test]
    fn headers_of_sizes_that_no_record_has_and_files_shorter_than_their_headers_are_rejected() {
        let folder = Scratch::new();
        collect(&folder.0).unwrap();
        let path = folder.0.join("dataset.json");
        let text = fs::read_to_string(&path).unwrap();
        let refuse = |from: &str, to: &str, expected: &str| {
            assert!(text.contains(from), "{text}");
            fs::write(&path, text.replace(from, to)).unwrap();
            let message = Dataset::open(&folder.0).err().unwrap().to_string();
            assert!(message.contains("dataset.json") && message.contains(expected), "{message}");
        };
        refuse("\"timesteps\": 3", "\"timesteps\": 0", "timesteps is 0");
        refuse("\"timesteps\": 3", "\"timesteps\": 1000000000000", "record fewer steps");
        refuse("\"obs_dim\": 40", "\"obs_dim\": 9223372036854775807", "record fewer steps");
        refuse("\"obs_dim\": 40", "\"obs_dim\": -1", "truncated or foreign");
        fs::write(&path, text).unwrap();
        let data = folder.0.join("rollouts-000000.npy");
        let bytes = fs::read(&data).unwrap();
        fs::write(&data, &bytes[..bytes.len() - 1]).unwrap();
        let refused = Dataset::open(&folder.0).err().unwrap().to_string();
        assert!(refused.contains("truncated after it was written"), "{refused}");
        assert!(collect(&folder.0).unwrap_err().to_string().contains("truncated after it was written"));
        fs::write(&data, "notes of a user").unwrap();
        assert!(collect(&folder.0).unwrap_err().to_string().contains("move the file away"));
        assert_eq!(fs::read(&data).unwrap(), b"notes of a user");
    }

    #[test]
    fn shards_cut_the_rollouts_into_pieces_without_gap_or_overlap() {
        for (rollouts, count) in [(10, 3), (2, 5), (7, 7)] {
            let ranges = (0..count).map(|i| Shard::parse(&format!("{i}/{count}")).unwrap().range(rollouts));
            assert_eq!(ranges.flatten().collect::<Vec<_>>(), (0..rollouts).collect::<Vec<_>>());
        }
        assert_eq!(Shard { index: 0, count: 1 }.range(9), 0..9);
    }

    #[test]
    fn shards_that_do_not_exist_are_rejected() {
        for text in ["3/3", "1", "a/2", "-1/2", "0/0"] {
            assert!(Shard::parse(text).unwrap_err().to_string().contains(text), "{text}");
        }
    }
}
