//! Rows, defects and tracks as text, fast: CSV and JSON lines.

mod defects;
mod device;
mod track;

use geu_protocol::capture::Timestamp;
use geu_protocol::field::{Bit, GYRO_FLAGS, UNIT_FLAGS};
use geu_recording::ReceivedSample;

pub use defects::DefectLines;
pub use device::DeviceRows;
pub use track::{TrackColumn, TrackFormat, instant, track_columns, track_difference, track_header, write_track};

/// A format of text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextFormat {
    /// Comma-separated values.
    Csv,
    /// One JSON object a line.
    Jsonl,
}

const NAMES: [&str; 11] = [
    "t_s",
    "sequence",
    "clock_count",
    "gyrx",
    "gyry",
    "gyrza",
    "gyrzb",
    "gyro_flags",
    "unit_flags",
    "electronics_c",
    "sensor_c",
];

impl TextFormat {
    /// The header line; `with_bits` adds a column for each flag at the end.
    pub fn header(self, with_bits: bool) -> String {
        match self {
            TextFormat::Csv => {
                let bits = [GYRO_FLAGS, UNIT_FLAGS].concat();
                let bits = bits.iter().map(|bit| bit.name).take(if with_bits { bits.len() } else { 0 });
                NAMES.into_iter().chain(bits).collect::<Vec<_>>().join(",") + "\n"
            }
            TextFormat::Jsonl => String::new(),
        }
    }
}

/// Appends a row with its line end.
#[inline]
pub fn write_row(format: TextFormat, with_bits: bool, row: &ReceivedSample, out: &mut Vec<u8>) {
    match format {
        TextFormat::Csv => write_fields::<false, CSV_LINE>(row, out),
        TextFormat::Jsonl => write_fields::<true, JSON_LINE>(row, out),
    }
    if with_bits {
        write_bits(format, row.sample.gyro_flags, GYRO_FLAGS, out);
        write_bits(format, row.sample.unit_flags, UNIT_FLAGS, out);
    }
    out.extend_from_slice(if format == TextFormat::Jsonl { b"}\n" } else { b"\n" });
}

#[inline]
fn write_fields<const IS_JSON: bool, const LENGTH: usize>(row: &ReceivedSample, out: &mut Vec<u8>) {
    let mut line = Line::<IS_JSON, LENGTH>::new();
    let sample = &row.sample;
    line.field(0, row.time, |line, time| line.seconds(time));
    line.field(1, Some(sample.sequence), |line, value| line.short::<5>(value.into()));
    line.field(2, row.has_clock.then_some(sample.clock_count), |line, value| line.unsigned(value));
    for (index, increment) in sample.increments.into_iter().enumerate() {
        line.field(3 + index, Some(increment), |line, value| {
            line.minus(value < 0);
            line.short::<5>(value.unsigned_abs().into());
        });
    }
    line.field(7, Some(sample.gyro_flags), |line, value| line.short::<3>(value.into()));
    line.field(8, Some(sample.unit_flags), |line, value| line.short::<3>(value.into()));
    line.field(9, Some(sample.electronics_centi_c), |line, value| line.hundredths(value));
    line.field(10, row.has_clock.then_some(sample.sensor_centi_c), |line, value| line.hundredths(value));
    out.extend_from_slice(&line.bytes[..line.length]);
}

fn write_bits(format: TextFormat, flags: u8, bits: &[Bit], out: &mut Vec<u8>) {
    for bit in bits {
        let is_set = flags & 1 << bit.bit != 0;
        match format {
            TextFormat::Csv => out.extend_from_slice(if is_set { b",1" } else { b",0" }),
            TextFormat::Jsonl => out.extend_from_slice(format!(",\"{}\":{is_set}", bit.name).as_bytes()),
        }
    }
}

/// Longer than any line of eleven numbers.
const CSV_LINE: usize = 128;
/// Longer than any line with names.
const JSON_LINE: usize = 384;

/// A line in a buffer. Numbers are written as words of eight digits, of which the last ones are overwritten by the next field.
struct Line<const IS_JSON: bool, const LENGTH: usize> {
    bytes: [u8; LENGTH],
    length: usize,
}

const ZEROS: u64 = 0x3030_3030_3030_3030;
const EIGHT_DIGITS: u64 = 100_000_000;
const POWERS_OF_TEN: [u64; 8] = [1, 10, 100, 1000, 10_000, 100_000, 1_000_000, 10_000_000];

/// The eight decimal digits of a number below 100 000 000 as values from 0 to 9, the first in the lowest byte: pairs of four,
/// two and one digit are divided at once.
#[inline]
fn eight_digits(value: u64) -> u64 {
    let fours = (value / 10_000) | (value % 10_000) << 32;
    let hundreds = ((fours * 5243) >> 19) & 0x0000_007F_0000_007F;
    let twos = hundreds | (fours - 100 * hundreds) << 16;
    let tens = ((twos * 103) >> 10) & 0x000F_000F_000F_000F;
    tens | (twos - 10 * tens) << 8
}

impl<const IS_JSON: bool, const LENGTH: usize> Line<IS_JSON, LENGTH> {
    #[inline]
    fn new() -> Line<IS_JSON, LENGTH> {
        Line { bytes: [0; LENGTH], length: 0 }
    }

    #[inline]
    fn push(&mut self, bytes: &[u8]) {
        self.bytes[self.length..self.length + bytes.len()].copy_from_slice(bytes);
        self.length += bytes.len();
    }

    /// Appends the lowest `count` bytes.
    #[inline]
    fn push_word(&mut self, word: u64, count: usize) {
        self.bytes[self.length..self.length + 8].copy_from_slice(&word.to_le_bytes());
        self.length += count;
    }

    #[inline]
    fn field<T>(&mut self, index: usize, value: Option<T>, write: impl FnOnce(&mut Self, T)) {
        if IS_JSON {
            self.push(if index == 0 { b"{\"" } else { b",\"" });
            self.push(NAMES[index].as_bytes());
            self.push(b"\":");
        } else if index > 0 {
            self.push(b",");
        }
        match value {
            Some(value) => write(self, value),
            None if IS_JSON => self.push(b"null"),
            None => {}
        }
    }

    /// Appends a number below 10 to the power of `DIGITS`, at most 8. The length depends on comparisons alone, and not on the
    /// digits, so that the next field need not wait for them.
    #[inline(always)]
    fn short<const DIGITS: usize>(&mut self, value: u64) {
        let mut length = 1;
        for power in &POWERS_OF_TEN[1..DIGITS] {
            length += usize::from(value >= *power);
        }
        self.push_word((eight_digits(value) | ZEROS) >> (64 - 8 * length), length);
    }

    #[inline]
    fn unsigned(&mut self, value: u64) {
        if value < EIGHT_DIGITS {
            return self.short::<8>(value);
        }
        let (high, low) = (value / EIGHT_DIGITS, value % EIGHT_DIGITS);
        if high < EIGHT_DIGITS {
            self.short::<8>(high);
        } else {
            self.short::<4>(high / EIGHT_DIGITS);
            self.push_word(eight_digits(high % EIGHT_DIGITS) | ZEROS, 8);
        }
        self.push_word(eight_digits(low) | ZEROS, 8);
    }

    #[inline]
    fn minus(&mut self, is_negative: bool) {
        self.bytes[self.length] = b'-';
        self.length += usize::from(is_negative);
    }

    #[inline]
    fn hundredths(&mut self, value: i16) {
        self.minus(value < 0);
        let magnitude = u64::from(value.unsigned_abs());
        self.short::<3>(magnitude / 100);
        // The last two of eight digits.
        let digits = (eight_digits(magnitude % 100) | ZEROS) >> 40;
        self.push_word(digits & !0xFF | u64::from(b'.'), 3);
    }

    /// Seconds with the digits of the source, six or more.
    #[inline]
    fn seconds(&mut self, time: Timestamp) {
        self.minus(time.t_ns < 0);
        let magnitude = time.t_ns.unsigned_abs();
        self.unsigned(magnitude / 1_000_000_000);
        self.push(b".");
        let fraction = magnitude % 1_000_000_000;
        let digits = time.digits.clamp(6, 9);
        self.push_word(eight_digits(fraction / 10) | ZEROS, digits.min(8));
        if digits == 9 {
            self.push_word(ZEROS | (fraction % 10), 1);
        }
    }
}

/// Appends a time with the digits of the source, six or more.
pub fn write_seconds(time: Timestamp, out: &mut Vec<u8>) {
    let mut line = Line::<false, 40>::new();
    line.seconds(time);
    out.extend_from_slice(&line.bytes[..line.length]);
}

/// Appends a text as a JSON string.
pub fn quote(text: &str, out: &mut Vec<u8>) {
    out.push(b'"');
    for letter in text.chars() {
        match letter {
            '"' | '\\' => out.extend_from_slice(&[b'\\', letter as u8]),
            letter if (letter as u32) < 0x20 => {
                out.extend_from_slice(format!("\\u{:04x}", letter as u32).as_bytes());
            }
            letter => out.extend_from_slice(letter.encode_utf8(&mut [0; 4]).as_bytes()),
        }
    }
    out.push(b'"');
}

#[cfg(test)]
mod tests {
    use super::*;
    use geu_protocol::Sample;

    const ROW: ReceivedSample = ReceivedSample {
        time: Some(Timestamp { t_ns: 1_795_020_000_500_932_000, digits: 6 }),
        is_received: true,
        sample: Sample {
            sequence: 65_535,
            increments: [-32_768, 32_767, 0, -1],
            gyro_flags: 0x0F,
            unit_flags: 0x07,
            electronics_centi_c: -5,
            clock_count: (1 << 48) - 1,
            sensor_centi_c: 7000,
        },
        has_clock: true,
    };

    fn text(format: TextFormat, row: &ReceivedSample) -> String {
        let mut out = Vec::new();
        write_row(format, false, row, &mut out);
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn csv_is_as_the_contract_says() {
        assert_eq!(
            text(TextFormat::Csv, &ROW),
            "1795020000.500932,65535,281474976710655,-32768,32767,0,-1,15,7,-0.05,70.00\n"
        );
        let time = Some(Timestamp { t_ns: -1_500_000_001, digits: 9 });
        assert_eq!(
            text(TextFormat::Csv, &ReceivedSample { time, has_clock: false, ..ROW }),
            "-1.500000001,65535,,-32768,32767,0,-1,15,7,-0.05,\n"
        );
        let time = Some(Timestamp { t_ns: 100_000_000, digits: 1 });
        assert!(text(TextFormat::Csv, &ReceivedSample { time, ..ROW }).starts_with("0.100000,"));
        assert_eq!(
            TextFormat::Csv.header(false),
            "t_s,sequence,clock_count,gyrx,gyry,gyrza,gyrzb,gyro_flags,unit_flags,electronics_c,sensor_c\n"
        );
    }

    #[test]
    fn numbers_are_those_of_the_standard_formatter() {
        let powers = (0..20)
            .map(|power| 10u64.pow(power))
            .flat_map(|power| [power - 1, power, power + 1, power.saturating_mul(7)]);
        for value in (0..70_000).chain(powers).chain([u64::MAX, (1 << 48) - 1]) {
            let mut line = Line::<false, 40>::new();
            line.unsigned(value);
            assert_eq!(std::str::from_utf8(&line.bytes[..line.length]), Ok(value.to_string().as_str()));
        }
        for value in i16::MIN..=i16::MAX {
            let mut line = Line::<false, 40>::new();
            line.hundredths(value);
            let (sign, magnitude) = (if value < 0 { "-" } else { "" }, value.unsigned_abs());
            let expected = format!("{sign}{}.{:02}", magnitude / 100, magnitude % 100);
            assert_eq!(std::str::from_utf8(&line.bytes[..line.length]), Ok(expected.as_str()));
        }
    }

    #[test]
    fn the_longest_rows_fit() {
        let sample = Sample {
            increments: [i16::MIN; 4],
            gyro_flags: 255,
            unit_flags: 255,
            electronics_centi_c: i16::MIN,
            sensor_centi_c: i16::MIN,
            clock_count: u64::MAX,
            ..ROW.sample
        };
        for digits in 6..=9 {
            let row = ReceivedSample { time: Some(Timestamp { t_ns: i64::MIN, digits }), sample, ..ROW };
            let csv = text(TextFormat::Csv, &row);
            let fraction = &"854775808"[..digits];
            let rest = "65535,18446744073709551615,-32768,-32768,-32768,-32768,255,255,-327.68,-327.68\n";
            assert_eq!(csv, format!("-9223372036.{fraction},{rest}"));
            assert!(csv.len() + 8 <= CSV_LINE);
            assert!(text(TextFormat::Jsonl, &row).len() + 8 <= JSON_LINE);
        }
    }

    #[test]
    fn json_has_the_same_names_and_null_for_what_is_absent() {
        assert_eq!(
            text(TextFormat::Jsonl, &ReceivedSample { time: None, has_clock: false, ..ROW }),
            "{\"t_s\":null,\"sequence\":65535,\"clock_count\":null,\"gyrx\":-32768,\"gyry\":32767,\"gyrza\":0,\
             \"gyrzb\":-1,\"gyro_flags\":15,\"unit_flags\":7,\"electronics_c\":-0.05,\"sensor_c\":null}\n"
        );
    }
}
