//! A folder that appears whole or not at all, and whose files are known by their SHA-256.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::header::{FORMAT, FileHeader, Header};
use super::unusable;
use crate::error::{LearnError, Result};
use crate::files::{io, write_new};

const HEADER: &str = "export.json";

/// What a file is known by.
pub(super) fn fingerprint(bytes: &[u8]) -> FileHeader {
    let mut sha256 = String::new();
    for byte in Sha256::digest(bytes) {
        let _ = write!(sha256, "{byte:02x}");
    }
    FileHeader { bytes: bytes.len() as u64, sha256 }
}

/// An export that is written but not yet where it belongs. It vanishes unless it is [committed](Staged::commit).
pub struct Staged {
    folder: PathBuf,
    out: PathBuf,
}

impl Staged {
    /// Fails unless `out` is new, empty, or an export that may be replaced.
    pub fn check(out: &Path) -> Result<()> {
        let is_free = match fs::read_dir(out) {
            Err(error) => error.kind() == std::io::ErrorKind::NotFound && out.file_name().is_some(),
            Ok(mut entries) => entries.next().is_none() || format_of(out).is_some(),
        };
        if is_free {
            return Ok(());
        }
        Err(LearnError::Invalid(format!(
            "{} is neither new nor an export that could be replaced; choose another folder",
            out.display()
        )))
    }

    /// Writes the files and the header into a folder beside `out`, and waits until they are on the disk.
    pub(super) fn write(out: &Path, header: &Header, files: &BTreeMap<String, Vec<u8>>) -> Result<Self> {
        Self::check(out)?;
        let out = std::path::absolute(out).map_err(io(out))?;
        let staged = Self { folder: beside(&out, "new"), out };
        remove(&staged.folder)?;
        fs::create_dir_all(&staged.folder).map_err(io(&staged.folder))?;
        for (name, bytes) in files {
            write_new(&staged.folder.join(name), bytes)?;
        }
        let text = serde_json::to_string_pretty(header)
            .map_err(|error| unusable(&staged.folder, error.to_string()))?;
        write_new(&staged.folder.join(HEADER), (text + "\n").as_bytes())?;
        sync(&staged.folder)?;
        Ok(staged)
    }

    /// Where the export lies until it is committed.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Puts the export where it belongs, in place of an earlier one.
    pub fn commit(self) -> Result<()> {
        Self::check(&self.out)?;
        let parent = self.out.parent().unwrap_or(&self.out);
        // After an exchange the old export has the temporary name, and goes when `self` does.
        if format_of(&self.out).is_some() && exchange(&self.folder, &self.out) {
            return sync(parent);
        }
        let old = beside(&self.out, "old");
        remove(&old)?;
        if self.out.exists() {
            fs::rename(&self.out, &old).map_err(io(&self.out))?;
        }
        fs::rename(&self.folder, &self.out).map_err(io(&self.out))?;
        remove(&old)?;
        sync(parent)
    }
}

impl Drop for Staged {
    fn drop(&mut self) {
        // What cannot be removed now is removed by the next export.
        let _ = remove(&self.folder);
    }
}

/// Reads the header of an export and checks every file that it names.
pub(super) fn open(folder: &Path) -> Result<Header> {
    let path = folder.join(HEADER);
    let text = fs::read_to_string(&path).map_err(|error| {
        unusable(&path, format!("it cannot be read ({error}); `dappo-batch export` makes such a folder"))
    })?;
    let found = format_of(folder).unwrap_or_else(|| "missing".into());
    if found != FORMAT {
        return Err(unusable(&path, format!("its format is `{found}`, expected `{FORMAT}`")));
    }
    let header: Header = serde_json::from_str(&text)
        .map_err(|error| unusable(&path, format!("it is broken or foreign ({error})")))?;
    for name in header.files.keys() {
        read(folder, &header, name)?;
    }
    Ok(header)
}

/// Reads a file that the header lists, and fails if it is another one.
pub(super) fn read(folder: &Path, header: &Header, name: &str) -> Result<Vec<u8>> {
    let path = folder.join(name);
    let expected =
        header.files.get(name).ok_or_else(|| unusable(&path, "the export does not list it".into()))?;
    let bytes = fs::read(&path)
        .map_err(|error| unusable(&path, format!("it cannot be read ({error}); export again")))?;
    let found = fingerprint(&bytes);
    if found != *expected {
        let message = format!(
            "it has {} bytes with SHA-256 {}, expected {} with {}; export again",
            found.bytes, found.sha256, expected.bytes, expected.sha256
        );
        return Err(unusable(&path, message));
    }
    Ok(bytes)
}

/// What the header says it is, if there is one.
fn format_of(folder: &Path) -> Option<String> {
    let text = fs::read_to_string(folder.join(HEADER)).ok()?;
    let header: serde_json::Value = serde_json::from_str(&text).ok()?;
    let format = header.get("format")?.as_str()?;
    format.starts_with("dappo-batch export").then(|| format.to_owned())
}

/// A hidden neighbour of a folder.
fn beside(folder: &Path, what: &str) -> PathBuf {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    folder.with_file_name(format!(".{name}.{what}.tmp"))
}

fn remove(folder: &Path) -> Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(io(folder)(error)),
        _ => Ok(()),
    }
}

/// Lets two folders change their names in one step, where the system can do that.
#[cfg(target_os = "linux")]
fn exchange(one: &Path, other: &Path) -> bool {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    renameat_with(CWD, one, CWD, other, RenameFlags::EXCHANGE).is_ok()
}

#[cfg(not(target_os = "linux"))]
fn exchange(_: &Path, _: &Path) -> bool {
    false
}

/// Makes what a folder holds durable; only Unix can sync a folder.
fn sync(folder: &Path) -> Result<()> {
    if cfg!(unix) {
        File::open(folder).and_then(|file| file.sync_all()).map_err(io(folder))?;
    }
    Ok(())
}
