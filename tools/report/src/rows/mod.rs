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
    let mut line = Line { format, field: 0, bytes: [0; LINE], length: 0 };
    let sample = &row.sample;
    line.field(row.time, |line, time| line.seconds(time));
    line.field(Some(sample.sequence), |line, value| line.unsigned(value.into()));
    line.field(row.has_clock.then_some(sample.clock_count), |line, value| line.unsigned(value));
    for increment in sample.increments {
        line.field(Some(increment), |line, value| line.signed(value.into()));
    }
    line.field(Some(sample.gyro_flags), |line, value| line.unsigned(value.into()));
    line.field(Some(sample.unit_flags), |line, value| line.unsigned(value.into()));
    line.field(Some(sample.electronics_centi_c), |line, value| line.hundredths(value));
    line.field(row.has_clock.then_some(sample.sensor_centi_c), |line, value| line.hundredths(value));
    out.extend_from_slice(&line.bytes[..line.length]);
    if with_bits {
        write_bits(format, sample.gyro_flags, GYRO_FLAGS, out);
        write_bits(format, sample.unit_flags, UNIT_FLAGS, out);
    }
    out.extend_from_slice(if format == TextFormat::Jsonl { b"}\n" } else { b"\n" });
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

/// Longer than any line: names and eleven numbers.
const LINE: usize = 384;

struct Line {
    format: TextFormat,
    field: usize,
    bytes: [u8; LINE],
    length: usize,
}

/// The two digits of each number below 100.
const PAIRS: [[u8; 2]; 100] = {
    let mut pairs = [[0; 2]; 100];
    let mut value = 0;
    while value < 100 {
        pairs[value] = [b'0' + (value / 10) as u8, b'0' + (value % 10) as u8];
        value += 1;
    }
    pairs
};

impl Line {
    #[inline]
    fn push(&mut self, bytes: &[u8]) {
        self.bytes[self.length..self.length + bytes.len()].copy_from_slice(bytes);
        self.length += bytes.len();
    }

    #[inline]
    fn field<T>(&mut self, value: Option<T>, write: impl FnOnce(&mut Line, T)) {
        match self.format {
            TextFormat::Csv if self.field > 0 => self.push(b","),
            TextFormat::Csv => {}
            TextFormat::Jsonl => {
                self.push(if self.field == 0 { b"{\"" } else { b",\"" });
                self.push(NAMES[self.field].as_bytes());
                self.push(b"\":");
            }
        }
        self.field += 1;
        match value {
            Some(value) => write(self, value),
            None if self.format == TextFormat::Jsonl => self.push(b"null"),
            None => {}
        }
    }

    #[inline]
    fn unsigned(&mut self, mut value: u64) {
        let (mut digits, mut at) = ([0; 20], 20);
        while value >= 100 {
            at -= 2;
            digits[at..at + 2].copy_from_slice(&PAIRS[(value % 100) as usize]);
            value /= 100;
        }
        at -= 2;
        digits[at..at + 2].copy_from_slice(&PAIRS[value as usize]);
        at += usize::from(value < 10);
        self.push(&digits[at..]);
    }

    #[inline]
    fn signed(&mut self, value: i64) {
        if value < 0 {
            self.push(b"-");
        }
        self.unsigned(value.unsigned_abs());
    }

    #[inline]
    fn hundredths(&mut self, value: i16) {
        if value < 0 {
            self.push(b"-");
        }
        let magnitude = value.unsigned_abs();
        self.unsigned(u64::from(magnitude / 100));
        self.push(b".");
        self.push(&PAIRS[usize::from(magnitude % 100)]);
    }

    /// Seconds with the digits of the source, six or more.
    #[inline]
    fn seconds(&mut self, time: Timestamp) {
        if time.t_ns < 0 {
            self.push(b"-");
        }
        let magnitude = time.t_ns.unsigned_abs();
        self.unsigned(magnitude / 1_000_000_000);
        let mut fraction = (magnitude % 1_000_000_000) * 10;
        let mut digits = [b'.'; 11];
        for pair in (0..5).rev() {
            digits[1 + 2 * pair..3 + 2 * pair].copy_from_slice(&PAIRS[(fraction % 100) as usize]);
            fraction /= 100;
        }
        self.push(&digits[..1 + usize::from(time.digits.clamp(6, 9))]);
    }
}

/// Appends a time with the digits of the source, six or more.
pub fn write_seconds(time: Timestamp, out: &mut Vec<u8>) {
    let mut line = Line { format: TextFormat::Csv, field: 0, bytes: [0; LINE], length: 0 };
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
    fn json_has_the_same_names_and_null_for_what_is_absent() {
        assert_eq!(
            text(TextFormat::Jsonl, &ReceivedSample { time: None, has_clock: false, ..ROW }),
            "{\"t_s\":null,\"sequence\":65535,\"clock_count\":null,\"gyrx\":-32768,\"gyry\":32767,\"gyrza\":0,\
             \"gyrzb\":-1,\"gyro_flags\":15,\"unit_flags\":7,\"electronics_c\":-0.05,\"sensor_c\":null}\n"
        );
    }
}
