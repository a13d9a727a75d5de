use super::*;

const MANIFEST: &str = CheckpointManifest::<Progress>::NAME;

use crate::files::testing::Scratch;
use crate::files::testing::{Fault, everywhere};
use crate::files::write_new;

fn try_write(at: &Path, iteration: u64, content: &str) -> Result<()> {
    let progress = Progress { iteration, env_steps: iteration * 10, stage: 0 };
    Checkpoint::write(at, "ant", progress, 2, |folder| {
        write_new(&folder.join("learner.toml"), content.as_bytes())
    })
}

#[test]
fn what_earlier_versions_left_of_a_kill_goes_with_the_next_checkpoint_and_nothing_else() {
    let at = Scratch::new();
    for name in ["00000001", EARLIER_TEMPORARY] {
        fs::create_dir(at.0.join(name)).unwrap();
        fs::write(at.0.join(name).join("policy.bpk"), "half").unwrap();
    }
    for name in ["00000002", ".old"] {
        fs::create_dir(at.0.join(name)).unwrap();
        fs::write(at.0.join(name).join("notes.txt"), "mine").unwrap();
    }
    write(&at.0, 3, "content");
    write(&at.0, 4, "content");
    assert_eq!(at.names(), [".old", "00000002", "00000003", "00000004"]);
    assert_eq!(newest(&at.0).unwrap().progress.iteration, 4);
}

fn write(at: &Path, iteration: u64, content: &str) {
    try_write(at, iteration, content).unwrap();
}

fn newest(at: &Path) -> Result<Checkpoint> {
    Checkpoint::newest(at, "ant")
}

#[test]
fn the_newest_checkpoint_is_found_and_old_ones_go() {
    let at = Scratch::new();
    for iteration in [1, 2, 3] {
        write(&at.0, iteration, "content");
    }
    assert_eq!(newest(&at.0).unwrap().progress.iteration, 3);
    assert_eq!(at.names(), ["00000002", "00000003"]);
}

#[test]
fn a_fault_at_any_call_leaves_a_checkpoint_to_go_on_from_and_nothing_after_the_next() {
    let calls = everywhere(
        || {
            let at = Scratch::new();
            write(&at.0, 1, "content");
            write(&at.0, 2, "content");
            at
        },
        |at| try_write(&at.0, 3, "content"),
        |at, result, fault, call| {
            let iteration = newest(&at.0).unwrap().progress.iteration;
            assert!(iteration == 3 || (iteration == 2 && result.is_err()), "{call}: {result:?}");
            if fault == Fault::Full && iteration == 2 {
                assert_eq!(at.names(), ["00000001", "00000002"], "{call}");
            }
            write(&at.0, iteration + 1, "content");
            let expected = [iteration, iteration + 1].map(|number| format!("{number:08}"));
            assert_eq!(at.names(), expected, "{call}");
        },
    );
    assert!(calls > 10, "{calls}");
}

#[test]
fn only_names_of_eight_digits_are_checkpoints_and_foreign_folders_stay() {
    let at = Scratch::new();
    let foreign = ["0", "1", "000000004", "00000000", "00000009.old"];
    for name in foreign {
        fs::create_dir(at.0.join(name)).unwrap();
        fs::write(at.0.join(name).join("notes.txt"), "mine").unwrap();
    }
    for iteration in [9_999, 100_000_000, 100_000_001, 100_000_002] {
        write(&at.0, iteration, "content");
    }
    let kept = ["100000001", "100000002"];
    assert_eq!(at.names(), [&["0", "00000000", "000000004", "00000009.old", "1"][..], &kept].concat());
    for name in foreign {
        assert_eq!(fs::read(at.0.join(name).join("notes.txt")).unwrap(), b"mine");
    }
    assert_eq!(newest(&at.0).unwrap().progress.iteration, 100_000_002);
    fs::rename(at.0.join("100000002"), at.0.join("100000003")).unwrap();
    let message = newest(&at.0).unwrap_err().to_string();
    assert!(message.contains("it holds number 100000002; rename it to 100000002"), "{message}");
}

#[test]
fn damaged_and_foreign_checkpoints_are_rejected_by_name() {
    let scratch = Scratch::new();
    let at = &scratch.0;
    write(at, 1, "content");
    let file = at.join("00000001/learner.toml");
    let message =
        |expected_robot: &str| Checkpoint::<Progress>::newest(at, expected_robot).unwrap_err().to_string();
    assert!(message("hexapod").contains("belongs to robot `ant`"));
    fs::write(&file, "conte").unwrap();
    assert!(message("ant").contains("learner.toml") && message("ant").contains("5 bytes, expected 7"));
    fs::write(&file, "consent").unwrap();
    assert!(message("ant").contains("CRC-32"));
    fs::remove_file(&file).unwrap();
    assert!(message("ant").contains("learner.toml"));
    fs::write(at.join("00000001").join(MANIFEST), "{\"format\": \"dap").unwrap();
    assert!(message("ant").contains("truncated or foreign"));
}

#[test]
fn names_that_lead_elsewhere_and_files_that_no_manifest_lists_are_rejected() {
    let (scratch, elsewhere) = (Scratch::new(), Scratch::new());
    let at = &scratch.0;
    write(at, 1, "content");
    let folder = at.join("00000001");
    let manifest = fs::read_to_string(folder.join(MANIFEST)).unwrap();
    let message = || newest(at).unwrap_err().to_string();
    for name in ["/dev/zero", "../learner.toml", "..", "x/y", ""] {
        fs::write(folder.join(MANIFEST), manifest.replace("learner.toml", name)).unwrap();
        let expected = format!("it lists `{name}`, expected names of files in its folder");
        assert!(message().contains(&expected), "{}", message());
    }
    fs::write(folder.join(MANIFEST), manifest.replace("learner.toml", MANIFEST)).unwrap();
    assert!(message().contains("twice"), "{}", message());
    fs::write(folder.join(MANIFEST), &manifest).unwrap();
    let checkpoint = newest(at).unwrap();
    assert_eq!(checkpoint.read("learner.toml", 7).unwrap(), b"content");
    assert!(checkpoint.read("learner.toml", 6).is_err());
    fs::write(folder.join("envs.bin"), "").unwrap();
    assert!(message().contains("envs.bin: manifest.json does not list it"), "{}", message());
    let error = checkpoint.read("envs.bin", 7).unwrap_err().to_string();
    assert!(error.contains("does not list it"), "{error}");
    fs::remove_file(folder.join("envs.bin")).unwrap();

    let file = folder.join("learner.toml");
    fs::rename(&file, elsewhere.0.join("learner.toml")).unwrap();
    std::os::unix::fs::symlink(elsewhere.0.join("learner.toml"), &file).unwrap();
    assert!(message().contains("it is a symbolic link"), "{}", message());
    fs::rename(&folder, elsewhere.0.join("00000001")).unwrap();
    std::os::unix::fs::symlink(elsewhere.0.join("00000001"), &folder).unwrap();
    assert!(message().contains("it is a symbolic link"), "{}", message());
    // Nothing is written to the target of a link.
    write(at, 2, "content");
    write(at, 3, "content");
    write(at, 4, "content");
    assert_eq!(elsewhere.names(), ["00000001", "learner.toml"]);
    fs::rename(at, elsewhere.0.join("all")).unwrap();
    std::os::unix::fs::symlink(elsewhere.0.join("all"), at).unwrap();
    assert!(try_write(at, 5, "content").unwrap_err().to_string().contains("symbolic link"));
    assert_eq!(fs::read_dir(elsewhere.0.join("all")).unwrap().count(), 3);
    fs::remove_file(at).unwrap();
}
