//! `geu decode` on a live link: a pty, a pipe or a FIFO with the other side in this test.

use std::fs::{self, File, OpenOptions};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use geu_protocol::serial::data_frame;
use geu_protocol::{CLOCK_PER_SAMPLE, Sample};
use geu_tests::pty::open_pty;
use geu_tests::{geu, root};
use nix::sys::signal::{Signal, kill};
use nix::sys::stat::Mode;
use nix::unistd::{Pid, mkfifo};

fn sample(index: u16) -> Sample {
    Sample {
        sequence: index,
        // Bytes that a terminal in cooked mode would change or act on: carriage return, interrupt, end of file.
        increments: [0x0D0A, 0x0304, 0x1113, 0x7F0D],
        clock_count: (u64::from(index) + 1) * CLOCK_PER_SAMPLE,
        ..Sample::default()
    }
}

fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).expect("after 1970").as_secs_f64()
}

#[test]
fn rows_of_a_pty_come_at_once_and_an_interrupt_ends_with_the_summary() {
    let (mut master, _slave, path) = open_pty();
    let mut child =
        geu().args(["decode", &path]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("geu starts");
    let mut lines = BufReader::new(child.stdout.take().expect("its output")).lines();
    // The port discards what was there when it was opened: wait until it listens.
    std::thread::sleep(Duration::from_millis(500));
    let frame = data_frame(&sample(0));
    master.write_all(&frame[..10]).expect("written");
    std::thread::sleep(Duration::from_millis(20));
    master.write_all(&frame[10..]).expect("written");
    let before_s = now_s();
    assert!(lines.next().expect("a header").expect("text").starts_with("t_s,"));
    let row = lines.next().expect("a row").expect("text");
    let t_s: f64 = row.split(',').next().and_then(|time| time.parse().ok()).expect("a time");
    assert!((t_s - before_s).abs() < 0.1, "{t_s} is not when the last byte came, {before_s}");
    assert!(row.ends_with(",0,500000,3338,772,4371,32525,0,0,0.00,0.00"), "{row}");
    master.write_all(&data_frame(&sample(1))).expect("written");
    assert!(lines.next().expect("a row").expect("text").contains(",1,1000000,"));
    kill(Pid::from_raw(child.id() as i32), Signal::SIGINT).expect("a signal");
    let mut errors = String::new();
    child.stderr.take().expect("its errors").read_to_string(&mut errors).expect("text");
    assert!(child.wait().expect("its end").success(), "{errors}");
    for expected in
        ["bytes-decoded            56", "accounts for all", "defects                  0", "rows                     2"]
    {
        assert!(errors.contains(expected), "{expected} not in {errors}");
    }
}

#[test]
fn a_link_that_goes_away_ends_the_decoding() {
    let (mut master, slave, path) = open_pty();
    let child =
        geu().args(["decode", &path]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("geu starts");
    std::thread::sleep(Duration::from_millis(500));
    drop(slave);
    master.write_all(&data_frame(&sample(7))).expect("written");
    std::thread::sleep(Duration::from_millis(300));
    drop(master);
    let output = child.wait_with_output().expect("its end");
    assert!(output.status.success());
    assert_eq!(String::from_utf8_lossy(&output.stdout).lines().count(), 2);
}

#[test]
fn a_duration_ends_a_silent_link() {
    let (_master, _slave, path) = open_pty();
    for (strict, code) in [(&[][..], 0), (&["--strict"], 1)] {
        let arguments = [&["decode", &path, "--duration", "0.3"], strict].concat();
        let output = geu().args(arguments).output().expect("geu starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(said.contains("no sample: nothing was received"), "{said}");
    }
}

#[test]
fn a_link_that_ends_before_the_duration_fails_with_its_rows() {
    let watch = ["watch", "--quiet"];
    for (command, frames, lines) in
        [(&["decode"][..], 1, 2), (&["decode"], 0, 1), (&["track", "--format", "csv"], 1, 2), (&watch, 1, 1)]
    {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("its address").to_string();
        let mut child = geu();
        child.args(command).args([&address, "--duration", "60"]).stdout(Stdio::piped()).stderr(Stdio::piped());
        let child = child.spawn().expect("geu starts");
        let (mut client, _) = listener.accept().expect("a client");
        (0..frames).for_each(|index| client.write_all(&data_frame(&sample(index))).expect("written"));
        drop(client);
        let output = child.wait_with_output().expect("its end");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{command:?}: {said}");
        let early = said.split_once(&format!("{address}: ended ")).and_then(|(_, rest)| rest.split_once(" s before"));
        let left_s: f64 = early.and_then(|(left_s, _)| left_s.parse().ok()).unwrap_or_else(|| panic!("{said}"));
        assert!((50.0..=60.0).contains(&left_s) && said.contains(&format!("after {frames} rows")), "{said}");
        assert_eq!(String::from_utf8_lossy(&output.stdout).lines().count(), lines, "{command:?}");
    }
}

#[test]
fn a_link_that_ends_without_a_sample_keeps_the_previous_output() {
    let directory = tempfile::tempdir().expect("a directory");
    let file = directory.path().join("rows.csv");
    for command in ["decode", "track"] {
        fs::write(&file, "before").expect("written");
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("its address").to_string();
        let child = geu().args([command, &address, "--duration", "60", "--quiet", "--out"]).arg(&file).spawn();
        let mut child = child.expect("geu starts");
        drop(listener.accept().expect("a client"));
        assert_eq!(child.wait().expect("its end").code(), Some(1), "{command}");
        assert_eq!(fs::read_to_string(&file).expect("a file"), "before", "{command}");
    }
}

#[test]
fn a_strict_watch_of_a_silent_link_fails() {
    let (_master, _slave, path) = open_pty();
    let arguments = ["watch", &path, "--duration", "0.3", "--strict", "--quiet"];
    let output = geu().args(arguments).output().expect("geu starts");
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("--strict: no sample"), "{output:?}");
}

#[test]
fn a_duration_of_a_recording_is_refused() {
    let capture = root().join("tests/captures/encoded.log");
    let directory = tempfile::tempdir().expect("a directory");
    let (_master, _slave, link) = open_pty();
    let refuse = |arguments: &[&Path]| {
        let mut command = geu();
        command.args(arguments).args(["--duration", "5"]).stdin(File::open(&capture).expect("the capture"));
        let output = command.output().expect("geu starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains("--duration: expected live inputs alone, got the recording "), "{said}");
    };
    for command in ["decode", "track", "watch"].map(Path::new) {
        refuse(&[command, &capture]);
        refuse(&[command, Path::new("-")]);
        refuse(&[command, directory.path()]);
    }
    refuse(&[Path::new("decode"), Path::new(&link), &capture]);
}

#[test]
fn a_link_is_no_output_of_its_decoding() {
    let (mut master, _slave, link) = open_pty();
    for (command, option) in [("decode", "--out"), ("decode", "--defects"), ("track", "--out")] {
        let output = geu().args([command, &link, "--duration", "0.5", option, &link]).output().expect("geu starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains("expected a file that is not an input"), "{said}");
    }
    // The unit got nothing.
    nix::fcntl::fcntl(&master, nix::fcntl::FcntlArg::F_SETFL(nix::fcntl::OFlag::O_NONBLOCK)).expect("a flag");
    assert_eq!(master.read(&mut [0; 64]).expect_err("nothing").kind(), std::io::ErrorKind::WouldBlock);
    // Any number of inputs and outputs share /dev/null.
    let capture = root().join("tests/captures/encoded.log");
    let mut decode = geu();
    decode.arg("decode").arg(&capture).args(["--out", "/dev/null", "--defects", "/dev/null"]);
    assert!(decode.output().expect("geu starts").status.success());
}

#[test]
fn every_input_exists_before_the_first_is_read() {
    let (_master, _slave, link) = open_pty();
    let output = geu().args(["decode", &link, "nowhere.log", "--duration", "0.5"]).output().expect("geu starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("nowhere.log: no such file") && output.stdout.is_empty(), "{said}");
    let (_other_master, _other_slave, other) = open_pty();
    let output = geu().args(["decode", &link, &other, "--duration", "0.3"]).output().expect("geu starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains(&format!("geu: not read before the end: {other}")), "{said}");
}

/// Asks for the end, which is well and comes within a second; what it said on standard error, and the rest of its output.
fn stopped(mut child: Child, signal: Signal) -> (String, String) {
    kill(Pid::from_raw(child.id() as i32), signal).expect("it runs");
    let asked = Instant::now();
    while child.try_wait().expect("its end").is_none() {
        if asked.elapsed() > Duration::from_secs(1) {
            child.kill().expect("it runs");
            panic!("{signal} did not end it");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let (mut said, mut rest) = (String::new(), String::new());
    child.stderr.take().expect("a pipe").read_to_string(&mut said).expect("text");
    if let Some(mut output) = child.stdout.take() {
        output.read_to_string(&mut rest).expect("text");
    }
    assert!(child.wait().expect("its end").success(), "{said}");
    (said, rest)
}

#[test]
fn a_frame_that_is_under_way_when_it_is_stopped_is_no_defect() {
    let (mut master, _slave, path) = open_pty();
    let mut child = geu()
        .args(["decode", &path, "--strict"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("geu starts");
    std::thread::sleep(Duration::from_millis(500));
    master.write_all(&[&data_frame(&sample(0))[..], &data_frame(&sample(1))[..11]].concat()).expect("a write");
    let mut lines = BufReader::new(child.stdout.take().expect("its output")).lines();
    assert!(lines.nth(1).expect("a row").expect("text").contains(",0,500000,"));
    let (said, _) = stopped(child, Signal::SIGINT);
    for expected in
        ["bytes-decoded            28", "bytes-unfinished         11", "accounts for all", "defects                  0"]
    {
        assert!(said.contains(expected), "{expected} not in {said}");
    }
}

#[test]
fn a_line_that_is_under_way_when_it_is_stopped_is_no_defect() {
    let mut child = geu()
        .args(["decode", "-", "--strict"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("geu starts");
    let mut input = child.stdin.take().expect("a pipe");
    let log = "(0.5) can0 1A0#FFFEFFFE00050005\n(0.5) can0 1A1#00000F070810DD5E\n(0.5) can0 1A2#00000007A1201B58\n";
    write!(input, "{log}(1.0) can0 1A0#FFFEFFFE00050005\n(1.0) can0 1A1#0000").expect("a write");
    let mut lines = BufReader::new(child.stdout.take().expect("its output")).lines();
    assert!(lines.nth(1).expect("a row").expect("text").starts_with("0.500000,0,"));
    let (said, _) = stopped(child, Signal::SIGTERM);
    for expected in
        ["records                  4", "records-unfinished       1", "accounts for all", "defects                  0"]
    {
        assert!(said.contains(expected), "{expected} not in {said}");
    }
}

#[test]
fn a_fifo_is_waited_for_until_its_writer_comes_or_a_signal() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("fifo");
    mkfifo(&path, Mode::S_IRWXU).expect("a FIFO");
    let configuration = geu_tests::root().join("configs/paper.toml");
    for arguments in [&["decode"][..], &["track", "--config", configuration.to_str().expect("text")]] {
        for signal in [Signal::SIGTERM, Signal::SIGINT] {
            let mut command = geu();
            command.args(arguments).arg(&path).stdout(Stdio::piped()).stderr(Stdio::piped());
            let child = command.spawn().expect("geu starts");
            std::thread::sleep(Duration::from_millis(500));
            stopped(child, signal);
        }
    }
    let mut command = geu();
    let child = command.arg("decode").arg(&path).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    std::thread::sleep(Duration::from_millis(300));
    let mut writer = OpenOptions::new().write(true).open(&path).expect("a reader");
    writer.write_all(&data_frame(&sample(0))).expect("a write");
    std::thread::sleep(Duration::from_millis(300));
    writer.write_all(&data_frame(&sample(1))).expect("a write");
    drop(writer);
    let output = child.expect("geu starts").wait_with_output().expect("its end");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(String::from_utf8_lossy(&output.stdout).lines().count(), 3);
}

#[test]
fn a_compressed_stream_that_stands_still_ends_at_a_signal_with_its_rows() {
    let frames = [data_frame(&sample(0)), data_frame(&sample(1))].concat();
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(&frames).and_then(|()| gzip.flush()).expect("a write");
    let mut zstd = zstd::Encoder::new(Vec::new(), 1).expect("zstd");
    zstd.write_all(&frames).and_then(|()| zstd.flush()).expect("a write");
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("fifo");
    mkfifo(&path, Mode::S_IRWXU).expect("a FIFO");
    let (gzip, zstd) = (&gzip.get_ref()[..], &zstd.get_ref()[..]);
    for bytes in [gzip, zstd, &gzip[..5], &gzip[..1], &frames[..11]] {
        let is_cut = bytes.len() < 12;
        for name in ["-", path.to_str().expect("text")] {
            let mut command = geu();
            command.args(["decode", name]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
            let mut child = command.spawn().expect("geu starts");
            let mut input: Box<dyn Write> = match name {
                "-" => Box::new(child.stdin.take().expect("a pipe")),
                _ => Box::new(OpenOptions::new().write(true).open(&path).expect("a reader")),
            };
            input.write_all(bytes).expect("a write");
            let mut lines = BufReader::new(child.stdout.take().expect("its output")).lines();
            // Available rows come at once.
            let rows: Vec<_> = lines.by_ref().take(if is_cut { 0 } else { 3 }).map(|row| row.expect("text")).collect();
            std::thread::sleep(Duration::from_millis(300));
            let (said, _) = stopped(child, Signal::SIGTERM);
            assert!(is_cut || rows[2].contains(",1,1000000,") && said.contains("defects                  0"), "{said}");
            assert!(lines.next().is_none_or(|line| line.expect("text").starts_with("t_s,")));
        }
    }
}

/// Waits until `min_bytes` of a file in the directory are written, or the file is created.
fn await_partial(directory: &Path, min_bytes: u64) {
    let is_partial = |entry: &fs::DirEntry| {
        let length = entry.metadata().map_or(0, |metadata| metadata.len());
        entry.file_name().to_string_lossy().ends_with(".partial") && length >= min_bytes
    };
    let begun = || fs::read_dir(directory).expect("a directory").flatten().any(|entry| is_partial(&entry));
    let start = Instant::now();
    while !begun() {
        assert!(start.elapsed() < Duration::from_secs(10), "nothing is written");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn a_signal_ends_the_reading_of_recorded_files_without_a_result() {
    let directory = tempfile::tempdir().expect("a directory");
    let name = |name: &str| directory.path().join(name).to_str().expect("text").to_owned();
    // Some seconds of work.
    let (day, old) = (name("day.bin.zst"), name("old.csv"));
    let mut long = zstd::Encoder::new(File::create(&day).expect("a file"), 1).expect("zstd").auto_finish();
    let frames = data_frame(&sample(0)).repeat(1 << 16);
    (0..400).for_each(|_| long.write_all(&frames).expect("written"));
    drop(long);
    for (command, input, signal) in
        [("decode", &day[..], Signal::SIGINT), ("decode", "-", Signal::SIGTERM), ("track", &day, Signal::SIGTERM)]
    {
        fs::write(&old, "old\n").expect("written");
        let mut child = geu();
        child.args([command, input, "--out", &old]).stdin(File::open(&day).expect("there")).stderr(Stdio::piped());
        let mut child = child.spawn().expect("geu starts");
        await_partial(directory.path(), 0);
        kill(Pid::from_raw(child.id() as i32), signal).expect("it runs");
        assert_eq!(child.wait().expect("its end").code(), Some(128 + signal as i32), "{command} {input}");
        assert_eq!(fs::read_to_string(&old).expect("there"), "old\n");
        assert_eq!(fs::read_dir(directory.path()).expect("a directory").count(), 2, "{command} {input}");

        // Rows on a standard output that is not read.
        let mut child =
            geu().args([command, &day]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("geu starts");
        std::thread::sleep(Duration::from_millis(300));
        // Not SIGINT, which a shell lets its background jobs ignore.
        kill(Pid::from_raw(child.id() as i32), Signal::SIGTERM).expect("it runs");
        assert_eq!(child.wait().expect("its end").signal(), Some(Signal::SIGTERM as i32), "{command}");
    }
    // With a live one among them all rows are given.
    let mut child = geu();
    child.args(["decode", &day, "-", "--out", &old]).stdin(Stdio::piped()).stderr(Stdio::piped());
    let child = child.spawn().expect("geu starts");
    // Before the first row there is nothing to give.
    await_partial(directory.path(), 1);
    let (said, _) = stopped(child, Signal::SIGINT);
    assert!(said.contains("defects                  0"), "{said}");
    assert!(fs::read_to_string(&old).expect("there").starts_with("t_s,"));
}

#[test]
fn an_address_is_connected_to_and_read_as_a_stream() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("bound").to_string();
    for command in ["decode", "track"] {
        for (name, ends) in [(address.clone(), true), (format!("tcp:{address}"), false)] {
            let mut child = geu();
            let child = child.args([command, &name]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
            let mut child = child.expect("geu starts");
            let (mut stream, _) = listener.accept().expect("a client");
            let mut lines = BufReader::new(child.stdout.take().expect("its output")).lines();
            stream.write_all(&[data_frame(&sample(0)), data_frame(&sample(1))].concat()).expect("a write");
            let rows: Vec<_> = lines.by_ref().take(3).map(|row| row.expect("text")).collect();
            assert!(rows[2].starts_with("1.000000,1,"), "{rows:?}");
            if ends {
                drop(stream);
                assert!(child.wait().expect("its end").success());
            } else {
                stopped(child, Signal::SIGINT);
            }
            assert!(lines.next().is_none());
        }
    }
    drop(listener);
    let output = geu().args(["decode", &address]).output().expect("geu starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains(&format!("{address}: cannot be opened: Connection refused")), "{said}");
}
