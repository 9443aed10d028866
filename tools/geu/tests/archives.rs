//! Archives of decoded samples: reading back gives the decoded rows.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

struct TestDirectory(tempfile::TempDir);

impl TestDirectory {
    fn new() -> TestDirectory {
        TestDirectory(tempfile::tempdir().expect("a directory"))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Runs a command in the directory.
    fn geu(&self, words: &str) -> Output {
        let mut geu = Command::new(env!("CARGO_BIN_EXE_geu"));
        geu.current_dir(self.0.path()).args(words.split(' ')).env("XDG_CACHE_HOME", self.path("cache"));
        geu.output().expect("geu runs")
    }

    /// Standard output of a command that succeeds.
    fn text(&self, words: &str) -> String {
        let output = self.geu(words);
        assert!(output.status.success(), "{words}: {}", stderr(&output));
        String::from_utf8(output.stdout).expect("text")
    }

    /// The message, of one line, of a command that exits with 2.
    fn refusal(&self, words: &str) -> String {
        let output = self.geu(words);
        let message = stderr(&output);
        assert!(output.status.code() == Some(2) && message.lines().count() == 1, "{words}: {message}");
        message
    }

    /// Compares the rows of an input with the rows of its archive, in one file and by days.
    fn assert_reads_back(&self, name: &str, input: &str, more: &str) {
        let rows = self.text(&format!("decode {input} --quiet{more}"));
        assert!(rows.lines().count() > 2, "{rows}");
        self.text(&format!("decode {input} --quiet --format parquet --out {name}.parquet{more}"));
        assert_eq!(self.text(&format!("decode {name}.parquet --quiet{more}")), rows, "{name}");
        self.text(&format!("decode {input} --quiet --format parquet --partition {name}{more}"));
        assert_eq!(self.text(&format!("decode {name} --quiet{more}")), rows, "{name}");
        let summary = self.text(&format!("decode {name}.parquet --format summary{more}"));
        assert!(summary.contains("accounts for all"), "{summary}");
    }
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn rows_of_the_default_unit_are_read_back() {
    let directory = TestDirectory::new();
    directory.text("simulate --duration 300 --start 1795132760 --out can");
    directory.text("simulate --duration 60 --wire serial --out serial");
    let log = fs::read_to_string(directory.path("can/link.log")).expect("a recording");
    // Samples without clock, gaps, reserved flags, nanoseconds.
    let lines = log.lines().enumerate().filter(|(number, _)| number % 50 != 7 && !(200..230).contains(number));
    let lines: Vec<String> = lines.map(|(_, line)| line.replacen(") ", "123) ", 1)).collect();
    fs::write(directory.path("gaps.log"), lines.join("\n") + "\n").expect("written");
    directory.assert_reads_back("whole", "can/link.log", "");
    directory.assert_reads_back("bytes", "serial/link.bin", "");
    directory.assert_reads_back("gaps", "gaps.log", "");
    let gaps = |input: &str| {
        let summary = directory.text(&format!("decode {input} --format summary"));
        let lines =
            summary.lines().filter(|line| ["-lost ", "repeats ", "clock_ppm "].iter().any(|name| line.contains(name)));
        lines.collect::<Vec<_>>().join("\n")
    };
    assert_eq!(gaps("gaps.parquet"), gaps("gaps.log"));
    assert_eq!(
        directory.text("decode gaps.parquet --quiet --flags bits"),
        directory.text("decode gaps.log --quiet --flags bits")
    );
    directory.text("decode whole.parquet --quiet --format parquet --out again.parquet");
    assert_eq!(fs::read(directory.path("again.parquet")).ok(), fs::read(directory.path("whole.parquet")).ok());
}

/// A unit with samples in rows of a table, with starts and trials.
const TABLE: &str = r#"
[device]
name = "table"
source = "test"
interval_s = 0.1
output = "rate"
range_arcsec_s = 720000.0

[[device.head]]
name = "X"
input = [1.0, 0.0, 0.0]

[device.table]
time = { column = "at", unit = "s" }
start = { column = "from", unit = "ms" }
group = "trial"
fields = [
  { column = "rate", head = "X", unit = "deg/s" },
  { column = "warm", value = "sensor" },
]
"#;

#[test]
fn rows_of_described_units_are_read_back() {
    let directory = TestDirectory::new();
    for name in ["stim300", "mti-100", "openimu300ri", "tetrad"] {
        directory.text(&format!("simulate --device {name} --duration 2 --start 1795132799 --out recorded-{name}"));
        let recorded = |end: &str| format!("recorded-{name}/link.{end}");
        let input = if directory.path(&recorded("bin")).exists() { recorded("bin") } else { recorded("log") };
        directory.assert_reads_back(name, &input, &format!(" --device {name}"));
        assert!(directory.path(&format!("{name}/device={name}")).is_dir());
    }
    fs::write(directory.path("table.toml"), TABLE).expect("written");
    let rows = "at,from,trial,rate,warm\n1795132799.123456789,1795132799000.5,a,0.1,20\n1795132799.3,1795132799123.456,a,-1e-9,\n\
                1795132800.5,1795132799400,a,3,nan\n1795132801.2,1795132801000,b,4,21.5\n1795132801.3,1795132801200,b,5,\n\
                1795132801.3,1795132801200,b,5,\n1795132801.5,1795132801400,b,,\n";
    fs::write(directory.path("rows.csv"), rows).expect("written");
    directory.assert_reads_back("table", "rows.csv", " --device table.toml");
}

#[test]
fn samples_of_several_recordings_are_numbered_through_by_their_times() {
    let directory = TestDirectory::new();
    for (name, start) in [("one", 1_795_132_700), ("two", 1_795_219_100)] {
        directory.text(&format!("simulate --device openimu300ri --duration 1 --start {start} --out {name}"));
        let format = "--quiet --format parquet --partition archive";
        directory.text(&format!("decode {name}/link.log --device openimu300ri {format}"));
    }
    let rows = directory.text("decode archive --device openimu300ri --quiet");
    let numbers = rows
        .lines()
        .skip(1)
        .map(|line| line.split(',').nth(1).and_then(|number| number.parse().ok()).expect("a number"));
    // A day has 8 640 000 samples.
    assert_eq!(numbers.collect::<Vec<u64>>(), (0..100).chain(8_640_000..8_640_100).collect::<Vec<_>>());
}

#[test]
fn a_range_of_times_selects_rows_and_evaluations_of_an_archive_equal_those_of_the_link() {
    let directory = TestDirectory::new();
    directory.text("simulate --duration 14000 --start 1795132000 --out unit");
    directory.text("decode unit/link.log --quiet --format parquet --partition archive");
    let rows = directory.text("decode unit/link.log --quiet");
    let within = |from: f64, to: f64| {
        let is_within = |line: &&str| {
            line.split(',').next().and_then(|t_s| t_s.parse().ok()).is_none_or(|t_s: f64| from <= t_s && t_s < to)
        };
        rows.lines().filter(is_within).map(|line| format!("{line}\n")).collect::<String>()
    };
    // 2026-11-19T23:55:00Z is 1795132500.
    let selected = directory.text("decode archive --quiet --from 2026-11-19T23:55:00Z --to 1795133000.25");
    assert_eq!(selected, within(1_795_132_500.0, 1_795_133_000.25));
    assert!(selected.lines().count() > 900);
    for command in ["calibrate --config", "diagnose --seed 1 --config"] {
        let results = |link: &str, name: &str| {
            let files = "--reference unit/reference.csv --manoeuvres unit/manoeuvres.csv";
            let output = directory.geu(&format!("{command} unit/run.toml --link {link} {files} --json {name}"));
            assert!(output.status.code() != Some(2), "{}", stderr(&output));
            fs::read_to_string(directory.path(name)).expect("a result")
        };
        assert_eq!(results("archive/device=iras", "one.json"), results("unit/link.log", "two.json"), "{command}");
    }
    let message = directory.refusal("decode archive --quiet --from 1800000000");
    assert!(message.contains("expected samples of") && message.contains("in this range, got none"), "{message}");
    let message = directory.refusal("decode unit/link.log --quiet --from 0");
    assert!(message.contains("link.log: expected an archive"), "{message}");
    let message = directory.refusal("decode archive --quiet --from 2 --to 2");
    assert!(message.contains("--to: expected a time after that of --from"), "{message}");
}

#[test]
fn an_archive_of_another_unit_or_of_several_and_a_damaged_file_are_refused() {
    let directory = TestDirectory::new();
    directory.text("simulate --duration 60 --out iras");
    directory.text("simulate --device stim300 --duration 1 --out stim300");
    directory.text("decode iras/link.log --quiet --format parquet --partition both");
    directory.text("decode stim300/link.bin --device stim300 --quiet --format parquet --partition both");
    let message = directory.refusal("decode both --quiet");
    assert!(
        message.contains("both: expected an archive of one unit, got iras, stim300; give both/device=iras"),
        "{message}"
    );
    let message = directory.refusal("decode both/device=stim300 --quiet");
    assert!(message.contains("expected an archive of iras, got stim300; give --device stim300"), "{message}");
    directory.text("decode iras/link.log --quiet --format arrow --partition arrow");
    let message = directory.refusal("decode arrow --quiet");
    assert!(message.contains("arrow: expected Parquet files, got Arrow files"), "{message}");
    directory.text("decode iras/link.log --quiet --format arrow --out rows.arrow");
    let message = directory.refusal("decode rows.arrow --quiet");
    assert!(message.contains("is an Arrow file") && message.contains("pyarrow"), "{message}");
    assert!(directory.refusal("decode iras --quiet").contains("iras: is a directory"));

    // A hostile file: bytes changed or cut anywhere. A result or a message, no panic.
    directory.text("decode iras/link.log --quiet --format parquet --out whole.parquet");
    let whole = fs::read(directory.path("whole.parquet")).expect("a file");
    let mut random = 1u64;
    for trial in 0..60 {
        let mut bytes = whole.clone();
        let mut next = |below: usize| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) as usize % below
        };
        match trial % 4 {
            0 => bytes.truncate(4 + next(whole.len() - 4)),
            // The metadata is at the end.
            part => (0..3).for_each(|_| {
                let at = if part == 1 { next(whole.len()) } else { whole.len() - 1 - next(whole.len() / 2) };
                bytes[at] ^= 1 << next(8);
            }),
        }
        damaged(&directory, &directory.path("damaged.parquet"), &bytes);
    }
}

fn damaged(directory: &TestDirectory, path: &Path, bytes: &[u8]) {
    fs::write(path, bytes).expect("written");
    let output = directory.geu("decode damaged.parquet --quiet --out rows.csv");
    let message = stderr(&output);
    assert!(matches!(output.status.code(), Some(0 | 2)), "{message}");
    assert!(message.lines().count() <= 1 && !message.contains("panicked"), "{message}");
}
