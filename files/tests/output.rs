//! What becomes of the file that an output replaces.

use std::fs::{self, Permissions};
use std::io::Write;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;

use geu_files::{Output, persist_all, write_whole};

fn text(path: &Path) -> String {
    fs::read_to_string(path).expect("there")
}

#[test]
fn an_output_that_is_dropped_leaves_what_was_there() {
    let room = tempfile::tempdir().expect("a directory");
    let path = room.path().join("rows.csv");
    fs::write(&path, "before").expect("room");
    let mut output = Output::create(&path).expect("room");
    output.write_all(b"half").expect("room");
    output.complete().expect("room");
    assert_eq!((text(&path), fs::read_dir(room.path()).expect("there").count()), ("before".to_owned(), 2));
    drop(output);
    assert_eq!((text(&path), fs::read_dir(room.path()).expect("there").count()), ("before".to_owned(), 1));
    write_whole(&path, "after").expect("room");
    assert_eq!((text(&path), fs::read_dir(room.path()).expect("there").count()), ("after".to_owned(), 1));
}

#[test]
fn permissions_stay_and_symlinks_are_followed() {
    let room = tempfile::tempdir().expect("a directory");
    let [file, link, dangling, target] = ["file", "link", "dangling", "sub/target"].map(|name| room.path().join(name));
    fs::create_dir(room.path().join("sub")).expect("room");
    fs::write(&file, "before").expect("room");
    fs::set_permissions(&file, Permissions::from_mode(0o640)).expect("ours");
    symlink("file", &link).expect("room");
    symlink("sub/target", &dangling).expect("room");
    write_whole(&link, "after").expect("room");
    write_whole(&dangling, "new").expect("room");
    assert_eq!((text(&file), text(&target)), ("after".to_owned(), "new".to_owned()));
    assert_eq!(fs::metadata(&file).expect("there").permissions().mode() & 0o7777, 0o640);
    for link in [&link, &dangling] {
        assert!(fs::symlink_metadata(link).expect("there").is_symlink());
    }
    // A new file has the permissions that any new file has.
    let plain = room.path().join("plain");
    fs::write(&plain, "").expect("room");
    let mode = |path: &Path| fs::metadata(path).expect("there").permissions().mode();
    assert_eq!(mode(&target), mode(&plain));
    symlink("circle", room.path().join("circle")).expect("room");
    assert!(write_whole(&room.path().join("circle"), "").is_err());
}

#[test]
fn devices_are_written_as_they_stand_and_directories_not() {
    write_whole(Path::new("/dev/null"), "nothing").expect("a device");
    let error = write_whole(Path::new("/dev/full"), "something").expect_err("no room");
    assert_eq!(error.kind(), std::io::ErrorKind::StorageFull);
    let room = tempfile::tempdir().expect("a directory");
    for path in [room.path().to_owned(), room.path().join("none/file"), room.path().join("none/"), "".into()] {
        assert!(Output::create(&path).is_err(), "{}", path.display());
    }
    // A name as long as a file system takes.
    let long = room.path().join("n".repeat(255));
    write_whole(&long, "long").expect("room");
    assert_eq!(text(&long), "long");
}

#[test]
fn several_are_in_their_places_when_all_are_whole() {
    let room = tempfile::tempdir().expect("a directory");
    let paths = ["one", "other"].map(|name| room.path().join(name));
    let outputs = paths.each_ref().map(|path| {
        let mut output = Output::create(path).expect("room");
        output.write_all(b"whole").expect("room");
        output
    });
    assert!(paths.iter().all(|path| !path.exists()));
    persist_all(outputs).expect("room");
    assert!(paths.iter().all(|path| text(path) == "whole"));
}
