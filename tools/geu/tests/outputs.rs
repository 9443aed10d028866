//! Files that a command writes, option by option: whatever goes wrong leaves what was there, and no output is an input.
//!
//! `outputs.txt` names every option; a test of the command holds it to the command line.

use std::fs;
use std::io::Write;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// What is there before a command.
const BEFORE: &str = "what was there";
/// Until a process has done what is asked: a loaded machine takes its time.
const TIMEOUT: Duration = Duration::from_secs(30);

/// How a command is called that writes a file: words that begin with `@` are files of the room.
const CASES: [(&str, &str); 15] = [
    ("blind campaign --json", "--config @unit.toml --runs 1 --sizes 12 --duration 900"),
    ("calibrate --html", CALIBRATE),
    ("calibrate --json", CALIBRATE),
    ("calibrate --out", CALIBRATE),
    ("decode --defects", "@defective.log --quiet"),
    ("decode --out", "@long/link.log --quiet"),
    ("describe --out", "icd"),
    ("diagnose --html", DIAGNOSE),
    ("diagnose --json", DIAGNOSE),
    ("diagnose --out", DIAGNOSE),
    ("reconstruct --out", "--config @unit.toml --link @long/link.log --sse @long/sse.csv"),
    ("replay --junit", "@short.log --tcp 127.0.0.1:0 --speed 100"),
    ("run --junit", "@unit.toml --tcp 127.0.0.1:0 --control off --duration 0.5"),
    ("simulate --junit", "@unit.toml --duration 1 --out @new"),
    ("track --out", "@long/link.log --config @unit.toml --quiet"),
];
const CALIBRATE: &str =
    "--config @unit.toml --link @long/link.log --manoeuvres @long/manoeuvres.csv --reference @long/reference.csv";
const DIAGNOSE: &str = "--config @unit.toml --link @quarter/link.log --reference @quarter/reference.csv";
/// Options that name directories; `directories.rs` has them.
const DIRECTORIES: [&str; 5] =
    ["blind hide --out", "checkout --out", "run --record", "simulate --out", "simulate --svg"];

struct Room(tempfile::TempDir);

impl Room {
    /// With what the commands read.
    fn new() -> Room {
        let room = Room(tempfile::tempdir().expect("a directory"));
        fs::write(room.path("unit.toml"), "seed = 1\n").expect("room");
        for (name, duration) in [("long", "14000"), ("quarter", "900")] {
            let out = room.path(name);
            let simulated = room.geu("simulate", &["--duration", duration, "--out"]).arg(out).output();
            assert!(simulated.expect("geu runs").status.success());
        }
        let log = fs::read_to_string(room.path("long/link.log")).expect("a recording");
        let lines: Vec<&str> = log.lines().collect();
        fs::write(room.path("short.log"), lines[..30].join("\n") + "\n").expect("room");
        fs::write(room.path("defective.log"), lines[..30].join("\n") + "\nno frame\n").expect("room");
        room
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

    /// Runs a case with an output.
    fn run(&self, (option, words): (&str, &str), output: &Path, limit: Option<&str>) -> Output {
        let mut command = match limit {
            // A limit on the size of files takes the place of a full disk.
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

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Files beside `path` that are not whole.
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
    let room = Room::new();
    for case in CASES {
        let Some(input) = case.1.split(' ').find_map(|word| word.strip_prefix('@')) else { continue };
        let (input, before) = (room.path(input), fs::read(room.path(input)).expect("an input"));
        let [hard, soft] = ["hard", "soft"].map(|name| room.path(name));
        for link in [&hard, &soft] {
            let _ = fs::remove_file(link);
        }
        fs::hard_link(&input, &hard).expect("room");
        symlink(&input, &soft).expect("room");
        for path in [&input, &hard, &soft] {
            let output = room.run(case, path, None);
            let message = said(&output);
            assert_eq!(output.status.code(), Some(2), "{case:?}: {message}");
            let option = case.0.rsplit(' ').next().expect("an option");
            let expected = format!("{option} {}: expected a file that is none of the inputs", path.display());
            assert!(message.lines().count() == 1 && message.contains(&expected), "{case:?}: {message}");
            assert!(output.stdout.is_empty() && fs::read(&input).expect("still there") == before, "{case:?}");
        }
    }
}

#[test]
fn standard_output_is_an_output_too() {
    let room = Room::new();
    let path = room.path("short.log");
    let before = text(&path);
    let stdout = fs::OpenOptions::new().append(true).open(&path).expect("room");
    let output = room.geu("decode", &["--quiet"]).arg(&path).stdout(stdout).output().expect("geu runs");
    assert_eq!((output.status.code(), text(&path)), (Some(2), before.clone()), "{}", said(&output));
    // So is standard error, and what is refused says so there; rows may not be written over the input through it.
    let stderr = fs::OpenOptions::new().append(true).open(&path).expect("room");
    let output = room.geu("decode", &["--quiet", "--out", "/dev/stderr"]).arg(&path).stderr(stderr).output();
    assert_eq!(output.expect("geu runs").status.code(), Some(2));
    let after = text(&path);
    let (start, message) = after.split_at(before.len());
    assert!(start == before && message.lines().count() == 1 && message.contains("none of the inputs"), "{message}");
    // What is not read may be standard output and --out at once.
    let (path, short) = (room.path("rows.csv"), room.path("short.log"));
    let stdout = fs::File::create(&path).expect("room");
    let mut command = room.geu("decode", &["--quiet", "--out", "/dev/stdout"]);
    let output = command.arg(short).stdout(stdout).output().expect("geu runs");
    assert!(output.status.success() && text(&path).lines().count() > 5, "{}", said(&output));
}

#[test]
fn a_truth_that_only_the_configuration_names_is_an_input_too() {
    let room = Room::new();
    let [config, truth] = ["unit.toml", "truth.csv"].map(|name| room.path(name));
    fs::copy(room.path("quarter/reference.csv"), &truth).expect("room");
    fs::write(&config, "[run]\ntruth = \"truth.csv\"\n").expect("room");
    let before = text(&truth);
    let output = room.run(("simulate --junit", "@unit.toml --duration 1 --out @new"), &truth, None);
    assert_eq!(output.status.code(), Some(2), "{}", said(&output));
    assert!(said(&output).contains("none of the inputs") && text(&truth) == before, "{}", said(&output));
}

#[test]
fn an_output_is_whole_and_a_full_disk_leaves_what_was_there() {
    let room = Room::new();
    let path = room.path("output");
    for case in CASES {
        // Whole first: a diagnosis keeps its thresholds, and is quick the second time.
        for limit in [None, Some("0")] {
            fs::write(&path, BEFORE).expect("room");
            let output = room.run(case, &path, limit);
            let (message, code) = (said(&output), output.status.code());
            let is_recording = case.0.starts_with("simulate");
            match limit {
                None => assert!(code == Some(0) && text(&path) != BEFORE, "{case:?}: {message}"),
                // The recording, which cannot even begin, says that in its own words.
                Some(_) if is_recording => assert!(code == Some(1) || code == Some(2), "{case:?}: {message}"),
                Some(_) => {
                    let expected = format!("geu: {}: cannot be written", path.display());
                    assert!(code == Some(1) && message.contains(&expected), "{case:?}: {code:?}: {message}");
                }
            }
            assert!(limit.is_none() || text(&path) == BEFORE, "{case:?}");
            assert_eq!(partial(&path), Vec::<PathBuf>::new(), "{case:?}");
            let _ = fs::remove_dir_all(room.path("new"));
        }
    }
    // Where there is no directory it is said before the command begins.
    for case in CASES {
        let output = room.run(case, &room.path("none/output"), None);
        let message = said(&output);
        assert_eq!(output.status.code(), Some(1), "{case:?}: {message}");
        assert!(message.lines().count() == 1 && message.contains("in a directory that is there"), "{message}");
    }
}

/// `geu decode` of a stream that does not end, with an output, when rows are in it.
fn follows(room: &Room, path: &Path) -> Child {
    fs::write(path, BEFORE).expect("room");
    let mut command = room.geu("decode", &["-", "--quiet", "--out"]);
    let mut child = command.arg(path).stdin(Stdio::piped()).spawn().expect("geu runs");
    child
        .stdin
        .as_mut()
        .expect("a pipe")
        .write_all(&fs::read(room.path("short.log")).expect("there"))
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
fn rows_of_a_live_link_are_whole_after_a_signal_and_beside_when_killed() {
    let room = Room::new();
    let path = room.path("rows.csv");
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let mut child = follows(&room, &path);
        let stdin = child.stdin.take();
        kill(Pid::from_raw(child.id() as i32), signal).expect("it runs");
        assert_eq!(child.wait().expect("its end").code(), Some(0), "{signal}");
        drop(stdin);
        assert!(text(&path).lines().count() > 5 && partial(&path).is_empty(), "{signal}: {}", text(&path));
    }
    let mut child = follows(&room, &path);
    child.kill().expect("it runs");
    child.wait().expect("its end");
    let [partial] = &partial(&path)[..] else { panic!("{:?}", partial(&path)) };
    assert!(text(&path) == BEFORE && text(partial).lines().count() > 5);
}

#[test]
fn a_recording_that_is_cut_gives_its_rows_and_a_missing_one_leaves_what_was_there() {
    let room = Room::new();
    let (path, short) = (room.path("rows.csv"), fs::read(room.path("short.log")).expect("there"));
    let cut = room.path("cut.log.gz");
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::none());
    gzip.write_all(&short).expect("memory");
    let bytes = gzip.finish().expect("memory");
    fs::write(&cut, &bytes[..bytes.len() - 12]).expect("room");
    fs::write(&path, BEFORE).expect("room");
    let output = room.geu("decode", &["--out"]).args([&path, &room.path("short.log"), &room.path("none.log")]).output();
    let output = output.expect("geu runs");
    assert_eq!((output.status.code(), text(&path).as_str()), (Some(2), BEFORE), "{}", said(&output));
    let output = room.geu("decode", &["--out"]).args([&path, &cut]).output().expect("geu runs");
    assert_eq!(output.status.code(), Some(2), "{}", said(&output));
    assert!(text(&path).lines().count() > 3, "{}", text(&path));
}
