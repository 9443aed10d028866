//! Lines of a table of samples; the description of the unit states the columns.

use super::text::{LineFormat, reader};
use super::{CaptureRecord, Detection, Format};

pub(super) const FORMATS: &[Format] = &[Format {
    name: "table",
    title: "the table of a described unit",
    suffixes: &["csv", "txt"],
    detection: Detection::Variant,
    new_reader: Some(reader::<Table>),
}];

#[derive(Debug, Default)]
struct Table;

impl LineFormat for Table {
    fn read<'a>(&'a mut self, line: &'a [u8]) -> Option<CaptureRecord<'a>> {
        Some(if line.trim_ascii().is_empty() { CaptureRecord::Remark } else { CaptureRecord::Line(line) })
    }
}
