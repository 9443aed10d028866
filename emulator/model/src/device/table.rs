//! Samples in a delimited text table: columns by their names in its first line.

use std::sync::Arc;

use geu_protocol::excerpt::MAX_QUOTED;
use geu_protocol::layout::{BitField, Frame, FrameSet, Number, ValueSpec};

use super::Device;
use super::fields::{Fields, PLAIN};
use crate::configuration::{ConfigurationError, Node};
use crate::units::TIME_UNITS;

const DELIMITERS: [&str; 5] = [",", ";", "\t", "|", " "];
/// Types of numbers that were whole before they became text, and the default one.
const TYPES: [&str; 9] = ["u8", "i8", "u16", "i16", "u24", "i24", "u32", "i32", "f64"];
/// Bytes of a column's number in the frame of a row.
const COLUMN_BYTES: usize = 8;

/// A column of times.
#[derive(Debug, Clone)]
pub struct TimeColumn {
    pub column: String,
    /// Name of its unit, and the size: a power of ten.
    pub unit: &'static str,
    pub unit_ns: i64,
}

/// The samples of a unit in a table.
#[derive(Debug, Clone)]
pub struct TableWire {
    /// Separates the cells of a row; spaces separate as one.
    pub delimiter: char,
    /// End of the interval of a row.
    pub time: TimeColumn,
    /// Start of the interval; without it a row has the nominal interval.
    pub start: Option<TimeColumn>,
    /// Column with the name of the trial of a row.
    pub group: Option<String>,
    /// Columns of the fields, in their order.
    pub columns: Vec<String>,
    /// A single frame, with the fields.
    pub frames: Arc<FrameSet>,
}

impl TableWire {
    /// Reads `node`; `values` belong to the links.
    pub(super) fn read(node: &Node, device: &Device, values: Vec<ValueSpec>) -> Result<TableWire, ConfigurationError> {
        node.only(&["time", "start", "delimiter", "group", "fields"])?;
        let has = |key: &str| node.keys().contains(&key);
        let delimiter = if has("delimiter") { node.choice("delimiter", &DELIMITERS)? } else { "," };
        let own = node.tables("fields")?;
        let mut fields = Fields::new(device, values);
        let (mut frame, mut columns) = (Frame::new("TABLE", COLUMN_BYTES * own.len()), Vec::new());
        for (index, node) in own.iter().enumerate() {
            columns.push(column(node, "column")?);
            let place = BitField::bytes(COLUMN_BYTES * index, number(node)?);
            frame.fields.push(fields.field(node, place, &PLAIN, &["column", "type"])?);
        }
        fields.set.frames.push(frame);
        fields.check(node, "fields")?;
        let expected = "expected `time`, { column = TEXT, unit = UNIT }, got none".to_owned();
        Ok(TableWire {
            delimiter: delimiter.chars().next().unwrap_or(','),
            time: time(node, "time")?.ok_or_else(|| node.error("time", expected))?,
            start: time(node, "start")?,
            group: has("group").then(|| column(node, "group")).transpose()?,
            columns,
            frames: Arc::new(fields.set),
        })
    }

    /// Names of all columns.
    pub fn titles(&self) -> impl Iterator<Item = &String> {
        let times = [Some(&self.time), self.start.as_ref()].into_iter().flatten();
        times.map(|time| &time.column).chain(&self.group).chain(&self.columns)
    }
}

/// The name of a column, short enough that messages quote it.
fn column(node: &Node, key: &str) -> Result<String, ConfigurationError> {
    match node.text(key)? {
        name if (1..=MAX_QUOTED).contains(&name.len()) => Ok(name.to_owned()),
        _ => Err(node.unexpected(key, &format!("a name of 1 to {MAX_QUOTED} bytes"))),
    }
}

fn time(parent: &Node, key: &str) -> Result<Option<TimeColumn>, ConfigurationError> {
    let Some(node) = parent.table(key)? else { return Ok(None) };
    node.only(&["column", "unit"])?;
    let unit = node.choice("unit", &TIME_UNITS.iter().map(|(name, _)| *name).collect::<Vec<_>>())?;
    let (unit, size_s) = *TIME_UNITS.iter().find(|(name, _)| *name == unit).unwrap_or(&TIME_UNITS[0]);
    Ok(Some(TimeColumn { column: column(&node, "column")?, unit, unit_ns: (size_s * 1e9).round() as i64 }))
}

/// The type of a column's numbers; without one a real number, or a whole one for the sequence.
fn number(node: &Node) -> Result<Number, ConfigurationError> {
    let name = match node.keys().contains(&"type") {
        true => node.choice("type", &TYPES)?,
        false if node.text("value").is_ok_and(|value| value == "sequence") => "u32",
        false => "f64",
    };
    let number = Number::from_name(name).or_else(|| Number::from_name(&format!("{name}be")));
    number.ok_or_else(|| node.unexpected("type", "a type"))
}
