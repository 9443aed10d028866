//! A disk that hangs, for as long as a file exists: `write` of a program is led past it by a preloaded library.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The library and the file.
pub struct StalledDisk {
    library: PathBuf,
    flag: PathBuf,
    directory: PathBuf,
}

impl StalledDisk {
    /// One that holds the files below `directory`, and does not hang yet; `beside` takes its own files. `None` without a C
    /// compiler.
    ///
    /// # Panics
    /// If the library does not compile.
    pub fn new(directory: &Path, beside: &Path) -> Option<StalledDisk> {
        let (source, library) = (beside.join("stalled_disk.c"), beside.join("stalled_disk.so"));
        fs::write(&source, include_str!("stalled_disk.c")).expect("written");
        let mut compiler = Command::new("cc");
        compiler.args(["-shared", "-fPIC", "-O1", "-o"]).args([&library, &source]).arg("-ldl");
        assert!(compiler.status().ok()?.success(), "{compiler:?}");
        let real = fs::canonicalize(directory.parent()?).expect("a directory").join(directory.file_name()?);
        Some(StalledDisk { library, flag: beside.join("stalled"), directory: real })
    }

    /// Puts it under a program.
    pub fn under(&self, command: &mut Command) {
        command.env("LD_PRELOAD", &self.library);
        command.env("STALLED_DIRECTORY", &self.directory).env("STALLED_WHILE", &self.flag);
    }

    /// From now on nothing is written.
    ///
    /// # Panics
    /// If the file cannot be written.
    pub fn stall(&self) {
        fs::write(&self.flag, "").expect("written");
    }

    /// Ends the stall.
    ///
    /// # Panics
    /// If it did not hang.
    pub fn go_on(&self) {
        fs::remove_file(&self.flag).expect("it hung");
    }
}
