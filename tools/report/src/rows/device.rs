//! Samples of a described unit.

use std::io::Write;

use geu_protocol::capture::Timestamp;
use geu_protocol::layout::ValueSpec;
use geu_recording::DeviceSample;

use super::{TextFormat, quote, write_seconds};

/// Whole numbers below this are exact.
const WHOLE: f64 = 9e15;

/// Rows of a unit: time, number of the sample, and its values by their names.
#[derive(Debug)]
pub struct DeviceRows {
    format: TextFormat,
    names: Vec<String>,
    /// For recordings without receive times.
    interval_s: f64,
}

impl DeviceRows {
    pub fn new(format: TextFormat, values: &[ValueSpec], interval_s: f64) -> DeviceRows {
        DeviceRows { format, names: values.iter().map(|value| value.name.clone()).collect(), interval_s }
    }

    /// The header line.
    pub fn header(&self) -> String {
        match self.format {
            TextFormat::Csv => format!("t_s,number,{}\n", self.names.join(",")),
            TextFormat::Jsonl => String::new(),
        }
    }

    /// Appends a row with its line end. Without a receive time a sample has that of its number.
    pub fn write(&self, row: &DeviceSample, out: &mut Vec<u8>) {
        let number = || Timestamp { t_ns: (row.number as f64 * self.interval_s * 1e9).round() as i64, digits: 9 };
        let is_json = self.format == TextFormat::Jsonl;
        out.extend_from_slice(if is_json { b"{\"t_s\":" } else { b"" });
        write_seconds(row.time.unwrap_or_else(number), out);
        let key = if is_json { ",\"number\":" } else { "," };
        write!(out, "{key}{}", row.number).expect("memory");
        for (name, value) in self.names.iter().zip(&row.values) {
            out.push(b',');
            if is_json {
                quote(name, out);
                out.push(b':');
            }
            match value {
                // Most values are whole: no search for the shortest decimals.
                whole if whole.fract() == 0.0 && whole.abs() < WHOLE => {
                    out.extend_from_slice(itoa::Buffer::new().format(*whole as i64).as_bytes());
                }
                value if value.is_finite() => write!(out, "{value}").expect("memory"),
                _ => out.extend_from_slice(if is_json { b"null" } else { b"" }),
            }
        }
        out.extend_from_slice(if is_json { b"}\n" } else { b"\n" });
    }
}
