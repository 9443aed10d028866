//! Several threads decode to the bytes of one.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use geu_protocol::{CLOCK_PER_SAMPLE, CanIdMap, Sample};
use geu_tests::geu;

/// More than the megabyte from which captures are read by several threads.
const SAMPLES: u64 = 40_000;

/// A log with everything that may happen at the boundary of two parts: lost, damaged and foreign frames, two interfaces, lines of
/// all lengths, remarks, a cut end.
fn log() -> String {
    let (plan, mut log) = (CanIdMap::default(), "\u{feff}".to_owned());
    for index in 0..SAMPLES {
        let sample = Sample {
            sequence: index as u16,
            increments: [(index % 4001) as i16 - 2000, -(index as i16 % 77), 5, i16::MIN],
            gyro_flags: if index % 1001 == 0 { 0x8E } else { 0x0F },
            unit_flags: 7,
            electronics_centi_c: 2_000,
            clock_count: (index + 1) * CLOCK_PER_SAMPLE,
            sensor_centi_c: 7_000,
        };
        for (part, frame) in plan.frames(&sample).into_iter().enumerate() {
            let (t_us, interface) = (index * 500_000 + 900, if index % 5003 == 77 { "can11" } else { "can0" });
            let mut line = format!("({}.{:06}) {interface} {:03X}#", t_us / 1_000_000, t_us % 1_000_000, frame.id());
            for byte in frame.data() {
                let byte = if index % 1511 == 5 && part == 1 { byte ^ 1 } else { *byte };
                write!(line, "{byte:02X}").expect("memory");
            }
            let end = if index % 333 == 1 { " R\r\n" } else { "\n" };
            if index % 997 != 3 || part != 1 {
                log += &(line + end);
            }
        }
        match index {
            _ if index % 701 == 0 => log += "# a remark\n\nDROPCOUNT: dropped 3 CAN frames\n",
            _ if index % 809 == 0 => log += "(1.5) can0 1A0#XY\n(1.5) can0 123#R\n",
            12_000 => log += &("x".repeat(100_000) + "\n"),
            20_000 => log += &("y".repeat(700_000) + "\n"),
            _ => {}
        }
    }
    log + "(99999999.5) can0 1A0#00"
}

/// Standard output, defects and summary.
fn decoded(directory: &Path, threads: &str, arguments: &[&str]) -> (Vec<u8>, Vec<u8>, String) {
    let defects = directory.join("defects.jsonl");
    let mut command = geu();
    command.env("RAYON_NUM_THREADS", threads).arg("decode").arg("--defects").arg(&defects).args(arguments);
    let output = command.output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let defects = fs::read(defects).expect("defects");
    (output.stdout, defects, String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn a_log_decoded_by_several_threads_gives_the_bytes_of_one() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("link.log");
    fs::write(&path, log()).expect("a log");
    let log = path.to_string_lossy();
    for format in ["csv", "jsonl", "summary"] {
        // The same log twice: the state continues from one input to the next.
        let arguments = ["--format", format, &log, &log];
        let one = decoded(directory.path(), "1", &arguments);
        assert!(one.2.contains("accounts for all") || format == "summary", "{}", one.2);
        assert!(format == "summary" || one.0.split(|&byte| byte == b'\n').count() as u64 > SAMPLES, "rows");
        assert!(one.1.split(|&byte| byte == b'\n').count() > 100, "defects");
        for threads in ["2", "5"] {
            assert!(decoded(directory.path(), threads, &arguments) == one, "{format} with {threads} threads");
        }
    }
}

#[test]
fn a_described_unit_decoded_by_several_threads_gives_the_bytes_of_one() {
    let directory = tempfile::tempdir().expect("a directory");
    let run = directory.path().join("run");
    let mut simulate = geu();
    simulate.args(["simulate", "--device", "mm5.10", "--duration", "400", "--out"]).arg(&run);
    assert!(simulate.output().expect("geu starts").status.success());
    let link = run.join("link.log");
    let arguments = ["--device", "mm5.10", &link.to_string_lossy()];
    let one = decoded(directory.path(), "1", &arguments);
    assert!(one.0.len() > 1 << 20, "rows");
    assert!(decoded(directory.path(), "3", &arguments) == one);
}
