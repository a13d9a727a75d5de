//! Files and folders that may come from somebody else, and that a kill may interrupt.
//!
//! Run folders, datasets, diagnosers and exports are handed on, so whatever lies in them is data. A name in such a
//! folder may be a link to any file of the user, a pipe that never ends, or a file of any size. Hence the rules that
//! everything here keeps:
//!
//! - Only regular files are read, links are not followed, and no more memory is taken than the caller allows.
//! - A new file gets a name that nobody can foresee, exclusively, and takes its own name when it is complete and on the
//!   disk. A link under that name is replaced. A kill leaves the old or the new file, never half of either.
//! - A file that is written in place is a regular one with a single name.
//! - What a kill leaves under a temporary name goes with the next write of the same file or folder. Temporary files and
//!   folders are locked while they are written, so that nobody removes those of a living process.

#[cfg(test)]
pub(crate) mod faults;
#[cfg(test)]
pub(crate) mod tests;

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, Metadata, OpenOptions, TryLockError};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{Error, ErrorKind, Read, Result as IoResult, Seek, SeekFrom, Write};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Component, Path, PathBuf};

use rustix::fs::OFlags;

use crate::error::{LearnError, Result};

/// The longest text or description that is read, bytes: far above those that are written.
pub const TEXT_BYTES: u64 = 64 << 20;
/// How much of a file's name goes into its temporary name, which must not exceed what file systems allow.
const STEM_BYTES: usize = 200;
/// Digits that make a temporary name unpredictable.
const DIGITS: usize = 16;
const ENDING: &[u8] = b".tmp";

/// Turns an I/O error into one that names the file.
pub(crate) fn io(path: &Path) -> impl FnOnce(Error) -> LearnError {
    let path = path.to_owned();
    move |source| LearnError::Io { path, source }
}

/// Whether a name out of a list is one of a file in the folder itself, wherever the list comes from.
#[must_use]
pub fn is_file_name(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    let is_plain = matches!(parts.next(), Some(Component::Normal(part)) if part == name);
    is_plain && parts.next().is_none() && !name.contains(['/', '\\', '\0'])
}

/// Fails unless a path is that of a regular file. Says in words what it is instead.
fn check_regular(found: &Metadata) -> IoResult<()> {
    let kind = found.file_type();
    let what = if kind.is_file() {
        return Ok(());
    } else if kind.is_symlink() {
        "a symbolic link, expected a regular file; put the file itself in its place"
    } else if kind.is_dir() {
        "a folder, expected a regular file"
    } else if kind.is_fifo() {
        "a named pipe, expected a regular file"
    } else if kind.is_socket() {
        "a socket, expected a regular file"
    } else {
        "a device, expected a regular file"
    };
    Err(Error::new(ErrorKind::InvalidInput, format!("it is {what}")))
}

/// Opens a regular file in bounded time, whatever else lies there.
fn open(options: &mut OpenOptions, path: &Path) -> IoResult<(File, Metadata)> {
    match fs::symlink_metadata(path) {
        // Opening a device can have effects of its own.
        Ok(found) => check_regular(&found)?,
        Err(error) if error.kind() == ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = options.custom_flags(flags.bits() as i32).open(path)?;
    let found = file.metadata()?;
    check_regular(&found)?;
    Ok((file, found))
}

/// Reads the files of one folder by their names.
pub trait Files {
    /// Where a file lies.
    fn path(&self, name: &str) -> PathBuf;

    /// Reads a file of at most `limit` bytes.
    fn read(&self, name: &str, limit: u64) -> Result<Vec<u8>>;
}

/// A folder without a list of its files.
impl Files for Path {
    fn path(&self, name: &str) -> PathBuf {
        self.join(name)
    }

    fn read(&self, name: &str, limit: u64) -> Result<Vec<u8>> {
        let path = self.join(name);
        read_regular(&path, limit).map_err(io(&path))
    }
}

/// Opens a regular file for reading; returns it and its length, bytes.
pub fn open_regular(path: &Path) -> IoResult<(File, u64)> {
    open(OpenOptions::new().read(true), path).map(|(file, found)| (file, found.len()))
}

/// Reads a regular file of at most `limit` bytes.
pub fn read_regular(path: &Path, limit: u64) -> IoResult<Vec<u8>> {
    let (file, length) = open_regular(path)?;
    let too_long = || {
        Error::new(ErrorKind::InvalidInput, format!("it has more than the {limit} bytes that are expected"))
    };
    if length > limit {
        return Err(too_long());
    }
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(length as usize + 1).map_err(|_| Error::from(ErrorKind::OutOfMemory))?;
    // It may grow meanwhile, and files of the system tell no length.
    file.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        return Err(too_long());
    }
    Ok(bytes)
}

/// Reads a regular file of text.
pub fn read_text(path: &Path) -> IoResult<String> {
    String::from_utf8(read_regular(path, TEXT_BYTES)?)
        .map_err(|error| Error::new(ErrorKind::InvalidData, format!("it is no text in UTF-8 ({error})")))
}

/// Writes a file under a temporary name, syncs it and renames it. What was there before is replaced, links included.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    let folder = folder_of(path);
    fs::create_dir_all(folder).map_err(io(folder))?;
    sweep(folder, |stem| stem == stem_of(path));
    let (temporary, mut file) = create_temporary(path).map_err(io(path))?;
    let written = put(&mut file, bytes)
        .and_then(|()| step(|| file.sync_all()))
        .and_then(|()| step(|| fs::rename(&temporary, path)));
    if let Err(error) = written {
        let _ = step(|| fs::remove_file(&temporary));
        return Err(io(path)(error));
    }
    sync_folder(folder)
}

/// Writes a file that does not exist yet, and waits until it is on the disk.
pub(crate) fn write_new(path: &Path, bytes: &[u8]) -> Result<()> {
    step(|| OpenOptions::new().write(true).create_new(true).open(path))
        .and_then(|mut file| put(&mut file, bytes).and_then(|()| step(|| file.sync_all())))
        .map_err(io(path))
}

/// Opens a file to write in place, and makes it if need be. It keeps what it holds.
pub(crate) fn open_in_place(path: &Path) -> IoResult<File> {
    let options = &mut OpenOptions::new();
    let (file, found) = step(|| open(options.read(true).write(true).create(true).truncate(false), path))?;
    // Another name may be that of a file elsewhere.
    if found.nlink() > 1 {
        let message = "it has several names (hard links); put a copy in its place";
        return Err(Error::new(ErrorKind::InvalidInput, message));
    }
    Ok(file)
}

/// Appends to a file, which is made if need be.
pub(crate) fn append(path: &Path, bytes: &[u8]) -> Result<File> {
    let mut file = open_in_place(path).map_err(io(path))?;
    file.seek(SeekFrom::End(0)).and_then(|_| put(&mut file, bytes)).map_err(io(path))?;
    Ok(file)
}

/// Takes the lock of a file, which is made if need be; `None` if another process has it.
pub(crate) fn lock(path: &Path) -> Result<Option<File>> {
    let options = &mut OpenOptions::new();
    let opened = step(|| open(options.read(true).write(true).create(true).truncate(false), path));
    let (file, _) = opened.map_err(io(path))?;
    take_lock(file, path)
}

/// Opens a file to write in place with its lock, as [`open_in_place`]; `None` if another process has it.
pub(crate) fn lock_in_place(path: &Path) -> Result<Option<File>> {
    take_lock(open_in_place(path).map_err(io(path))?, path)
}

fn take_lock(file: File, path: &Path) -> Result<Option<File>> {
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Ok(None),
        // Some network disks have no locks.
        Err(TryLockError::Error(error)) if error.kind() == ErrorKind::Unsupported => Ok(Some(file)),
        Err(TryLockError::Error(error)) => Err(io(path)(error)),
    }
}

/// Makes a folder if need be, with those it lies in. One that is a link to elsewhere is refused.
pub(crate) fn own_folder(path: &Path) -> Result<()> {
    let root = folder_of(path);
    fs::create_dir_all(root).map_err(io(root))?;
    match step(|| fs::create_dir(path)) {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(io(path)(error)),
        _ => {}
    }
    let kind = fs::symlink_metadata(path).map_err(io(path))?.file_type();
    if kind.is_dir() {
        return Ok(());
    }
    let what = if kind.is_symlink() { "a symbolic link" } else { "no folder" };
    let message = format!("it is {what}, expected a folder; put the folder itself in its place");
    Err(io(path)(Error::new(ErrorKind::InvalidInput, message)))
}

/// A folder beside the one that it becomes. It vanishes unless it does.
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
        // One that was renamed is gone. One that cannot be removed now goes with the next write.
        let _ = step(|| fs::remove_dir_all(&self.path));
    }
}

/// Fails with the path of an entry of a folder whose name `is_known` does not accept.
pub(crate) fn check_names(
    folder: &Path,
    is_known: impl Fn(&str) -> bool,
) -> std::result::Result<(), PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else { return Err(folder.to_owned()) };
    for entry in entries {
        let name = entry.map_err(|_| folder.to_owned())?.file_name();
        if !name.to_str().is_some_and(&is_known) {
            return Err(folder.join(name));
        }
    }
    Ok(())
}

/// Puts a new folder where it belongs, in place of an earlier one.
#[expect(clippy::needless_pass_by_value, reason = "the earlier folder goes where `new` ends")]
pub(crate) fn replace_folder(new: TemporaryFolder, destination: &Path) -> Result<()> {
    sync_folder(new.path())?;
    // After an exchange the earlier folder has the temporary name, and goes when `new` does.
    if !step(|| Ok(exchange(new.path(), destination))).map_err(io(destination))? {
        remove_folder(destination)?;
        rename(new.path(), destination)?;
    }
    sync_folder(folder_of(destination))
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

/// Removes a folder: first its name, so that a kill leaves no half of it.
pub(crate) fn remove_folder(folder: &Path) -> Result<()> {
    let doomed = temporary_name(folder);
    match rename(folder, &doomed) {
        Err(LearnError::Io { source, .. }) if source.kind() == ErrorKind::NotFound => return Ok(()),
        other => other?,
    }
    // What cannot be removed now goes with the next write.
    let _ = step(|| fs::remove_dir_all(&doomed));
    Ok(())
}

/// Gives a file or folder another name.
pub(crate) fn rename(from: &Path, to: &Path) -> Result<()> {
    step(|| fs::rename(from, to)).map_err(io(to))
}

/// Makes what a folder holds durable.
pub(crate) fn sync_folder(folder: &Path) -> Result<()> {
    step(|| File::open(folder).and_then(|file| file.sync_all())).map_err(io(folder))
}

/// Removes what killed processes have left in a folder under the temporary names of files and folders that
/// `is_ours` accepts. What cannot be removed stays.
pub(crate) fn sweep(folder: &Path, is_ours: impl Fn(&[u8]) -> bool) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        if !stem_of_temporary(name.as_bytes()).is_some_and(&is_ours) {
            continue;
        }
        let (path, kind) = (entry.path(), entry.file_type());
        let is_folder = kind.is_ok_and(|kind| kind.is_dir());
        let opened = if is_folder { File::open(&path) } else { open_regular(&path).map(|(file, _)| file) };
        // Whoever is at it has the lock.
        if opened.is_ok_and(|file| file.try_lock().is_ok()) {
            let _ = step(|| if is_folder { fs::remove_dir_all(&path) } else { fs::remove_file(&path) });
        }
    }
}

/// The folder that a file or folder lies in.
pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// What the temporary names of a file or folder have in common.
pub(crate) fn stem_of(path: &Path) -> &[u8] {
    let name = path.file_name().map(OsStr::as_bytes).unwrap_or_default();
    &name[..name.len().min(STEM_BYTES)]
}

/// A name that nobody can foresee, in the same folder.
fn temporary_name(path: &Path) -> PathBuf {
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

/// Makes an empty, locked file under a temporary name.
fn create_temporary(path: &Path) -> IoResult<(PathBuf, File)> {
    loop {
        let temporary = temporary_name(path);
        match step(|| OpenOptions::new().write(true).create_new(true).open(&temporary)) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
            Ok(file) => {
                // Before it was locked another process may have swept it, or may be about to.
                let is_swept = matches!(file.try_lock(), Err(TryLockError::WouldBlock));
                if !is_swept && file.metadata()?.nlink() > 0 {
                    return Ok((temporary, file));
                }
            }
        }
    }
}

/// Writes all bytes.
pub(crate) fn put(file: &mut File, bytes: &[u8]) -> IoResult<()> {
    match step(|| Ok(())) {
        Ok(()) => file.write_all(bytes),
        Err(error) => {
            // A process that ends in a write leaves a part of it.
            let _ = file.write_all(&bytes[..bytes.len() / 2]);
            Err(error)
        }
    }
}

/// Every call that changes the file system comes through here, so that tests can end a process at any of them.
pub(crate) fn step<T>(call: impl FnOnce() -> IoResult<T>) -> IoResult<T> {
    #[cfg(test)]
    faults::check()?;
    call()
}
