//! Folders that are sealed: a manifest lists every other file with its checksum.
//!
//! Checkpoints, exports and diagnosers are such folders. One of them appears whole or not at all, nothing is read from
//! it but what its manifest lists, and what is no part of it is never removed with it.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{Error, ErrorKind, Read, Result as IoResult};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::folders::{TemporaryFolder, check_folder, check_names, folder_of, replace_folder};
use super::{Files, TEXT_BYTES, io, is_file_name, open_regular, read_regular, write_new};
use crate::error::{FileKind, LearnError, Result};

/// The longest file that is read, bytes: burn's arrays end at 10 GiB.
const LONGEST: u64 = 1 << 34;

/// The contents of the file that lists all others.
pub trait Manifest: DeserializeOwned {
    /// Its name.
    const NAME: &'static str;
    /// Whether it is TOML instead of JSON.
    const IS_TOML: bool = false;
    /// Name and version of the format, its entry `format`.
    const FORMAT: &'static str;
    /// What such a folder is.
    const KIND: &'static str;
    /// What its files belong to.
    const FILES: FileKind;
    /// What to do with one that is broken.
    const ADVICE: &'static str;
    /// Files that may be in such a folder even if no manifest lists them, as kills of earlier versions left them.
    const UNLISTED: &'static [&'static str] = &[];

    /// All other files.
    fn seals(&self) -> Vec<(String, Seal)>;
}

/// What identifies a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seal {
    /// Its length; some manifests do not contain it.
    pub bytes: Option<u64>,
    /// Of its contents.
    pub checksum: Checksum,
}

/// A checksum of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Checksum {
    /// Detects accidental changes.
    Crc32(u32),
    /// In hexadecimal; detects every change.
    Sha256(String),
}

/// Length and CRC-32 of what is read, without taking it into memory.
pub fn crc32(file: impl Read) -> IoResult<(u64, u32)> {
    let mut hasher = crc32fast::Hasher::new();
    let bytes = read_to_end(file, |part| hasher.update(part))?;
    Ok((bytes, hasher.finalize()))
}

/// Length and SHA-256, in hexadecimal, of what is read, without taking it into memory.
pub fn sha256(file: impl Read) -> IoResult<(u64, String)> {
    let mut hasher = Sha256::new();
    let bytes = read_to_end(file, |part| hasher.update(part))?;
    let mut text = String::new();
    for byte in hasher.finalize() {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
    }
    Ok((bytes, text))
}

fn read_to_end(mut file: impl Read, mut take: impl FnMut(&[u8])) -> IoResult<u64> {
    let (mut buffer, mut bytes) = (vec![0; 1 << 16], 0);
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(bytes),
            count => {
                take(&buffer[..count]);
                bytes += count as u64;
            }
        }
    }
}

impl Seal {
    /// Fails if the file is another one, with the difference.
    fn check(&self, file: impl Read) -> std::result::Result<(), String> {
        let unreadable = |error: Error| format!("it cannot be read ({error})");
        let (bytes, difference) = match &self.checksum {
            Checksum::Crc32(expected) => {
                let (bytes, found) = crc32(file).map_err(unreadable)?;
                let differs = || format!("its CRC-32 is {found:08x}, expected {expected:08x}");
                (bytes, (found != *expected).then(differs))
            }
            Checksum::Sha256(expected) => {
                let (bytes, found) = sha256(file).map_err(unreadable)?;
                let differs = || format!("its SHA-256 is {found}, expected {expected}");
                (bytes, (found != *expected).then(differs))
            }
        };
        self.check_length(bytes)?;
        difference.map_or(Ok(()), Err)
    }

    fn check_length(&self, bytes: u64) -> std::result::Result<(), String> {
        match self.bytes {
            Some(expected) if expected != bytes => Err(format!("it has {bytes} bytes, expected {expected}")),
            _ => Ok(()),
        }
    }

    /// Compares a file without taking it into memory.
    fn check_file(&self, path: &Path) -> std::result::Result<(), String> {
        let (file, length) = open_regular(path).map_err(|error| format!("it cannot be read ({error})"))?;
        self.check_length(length)?;
        if length > LONGEST {
            return Err(format!("it has {length} bytes, expected at most {LONGEST}"));
        }
        self.check(file.take(length))
    }
}

fn parse<M: Manifest, T: DeserializeOwned>(text: &str) -> std::result::Result<T, String> {
    if M::IS_TOML {
        toml::from_str(text).map_err(|error| error.to_string())
    } else {
        serde_json::from_str(text).map_err(|error| error.to_string())
    }
}

/// The entry of a manifest with its format.
#[derive(Deserialize)]
struct Format {
    format: Option<String>,
}

/// A sealed folder whose files have been compared with its manifest.
#[derive(Debug, Clone)]
pub struct SealedFolder<M> {
    folder: PathBuf,
    manifest: M,
    /// CRC-32 of the manifest.
    fingerprint: u32,
    seals: BTreeMap<String, Seal>,
}

impl<M: Manifest> SealedFolder<M> {
    /// Opens a folder and verifies its files.
    pub fn open(folder: &Path) -> Result<Self> {
        let sealed = Self::read_manifest(folder)?;
        check_names(folder, |name| name == M::NAME || sealed.seals.contains_key(name)).map_err(|path| {
            M::FILES.unusable(&path, format!("{} does not list it; remove it, or {}", M::NAME, M::ADVICE))
        })?;
        for (name, seal) in &sealed.seals {
            let path = folder.join(name);
            seal.check_file(&path)
                .map_err(|message| M::FILES.unusable(&path, format!("{message}; {}", M::ADVICE)))?;
        }
        Ok(sealed)
    }

    fn read_manifest(folder: &Path) -> Result<Self> {
        check_folder(folder)?;
        let path = folder.join(M::NAME);
        let bad = |message: String| M::FILES.unusable(&path, message);
        let bytes = read_regular(&path, TEXT_BYTES)
            .map_err(|error| bad(format!("it cannot be read ({error}); this is not {}", M::KIND)))?;
        let fingerprint = crc32fast::hash(&bytes);
        let foreign = |error: String| bad(format!("it is truncated or foreign ({error}); {}", M::ADVICE));
        let text = String::from_utf8(bytes).map_err(|error| foreign(error.to_string()))?;
        let format = parse::<M, Format>(&text).map_err(foreign)?.format.unwrap_or_else(|| "missing".into());
        if format != M::FORMAT {
            return Err(bad(format!("its format is `{format}`, expected `{}`", M::FORMAT)));
        }
        let manifest: M = parse::<M, M>(&text).map_err(foreign)?;
        let mut seals = BTreeMap::new();
        for (name, seal) in manifest.seals() {
            if !is_file_name(&name) {
                return Err(bad(format!("it lists `{name}`, expected names of files in its folder")));
            }
            if name == M::NAME || seals.contains_key(&name) {
                return Err(bad(format!("it lists `{name}` twice")));
            }
            seals.insert(name, seal);
        }
        Ok(Self { folder: folder.to_owned(), manifest, fingerprint, seals })
    }

    /// Its path.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Path of its manifest.
    pub fn manifest_path(&self) -> PathBuf {
        self.folder.join(M::NAME)
    }

    /// Its manifest.
    pub fn manifest(&self) -> &M {
        &self.manifest
    }

    /// CRC-32 of the manifest, which holds the checksums of all files: equal for equal folders.
    pub fn fingerprint(&self) -> String {
        format!("{:08x}", self.fingerprint)
    }
}

/// Only what the manifest lists can be read, and only as it lists it.
impl<M: Manifest> Files for SealedFolder<M> {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn has(&self, name: &str) -> bool {
        self.seals.contains_key(name)
    }

    fn read(&self, name: &str, limit: u64) -> Result<Vec<u8>> {
        let path = self.path(name);
        let bad = |message: String| M::FILES.unusable(&path, format!("{message}; {}", M::ADVICE));
        let seal = self.seals.get(name).ok_or_else(|| bad(format!("{} does not list it", M::NAME)))?;
        let bytes =
            read_regular(&path, limit).map_err(|error| bad(format!("it cannot be read ({error})")))?;
        seal.check(bytes.as_slice()).map_err(bad)?;
        Ok(bytes)
    }
}

/// A folder that is not sealed yet, and not where it belongs. It vanishes unless it is
/// [committed](UnsealedFolder::commit).
pub struct UnsealedFolder<M> {
    temporary: TemporaryFolder,
    destination: PathBuf,
    kind: PhantomData<M>,
}

impl<M: Manifest> UnsealedFolder<M> {
    /// Begins a folder that will take the place of an earlier one.
    pub fn create(destination: &Path) -> Result<Self> {
        check_replaceable::<M>(destination)?;
        let destination = std::path::absolute(destination).map_err(io(destination))?;
        let parent = folder_of(&destination);
        fs::create_dir_all(parent).map_err(io(parent))?;
        Ok(Self { temporary: TemporaryFolder::create(&destination)?, destination, kind: PhantomData })
    }

    /// Where its files are to be written.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.temporary.path()
    }

    /// Names of the files that have been written, and the `sum` of each.
    pub fn list<T>(&self, sum: impl Fn(File) -> IoResult<T>) -> Result<BTreeMap<String, T>> {
        let mut files = BTreeMap::new();
        for entry in fs::read_dir(self.path()).map_err(io(self.path()))? {
            let path = entry.map_err(io(self.path()))?.path();
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let summed = open_regular(&path).and_then(|(file, _)| sum(file)).map_err(io(&path))?;
            files.insert(name, summed);
        }
        Ok(files)
    }

    /// Writes the manifest, which lists every file.
    pub fn seal(&self, manifest: &M) -> Result<()>
    where
        M: Serialize,
    {
        let path = self.path().join(M::NAME);
        let text = if M::IS_TOML {
            toml::to_string(manifest).map_err(|error| error.to_string())
        } else {
            serde_json::to_string_pretty(manifest).map(|text| text + "\n").map_err(|error| error.to_string())
        };
        write_new(&path, text.map_err(|error| M::FILES.unusable(&path, error))?.as_bytes())
    }

    /// Moves the folder to its place.
    pub fn commit(self) -> Result<()> {
        check_replaceable::<M>(&self.destination)?;
        replace_folder(self.temporary, &self.destination)
    }
}

/// Fails unless there is nothing yet, or nothing but the files of an earlier folder of this kind.
pub fn check_replaceable<M: Manifest>(destination: &Path) -> Result<()> {
    let occupied = || {
        LearnError::Invalid(format!(
            "{} is neither new nor {} that could be replaced; choose another folder",
            destination.display(),
            M::KIND
        ))
    };
    // `..` and the like cannot be given to a new folder.
    if destination.file_name().is_none() {
        return Err(occupied());
    }
    match fs::symlink_metadata(destination) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Ok(found) if found.is_file() => return Err(occupied()),
        _ => check_folder(destination)?,
    }
    let listed = SealedFolder::<M>::read_manifest(destination).ok().map(|sealed| sealed.seals);
    let is_listed = |name: &str| listed.as_ref().is_some_and(|listed| listed.contains_key(name));
    let is_known = |name: &str| name == M::NAME || M::UNLISTED.contains(&name) || is_listed(name);
    check_names(destination, is_known).map_err(|foreign| {
        if listed.is_none() {
            return occupied();
        }
        LearnError::Invalid(format!(
            "{} is not a file of {} and would go with the one that is replaced; move it away, or choose another folder",
            foreign.display(),
            M::KIND
        ))
    })
}
