//! Files and folders that may come from others, and that a kill may interrupt.
//!
//! Run folders, datasets, diagnosers and exports are passed on, so their contents are data. A name in such a
//! folder may be a link to any file of the user, a pipe that never ends, or a file of any size. Hence the
//! rules that everything here keeps:
//!
//! - Only regular files are read, links are not followed, and no more memory is taken than the caller allows.
//! - A new file gets an unpredictable name, exclusively, and takes its own name when it is complete and on the
//!   disk. A link under that name is replaced. A kill leaves the old or the new file, never half of either.
//! - A file that is written in place is a regular one with a single name.
//! - What a kill leaves under a temporary name is removed by the next write of the same file or folder.
//!   Temporary files and folders are locked while they are written, so that those of a running process stay.

mod folders;
pub mod sealed;
#[doc(hidden)]
pub mod testing;
#[cfg(test)]
mod tests;

use std::fs::{self, File, Metadata, OpenOptions, TryLockError};
use std::io::{Error, ErrorKind, Read, Result as IoResult, Seek, SeekFrom, Write};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Component, Path, PathBuf};

use rustix::fs::OFlags;

use crate::error::{LearnError, Result};

use folders::temporary_name;
pub(crate) use folders::{TemporaryFolder, folder_of, replace_folder, sync_folder};
pub use folders::{check_folder, own_folder, remove_folder, rename, stem_of, sweep};

/// The longest text or description that is read, bytes: far above those that are written.
pub const TEXT_BYTES: u64 = 64 << 20;

/// Adds the file to an I/O error.
pub fn io(path: &Path) -> impl FnOnce(Error) -> LearnError {
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

/// Fails unless a path is that of a regular file. The error contains what it is instead.
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

/// Opens a regular file in bounded time, whatever is there.
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
    /// Path of a file.
    fn path(&self, name: &str) -> PathBuf;

    /// Whether there is such a file.
    fn has(&self, name: &str) -> bool;

    /// Reads a file of at most `limit` bytes.
    fn read(&self, name: &str, limit: u64) -> Result<Vec<u8>>;
}

/// A folder without a list of its files.
impl Files for Path {
    fn path(&self, name: &str) -> PathBuf {
        self.join(name)
    }

    fn has(&self, name: &str) -> bool {
        fs::symlink_metadata(self.join(name)).is_ok()
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
    if length > limit {
        return Err(too_long(limit));
    }
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(length as usize + 1).map_err(|_| Error::from(ErrorKind::OutOfMemory))?;
    // It may grow meanwhile, and files of the system have no length.
    file.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        return Err(too_long(limit));
    }
    Ok(bytes)
}

/// Reads a regular file of text.
pub fn read_text(path: &Path) -> IoResult<String> {
    text(read_regular(path, TEXT_BYTES)?)
}

/// Reads a text that a user names: links are followed, and pipes are read to their end.
pub fn read_given_text(path: &Path) -> IoResult<String> {
    let mut bytes = Vec::new();
    File::open(path)?.take(TEXT_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > TEXT_BYTES {
        return Err(too_long(TEXT_BYTES));
    }
    text(bytes)
}

fn text(bytes: Vec<u8>) -> IoResult<String> {
    String::from_utf8(bytes)
        .map_err(|error| Error::new(ErrorKind::InvalidData, format!("it is not text in UTF-8 ({error})")))
}

fn too_long(limit: u64) -> Error {
    Error::new(ErrorKind::InvalidInput, format!("it has more than the {limit} bytes that are expected"))
}

/// Writes a file under a temporary name, syncs it and renames it. What was there before is replaced, links included.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    write_under_temporary_name(path, bytes, |temporary| fs::rename(temporary, path))
}

/// Writes a file that a user names as [`write_atomically`] does, but into a pipe, a device or an open file such as
/// `/dev/stdout`.
pub fn write_given(path: &Path, bytes: &[u8]) -> Result<()> {
    let is_stream = fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir());
    if is_stream || is_open_file(path) {
        return fs::write(path, bytes).map_err(io(path));
    }
    write_atomically(path, bytes)
}

/// Whether a path stands for an open file of a process: `/dev/stdout`, `/dev/fd/3` and those of `/proc`.
fn is_open_file(path: &Path) -> bool {
    let Ok(folder) = folder_of(path).canonicalize() else { return false };
    let is_link_of_the_system =
        || folder == Path::new("/dev") && fs::read_link(path).is_ok_and(|target| target.starts_with("/proc"));
    folder.starts_with("/proc") || is_link_of_the_system()
}

/// Writes a file as [`write_atomically`] does, unless one is there: of several processes that begin together, one
/// writes it.
pub fn write_first(path: &Path, bytes: &[u8]) -> Result<()> {
    write_under_temporary_name(path, bytes, |temporary| match fs::hard_link(temporary, path) {
        Ok(()) => fs::remove_file(temporary),
        Err(error) if error.kind() == ErrorKind::AlreadyExists => fs::remove_file(temporary),
        // Some file systems have no hard links.
        Err(_) => fs::rename(temporary, path),
    })
}

/// Writes and syncs a file that `take_name` then gives its name.
fn write_under_temporary_name(
    path: &Path,
    bytes: &[u8],
    take_name: impl FnOnce(&Path) -> IoResult<()>,
) -> Result<()> {
    let folder = folder_of(path);
    fs::create_dir_all(folder).map_err(io(folder))?;
    sweep(folder, |stem| stem == stem_of(path));
    let (temporary, mut file) = create_temporary(path).map_err(io(path))?;
    let written = put(&mut file, bytes)
        .and_then(|()| step(|| file.sync_all()))
        .and_then(|()| step(|| take_name(&temporary)));
    if let Err(error) = written {
        let _ = step(|| fs::remove_file(&temporary));
        return Err(io(path)(error));
    }
    sync_folder(folder)
}

/// Writes a file that does not exist yet, and waits until it is on the disk.
pub fn write_new(path: &Path, bytes: &[u8]) -> Result<()> {
    step(|| OpenOptions::new().write(true).create_new(true).open(path))
        .and_then(|mut file| put(&mut file, bytes).and_then(|()| step(|| file.sync_all())))
        .map_err(io(path))
}

/// Opens a file to write in place, and makes it if need be. It keeps what it holds.
pub fn open_in_place(path: &Path) -> IoResult<File> {
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
pub fn append(path: &Path, bytes: &[u8]) -> Result<File> {
    let mut file = open_in_place(path).map_err(io(path))?;
    file.seek(SeekFrom::End(0)).and_then(|_| put(&mut file, bytes)).map_err(io(path))?;
    Ok(file)
}

/// Takes the lock of a file, which is made if need be; `None` if another process has it.
pub fn lock(path: &Path) -> Result<Option<File>> {
    let options = &mut OpenOptions::new();
    let opened = step(|| open(options.read(true).write(true).create(true).truncate(false), path));
    let (file, _) = opened.map_err(io(path))?;
    take_lock(file, path)
}

/// Opens a file to write in place with its lock, as [`open_in_place`]; `None` if another process has it.
pub fn lock_in_place(path: &Path) -> Result<Option<File>> {
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
pub fn put(file: &mut File, bytes: &[u8]) -> IoResult<()> {
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
pub fn step<T>(call: impl FnOnce() -> IoResult<T>) -> IoResult<T> {
    testing::check()?;
    call()
}
