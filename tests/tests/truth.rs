//! Truth from files: a run on the reference of another one, on a CCSDS attitude ephemeris, and what is refused.

use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Output;

use geu_tests::geu;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

fn run(arguments: &[&str]) -> Output {
    geu().args(arguments).output().expect("geu starts")
}

fn simulate(arguments: &[&str], out: &Path) {
    let output = geu().arg("simulate").args(arguments).arg("--out").arg(out).output().expect("geu starts");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

fn path(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// The fields of a CSV file behind its header.
fn rows(file: &Path) -> Vec<Vec<String>> {
    let text = fs::read_to_string(file).expect("a file");
    text.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

fn number(field: &str) -> f64 {
    field.parse().unwrap_or_else(|error| panic!("{field}: {error}"))
}

/// Accumulated counts of each gyro after every sample.
fn accumulated(directory: &Path) -> Vec<[f64; 4]> {
    let mut sums = [0.0; 4];
    let of_gyros = rows(&directory.join("truth.csv"));
    of_gyros
        .chunks(4)
        .map(|rows| {
            for (sum, row) in sums.iter_mut().zip(rows) {
                *sum += number(row.last().expect("a count"));
            }
            sums
        })
        .collect()
}

const FILES: [&str; 8] =
    ["link.log", "reference.csv", "truth.csv", "manoeuvres.csv", "fss.csv", "sse.csv", "commands.jsonl", "run.toml"];

fn assert_same_bytes(a: &Path, b: &Path) {
    for name in FILES {
        let read = |directory: &Path| fs::read(directory.join(name)).expect(name);
        assert!(read(a) == read(b), "{name} differs between {} and {}", a.display(), b.display());
    }
}

#[test]
fn a_run_on_the_reference_of_another_counts_the_same_and_is_made_again_from_its_run_toml() {
    let directory = tempfile::tempdir().expect("a directory");
    let [scenario, file, again, live] = ["scenario", "file", "again", "live"].map(|name| directory.path().join(name));
    // A pointing and the first two scans about Y.
    simulate(&["--duration", "1200"], &scenario);
    let reference = scenario.join("reference.csv");
    simulate(&["--truth", path(&reference)], &file);
    // The spline's 0.0013″, ten times as much at the ends, and the rounding of each.
    for (a, b) in accumulated(&scenario).iter().zip(accumulated(&file)) {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1.0), "{a:?} {b:?}");
    }
    for (a, b) in rows(&reference).iter().zip(rows(&file.join("reference.csv"))) {
        assert!(a.iter().zip(&b).all(|(a, b)| (number(a) - number(b)).abs() < 1e-6), "{a:?} {b:?}");
    }
    // The limit cycle is found in what the rates have more than θ and ψ mean, up to where it starts: a step of 4″ or two.
    let (a, b) = (rows(&scenario.join("fss.csv")), rows(&file.join("fss.csv")));
    assert_eq!((a.len(), b.len()), (2400, 2400));
    for (a, b) in a.iter().zip(b) {
        assert!((1..3).all(|column| (number(&a[column]) - number(&b[column])).abs() <= 8.0), "{a:?} {b:?}");
    }
    // A file has no manoeuvres, and so no reference times.
    assert_eq!(rows(&file.join("manoeuvres.csv")).len() + rows(&file.join("sse.csv")).len(), 0);

    simulate(&[path(&file.join("run.toml"))], &again);
    assert_same_bytes(&file, &again);
    let socket = directory.path().join("pty");
    let arguments = ["run", "--truth", path(&reference), "--speed", "max", "--start", "0", "--pty", path(&socket)];
    let output = geu().args(arguments).args(["--wire", "can", "--record"]).arg(&live).output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_same_bytes(&file, &live);
}

#[test]
fn an_attitude_ephemeris_moves_the_unit() {
    let directory = tempfile::tempdir().expect("a directory");
    let (file, out) = (directory.path().join("turn.aem"), directory.path().join("out"));
    let mut text = "CCSDS_AEM_VERS = 1.0\nCREATION_DATE = 2026-03-31T00:00:00\nORIGINATOR = TEST\nMETA_START\nOBJECT_NAME = GEU\nOBJECT_ID = 1983-004A\nREF_FRAME_A = EME2000\nREF_FRAME_B = SC_BODY_1\nATTITUDE_DIR = A2B\nTIME_SYSTEM = UTC\nSTART_TIME = 2026-03-31T00:00:00\nSTOP_TIME = 2026-03-31T00:01:00\nATTITUDE_TYPE = QUATERNION\nQUATERNION_TYPE = FIRST\nMETA_STOP\nDATA_START\n".to_owned();
    // 200″/s about +X.
    for second in 0..60 {
        let half_rad = (f64::from(second) * 100.0 / 3600.0).to_radians();
        writeln!(text, "2026-03-31T00:00:{second:02} {} {} 0 0", half_rad.cos(), half_rad.sin()).expect("a string");
    }
    fs::write(&file, text + "DATA_STOP\n").expect("written");
    simulate(&["--truth", path(&file), "--set", "gyro.GYRX.angle-random-walk.arcsec_per_sqrt_s=0"], &out);
    let reference = fs::read_to_string(out.join("reference.csv")).expect("a file");
    // θ and ψ are unavailable: no column has them, and the FSS outputs no samples.
    assert!(reference.starts_with("t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s\n"), "{reference}");
    let rates = rows(&out.join("reference.csv"));
    assert_eq!((rates.len(), rows(&out.join("fss.csv")).len()), (118, 0));
    assert!(rates.iter().all(|row| (number(&row[1]) - 200.0).abs() < 1e-4 && number(&row[2]).abs() < 1e-4));
    // (200″/s·59 s − 118·0.21″)/1.0012, rounded.
    assert_eq!(accumulated(&out).last().map(|sums| sums[0]), Some(11_761.0));
}

#[test]
fn manoeuvres_are_written_until_the_end_of_the_run() {
    let directory = tempfile::tempdir().expect("a directory");
    // Legs of the default scenario end at 600, 770, 1090 s; the end of a run with a slow clock, 0.1 % later, cuts one.
    let exact = "unit.clock-frequency.ppm=0";
    let slow = "unit.clock-frequency.ppm=-1000";
    for (index, (duration, set, ends)) in [
        ("100", exact, &[100.0][..]),
        ("600", exact, &[600.0]),
        ("1000", exact, &[600.0, 770.0, 1000.0]),
        ("1000", slow, &[600.0, 770.0, 1001.001001]),
    ]
    .into_iter()
    .enumerate()
    {
        let out = directory.path().join(index.to_string());
        simulate(&["--duration", duration, "--set", set, "--start", "1700000000"], &out);
        let rows = rows(&out.join("manoeuvres.csv"));
        let mut start = "1700000000.000000".to_owned();
        assert_eq!(rows.len(), ends.len(), "{rows:?}");
        for (row, end_s) in rows.iter().zip(ends) {
            assert_eq!((&row[1], &row[2]), (&start, &format!("{:.6}", 1_700_000_000.0 + end_s)));
            start.clone_from(&row[2]);
        }
    }
    // The attitude is held after the scenario, until the end of the run.
    let short = directory.path().join("short.toml");
    fs::write(&short, "[[manoeuvre]]\nkind = \"pointing\"\nduration_s = 5\n").expect("written");
    let held = directory.path().join("held");
    simulate(&[path(&short), "--duration", "8"], &held);
    let fields = [["pointing", "0.000000", "5.000000"], ["hold", "5.000000", "8.000000"]];
    assert_eq!(rows(&held.join("manoeuvres.csv")), fields);
}

#[test]
fn a_truth_that_cannot_serve_is_refused_at_the_start() {
    let directory = tempfile::tempdir().expect("a directory");
    let (scenario, out) = (directory.path().join("scenario"), directory.path().join("out"));
    simulate(&["--duration", "10"], &scenario);
    let reference = scenario.join("reference.csv");
    let missing = directory.path().join("nothing.csv");
    let gap = directory.path().join("gap.csv");
    let text = fs::read_to_string(&reference).expect("a file");
    let cut: String = text.lines().enumerate().filter(|(n, _)| *n != 7).map(|(_, line)| format!("{line}\n")).collect();
    fs::write(&gap, cut).expect("written");
    for command in ["simulate", "run"] {
        let place = if command == "simulate" { "--out" } else { "--record" };
        for (truth, duration, part) in [
            (&reference, "11", "expected a truth that covers the run of 11 s, got 10 s, enough for 10 s"),
            (&missing, "5", "nothing.csv: cannot be read"),
            (&gap, "5", "gap.csv: line 8: expected rows every 0.5 s or so, got a gap of 1 s"),
        ] {
            let output = run(&[command, "--truth", path(truth), "--duration", duration, place, path(&out)]);
            let message = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(2), "{message}");
            assert!(message.contains(part), "{part} not in {message}");
        }
    }
    assert!(!out.exists(), "nothing is written for a run that cannot be");
}

#[test]
fn a_discovered_term_is_simulated_recorded_in_the_truth_and_reproduced() {
    let directory = tempfile::tempdir().expect("a directory");
    let (first, again) = (directory.path().join("first"), directory.path().join("again"));
    let terms = r#"gyro.GYRY.discovered=[{formula="rate_y^2",coefficient=4e-7}]"#;
    simulate(&["--duration", "900", "--set", terms], &first);
    simulate(&[path(&first.join("run.toml"))], &again);
    assert_same_bytes(&first, &again);
    let truth = fs::read_to_string(first.join("truth.csv")).expect("a file");
    let header: Vec<&str> = truth.lines().next().expect("a header").split(',').collect();
    let place = |name: &str| header.iter().position(|own| *own == name).unwrap_or_else(|| panic!("{name}: {header:?}"));
    let (own, from, to) = (place("discovered_counts"), place("true_arcsec"), place("unquantised"));
    let mut most: f64 = 0.0;
    for row in rows(&first.join("truth.csv")) {
        let sum: f64 = row[from..to].iter().map(|field| number(field)).sum();
        assert!((sum - number(&row[to])).abs() < 1e-9, "{row:?}");
        if row[2] == "GYRY" {
            most = most.max(number(&row[own]));
        } else {
            assert_eq!(number(&row[own]), 0.0, "{row:?}");
        }
    }
    // A scan of 720″/s about Y: (720″/s)²·4·10⁻⁷·0.5 s/0.9987, the limit cycle beside it.
    assert!((0.1038..0.1055).contains(&most), "{most}");
}

#[test]
fn the_truth_as_columns_has_the_rows_of_the_csv() {
    let directory = tempfile::tempdir().expect("a directory");
    let [text, columns] = ["text", "columns"].map(|name| directory.path().join(name));
    for device in ["iras", "kvh-1750"] {
        let arguments = ["--device", device, "--duration", "2", "--seed", "3", "--force"];
        simulate(&arguments, &text);
        simulate(&arguments, &columns);
        simulate(&[&arguments[..], &["--format", "parquet"]].concat(), &columns);
        assert!(!columns.join("truth.csv").exists());
        let lines = geu_recording::open_rows(&columns.join("truth.parquet")).expect("a table").lines();
        let cells = |line: String| line.split('\u{1f}').map(str::to_owned).collect::<Vec<_>>();
        let mut read: Vec<Vec<String>> = lines.map(|line| cells(line.expect("a row"))).collect();
        let header = read.remove(0);
        let text = fs::read_to_string(text.join("truth.csv")).expect("a truth");
        let names: Vec<&str> = text.lines().next().expect("a header").split(',').collect();
        assert_eq!(header[..4], ["time", "t_s", "time_rest_ns", "t_s_decimals"]);
        assert_eq!(header[4..], names[1..]);
        assert_eq!(read.len(), text.lines().count() - 1);
        for (row, line) in read.iter().zip(text.lines().skip(1)) {
            let cells: Vec<&str> = line.split(',').collect();
            assert_eq!((number(&row[1]), &*row[5]), (number(cells[0]), cells[2]));
            let numbers = [&row[4..5], &row[6..]].concat();
            let of_text = [&cells[1..2], &cells[3..]].concat();
            assert!(numbers.iter().zip(of_text).all(|(one, other)| number(one) == number(other)), "{row:?} {line}");
        }
    }
}

#[test]
fn a_killed_run_with_a_truth_as_columns_is_repeated_to_its_planned_end() {
    let directory = tempfile::tempdir().expect("a directory");
    let [killed, again] = ["killed", "again"].map(|name| directory.path().join(name));
    let arguments = ["simulate", "--duration", "30d", "--format", "parquet", "--out", path(&killed)];
    let mut child = geu().args(arguments).stderr(std::process::Stdio::null()).spawn().expect("geu starts");
    let is_partial = |entry: std::io::Result<fs::DirEntry>| {
        entry.expect("a file").path().extension().is_some_and(|end| end == "partial")
    };
    while !fs::read_dir(&killed).is_ok_and(|mut files| files.any(is_partial)) {
        assert!(child.try_wait().expect("a process").is_none(), "ended before its first rows");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    kill(Pid::from_raw(child.id() as i32), Signal::SIGKILL).expect("killed");
    child.wait().expect("its end");
    let run = fs::read_to_string(killed.join("run.toml")).expect("a configuration");
    assert!(run.contains("duration_s = 2592000.0") && run.contains("unfinished = true"), "{run}");
    simulate(&[path(&killed.join("run.toml")), "--duration", "5"], &again);
    simulate(&["--duration", "5", "--format", "parquet", "--force"], &killed);
    assert!(!fs::read_dir(&killed).expect("files").any(is_partial));
    let [of_killed, of_again] = [&killed, &again].map(|run| fs::read(run.join("link.log")).expect("a link"));
    assert!(of_killed == of_again);
}
