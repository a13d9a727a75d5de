//! The copy of its robot that a run, a dataset or a diagnoser keeps in the folder `robot/`.
//!
//! A damage code is meaningless without its robot, and robot files can change after a training.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde::Deserialize;

use crate::error::{FileKind, Result};
use crate::files::sealed::{Checksum, Manifest, Seal, check_replaceable};
use crate::files::{TemporaryFolder, io, rename, replace_folder, sync_folder, write_new};

/// Name of the folder.
const FOLDER: &str = "robot";

/// What this crate reads of `robot.json`; Python writes it.
#[derive(Deserialize)]
struct RobotManifest {
    files: BTreeMap<String, FileEntry>,
}

#[derive(Deserialize)]
struct FileEntry {
    bytes: u64,
    sha256: String,
}

impl Manifest for RobotManifest {
    const NAME: &'static str = "robot.json";
    const FORMAT: &'static str = "dappo-batch robot 1";
    const KIND: &'static str = "a copy of a robot";
    const FILES: FileKind = FileKind::Checkpoint;
    const ADVICE: &'static str = "remove it";

    fn seals(&self) -> Vec<(String, Seal)> {
        let seal = |FileEntry { bytes, sha256 }: &FileEntry| Seal {
            bytes: Some(*bytes),
            checksum: Checksum::Sha256(sha256.clone()),
        };
        self.files.iter().map(|(name, file)| (name.clone(), seal(file))).collect()
    }
}

/// Names and contents of the files of a robot.
pub type RobotFiles = Vec<(String, Vec<u8>)>;

/// Writes the files of a robot into the folder of a run or a diagnoser, replacing those that are there.
pub fn keep(root: &Path, files: &RobotFiles) -> Result<()> {
    check_replaceable::<RobotManifest>(&root.join(FOLDER))?;
    replace_folder(write(root, files)?, &root.join(FOLDER))
}

/// Writes the files of a robot into the folder of a dataset, unless some are there: its pieces may begin
/// together.
pub fn keep_first(root: &Path, files: &RobotFiles) -> Result<()> {
    let folder = root.join(FOLDER);
    if folder.exists() {
        return Ok(());
    }
    let written = write(root, files)?;
    sync_folder(written.path())?;
    // Another process may have been faster; a folder that holds something is never replaced.
    match rename(written.path(), &folder) {
        Err(_) if folder.exists() => Ok(()),
        renamed => renamed.and_then(|()| sync_folder(root)),
    }
}

/// Writes the files into a folder that has not its name yet.
fn write(root: &Path, files: &RobotFiles) -> Result<TemporaryFolder> {
    fs::create_dir_all(root).map_err(io(root))?;
    let written = TemporaryFolder::create(&root.join(FOLDER))?;
    for (name, bytes) in files {
        write_new(&written.path().join(name), bytes)?;
    }
    Ok(written)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contents(root: &Path) -> Vec<(String, String)> {
        let mut found: Vec<_> = fs::read_dir(root.join(FOLDER))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .map(|path| {
                (path.file_name().unwrap().to_string_lossy().into(), fs::read_to_string(&path).unwrap())
            })
            .collect();
        found.sort();
        found
    }

    #[test]
    fn a_copy_replaces_another_or_gives_way_to_it_and_leaves_nothing_else() {
        let root = std::env::temp_dir().join(format!("dappo-robot-files-{}", std::process::id()));
        let files =
            |names: &[&str]| names.iter().map(|name| ((*name).into(), name.as_bytes().into())).collect();
        let expected = |name: &str| vec![(name.to_owned(), name.to_owned())];
        keep_first(&root, &files(&["one"])).unwrap();
        keep_first(&root, &files(&["two", "three"])).unwrap();
        assert_eq!(contents(&root), expected("one"));
        // No list contains this file, so it may belong to a user.
        let refused = keep(&root, &files(&["two"])).unwrap_err().to_string();
        assert!(refused.contains("robot is neither new nor a copy of a robot"), "{refused}");
        assert_eq!(contents(&root), expected("one"));
        let list = |name: &str| {
            let format = RobotManifest::FORMAT;
            format!(r#"{{"format": "{format}", "files": {{"{name}": {{"bytes": 3, "sha256": ""}}}}}}"#)
        };
        let header = root.join(FOLDER).join(RobotManifest::NAME);
        fs::write(&header, list("other")).unwrap();
        let refused = keep(&root, &files(&["two"])).unwrap_err().to_string();
        assert!(refused.contains("robot/one is not a file of a copy of a robot"), "{refused}");
        fs::write(&header, list("one")).unwrap();
        keep(&root, &files(&["two"])).unwrap();
        assert_eq!(contents(&root), expected("two"));
        assert_eq!(fs::read_dir(&root).unwrap().count(), 1);
        fs::remove_dir_all(root).unwrap();
    }
}
