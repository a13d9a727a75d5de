//! The files of a dataset must not hold a rollout twice.

use std::fs;
use std::ops::Range;
use std::path::Path;

use dappo_learn::error::{FileKind, Result};
use dappo_learn::files::{io, open_regular};

use super::header::DatasetHeader;
use super::npy::HEADER_BYTES;
use super::part::count_records;
use super::reader::first_rollout;

/// Fails if another file than the one that begins with the first rollout of `range` holds some of them.
pub fn check_piece(folder: &Path, header: &DatasetHeader, range: &Range<usize>) -> Result<()> {
    for entry in fs::read_dir(folder).map_err(io(folder))? {
        let path = entry.map_err(io(folder))?.path();
        let Some(first) = first_rollout(&path).filter(|&first| first != range.start) else { continue };
        let (file, bytes) = open_regular(&path).map_err(io(&path))?;
        if first >= range.end || bytes < HEADER_BYTES as u64 {
            continue;
        }
        let end = first.saturating_add(count_records(&path, &file, &header.fields(), header.record_bytes())?);
        if end > first && end > range.start {
            return Err(FileKind::Dataset.unusable(
                path,
                format!(
                    "it holds the rollouts {first} to {}, of which this command would collect some again ({} to {}): \
                     all pieces of a dataset need the same number of rollouts and of pieces",
                    end - 1,
                    range.start,
                    range.end - 1
                ),
            ));
        }
    }
    Ok(())
}
