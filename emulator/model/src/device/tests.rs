//! Valid descriptions, and the messages on others.

use geu_protocol::layout::Quantity;

use super::*;

#[test]
fn every_known_description_is_right() {
    for (name, text) in DEVICES {
        let device = Device::from_name(name).unwrap();
        assert!(!device.name.is_empty() && !device.source.is_empty(), "{name}");
        assert!(text.starts_with("# "), "{name}: a description begins with what the unit is");
    }
    assert!(Device::from_name("no-such").is_none());
}

#[test]
fn a_word_of_bits_has_validity_and_names() {
    let device = Device::from_name("stim300").unwrap();
    let frames = &device.serial.as_ref().unwrap().frames;
    let mut bytes = Vec::new();
    let mut values = vec![0.0; frames.values.len()];
    let slot = |quantity| frames.slot(&quantity).unwrap();
    values[slot(Quantity::Valid(0))] = 1.0;
    values[slot(Quantity::Valid(2))] = 1.0;
    values[slot(Quantity::Output(1))] = -1.5;
    values[slot(Quantity::Status("overload".to_owned()))] = 1.0;
    frames.frames[0].write(&values, &mut bytes);
    assert_eq!(bytes.len(), 25);
    assert_eq!(bytes[4..7], [0xFF, 0xA0, 0x00]);
    // Bits of the word are errors: that of Y, and the overload.
    assert_eq!(bytes[10], 0b1_0010);
    let mut read = vec![f64::NAN; values.len()];
    frames.frames[0].read(&bytes, &mut read);
    assert_eq!(read, values);
    let names: Vec<&str> = frames.values.iter().map(|value| value.name.as_str()).collect();
    assert_eq!(names[..5], ["X_deg_s", "Y_deg_s", "Z_deg_s", "X_valid", "Y_valid"]);
    assert!(
        names.contains(&"X_temperature_c") && names.contains(&"latency_us") && names.contains(&"sequence"),
        "{names:?}"
    );
}

/// The named values of one frame of these bytes.
fn read(frames: &geu_protocol::layout::FrameSet, frame: usize, bytes: &[u8]) -> Vec<(String, f64)> {
    assert!(frames.frames[frame].has_constants(bytes) && frames.frames[frame].checks_hold(bytes), "{bytes:02X?}");
    let mut values = vec![f64::NAN; frames.values.len()];
    frames.frames[frame].read(bytes, &mut values);
    let named = frames.values.iter().zip(values).filter(|(_, value)| !value.is_nan());
    named.map(|(spec, value)| (spec.name.clone(), value)).collect()
}

fn value(read: &[(String, f64)], name: &str) -> f64 {
    read.iter().find(|(own, _)| own == name).unwrap_or_else(|| panic!("no {name} in {read:?}")).1
}

#[test]
fn frames_of_real_units_are_read_as_published() {
    // The sample message of KVH's interface control document 56-0298: angles, status 77, sequence 3D, 40 °C.
    let kvh = Device::from_name("kvh-1750").unwrap().serial.unwrap().frames;
    let sample = [
        0xFE, 0x81, 0xFF, 0x55, 0x37, 0xA9, 0x6A, 0x6E, 0x38, 0x58, 0x6C, 0x1F, 0xB7, 0x5B, 0xF8, 0x62, 0xBF, 0x80,
        0x3E, 0x78, 0xBB, 0x65, 0x0D, 0x28, 0x3B, 0x0A, 0x37, 0xAC, 0x77, 0x3D, 0x00, 0x28, 0x4B, 0xFA, 0x34, 0xD8,
    ];
    let values = read(&kvh, 0, &sample);
    assert!((value(&values, "X_rad") - 2.019593e-5).abs() < 1e-11, "{values:?}");
    assert!((value(&values, "Z_rad") + 1.311_124_8e-5).abs() < 1e-11);
    assert_eq!([value(&values, "Y_valid"), value(&values, "sequence"), value(&values, "sensor_c")], [1.0, 61.0, 40.0]);

    // A public trace of the sister unit MTLT305D.
    let openimu = Device::from_name("openimu300ri").unwrap().can.unwrap().frames;
    assert_eq!(openimu.frames[0].id, Some((0x0CF0_2A80, true)));
    let values = read(&openimu, 0, &[0xC9, 0x81, 0xEB, 0x7C, 0x79, 0x79, 0x00, 0x06]);
    assert_eq!(value(&values, "Y_deg_s"), 9.5703125);
    assert_eq!(
        [value(&values, "X_deg_s"), value(&values, "Z_deg_s"), value(&values, "latency_ms")],
        [-0.1640625, -7.0546875, 3.0]
    );

    // Frames of a public trace of a unit of the family: counter D, then E.
    let mm = Device::from_name("mm5.10").unwrap().can.unwrap().frames;
    for (bytes, counter, yaw_deg_s) in [
        ([0x3B, 0x7C, 0x00, 0xFF, 0x1C, 0x7C, 0x0D, 0xE3], 13.0, -4.825),
        ([0xD0, 0x77, 0x00, 0xFF, 0x0D, 0x7D, 0x0E, 0xFA], 14.0, -10.48),
    ] {
        let values = read(&mm, 0, &bytes);
        assert_eq!(value(&values, "sequence"), counter);
        assert!((value(&values, "Z_deg_s") - yaw_deg_s).abs() < 1e-9, "{values:?}");
    }
}

#[test]
fn a_datagram_of_a_stim300_has_its_padded_check() {
    // A datagram with all contents that a public driver prints, counter 225 and latency 506 µs.
    let stim300 = TEXT.replace(
        &TEXT[TEXT.find("fields = [").unwrap()..],
        "fields = [{ constant = \"AF\" }, { head = \"X\", type = \"i24be\", unit = \"deg/s\", scale = 6.103515625e-5 },\n\
         { ignored = \"00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 \
         00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00\" },\n\
         { value = \"sequence\", type = \"u8\" }, { value = \"latency\", type = \"u16be\", unit = \"us\" },\n\
         { crc = \"CRC-32/MPEG-2\", type = \"u32be\", pad_to = 4 }]\n",
    );
    let device = parse(&stim300.replace("baud = 9600", "baud = 921600")).unwrap();
    let text = "AF000124FFFAD600035B00FFE7A6FFDD36081C5200FF7E70FEBA0C3FFA1D0023A023C023A0002319230A231C00239523B6239500FFEF0200E101FAC64942C6";
    let bytes: Vec<u8> =
        (0..text.len()).step_by(2).map(|at| u8::from_str_radix(&text[at..at + 2], 16).unwrap()).collect();
    let values = read(&device.serial.unwrap().frames, 0, &bytes);
    assert_eq!(
        [value(&values, "X_deg_s"), value(&values, "sequence"), value(&values, "latency_us")],
        [0.017_822_265_625, 225.0, 506.0]
    );
}

const TEXT: &str = r#"
[device]
name = "Test"
source = "none"
interval_s = 0.01
output = "rate"
range_arcsec_s = 36000.0
[[device.head]]
name = "X"
input = [0.0, 2.0, 0.0]
output = [0.0, 0.0, 1.0]
[device.serial]
baud = 9600
[[device.serial.frame]]
name = "DATA"
fields = [
  { constant = "A5" },
  { head = "X", type = "i16be", unit = "deg/s", scale = 0.01 },
  { value = "sequence", type = "u8" },
  { crc = "CRC-16/XMODEM", type = "u16be" },
]
"#;

fn parse(text: &str) -> Result<Device, ConfigurationError> {
    let dbc = "VERSION \"\"\nBU_: U\nBO_ 291 DATA: 4 U\n SG_ RATE : 0|16@1- (0.01,0) [0|0] \"\" U\n SG_ OTHER : 8|8@1+ (1,0) [0|0] \"\" U\n SG_ LONG : 24|16@1+ (1,0) [0|0] \"\" U\n";
    Device::parse("t.toml", text, &|file| {
        if file == "t.dbc" { Ok(dbc.to_owned()) } else { Err("no such file".to_owned()) }
    })
}

#[test]
fn errors_of_a_description_say_what_was_expected() {
    assert_eq!(parse(TEXT).unwrap().heads[0].input, [0.0, 1.0, 0.0]);
    for (from, to, part) in [
        ("[device]", "[devise]", "unknown key `devise`"),
        ("interval_s = 0.01\n", "", "interval_s"),
        ("interval_s = 0.01", "interval_s = 0.0", "a number within 0.00001…10000"),
        ("\"rate\"", "\"rates\"", "did you mean `rate`?"),
        ("[0.0, 2.0, 0.0]", "[0.0, 0.0, 0.0]", "a direction"),
        ("[0.0, 2.0, 0.0]", "[0.0, 2.0]", "a direction"),
        ("output = [0.0, 0.0, 1.0]", "output = [0.0, 1.0, 1.0]", "perpendicular"),
        ("name = \"X\"", "name = \"é\"", "a name of 1 to 16"),
        ("head = \"X\", type", "head = \"Y\", type", "expected a head (X), got Y"),
        ("i16be", "i16", "did you mean `i16"),
        ("i16be", "i8", "the range of the unit, got one from"),
        ("\"deg/s\"", "\"deg/sec\"", "did you mean `deg/s`?"),
        ("scale = 0.01", "scale = 0", "a number that is not 0"),
        ("scale = 0.01", "scal = 0.01", "did you mean `scale`?"),
        ("  { head = \"X\", type = \"i16be\", unit = \"deg/s\", scale = 0.01 },\n", "", "none for head X"),
        ("CRC-16/XMODEM", "CRC-16/XMODM", "did you mean `CRC-16/XMODEM`?"),
        ("CRC-16/XMODEM", "CRC-32/MPEG-2", "a field of 32 bits"),
        ("  { crc = \"CRC-16/XMODEM\", type = \"u16be\" },\n", "", "`unchecked = true`"),
        ("  { constant = \"A5\" },\n", "", "`unchecked = true`"),
        ("constant = \"A5\"", "constant = \"A\"", "bytes in hexadecimal"),
        ("baud = 9600", "baud = 300", "at most the sample interval"),
        ("value = \"sequence\"", "value = \"sequense\"", "did you mean `sequence`?"),
        ("value = \"sequence\", type = \"u8\"", "value = \"sequence\", type = \"i8\"", "without sign"),
        ("value = \"sequence\", type = \"u8\"", "value = \"sequence\", type = \"u8\", modulus = 300", "from 2 to 256"),
        ("value = \"sequence\", type = \"u8\"", "bits = { X_valid = 8 }, type = \"u8\"", "bits.X_valid"),
        ("value = \"sequence\", type = \"u8\"", "head = \"X\", type = \"i16be\", unit = \"deg/s\"", "got another one"),
        ("[device.serial]\nbaud = 9600\n[[device.serial.frame]]", "[[other]]", "unknown key `other`"),
        ("name = \"DATA\"", "name = \"DATA\"\nevery = 2", "1 for one frame or more"),
        ("name = \"DATA\"", "name = \"DATA\"\nevery = 0", "a whole number from 1"),
    ] {
        let text = TEXT.replacen(from, to, 1);
        assert_ne!(text, TEXT, "{from}");
        let error = parse(&text).map(|_| ()).expect_err(to).to_string();
        assert!(error.contains(part) && error.contains("t.toml:"), "{part:?} not in {error}");
    }
}

#[test]
fn a_can_unit_has_its_signals_from_a_database() {
    let serial = TEXT.find("[device.serial]").unwrap();
    let can = |signals: &str| format!("{}[device.can]\ndbc = \"t.dbc\"\nsignals = {{ {signals} }}\n", &TEXT[..serial]);
    let device = parse(&can("\"DATA.RATE\" = { head = \"X\", unit = \"deg/s\" }")).unwrap();
    let frame = &device.can.as_ref().unwrap().frames.frames[0];
    assert_eq!((frame.id, frame.length()), (Some((0x123, false)), 4));
    let mut bytes = Vec::new();
    frame.write(&[-1.0], &mut bytes);
    assert_eq!(bytes, [0x9C, 0xFF, 0, 0]);
    for (signals, part) in [
        ("\"DATA.RAT\" = { head = \"X\", unit = \"deg/s\" }", "did you mean `DATA.RATE`?"),
        ("\"DATA.LONG\" = { head = \"X\", unit = \"deg/s\" }", "inside its message"),
        ("\"DATA.OTHER\" = { value = \"sequence\" }", "none for head X"),
        (
            "\"DATA.RATE\" = { head = \"X\", unit = \"deg/s\" }, \"DATA.OTHER\" = { value = \"sequence\" }",
            "share a bit",
        ),
    ] {
        let error = parse(&can(signals)).map(|_| ()).expect_err(signals).to_string();
        assert!(error.contains(part) && error.contains("t.toml:"), "{part:?} not in {error}");
    }
    let missing = can("").replace("t.dbc", "other.dbc");
    assert!(parse(&missing).map(|_| ()).expect_err("no file").to_string().contains("no such file"));
}
