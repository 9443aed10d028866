//! The configuration as a tree of fields with their values in place: the one list that reading, display and schema walk.
//!
//! Most fields are numbers, which their specifications describe. A field with a form of its own is a [`Part`].

use geu_protocol::Gyro;
use serde_json::{Map, Value as Json, json};

use super::document::{Node, Read};
use super::effects::EffectTables;
use super::fault::{EXPECT, FAULT};
use super::plan::Plan;
use super::{Configuration, schema};
use crate::device::Device;
use crate::effect::{EffectSpec, discovered};
use crate::package::Axes;
use crate::parameter_spec::{DefaultValue, ParameterSet, ParameterSpec, REAL, ValueFormat, number};
use crate::time_profile::{COURSES, TimeProfileSpec};

pub(super) const THETA: ParameterSpec =
    number("theta_deg", "°", REAL, DefaultValue::Value(90.0), 60.0, 120.0, "solar aspect angle at the start");
pub(super) const PSI: ParameterSpec =
    number("psi_deg", "°", REAL, DefaultValue::Value(0.0), -360.0, 360.0, "angle about the sun vector at the start");

/// A key of a table with its value.
pub(super) struct Field<'a> {
    key: &'static str,
    value: Value<'a>,
}

enum Value<'a> {
    /// A number.
    Number(&'static ParameterSpec, &'a mut f64),
    /// An inline table of numbers that a gyro with these axes has. `true`: its schema has the title.
    Numbers { title: (&'static str, bool), numbers: &'a mut dyn ParameterSet, axes: Option<Axes>, device: &'a Device },
    /// A table with a header.
    Table(Vec<Field<'a>>),
    /// A form of its own.
    Part(Box<dyn Part + 'a>),
}

/// A field that is read, displayed and described in a form of its own.
pub(super) trait Part {
    /// Reads the value from the table that can have the key.
    ///
    /// # Errors
    /// The first error, with its place.
    fn read(&mut self, node: &Node, key: &str) -> Read<()>;
    /// Appends the TOML of the value; `complete` adds comments and absent values.
    fn show(&self, key: &str, complete: bool, text: &mut String);
    /// JSON schemas of the keys.
    fn schema(&self, key: &str) -> Map<String, Json>;
    /// Effects whose codes are keys, instead of a single key.
    fn effects(&self) -> &'static [EffectSpec] {
        &[]
    }
}

/// Appends a formatted line.
macro_rules! line {
    ($text:expr, $($content:tt)*) => {{
        use std::fmt::Write;
        writeln!($text, $($content)*).expect("a string takes everything");
    }};
}
pub(super) use line;

impl Configuration {
    /// The fields in the order of display.
    pub(super) fn tree(&mut self) -> Vec<Field<'_>> {
        let Configuration { scenario, electronics, sensors, device, gyros, .. } = self;
        let device = &**device;
        let gyros = device.heads.iter().zip(gyros).map(|(head, own)| {
            let axes = Some(head.axes);
            let title = ("the unit's own parameters, and the believed ones", false);
            let fields = vec![
                Field {
                    key: "calibration",
                    value: Value::Numbers { title, numbers: &mut own.calibration, axes, device },
                },
                part(discovered::CODE, &mut own.discovered),
                part("", EffectTables { configured: &mut own.effects, axes, device }),
                part("", EffectTables { configured: &mut own.wiring, axes, device }),
            ];
            table(head.gyro.name(), fields)
        });
        let gyros = gyros.collect();
        vec![
            part("device", device),
            part("seed", &mut self.seed),
            part("start_unix_s", &mut self.start_unix_ns),
            table(
                "scenario",
                vec![
                    Field { key: THETA.name, value: Value::Number(&THETA, &mut scenario.theta_deg) },
                    Field { key: PSI.name, value: Value::Number(&PSI, &mut scenario.psi_deg) },
                    numbers("limit_cycle", ("limit cycle about X and Y", false), &mut scenario.limit_cycle, device),
                ],
            ),
            part("manoeuvre", &mut scenario.manoeuvres),
            part("motion", &mut self.motion),
            part("truth", &mut self.truth),
            table(
                "temperature",
                vec![
                    numbers("electronics", ("electronics temperature", false), &mut electronics.numbers, device),
                    part("electronics_table", &mut electronics.table),
                ],
            ),
            table("unit", vec![part("", EffectTables { configured: &mut self.unit, axes: None, device })]),
            table("gyro", gyros),
            table(
                "sensors",
                vec![
                    numbers(
                        "fss",
                        ("Fine Sun Sensor: two axes, 2 Hz (Casteren §1, §6)", true),
                        &mut sensors.fss,
                        device,
                    ),
                    numbers(
                        "sse",
                        ("slit star sensor: fixes at the reference times (Casteren §5)", true),
                        &mut sensors.sse,
                        device,
                    ),
                ],
            ),
            part(FAULT, Plan { device, faults: &self.faults, expectations: &self.expectations }),
            part(EXPECT, Plan { device, faults: &self.faults, expectations: &self.expectations }),
            part("run", &mut self.run),
        ]
    }
}

fn table<'a>(key: &'static str, fields: Vec<Field<'a>>) -> Field<'a> {
    Field { key, value: Value::Table(fields) }
}

fn numbers<'a>(
    key: &'static str,
    title: (&'static str, bool),
    numbers: &'a mut dyn ParameterSet,
    device: &'a Device,
) -> Field<'a> {
    Field { key, value: Value::Numbers { title, numbers, axes: None, device } }
}

fn part<'a>(key: &'static str, part: impl Part + 'a) -> Field<'a> {
    Field { key, value: Value::Part(Box::new(part)) }
}

/// True if a gyro with these axes has the number; all of the unit's numbers exist.
pub(super) fn has(axes: Option<&Axes>, name: &str) -> bool {
    axes.is_none_or(|axes| axes.has_number(name))
}

/// The effect that a key names, and its time course if the key has a suffix.
pub(super) fn named_effect(key: &str, specs: &[EffectSpec]) -> Option<(usize, Option<&'static TimeProfileSpec>)> {
    let index = |code: &str| specs.iter().position(|spec| spec.code == code);
    index(key)
        .map(|effect| (effect, None))
        .or_else(|| COURSES.iter().find_map(|kind| Some((index(key.strip_suffix(kind.name)?)?, Some(*kind)))))
}

impl Field<'_> {
    fn effects(&self) -> &'static [EffectSpec] {
        if let Value::Part(part) = &self.value { part.effects() } else { &[] }
    }
}

/// Reads the fields of a table; defaults remain for absent keys.
///
/// # Errors
/// An unknown key, or the first error of a field.
pub(super) fn read(fields: &mut [Field], node: &Node) -> Read<()> {
    let is_known = |field: &Field, key: &str| field.key == key || named_effect(key, field.effects()).is_some();
    if let Some(key) = node.keys().into_iter().find(|key| !fields.iter().any(|field| is_known(field, key))) {
        let codes = fields.iter().flat_map(|field| field.effects().iter().map(|spec| spec.code));
        let keys = fields.iter().map(|field| field.key).filter(|key| !key.is_empty());
        let mut error = node.unknown(key, &keys.chain(codes.clone()).collect::<Vec<_>>());
        if codes.count() > 0 {
            let suffixes: Vec<&str> = COURSES.iter().map(|kind| kind.name).collect();
            error.message += &format!("; an effect may have {} behind it", suffixes.join(", "));
        }
        return Err(error);
    }
    for Field { key, value } in fields {
        match value {
            Value::Number(spec, place) => **place = node.number(spec)?,
            Value::Part(part) => part.read(node, key)?,
            Value::Numbers { numbers, axes, .. } => {
                if let Some(node) = node.table(key)? {
                    node.fill(*numbers, |name| has(axes.as_ref(), name), &[])?;
                }
            }
            Value::Table(fields) => {
                if let Some(node) = node.table(key)? {
                    read(fields, &node)?;
                }
            }
        }
    }
    Ok(())
}

/// Appends the fields of the table at `path` as TOML; `complete` adds comments and absent values.
pub(super) fn show(fields: &[Field], path: &str, complete: bool, text: &mut String) {
    for Field { key, value } in fields {
        match value {
            Value::Number(spec, value) => {
                let comment = comment(complete, &format!("{} ({})", spec.meaning, spec.limits()));
                line!(text, "{key} = {value:?}{comment}");
            }
            Value::Numbers { title: (title, _), numbers, axes, device } => {
                show_numbers(text, complete, key, title, *numbers, |name| has(axes.as_ref(), name), device);
            }
            Value::Table(fields) => {
                let path = if path.is_empty() { (*key).to_owned() } else { format!("{path}.{key}") };
                if !fields.iter().all(|field| matches!(field.value, Value::Table(_))) {
                    line!(text, "\n[{path}]");
                }
                show(fields, &path, complete, text);
            }
            Value::Part(part) => part.show(key, complete, text),
        }
    }
}

/// The JSON schema of a table with these fields.
pub(super) fn schema(fields: &[Field]) -> Json {
    let mut properties = Map::new();
    for Field { key, value } in fields {
        let schema = match value {
            Value::Number(spec, _) => schema::number(spec),
            Value::Numbers { title: (title, is_shown), numbers, axes, .. } => {
                let mut schema = schema::table(*numbers, &|name| has(axes.as_ref(), name));
                if *is_shown {
                    schema["description"] = json!(title);
                }
                schema
            }
            Value::Table(fields) => self::schema(fields),
            Value::Part(part) => {
                properties.extend(part.schema(key));
                continue;
            }
        };
        properties.insert((*key).to_owned(), schema);
    }
    schema::object(properties, &[])
}

/// A comment behind a value, in a complete display.
pub(super) fn comment(complete: bool, meaning: &str) -> String {
    if complete { format!("  # {}", meaning.trim()) } else { String::new() }
}

/// The numbers that have a value.
pub(super) fn present(numbers: &dyn ParameterSet) -> impl Iterator<Item = (&'static ParameterSpec, f64)> {
    let values: Vec<_> = numbers.specs().iter().enumerate().map(|(index, spec)| (spec, numbers.value(index))).collect();
    values.into_iter().filter(|(_, value)| !value.is_nan())
}

/// The inline table of the numbers.
pub(super) fn inline(numbers: &dyn ParameterSet, has: impl Fn(&str) -> bool, device: &Device) -> String {
    let gyros: Vec<Gyro> = device.gyros().collect();
    let pairs: Vec<String> = present(numbers)
        // A gyro number of 0 has no name to write.
        .filter(|(number, value)| has(number.name) && (number.form != ValueFormat::Gyro || *value != 0.0))
        .map(|(number, value)| format!("{} = {}", number.name, number.form.written_of(value, &gyros)))
        .collect();
    format!("{{ {} }}", pairs.join(", "))
}

/// Comment lines with meaning and limits of each number.
pub(super) fn describe<'a>(text: &mut String, specs: impl IntoIterator<Item = &'a ParameterSpec>) {
    for spec in specs {
        line!(text, "#   {}: {} ({})", spec.name, spec.meaning, spec.limits());
    }
}

/// The inline table under `key`, with title and description in a complete display.
pub(super) fn show_numbers(
    text: &mut String,
    complete: bool,
    key: &str,
    title: &str,
    numbers: &dyn ParameterSet,
    has: impl Fn(&str) -> bool,
    device: &Device,
) {
    if complete {
        line!(text, "# {title}");
        for spec in numbers.specs().iter().filter(|spec| has(spec.name)) {
            let (min, max) = device.widening().limits(spec, spec.min, spec.max);
            let limits = match spec.form {
                ValueFormat::Gyro => ValueFormat::limits_of(&device.gyros().map(Gyro::name).collect::<Vec<_>>()),
                form => form.limits(min, max),
            };
            line!(text, "#   {}: {} ({limits})", spec.name, spec.meaning);
        }
    }
    line!(text, "{key} = {}", inline(numbers, has, device));
}

/// A text as TOML.
pub(super) fn quoted(text: &str) -> String {
    toml_edit::Value::from(text).to_string()
}

/// A table with one schema.
pub(super) fn one(key: &str, schema: Json) -> Map<String, Json> {
    Map::from_iter([(key.to_owned(), schema)])
}
