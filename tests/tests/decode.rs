//! `geu decode` as a user runs it.

use std::fs;
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use geu_protocol::{CLOCK_PER_SAMPLE, CanIdMap, Sample};
use geu_tests::{geu, recordings, root, skipped};

const HEADER: &str = "t_s,sequence,clock_count,gyrx,gyry,gyrza,gyrzb,gyro_flags,unit_flags,electronics_c,sensor_c";
const ROWS: u16 = 120;

fn capture(name: &str) -> PathBuf {
    root().join("tests/captures").join(name)
}

fn decode(arguments: &[&str]) -> Output {
    geu().arg("decode").args(arguments).output().expect("geu starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The rows of a capture; it must decode, and the account must add up.
fn rows(arguments: &[&str]) -> Vec<String> {
    let output = decode(arguments);
    let errors = text(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {errors}");
    assert_eq!(summary(&errors, "account"), "accounts for all", "{errors}");
    let text = text(&output.stdout);
    let mut lines = text.lines().map(str::to_owned);
    assert_eq!(lines.next().as_deref(), Some(HEADER));
    lines.collect()
}

/// The value of a line of the summary.
fn summary(text: &str, name: &str) -> String {
    let line = text.lines().find(|line| line.split_whitespace().next() == Some(name));
    line.map_or_else(|| panic!("no {name} in {text}"), |line| line[name.len()..].trim().to_owned())
}

fn sample(index: u16) -> Sample {
    Sample {
        sequence: index,
        increments: [-2 * index as i16, index as i16, 5, -32_768 + index as i16],
        gyro_flags: if index % 7 == 3 { 0x8F } else { 0x0F },
        unit_flags: 0x07,
        electronics_centi_c: 2_064 - 40 * index as i16,
        clock_count: (u64::from(index) + 1) * CLOCK_PER_SAMPLE,
        sensor_centi_c: 7_000,
    }
}

fn t_us(index: u16) -> u64 {
    1_795_020_000_500_900 + u64::from(index) * 500_000 + u64::from(index % 5)
}

/// A minute of our own encoder, as `candump -l` writes it.
fn encoded_log() -> String {
    let mut log = String::new();
    for index in 0..ROWS {
        for (later_us, frame) in [0, 250, 500].into_iter().zip(CanIdMap::default().frames(&sample(index))) {
            let t_us = t_us(index) + later_us;
            let data: String = frame.data().iter().map(|byte| format!("{byte:02X}")).collect();
            log += &format!("({}.{:06}) can0 {:03X}#{data}\n", t_us / 1_000_000, t_us % 1_000_000, frame.id());
        }
    }
    log
}

/// The rows as CSV, written independently of the program.
fn encoded_rows() -> Vec<String> {
    let hundredths =
        |value: i16| format!("{}{}.{:02}", if value < 0 { "-" } else { "" }, value.abs() / 100, value.abs() % 100);
    (0..ROWS)
        .map(|index| {
            let (h, t_us) = (sample(index), t_us(index));
            let [x, y, za, zb] = h.increments;
            format!(
                "{}.{:06},{},{},{x},{y},{za},{zb},{},{},{},{}",
                t_us / 1_000_000,
                t_us % 1_000_000,
                h.sequence,
                h.clock_count,
                h.gyro_flags,
                h.unit_flags,
                hundredths(h.electronics_centi_c),
                hundredths(h.sensor_centi_c)
            )
        })
        .collect()
}

/// A row without its time.
fn fields(row: &str) -> &str {
    row.split_once(',').expect("a row").1
}

fn time_s(row: &str) -> f64 {
    row.split(',').next().and_then(|time| time.parse().ok()).expect("a time")
}

fn write(directory: &Path, name: &str, bytes: &[u8]) -> String {
    let path = directory.join(name);
    fs::write(&path, bytes).expect("a file in the temporary directory");
    path.to_str().expect("UTF-8").to_owned()
}

#[test]
fn the_committed_recording_is_what_the_encoder_writes() {
    let path = capture("encoded.log");
    if std::env::var_os("GEU_BLESS").is_some() {
        fs::write(&path, encoded_log()).expect("encoded.log");
    }
    assert_eq!(fs::read_to_string(&path).expect("encoded.log"), encoded_log());
    assert_eq!(rows(&[path.to_str().unwrap(), "--strict"]), encoded_rows());
}

#[test]
fn every_format_gives_the_same_rows() {
    let expected = encoded_rows();
    // Times: absolute to the microsecond, or seconds since the start, or none (then the clock count).
    for (name, start_s) in [
        ("encoded.log", 0.0),
        ("encoded.pcap", 0.0),
        ("encoded.pcapng", 0.0),
        ("encoded-socketcan.pcap", 0.0),
        ("encoded-sll.pcap", 0.0),
        ("encoded-sll.pcapng", 0.0),
        ("encoded-console-a.txt", 0.0),
        ("encoded-console-A.txt", 0.0),
        ("encoded-console-z.txt", 1_795_020_000.500_9),
        ("encoded-console-d.txt", 1_795_020_000.500_9),
        ("encoded-console.txt", 1_795_020_000.0),
        ("encoded-python-can.asc", 1_795_020_000.500_9),
        ("encoded-log2asc.asc", 1_795_020_000.500_9),
        ("encoded-python-can.trc", 0.0),
        ("encoded-python-can.csv", 0.0),
        ("encoded-python-can.blf", 0.0),
    ] {
        let path = capture(name);
        let rows = rows(&[path.to_str().unwrap(), "--strict"]);
        assert_eq!(rows.len(), expected.len(), "{name}");
        for (row, expected) in rows.iter().zip(&expected) {
            assert_eq!(fields(row), fields(expected), "{name}");
            let tolerance_s = if name == "encoded-console.txt" { 1e-3 } else { 2e-6 };
            assert!((time_s(row) + start_s - time_s(expected)).abs() < tolerance_s, "{name}: {row} {expected}");
        }
    }
}

#[test]
fn the_wild_log_gives_all_rows_and_counts_the_rest() {
    let directory = tempfile::tempdir().unwrap();
    let defects = directory.path().join("defects");
    let path = capture("wild.log");
    let output = decode(&[path.to_str().unwrap(), "--defects", defects.to_str().unwrap()]);
    let (out, errors) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{errors}");
    assert_eq!(
        out.lines().skip(1).map(fields).collect::<Vec<_>>(),
        encoded_rows()[..12].iter().map(|row| fields(row)).collect::<Vec<_>>()
    );
    for (name, expected) in [
        ("account", "accounts for all"),
        ("records", "59"),
        ("records-decoded", "36"),
        ("records-command", "1"),
        ("records-reply", "1"),
        ("records-other-traffic", "4"),
        ("records-other-interface", "3"),
        ("records-remote", "2"),
        ("records-fd", "1"),
        ("records-error", "1"),
        ("records-remark", "4"),
        ("records-defective", "6"),
        ("frames-dropped", "17 by recorder or socket"),
        ("defect-wrong-length", "1"),
        ("defect-status-without-increments", "1"),
        ("defect-broken-record", "3"),
        ("defect-cut-record", "1"),
        ("defect-time-backwards", "1"),
        ("interface-not-used", "can1 3 frames of the unit"),
    ] {
        assert_eq!(summary(&errors, name), expected, "{name} in {errors}");
    }
    let defects = fs::read_to_string(defects).unwrap();
    assert_eq!(defects.lines().count(), 8, "{defects}");
    assert!(defects.lines().all(|line| line.contains("\"place\":\"") && line.contains("wild.log:")), "{defects}");
    let strict = decode(&[path.to_str().unwrap(), "--strict"]);
    assert_eq!((strict.status.code(), strict.stdout), (Some(1), output.stdout));
    let other = rows(&[path.to_str().unwrap(), "--interface", "can1"]);
    assert_eq!(other.len(), 1);
}

#[test]
fn containers_pipes_and_several_inputs_are_one_stream() {
    let directory = tempfile::tempdir().unwrap();
    let log = encoded_log();
    let (a, b) = log.as_bytes().split_at(log.len() / 2);
    // Two members of gzip, cut anywhere; and zstd.
    let gzip = |bytes: &[u8]| {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    };
    let gz = write(directory.path(), "log.gz", &[gzip(a), gzip(b)].concat());
    assert_eq!(rows(&[&gz, "--strict"]), encoded_rows());
    let zst = write(directory.path(), "no-suffix", &zstd::encode_all(log.as_bytes(), 3).unwrap());
    assert_eq!(rows(&[&zst, "--strict"]), encoded_rows());
    // A sample that begins in one file and ends in the next.
    let lines: Vec<&str> = log.split_inclusive('\n').collect();
    let first = write(directory.path(), "1", lines[..100].concat().as_bytes());
    let second = write(directory.path(), "2", &gzip(lines[100..].concat().as_bytes()));
    assert_eq!(rows(&[&first, &second, "--strict"]), encoded_rows());
    // The same where the interface has another name in the next.
    let renamed: String = lines[100..].concat().replace("can0", "can7");
    let third = write(directory.path(), "3", renamed.as_bytes());
    assert_eq!(rows(&[&first, &third, "--strict"]), encoded_rows());
    // A second interface beside it stays out in every input, also where its frames come first.
    let doubled = |lines: &[&str]| lines.iter().map(|line| line.replace("can0", "can1") + line).collect::<String>();
    let one = write(directory.path(), "4", lines[..3].concat().as_bytes());
    let two = write(directory.path(), "5", doubled(&lines[3..100]).as_bytes());
    let three = write(directory.path(), "6", doubled(&lines[100..]).as_bytes());
    assert_eq!(rows(&[&one, &two, &three, "--strict"]), encoded_rows());
    let output = decode(&[&one, &two, &three, "--quiet"]);
    assert!(text(&output.stderr).contains("frames of the unit left out: 357 on can1 (used: can0;"));
    let alone = write(directory.path(), "7", lines[99..].concat().replace("can0", "can1").as_bytes());
    assert_eq!(rows(&[&one, &two, &alone]).len(), 120);
    let named = rows(&[&one, &two, &alone, "--interface", "can0"]);
    assert_eq!(named.len(), 33);
    let mut child =
        geu().args(["decode", "-", "--strict"]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(log.as_bytes()).unwrap();
    assert_eq!(text(&child.wait_with_output().unwrap().stdout).lines().count(), 1 + encoded_rows().len());
}

#[test]
fn json_and_summary_say_the_same() {
    let path = capture("encoded.log");
    let json = text(&decode(&[path.to_str().unwrap(), "--format", "jsonl"]).stdout);
    assert_eq!(json.lines().count(), usize::from(ROWS));
    let first = "{\"t_s\":1795020000.500900,\"sequence\":0,\"clock_count\":500000,\"gyrx\":0,";
    assert!(json.starts_with(first), "{}", json.lines().next().unwrap_or_default());
    let summary_text = text(&decode(&[path.to_str().unwrap(), "--format", "summary"]).stdout);
    assert_eq!(summary(&summary_text, "rows"), "120");
    assert_eq!(summary(&summary_text, "saturated"), "GYRX 0 GYRY 0 GYRZA 0 GYRZB 17");
}

#[test]
fn a_closed_pipe_ends_it_quietly() {
    let log = write(tempfile::tempdir().unwrap().keep().as_path(), "long.log", encoded_log().repeat(200).as_bytes());
    let mut child = geu().args(["decode", &log]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
}

#[test]
fn bad_input_gives_one_clear_message_and_what_was_read_so_far() {
    let directory = tempfile::tempdir().unwrap();
    let gzip = {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(encoded_log().as_bytes()).unwrap();
        encoder.finish().unwrap()
    };
    let cut = write(directory.path(), "cut.log.gz", &gzip[..gzip.len() * 2 / 3]);
    let zst = zstd::encode_all(encoded_log().repeat(200).as_bytes(), 3).unwrap();
    let cut_zst = write(directory.path(), "cut.log.zst", &zst[..zst.len() * 2 / 3]);
    let empty = write(directory.path(), "empty.log", b"");
    let empty_gz = write(directory.path(), "empty.gz", &{
        let encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.finish().unwrap()
    });
    let binary = write(directory.path(), "binary.log", &[0, 1, 2, 3, 0xFF].repeat(50));
    let prose = write(directory.path(), "prose.log", b"To be, or not to be\n");
    let directory_path = directory.path().to_str().unwrap();
    for (input, words) in [
        (cut.as_str(), &["cut.log.gz", "gzip is damaged or cut"][..]),
        (&cut_zst, &["cut.log.zst", "zstd is damaged or cut"]),
        (&empty, &["empty.log", "is empty", "0 bytes"]),
        (&empty_gz, &["empty.gz", "is empty"]),
        (&binary, &["binary.log", "offset 0", "expected", "EB 90", "got none", "00 01 02 03 FF"]),
        (&prose, &["prose.log", "line 1", "expected", "candump", "got \"To be, or not to be\""]),
        (directory_path, &["is a directory"]),
        ("/no/such/file.log", &["/no/such/file.log", "no such file"]),
        ("can73", &["can73", "no such file", "no CAN interface of that name"]),
    ] {
        let output = decode(&[input, "--quiet"]);
        let errors = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{input}: {errors}");
        assert_eq!(errors.lines().count(), 1, "{errors}");
        assert!(words.iter().all(|word| errors.contains(word)), "{words:?} in {errors}");
        // Rows only of what could be read.
        assert_eq!(text(&output.stdout).starts_with(HEADER), [&cut, &cut_zst].contains(&&input.to_owned()), "{input}");
        let kept = write(directory.path(), "kept.csv", b"old");
        let outputs = [decode(&[input, "--format", "summary"]), decode(&[input, "--out", &kept])];
        if output.stdout.is_empty() {
            assert!(outputs.iter().all(|output| output.stdout.is_empty()), "{input}");
            assert_eq!(fs::read(&kept).unwrap(), b"old", "{input}");
        }
    }
    let rows = text(&decode(&[&cut, "--quiet"]).stdout);
    let found: Vec<&str> = rows.lines().skip(1).collect();
    assert!(found.len() > 20 && encoded_rows().iter().zip(&found).all(|(expected, row)| expected == row), "{rows}");
}

#[test]
fn a_cut_container_gives_the_rows_so_far_and_exit_2() {
    let directory = tempfile::tempdir().unwrap();
    let mut pcap = Vec::new();
    for word in [0xA1B2_C3D4u32, 0x0004_0002, 0, 0, 65_535, 227] {
        pcap.extend_from_slice(&word.to_le_bytes());
    }
    for frame in (0..2).flat_map(|index| CanIdMap::default().frames(&sample(index))) {
        for word in [1_795_020_000u32, 0, 16, 16] {
            pcap.extend_from_slice(&word.to_le_bytes());
        }
        pcap.extend_from_slice(&frame.id().to_be_bytes());
        pcap.extend_from_slice(&[8, 0, 0, 0]);
        pcap.extend_from_slice(frame.data());
    }
    // Without the last packet's last five bytes, and without most of the header.
    for (kept, lines, words) in
        [(pcap.len() - 5, 3, "offset 184: pcap is damaged or cut"), (10, 1, "offset 0: pcap is damaged or cut")]
    {
        let path = write(directory.path(), "cut.pcap", &pcap[..kept]);
        let defects = directory.path().join("defects.jsonl");
        let output = decode(&[&path, "--quiet", "--defects", defects.to_str().unwrap()]);
        let errors = text(&output.stderr);
        assert_eq!((output.status.code(), errors.lines().count()), (Some(2), 1), "{errors}");
        assert!(errors.contains(words) && errors.contains("expected a whole header"), "{errors}");
        assert_eq!(text(&output.stdout).lines().count(), lines, "{errors}");
        assert!(fs::read_to_string(&defects).unwrap().contains("cut-record"));
    }
    let log = encoded_log();
    let cut = write(directory.path(), "cut.log", &log.as_bytes()[..log.len() - 5]);
    assert_eq!(rows(&[&cut]).len(), encoded_rows().len());

    // The only container of a BLF begins at 144; the start of a second one behind it claims 4 GB.
    let blf = fs::read(capture("encoded-python-can.blf")).unwrap();
    let claim = [&b"LOBJ\x10\0\x01\0\xFF\xFF\xFF\xFF\x0A\0\0\0\x02\0"[..], &[0xFF; 40]].concat();
    let place = format!("offset {}: blf is damaged or cut", blf.len());
    for (bytes, count, words) in [
        (blf[..blf.len() / 2].to_vec(), None, "offset 144: blf is damaged or cut"),
        ([&blf[..], &claim].concat(), Some(encoded_rows().len()), &place),
    ] {
        let path = write(directory.path(), "cut.blf", &bytes);
        let output = decode(&[&path, "--quiet"]);
        let (rows, errors) = (text(&output.stdout), text(&output.stderr));
        assert!(output.status.code() == Some(2) && errors.contains(words) && errors.lines().count() == 1, "{errors}");
        let rows = rows.lines().count() - 1;
        assert!(count.map_or(0 < rows && rows < encoded_rows().len(), |count| rows == count), "{rows} rows");
    }
}

#[test]
fn an_output_never_destroys_what_is_to_be_read() {
    let directory = tempfile::tempdir().unwrap();
    let log = write(directory.path(), "x.log", encoded_log().as_bytes());
    let linked = directory.path().join("linked.log").to_str().unwrap().to_owned();
    fs::hard_link(&log, &linked).unwrap();
    let kept = write(directory.path(), "kept.csv", b"kept");
    let new = directory.path().join("new.csv").to_str().unwrap().to_owned();
    for (arguments, words) in [
        (&[&*log, "--out", &log][..], &["--out", "the same file as the input", "x.log"][..]),
        (&[&log, "--defects", &linked], &["--defects", "the same file as the input"]),
        (&[&log, "--format", "summary", "--out", &log], &["--out", "the same file as the input"]),
        (&[&log, "--out", &new, "--defects", &new], &["--defects", "expected another file than --out"]),
        (&[&log, "--out", &kept, "--defects", &kept], &["--defects", "expected another file than --out"]),
        (&["/no/such/x.log", "--out", &kept], &["/no/such/x.log"]),
    ] {
        let output = decode(arguments);
        let errors = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {errors}");
        assert!(errors.lines().count() == 1 && words.iter().all(|word| errors.contains(word)), "{errors}");
        assert_eq!(fs::read_to_string(&log).unwrap(), encoded_log());
        assert_eq!(fs::read(&kept).unwrap(), b"kept");
        assert!(!Path::new(&new).exists());
    }
    let output = decode(&[&log, "--out", "/dev/null", "--defects", "/dev/null"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
}

#[test]
fn what_cannot_be_written_is_a_failure_and_no_panic() {
    let log = capture("encoded.log");
    let log = log.to_str().unwrap();
    let full = || Stdio::from(fs::OpenOptions::new().write(true).open("/dev/full").unwrap());
    for arguments in [&["config", "show"][..], &["config", "check"], &["describe", "icd"], &["decode", log]] {
        let output = geu().args(arguments).stdout(full()).output().unwrap();
        let errors = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {errors}");
        assert!(errors.contains("geu: writing failed: "), "{errors}");
        let mut child = geu().args(arguments).args(["--help"]).stdout(full()).stderr(full()).spawn().unwrap();
        assert!(child.wait().unwrap().code() != Some(101));
    }
    for (arguments, code) in [(&["decode", log][..], 0), (&["decode", "/no/such/x.log"], 2)] {
        let status = geu().args(arguments).stdout(Stdio::null()).stderr(full()).status().unwrap();
        assert_eq!(status.code(), Some(code), "{arguments:?}");
    }
    let mut child = geu().args(["config", "show"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
}

#[test]
fn a_file_without_permission_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let path = write(directory.path(), "closed.log", encoded_log().as_bytes());
    fs::set_permissions(&path, fs::Permissions::from_mode(0o000)).unwrap();
    if fs::File::open(&path).is_ok() {
        return skipped("root may read every file, so a refusal cannot be tried");
    }
    let output = decode(&[&path]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("ermission denied"));
}

#[test]
fn recording_01_equals_ten_lines_of_python() {
    let Some(recording) = recordings("01/link.log.gz") else { return };
    let script = root().join("tests/independent_decode.py");
    let Ok(python) = Command::new("python3").arg(script).arg(&recording).output() else {
        return skipped("python3 is not installed");
    };
    assert!(python.status.success(), "{}", text(&python.stderr));
    let rows = rows(&[recording.to_str().unwrap(), "--strict"]);
    let python = text(&python.stdout);
    let independent: Vec<&str> = python.lines().collect();
    assert_eq!(rows.len(), 22_699);
    assert_eq!(rows, independent);
}

#[test]
fn a_note_says_why_there_are_no_rows() {
    let directory = tempfile::tempdir().unwrap();
    let pcap = capture("encoded.pcap").to_str().unwrap().to_owned();
    let other =
        write(directory.path(), "other.log", b"(1.0) can0 123#0102030405060708\n(1.1) can0 124#0102030405060708\n");
    let frames: Vec<u8> = (0..20).flat_map(|index| geu_protocol::serial::data_frame(&sample(index))).collect();
    let serial = write(directory.path(), "raw.bin", &frames);
    // A STATUS that does not match its INCREMENTS.
    let cut = write(directory.path(), "cut.log", b"(1.0) can0 1A0#0000000000000000\n(1.0) can0 1A1#0000000000000000\n");
    let found = "1A0 to 1A2 are as the unit sends them: --base 1A0";
    for (arguments, words) in [
        (&[&pcap[..], "--base", "300"][..], &["identifiers 300, 301, 302 (base 300), got 1A0, 1A1, 1A2; ", found][..]),
        (&[&pcap, "--base", "1A1"], &["identifiers 1A1, 1A2, 1A3 (base 1A1), got 1A0, 1A1, 1A2; ", found]),
        (&[&other], &["expected identifiers 1A0, 1A1, 1A2 (base 1A0), got 123, 124; --base is another"]),
        (&[&cut], &["(base 1A0), which are there, but no INCREMENTS", "defects crc-mismatch 1"]),
        (&[&serial, "--input-format", "candump"], &["--input-format candump found no record", "without it"]),
    ] {
        for more in [&["decode", "--format", "summary"][..], &["decode", "--quiet"], &["track", "--quiet"]] {
            let output = geu().args(more).args(arguments).output().expect("geu starts");
            let errors = text(&output.stderr);
            assert!(output.status.success() && errors.lines().count() == 1, "{more:?} {arguments:?}: {errors}");
            assert!(words.iter().all(|word| errors.contains(word)), "{words:?} in {errors}");
        }
    }
    assert!(decode(&[&pcap, "--quiet"]).stderr.is_empty());
}
