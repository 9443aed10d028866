//! Units from descriptions: bytes of an encoder of its own, decoded by `geu decode --device`.

use std::fs;
use std::path::Path;

use geu_tests::{geu, root};

/// CRC, bit by bit, most significant bit first.
fn crc(width: u32, polynomial: u32, initial: u32, bytes: impl IntoIterator<Item = u8>) -> u32 {
    let top = 1u32 << (width - 1);
    bytes.into_iter().fold(initial, |crc, byte| {
        (0..8).fold(crc ^ u32::from(byte) << (width - 8), |crc, _| match crc & top {
            0 => crc << 1,
            _ => crc << 1 ^ polynomial,
        }) & (u32::MAX >> (32 - width))
    })
}

fn crc32(bytes: &[u8], zeros: usize) -> [u8; 4] {
    crc(32, 0x04C1_1DB7, u32::MAX, bytes.iter().copied().chain(std::iter::repeat_n(0, zeros))).to_be_bytes()
}

fn i24(number: i32) -> [u8; 3] {
    let [_, a, b, c] = number.to_be_bytes();
    [a, b, c]
}

/// Datagram 94 of a STIM300: rates in 2⁻¹⁴ °/s, temperatures in 1/256 °C.
fn stim300(sample: u32, rates: [i32; 3]) -> Vec<u8> {
    let mut bytes = vec![0x94];
    rates.iter().for_each(|rate| bytes.extend(i24(*rate)));
    bytes.push(if sample % 100 == 7 { 0b1_0001 } else { 0 });
    [5632i16, 5888, -256].iter().for_each(|temperature| bytes.extend(temperature.to_be_bytes()));
    bytes.extend([0, sample as u8, 1, 0xFA]);
    bytes.extend(crc32(&bytes, 3));
    bytes
}

/// Message A of a KVH 1750: angles in rad.
fn kvh(sample: u32, angles: [f32; 3]) -> Vec<u8> {
    let mut bytes = vec![0xFE, 0x81, 0xFF, 0x55];
    angles.iter().chain(&[0.1, -0.2, 1.0]).for_each(|number| bytes.extend(number.to_be_bytes()));
    bytes.extend([0x77, (sample % 128) as u8, 0, 40]);
    bytes.extend(crc32(&bytes, 0));
    bytes
}

/// `geu decode` of a file; rows without the header, and the summary.
fn decode(device: &str, file: &Path) -> (Vec<Vec<String>>, Vec<String>, String) {
    let output = geu().args(["decode", "--device", device]).arg(file).output().expect("geu starts");
    let summary = String::from_utf8(output.stderr).expect("UTF-8");
    assert!(output.status.success(), "{summary}");
    assert!(summary.contains("accounts for all"), "{summary}");
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let header = lines.next().expect("a header");
    (lines.collect(), header, summary)
}

fn column(header: &[String], name: &str) -> usize {
    header.iter().position(|own| own == name).unwrap_or_else(|| panic!("no {name} in {header:?}"))
}

fn value(summary: &str, name: &str) -> String {
    let line = summary.lines().find(|line| line.split_whitespace().next() == Some(name));
    line.map_or_else(|| panic!("no {name} in {summary}"), |line| line[name.len()..].trim().to_owned())
}

#[test]
fn datagrams_of_a_stim300_are_read_exactly_and_corrupted_ones_never() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("stim300.bin");
    let rate =
        |sample: u32, axis: i32| (sample as i32 * 7919 * (axis + 1)) % 6_553_600 * if axis == 1 { -1 } else { 1 };
    let rates = |sample: u32| [0, 1, 2].map(|axis| rate(sample, axis));
    // A thousand of ten thousand datagrams have a bit flipped, at every place in turn, and a few are missing.
    let (mut bytes, mut sent) = (vec![0x94, 0x00, 0x12], Vec::new());
    for sample in (0..10_000).filter(|sample| !(4000..4003).contains(sample)) {
        let mut datagram = stim300(sample, rates(sample));
        if sample % 10 == 5 {
            let bit = (sample as usize / 10) % (8 * datagram.len());
            datagram[bit / 8] ^= 1 << (bit % 8);
        } else {
            sent.push(sample);
        }
        bytes.extend(datagram);
    }
    fs::write(&file, &bytes).expect("a file");
    let (rows, header, summary) = decode("stim300", &file);
    assert_eq!(rows.len(), sent.len(), "{summary}");
    let [x, y, z, number, sequence, valid, overload, temperature, latency] = [
        "X_deg_s",
        "Y_deg_s",
        "Z_deg_s",
        "number",
        "sequence",
        "X_valid",
        "status_overload",
        "Z_temperature_c",
        "latency_us",
    ]
    .map(|name| column(&header, name));
    for (row, sample) in rows.iter().zip(&sent) {
        for (place, rate) in [x, y, z].into_iter().zip(rates(*sample)) {
            assert_eq!(row[place].parse::<f64>(), Ok(f64::from(rate) / 16384.0), "{row:?}");
        }
        assert_eq!((&*row[number], &*row[sequence]), (&*sample.to_string(), &*(sample % 256).to_string()));
        let is_over = if sample % 100 == 7 { ["0", "1"] } else { ["1", "0"] };
        assert_eq!([&*row[valid], &*row[overload]], is_over);
        assert_eq!([&*row[temperature], &*row[latency]], ["-1", "506"]);
    }
    assert_eq!(value(&summary, "samples-lost"), "1003", "{summary}");
    assert_eq!(value(&summary, "not-valid"), "X 100 Y 0 Z 0");
    assert_eq!(rows[1][0], "0.000500000", "without receive times a row has the time of its number");
}

#[test]
fn increments_in_floating_point_are_read_exactly() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("kvh.bin");
    let angle = |sample: u32, axis: u32| ((sample * 31 + axis * 7) as f32 * 1e-3).sin() * 1e-3;
    let angles = |sample: u32| [0, 1, 2].map(|axis| angle(sample, axis));
    let bytes: Vec<u8> = (0..2000).flat_map(|sample| kvh(sample, angles(sample))).collect();
    fs::write(&file, &bytes).expect("a file");
    let (rows, header, summary) = decode("kvh-1750", &file);
    assert_eq!((rows.len(), value(&summary, "defects")), (2000, "0".to_owned()), "{summary}");
    let places = ["X_rad", "Y_rad", "Z_rad"].map(|name| column(&header, name));
    for (sample, row) in (0..).zip(&rows) {
        let read = places.map(|place| row[place].parse::<f64>().expect("a number") as f32);
        assert_eq!(read, angles(sample));
    }
}

#[test]
fn messages_of_a_can_unit_make_samples_on_the_interface_that_has_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("link.log");
    let message = |id: u32, number: u16, status: u8, sample: u32| {
        let [low, high] = number.to_le_bytes();
        let mut bytes = vec![low, high, status << 4, 0xFF, 0, 0x80, (sample % 16) as u8];
        bytes.push(crc(8, 0x1D, 0xFF, bytes.iter().copied()) as u8 ^ 0xFF);
        let hex: String = bytes.iter().map(|byte| format!("{byte:02X}")).collect();
        (format!("{id:03X}"), hex)
    };
    let yaw = |sample: u32| (sample * 131 % 65_536) as u16;
    // The roll rate of a sample: the number, and its text.
    let roll = |sample: u32| (0x8000 + 200 * (sample % 50) as u16, format!("{}", sample % 50));
    let mut text = String::new();
    // Twenty samples more are missing than the counter of 16 shows.
    for sample in (0..1000u32).filter(|sample| !(700..720).contains(sample)) {
        let t_s = 1_700_000_000.0 + f64::from(sample) * 0.01;
        let status = if sample % 50 == 3 { 2 } else { 0 };
        let (first, second) = (message(0x174, yaw(sample), status, sample), message(0x178, roll(sample).0, 0, sample));
        text += &format!("({t_s:.6}) vcan1 {}#{}\n", first.0, first.1);
        text += &format!("({t_s:.6}) vcan1 123#00\n");
        if sample == 600 {
            text = text[..text.rfind("(").expect("a line")].to_owned();
            text = text[..text.rfind("(").expect("a line")].to_owned();
        }
        match sample {
            // A missing message, a wrong check, a wrong length.
            200 => {}
            300 => text += &format!("({t_s:.6}) vcan1 {}#{}00\n", second.0, &second.1[..14]),
            400 => text += &format!("({t_s:.6}) vcan1 {}#{}\n", second.0, &second.1[..14]),
            _ => text += &format!("({t_s:.6}) vcan1 {}#{}\n", second.0, second.1),
        }
        text += &format!("({t_s:.6}) vcan0 {}#{}\n", first.0, first.1);
    }
    fs::write(&file, &text).expect("a file");
    let (rows, header, summary) = decode("mm5.10", &file);
    let expected: Vec<u32> =
        (0..1000).filter(|sample| ![200, 300, 400, 600].contains(sample) && !(700..720).contains(sample)).collect();
    assert_eq!(rows.len(), expected.len(), "{summary}");
    let [z, valid, number] = ["Z_deg_s", "Z_valid", "number"].map(|name| column(&header, name));
    let second = column(&header, "X_deg_s");
    assert!(rows.iter().zip(&expected).all(|(row, sample)| row[second] == roll(*sample).1), "messages of one sample");
    for (row, sample) in rows.iter().zip(&expected) {
        let rate = (f64::from(yaw(*sample)) - 32_768.0) * 0.005;
        assert!((row[z].parse::<f64>().expect("a number") - rate).abs() < 1e-9, "{row:?}, expected {rate}");
        assert_eq!(&*row[valid], if sample % 50 == 3 { "0" } else { "1" });
        assert_eq!(row[number], sample.to_string());
    }
    for (name, expected) in [
        ("defect-incomplete-sample", "4"),
        ("defect-check-mismatch", "1"),
        ("defect-wrong-length", "1"),
        ("samples-lost", "24"),
        ("records-other-traffic", "979"),
        ("records-other-interface", "980"),
        ("interface", "vcan1"),
    ] {
        assert_eq!(value(&summary, name), expected, "{name} in {summary}");
    }
}

#[test]
fn a_description_of_the_default_unit_reads_its_bytes_as_the_default_decoder_does() {
    let folder = tempfile::tempdir().expect("a folder");
    let device = folder.path().join("unit.toml");
    let heads =
        [("GYRX", "1.0, 0.0, 0.0"), ("GYRY", "0.0, 1.0, 0.0"), ("GYRZA", "0.0, 0.0, 1.0"), ("GYRZB", "0.0, 0.0, 1.0")];
    let own = heads.map(|(name, input)| format!("[[device.head]]\nname = \"{name}\"\ninput = [{input}]\n")).concat();
    let fields =
        heads.map(|(name, _)| format!("  {{ head = \"{name}\", type = \"i16be\", unit = \"arcsec\" }},\n")).concat();
    let text = format!(
        "[device]\nname = \"unit\"\nsource = \"its interface control document\"\ninterval_s = 0.5\noutput = \"increment\"\n\
         range_arcsec_s = 65534.0\n{own}[device.serial]\n[[device.serial.frame]]\nname = \"DATA\"\nfields = [\n\
         {{ constant = \"EB 90 01 16\" }},\n{{ value = \"sequence\", type = \"u16be\" }},\n{fields}\
         {{ bits = {{ GYRX_valid = 0, GYRX_saturated = 4 }}, type = \"u8\" }},\n{{ bits = {{ heater_in_band = 0 }}, type = \"u8\" }},\n\
         {{ value = \"electronics\", type = \"i16be\", scale = 0.01 }},\n{{ value = \"clock_count\", type = \"u48be\" }},\n\
         {{ value = \"sensor\", type = \"i16be\", scale = 0.01 }},\n{{ crc = \"CRC-16/IBM-3740\", type = \"u16be\", from = 2 }},\n]\n"
    );
    fs::write(&device, text).expect("a file");
    let out = folder.path().join("run");
    let simulated = geu().args(["simulate", "--duration", "120", "--wire", "serial", "--out"]).arg(&out).output();
    assert!(simulated.expect("geu starts").status.success());
    let (rows, header, _) = decode(device.to_str().expect("UTF-8"), &out.join("link.bin"));
    let plain = geu().args(["decode"]).arg(out.join("link.bin")).output().expect("geu starts");
    let plain = String::from_utf8(plain.stdout).expect("UTF-8");
    let mut lines = plain.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let plain_header = lines.next().expect("a header");
    let plain: Vec<_> = lines.collect();
    assert_eq!((rows.len(), plain.len()), (240, 240));
    for (name, own) in [
        ("sequence", "sequence"),
        ("gyrx", "GYRX_arcsec"),
        ("gyry", "GYRY_arcsec"),
        ("gyrza", "GYRZA_arcsec"),
        ("gyrzb", "GYRZB_arcsec"),
        ("clock_count", "clock_count"),
        ("electronics_c", "electronics_c"),
        ("sensor_c", "sensor_c"),
    ] {
        let (own, name) = (column(&header, own), column(&plain_header, name));
        for (row, plain) in rows.iter().zip(&plain) {
            assert_eq!(row[own].parse::<f64>(), plain[name].parse::<f64>());
        }
    }
}

#[test]
fn a_description_is_shown_as_it_can_be_read_again() {
    let run = |arguments: &[&str]| geu().arg("device").args(arguments).output().expect("geu starts");
    let list = String::from_utf8(run(&["list"]).stdout).expect("UTF-8");
    let names: Vec<&str> = list.lines().filter_map(|line| line.split_whitespace().next()).collect();
    assert!(names.contains(&"iras") && names.contains(&"stim300") && names.contains(&"tetrad"), "{list}");
    let pages = fs::read_dir(root().join("docs/devices")).expect("a folder");
    let pages = pages.map(|page| fs::read_to_string(page.expect("a page").path()).expect("a page")).collect::<Vec<_>>();
    let table = fs::read_to_string(root().join("docs/devices.md")).expect("a page");
    for name in names.iter().filter(|name| **name != "iras") {
        assert!(table.contains(&format!("| `{name}` |")), "{name} is not in docs/devices.md");
        let unit = String::from_utf8(run(&["show", name]).stdout).expect("UTF-8");
        let unit = unit.lines().next().and_then(|line| line.split_once(' ')).expect("a name").1.trim();
        let title = format!("# {}\n", unit.split(',').next().unwrap_or(unit).trim_end_matches(" IMU"));
        let has_page = |page: &String| page.starts_with(&title) || page.starts_with(&title.replace('\n', " IMU\n"));
        assert!(pages.iter().any(has_page), "{name}: no page begins with {title}");
    }
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["stim300", "kvh-1750", "tetrad"] {
        let text = run(&["show", name, "--toml"]).stdout;
        let file = folder.path().join(format!("{name}.toml"));
        fs::write(&file, text).expect("a file");
        let checked = run(&["check", file.to_str().expect("UTF-8")]);
        assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stderr));
        let shown = String::from_utf8(run(&["show", file.to_str().expect("UTF-8")]).stdout).expect("UTF-8");
        assert_eq!(shown, String::from_utf8(run(&["show", name]).stdout).expect("UTF-8"));
    }
    let unknown = run(&["show", "stim30"]);
    assert_eq!(unknown.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&unknown.stderr).contains("did you mean `stim300`?"));
}

#[test]
fn a_database_may_be_in_windows_encoding_and_no_file_is_read_without_end() {
    let run = |arguments: &[&str]| geu().arg("device").args(arguments).output().expect("geu starts");
    let folder = tempfile::tempdir().expect("a folder");
    let shown = String::from_utf8(run(&["show", "mm5.10", "--toml"]).stdout).expect("UTF-8");
    let (file, database) = (folder.path().join("own.toml"), folder.path().join("mm5.10.dbc"));
    fs::write(&file, shown).expect("a file");
    let mut text = geu().args(["describe", "dbc", "--device", "mm5.10"]).output().expect("geu starts").stdout;
    text.extend(b"\nCM_ \"rates in \xB0/s\";\n");
    fs::write(&database, &text).expect("a file");
    let check = || run(&["check", file.to_str().expect("UTF-8")]);
    assert!(check().status.success(), "{}", String::from_utf8_lossy(&check().stderr));
    fs::write(&database, vec![b'x'; 17 << 20]).expect("a file");
    let error = String::from_utf8(check().stderr).expect("UTF-8");
    assert!(error.contains("expected at most") && error.contains("device.can.dbc"), "{error}");
    fs::remove_file(&database).expect("a file");
    nix::unistd::mkfifo(&database, nix::sys::stat::Mode::S_IRWXU).expect("a FIFO");
    assert!(String::from_utf8_lossy(&check().stderr).contains("not a regular file"));
    let shown = run(&["show", "--toml", database.to_str().expect("UTF-8")]);
    assert!(String::from_utf8_lossy(&shown.stderr).contains("not a regular file"));
    fs::write(&file, b"[device]\nname = \"\xB0\"\n").expect("a file");
    assert!(String::from_utf8_lossy(&check().stderr).contains("expected UTF-8"));
}

#[test]
fn a_unit_with_both_links_has_the_same_columns_on_each_and_may_change_its_interface_between_inputs() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, bytes: &[u8]| {
        let file = folder.path().join(name);
        fs::write(&file, bytes).expect("a file");
        file.to_str().expect("UTF-8").to_owned()
    };
    write("unit.dbc", b"VERSION \"\"\nBU_: U\nBO_ 291 DATA: 4 U\n SG_ RATE : 0|16@1- (0.01,0) [0|0] \"deg/s\" U\n SG_ COUNTER : 16|8@1+ (1,0) [0|0] \"\" U\n SG_ FLAGS : 24|8@1+ (1,0) [0|0] \"\" U\n");
    let device = write(
        "unit.toml",
        br#"[device]
name = "both"
source = "none"
interval_s = 0.01
output = "rate"
range_arcsec_s = 36000.0
[[device.head]]
name = "X"
input = [1, 0, 0]
[device.serial]
[[device.serial.frame]]
name = "S"
fields = [{ constant = "A5" }, { head = "X", type = "i16be", unit = "deg/s", scale = 0.01 }, { crc = "CRC-16/XMODEM", type = "u16be" }]
[device.can]
dbc = "unit.dbc"
[device.can.signals]
"DATA.RATE" = { head = "X", unit = "deg/s" }
"DATA.COUNTER" = { value = "sequence" }
"DATA.FLAGS" = { bits = { X_valid = 0, busy = 1 } }
"#,
    );
    let serial = (-10..10i16).flat_map(|number| {
        let mut frame = vec![0xA5];
        frame.extend((10 * number).to_be_bytes());
        frame.extend((crc(16, 0x1021, 0, frame.iter().copied()) as u16).to_be_bytes());
        frame
    });
    let serial = write("link.bin", &serial.collect::<Vec<u8>>());
    let can = |interface: &str, samples: std::ops::Range<u32>| -> String {
        let line = |sample: u32| {
            let [low, high] = (10 * sample as u16).to_le_bytes();
            let t_s = 1000.0 + 0.01 * f64::from(sample);
            format!("({t_s:.6}) {interface} 123#{low:02X}{high:02X}{sample:02X}03\n")
        };
        samples.map(line).collect()
    };
    let inputs = [write("1.log", can("can0", 0..10).as_bytes()), write("2.log", can("vcan3", 10..20).as_bytes())];
    let (rows, header, _) = decode(&device, Path::new(&serial));
    assert_eq!(header, ["t_s", "number", "X_deg_s", "sequence", "X_valid", "status_busy"]);
    assert_eq!(rows.len(), 20);
    assert_eq!(rows[19], ["0.190000000", "19", "0.9", "", "", ""]);
    let output = geu().args(["decode", "--device", &device]).args(&inputs).output().expect("geu starts");
    let (text, summary) =
        (String::from_utf8(output.stdout).expect("UTF-8"), String::from_utf8(output.stderr).expect("UTF-8"));
    assert_eq!(text.lines().count(), 21, "{summary}");
    assert_eq!(text.lines().last(), Some("1000.190000,19,1.9,19,1,1"));
    assert!(summary.contains("accounts for all") && value(&summary, "interface") == "can0, vcan3", "{summary}");
    assert_eq!([value(&summary, "samples-lost"), value(&summary, "frames-DATA")], ["0", "20"]);
}

#[test]
fn send_refuses_a_unit_without_commands_with_the_reason() {
    for (arguments, reason) in [
        (&["send", "/tmp/geu0", "PING", "--device", "stim300"][..], "would have to list commands"),
        (&["send", "/tmp/geu0", "PING", "--device", "stim30"], "did you mean `stim300`"),
    ] {
        let output = geu().args(arguments).output().expect("geu starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains(reason), "{arguments:?}: {said}");
    }
}
