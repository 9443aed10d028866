//! Outputs and the files that they replace.

use std::fs::{self, Permissions};
use std::io::Write;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;

use geu_files::{Output, persist_all, write_whole};

fn text(path: &Path) -> String {
    fs::read_to_string(path).expect("there")
}

#[test]
fn dropped_output_keeps_the_previous_file() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("rows.csv");
    fs::write(&path, "before").expect("written");
    let mut output = Output::create(&path).expect("written");
    output.write_all(b"half").expect("written");
    output.complete().expect("written");
    assert_eq!((text(&path), fs::read_dir(directory.path()).expect("there").count()), ("before".to_owned(), 2));
    drop(output);
    assert_eq!((text(&path), fs::read_dir(directory.path()).expect("there").count()), ("before".to_owned(), 1));
    write_whole(&path, "after").expect("written");
    assert_eq!((text(&path), fs::read_dir(directory.path()).expect("there").count()), ("after".to_owned(), 1));
}

#[test]
fn a_new_output_keeps_a_file_that_was_written_meanwhile() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("rows.csv");
    let [first, second] = ["first", "second"].map(|rows| {
        let mut output = Output::create_new(&path).expect("written");
        output.write_all(rows.as_bytes()).expect("written");
        output
    });
    first.persist().expect("the only one");
    let error = second.persist().expect_err("a file exists");
    assert!(error.to_string().contains("rows.csv: expected no file"), "{error}");
    assert_eq!((text(&path), fs::read_dir(directory.path()).expect("there").count()), ("first".to_owned(), 1));
}

#[test]
fn permissions_stay_and_symlinks_are_followed() {
    let directory = tempfile::tempdir().expect("a directory");
    let [file, link, dangling, target] =
        ["file", "link", "dangling", "sub/target"].map(|name| directory.path().join(name));
    fs::create_dir(directory.path().join("sub")).expect("written");
    fs::write(&file, "before").expect("written");
    fs::set_permissions(&file, Permissions::from_mode(0o640)).expect("ours");
    symlink("file", &link).expect("written");
    symlink("sub/target", &dangling).expect("written");
    write_whole(&link, "after").expect("written");
    write_whole(&dangling, "new").expect("written");
    assert_eq!((text(&file), text(&target)), ("after".to_owned(), "new".to_owned()));
    assert_eq!(fs::metadata(&file).expect("there").permissions().mode() & 0o7777, 0o640);
    for link in [&link, &dangling] {
        assert!(fs::symlink_metadata(link).expect("there").is_symlink());
    }
    // A new file has the default permissions.
    let plain = directory.path().join("plain");
    fs::write(&plain, "").expect("written");
    let mode = |path: &Path| fs::metadata(path).expect("there").permissions().mode();
    assert_eq!(mode(&target), mode(&plain));
    symlink("circle", directory.path().join("circle")).expect("written");
    assert!(write_whole(&directory.path().join("circle"), "").is_err());
}

#[test]
fn devices_are_written_directly_and_directories_are_refused() {
    write_whole(Path::new("/dev/null"), "nothing").expect("a device");
    let error = write_whole(Path::new("/dev/full"), "something").expect_err("a full device");
    assert_eq!(error.kind(), std::io::ErrorKind::StorageFull);
    let directory = tempfile::tempdir().expect("a directory");
    for path in
        [directory.path().to_owned(), directory.path().join("none/file"), directory.path().join("none/"), "".into()]
    {
        assert!(Output::create(&path).is_err(), "{}", path.display());
    }
    // The longest name of a file system.
    let long = directory.path().join("n".repeat(255));
    write_whole(&long, "long").expect("written");
    assert_eq!(text(&long), "long");
}

#[test]
fn outputs_are_moved_when_all_are_complete() {
    let directory = tempfile::tempdir().expect("a directory");
    let paths = ["one", "other"].map(|name| directory.path().join(name));
    let outputs = paths.each_ref().map(|path| {
        let mut output = Output::create(path).expect("written");
        output.write_all(b"whole").expect("written");
        output
    });
    assert!(paths.iter().all(|path| !path.exists()));
    persist_all(outputs).expect("written");
    assert!(paths.iter().all(|path| text(path) == "whole"));
}
