//! Generated descriptions of known units: programs that are not ours read the same values with them.

use std::fmt::Write;
use std::path::Path;
use std::process::Command;

use geu_model::device::{DEVICES, Device};
use geu_protocol::layout::{Frame, FrameSet};

use crate::describe::{
    LINKTYPE_CAN_SOCKETCAN, LINKTYPE_RAW, NO_TSHARK, dissect_with, here, pcap, run, skip, socketcan, tcp, text,
};

/// Links of a unit: true for CAN.
fn links(device: &Device) -> impl Iterator<Item = (bool, &FrameSet)> {
    let serial = device.serial.iter().map(|serial| (false, &*serial.frames));
    serial.chain(device.can.iter().map(|can| (true, &*can.frames)))
}

/// The known units, and a unit with a frame for each sum and some CRCs with reflection, padding and suffix.
fn units() -> Vec<(String, Device)> {
    let checks = [
        ("sum", "u16be"),
        ("negated-sum", "u8"),
        ("sum-u16be", "u16le"),
        ("negated-sum-u16le", "u16be"),
        ("fletcher", "u16be"),
        ("xor", "u8"),
        ("CRC-16/TMS37157", "u16le"),
        ("CRC-8/MAXIM-DOW", "u8"),
        ("CRC-24/BLE", "u24be"),
        ("CRC-32/ISO-HDLC", "u32le"),
        ("CRC-32/BZIP2", "u32be"),
    ];
    let frames = checks.iter().enumerate().map(|(index, (check, number))| {
        let (every, carried) = match index {
            0 => (1, "head = \"X\", type = \"i24le\", unit = \"deg\", scale = 1e-4"),
            _ => (20, "value = \"sensor\", type = \"f64le\""),
        };
        format!(
            "[[device.serial.frame]]\nname = \"F{index}\"\nevery = {every}\nfields = [{{ constant = \"C3 {index:02X}\" }}, \
             {{ {carried} }}, {{ crc = \"{check}\", type = \"{number}\", pad_to = {}, suffix = \"A1 B2\" }}, {{ ignored = \"07\" }}]\n",
            1 + index % 4
        )
    });
    let text = "[device]\nname = \"sums\"\nsource = \"none\"\ninterval_s = 1.0\noutput = \"increment\"\nrange_arcsec_s = 36.0\n\
                [[device.head]]\nname = \"X\"\ninput = [1, 0, 0]\n[device.serial]\n";
    let text = text.to_owned() + &frames.collect::<String>();
    let sums =
        Device::parse("sums.toml", &text, &|_| Err("no file".to_owned())).unwrap_or_else(|error| panic!("{error}"));
    let known = DEVICES.iter().map(|(name, _)| ((*name).to_owned(), Device::from_name(name).unwrap()));
    known.chain([("sums".to_owned(), sums)]).collect()
}

fn prefix(name: &str) -> String {
    format!("unit_{}", name.replace(['-', '.'], "_"))
}

/// Bytes of a frame in which every field has some number, by `seed`.
fn bytes(frame: &Frame, set: &FrameSet, seed: u64) -> Vec<u8> {
    let mut values = vec![0.0; set.values.len()];
    for (index, field) in frame.fields.iter().enumerate() {
        let share = (seed * 7919 + index as u64 * 104_729) % 1_000 * 1_000_003 % 1_000;
        let (low, high) = field.limits();
        values[field.slot] = if high.is_finite() && high < 1e30 {
            low + (high - low) * share as f64 / 999.0
        } else {
            share as f64 * 1e-6
        };
    }
    let mut bytes = Vec::new();
    frame.write(&values, &mut bytes);
    bytes
}

/// Values of a frame by their names.
fn values<'a>(frame: &'a Frame, set: &'a FrameSet, bytes: &[u8]) -> Vec<(&'a str, f64)> {
    let mut values = vec![0.0; set.values.len()];
    frame.read(bytes, &mut values);
    frame.fields.iter().map(|field| (set.values[field.slot].name.as_str(), values[field.slot])).collect()
}

const SEEDS: std::ops::Range<u64> = 0..40;

#[test]
fn c_programs_read_the_values_that_the_layout_reads_and_refuse_corrupted_frames() {
    let directory = tempfile::tempdir().unwrap();
    for (name, device) in units() {
        let prefix = prefix(&name);
        std::fs::write(directory.path().join("unit.h"), device.wire(&prefix).header()).unwrap();
        for (_, set) in links(&device) {
            for frame in &set.frames {
                let (mut vectors, mut expected) = (String::new(), String::new());
                for seed in SEEDS {
                    let mut bytes = bytes(frame, set, seed);
                    let is_corrupt = seed % 4 == 3 && !frame.checks.is_empty();
                    if !is_corrupt {
                        _ = writeln!(expected, "0");
                        values(frame, set, &bytes)
                            .iter()
                            .for_each(|(name, value)| _ = writeln!(expected, "{name} {value:.17e}"));
                    } else {
                        let bit = seed as usize * 5 % (8 * frame.checks[0].place.end());
                        bytes[bit / 8] ^= 1 << (bit % 8);
                        _ = writeln!(expected, "refused");
                    }
                    let listed: Vec<String> = bytes.iter().map(u8::to_string).collect();
                    _ = writeln!(vectors, "{{{}}},", listed.join(", "));
                }
                let printed: String = frame
                    .fields
                    .iter()
                    .map(|field| {
                        let name = &set.values[field.slot].name;
                        format!("printf(\"{name} %.17e\\n\", sample.{name});\n")
                    })
                    .collect();
                let (own, length) = (&frame.name, frame.length());
                let program = format!(
                    "#include <stdio.h>\n#include \"unit.h\"\nstatic const uint8_t vectors[][{length}] = {{ {vectors} }};\n\
                     int main(void) {{\n{prefix}_sample sample;\nmemset(&sample, 0, sizeof sample);\n\
                     for (size_t index = 0; index < sizeof vectors / sizeof vectors[0]; index++) {{\n\
                     int result = (int){prefix}_read_{own}(vectors[index], {length}, &sample);\n\
                     if (result) {{ puts(\"refused\"); continue; }}\nputs(\"0\");\n{printed}}}\nreturn 0;\n}}\n"
                );
                let source = directory.path().join("unit.c");
                std::fs::write(&source, program).unwrap();
                let executable = directory.path().join("unit");
                let arguments = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-o"].map(Path::new);
                let arguments = arguments.into_iter().chain([executable.as_path(), &source]).collect::<Vec<_>>();
                let Some(compiled) = run("cc", &arguments) else {
                    return skip("cc is absent; the C headers were not tried");
                };
                assert!(compiled.status.success(), "{name}: {}", text(&compiled));
                let arguments = ["-x", "c++", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"].map(Path::new);
                match run("c++", &arguments.into_iter().chain([source.as_path()]).collect::<Vec<_>>()) {
                    Some(checked) => assert!(checked.status.success(), "{name}: {}", text(&checked)),
                    None => skip("c++ is absent; the headers were not tried with it"),
                }
                let output = Command::new(&executable).output().unwrap();
                let got = String::from_utf8(output.stdout).unwrap();
                let same = |line: &str| {
                    line.split_once(' ').map_or_else(
                        || line.to_owned(),
                        |(name, value)| format!("{name} {}", value.parse::<f64>().unwrap()),
                    )
                };
                let [got, expected] = [got, expected].map(|text| text.lines().map(same).collect::<Vec<_>>());
                assert_eq!(got, expected, "{name} {own}");
            }
        }
    }
}

#[test]
fn tshark_reads_the_values_that_the_layout_reads() {
    let directory = tempfile::tempdir().unwrap();
    for (name, device) in units() {
        let prefix = prefix(&name);
        let dissector = directory.path().join(format!("{prefix}.lua"));
        std::fs::write(&dissector, device.wire(&prefix).dissector()).unwrap();
        for (is_can, set) in links(&device) {
            let (mut packets, mut expected) = (Vec::<Vec<u8>>::new(), Vec::<Vec<(String, f64)>>::new());
            for seed in SEEDS {
                for frame in &set.frames {
                    let bytes = bytes(frame, set, seed);
                    let named = values(frame, set, &bytes);
                    expected.push(named.into_iter().map(|(name, value)| (format!("{prefix}.{name}"), value)).collect());
                    let (id, is_extended) = frame.id.unwrap_or_default();
                    packets.push(if is_can { socketcan(id | u32::from(is_extended) << 31, &bytes) } else { bytes });
                }
            }
            let option = format!("{prefix}.tcp_port:4700");
            let (link, packets, options) = match is_can {
                true => (LINKTYPE_CAN_SOCKETCAN, packets, vec![]),
                // Segments that do not end where frames do.
                false => {
                    let all = packets.concat();
                    let segments: Vec<&[u8]> = all.chunks(all.len() / 7 + 1).collect();
                    (LINKTYPE_RAW, tcp(4700, &segments), vec!["-o", &option])
                }
            };
            let names: Vec<String> = set.values.iter().map(|value| format!("{prefix}.{}", value.name)).collect();
            let good = format!("{prefix}.check_good");
            let fields: Vec<&str> = names.iter().map(String::as_str).chain([good.as_str()]).collect();
            let Some(rows) = dissect_with(&dissector, &pcap(link, &packets), &options, &fields) else {
                return skip(NO_TSHARK);
            };
            for (index, field) in fields.iter().enumerate() {
                let all = rows.iter().filter_map(|row| row.get(index)).flat_map(|own| own.split(','));
                let got: Vec<&str> = all.filter(|text| !text.is_empty()).collect();
                if *field == good {
                    let checks: usize = set.frames.iter().map(|frame| frame.checks.len()).sum();
                    assert_eq!(got, vec!["1"; checks * SEEDS.count()], "{name}");
                    continue;
                }
                let own: Vec<f64> =
                    expected.iter().flatten().filter(|(name, _)| name == field).map(|(_, value)| *value).collect();
                assert_eq!(got.len(), own.len(), "{name} {field}");
                for (got, own) in got.iter().zip(own) {
                    let got: f64 = got.parse().unwrap();
                    assert!((got - own).abs() <= 1e-6 * own.abs().max(1e-9), "{name} {field}: {got}, expected {own}");
                }
            }
        }
    }
}

#[test]
fn cantools_reads_the_values_that_the_layout_reads() {
    let present = run("python3", &["-c", "import cantools"]);
    if !present.is_some_and(|output| output.status.success()) {
        return skip("python3 with cantools is absent; the CAN databases of units were not tried");
    }
    let directory = tempfile::tempdir().unwrap();
    for (name, _) in DEVICES {
        let device = Device::from_name(name).unwrap();
        let Some(can) = &device.can else { continue };
        let database = directory.path().join("unit.dbc");
        std::fs::write(&database, &can.dbc).unwrap();
        let signals = signals(name);
        let (mut lines, mut expected) = (String::new(), Vec::new());
        for frame in &can.frames.frames {
            for seed in SEEDS {
                let bytes = bytes(frame, &can.frames, seed);
                let (id, _) = frame.id.unwrap();
                _ = writeln!(lines, "{id} {}", geu_protocol::hex::hex(&bytes));
                expected.push(values(frame, &can.frames, &bytes));
            }
        }
        let vectors = directory.path().join("vectors.txt");
        std::fs::write(&vectors, lines).unwrap();
        let script = here("tests/describe/unit.py");
        let output =
            run("python3", &[script.as_os_str(), database.as_os_str(), vectors.as_os_str()]).expect("python3 exists");
        assert!(output.status.success(), "{}", text(&output));
        let got = String::from_utf8(output.stdout).unwrap();
        assert_eq!(got.lines().count(), expected.len());
        for (line, expected) in got.lines().zip(expected) {
            for (own, signal) in &signals {
                let Some((_, value)) = expected.iter().find(|(name, _)| name == own) else { continue };
                let mut read = line.split(' ').filter_map(|one| one.split_once('='));
                let (_, read) =
                    read.find(|(name, _)| name == signal).unwrap_or_else(|| panic!("no {signal} in {line}"));
                assert!(
                    (read.parse::<f64>().unwrap() - value).abs() < 1e-9,
                    "{name}: {signal} is {read}, expected {value}"
                );
            }
        }
    }
}

/// Columns of a CAN unit with the signals of its database.
fn signals(name: &str) -> Vec<(&'static str, &'static str)> {
    match name {
        "mm5.10" => vec![("Z_deg_s", "YAW_RATE"), ("X_deg_s", "ROLL_RATE")],
        "openimu300ri" => vec![
            ("Y_deg_s", "PITCH_RATE"),
            ("X_deg_s", "ROLL_RATE"),
            ("Z_deg_s", "YAW_RATE"),
            ("latency_ms", "LATENCY"),
        ],
        _ => panic!("{name}: the signals of this unit are not listed"),
    }
}

/// A unit with fields that XTCE or COSMOS expresses in another way than others.
fn unit_with(frames: &str) -> Device {
    let text = format!(
        "[device]\nname = \"<A & \\\"B\\\">\"\nsource = \"none\"\ninterval_s = 1.0\noutput = \"increment\"\nrange_arcsec_s = 36.0\n\
         [[device.head]]\nname = \"X\"\ninput = [1, 0, 0]\n[device.serial]\n{frames}"
    );
    Device::parse("own.toml", &text, &|_| Err("no file".to_owned())).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn ground_systems_have_a_packet_for_each_frame() {
    for (name, device) in units().into_iter().filter(|(_, device)| device.has_link()) {
        let prefix = prefix(&name);
        let ground = device.wire(&prefix).ground();
        let (xtce, cosmos) = (ground.xtce().unwrap_or_else(|error| panic!("{name}: {error}")), ground.cosmos());
        for frame in links(&device).flat_map(|(_, set)| &set.frames) {
            assert_eq!(xtce.matches(&format!("<SequenceContainer name=\"{}\"", frame.name)).count(), 1, "{name}");
            assert_eq!(
                cosmos.matches(&format!("TELEMETRY {} {} ", prefix.to_uppercase(), frame.name.to_uppercase())).count(),
                1
            );
        }
    }
}

#[test]
fn what_xtce_cannot_express_is_an_error_with_its_place() {
    let parts = "{ head = \"X\", type = \"i16be\", unit = \"arcsec\" }, { type = \"u16le\", parts = [{ value = \"sequence\", first = 4, \
                 length = 8 }, { ignored = 0, first = 0, length = 4 }, { ignored = 0, first = 12, length = 4 }] }, { crc = \"CRC-16/XMODEM\", type = \"u16le\" }";
    let crossing =
        unit_with(&format!("[[device.serial.frame]]\nname = \"F\"\nfields = [{{ constant = \"A5\" }}, {parts}]\n"));
    let ground = crossing.wire("own").ground();
    let error = ground.xtce().unwrap_err();
    assert!(error.starts_with("F, sequence: XTCE expects ") && error.ends_with("from byte 3 on"), "{error}");
    let cosmos = ground.cosmos();
    assert!(cosmos.contains("packet.read('SEQUENCE_PART_0') * 1 + packet.read('SEQUENCE_PART_1') * 16\n"), "{cosmos}");
    assert!(cosmos.contains("CrcProtocol nil false ERROR -16 16 LITTLE_ENDIAN 0x1021 0x0 false false"), "{cosmos}");

    // The second and third frame differ behind a field of the first, the last two behind the end of the first.
    let frame = |name: &str, fields: &str| {
        format!(
            "[[device.serial.frame]]\nname = \"{name}\"\nfields = [{{ constant = \"A5\" }}, {fields}, {{ crc = \"xor\", type = \"u8\" }}]\n"
        )
    };
    let first = frame("A", "{ constant = \"01\" }, { head = \"X\", type = \"i16be\", unit = \"arcsec\" }");
    let other = |name, constant| {
        frame(name, &format!("{{ constant = \"{constant}\" }}, {{ value = \"sensor\", type = \"i16be\" }}"))
    };
    let xtce = unit_with(&(first.clone() + &other("B", "02 01") + &other("C", "02 02"))).wire("own").ground().xtce();
    let xtce = xtce.unwrap();
    assert_eq!(xtce.matches("referenceLocation").count(), 6, "{xtce}");
    assert!(xtce.contains("<LongDescription>&lt;A &amp; 'B'&gt;. Source: none;"), "{xtce}");
    let far = |name, constant| {
        frame(
            name,
            &format!(
                "{{ constant = \"02\" }}, {{ value = \"sensor\", type = \"i32be\" }}, {{ constant = \"{constant}\" }}"
            ),
        )
    };
    let error = unit_with(&(first + &far("D", "03") + &far("E", "04"))).wire("own").ground().xtce().unwrap_err();
    assert_eq!(
        error,
        "E: XTCE expects a constant that distinguishes it from D, within the length of each frame, got none"
    );
}

#[test]
fn containers_of_links_and_frames_have_different_names_in_xtce() {
    let frame = |name: &str, constant: &str, field: &str| {
        format!(
            "[[device.serial.frame]]\nname = \"{name}\"\nfields = [{{ constant = \"{constant}\" }}, {field}, {{ crc = \"xor\", type = \"u8\" }}]\n"
        )
    };
    let head = frame("serial", "A5", "{ head = \"X\", type = \"i16be\", unit = \"arcsec\" }");
    let sensor = frame("serial_2", "A6", "{ value = \"sensor\", type = \"i16be\" }");
    let xtce = unit_with(&(head + &sensor)).wire("own").ground().xtce().unwrap();
    let mut names: Vec<&str> =
        xtce.split("<SequenceContainer name=\"").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
    assert_eq!(names.len(), 3, "{xtce}");
    names.sort_unstable();
    names.dedup();
    assert_eq!(names, ["serial", "serial_2", "serial_2_2"]);
}
