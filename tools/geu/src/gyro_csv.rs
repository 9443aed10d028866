//! CSV of any gyros: its description, and the output of `geu decode --gyro-csv`.

use std::io::Write;
use std::path::Path;

use geu_recording::{GyroCsv, GyroCsvSpec};

use crate::command_error::CommandError;
use crate::settings::read_text;

/// Reads a description.
///
/// # Errors
/// The file cannot be read or is not valid.
pub fn description(path: &Path) -> Result<GyroCsvSpec, CommandError> {
    let text = read_text(path, "a description, such as configs/suchai3.toml")?;
    GyroCsvSpec::parse(&path.display().to_string(), &text).map_err(CommandError::input)
}

/// Appends a header and a row for each sample: time, line, then a rate for each gyro.
pub fn write_csv(read: &GyroCsv, out: &mut Vec<u8>) {
    let names = read.description.gyros.iter().map(|gyro| format!(",{}_arcsec_s", gyro.name));
    put(out, format_args!("t_s,line{}\n", names.collect::<String>()));
    for sample in &read.samples {
        put(out, format_args!("{:.6},{}", sample.t_s, sample.line));
        sample.rates_arcsec_s.iter().for_each(|rate| put(out, format_args!(",{rate}")));
        put(out, format_args!("\n"));
    }
}

/// Appends a JSON object for each sample.
pub fn write_jsonl(read: &GyroCsv, out: &mut Vec<u8>) {
    for sample in &read.samples {
        put(out, format_args!("{{\"t_s\":{:.6},\"line\":{}", sample.t_s, sample.line));
        for (gyro, rate) in read.description.gyros.iter().zip(&sample.rates_arcsec_s) {
            put(out, format_args!(",{}:{rate}", serde_json::Value::from(format!("{}_arcsec_s", gyro.name))));
        }
        put(out, format_args!("}}\n"));
    }
}

/// Appends a JSON object for each defect: place, kind and text.
pub fn write_defects(input: &str, read: &GyroCsv, out: &mut Vec<u8>) {
    for defect in &read.defects {
        let place = format!("{input}: line {}", defect.line);
        let object = serde_json::json!({ "place": place, "kind": defect.kind.name(), "text": defect.kind.to_string() });
        put(out, format_args!("{object}\n"));
    }
}

fn put(out: &mut Vec<u8>, content: std::fmt::Arguments) {
    out.write_fmt(content).expect("memory");
}
