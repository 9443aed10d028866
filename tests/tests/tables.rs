//! Samples in text tables: telemetry of a real gyro in orbit, if present, and tables of described units.

use std::fs;
use std::path::{Path, PathBuf};

use geu_tests::{geu, recordings, root};

/// A unit with the start and trial of each row, and a temperature in some rows.
const DESCRIPTION: &str = r#"
[device]
name = "Rate table"
source = "a test"
interval_s = 1.0
output = "rate"
range_arcsec_s = 36000.0

[[device.head]]
name = "A"
input = [1.0, 0.0, 0.0]

[[device.head]]
name = "B"
input = [0.0, 1.0, 0.0]

[device.table]
delimiter = ";"
time = { column = "to [ms]", unit = "ms" }
start = { column = "from [ms]", unit = "ms" }
group = "trial"
fields = [
  { column = "b", head = "B", unit = "rad/s", scale = -1e-3 },
  { column = "a", head = "A", unit = "deg/s" },
  { column = "temp", head = "A", of = "temperature", offset = 1.0 },
]

[device.table.reference]
group = "day"
magnitude = { column = "m", unit = "rad/s" }
rates.A = { column = "wa", unit = "deg/h" }
rates.B = { column = "wb", unit = "arcsec/s" }
"#;

/// Standard output, standard error and exit code of `geu decode`.
fn decode(device: &Path, file: &Path, more: &[&str]) -> (String, String, Option<i32>) {
    let output = geu().arg("decode").arg(file).arg("--device").arg(device).args(more).output().expect("geu starts");
    let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
    (text(output.stdout), text(output.stderr), output.status.code())
}

/// A directory with a description and a table.
fn written(description: &str, table: &str) -> (tempfile::TempDir, PathBuf, PathBuf) {
    let directory = tempfile::tempdir().expect("a directory");
    let (device, file) = (directory.path().join("unit.toml"), directory.path().join("table.csv"));
    fs::write(&device, description).expect("written");
    fs::write(&file, table).expect("written");
    (directory, device, file)
}

/// Kinds of defects with their lines.
fn kinds(defects: &str) -> Vec<(String, String)> {
    let quoted = |line: &str, place| line.split('"').nth(place).expect("quoted").to_owned();
    let line = |place: String| place.rsplit(':').next().expect("a line").to_owned();
    defects.lines().map(|own| (line(quoted(own, 3)), quoted(own, 7))).collect()
}

#[test]
fn real_telemetry_is_read_with_its_faults() {
    let Some(directory) = recordings("suchai3") else { return };
    // Number of rows as the telemetry's README states it; steps of time counted by another program (Python's csv module).
    for (day, rows, faults) in [
        ("20230824", 5586, &[("time-gap", 5)][..]),
        ("20230904", 5349, &[("time-gap", 8), ("time-repeated", 2), ("time-backwards", 2)]),
        ("20231113", 1000, &[("time-gap", 1), ("time-backwards", 1)]),
        ("20231211", 2001, &[("time-gap", 2), ("time-repeated", 1)]),
    ] {
        let file = directory.join(format!("suchai3_{day}.csv"));
        let (text, summary, code) = decode(Path::new("suchai3"), &file, &[]);
        assert_eq!(code, Some(0), "{summary}");
        assert!(summary.contains("accounts for all"), "{summary}");
        let names: Vec<&str> = text.lines().next().expect("a header").split(',').collect();
        assert_eq!(names, ["t_s", "number", "X_deg_s", "Y_deg_s", "Z_deg_s"]);
        let counted: Vec<String> = summary.lines().filter_map(|line| line.strip_prefix("defect-")).map(words).collect();
        assert_eq!(counted, faults.iter().map(|(kind, count)| format!("{kind} {count}")).collect::<Vec<_>>(), "{day}");
        // Tumbling at 25 to 57 deg/s.
        let rates = text.lines().skip(1).map(|line| {
            let rates = line.split(',').skip(2).map(|rate| rate.parse::<f64>().expect("a rate"));
            rates.map(|rate| rate * rate).sum::<f64>().sqrt()
        });
        let rates: Vec<f64> = rates.collect();
        let mean = rates.iter().sum::<f64>() / rows as f64;
        assert!(rates.len() == rows && (24.5..57.5).contains(&mean), "{day}: {mean} deg/s");
    }
}

fn words(line: &str) -> String {
    line.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn a_table_is_decoded_as_frames_are() {
    let header = "sat_index,timestamp_s,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb";
    // A row stamped again, two rows 100 s ahead, a word, a short row, a header again.
    let rows = "1,1000.0,-1456,0,1\n2,1001.0,-1456,0,1\n2,1001.0,-1456,0,1\n3,1102.0,0,0,1\n4,1103.0,0,0,1\n\
                5,1004.0,0,x,1\n6,1005.0,0\nsat_index,timestamp_s,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb\n7,1006.0,0,0,1\n";
    let (directory, _, file) = written("", &format!("{header}\n{rows}"));
    let defects = directory.path().join("defects.jsonl");
    let suchai3 = Path::new("suchai3");
    let (text, summary, code) = decode(suchai3, &file, &["--strict", "--defects", defects.to_str().expect("UTF-8")]);
    assert_eq!(code, Some(1), "{summary}");
    let numbers: Vec<&str> = text.lines().skip(1).map(|line| line.split(',').nth(1).expect("a number")).collect();
    // The rows ahead are no missing samples: their time returns.
    assert_eq!(numbers, ["0", "1", "1", "102", "103", "4", "6"]);
    assert!(text.starts_with("t_s,number,X_deg_s,Y_deg_s,Z_deg_s\n1000.000000,0,-10,0,0.00686"), "{text}");
    assert!(text.contains("1004.000000,4,0,,0.00686"), "{text}");
    let reported = fs::read_to_string(&defects).expect("written");
    let expected = [
        ("4", "time-repeated"),
        ("5", "time-gap"),
        ("7", "bad-cell"),
        ("7", "time-backwards"),
        ("8", "bad-row"),
        ("9", "bad-row"),
        ("10", "time-gap"),
    ];
    assert_eq!(kinds(&reported), expected.map(|(line, kind)| (line.to_owned(), kind.to_owned())), "{reported}");
    assert!(reported.contains(r#""text":"gyro_y_lsb: x""#), "{reported}");
    assert!(summary.contains("samples-lost             1\n") && summary.contains("accounts for all"), "{summary}");

    let (summary, _, code) = decode(suchai3, &file, &["--format", "summary"]);
    assert!(code == Some(0) && words(&summary).contains("rows 7") && summary.contains("bad-row"), "{summary}");
    let (jsonl, ..) = decode(suchai3, &file, &["--format", "jsonl", "-q"]);
    assert!(jsonl.starts_with("{\"t_s\":1000.000000,\"number\":0,\"X_deg_s\":-10,\"Y_deg_s\":0,"), "{jsonl}");
    let output = geu().args(["decode", "-q", "--gyro-csv", "suchai3"]).arg(&file).output().expect("geu starts");
    assert_eq!(String::from_utf8(output.stdout).expect("UTF-8"), text);
}

#[test]
fn rows_have_their_own_times_trials_and_units() {
    let table = "\u{feff}# made by a test\r\n#trial;temp;\"from [ms]\";to [ms];a;b;\"note; more\"\r\n\
                 one;20;0;250.5;3;1;\r\none;;250.5;1000;\"4\";1;\"x;y\"\r\none;;1000;9000;;;\r\none;;3000;4000;5;1;\r\n\
                 two;;0;1000;6;1;\r\ntwo;;2000;1500;6;1;\r\ntwo;;1000;1e4;6;1;\r\n";
    let (_directory, device, file) = written(DESCRIPTION, table);
    let (text, summary, code) = decode(&device, &file, &["--defects", "/dev/stdout"]);
    assert_eq!(code, Some(0), "{summary}");
    let (defects, rows): (Vec<&str>, Vec<&str>) = text.lines().partition(|line| line.starts_with('{'));
    let expected = [
        "t_s,number,B_rad_s,A_deg_s,A_temperature_c,start_s,group",
        "0.250500,0,-0.001,3,21,0.000000,one",
        "1.000000,1,-0.001,4,,0.250500,one",
        // The row without outputs is a remark; two samples are missing.
        "4.000000,4,-0.001,5,,3.000000,one",
        "1.000000,0,-0.001,6,,0.000000,two",
        "10.000000000,1,-0.001,6,,1.000000,two",
    ];
    assert_eq!(rows, expected, "{summary}");
    let found = kinds(&defects.join("\n"));
    assert_eq!(found, [("6", "time-gap"), ("8", "bad-row")].map(|(line, kind)| (line.to_owned(), kind.to_owned())));
    assert!(summary.contains("records-remark           3\n") && summary.contains("accounts for all"), "{summary}");
}

#[test]
fn a_table_without_the_columns_is_refused() {
    let (_directory, device, file) = written(DESCRIPTION, "to [ms];a;b\n1;2;3\n");
    let (text, message, code) = decode(&device, &file, &[]);
    assert_eq!((text.as_str(), code), ("", Some(2)));
    let expected =
        "line 1: expected the columns to [ms], from [ms], trial, b, a, temp, separated by ';', got \"to [ms];a;b\"";
    assert!(message.contains(expected), "{message}");
    for (from, to, part) in [
        ("time = {", "times = {", "did you mean `time`?"),
        (
            "time = { column = \"to [ms]\", unit = \"ms\" }",
            "",
            "expected `device.table.time`, { column = TEXT, unit = UNIT }",
        ),
        ("unit = \"ms\" }\nstart", "unit = \"h\" }\nstart", "of s, ms, us, ns"),
        ("column = \"a\", ", "", "expected a text for `device.table.fields.1.column`, got nothing"),
        ("delimiter = \";\"", "delimiter = \"x\"", "device.table.delimiter"),
        ("head = \"A\", unit", "head = \"B\", unit", "expected the unit of the other field, for the column B_rad_s"),
        ("unit = \"deg/s\" }", "unit = \"deg/s\", type = \"i8\", scale = 0.01 }", "the range of the unit"),
        ("[device.table]", "[device.tables]", "did you mean `table`?"),
        ("reference]", "refrence]", "did you mean `reference`?"),
        ("group = \"day\"", "groups = \"day\"", "did you mean `group`?"),
        (
            "magnitude = { column = \"m\", unit = \"rad/s\" }",
            "",
            "expected `device.table.reference.magnitude`, { column = TEXT",
        ),
        ("unit = \"rad/s\" }\nrates", "unit = \"rad\" }\nrates", "did you mean `rad/s`?"),
        ("rates.A = { column = \"wa\", unit = \"deg/h\" }\n", "", "expected `device.table.reference.rates.A`"),
        ("rates.B", "rates.C", "expected one of: A, B"),
    ] {
        fs::write(&device, DESCRIPTION.replace(from, to)).expect("written");
        let output = geu().args(["device", "check"]).arg(&device).output().expect("geu starts");
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && message.contains(part), "{part} not in {message}");
    }
}

#[test]
fn a_unit_with_a_table_alone_has_no_link() {
    for arguments in [
        &["run", "--device", "suchai3", "--duration", "1"][..],
        &["simulate", "--device", "suchai3", "--duration", "1", "--out", "none"],
        &["describe", "header", "--device", "suchai3"],
    ] {
        let output = geu().args(arguments).output().expect("geu starts");
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && message.contains("expected a unit with a link"), "{message}");
    }
    let output = geu().args(["device", "show", "suchai3"]).output().expect("geu starts");
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    assert!(text.contains("column gyro_x_lsb") && text.contains("X_deg_s = number × 0.00686"), "{text}");
}

#[test]
fn a_table_beside_a_link_is_known_by_its_header() {
    let table = "[device.table]\ntime = { column = \"t\", unit = \"us\" }\nfields = [{ column = \"n\", value = \"sequence\" }, \
                 { column = \"x\", head = \"X\", unit = \"deg/s\" }, { column = \"y\", head = \"Y\", unit = \"deg/s\" }, \
                 { column = \"z\", head = \"Z\", unit = \"deg/s\" }]\n";
    let stim300 = fs::read_to_string(root().join("configs/devices/stim300.toml")).expect("it ships");
    let rows = "t,n,x,y,z\n500,7,1,2,3\n1000,8,1,2,3\n2500,11,1,2,3\n";
    let (directory, device, file) = written(&format!("{stim300}\n{table}"), rows);
    let (text, summary, code) = decode(&device, &file, &[]);
    assert_eq!(code, Some(0), "{summary}");
    let numbers: Vec<&str> = text.lines().skip(1).map(|line| &line[..line.find(",1,2,3").expect("rates")]).collect();
    assert_eq!(numbers, ["0.000500,0", "0.001000,1", "0.002500,4"]);
    assert!(summary.contains("defect-sequence-gap") && summary.contains("table\n"), "{summary}");
    let simulated = directory.path().join("run");
    let mut simulate = geu();
    simulate.args(["simulate", "--duration", "1", "--device"]).arg(&device).arg("--out").arg(&simulated);
    assert!(simulate.status().expect("geu starts").success());
    let (_, summary, code) = decode(&device, &simulated.join("link.bin"), &["--format", "summary"]);
    assert!(code == Some(0) && summary.is_empty(), "{summary}");
}
