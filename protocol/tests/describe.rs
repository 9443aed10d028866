//! What is generated for other tools: each file beside the sources equals its generator, and the tools read it.

use std::ffi::OsStr;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use geu_protocol::serial::{FrameType, data_frame, frame};
use geu_protocol::{CanIdMap, Sample, describe};

pub fn here(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Says that a test did not run, past the capture of the harness: what did not run must not look passed.
pub fn skip(reason: &str) {
    let _ = writeln!(std::io::stderr(), "skipped: {reason}");
}

pub fn run<S: AsRef<OsStr>>(program: &str, arguments: &[S]) -> Option<Output> {
    match Command::new(program).args(arguments).output() {
        Ok(output) => Some(output),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
        Err(error) => panic!("{program}: {error}"),
    }
}

pub fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

#[test]
fn files_are_those_the_generators_write() {
    for (form, name, generated) in [
        ("dbc", "geu.dbc", describe::dbc(CanIdMap::default())),
        ("header", "geu.h", describe::header()),
        ("dissector", "geu.lua", describe::dissector()),
        ("icd", "ICD.md", describe::icd()),
    ] {
        let written = std::fs::read_to_string(here(name)).unwrap_or_default();
        let differs = written.lines().zip(generated.lines()).position(|(a, b)| a != b);
        assert!(
            written == generated,
            "protocol/{name} differs from its generator, first in line {}; bring it up to date with\n    \
             cargo run --locked -- describe {form} --out protocol/{name}",
            differs.unwrap_or(written.lines().count().min(generated.lines().count())) + 1
        );
    }
}

#[test]
fn cantools_decodes_the_vectors_with_the_database() {
    let present = run("python3", &["-c", "import cantools"]);
    if !present.is_some_and(|output| output.status.success()) {
        return skip("python3 with cantools is absent; the CAN database was not tried");
    }
    let script = here("tests/describe/dbc.py");
    let output = run("python3", &[script.as_os_str(), here("geu.dbc").as_os_str()]).expect("python3 exists");
    assert!(output.status.success(), "{}", text(&output));
}

#[test]
fn c_and_cpp_programs_pack_and_unpack_the_vectors_with_the_header() {
    let directory = tempfile::tempdir().unwrap();
    let include = format!("-I{}", env!("CARGO_MANIFEST_DIR"));
    let source = here("tests/describe/header.c");
    for (compiler, language) in [("cc", &["-std=c99"][..]), ("c++", &["-x", "c++", "-std=c++11"])] {
        let program = directory.path().join(compiler);
        let mut arguments: Vec<&OsStr> = language.iter().map(OsStr::new).collect();
        arguments.extend(["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", &include].map(OsStr::new));
        arguments.extend([source.as_os_str(), OsStr::new("-o"), program.as_os_str()]);
        let Some(compiled) = run(compiler, &arguments) else {
            skip(&format!("{compiler} is absent; the C header was not tried with it"));
            continue;
        };
        assert!(compiled.status.success(), "{}", text(&compiled));
        let checked = Command::new(&program).output().unwrap();
        assert!(checked.status.success(), "{compiler}: {}", text(&checked));
    }
}

/// A capture file of one link type, with a packet every 0.5 s.
pub fn pcap(link_type: u32, packets: &[Vec<u8>]) -> Vec<u8> {
    let mut file = Vec::new();
    file.extend_from_slice(&0xA1B2_C3D4u32.to_be_bytes());
    file.extend_from_slice(&[0, 2, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xFF, 0xFF]);
    file.extend_from_slice(&link_type.to_be_bytes());
    for (index, packet) in packets.iter().enumerate() {
        let length = packet.len() as u32;
        for word in [index as u32 / 2, index as u32 % 2 * 500_000, length, length] {
            file.extend_from_slice(&word.to_be_bytes());
        }
        file.extend_from_slice(packet);
    }
    file
}

pub const LINKTYPE_CAN_SOCKETCAN: u32 = 227;
pub const LINKTYPE_RAW: u32 = 101;

/// A frame with an identifier as SocketCAN has it: bit 31 is set for 29 bits.
pub fn socketcan(id: u32, data: &[u8]) -> Vec<u8> {
    let mut packet = id.to_be_bytes().to_vec();
    packet.extend_from_slice(&[data.len() as u8, 0, 0, 0]);
    packet.extend_from_slice(data);
    packet
}

/// The segments of one direction of a TCP connection from the unit's `port`, as IPv4 packets.
pub fn tcp(port: u16, segments: &[&[u8]]) -> Vec<Vec<u8>> {
    let mut sequence = 1000u32;
    let mut packets = Vec::new();
    for segment in segments {
        let mut packet = vec![0x45, 0];
        packet.extend_from_slice(&(40 + segment.len() as u16).to_be_bytes());
        packet.extend_from_slice(&[0, 0, 0x40, 0, 64, 6, 0, 0, 10, 0, 0, 1, 10, 0, 0, 2]);
        packet.extend_from_slice(&port.to_be_bytes());
        packet.extend_from_slice(&40_001u16.to_be_bytes());
        packet.extend_from_slice(&sequence.to_be_bytes());
        packet.extend_from_slice(&[0, 0, 0, 1, 0x50, 0x18, 0xFF, 0xFF, 0, 0, 0, 0]);
        packet.extend_from_slice(segment);
        sequence += segment.len() as u32;
        packets.push(packet);
    }
    packets
}

/// Each packet's values of `fields`, as tshark with the dissector prints them; `None` without tshark.
fn dissect(capture: &[u8], options: &[&str], fields: &[&str]) -> Option<Vec<Vec<String>>> {
    dissect_with(&here("geu.lua"), capture, options, fields)
}

/// Reads with the dissector of a file.
pub fn dissect_with(dissector: &Path, capture: &[u8], options: &[&str], fields: &[&str]) -> Option<Vec<Vec<String>>> {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(capture).unwrap();
    let script = format!("lua_script:{}", dissector.display());
    let path = file.path().to_str().unwrap();
    let mut arguments = vec!["-X", &script, "-r", path, "-T", "fields", "-E", "occurrence=a"];
    arguments.extend(options);
    fields.iter().for_each(|field| arguments.extend(["-e", field]));
    let output = run("tshark", &arguments)?;
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !errors.contains("Lua"), "{}", text(&output));
    let lines = String::from_utf8_lossy(&output.stdout).into_owned();
    Some(lines.lines().map(|line| line.split('\t').map(str::to_string).collect()).collect())
}

fn samples() -> Vec<Sample> {
    let one = |sequence: u16| Sample {
        sequence,
        increments: [-2, i16::MIN, i16::MAX, sequence as i16 - 3],
        gyro_flags: 0x6F,
        unit_flags: 0x07,
        electronics_centi_c: -1234 + sequence as i16,
        clock_count: (1 << 47) + u64::from(sequence) * 500_000,
        sensor_centi_c: 7000,
    };
    (65_533..=u16::MAX).chain(0..4).map(one).collect()
}

const FIELDS: [&str; 10] = [
    "geu.sequence",
    "geu.gyrx",
    "geu.gyry",
    "geu.gyrza",
    "geu.gyrzb",
    "geu.gyro_flags",
    "geu.unit_flags",
    "geu.electronics_c",
    "geu.clock_count",
    "geu.sensor_c",
];

/// Expected output of tshark for `h`, in the order of `FIELDS`.
fn row(h: &Sample) -> Vec<String> {
    let celsius = |centi: i16| {
        let text = format!("{:.2}", f64::from(centi) / 100.0);
        text.trim_end_matches('0').trim_end_matches('.').to_string()
    };
    let mut row = vec![h.sequence.to_string()];
    row.extend(h.increments.iter().map(i16::to_string));
    row.extend([format!("0x{:02x}", h.gyro_flags), format!("0x{:02x}", h.unit_flags)]);
    row.extend([celsius(h.electronics_centi_c), h.clock_count.to_string(), celsius(h.sensor_centi_c)]);
    row
}

pub const NO_TSHARK: &str = "tshark is absent; the dissector was not tried";

#[test]
fn tshark_reads_can_frames_and_checks_status_with_the_increments_before_it() {
    let plan = CanIdMap::with_base(0x200).unwrap();
    let mut packets = Vec::new();
    for sample in samples() {
        for frame in plan.frames(&sample) {
            packets.push(socketcan(frame.id(), frame.data()));
            packets.push(socketcan(0x123, &[1, 2, 3]));
        }
    }
    let status = packets[2].clone();
    packets.push(status);
    packets.push(socketcan(0x208, &[4, 3, 0xFF, 0x9C, 20]));
    packets.push(socketcan(0x209, &[3, 3]));
    packets.push(socketcan(0x200, &[1, 2]));
    let capture = pcap(LINKTYPE_CAN_SOCKETCAN, &packets);
    let mut fields = FIELDS.to_vec();
    fields.extend(["geu.crc_good", "geu.self_test_counts", "geu.result", "_ws.expert.message", "geu.gyry_saturated"]);
    // Once in one pass, and once in two: the CRC of STATUS is found in the order of the capture.
    for passes in [&["-o", "geu.can_base:200"][..], &["-o", "geu.can_base:200", "-2"]] {
        let Some(rows) = dissect(&capture, passes, &fields) else {
            return skip(NO_TSHARK);
        };
        let rows: Vec<_> = rows.into_iter().filter(|row| row.iter().any(|cell| !cell.is_empty())).collect();
        let (cyclic, rest) = rows.split_at(3 * samples().len());
        for (cells, sample) in cyclic.chunks(3).zip(samples()) {
            let merged: Vec<String> =
                (0..FIELDS.len()).map(|column| cells.iter().map(|row| row[column].as_str()).collect()).collect();
            assert_eq!(merged, row(&sample));
            assert_eq!((cells[1][10].as_str(), cells[1][14].as_str()), ("1", "1"));
        }
        assert_eq!(rest.len(), 4);
        assert!(rest[0][13].contains("no INCREMENTS"), "{rest:?}");
        assert_eq!(rest[1][11], "-100");
        assert_eq!(rest[2][12], "3");
        assert!(rest[3][13].contains("length"), "{rest:?}");
    }
}

#[test]
fn tshark_reads_serial_frames_over_tcp_however_they_are_cut() {
    let mut bytes = Vec::new();
    for sample in samples() {
        bytes.extend_from_slice(&data_frame(&sample));
    }
    bytes.extend_from_slice(&frame(FrameType::Command, &[1]));
    bytes.extend_from_slice(&frame(FrameType::Reply, &[1, 0, 1, 0]));
    let mut fields = FIELDS.to_vec();
    fields.extend(["geu.opcode", "geu.ping_major", "geu.crc_good"]);
    // By the preference's port in segments that cut every frame; found by the sync on another port.
    for (port, length, options) in [(4700, 9, &[][..]), (4700, 33, &["-2"]), (28_123, 37, &[])] {
        let segments: Vec<&[u8]> = bytes.chunks(length).collect();
        let Some(rows) = dissect(&pcap(LINKTYPE_RAW, &tcp(port, &segments)), options, &fields) else {
            return skip(NO_TSHARK);
        };
        let column = |index: usize| -> Vec<&str> {
            rows.iter().flat_map(|row| row[index].split(',')).filter(|cell| !cell.is_empty()).collect()
        };
        let expected: Vec<Vec<String>> = samples().iter().map(row).collect();
        for (index, name) in FIELDS.iter().enumerate() {
            let expected: Vec<&str> = expected.iter().map(|row| row[index].as_str()).collect();
            assert_eq!(column(index), expected, "{name}, port {port}, segments of {length}");
        }
        assert_eq!((column(10), column(11)), (vec!["0x01", "0x01"], vec!["1"]));
        assert_eq!(column(12), vec!["1"; samples().len() + 2]);
    }
}

#[test]
fn tshark_says_which_bytes_are_no_frame_and_finds_the_frame_behind_them() {
    let good = data_frame(&samples()[0]);
    let mut flipped = good;
    flipped[10] ^= 0x40;
    let bytes = [&flipped[..], &[0xEB, 0x90, 0x77], &good].concat();
    let fields = ["geu.sequence", "geu.crc_good", "geu.skipped", "_ws.expert.message"];
    let segments = tcp(4700, &[&bytes]);
    let Some(rows) = dissect(&pcap(LINKTYPE_RAW, &segments), &[], &fields) else {
        return skip(NO_TSHARK);
    };
    assert_eq!(rows[0][0], "65533");
    assert_eq!(rows[0][1], "0,1");
    assert_eq!(rows[0][2].replace(':', "").len(), 2 * (flipped.len() + 3), "{rows:?}");
    assert!(rows[0][3].contains("CRC does not match"), "{rows:?}");
}
