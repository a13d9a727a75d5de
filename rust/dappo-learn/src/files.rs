//! Writing files so that a kill leaves the old or the new one, never half of either.

use std::fs::{self, File};
use std::io::Write;
use std::path::Path;

use crate::error::{LearnError, Result};

/// Turns an I/O error into one that names the file.
pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> LearnError {
    let path = path.to_owned();
    move |source| LearnError::Io { path, source }
}

/// Writes a file under a temporary name, syncs it and renames it, so that a kill leaves the old or the new file.
pub(crate) fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(io(folder))?;
    }
    let temporary = path.with_extension("tmp");
    write_synced(&temporary, bytes)?;
    fs::rename(&temporary, path).map_err(io(path))
}

/// Writes a file and waits until it is on the disk.
pub(crate) fn write_synced(path: &Path, bytes: &[u8]) -> Result<()> {
    let mut file = File::create(path).map_err(io(path))?;
    file.write_all(bytes).map_err(io(path))?;
    file.sync_all().map_err(io(path))
}
