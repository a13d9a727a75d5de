//! A folder that appears whole or not at all, and whose files are known by their SHA-256.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::header::{FORMAT, FileHeader, Header};
use super::unusable;
use crate::error::{LearnError, Result};
use crate::files::{
    TemporaryFolder, check_names, folder_of, io, is_file_name, read_regular, read_text, replace_folder,
    write_new,
};

const HEADER: &str = "export.json";
/// The longest file that is read, bytes: far above any network of a controller.
const LONGEST: u64 = 1 << 32;

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
    folder: TemporaryFolder,
    out: PathBuf,
}

impl Staged {
    /// Fails unless `out` is new, empty, or an export that may be replaced.
    pub fn check(out: &Path) -> Result<()> {
        let is_free = match fs::read_dir(out) {
            Err(error) => error.kind() == std::io::ErrorKind::NotFound && out.file_name().is_some(),
            Ok(mut entries) => entries.next().is_none() || format_of(out).is_some(),
        };
        if !is_free {
            return Err(LearnError::Invalid(format!(
                "{} is neither new nor an export that could be replaced; choose another folder",
                out.display()
            )));
        }
        let foreign = header_of(out).and_then(|header| {
            let files =
                header.get("files").and_then(serde_json::Value::as_object).cloned().unwrap_or_default();
            check_names(out, |name| name == HEADER || files.contains_key(name)).err()
        });
        foreign.map_or(Ok(()), |path| {
            Err(LearnError::Invalid(format!(
                "{} is no file of the export that would be replaced; move it away, or choose another folder",
                path.display()
            )))
        })
    }

    /// Writes the files and the header into a folder beside `out`, and waits until they are on the disk.
    pub(super) fn write(out: &Path, header: &Header, files: &BTreeMap<String, Vec<u8>>) -> Result<Self> {
        Self::check(out)?;
        let out = std::path::absolute(out).map_err(io(out))?;
        let parent = folder_of(&out);
        fs::create_dir_all(parent).map_err(io(parent))?;
        let folder = TemporaryFolder::create(&out)?;
        for (name, bytes) in files {
            write_new(&folder.path().join(name), bytes)?;
        }
        let text = serde_json::to_string_pretty(header)
            .map_err(|error| unusable(folder.path(), error.to_string()))?;
        write_new(&folder.path().join(HEADER), (text + "\n").as_bytes())?;
        Ok(Self { folder, out })
    }

    /// Where the export lies until it is committed.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Puts the export where it belongs, in place of an earlier one.
    pub fn commit(self) -> Result<()> {
        Self::check(&self.out)?;
        replace_folder(self.folder, &self.out)
    }
}

/// Reads the header of an export and checks every file that it names.
pub(super) fn open(folder: &Path) -> Result<Header> {
    let path = folder.join(HEADER);
    let text = read_text(&path).map_err(|error| {
        unusable(&path, format!("it cannot be read ({error}); `dappo-batch export` makes such a folder"))
    })?;
    let found = format_of(folder).unwrap_or_else(|| "missing".into());
    if found != FORMAT {
        return Err(unusable(&path, format!("its format is `{found}`, expected `{FORMAT}`")));
    }
    let header: Header = serde_json::from_str(&text)
        .map_err(|error| unusable(&path, format!("it is broken or foreign ({error})")))?;
    if let Some(name) = header.files.keys().find(|name| !is_file_name(name)) {
        return Err(unusable(&path, format!("it lists `{name}`, expected names of files in its folder")));
    }
    check_names(folder, |name| name == HEADER || header.files.contains_key(name))
        .map_err(|path| unusable(&path, format!("{HEADER} does not list it; remove it, or export again")))?;
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
    let bytes = read_regular(&path, expected.bytes.min(LONGEST))
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

fn header_of(folder: &Path) -> Option<serde_json::Value> {
    serde_json::from_str(&read_text(&folder.join(HEADER)).ok()?).ok()
}

/// What the header says it is, if there is one.
fn format_of(folder: &Path) -> Option<String> {
    let header = header_of(folder)?;
    let format = header.get("format")?.as_str()?;
    format.starts_with("dappo-batch export").then(|| format.to_owned())
}
