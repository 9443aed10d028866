//! Samples in a delimited text table: columns by their names in its first line.

use std::sync::Arc;

use geu_protocol::excerpt::MAX_QUOTED;
use geu_protocol::layout::{BitField, Frame, FrameSet, Number, ValueSpec};

use super::Device;
use super::fields::{Fields, PLAIN};
use crate::configuration::{ConfigurationError, Node};
use crate::units::{NamedUnits, RATE_UNITS, TIME_UNITS};

const DELIMITERS: [&str; 5] = [",", ";", "\t", "|", " "];
/// Types of numbers that were whole before they became text, and the default one.
const TYPES: [&str; 9] = ["u8", "i8", "u16", "i16", "u24", "i24", "u32", "i32", "f64"];
/// Bytes of a column's number in the frame of a row.
const COLUMN_BYTES: usize = 8;

/// A column and its unit.
#[derive(Debug, Clone)]
pub struct UnitColumn {
    pub column: String,
    pub unit: &'static str,
    /// Size of the unit, s or arcsec/s.
    pub size: f64,
}

impl UnitColumn {
    /// Reads `key`, `{ column = TEXT, unit = UNIT }`; `None` without it.
    fn read(parent: &Node, key: &str, units: NamedUnits) -> Result<Option<UnitColumn>, ConfigurationError> {
        let Some(node) = parent.table(key)? else { return Ok(None) };
        node.only(&["column", "unit"])?;
        let name = node.choice("unit", &units.iter().map(|(name, _)| *name).collect::<Vec<_>>())?;
        let (unit, size) = *units.iter().find(|(own, _)| *own == name).unwrap_or(&units[0]);
        Ok(Some(UnitColumn { column: column(&node, "column")?, unit, size }))
    }

    fn required(parent: &Node, key: &str, units: NamedUnits) -> Result<UnitColumn, ConfigurationError> {
        let expected = format!("expected `{}`, {{ column = TEXT, unit = UNIT }}, got none", parent.path_of(key));
        UnitColumn::read(parent, key, units)?.ok_or_else(|| parent.error(key, expected))
    }

    /// Size of a unit of time, ns: a power of ten.
    pub fn unit_ns(&self) -> i64 {
        (self.size * 1e9).round() as i64
    }
}

/// A reference beside the table of the samples: windows with mean rates of all heads and an independent magnitude of the rate.
#[derive(Debug, Clone)]
pub struct ReferenceTable {
    /// Column of the group of a window, such as a day.
    pub group: Option<String>,
    pub magnitude: UnitColumn,
    /// Mean rate of each head.
    pub rates: Vec<UnitColumn>,
    /// A remark that a diagnosis repeats.
    pub caveat: Option<String>,
}

impl ReferenceTable {
    fn read(node: &Node, device: &Device) -> Result<ReferenceTable, ConfigurationError> {
        node.only(&["group", "magnitude", "rates", "caveat"])?;
        let has = |key: &str| node.keys().contains(&key);
        let names: Vec<&str> = device.heads.iter().map(|head| head.gyro.name()).collect();
        let rates = node.table("rates")?;
        let rates =
            rates.ok_or_else(|| node.error("rates", "expected a table `rates` of heads, got none".to_owned()))?;
        rates.only(&names)?;
        Ok(ReferenceTable {
            group: has("group").then(|| column(node, "group")).transpose()?,
            magnitude: UnitColumn::required(node, "magnitude", RATE_UNITS)?,
            rates: names.iter().map(|name| UnitColumn::required(&rates, name, RATE_UNITS)).collect::<Result<_, _>>()?,
            caveat: has("caveat").then(|| node.text("caveat").map(str::to_owned)).transpose()?,
        })
    }

    /// Names of all columns.
    pub fn titles(&self) -> impl Iterator<Item = &String> {
        self.group.iter().chain(self.rates.iter().chain([&self.magnitude]).map(|own| &own.column))
    }
}

/// The samples of a unit in a table.
#[derive(Debug, Clone)]
pub struct TableWire {
    /// Separates the cells of a row; spaces separate as one.
    pub delimiter: char,
    /// End of the interval of a row.
    pub time: UnitColumn,
    /// Start of the interval; without it a row has the nominal interval.
    pub start: Option<UnitColumn>,
    /// Column with the name of the trial of a row.
    pub group: Option<String>,
    /// Columns of the fields, in their order.
    pub columns: Vec<String>,
    /// A single frame, with the fields.
    pub frames: Arc<FrameSet>,
    pub reference: Option<ReferenceTable>,
}

impl TableWire {
    /// Reads `node`; `values` belong to the links.
    pub(super) fn read(node: &Node, device: &Device, values: Vec<ValueSpec>) -> Result<TableWire, ConfigurationError> {
        node.only(&["time", "start", "delimiter", "group", "fields", "reference"])?;
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
        Ok(TableWire {
            delimiter: delimiter.chars().next().unwrap_or(','),
            time: UnitColumn::required(node, "time", TIME_UNITS)?,
            start: UnitColumn::read(node, "start", TIME_UNITS)?,
            group: has("group").then(|| column(node, "group")).transpose()?,
            columns,
            frames: Arc::new(fields.set),
            reference: node.table("reference")?.map(|node| ReferenceTable::read(&node, device)).transpose()?,
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
