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
fn results_have_the_angle_of_the_output() {
    for (name, unit) in [
        ("stim300", "deg"),
        ("kvh-1750", "rad"),
        ("mti-100", "rad"),
        ("mm5.10", "deg"),
        ("suchai3", "deg"),
        ("tetrad", "arcsec"),
    ] {
        assert_eq!(Device::from_name(name).expect("a unit").angle_unit().name, unit, "{name}");
    }
    assert_eq!(Device::iras().angle_unit().name, "arcsec");
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

const DBC: &str = "VERSION \"\"
BU_: U
BO_ 291 DATA: 4 U
 SG_ RATE : 0|16@1- (0.01,0) [0|0] \"deg/s\" U
 SG_ OTHER : 8|8@1+ (1,0) [0|0] \"\" U
 SG_ LONG : 24|16@1+ (1,0) [0|0] \"\" U
 SG_ COUNTER : 24|4@1+ (1,0) [0|0] \"\" U
 SG_ WIDE : 1|18446744073709551615@1+ (1,0) [0|0] \"\" U
BO_ 292 MIX: 8 U
 SG_ PAGE M : 0|8@1+ (1,0) [0|0] \"\" U
 SG_ NUMBER : 8|8@1+ (1,0) [0|0] \"\" U
 SG_ RATE_A m0 : 16|16@1- (0.01,0) [0|0] \"deg/s\" U
 SG_ WARMTH m1 : 16|16@1- (0.01,0) [0|0] \"\" U
 SG_ CRC : 56|8@1+ (1,0) [0|0] \"\" U
BO_ 293 NESTED: 8 U
 SG_ PAGE M : 0|8@1+ (1,0) [0|0] \"\" U
 SG_ SUB m0M : 8|8@1+ (1,0) [0|0] \"\" U
 SG_ RATE m0 : 16|16@1- (0.01,0) [0|0] \"deg/s\" U
BO_ 294 HUGE: 18446744073709551615 U
 SG_ RATE : 0|16@1- (0.01,0) [0|0] \"deg/s\" U
";

fn parse(text: &str) -> Result<Device, ConfigurationError> {
    Device::parse("t.toml", text, &|file| match file {
        "t.dbc" => Ok(DBC.to_owned()),
        "short.dbc" => Ok(DBC.replace("BO_ 291", "BO_ 217066112")),
        "garbage.dbc" => Ok("x".repeat(100_000)),
        _ => Err("no such file".to_owned()),
    })
}

#[test]
fn errors_of_a_description_say_what_was_expected() {
    assert_eq!(parse(TEXT).unwrap().heads[0].axes.input_control, [0.0, 1.0, 0.0]);
    for (from, to, part) in [
        ("[device]", "[devise]", "unknown key `devise`"),
        ("interval_s = 0.01\n", "", "interval_s"),
        ("interval_s = 0.01", "interval_s = 0.0", "a number within 0.00001…10000"),
        ("\"rate\"", "\"rates\"", "did you mean `rate`?"),
        ("[0.0, 2.0, 0.0]", "[0.0, 0.0, 0.0]", "a direction"),
        ("[0.0, 2.0, 0.0]", "[0.0, 2.0]", "a direction"),
        ("output = [0.0, 0.0, 1.0]", "output = [0.0, 1.0, 1.0]", "perpendicular"),
        ("name = \"X\"", "name = \"é\"", "a name of letters"),
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
        ("name = \"DATA\"", "name = \"a b\"", "a name of letters"),
        (
            "value = \"sequence\", type = \"u8\"",
            "bits = { number = 0, \"a,b\" = 1 }, type = \"u8\"",
            "a name of letters",
        ),
        (
            "value = \"sequence\", type = \"u8\"",
            "value = \"sequence\", type = \"u8\", scale = 2.0",
            "unknown key `scale`",
        ),
        (
            "value = \"sequence\", type = \"u8\"",
            "value = \"latency\", type = \"u8\" }, { value = \"latency\", type = \"u8\", unit = \"ms\"",
            "the unit of the other field",
        ),
        (
            "value = \"sequence\", type = \"u8\"",
            "value = \"sequence\", type = \"u8\" }, { value = \"sequence\", type = \"u16be\"",
            "the modulus of the other field",
        ),
        ("type = \"u16be\" },\n]", "type = \"u16be\", to = 2 },\n]", "does not cover every field"),
        (
            "value = \"sequence\", type = \"u8\"",
            "parts = [{ value = \"sequence\", first = 0, length = 9 }], type = \"u8\"",
            "from 1 to 8",
        ),
        (
            "value = \"sequence\", type = \"u8\"",
            "parts = [{ value = \"sequence\", first = 6, length = 0 }], type = \"u8\"",
            "from 1 to 2",
        ),
        (
            "value = \"sequence\", type = \"u8\"",
            "parts = [{ value = \"sequence\", first = 0, length = 3 }, { bits = { busy = 2 } }], type = \"u8\"",
            "got status_busy on bits of another",
        ),
        (
            "value = \"sequence\", type = \"u8\"",
            "bits = { X_valid = 0, busy = 0 }, type = \"u8\"",
            "got status_busy on bits of another",
        ),
        ("value = \"sequence\", type = \"u8\"", "parts = [], type = \"i8\"", "a type without sign"),
        ("type = \"u16be\" },\n]", "type = \"u16be\", signal = \"x\" },\n]", "unknown key `signal`"),
        (
            "type = \"u16be\" },\n]\n",
            "type = \"u16be\" },\n]\n[[device.serial.frame]]\nname = \"data\"\nfields = [{ constant = \"A6\" }, { crc = \"xor\", type = \"u8\" }]\n",
            "frames of different names",
        ),
        (
            "type = \"u16be\" },\n]\n",
            "type = \"u16be\" },\n]\n[[device.serial.frame]]\nname = \"B\"\nevery = 5\nfields = [{ constant = \"A5\" }, { ignored = \"00 00 00\" }, { crc = \"CRC-16/XMODEM\", type = \"u16be\" }]\n",
            "differ in a constant",
        ),
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
            "on bits of another",
        ),
    ] {
        let error = parse(&can(signals)).map(|_| ()).expect_err(signals).to_string();
        assert!(error.contains(part) && error.contains("t.toml:"), "{part:?} not in {error}");
    }
    let rate = "\"DATA.RATE\" = { head = \"X\", unit = \"deg/s\" }";
    for (signals, part) in [
        ("DATA.RATE = { head = \"X\" }".to_owned(), "in quotes"),
        (
            "\"MIX.RATE_A\" = { head = \"X\", unit = \"deg/s\" }, \"MIX.PAGE\" = { bits = { busy = 0 } }".to_owned(),
            "got status_busy on bits of another",
        ),
        (format!("{rate}, \"DATA.WIDE\" = {{ value = \"clock_count\" }}"), "of 1 to 53 bits"),
        (format!("{rate}, \"DATA.COUNTER\" = {{ value = \"sequence\", modulus = 17 }}"), "from 2 to 16"),
        ("\"DATA.RATE\" = { head = \"X\", unit = \"rad/s\" }".to_owned(), "the unit of the database, deg/s"),
        ("\"NESTED.RATE\" = { head = \"X\", unit = \"deg/s\" }".to_owned(), "at most one selector"),
        ("\"HUGE.RATE\" = { head = \"X\", unit = \"deg/s\" }".to_owned(), "a message of 1 to 8 bytes"),
    ] {
        let error = parse(&can(&signals)).map(|_| ()).expect_err(&signals).to_string();
        assert!(error.contains(part), "{part:?} not in {error}");
    }
    for (file, part) in [("other", "no such file"), ("short", "bit 31 set"), ("garbage", "a CAN database")] {
        let error =
            parse(&can(rate).replace("\"t.dbc", &format!("\"{file}.dbc"))).map(|_| ()).expect_err(file).to_string();
        assert!(error.contains(part) && error.len() < 1000, "{part:?} not in {error}");
    }
}

#[test]
fn parts_of_a_word_and_sums_of_words_are_as_described() {
    let text = TEXT
        .replace("value = \"sequence\", type = \"u8\"", "parts = [{ value = \"sequence\", first = 0, length = 3 }, \
                 { head = \"X\", of = \"temperature\", first = 3, length = 4, signed = true }, { bits = { X_valid = 7 } }], type = \"u8\"")
        .replace("CRC-16/XMODEM", "sum-u16le");
    let frames = parse(&text).unwrap().serial.unwrap().frames;
    let with = |part: &str| {
        parse(&text.replace("{ bits = { X_valid = 7 } }", part)).map(|device| device.serial.unwrap().frames)
    };
    let constant = with("{ constant = 1, first = 7, length = 1 }").unwrap();
    let mut bytes = Vec::new();
    constant.frames[0].write(&vec![0.0; constant.values.len()], &mut bytes);
    assert!(bytes[3] == 0x80 && constant.frames[0].constant_bits().eq([(3, 0x80, 0x80)]), "{bytes:02X?}");
    bytes[3] = 0;
    assert!(!constant.frames[0].has_constants(&bytes));
    let ignored = with("{ ignored = 1, first = 7, length = 1, comment = \"-\" }").unwrap();
    assert!(ignored.frames[0].has_constants(&bytes) && ignored.frames[0].template()[3] == 0x80);
    for (part, expected) in [
        ("{ constant = 2, first = 7, length = 1 }", "a whole number from 0 to 1"),
        ("{ constant = 1, first = 6, length = 1 }", "bits of its own"),
        ("{ ignored = 1, first = 6, length = 1 }", "bits of its own"),
        ("{ ignored = 1, first = 7, length = 2 }", "a whole number from 1 to 1"),
        ("{ ignored = -1, first = 7, length = 1 }", "a whole number of 0 or more"),
    ] {
        let error = with(part).map(|_| ()).expect_err(part).to_string();
        assert!(error.contains(expected), "{expected:?} not in {error}");
    }
    // 01A5 + ED02 = EEA7.
    let values = read(&frames, 0, &[0xA5, 0x01, 0x02, 0b1110_1101, 0xEE, 0xA7]);
    assert!(frames.sequence == (8, 1) && value(&values, "sequence") == 5.0, "{values:?}");
    assert_eq!([value(&values, "X_temperature_c"), value(&values, "X_valid")], [-3.0, 1.0]);
}

#[test]
fn a_frame_instead_of_another_has_all_its_values() {
    let end = "  { crc = \"CRC-16/XMODEM\", type = \"u16be\" },\n]\n";
    let other = |fields: &str| {
        format!(
            "{TEXT}[[device.serial.frame]]\nname = \"LONG\"\ninstead_of = \"DATA\"\nfields = [{{ constant = \"A6\" }}, {fields}{end}"
        )
    };
    let rate = "{ head = \"X\", type = \"i32be\", unit = \"deg/s\", scale = 1e-6 },";
    let frames =
        parse(&other(&format!("{rate} {{ value = \"sequence\", type = \"u8\" }},\n"))).unwrap().serial.unwrap().frames;
    assert_eq!(frames.frames[1].instead_of, Some(0));
    let both = format!("{rate} {{ value = \"sequence\", type = \"u8\" }},\n");
    let turned = "{ head = \"X\", of = \"angle\", type = \"i32be\", unit = \"deg\", scale = 2, divisor = 4e6 },\n";
    let angle = format!("{both} {turned}");
    let every = |number: &str| {
        other(&angle)
            .replace("fields = [{ constant = \"A6\"", &format!("every = {number}\nfields = [{{ constant = \"A6\""))
    };
    let device = parse(&every("3")).unwrap();
    let set = &device.serial.as_ref().unwrap().frames;
    let sent: Vec<&str> = (0..7).flat_map(|index| set.due(index)).map(|frame| frame.name.as_str()).collect();
    assert_eq!(sent, ["LONG", "DATA", "DATA", "LONG", "DATA", "DATA", "LONG"]);
    assert_eq!(
        (device.angle_samples, set.cadence(&set.frames[1]).as_str()),
        (Some(3), "instead of DATA every 3 samples")
    );
    let other_every = every("4")[TEXT.len()..].replace("LONG", "LONGER").replace("A6", "A8");
    for (text, part) in [
        (every("3").replace("9600", "19200") + &other_every, "as many samples in all frames, got 3 and 4"),
        (every("1"), "2 or more in a frame that comes instead"),
        (every("3").replace("divisor = 4e6", "divisor = 0"), "a number that is not 0"),
        (every("3").replace("divisor = 4e6", "divisor = 1e11"), "the range of the unit"),
        (other(rate), "expected all values of DATA in LONG"),
        (other(rate).replace("instead_of = \"DATA\"", "instead_of = \"DAT\""), "an earlier frame"),
    ] {
        let error = parse(&text).map(|_| ()).expect_err(part).to_string();
        assert!(error.contains(part), "{part:?} not in {error}");
    }
}

#[test]
fn plain_signals_and_checks_of_a_multiplexed_message_are_in_each_of_its_frames() {
    let serial = TEXT.find("[device.serial]").unwrap();
    let text = format!(
        "{}[device.can]\ndbc = \"t.dbc\"\n[device.can.signals]\n\"MIX.NUMBER\" = {{ value = \"sequence\" }}\n\
         \"MIX.RATE_A\" = {{ head = \"X\", unit = \"deg/s\" }}\n\"MIX.WARMTH\" = {{ value = \"sensor\" }}\n\
         [[device.can.checks]]\nsignal = \"MIX.CRC\"\ncrc = \"CRC-8/SAE-J1850\"\n",
        &TEXT[..serial]
    );
    let frames = parse(&text).unwrap().can.unwrap().frames;
    let names: Vec<(&str, usize, usize)> =
        frames.frames.iter().map(|frame| (frame.name.as_str(), frame.fields.len(), frame.checks.len())).collect();
    assert_eq!(names, [("MIX_0", 2, 1), ("MIX_1", 2, 1)]);
    let mut bytes = Vec::new();
    frames.frames[1].write(&vec![3.0; frames.values.len()], &mut bytes);
    assert_eq!(bytes[..4], [1, 3, 0x2C, 0x01]);
    assert!(!frames.frames[0].has_constants(&bytes) && frames.frames[1].has_constants(&bytes));
    assert!(frames.frames[1].checks_hold(&bytes));
    bytes[2] ^= 1;
    assert!(!frames.frames[1].checks_hold(&bytes));
}

#[test]
fn both_links_of_a_unit_have_the_same_values() {
    let text = format!(
        "{TEXT}[device.can]\ndbc = \"t.dbc\"\nsignals = {{ \"DATA.COUNTER\" = {{ value = \"sequence\" }}, \
         \"DATA.RATE\" = {{ head = \"X\", unit = \"deg/s\" }} }}\n"
    );
    let error = parse(&text).map(|_| ()).expect_err("a frame and a message DATA").to_string();
    assert!(error.contains("other names than the serial frames"), "{error}");
    let device = parse(&text.replace("name = \"DATA\"", "name = \"S\"")).unwrap();
    let (serial, can) = (device.serial.unwrap().frames, device.can.unwrap().frames);
    assert_eq!(serial.values, can.values);
    assert_eq!((serial.sequence, can.sequence), ((256, 1), (16, 1)));
}

#[test]
fn a_sample_is_encoded_with_its_counters_and_rarer_frames() {
    let text = "[device]\nname = \"T\"\nsource = \"a test\"\ninterval_s = 0.01\noutput = \"increment\"\nrange_arcsec_s = 1000.0\n\
        clock_hz = 5e4\n[[device.head]]\nname = \"X\"\ninput = [1, 0, 0]\n[[device.serial.frame]]\nname = \"DATA\"\nfields = [\n\
        { constant = \"A5\" }, { head = \"X\", type = \"i16be\", unit = \"arcsec\", scale = 0.05 },\n\
        { value = \"sequence\", type = \"u8\", modulus = 100, step = 10 }, { value = \"clock_count\", type = \"u16be\" },\n\
        { bits = { X_valid = 0, X_saturated = 7, self_test = 3 }, type = \"u8\" }, { crc = \"xor\", type = \"u8\" } ]\n\
        [[device.serial.frame]]\nname = \"RARE\"\nevery = 4\nfields = [ { constant = \"5A\" }, \
        { value = \"electronics\", type = \"i8\" }, { crc = \"xor\", type = \"u8\" } ]\n";
    let device = Device::parse("t.toml", text, &|_| Err("no file".to_owned())).unwrap();
    assert_eq!((device.heads[0].count_arcsec, device.limits(&device.heads[0])), (0.05, (-200.0, 200.0)));
    let mut configuration = crate::Configuration::of_device(&Arc::new(device), &[]).unwrap();
    configuration.motion = vec![crate::attitude::RateSegment { duration_s: 60.0, x_deg_s: 0.25, ..Default::default() }];
    let mut unit = crate::GyroUnit::new(&configuration);
    let mut frames = Vec::new();
    for _ in 0..140 {
        let ended = unit.end_sample();
        let encoded = configuration.device.encode(false, &ended);
        frames.push(encoded.into_iter().map(|(_, bytes)| bytes).collect::<Vec<_>>());
    }
    // 0.25 °/s are 9″ in 10 ms: 180 counts. The clock counts 500, modulo 65536; the sequence 10, modulo 100.
    assert_eq!(frames[0][0][..7], [0xA5, 0, 180, 0, 0x01, 0xF4, 1]);
    assert_eq!(frames[13][0][3..6], [30, 0x1B, 0x58]);
    assert_eq!(frames[131][0][4..6], ((500 * 132) as u16).to_be_bytes());
    assert_eq!(frames.iter().map(Vec::len).collect::<Vec<_>>()[..9], [2, 1, 1, 1, 2, 1, 1, 1, 2]);
    assert_eq!(frames[4][1], [0x5A, 20, 0x5A ^ 20]);
    // A number before the first, as a fault may put it; beyond the range it is clipped and flagged.
    let early = unit.end_sample().numbered((-3i64) as u64);
    assert_eq!(configuration.device.encode(false, &early)[0].1[3], 70);
    configuration.motion[0].x_deg_s = 0.5;
    let clipped = configuration.device.encode(false, &crate::GyroUnit::new(&configuration).end_sample());
    assert_eq!(clipped[0].1[1..3], 200i16.to_be_bytes());
    assert_eq!(clipped[0].1[6], 0x81);
}

#[test]
fn the_default_unit_is_a_unit_without_a_described_link() {
    let iras = Device::iras();
    assert!(iras.is_iras() && iras.frames(false).is_none() && iras.frames(true).is_none());
    assert_eq!((iras.interval_ns(), iras.reference_interval_ns()), (500_000_000, 500_000_000));
    let spacing = |name: &str| Device::from_name(name).unwrap().reference_interval_ns();
    assert_eq!(["stim300", "kvh-1750", "tetrad", "hg4930"].map(spacing), [10_000_000; 4]);
}

#[test]
fn a_known_unit_has_the_text_and_the_files_of_its_name() {
    for (name, text) in DEVICES {
        let known = Device::from_name(name).expect("a known unit");
        assert_eq!(known.known_name(), Some(*name));
        let file = |file: &str| FILES.iter().find(|(own, _)| *own == file).expect("a known file").1;
        let other = Device::parse(name, text, &|name| Ok(format!("{}\n", file(name)))).expect("the same unit");
        assert_eq!(other.known_name(), Some(*name).filter(|_| known.description.files.is_empty()));
        let other =
            Device::parse(name, &format!("{text}\n"), &|name| Ok(file(name).to_owned())).expect("the same unit");
        assert_eq!(other.known_name(), None);
    }
}
