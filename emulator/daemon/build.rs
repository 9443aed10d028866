//! Takes the charts' library of the bench page, uPlot, from npm; the sources have no copy.
//!
//! In this order: the directory that `GEU_UPLOT` names; `npm pack`. Where neither gives it, the page has no charts.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use std::{env, fs, io, thread};

const VERSION: &str = "1.6.32";
/// Of the package, as the registry tells it too (there in base 64).
const SHA512: &str = "2883159c6ebccefbb95d751b0b82d010f9e1c0ec41b8bc96d401eda66e882935\
                      c89a46cb824332fa369b8cb8122cc6ac36e186cd09bf7a9ded3a4c93c6989023";
/// Name here, and place in the package.
const FILES: [(&str, &str); 3] = [
    ("uPlot.iife.min.js", "package/dist/uPlot.iife.min.js"),
    ("uPlot.min.css", "package/dist/uPlot.min.css"),
    ("LICENSE", "package/LICENSE"),
];
/// A network that hangs is not waited for any longer.
const PATIENCE: Duration = Duration::from_secs(25);

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=GEU_UPLOT");
    let out = env::var_os("OUT_DIR").expect("cargo tells where to write");
    let out = Path::new(&out);
    let taken = match env::var_os("GEU_UPLOT") {
        Some(directory) => named(Path::new(&directory), out),
        None => packed(out),
    };
    if let Err(reason) = taken {
        println!(
            "cargo:warning=the bench page is built without charts: {reason}; to have them, set GEU_UPLOT to a directory \
             with {} of uPlot {VERSION}, or `cargo clean -p geu-daemon` and build with npm and a network",
            FILES.map(|(name, _)| name).join(", ")
        );
        for (name, _) in FILES {
            fs::write(out.join(name), "").expect("the build's own directory can be written");
        }
    }
}

/// From a directory that somebody filled.
fn named(directory: &Path, out: &Path) -> Result<(), String> {
    for (name, _) in FILES {
        println!("cargo:rerun-if-changed={}", directory.join(name).display());
    }
    copied(directory, FILES.map(|(name, _)| (name, name)), out).map_err(|error| format!("GEU_UPLOT: {error}"))
}

/// From the registry.
fn packed(out: &Path) -> Result<(), String> {
    let package = format!("uplot-{VERSION}.tgz");
    if checked(out, &package).is_err() {
        let mut npm = Command::new("npm");
        npm.args(["pack", "--silent", "--ignore-scripts", "--fetch-retries=0", "--fetch-timeout=20000"]);
        ended(npm.arg(format!("uplot@{VERSION}")).current_dir(out)).map_err(|error| format!("npm pack: {error}"))?;
        checked(out, &package)?;
    }
    let mut tar = Command::new("tar");
    tar.args(["xzf", &package]).args(FILES.map(|(_, place)| place));
    ended(tar.current_dir(out)).map_err(|error| format!("tar: {error}"))?;
    copied(out, FILES, out)
}

fn copied(directory: &Path, files: [(&str, &str); 3], out: &Path) -> Result<(), String> {
    for (name, place) in files {
        let file = directory.join(place);
        let text = fs::read_to_string(&file).map_err(|error| format!("{}: {error}", file.display()))?;
        fs::write(out.join(name), text).map_err(|error| error.to_string())?;
    }
    Ok(())
}

/// Whether the package is the one that is meant.
fn checked(out: &Path, package: &str) -> Result<(), String> {
    let output = Command::new("sha512sum").arg(package).current_dir(out).stderr(Stdio::null()).output();
    let output = output.map_err(|error| format!("sha512sum: {error}"))?;
    if output.stdout.starts_with(SHA512.as_bytes()) {
        return Ok(());
    }
    let got = String::from_utf8_lossy(&output.stdout);
    Err(format!("{package}: expected sha512 {SHA512}, got {}", got.split_whitespace().next().unwrap_or("no file")))
}

/// Runs a program to its end, silently.
fn ended(command: &mut Command) -> io::Result<()> {
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
    let give_up = Instant::now() + PATIENCE;
    loop {
        if let Some(status) = child.try_wait()? {
            return if status.success() { Ok(()) } else { Err(io::Error::other(status.to_string())) };
        }
        if Instant::now() > give_up {
            let _ = child.kill();
            let _ = child.wait();
            return Err(io::ErrorKind::TimedOut.into());
        }
        thread::sleep(Duration::from_millis(20));
    }
}
