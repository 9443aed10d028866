//! Described units emulated: their bytes read by a reader of its own, faults, and runs that repeat.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::time::{Duration, Instant};

use geu_tests::emulator::Emulator;
use geu_tests::geu;

/// A rate table that turns all axes, to two thirds of the range of the slowest unit, with a sine and random rates.
const MOTION: &str = "
[[motion]]
duration_s = 2.0
x_deg_s = 3.0
y_deg_s = -2.0
end_x_deg_s = -4.0
z_deg_s = 1.0
[[motion]]
duration_s = 3.0
sine_x_deg_s = 2.0
sine_y_deg_s = 3.0
sine_z_deg_s = -1.5
frequency_hz = 1.7
random_deg_s = 0.5
random_hz = 10.0
";

/// An arcsec.
const ARCSEC_RAD: f64 = std::f64::consts::PI / 648_000.0;

fn run(arguments: &[&str], paths: &[&Path]) -> Output {
    geu().args(arguments).args(paths).output().expect("geu starts")
}

/// Simulates a unit on [`MOTION`] with more configuration, and returns the directory.
fn simulated(folder: &Path, device: &str, more: &str) -> PathBuf {
    let (configuration, out) = (folder.join("unit.toml"), folder.join("run"));
    fs::write(&configuration, format!("device = \"{device}\"\n{more}{MOTION}")).expect("a file");
    let output = geu().arg("simulate").arg(&configuration).arg("--out").arg(&out).output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    out
}

/// True angle in arcsec and count of each sample by head, from `truth.csv`.
fn truth(run: &Path) -> BTreeMap<String, Vec<(f64, f64)>> {
    let text = fs::read_to_string(run.join("truth.csv")).expect("a truth");
    let mut heads = BTreeMap::<String, Vec<(f64, f64)>>::new();
    for line in text.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |cell: &str| cell.parse().expect("a number");
        heads.entry(cells[2].to_owned()).or_default().push((number(cells[3]), number(cells[cells.len() - 1])));
    }
    heads
}

fn i24(bytes: &[u8]) -> f64 {
    f64::from(i32::from_be_bytes([bytes[0], bytes[1], bytes[2], 0]) >> 8)
}

#[test]
fn a_reader_that_is_not_ours_finds_the_true_rates_of_a_stim300() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = simulated(folder.path(), "stim300", "");
    let (bytes, truth) = (fs::read(run.join("link.bin")).expect("a link"), truth(&run));
    assert_eq!(bytes.len(), 25 * 10_000);
    for (index, datagram) in bytes.chunks(25).enumerate() {
        assert_eq!((datagram[0], datagram[18]), (0x94, index as u8), "{index}");
        for (axis, head) in ["X", "Y", "Z"].iter().enumerate() {
            let counts = i24(&datagram[1 + 3 * axis..]);
            let (true_arcsec, count) = truth[*head][index];
            assert_eq!(counts, count);
            // The mean rate of the sample, in counts of 2⁻¹⁴ °/s.
            let true_counts = true_arcsec / 3600.0 / 0.0005 * 16384.0;
            assert!((counts - true_counts).abs() <= 0.500_001, "{index} {head}: {counts} {true_counts}");
        }
        // 70 °C in 1/256 °C.
        assert_eq!(datagram[11..13], (70 * 256i16).to_be_bytes());
    }
}

#[test]
fn increments_of_floats_and_of_skewed_heads_are_the_true_angles() {
    let folder = tempfile::tempdir().expect("a folder");
    let kvh = simulated(folder.path(), "kvh-1750", "");
    let (bytes, true_x) = (fs::read(kvh.join("link.bin")).expect("a link"), truth(&kvh)["X"].clone());
    assert_eq!(bytes.len(), 36 * 5000);
    for (message, (true_arcsec, _)) in bytes.chunks(36).zip(true_x) {
        let angle = f32::from_be_bytes(message[4..8].try_into().expect("four bytes"));
        assert_eq!(angle, (true_arcsec / (648_000.0 / std::f64::consts::PI)) as f32);
    }
    let folder = tempfile::tempdir().expect("a folder");
    let tetrad = simulated(folder.path(), "tetrad", "");
    let (bytes, truth) = (fs::read(tetrad.join("link.bin")).expect("a link"), truth(&tetrad));
    let (mut sums, mut parity) = ([0.0; 4], 0.0);
    for (index, frame) in bytes.chunks(31).enumerate() {
        for (place, head) in ["A", "B", "C", "D"].iter().enumerate() {
            let word: [u8; 4] = frame[4 + 4 * place..8 + 4 * place].try_into().expect("four bytes");
            let counts = f64::from(i32::from_le_bytes(word));
            sums[place] += counts - truth[*head][index].0 / 0.01;
            // No fraction of a count is ever lost.
            assert!(sums[place].abs() <= 0.501, "{index} {head}: {}", sums[place]);
            parity += counts;
        }
    }
    // The axes of a tetrahedron add up to 0, and so do its outputs.
    assert!(parity.abs() <= 2.0, "{parity}");
}

#[test]
fn a_longer_message_comes_instead_of_every_sixth_and_carries_the_angle_since_the_one_before() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = simulated(folder.path(), "hg4930", "");
    let (bytes, truth) = (fs::read(out.join("link.bin")).expect("a link"), truth(&out));
    let word = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    let (mut at, mut index, mut since) = (0, 0, [0.0; 3]);
    while at < bytes.len() {
        let is_inertial = index % 6 == 0;
        let length = if is_inertial { 44 } else { 20 };
        assert_eq!(bytes[at..at + 2], [0x0E, 1 + u8::from(is_inertial)], "{index}");
        let sum = (at..at + length - 2).step_by(2).fold(0, |sum: u16, at| sum.wrapping_add(word(at)));
        assert_eq!(sum, word(at + length - 2), "{index}");
        // Counter, continuous test; version of the software, or the temperature.
        let second = if index % 2 == 0 { 0x8000 | 70 } else { 1 };
        assert_eq!((word(at + 14), word(at + 16)), (4 + index % 4, second), "{index}");
        for (place, head) in ["X", "Y", "Z"].iter().enumerate() {
            since[place] += truth[*head][usize::from(index)].0 * ARCSEC_RAD;
            let angle = at + 18 + 4 * place;
            if is_inertial {
                let counts = i32::from_le_bytes(bytes[angle..angle + 4].try_into().expect("four bytes"));
                assert!((f64::from(counts) - since[place] * 2f64.powi(33)).abs() < 0.501, "{index} {head}");
                since[place] = 0.0;
            }
        }
        (at, index) = (at + length, index + 1);
    }
    assert_eq!(index, 3000);
}

#[test]
fn decoded_rows_of_every_unit_are_the_counts_of_its_truth() {
    for (device, per_count) in [
        ("stim300", 1.0 / 16384.0),
        ("stim300-increment", 1.0 / 2_097_152.0),
        ("kvh-1750", ARCSEC_RAD),
        ("mm5.10", 0.005),
        ("openimu300ri", 1.0 / 128.0),
        // A rate: a count is an arcsec in 10 ms.
        ("mti-100", ARCSEC_RAD / 0.01),
        ("tetrad", 0.01),
        ("hg4930", 1.0 / 1_048_576.0),
    ] {
        let folder = tempfile::tempdir().expect("a folder");
        let out = simulated(folder.path(), device, "");
        let link = ["link.bin", "link.log"].map(|name| out.join(name)).into_iter().find(|path| path.exists());
        let decoded = run(&["decode", "--device", device], &[&link.expect("a link")]);
        let summary = String::from_utf8_lossy(&decoded.stderr).into_owned();
        // Of a log the frames are counted, of serial bytes every byte.
        assert!(summary.contains("accounts for all") || summary.contains("candump"), "{device}: {summary}");
        assert!(summary.contains("defects                  0"), "{device}: {summary}");
        let text = String::from_utf8(decoded.stdout).expect("UTF-8");
        let header: Vec<&str> = text.lines().next().expect("a header").split(',').collect();
        let truth = truth(&out);
        assert_eq!(text.lines().count() - 1, truth.values().next().expect("a head").len(), "{device}");
        for (head, counts) in &truth {
            let column =
                header.iter().position(|name| name.starts_with(&format!("{head}_")) && !name.contains("valid"));
            let column = column.unwrap_or_else(|| panic!("{device}: no {head} in {header:?}"));
            for (line, (_, count)) in text.lines().skip(1).zip(counts) {
                let value: f64 = line.split(',').nth(column).expect("a cell").parse().expect("a number");
                // A float of 32 bits is rounded.
                let error = (value / per_count - count).abs();
                assert!(error < 1e-6 + 1e-7 * count.abs(), "{device} {head}: {value} {count}");
            }
        }
    }
}

#[test]
fn faults_act_on_the_heads_and_frames_of_a_described_unit() {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = "
[[fault]]
at_s = 1.0
for_s = 1.0
gyro = \"Y\"
fault = \"stuck-count\"
counts = 777
[[fault]]
at_s = 3.0
for_s = 0.5
fault = \"bit-flip\"
[[fault]]
at_s = 4.0
for_s = 0.01
fault = \"sequence-jump\"
by = 5
[[expect]]
condition = \"count(Y) == 777\"
within_s = 2
at_s = 1.0
";
    let run_of = simulated(folder.path(), "stim300", plan);
    let counts: Vec<f64> = truth(&run_of)["Y"].iter().map(|(_, count)| *count).collect();
    assert!(counts[2000..4000].iter().all(|count| *count == 777.0));
    assert!(counts[1999] != 777.0 && counts[4000] != 777.0);
    let summary = run(&["decode", "--device", "stim300", "--format", "summary"], &[&run_of.join("link.bin")]);
    let summary = String::from_utf8(summary.stdout).expect("UTF-8");
    // A thousand datagrams with a changed bit are not read; the sequence jumps by 5 and back, which is a gap of 5 and of 251.
    let gaps: Vec<&str> = summary.lines().filter(|line| line.starts_with("gap ")).collect();
    assert!(gaps.iter().any(|gap| gap.split_whitespace().nth(1) == Some("5")), "{gaps:?}");
    assert!(summary.contains("frames-RATE_TEMPERATURE  9000"), "{summary}");
    // The recording has the unit.
    let decoded =
        run(&["decode", "--format", "summary", "--device"], &[&run_of.join("run.toml"), &run_of.join("link.bin")]);
    assert_eq!(String::from_utf8(decoded.stdout).as_deref(), Ok(&*summary));
    let again = folder.path().join("again");
    let output =
        geu().arg("simulate").arg(run_of.join("run.toml")).arg("--out").arg(&again).output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for name in ["link.bin", "truth.csv", "faults.jsonl", "run.toml", "reference.csv"] {
        assert_eq!(fs::read(run_of.join(name)).ok(), fs::read(again.join(name)).ok(), "{name}");
    }
}

#[test]
fn what_a_unit_cannot_have_is_refused_with_the_reason() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("unit.toml");
    let refused = |text: &str, arguments: &[&str], expected: &str| {
        fs::write(&file, text).expect("a file");
        let output = run(arguments, &[&file]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{text}: {said}");
        assert!(said.contains(expected), "{text}: {said}");
    };
    let check = ["config", "check"];
    let stim = |text: &str| format!("device = \"stim300\"\n{text}");
    refused("device = \"stim30\"\n", &check, "did you mean `stim300`?");
    refused(&stim("[gyro.GYRX]\n"), &check, ": X, Y, Z");
    refused(&stim("[gyro.X]\npivot-clearance = { clearance_arcsec = 3.0 }\n"), &check, "without an output axis");
    let fault = "[[fault]]\ngyro = \"X\"\nparameter = \"pivot-clearance.clearance_arcsec\"\ncourse = { step = 2 }\n";
    refused(&stim(fault), &check, "needs a gyro with an output axis");
    refused(&stim("[[fault]]\nfault = \"reply-late\"\ndelay_s = 1\n"), &check, "the unit has no commands");
    refused(&stim("[[fault]]\nfault = \"drop\"\nlink = \"can\"\n"), &check, "no such link");
    refused(&stim("[[fault]]\nfault = \"dead\"\ngyro = \"GYRX\"\n"), &check, "X, Y, Z for `fault.0.gyro`");
    refused(&stim(""), &["watch", "x.log", "--reference", "x.csv", "--config"], "x.csv: cannot be read");
    refused(&stim(""), &["config", "check", "--device", "tetrad"], "configuration of Skewed tetrad, got Safran");
    refused(&stim("[[motion]]\nx_deg_s = 1\n"), &check, "duration_s");
    let both = "[[manoeuvre]]\nkind = \"pointing\"\nduration_s = 10\n[[motion]]\nduration_s = 1\n";
    refused(both, &check, "either [[motion]] or [[manoeuvre]]");
    refused(&stim("[gyro.X]\nscale-factor = { ppm = -1000000.0 }\n"), &check, "within ±100000");
    refused(&stim("[gyro.X]\nmisalignment = { y_arcsec = 206364.0 }\n"), &check, "within ±206264");
    refused(&stim("[[fault]]\nfault = \"axis-swap\"\ngyro = \"X\"\nwith = \"X\"\n"), &check, "its own gyro");
    refused(&stim("[[fault]]\nfault = \"drop\"\nfor_s = 0.0001\n"), &check, "0.0005 s, or more");
    refused("[[fault]]\nfault = \"drop\"\nfor_s = 0.2\n", &check, "0.5 s, or more");
    // Limits grow with the range, 2000 times that of the default unit.
    fs::write(&file, stim("[gyro.X]\ndrift = { arcsec_per_h = 900000.0 }\nscale-factor = { ppm = 5000.0 }\n"))
        .expect("a file");
    let output = run(&check, &[&file]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    refused(&stim("[gyro.X]\ndrift = { arcsec_per_h = 80000000.0 }\n"), &check, "within ±72000000");
    let output = run(&["simulate", "--device", "mm5.10", "--svg"], &[&folder.path().join("s")]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("expected the default unit"), "{output:?}");
    let output = run(
        &["simulate", "--device", "mm5.10", "--wire", "serial", "--duration", "1", "--out"],
        &[&folder.path().join("o")],
    );
    assert!(String::from_utf8_lossy(&output.stderr).contains("Bosch MM5.10 has no such link"));
    let output = run(
        &["run", "--device", "mm5.10", "--control", "off", "--duration", "1", "--pty"],
        &[&folder.path().join("p")],
    );
    assert!(String::from_utf8_lossy(&output.stderr).contains("expected a link that it has, --can"), "{output:?}");
}

#[test]
fn a_stim300_at_2000_hz_reaches_the_client_of_a_pty_whole() {
    let folder = tempfile::tempdir().expect("a folder");
    let pty = folder.path().join("gyro");
    let name = pty.display().to_string();
    let emulator = Emulator::start(1, &["--device", "stim300", "--control", "off", "--pty", &name]);
    let mut port =
        fs::OpenOptions::new().read(true).write(true).custom_flags(nix::libc::O_NOCTTY).open(&pty).expect("a pty");
    let mut attributes = nix::sys::termios::tcgetattr(&port).expect("attributes");
    nix::sys::termios::cfmakeraw(&mut attributes);
    nix::sys::termios::tcsetattr(&port, nix::sys::termios::SetArg::TCSANOW, &attributes).expect("raw");
    let (mut bytes, mut chunk, start) = (Vec::new(), [0; 8192], Instant::now());
    while start.elapsed() < Duration::from_secs(3) {
        let length = port.read(&mut chunk).expect("bytes");
        bytes.extend_from_slice(&chunk[..length]);
    }
    drop(emulator);
    let is_start = |at: usize| (0..8).all(|datagram| bytes[at + 25 * datagram] == 0x94);
    let first = (0..bytes.len() - 200).find(|at| is_start(*at)).expect("datagrams");
    let counters: Vec<u8> = bytes[first..].chunks_exact(25).map(|datagram| datagram[18]).collect();
    assert!(counters.len() > 5000, "{}", counters.len());
    let lost = counters.windows(2).filter(|pair| pair[1] != pair[0].wrapping_add(1)).count();
    // A machine with more work than cores may hold the reader up for longer than the buffer of a port lasts, 80 ms.
    assert!(lost * 100 < counters.len(), "{lost} of {}", counters.len());
}
