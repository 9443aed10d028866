//! Recordings of ten configurations, links and fault plans have the bytes that an earlier build wrote.
//!
//! A change of the expected checksums is a change of behaviour. `GEU_PRINT_CHECKSUMS=1` prints those of this build.

use std::fs;
use std::hash::{DefaultHasher, Hasher};
use std::io::Read;
use std::net::TcpStream;
use std::path::{Path, PathBuf};

use geu_tests::emulator::Emulator;
use geu_tests::{geu, root};

/// Name, arguments of `geu simulate` with `@` for the directory of the configurations and `%` for that of the recordings made
/// before, checksum of all files.
const CASES: [(&str, &str, u64); 10] = [
    ("default-can", "--duration 900", 0x8617_15a2_ef67_b8e3),
    ("default-serial", "--duration 900 --seed 5 --wire serial", 0x5af7_e095_3c15_dcfb),
    ("checkout", "configs/checkout.toml --duration 4h --seed 3", 0x126d_2913_88fa_7082),
    ("paper", "configs/paper.toml --duration 1h --wire serial --faults configs/faults.toml", 0x121d_610d_07be_110b),
    ("effects-can", "@effects.toml --duration 2400", 0xf0f6_46ab_e686_242a),
    (
        "effects-faults",
        "@effects.toml --duration 900 --wire serial --faults @gyro_and_unit.toml",
        0xbe8e_ef81_b77d_cf91,
    ),
    ("parameters", "configs/reference.toml --duration 700 --faults @parameters.toml", 0x683d_cab8_97f5_b177),
    (
        "link-faults-can",
        "--duration 300 --faults @link_can.toml --set gyro.GYRX.drift.arcsec_per_h=900",
        0xdd07_fb22_6a30_ef13,
    ),
    ("link-faults-tcp", "--duration 300 --wire serial --faults @link_tcp.toml", 0x5dd1_2d38_3943_b2a8),
    (
        "truth-file",
        "--truth %default-can/reference.csv --wire serial --seed 4 --faults @gyro_and_unit.toml",
        0x841e_e9df_c3e1_5d70,
    ),
];

/// Of the bytes that a TCP client reads from `geu run --speed max` with link faults, and of its recording.
const LIVE: u64 = 0x875b_259c_696f_a236;

fn checksum(directory: &Path, hasher: &mut DefaultHasher) {
    let mut files: Vec<PathBuf> = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    for file in files {
        // What a run was called with names directories of this test.
        if !file.ends_with("run.toml") {
            hasher.write(file.file_name().unwrap().as_encoded_bytes());
            hasher.write(&fs::read(&file).unwrap());
        }
    }
}

fn compare(name: &str, expected: u64, hasher: DefaultHasher, differing: &mut Vec<String>) {
    let found = hasher.finish();
    if std::env::var_os("GEU_PRINT_CHECKSUMS").is_some() {
        eprintln!("{name} 0x{found:016x}");
    } else if found != expected {
        differing.push(name.to_owned());
    }
}

#[test]
fn recordings_have_the_bytes_of_the_earlier_build() {
    let configurations = root().join("tests/same_bytes");
    let recordings = tempfile::tempdir().unwrap();
    let mut differing = Vec::new();
    for (name, arguments, expected) in CASES {
        let place = |argument: &str| {
            argument
                .replace('@', &format!("{}/", configurations.display()))
                .replace('%', &format!("{}/", recordings.path().display()))
        };
        let out = recordings.path().join(name);
        let mut command = geu();
        command.current_dir(root()).arg("simulate").args(arguments.split(' ').map(place)).arg("--out").arg(&out);
        let output = command.output().expect("geu starts");
        // An expectation of the plan may be missed.
        assert!(matches!(output.status.code(), Some(0 | 1)), "{name}: {}", String::from_utf8_lossy(&output.stderr));
        let mut hasher = DefaultHasher::new();
        checksum(&out, &mut hasher);
        compare(name, expected, hasher, &mut differing);
    }
    assert!(differing.is_empty(), "differ: {differing:?}");
}

#[test]
fn a_tcp_client_and_the_recording_of_its_run_have_the_bytes_of_the_earlier_build() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("run");
    let plan = root().join("tests/same_bytes/link_tcp.toml");
    let mut emulator = Emulator::start(
        1,
        &[
            "--tcp",
            "127.0.0.1:0",
            "--wait",
            "--speed",
            "max",
            "--duration",
            "300",
            "--start",
            "1000000000",
            "--control",
            "off",
            "--faults",
            plan.to_str().unwrap(),
            "--record",
            out.to_str().unwrap(),
        ],
    );
    let address = emulator.ready[0].trim_start_matches("tcp ").trim_start_matches("tcp://").to_owned();
    let mut bytes = Vec::new();
    TcpStream::connect(&address).expect(&address).read_to_end(&mut bytes).unwrap();
    emulator.child.wait().unwrap();
    let mut hasher = DefaultHasher::new();
    hasher.write(&bytes);
    checksum(&out, &mut hasher);
    let mut differing = Vec::new();
    compare("live", LIVE, hasher, &mut differing);
    assert!(differing.is_empty(), "differ: {differing:?}, {} bytes received", bytes.len());
}
