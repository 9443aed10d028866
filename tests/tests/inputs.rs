//! Inputs of any size and origin, as a user meets them: bounded in memory, refused by name, quoted briefly.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use geu_protocol::capture::FOREIGN;
use geu_protocol::serial::data_frame;
use geu_tests::{geu, root};

/// Virtual memory of a child, KiB: some 200 MB lie above what a command needs that reads a bounded input, and gigabytes below what
/// reading without a bound takes.
const CHILD_KIB: u64 = 1_500_000;
/// For a decode of serial bytes, which keeps no rows: the program itself maps some 60 MB of it.
const DECODE_KIB: u64 = 300_000;

/// Runs geu with limited memory.
fn bounded(kib: u64, arguments: &[&str]) -> Output {
    let program = geu().get_program().to_owned();
    let mut shell = Command::new("sh");
    shell.args(["-c", &format!("ulimit -v {kib}; exec \"$0\" \"$@\"")]).arg(program).args(arguments);
    shell.stdin(Stdio::null()).output().expect("a shell")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn path(directory: &Path, name: &str) -> String {
    directory.join(name).to_str().expect("UTF-8").to_owned()
}

/// A file of `head` and `count` times `block`, compressed according to its name.
fn repeated(directory: &Path, name: &str, head: &[u8], block: &[u8], count: usize) -> String {
    let path = path(directory, name);
    let file = BufWriter::new(File::create(&path).expect("a file"));
    let mut file: Box<dyn Write> = match name.rsplit('.').next() {
        Some("gz") => Box::new(flate2::write::GzEncoder::new(file, flate2::Compression::fast())),
        Some("zst") => Box::new(zstd::Encoder::new(file, 1).expect("zstd").auto_finish()),
        _ => Box::new(file),
    };
    file.write_all(head).expect("a file");
    let chunk = block.repeat((1 << 20) / block.len());
    for _ in 0..(count * block.len()).div_ceil(chunk.len()) {
        file.write_all(&chunk).expect("a file");
    }
    path
}

#[test]
fn a_document_is_bounded_while_it_is_unpacked() {
    let directory = tempfile::tempdir().expect("a directory");
    let directory = directory.path();
    // A hundred million newlines were 5 GB of memory.
    let files = [
        repeated(directory, "lines.toml.gz", b"", b"\n", 100_000_000),
        repeated(directory, "comment.toml.zst", b"# ", b"x", 200_000_000),
        repeated(directory, "lines.toml", b"", b"\n", 10_000_000),
    ];
    let capture = root().join("tests/captures/encoded.log");
    let capture = capture.to_str().expect("UTF-8");
    for file in &files {
        for arguments in [
            &["config", "check", file][..],
            &["simulate", "--duration", "1", "--faults", file, "--out", &path(directory, "run")],
            &["track", capture, "--config", file],
            &["decode", capture, "--gyro-csv", file],
            &["blind", "score", "--key", file, "--json", file],
        ] {
            let output = bounded(CHILD_KIB, arguments);
            let message = said(&output);
            assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
            assert!(message.contains("expected at most") && message.contains(file.as_str()), "{message}");
        }
    }
}

#[test]
fn a_document_at_its_bound_is_read_within_memory() {
    let directory = tempfile::tempdir().expect("a directory");
    let file = repeated(directory.path(), "lines.toml", b"", b"\n", 1 << 20);
    let output = bounded(CHILD_KIB, &["config", "check", &file]);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
}

#[test]
fn a_series_is_bounded_row_by_row() {
    let directory = tempfile::tempdir().expect("a directory");
    let directory = directory.path();
    let capture = root().join("tests/captures/encoded.log");
    let capture = capture.to_str().expect("UTF-8");
    let good = |name: &str, text: &str| {
        let path = path(directory, name);
        fs::write(&path, text).expect("a file");
        path
    };
    let list = good("good.csv", "manoeuvre,start_s,end_s\n");
    let sun = good("fss.csv", "t_s,theta_arcsec,roll_arcsec\n0,0,0\n");
    let out = path(directory, "run");
    // What begins as a series and never ends its row: a line, a quoted field, blank lines.
    let quote = |name: &str| if name.starts_with("quoted") { "\"" } else { "" };
    for (name, block) in [("line.csv.zst", &b"0"[..]), ("quoted.csv.zst", b"a\n"), ("blank.csv.gz", b"\n")] {
        let of = |head: &str| repeated(directory, name, [head, quote(name)].concat().as_bytes(), block, 300_000_000);
        let reference = "t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s\n0,0,0,0\n";
        let check = |file: &str, arguments: &[&str]| {
            let output = bounded(CHILD_KIB, arguments);
            let message = said(&output);
            assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
            assert!(message.contains(file) && message.contains("expected a row within"), "{name}: {message}");
        };
        let file = of(reference);
        check(&file, &["simulate", "--truth", &file, "--out", &out]);
        let file = of("manoeuvre,start_s,end_s\n");
        check(&file, &["calibrate", "--link", capture, "--manoeuvres", &file, "--fss", &sun, "--sse", &sun]);
        let file = of("t_s,theta_arcsec,roll_arcsec\n");
        check(&file, &["calibrate", "--link", capture, "--manoeuvres", &list, "--fss", &file, "--sse", &sun]);
    }
    let file = repeated(directory, "m.aem.zst", b"CCSDS_AEM_VERS = 1.0\nCOMMENT ", b"x", 300_000_000);
    let output = bounded(CHILD_KIB, &["simulate", "--truth", &file, "--out", &out]);
    assert!(output.status.code() == Some(2) && said(&output).contains("expected a row within"), "{}", said(&output));
}

#[test]
fn what_is_not_read_is_refused_by_its_name_with_what_converts_it() {
    let directory = tempfile::tempdir().expect("a directory");
    for foreign in FOREIGN {
        let file = path(directory.path(), "capture.bin");
        fs::write(&file, [foreign.signature, &[0x5A; 4000]].concat()).expect("a file");
        let output = geu().args(["decode", &file]).output().expect("geu starts");
        let message = said(&output);
        assert_eq!(output.status.code(), Some(2), "{message}");
        let expected = format!("geu: {file}: is {}, which is not read here; ", foreign.name);
        assert!(message.starts_with(&expected) && message.lines().count() == 1, "{message}");
        assert!(output.stdout.is_empty(), "{message}");
        let rows = path(directory.path(), "rows.csv");
        for arguments in
            [&["decode", &file, "--format", "summary"][..], &["track", &file], &["decode", &file, "--out", &rows]]
        {
            let output = geu().args(arguments).output().expect("geu starts");
            assert!(output.status.code() == Some(2) && output.stdout.is_empty(), "{arguments:?}");
            assert_eq!(fs::read_dir(&directory).expect("a directory").count(), 1, "{arguments:?} leaves no file");
        }
    }
}

#[test]
fn bytes_without_a_frame_are_refused_however_many_there_are() {
    let directory = tempfile::tempdir().expect("a directory");
    let directory = directory.path();
    let mut random = 1u64;
    let noise: Vec<u8> = (0..4_000_000)
        .map(|_| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 56) as u8
        })
        .collect();
    let configuration = root().join("configs/paper.toml");
    let configuration = configuration.to_str().expect("UTF-8");
    let files = [
        (path(directory, "noise.bin"), 4_000_000),
        (repeated(directory, "bomb.gz", b"", &[0], 1_000_000_000), 1 << 26),
        (repeated(directory, "bomb.zst", b"", &[0], 1_000_000_000), 1 << 26),
        ("/dev/zero".to_owned(), 1 << 26),
    ];
    fs::write(&files[0].0, &noise).expect("a file");
    for (file, min_length) in &files {
        let mut refused = Vec::new();
        for arguments in
            [&["decode", "--quiet"][..], &["replay", "--tcp", "127.0.0.1:0"], &["track", "--config", configuration]]
        {
            let output = bounded(CHILD_KIB, &[arguments, &[file]].concat());
            assert_eq!(output.status.code(), Some(2), "{arguments:?} {file}: {}", said(&output));
            refused.push(said(&output));
        }
        let message = &refused[0];
        assert!(refused.iter().all(|other| other == message), "{refused:?}");
        let expected = format!("geu: {file}: offset 0 to ");
        let length = message.strip_prefix(&expected).and_then(|rest| rest.split(':').next()?.parse::<u64>().ok());
        // The limit is checked after each chunk.
        assert!(length.is_some_and(|length| (*min_length..min_length + (2 << 20)).contains(&length)), "{message}");
        assert!(message.contains(
            "expected Vector BLF, pcap, pcapng or serial frames EB 90 … with a matching CRC, got none; it begins"
        ));
    }
}

#[test]
fn a_recording_behind_noise_is_read() {
    let directory = tempfile::tempdir().expect("a directory");
    let frame = data_frame(&Default::default());
    for name in ["noise.bin", "noise.gz"] {
        let head = [&vec![0; 20_000_000][..], &frame].concat();
        let file = repeated(directory.path(), name, &head, &[0], 100_000_000);
        let output = bounded(DECODE_KIB, &["decode", &file]);
        assert!(output.status.success(), "{}", said(&output));
        assert_eq!(String::from_utf8_lossy(&output.stdout).lines().count(), 2, "{}", said(&output));
    }
}

#[test]
fn a_defect_that_comes_again_is_one_line_with_a_count() {
    let directory = tempfile::tempdir().expect("a directory");
    let directory = directory.path();
    let good = data_frame(&Default::default());
    let file = repeated(directory, "sync.bin", &good, &[0xEB, 0x90], 10_000_000);
    let (defects, rows) = (path(directory, "defects.jsonl"), path(directory, "rows.csv"));
    let length = fs::metadata(&file).expect("a file").len();
    let output =
        bounded(DECODE_KIB, &["decode", &file, "--defects", &defects, "--out", &rows, "--input-format", "serial"]);
    assert!(output.status.success(), "{}", said(&output));
    let text = fs::read_to_string(&defects).expect("defects");
    let lines: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).expect(line)).collect();
    assert!(lines.len() <= 3 && text.len() < 1000, "{text}");
    assert_eq!(lines[0]["place"], format!("{file}:{}", good.len()));
    assert_eq!(lines[0]["bytes"], "EB90EB");
    // Every sync is counted: the last has no byte behind it and is cut.
    let count: u64 = lines.iter().map(|line| line["count"].as_u64().unwrap_or(1)).sum();
    assert_eq!(count, (length - good.len() as u64) / 2, "{text}");
    assert_eq!(lines[0]["last_place"], format!("{file}:{}", length - 4));
}

#[test]
fn a_defect_on_either_side_of_a_row_is_reported_twice() {
    let directory = tempfile::tempdir().expect("a directory");
    let directory = directory.path();
    let frame = geu_protocol::serial::data_frame(&geu_protocol::Sample { clock_count: 500_000, ..Default::default() });
    let file = path(directory, "two.bin");
    fs::write(&file, [&[0xFF; 3][..], &frame, &[0xFF; 3], &frame].concat()).expect("a file");
    let defects = path(directory, "defects.jsonl");
    let output = geu().args(["decode", &file, "--defects", &defects]).output().expect("geu starts");
    assert!(output.status.success(), "{}", said(&output));
    let text = fs::read_to_string(&defects).expect("defects");
    assert_eq!(text.lines().filter(|line| line.contains("\"kind\":\"noise\"")).count(), 2, "{text}");
}

#[test]
fn any_number_of_interfaces_is_read_in_linear_time() {
    let directory = tempfile::tempdir().expect("a directory");
    let file = path(directory.path(), "names.log");
    let mut log = BufWriter::new(File::create(&file).expect("a file"));
    for index in 0..200_000 {
        writeln!(log, "(1795020000.500932) if{index} 1A0#FFFE000100050005").expect("a file");
    }
    drop(log);
    let start = Instant::now();
    let output = bounded(DECODE_KIB, &["decode", &file, "--format", "summary"]);
    // A quarter of a second; comparing each name with all before it takes half a minute and more.
    assert!(start.elapsed() < Duration::from_secs(15), "{:?}", start.elapsed());
    let summary = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(summary.contains("accounts for all"), "{summary}{}", said(&output));
    assert!(summary.lines().count() < 400, "{} lines", summary.lines().count());
    assert!(summary.contains("further interfaces: "), "{summary}");
}

#[test]
fn the_interface_asked_for_is_found_behind_any_number_of_others() {
    let directory = tempfile::tempdir().expect("a directory");
    let file = path(directory.path(), "names.log");
    let mut log = String::new();
    for index in 0..2000 {
        log += &format!("(1795020000.500932) if{index} 1A0#FFFE000100050005\n");
    }
    for id in ["1A0#FFFEFFFE00050005", "1A1#00000F070810DD5E", "1A2#00000007A1201B58"] {
        log += &format!("(1795020001.500932) wanted {id}\n");
    }
    fs::write(&file, log).expect("a file");
    let output = geu().args(["decode", &file, "--interface", "wanted"]).output().expect("geu starts");
    assert!(output.status.success(), "{}", said(&output));
    assert_eq!(String::from_utf8_lossy(&output.stdout).lines().count(), 2, "{}", said(&output));
}

#[test]
fn a_message_quotes_no_more_than_two_hundred_bytes_of_a_line() {
    let directory = tempfile::tempdir().expect("a directory");
    let directory = directory.path();
    let capture = root().join("tests/captures/encoded.log");
    let capture = capture.to_str().expect("UTF-8");
    let long = "x".repeat(60_000);
    let write = |name: &str, text: String| {
        let path = path(directory, name);
        fs::write(&path, text).expect("a file");
        path
    };
    let sun = write("fss.csv", "t_s,theta_arcsec,roll_arcsec\n0,0,0\n".to_owned());
    let out = path(directory, "run");
    let check = |arguments: &[&str]| {
        let output = geu().args(arguments).output().expect("geu starts");
        let message = said(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        // Names of keys, columns and files beside what is quoted.
        assert!(message.len() < 2500 && message.contains('…'), "{} bytes: {message}", message.len());
    };
    for (name, text) in [
        ("key.toml", format!("{long} = 1\n")),
        ("value.toml", format!("seed = \"{long}\"\n")),
        ("broken.toml", long.clone()),
        ("behind.toml", format!("unit = {{ clock-frequency = {{ ppm = 1.0, {long} = 2 }} }}\n")),
    ] {
        check(&["config", "check", &write(name, text)]);
    }
    check(&["decode", &write("text.log", long.clone())]);
    let header = "t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s\n";
    for (name, text) in [
        ("columns.csv", format!("{long},a\n")),
        ("number.csv", format!("{header}0,0,0,{long}\n")),
        ("m.aem", format!("CCSDS_AEM_VERS = 1.0\n{long}\n")),
        ("received.csv", format!("t_s,angle_x_arcsec,angle_y_arcsec,angle_z_arcsec,basis\n{long}\n")),
    ] {
        let file = write(name, text);
        check(&["simulate", "--truth", &file, "--out", &out]);
    }
    let list = write("list.csv", format!("manoeuvre,start_s,end_s\npointing,{long},1\n"));
    check(&["calibrate", "--link", capture, "--manoeuvres", &list, "--fss", &sun, "--sse", &sun]);
}

#[test]
fn flags_are_written_as_bits_beside_the_integers() {
    let capture: PathBuf = root().join("tests/captures/encoded.log");
    let capture = capture.to_str().expect("UTF-8");
    let run = |arguments: &[&str]| {
        let output = geu().arg("decode").arg(capture).args(arguments).output().expect("geu starts");
        assert!(output.status.success(), "{}", said(&output));
        String::from_utf8(output.stdout).expect("text")
    };
    let (plain, bits) = (run(&[]), run(&["--flags", "bits"]));
    assert_eq!(run(&["--flags", "integers"]), plain);
    let mut names =
        "gyrx_valid,gyry_valid,gyrza_valid,gyrzb_valid,gyrx_saturated,gyry_saturated,gyrza_saturated,gyrzb_saturated"
            .to_owned();
    names += ",heater_in_band,motors_synchronous,clock_locked,self_test,polled";
    for (index, (plain, bits)) in plain.lines().zip(bits.lines()).enumerate() {
        let added = bits.strip_prefix(plain).and_then(|rest| rest.strip_prefix(',')).expect("the same row, and more");
        if index == 0 {
            assert_eq!(added, names);
            continue;
        }
        let fields: Vec<&str> = plain.split(',').collect();
        let (gyro, unit): (u32, u32) = (fields[7].parse().expect("flags"), fields[8].parse().expect("flags"));
        let expected: Vec<String> = (0..8)
            .map(|bit| gyro >> bit & 1)
            .chain((0..5).map(|bit| unit >> bit & 1))
            .map(|bit| bit.to_string())
            .collect();
        assert_eq!(added, expected.join(","));
    }
    // Row 3 of the committed capture has GYRZB saturated, unlike row 0.
    let jsonl = run(&["--flags", "bits", "--format", "jsonl"]);
    let rows: Vec<serde_json::Value> = jsonl.lines().map(|line| serde_json::from_str(line).expect(line)).collect();
    assert_eq!((&rows[0]["gyrzb_saturated"], &rows[3]["gyrzb_saturated"]), (&false.into(), &true.into()));
    assert_eq!(
        (&rows[0]["gyrx_valid"], &rows[0]["polled"], &rows[0]["gyro_flags"]),
        (&true.into(), &false.into(), &15.into())
    );
}

#[test]
fn durations_have_units_everywhere() {
    let directory = tempfile::tempdir().expect("a directory");
    let link = |duration: &str| {
        let out = path(directory.path(), &format!("run{duration}"));
        let output = geu().args(["simulate", "--duration", duration, "--out", &out]).output().expect("geu starts");
        assert!(output.status.success(), "{}", said(&output));
        fs::read(Path::new(&out).join("link.log")).expect("link.log")
    };
    assert_eq!(link("2m"), link("120"));
    assert_eq!(link("90s"), link("90"));
    let capture = root().join("tests/captures/encoded.log");
    let capture = capture.to_str().expect("UTF-8");
    // Each option that is a duration takes a unit and refuses what is none before anything else.
    for arguments in [
        &["run", "--duration"][..],
        &["simulate", "--out", "nowhere", "--duration"],
        &["reconstruct", "--duration"],
        &["decode", capture, "--duration"],
        &["track", capture, "--duration"],
        &["send", "nowhere", "PING", "--timeout"],
        &["replay", capture, "--from"],
        &["replay", capture, "--to"],
        &["replay", capture, "--longest-gap"],
        &["blind", "hide", "--seed", "1", "--out", "nowhere", "--duration"],
        &["blind", "campaign", "--duration"],
    ] {
        for wrong in ["10x", "1ss", "inf", "-5"] {
            let output = geu().args(arguments).arg(wrong).output().expect("geu starts");
            let message = said(&output);
            assert_eq!(output.status.code(), Some(2), "{arguments:?} {wrong}: {message}");
            assert!(message.contains("expected a duration of") && message.contains(wrong), "{message}");
        }
        let help = geu().args(&arguments[..if arguments[0] == "blind" { 2 } else { 1 }]).arg("--help").output();
        let help = String::from_utf8(help.expect("geu starts").stdout).expect("text");
        assert!(help.contains("<DURATION>"), "{help}");
    }
    assert!(!Path::new("nowhere").exists());
}
