//! One file of a dataset while it is being written.

use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use super::header::Header;
use super::npy::{self, Field, HEADER_BYTES};
use crate::error::{LearnError, Result};
use crate::files::io;

/// One of several equal pieces of a dataset, so that several processes or machines can collect it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    /// The only piece.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

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
        self.index * rollouts / self.count..(self.index + 1) * rollouts / self.count
    }
}

/// One rollout: all damage classes from the same start.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Record {
    /// Observations of the damaged robots, `[C, T, O]`.
    pub damaged: Vec<f32>,
    /// Their actions, `[C, T, A]`.
    pub actions: Vec<f32>,
    /// Observations of their twins, `[C, T, O]`; empty if class 0 is the twin of all.
    pub twin: Vec<f32>,
    /// Steps before the damage.
    pub onset: u32,
    /// Steps between the damage and the window.
    pub delay: u32,
    /// Whether each robot was out of its range of heights when the window began, `[C]`.
    pub fallen: Vec<bool>,
}

/// Puts a list of f32 or u32 into its bytes on disk.
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

/// A file of records that grows at its end.
pub struct Part {
    path: PathBuf,
    file: File,
    fields: Vec<Field>,
    record_bytes: usize,
    count: usize,
}

impl Part {
    /// Opens the file whose first rollout is `first`, behind the last complete record if there are any.
    pub fn open(folder: &Path, header: &Header, first: usize) -> Result<Self> {
        let path = folder.join(format!("rollouts-{first:06}.npy"));
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(io(&path))?;
        let (fields, record_bytes) = (header.fields(), header.record_bytes() as usize);
        // A kill within the first write leaves less than a header.
        let has_header = file.metadata().map_err(io(&path))?.len() >= HEADER_BYTES as u64;
        let count = if has_header { count_records(&path, &file, &fields)? } else { 0 };
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
        self.file.set_len((HEADER_BYTES + self.count * self.record_bytes) as u64)?;
        self.write_count()
    }

    fn write_count(&mut self) -> std::io::Result<()> {
        self.file.seek(SeekFrom::Start(0))?;
        self.file.write_all(&npy::header(&self.fields, self.count))?;
        self.file.seek(SeekFrom::End(0)).map(|_| ())
    }

    /// Appends records. If that fails, those before are safe and the file is valid.
    pub fn append(&mut self, records: &[Record]) -> Result<()> {
        let mut bytes = Vec::with_capacity(records.len() * self.record_bytes);
        records.iter().for_each(|record| record.write(&mut bytes));
        debug_assert_eq!(bytes.len(), records.len() * self.record_bytes, "bytes of the records");
        // The records must be on the disk before the header counts them.
        let written = self.file.write_all(&bytes).and_then(|()| self.file.sync_data()).and_then(|()| {
            self.count += records.len();
            self.write_count()
        });
        written.map_err(|source| {
            // Whether or not the room can be given back, the header tells how far the file is valid.
            let _ = self.rewind();
            LearnError::Dataset {
                path: self.path.clone(),
                message: format!(
                    "writing failed ({source}); its {} rollouts are safe: make room, then give the same command again",
                    self.count
                ),
            }
        })
    }
}

/// The number of records that the header of a file tells.
pub(super) fn count_records(path: &Path, mut file: &File, fields: &[Field]) -> Result<usize> {
    let mut begin = vec![0; HEADER_BYTES];
    file.read_exact(&mut begin).map_err(io(path))?;
    npy::count(fields, &begin).ok_or_else(|| LearnError::Dataset {
        path: path.to_owned(),
        message: "its header does not fit the dataset.json beside it; move the file away".into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_cut_the_rollouts_into_pieces_without_gap_or_overlap() {
        for (rollouts, count) in [(10, 3), (2, 5), (7, 7)] {
            let ranges = (0..count).map(|i| Shard::parse(&format!("{i}/{count}")).unwrap().range(rollouts));
            assert_eq!(ranges.flatten().collect::<Vec<_>>(), (0..rollouts).collect::<Vec<_>>());
        }
        assert_eq!(Shard::WHOLE.range(9), 0..9);
    }

    #[test]
    fn shards_that_do_not_exist_are_refused() {
        for text in ["3/3", "1", "a/2", "-1/2", "0/0"] {
            assert!(Shard::parse(text).unwrap_err().to_string().contains(text), "{text}");
        }
    }
}
