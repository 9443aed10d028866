//! Samples of a described unit.

use std::io::Write;

use geu_model::device::{Device, TableWire};
use geu_recording::DeviceSample;

use super::{TextFormat, quote, write_seconds};

/// Whole numbers below this are exact.
const WHOLE: u64 = 9_000_000_000_000_000;

/// Rows of a unit: time, number of the sample, and its values by their names.
#[derive(Debug)]
pub struct DeviceRows {
    format: TextFormat,
    names: Vec<String>,
    /// For recordings without receive times.
    interval_s: f64,
    /// True for columns with the start and the trial of a row.
    has_start: bool,
    has_group: bool,
}

impl DeviceRows {
    pub fn new(format: TextFormat, device: &Device) -> DeviceRows {
        let has = |column: fn(&TableWire) -> bool| device.table.as_ref().is_some_and(column);
        DeviceRows {
            format,
            names: device.values().iter().map(|value| value.name.clone()).collect(),
            interval_s: device.interval_s,
            has_start: has(|table| table.start.is_some()),
            has_group: has(|table| table.group.is_some()),
        }
    }

    /// The header line.
    pub fn header(&self) -> String {
        match self.format {
            TextFormat::Csv => {
                let more = [("start_s", self.has_start), ("group", self.has_group)];
                let more = more.into_iter().filter(|(_, has)| *has).map(|(name, _)| name);
                let names: Vec<&str> = self.names.iter().map(String::as_str).chain(more).collect();
                format!("t_s,number,{}\n", names.join(","))
            }
            TextFormat::Jsonl => String::new(),
        }
    }

    /// Appends a row with its line end. Without a receive time a sample has that of its number.
    pub fn write(&self, row: &DeviceSample, out: &mut Vec<u8>) {
        let is_json = self.format == TextFormat::Jsonl;
        out.extend_from_slice(if is_json { b"{\"t_s\":" } else { b"" });
        write_seconds(row.time_or_number(self.interval_s), out);
        out.extend_from_slice(if is_json { b",\"number\":" } else { b"," });
        out.extend_from_slice(itoa::Buffer::new().format(row.number).as_bytes());
        for (name, &value) in self.names.iter().zip(&row.values) {
            out.push(b',');
            if is_json {
                quote(name, out);
                out.push(b':');
            }
            match value as i64 {
                // Most values are whole: no search for the shortest decimals.
                whole if whole as f64 == value && whole.unsigned_abs() < WHOLE => {
                    out.extend_from_slice(itoa::Buffer::new().format(whole).as_bytes());
                }
                _ if value.is_finite() => write_real(value, out),
                _ => out.extend_from_slice(if is_json { b"null" } else { b"" }),
            }
        }
        if self.has_start {
            out.extend_from_slice(if is_json { b",\"start_s\":" } else { b"," });
            match row.start {
                Some(start) => write_seconds(start, out),
                None => out.extend_from_slice(if is_json { b"null" } else { b"" }),
            }
        }
        if self.has_group {
            out.extend_from_slice(if is_json { b",\"group\":" } else { b"," });
            match is_json || row.group.contains([',', '"']) {
                true => quote(&row.group, out),
                false => out.extend_from_slice(row.group.as_bytes()),
            }
        }
        out.extend_from_slice(if is_json { b"}\n" } else { b"\n" });
    }
}

/// Appends the shortest decimals that read back exactly, without an exponent: as `Display` does, but faster.
fn write_real(value: f64, out: &mut Vec<u8>) {
    let (size, mut buffer) = (value.abs(), zmij::Buffer::new());
    let text = buffer.format_finite(size);
    let (number, exponent) = text.split_once('e').unwrap_or((text, "0"));
    let places = exponent.trim_start_matches('-').parse().unwrap_or(0);
    if size >= WHOLE as f64 || (number.len() > 16 && is_tie(size, number, places)) {
        return write!(out, "{value}").expect("memory");
    }
    out.extend_from_slice(if value < 0.0 { b"-" } else { b"" });
    if places > 0 {
        write!(out, "0.{:0<1$}", "", places - 1).expect("memory");
        out.extend(number.bytes().filter(u8::is_ascii_digit));
    } else {
        out.extend_from_slice(text.as_bytes());
    }
}

/// True if the value is in the middle between these decimals and others: `Display` takes the larger ones, `zmij` the even ones.
/// The value's last bit then is one binary place below the last decimal place, and there are 16 digits or more.
fn is_tie(size: f64, number: &str, places: usize) -> bool {
    let decimals = number.find('.').map_or(0, |point| number.len() - 1 - point) + places;
    decimals as u64 + 1 + (size.to_bits() >> 52) + u64::from((size.to_bits() | 1 << 52).trailing_zeros()) == 1075
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_are_those_of_the_standard_formatter() {
        let mut bits = 1u64;
        let powers = (-320..300).map(|power| format!("1.5e{power}").parse().unwrap());
        let random = std::iter::repeat_with(|| {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            f64::from_bits(bits)
        });
        let binary = (1..2047u64).map(|exponent| f64::from_bits(exponent << 52));
        // Rates and angles of 2^-14 and 2^-21 degrees: many lie between two decimals.
        let ties = (1..100_000)
            .flat_map(|count| [21, 30, 36, 44, 50].map(|power| (f64::from(count) * 20_011.0) * 0.5f64.powi(power)));
        let all = powers.chain(random.take(200_000)).chain(binary).chain(ties).chain([5e-324, 0.1, 1e-5, f64::MAX]);
        let mut written = 0;
        for value in all.flat_map(|value: f64| [value, (value as f32).into(), -value % 1e4]) {
            if value.is_finite() && (value.fract() != 0.0 || value.abs() > WHOLE as f64) {
                written += 1;
                let mut out = Vec::new();
                write_real(value, &mut out);
                assert_eq!(String::from_utf8(out).unwrap(), format!("{value}"));
            }
        }
        assert!(written > 1_000_000, "{written}");
    }
}
