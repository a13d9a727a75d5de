use std::os::unix::fs::symlink;
use std::os::unix::net::UnixListener;

use super::testing::{Fault, Scratch, everywhere};
use super::*;

#[test]
fn what_is_no_regular_file_is_rejected_in_words_and_at_once() {
    let scratch = Scratch::new();
    let at = |name: &str| scratch.0.join(name);
    fs::write(at("text"), "text").unwrap();
    symlink(at("text"), at("link")).unwrap();
    symlink(at("nowhere"), at("dangling")).unwrap();
    fs::create_dir(at("folder")).unwrap();
    let _socket = UnixListener::bind(at("socket")).unwrap();
    let fifo = std::process::Command::new("mkfifo").arg(at("fifo")).status().unwrap();
    assert!(fifo.success());
    let refused = [
        (at("link"), "it is a symbolic link"),
        (at("dangling"), "it is a symbolic link"),
        (at("folder"), "it is a folder"),
        (at("socket"), "it is a socket"),
        (at("fifo"), "it is a named pipe"),
        (PathBuf::from("/dev/zero"), "it is a device"),
    ];
    for (path, expected) in refused {
        for error in [
            read_regular(&path, 10).unwrap_err().to_string(),
            open_in_place(&path).unwrap_err().to_string(),
            append(&path, b"more").unwrap_err().to_string(),
            lock(&path).unwrap_err().to_string(),
        ] {
            assert!(error.contains(expected) && error.contains("expected a regular file"), "{error}");
        }
    }
    assert_eq!(fs::read(at("text")).unwrap(), b"text");
    assert!(!at("nowhere").exists());
    assert_eq!(read_regular(&at("missing"), 10).unwrap_err().kind(), ErrorKind::NotFound);
}

#[test]
fn a_file_is_read_up_to_the_limit_and_a_longer_one_takes_no_memory() {
    let scratch = Scratch::new();
    let path = scratch.0.join("file");
    fs::write(&path, "12345").unwrap();
    assert_eq!(read_regular(&path, 5).unwrap(), b"12345");
    assert!(read_regular(&path, 4).unwrap_err().to_string().contains("more than the 4 bytes"));
    File::create(&path).unwrap().set_len(1 << 40).unwrap();
    assert!(read_text(&path).unwrap_err().to_string().contains("bytes that are expected"));
    fs::write(&path, b"\xff").unwrap();
    assert!(read_text(&path).unwrap_err().to_string().contains("UTF-8"));
}

#[test]
fn only_plain_names_are_names_of_files_in_a_folder() {
    for name in ["weights.bpk", "a b", ".hidden", "ü", "..."] {
        assert!(is_file_name(name), "{name}");
    }
    for name in ["", ".", "..", "/etc/passwd", "../x", "a/b", "a/", "./a", "a\\b", "C:\\x", "a\0b"] {
        assert!(!is_file_name(name), "{name}");
    }
}

#[test]
fn an_atomic_write_replaces_links_and_never_follows_them() {
    let scratch = Scratch::new();
    let (path, victim) = (scratch.0.join("config.toml"), scratch.0.join("victim"));
    fs::write(&victim, "precious").unwrap();
    symlink(&victim, &path).unwrap();
    symlink(&victim, scratch.0.join("config.tmp")).unwrap();
    write_atomically(&path, b"new").unwrap();
    assert_eq!(read_text(&path).unwrap(), "new");
    assert_eq!(fs::read(&victim).unwrap(), b"precious");
    fs::hard_link(&victim, scratch.0.join("metrics.jsonl")).unwrap();
    let error = append(&scratch.0.join("metrics.jsonl"), b"more").unwrap_err().to_string();
    assert!(error.contains("metrics.jsonl: it has several names"), "{error}");
    assert!(write_new(&victim, b"").is_err());
    assert_eq!(fs::read(&victim).unwrap(), b"precious");
}

#[test]
fn a_fault_at_any_call_of_an_atomic_write_leaves_the_old_or_the_new_file_and_nothing_after_the_next() {
    let calls = everywhere(
        || {
            let scratch = Scratch::new();
            fs::write(scratch.0.join("file"), "old").unwrap();
            fs::write(scratch.0.join(".other.0123456789abcdef.tmp"), "not ours").unwrap();
            scratch
        },
        |scratch| write_atomically(&scratch.0.join("file"), b"new"),
        |scratch, result, fault, call| {
            let path = scratch.0.join("file");
            let text = read_text(&path).unwrap();
            assert!(text == "old" || text == "new", "{call}: {text}");
            assert!(result.is_err(), "{call}");
            if fault == Fault::Full {
                assert_eq!(scratch.names(), [".other.0123456789abcdef.tmp", "file"], "{call}");
            }
            write_atomically(&path, b"newer").unwrap();
            assert_eq!(read_text(&path).unwrap(), "newer");
            assert_eq!(scratch.names(), [".other.0123456789abcdef.tmp", "file"], "{call}");
        },
    );
    assert_eq!(calls, 5, "create, write, sync, rename, sync of the folder");
}

#[test]
fn what_a_living_process_writes_is_not_swept() {
    let scratch = Scratch::new();
    let path = scratch.0.join("file");
    let (temporary, file) = create_temporary(&path).unwrap();
    let folder = TemporaryFolder::create(&path).unwrap();
    sweep(&scratch.0, |stem| stem == b"file");
    assert!(temporary.exists() && folder.path().exists());
    drop(file);
    sweep(&scratch.0, |stem| stem == b"fil");
    assert!(temporary.exists());
    sweep(&scratch.0, |stem| stem == b"file");
    assert!(!temporary.exists() && folder.path().exists());
    drop(folder);
    assert!(scratch.names().is_empty());
}

#[test]
fn a_folder_that_lies_elsewhere_is_rejected() {
    let (scratch, elsewhere) = (Scratch::new(), Scratch::new());
    own_folder(&scratch.0.join("new/eval")).unwrap();
    own_folder(&scratch.0.join("new/eval")).unwrap();
    assert!(scratch.0.join("new/eval").is_dir());
    symlink(&elsewhere.0, scratch.0.join("link")).unwrap();
    symlink(elsewhere.0.join("nowhere"), scratch.0.join("dangling")).unwrap();
    fs::write(scratch.0.join("file"), "").unwrap();
    for (name, expected) in
        [("link", "a symbolic link"), ("dangling", "a symbolic link"), ("file", "no folder")]
    {
        let error = own_folder(&scratch.0.join(name)).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(expected), "{error}");
    }
    assert!(elsewhere.names().is_empty());
}

#[test]
fn a_removed_folder_loses_its_name_before_its_files() {
    let calls = everywhere(
        || {
            let scratch = Scratch::new();
            fs::create_dir(scratch.0.join("folder")).unwrap();
            fs::write(scratch.0.join("folder/a"), "").unwrap();
            scratch
        },
        |scratch| remove_folder(&scratch.0.join("folder")),
        |scratch, _, _, call| {
            let folder = scratch.0.join("folder");
            assert_eq!(folder.join("a").exists(), folder.exists(), "{call}");
            remove_folder(&folder).unwrap();
            sweep(&scratch.0, |stem| stem == b"folder");
            assert!(scratch.names().is_empty(), "{call}: {:?}", scratch.names());
        },
    );
    assert_eq!(calls, 2);
}

#[test]
fn a_lock_is_held_until_it_is_dropped_and_the_file_keeps_what_it_holds() {
    let scratch = Scratch::new();
    let path = scratch.0.join("lock");
    fs::write(&path, "kept").unwrap();
    let held = lock(&path).unwrap();
    assert!(held.is_some());
    assert!(lock(&path).unwrap().is_none());
    drop(held);
    assert!(lock(&path).unwrap().is_some());
    assert_eq!(read_text(&path).unwrap(), "kept");
}

#[test]
fn names_as_long_as_file_systems_allow_can_be_written() {
    let scratch = Scratch::new();
    let path = scratch.0.join("x".repeat(255));
    write_atomically(&path, b"content").unwrap();
    assert_eq!(read_text(&path).unwrap(), "content");
}

#[test]
fn a_folder_that_is_read_is_no_link_and_may_be_missing() {
    let (scratch, elsewhere) = (Scratch::new(), Scratch::new());
    check_folder(&scratch.0).unwrap();
    check_folder(&scratch.0.join("missing")).unwrap();
    symlink(&elsewhere.0, scratch.0.join("link")).unwrap();
    let error = check_folder(&scratch.0.join("link")).unwrap_err().to_string();
    assert!(error.contains("link: it is a symbolic link, expected a folder"), "{error}");
}

#[test]
fn a_file_that_is_written_first_stays() {
    let scratch = Scratch::new();
    let path = scratch.0.join("file");
    write_first(&path, b"one").unwrap();
    write_first(&path, b"two").unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"one");
    assert_eq!(scratch.names(), ["file"]);
}

#[test]
fn what_a_user_names_is_written_into_pipes_and_open_files_and_in_place_of_links() {
    let scratch = Scratch::new();
    let at = |name: &str| scratch.0.join(name);
    fs::write(at("victim"), "precious").unwrap();
    symlink(at("victim"), at("log")).unwrap();
    write_given(&at("log"), b"new").unwrap();
    assert_eq!(fs::read(at("victim")).unwrap(), b"precious");
    assert!(fs::symlink_metadata(at("log")).unwrap().is_file());
    write_given(Path::new("/dev/null"), b"gone").unwrap();
    assert!(!fs::metadata("/dev/null").unwrap().is_file());
    let fifo = std::process::Command::new("mkfifo").arg(at("fifo")).status().unwrap();
    assert!(fifo.success());
    let read = std::thread::spawn({
        let path = at("fifo");
        move || read_given_text(&path).unwrap()
    });
    write_given(&at("fifo"), b"through").unwrap();
    assert_eq!(read.join().unwrap(), "through");
    assert!(fs::metadata(at("fifo")).unwrap().file_type().is_fifo());
    let error = write_given(&scratch.0, b"").unwrap_err().to_string();
    assert!(error.contains("directory"), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn an_open_file_is_written_under_the_names_that_the_system_gives_it() {
    use std::os::fd::AsRawFd;
    let scratch = Scratch::new();
    let file = File::create(scratch.0.join("output")).unwrap();
    for (root, content) in [("/dev/fd", "one"), ("/proc/self/fd", "two")] {
        let name = Path::new(root).join(file.as_raw_fd().to_string());
        write_given(&name, content.as_bytes()).unwrap();
        assert_eq!(read_text(&scratch.0.join("output")).unwrap(), content);
    }
    assert!(is_open_file(Path::new("/dev/stdout")));
    assert!(!is_open_file(Path::new("/dev/null")));
}

#[test]
fn a_text_that_a_user_names_is_read_through_links_and_up_to_the_limit() {
    let scratch = Scratch::new();
    fs::write(scratch.0.join("text"), "seed = 1").unwrap();
    symlink(scratch.0.join("text"), scratch.0.join("link")).unwrap();
    assert_eq!(read_given_text(&scratch.0.join("link")).unwrap(), "seed = 1");
    let error = read_given_text(Path::new("/dev/zero")).unwrap_err().to_string();
    assert!(error.contains("more than the"), "{error}");
}
