//! The description of a CSV of gyros.

use geu_model::configuration::{ConfigText, ConfigurationError, Node};
use geu_model::parameter_spec::{DefaultValue, ParameterSpec, ValueFormat, number};
use geu_model::units::{ANGLE_UNITS, RATE_UNITS, TIME_UNITS};
use geu_protocol::excerpt::MAX_QUOTED;

const AXES: [&str; 9] = ["X", "Y", "Z", "+X", "+Y", "+Z", "-X", "-Y", "-Z"];
const INTERVAL: ParameterSpec =
    number("interval_s", "s", ValueFormat::Real, DefaultValue::Required, 1e-6, 1e6, "nominal interval of the rows");
const COUNTS: ParameterSpec = number(
    "counts_per_unit",
    "",
    ValueFormat::Real,
    DefaultValue::Value(1.0),
    1e-12,
    1e12,
    "counts in one unit (LSB per unit) where the column holds counts",
);

/// One gyro's column.
#[derive(Debug, Clone, PartialEq)]
pub struct GyroColumn {
    pub name: String,
    pub column: String,
    /// Axis: 0 X, 1 Y, 2 Z. Its sign is in `scale_arcsec_s`.
    pub axis: usize,
    /// Rate of one unit of the column, arcsec/s.
    pub scale_arcsec_s: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct GyroCsvSpec {
    pub time_column: String,
    /// Unit of the time, s.
    pub time_scale_s: f64,
    pub interval_s: f64,
    pub delimiter: u8,
    /// Gyros, in the order in which they are described.
    pub gyros: Vec<GyroColumn>,
    /// Table of windows with reference rates, if described.
    pub reference: Option<ReferenceTable>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct RateColumn {
    pub column: String,
    /// Rate of one unit of the column, arcsec/s.
    pub scale_arcsec_s: f64,
}

/// A table of windows: mean rates of the gyros and an independent rate.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceTable {
    /// Column of the group of a window, such as a day.
    pub group: Option<String>,
    /// The independent rate: its magnitude, or about X, Y and Z.
    pub rates: Vec<RateColumn>,
    /// Mean rate of each gyro about its axis, in the order of [`GyroCsvSpec::gyros`].
    pub gyros: Vec<RateColumn>,
    /// Note to print wherever it is used.
    pub caveat: Option<String>,
}

impl GyroCsvSpec {
    /// Reads a description; errors call it `name`.
    ///
    /// # Errors
    /// Unknown keys and units, missing columns, no gyro; with the line.
    pub fn parse(name: &str, text: &str) -> Result<GyroCsvSpec, ConfigurationError> {
        let source = ConfigText::parse(name, text)?;
        let root = source.root();
        root.only(&["time", "gyro", "delimiter", "reference"])?;
        let delimiter = match root.keys().contains(&"delimiter") {
            true => root.choice("delimiter", &[",", ";", "\t", "|", " "])?.as_bytes()[0],
            false => b',',
        };
        let missing = |table: &str| root.error(table, format!("expected a table [{table}], got none"));
        let time = root.table("time")?.ok_or_else(|| missing("time"))?;
        time.only(&["column", "unit", INTERVAL.name])?;
        let time_scale_s = unit(&time, TIME_UNITS)?;
        let interval_s = time.number(&INTERVAL)?;
        let gyro = root.table("gyro")?.ok_or_else(|| missing("gyro.NAME"))?;
        if let Some(name) = gyro.keys().into_iter().find(|name| name.len() > MAX_QUOTED) {
            return Err(gyro.error(name, format!("expected a name of at most {MAX_QUOTED} bytes, got {}", name.len())));
        }
        let gyros = gyro.keys().into_iter().map(|name| read_gyro(&gyro, name, interval_s));
        let gyros = gyros.collect::<Result<Vec<_>, _>>()?;
        if gyros.is_empty() {
            return Err(missing("gyro.NAME"));
        }
        Ok(GyroCsvSpec {
            time_column: column(&time, "column")?,
            time_scale_s,
            interval_s,
            delimiter,
            reference: match root.table("reference")? {
                Some(node) => Some(read_reference(&node, &gyros)?),
                None => None,
            },
            gyros,
        })
    }
}

fn read_reference(node: &Node, gyros: &[GyroColumn]) -> Result<ReferenceTable, ConfigurationError> {
    node.only(&["group", "caveat", "rate", "rate_x", "rate_y", "rate_z", "gyro"])?;
    let has = |key: &str| node.keys().contains(&key);
    let has_vector = node.keys().iter().any(|key| key.starts_with("rate_"));
    if has_vector && node.keys().contains(&"rate") {
        return Err(node.error("rate", "expected `rate`, or `rate_x`, `rate_y` and `rate_z`, got both".to_owned()));
    }
    let names: &[&str] = if has_vector { &["rate_x", "rate_y", "rate_z"] } else { &["rate"] };
    let of_gyro = node.table("gyro")?;
    let of_gyro = of_gyro.ok_or_else(|| node.error("gyro", "expected tables gyro.NAME, got none".to_owned()))?;
    of_gyro.only(&gyros.iter().map(|gyro| gyro.name.as_str()).collect::<Vec<_>>())?;
    Ok(ReferenceTable {
        group: has("group").then(|| column(node, "group")).transpose()?,
        caveat: has("caveat").then(|| node.text("caveat").map(str::to_owned)).transpose()?,
        rates: names.iter().map(|name| read_rate(node, name)).collect::<Result<_, _>>()?,
        gyros: gyros.iter().map(|gyro| read_rate(&of_gyro, &gyro.name)).collect::<Result<_, _>>()?,
    })
}

/// The name of a column, short enough that messages quote it.
fn column(node: &Node, key: &str) -> Result<String, ConfigurationError> {
    match node.text(key)? {
        name if name.len() <= MAX_QUOTED => Ok(name.to_owned()),
        _ => Err(node.unexpected(key, &format!("a name of at most {MAX_QUOTED} bytes"))),
    }
}

/// Size of the unit under `unit`, from these.
fn unit(node: &Node, units: &[(&str, f64)]) -> Result<f64, ConfigurationError> {
    let name = node.choice("unit", &units.iter().map(|(name, _)| *name).collect::<Vec<_>>())?;
    Ok(units.iter().find(|(own, _)| *own == name).map_or(1.0, |(_, size)| *size))
}

fn read_rate(parent: &Node, key: &str) -> Result<RateColumn, ConfigurationError> {
    let path = parent.path_of(key);
    let missing = || parent.error(key, format!("expected `{path}`, {{ column = TEXT, unit = UNIT }}, got none"));
    let node = parent.table(key)?.ok_or_else(missing)?;
    node.only(&["column", "unit"])?;
    let scale_arcsec_s = unit(&node, RATE_UNITS)?;
    Ok(RateColumn { column: column(&node, "column")?, scale_arcsec_s })
}

fn read_gyro(all: &Node, name: &str, interval_s: f64) -> Result<GyroColumn, ConfigurationError> {
    let missing = || all.error(name, format!("expected a table [gyro.{name}]"));
    let node = all.table(name)?.ok_or_else(missing)?;
    node.only(&["column", "axis", "unit", COUNTS.name])?;
    let size = unit(&node, &[RATE_UNITS, ANGLE_UNITS].concat())?;
    let is_angle = ANGLE_UNITS.iter().any(|(name, _)| node.text("unit").is_ok_and(|unit| unit == *name));
    let axis = node.choice("axis", &AXES)?;
    let sign = if axis.starts_with('-') { -1.0 } else { 1.0 };
    let axis = AXES.iter().position(|name| *name == axis).unwrap_or(0) % 3;
    let per_second = if is_angle { 1.0 / interval_s } else { 1.0 };
    let scale_arcsec_s = sign * size * per_second / node.number(&COUNTS)?;
    Ok(GyroColumn { name: name.to_owned(), column: column(&node, "column")?, axis, scale_arcsec_s })
}
