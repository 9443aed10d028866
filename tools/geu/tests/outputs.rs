//! Output files of every option: a failure keeps the previous file, and no output is an input.
//!
//! `outputs.txt` lists every option; a unit test compares it with the command line.

use std::fs;
use std::io::Write;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// The previous content of an output.
const BEFORE: &str = "previous content";
/// Time limit of a process on a loaded machine.
const TIMEOUT: Duration = Duration::from_secs(30);

/// Options that write a file, and the other arguments: words with a leading `@` are files of the test directory.
const CASES: [(&str, &str); 17] = [
    ("blind campaign --json", "--config @unit.toml --runs 1 --sizes 12 --duration 900"),
    ("blind merge --json", "@part.json"),
    ("calibrate --html", CALIBRATE),
    ("calibrate --json", CALIBRATE),
    ("calibrate --out", CALIBRATE),
    ("decode --defects", "@defective.log --quiet"),
    ("decode --out", "@long/link.log --quiet"),
    ("describe --out", "icd"),
    ("diagnose --html", DIAGNOSE),
    ("diagnose --json", DIAGNOSE),
    ("diagnose --next-manoeuvre", AMBIGUOUS),
    ("diagnose --out", DIAGNOSE),
    ("reconstruct --out", "--link @long/link.log --sse @long/sse.csv"),
    ("replay --junit", "@short.log --tcp 127.0.0.1:0 --speed 100"),
    ("run --junit", "@unit.toml --tcp 127.0.0.1:0 --control off --duration 0.5"),
    ("simulate --junit", "@unit.toml --duration 1 --out @new"),
    ("track --out", "@long/link.log --config @unit.toml --quiet"),
];
const CALIBRATE: &str =
    "--config @unit.toml --link @long/link.log --manoeuvres @long/manoeuvres.csv --reference @long/reference.csv";
/// Only the drift of one gyro differs from the recording's: an effect takes ten times as long to search.
const DIAGNOSE: &str =
    "--set gyro.GYRX.drift.arcsec_per_h=50 --link @quarter/link.log --reference @quarter/reference.csv";
/// The only part of a campaign of one run without an effect, one with an effect and one outside the catalogue.
const PART: &str = r#"{"version": "0.1.0", "shard": [1, 1], "seed": 1, "runs": 1, "sizes": [12.0], "duration_s": 900.0,
"configuration": "", "trials": [RUN, RUN, RUN]}"#;
const RUN: &str = r#"{"hidden": [], "verdict": "consistent", "said": [], "false_names": [], "is_misnamed": false}"#;
/// An effect that the recording hardly distinguishes from a dead zone.
const AMBIGUOUS: &str =
    "--set gyro.GYRX.output-axis-acceleration.seconds=0.05 --link @quarter/link.log --reference @quarter/reference.csv";
/// Options that name directories; `directories.rs` tests them.
const DIRECTORIES: [&str; 7] = [
    "blind hide --out",
    "checkout --out",
    "decode --partition",
    "man --out",
    "run --record",
    "simulate --out",
    "simulate --svg",
];

struct TestDirectory(tempfile::TempDir);

impl TestDirectory {
    /// A directory with the inputs of the commands.
    fn new() -> TestDirectory {
        let directory = TestDirectory(tempfile::tempdir().expect("a directory"));
        fs::write(directory.path("unit.toml"), "seed = 1\n").expect("written");
        fs::write(directory.path("part.json"), PART.replace("RUN", RUN)).expect("written");
        for (name, duration) in [("long", "14000"), ("quarter", "900")] {
            let out = directory.path(name);
            let simulated = directory.geu("simulate", &["--duration", duration, "--out"]).arg(out).output();
            assert!(simulated.expect("geu runs").status.success());
        }
        let log = fs::read_to_string(directory.path("long/link.log")).expect("a recording");
        let lines: Vec<&str> = log.lines().collect();
        fs::write(directory.path("short.log"), lines[..30].join("\n") + "\n").expect("written");
        fs::write(directory.path("defective.log"), lines[..30].join("\n") + "\nno frame\n").expect("written");
        directory
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn geu(&self, command: &str, arguments: &[&str]) -> Command {
        let mut geu = Command::new(env!("CARGO_BIN_EXE_geu"));
        geu.args(command.split(' ')).args(arguments).env("XDG_CACHE_HOME", self.path("cache")).stdin(Stdio::null());
        geu
    }

    /// The words of a case, without its output.
    fn words(&self, words: &str) -> Vec<String> {
        let word = |word: &str| match word.strip_prefix('@') {
            Some(name) => self.path(name).display().to_string(),
            None => word.to_owned(),
        };
        words.split(' ').map(word).collect()
    }

    /// Runs a case with an output and an optional limit of file sizes.
    fn run(&self, (option, words): (&str, &str), output: &Path, limit: Option<&str>) -> Output {
        let mut command = match limit {
            // A limit of file sizes has the effect of a full disk.
            Some(limit) => {
                let mut shell = Command::new("sh");
                shell.args(["-c", &format!("ulimit -f {limit}; exec \"$0\" \"$@\""), env!("CARGO_BIN_EXE_geu")]);
                shell
            }
            None => Command::new(env!("CARGO_BIN_EXE_geu")),
        };
        command.env("XDG_CACHE_HOME", self.path("cache")).stdin(Stdio::null());
        let (command_name, option) = option.rsplit_once(' ').expect("a command and an option");
        command.args(command_name.split(' ')).args(self.words(words)).arg(option).arg(output);
        command.output().expect("geu runs")
    }
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Incomplete files beside `path`.
fn partial(path: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(path.parent().expect("a directory")).expect("a directory");
    let paths = entries.map(|entry| entry.expect("an entry").path());
    paths.filter(|path| path.extension().is_some_and(|end| end == "partial")).collect()
}

#[test]
fn the_table_has_every_option() {
    let mut named: Vec<&str> = CASES.iter().map(|(option, _)| *option).chain(DIRECTORIES).collect();
    named.sort_unstable();
    assert_eq!(named, include_str!("outputs.txt").lines().collect::<Vec<_>>());
}

#[test]
fn an_output_that_is_an_input_is_refused() {
    let directory = TestDirectory::new();
    for case in CASES {
        let Some(input) = case.1.split(' ').find_map(|word| word.strip_prefix('@')) else { continue };
        let (input, before) = (directory.path(input), fs::read(directory.path(input)).expect("an input"));
        let [hard, soft] = ["hard", "soft"].map(|name| directory.path(name));
        for link in [&hard, &soft] {
            let _ = fs::remove_file(link);
        }
        fs::hard_link(&input, &hard).expect("written");
        symlink(&input, &soft).expect("written");
        for path in [&input, &hard, &soft] {
            let output = directory.run(case, path, None);
            let message = stderr(&output);
            assert_eq!(output.status.code(), Some(2), "{case:?}: {message}");
            let option = case.0.rsplit(' ').next().expect("an option");
            let expected = format!("{option} {}: expected a file that is not an input", path.display());
            assert!(message.lines().count() == 1 && message.contains(&expected), "{case:?}: {message}");
            assert!(output.stdout.is_empty() && fs::read(&input).expect("still there") == before, "{case:?}");
        }
    }
}

#[test]
fn standard_output_is_an_output_too() {
    let directory = TestDirectory::new();
    let path = directory.path("short.log");
    let before = text(&path);
    let stdout = fs::OpenOptions::new().append(true).open(&path).expect("written");
    let output = directory.geu("decode", &["--quiet"]).arg(&path).stdout(stdout).output().expect("geu runs");
    assert_eq!((output.status.code(), text(&path)), (Some(2), before.clone()), "{}", stderr(&output));
    // Standard error is an output too; the refusal is appended to it, and no row overwrites the input.
    let appended = fs::OpenOptions::new().append(true).open(&path).expect("written");
    let output = directory.geu("decode", &["--quiet", "--out", "/dev/stderr"]).arg(&path).stderr(appended).output();
    assert_eq!(output.expect("geu runs").status.code(), Some(2));
    let after = text(&path);
    let (start, message) = after.split_at(before.len());
    assert!(start == before && message.lines().count() == 1 && message.contains("not an input"), "{message}");
    // A file that is not an input may be standard output and --out at the same time.
    let (path, short) = (directory.path("rows.csv"), directory.path("short.log"));
    let stdout = fs::File::create(&path).expect("written");
    let mut command = directory.geu("decode", &["--quiet", "--out", "/dev/stdout"]);
    let output = command.arg(short).stdout(stdout).output().expect("geu runs");
    assert!(output.status.success() && text(&path).lines().count() > 5, "{}", stderr(&output));
}

#[test]
fn a_truth_that_only_the_configuration_names_is_an_input_too() {
    let directory = TestDirectory::new();
    let [config, truth] = ["unit.toml", "truth.csv"].map(|name| directory.path(name));
    fs::copy(directory.path("quarter/reference.csv"), &truth).expect("written");
    fs::write(&config, "[run]\ntruth = \"truth.csv\"\n").expect("written");
    let before = text(&truth);
    let output = directory.run(("simulate --junit", "@unit.toml --duration 1 --out @new"), &truth, None);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("not an input") && text(&truth) == before, "{}", stderr(&output));
}

#[test]
fn output_is_complete_and_a_full_disk_keeps_the_previous_file() {
    let directory = TestDirectory::new();
    let path = directory.path("output");
    for case in CASES {
        // The complete run comes first: a diagnosis stores its thresholds, and is quick the second time.
        for limit in [None, Some("0")] {
            fs::write(&path, BEFORE).expect("written");
            let output = directory.run(case, &path, limit);
            let (message, code) = (stderr(&output), output.status.code());
            let is_recording = case.0.starts_with("simulate");
            match limit {
                None => assert!(code == Some(0) && text(&path) != BEFORE, "{case:?}: {message}"),
                // The recording cannot start, with a message of its own.
                Some(_) if is_recording => assert!(code == Some(1) || code == Some(2), "{case:?}: {message}"),
                Some(_) => {
                    let expected = format!("geu: {}: cannot be written", path.display());
                    assert!(code == Some(1) && message.contains(&expected), "{case:?}: {code:?}: {message}");
                }
            }
            assert!(limit.is_none() || text(&path) == BEFORE, "{case:?}");
            assert_eq!(partial(&path), Vec::<PathBuf>::new(), "{case:?}");
            let _ = fs::remove_dir_all(directory.path("new"));
        }
    }
    // A missing directory is an error before the command starts.
    for case in CASES {
        let output = directory.run(case, &directory.path("none/output"), None);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{case:?}: {message}");
        assert!(message.lines().count() == 1 && message.contains("in a directory that exists"), "{message}");
    }
}

/// Starts `geu decode` of an endless stream, and waits for rows in its output.
fn follows(directory: &TestDirectory, path: &Path) -> Child {
    fs::write(path, BEFORE).expect("written");
    let mut command = directory.geu("decode", &["-", "--quiet", "--out"]);
    let mut child = command.arg(path).stdin(Stdio::piped()).spawn().expect("geu runs");
    child
        .stdin
        .as_mut()
        .expect("a pipe")
        .write_all(&fs::read(directory.path("short.log")).expect("there"))
        .expect("a reader");
    let start = Instant::now();
    while partial(path).first().is_none_or(|path| text(path).lines().count() <= 5) {
        assert!(start.elapsed() < TIMEOUT, "no rows");
        sleep(Duration::from_millis(10));
    }
    assert_eq!(text(path), BEFORE);
    child
}

#[test]
fn live_rows_are_complete_after_a_signal_and_partial_after_a_kill() {
    let directory = TestDirectory::new();
    let path = directory.path("rows.csv");
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let mut child = follows(&directory, &path);
        let stdin = child.stdin.take();
        kill(Pid::from_raw(child.id() as i32), signal).expect("it runs");
        assert_eq!(child.wait().expect("its end").code(), Some(0), "{signal}");
        drop(stdin);
        assert!(text(&path).lines().count() > 5 && partial(&path).is_empty(), "{signal}: {}", text(&path));
    }
    let mut child = follows(&directory, &path);
    child.kill().expect("it runs");
    child.wait().expect("its end");
    let [partial] = &partial(&path)[..] else { panic!("{:?}", partial(&path)) };
    assert!(text(&path) == BEFORE && text(partial).lines().count() > 5);
}

#[test]
fn truncated_recording_gives_its_rows_and_a_missing_one_keeps_the_previous_file() {
    let directory = TestDirectory::new();
    let (path, short) = (directory.path("rows.csv"), fs::read(directory.path("short.log")).expect("there"));
    let cut = directory.path("cut.log.gz");
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::none());
    gzip.write_all(&short).expect("memory");
    let bytes = gzip.finish().expect("memory");
    fs::write(&cut, &bytes[..bytes.len() - 12]).expect("written");
    fs::write(&path, BEFORE).expect("written");
    let output = directory
        .geu("decode", &["--out"])
        .args([&path, &directory.path("short.log"), &directory.path("none.log")])
        .output();
    let output = output.expect("geu runs");
    assert_eq!((output.status.code(), text(&path).as_str()), (Some(2), BEFORE), "{}", stderr(&output));
    let output = directory.geu("decode", &["--out"]).args([&path, &cut]).output().expect("geu runs");
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(text(&path).lines().count() > 3, "{}", text(&path));
}
