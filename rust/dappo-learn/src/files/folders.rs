//! Folders that appear and disappear as a whole, and leave nothing behind.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, TryLockError};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{Error, ErrorKind};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};

use super::{io, open_regular, step};
use crate::error::{LearnError, Result};

/// How much of a file's name goes into its temporary name, which must not exceed what file systems allow.
const STEM_BYTES: usize = 200;
/// Digits that make a temporary name unpredictable.
const DIGITS: usize = 16;
const ENDING: &[u8] = b".tmp";

/// Makes a folder if needed, with its parents. A link is refused.
pub fn own_folder(path: &Path) -> Result<()> {
    let root = folder_of(path);
    fs::create_dir_all(root).map_err(io(root))?;
    match step(|| fs::create_dir(path)) {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(io(path)(error)),
        _ => {}
    }
    check_folder(path)
}

/// Fails if the path is not a folder: a link may point to any folder of the user.
pub fn check_folder(path: &Path) -> Result<()> {
    let kind = match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        found => found.map_err(io(path))?.file_type(),
    };
    if kind.is_dir() {
        return Ok(());
    }
    let what = if kind.is_symlink() { "a symbolic link" } else { "no folder" };
    let message = format!("it is {what}, expected a folder; put the folder itself in its place");
    Err(io(path)(Error::new(ErrorKind::InvalidInput, message)))
}

/// A temporary folder next to its final place. It is removed unless it is moved there.
#[derive(Debug)]
pub struct TemporaryFolder {
    path: PathBuf,
    /// Locked, so that the folder is not swept.
    _handle: File,
}

impl TemporaryFolder {
    /// Makes an empty folder in the folder of `destination`, which exists.
    pub fn create(destination: &Path) -> Result<Self> {
        sweep(folder_of(destination), |stem| stem == stem_of(destination));
        loop {
            let path = temporary_name(destination);
            match step(|| fs::create_dir(&path)) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => continue,
                Err(error) => return Err(io(&path)(error)),
                Ok(()) => {}
            }
            // Before it is locked another process may sweep it.
            let handle = match File::open(&path) {
                Err(error) if error.kind() == ErrorKind::NotFound => continue,
                opened => opened.map_err(io(&path))?,
            };
            let is_swept = matches!(handle.try_lock(), Err(TryLockError::WouldBlock));
            if !is_swept && path.exists() {
                return Ok(Self { path, _handle: handle });
            }
        }
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // One that was renamed is gone. One that cannot be removed now is removed by the next write.
        let _ = step(|| fs::remove_dir_all(&self.path));
    }
}

/// Fails with the path of an entry of a folder whose name `is_known` does not accept.
pub fn check_names(folder: &Path, is_known: impl Fn(&str) -> bool) -> std::result::Result<(), PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else { return Err(folder.to_owned()) };
    for entry in entries {
        let name = entry.map_err(|_| folder.to_owned())?.file_name();
        if !name.to_str().is_some_and(&is_known) {
            return Err(folder.join(name));
        }
    }
    Ok(())
}

/// Moves a new folder to its place, replacing an earlier one.
#[expect(clippy::needless_pass_by_value, reason = "the earlier folder goes where `new` ends")]
pub fn replace_folder(new: TemporaryFolder, destination: &Path) -> Result<()> {
    sync_folder(new.path())?;
    // After an exchange the earlier folder has the temporary name, and is removed with `new`.
    if !step(|| Ok(exchange(new.path(), destination))).map_err(io(destination))? {
        remove_folder(destination)?;
        rename(new.path(), destination)?;
    }
    sync_folder(folder_of(destination))
}

/// Exchanges the names of two folders in one step, where the system supports that.
#[cfg(target_os = "linux")]
fn exchange(one: &Path, other: &Path) -> bool {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    renameat_with(CWD, one, CWD, other, RenameFlags::EXCHANGE).is_ok()
}

#[cfg(not(target_os = "linux"))]
fn exchange(_: &Path, _: &Path) -> bool {
    false
}

/// Removes a folder: first its name, so that a kill leaves no half of it.
pub fn remove_folder(folder: &Path) -> Result<()> {
    let doomed = temporary_name(folder);
    match rename(folder, &doomed) {
        Err(LearnError::Io { source, .. }) if source.kind() == ErrorKind::NotFound => return Ok(()),
        other => other?,
    }
    // What cannot be removed now is removed by the next write.
    let _ = step(|| fs::remove_dir_all(&doomed));
    Ok(())
}

/// Gives a file or folder another name.
pub fn rename(from: &Path, to: &Path) -> Result<()> {
    step(|| fs::rename(from, to)).map_err(io(to))
}

/// Makes what a folder holds durable.
pub fn sync_folder(folder: &Path) -> Result<()> {
    step(|| File::open(folder).and_then(|file| file.sync_all())).map_err(io(folder))
}

/// Removes what killed processes have left in a folder under the temporary names of files and folders that
/// `is_ours` accepts. What cannot be removed stays.
pub fn sweep(folder: &Path, is_ours: impl Fn(&[u8]) -> bool) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        if !stem_of_temporary(name.as_bytes()).is_some_and(&is_ours) {
            continue;
        }
        let (path, kind) = (entry.path(), entry.file_type());
        let is_folder = kind.is_ok_and(|kind| kind.is_dir());
        let opened = if is_folder { File::open(&path) } else { open_regular(&path).map(|(file, _)| file) };
        // Its user holds the lock, until the name is gone: the process that has just made the file cannot
        // take it.
        if let Ok(file) = opened
            && file.try_lock().is_ok()
        {
            let _ = step(|| if is_folder { fs::remove_dir_all(&path) } else { fs::remove_file(&path) });
        }
    }
}

/// The parent of a file or folder.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// What the temporary names of a file or folder have in common.
pub fn stem_of(path: &Path) -> &[u8] {
    let name = path.file_name().map(OsStr::as_bytes).unwrap_or_default();
    &name[..name.len().min(STEM_BYTES)]
}

/// An unpredictable name in the same folder.
pub(super) fn temporary_name(path: &Path) -> PathBuf {
    // The keys of this hash come from the operating system.
    let number = RandomState::new().build_hasher().finish();
    let name = [b".", stem_of(path), format!(".{number:0DIGITS$x}").as_bytes(), ENDING].concat();
    folder_of(path).join(OsString::from_vec(name))
}

/// What a temporary name stands for; `None` for any other name.
fn stem_of_temporary(name: &[u8]) -> Option<&[u8]> {
    let rest = name.strip_prefix(b".")?.strip_suffix(ENDING)?;
    let (stem, digits) = rest.split_at_checked(rest.len().checked_sub(DIGITS)?)?;
    let is_hex = digits.iter().all(|digit| matches!(digit, b'0'..=b'9' | b'a'..=b'f'));
    stem.strip_suffix(b".").filter(|_| is_hex)
}
