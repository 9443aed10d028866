//! The JSON schema of a configuration, made from the same numbers that read it.

use geu_protocol::Gyro;
use serde_json::{Map, Value, json};

use super::fault::{EXPECT_NUMBERS, FAULT_NUMBERS, FAULT_TEXTS};
use super::{
    CAN_BASE, Configuration, DURATION, ENDED_EARLY, LinkLogFormat, PSI, SERIAL_BAUD, START, THETA, TRUTH, UNFINISHED,
};
use crate::attitude::{LimitCycle, Manoeuvre, TruthNumbers};
use crate::course::{KINDS, Size};
use crate::effect::discovered::{self, Regressor};
use crate::effect::{Effects, GyroEffects, UnitEffects, WiringEffects};
use crate::fault::catalogue::{CATALOGUE, Scope, Transport};
use crate::fault::{ParameterRef, shape};
use crate::number::{DefaultValue, ParameterSet, ParameterSpec, ValueFormat};
use crate::package::{Axes, Calibration};
use crate::sensor::SensorNumbers;
use crate::temperature::Electronics;

impl Configuration {
    /// The schema (JSON Schema 2020-12).
    pub fn schema() -> Value {
        let gyros: Map<String, Value> = Gyro::ALL
            .into_iter()
            .map(|gyro| {
                let has = |name: &str| Axes::of(gyro).has_number(name);
                let mut properties = effects::<GyroEffects>(&has);
                properties.extend(effects::<WiringEffects>(&has));
                properties.insert("calibration".to_owned(), table(&Calibration::default(), &has));
                properties.insert(discovered::CODE.to_owned(), discovered_terms());
                (gyro.name().to_owned(), object(properties, &[]))
            })
            .collect();
        let command = json!({ "half_second": { "type": "integer", "minimum": 0 }, "link": { "type": "string" }, "bytes": { "type": "string" } });
        let sensors = SensorNumbers::default();
        let sensors: Map<String, Value> = SensorNumbers::KEYS
            .into_iter()
            .enumerate()
            .map(|(index, (key, title))| {
                let mut schema = table(sensors.numbers(index), &|_| true);
                schema["description"] = json!(title);
                (key.to_owned(), schema)
            })
            .collect();
        let properties = json!({
            "seed": { "type": "integer", "minimum": 0, "default": 1 },
            START.name: number(&START),
            "scenario": object(map(json!({
                THETA.name: number(&THETA),
                PSI.name: number(&PSI),
                "limit_cycle": table(&LimitCycle::default(), &|_| true),
            })), &[]),
            "manoeuvre": { "type": "array", "items": { "oneOf": manoeuvres() } },
            TRUTH: table(&TruthNumbers::default(), &|_| true),
            "temperature": object(map(json!({
                "electronics": table(&Electronics::default(), &|_| true),
                "electronics_table": { "type": "array", "items": { "type": "array", "prefixItems": [{ "type": "number" }, { "type": "number" }], "items": false } },
            })), &[]),
            "unit": object(effects::<UnitEffects>(&|_| true), &[]),
            "gyro": object(gyros, &[]),
            "sensors": object(sensors, &[]),
            "fault": { "type": "array", "items": { "oneOf": faults() } },
            "expect": { "type": "array", "items": expectation() },
            "run": object(map(json!({
                DURATION.name: number(&DURATION),
                "wire": { "enum": LinkLogFormat::NAMES },
                "links": { "type": "array", "items": { "enum": Transport::NAMES } },
                UNFINISHED: { "type": "boolean", "description": "the recording has no end yet: duration and commands stand in the files beside it" },
                ENDED_EARLY: object(map(json!({ "half_second": { "type": "integer", "minimum": 0 }, "reason": { "type": "string" } })), &["half_second", "reason"]),
                SERIAL_BAUD.name: number(&SERIAL_BAUD),
                CAN_BASE.name: number(&CAN_BASE),
                "injected": { "type": "array", "items": { "type": "string" }, "description": "faults injected while it ran" },
                "truth": { "type": "string", "description": "truth: a file (reference.csv, CCSDS AEM, received.csv) or, for geu run, udp://, tcp:// or 42://HOST:PORT" },
                "command": { "type": "array", "items": object(map(command), &["half_second", "link", "bytes"]) },
            })), &[]),
        });
        let mut schema = object(map(properties), &[]);
        schema["$schema"] = json!("https://json-schema.org/draft/2020-12/schema");
        schema["title"] = json!("GEU configuration");
        schema
    }
}

fn map(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(map) => map,
        _ => unreachable!("written as an object"),
    }
}

fn object(properties: Map<String, Value>, required: &[&str]) -> Value {
    let mut object = json!({ "type": "object", "additionalProperties": false, "properties": properties });
    if !required.is_empty() {
        object["required"] = json!(required);
    }
    object
}

fn limited(form: ValueFormat, least: f64, greatest: f64, meaning: &str) -> Value {
    let mut schema = match form {
        ValueFormat::Real => json!({ "type": "number" }),
        ValueFormat::Flag => json!({ "type": "boolean" }),
        ValueFormat::Gyro => json!({ "enum": Gyro::ALL.map(Gyro::name) }),
        ValueFormat::Whole => json!({ "type": "integer" }),
        ValueFormat::Choice(names) => json!({ "enum": names }),
    };
    schema["description"] = json!(meaning.trim());
    // JSON has no infinities: such a limit is none.
    for (key, limit) in [("minimum", least), ("maximum", greatest)] {
        if matches!(form, ValueFormat::Real | ValueFormat::Whole) && limit.is_finite() {
            schema[key] = json!(limit);
        }
    }
    schema
}

fn number(spec: &ParameterSpec) -> Value {
    let mut schema = limited(spec.form, spec.least, spec.greatest, spec.meaning);
    match (spec.form, spec.default) {
        (ValueFormat::Real, DefaultValue::Value(value)) if value.is_finite() => schema["default"] = json!(value),
        (ValueFormat::Whole, DefaultValue::Value(value)) => schema["default"] = json!(value as i64),
        (ValueFormat::Choice(names), DefaultValue::Value(value)) => schema["default"] = json!(names[value as usize]),
        (ValueFormat::Flag, DefaultValue::Value(value)) => schema["default"] = json!(value != 0.0),
        _ => {}
    }
    schema
}

fn table(numbers: &dyn ParameterSet, has: &dyn Fn(&str) -> bool) -> Value {
    let specs: Vec<&ParameterSpec> = numbers.specs().iter().filter(|spec| has(spec.name)).collect();
    let required: Vec<&str> =
        specs.iter().filter(|spec| spec.default == DefaultValue::Required).map(|spec| spec.name).collect();
    object(specs.iter().map(|spec| (spec.name.to_owned(), number(spec))).collect(), &required)
}

fn effects<E: Effects>(has: &dyn Fn(&str) -> bool) -> Map<String, Value> {
    let list = E::default();
    let mut properties = Map::new();
    for (index, spec) in list.specs().iter().enumerate() {
        let numbers = list.numbers(index);
        let mut schema = table(numbers, has);
        schema["description"] = json!(format!("{}; paper: {} ({})", spec.title, spec.paper, spec.source));
        properties.insert(spec.code.to_owned(), schema);
        for kind in KINDS {
            let mut course = Map::new();
            for amplitude in (0..spec.amplitudes.len()).filter(|&amplitude| has(numbers.specs()[amplitude].name)) {
                if let Some(Size { name, form, least, greatest }) = kind.size(spec, numbers.specs(), amplitude) {
                    course.insert(name, limited(form, least, greatest, kind.meaning));
                }
            }
            if course.is_empty() {
                continue;
            }
            course.extend(kind.shapes.iter().map(|shape| (shape.name.to_owned(), number(shape))));
            let required: Vec<&str> = kind
                .shapes
                .iter()
                .filter(|shape| shape.default == DefaultValue::Required)
                .map(|shape| shape.name)
                .collect();
            properties.insert(format!("{}{}", spec.code, kind.suffix), object(course, &required));
        }
    }
    properties
}

fn discovered_terms() -> Value {
    let names = Regressor::ALL.map(|regressor| regressor.name().replace('(', "\\(").replace(')', "\\)")).join("|");
    let factor = format!(" *({names}) *(\\^ *[123] *)?");
    let (coefficient, formula) = (
        discovered::COEFFICIENT,
        json!({
            "type": "string",
            "description": discovered::FORMULA_MEANING,
            "pattern": format!("^{factor}(\\*{factor})*$"),
        }),
    );
    let term = json!({ "formula": formula, coefficient.name: number(&coefficient) });
    json!({
        "type": "array",
        "description": discovered::TITLE,
        "maxItems": discovered::MOST_TERMS,
        "items": object(map(term), &["formula", coefficient.name]),
    })
}

/// What every fault may say of when and how long.
fn common() -> Map<String, Value> {
    let texts = FAULT_TEXTS
        .iter()
        .map(|(key, meaning)| ((*key).to_owned(), json!({ "type": "string", "description": meaning })));
    let numbers = FAULT_NUMBERS.iter().map(|spec| (spec.name.to_owned(), number(spec)));
    texts.chain(numbers).chain([("seed".to_owned(), json!({ "type": "integer", "minimum": 0 }))]).collect()
}

fn gyro_names(gyros: &[Gyro]) -> Value {
    json!({ "enum": gyros.iter().map(|gyro| gyro.name()).collect::<Vec<_>>() })
}

/// One schema for each parameter and each fault that has a name.
pub fn faults() -> Vec<Value> {
    let parameters = ParameterRef::all().into_iter().map(|target| {
        let (least, greatest) = target.limits();
        let courses: Vec<Value> = shape::KINDS
            .iter()
            .filter(|kind| !target.is_switch() || kind.name == "step")
            .map(|kind| {
                let mut properties: Map<String, Value> =
                    kind.numbers.iter().map(|spec| (spec.name.to_owned(), number(spec))).collect();
                let required: Vec<&str> = std::iter::once(kind.name)
                    .chain(
                        kind.numbers.iter().filter(|spec| spec.default == DefaultValue::Required).map(|spec| spec.name),
                    )
                    .collect();
                properties.insert(kind.name.to_owned(), limited(target.number().form, least, greatest, kind.meaning));
                object(properties, &required)
            })
            .collect();
        let mut properties = common();
        properties.insert("parameter".to_owned(), json!({ "const": target.name() }));
        properties.insert("course".to_owned(), json!({ "oneOf": courses }));
        let mut required = vec!["parameter", "course"];
        if !target.gyros().is_empty() {
            properties.insert("gyro".to_owned(), gyro_names(&target.gyros()));
            required.push("gyro");
        }
        object(properties, &required)
    });
    let possible = CATALOGUE.iter().filter(|spec| !spec.links().is_empty());
    let named = possible.map(|spec| {
        let mut properties = common();
        properties.remove("release_s");
        properties.insert("fault".to_owned(), json!({ "const": spec.code, "description": spec.meaning }));
        properties.extend(spec.numbers.iter().map(|spec| (spec.name.to_owned(), number(spec))));
        let mut required = vec!["fault"];
        required
            .extend(spec.numbers.iter().filter(|spec| spec.default == DefaultValue::Required).map(|spec| spec.name));
        match spec.scope {
            Scope::Gyro => {
                properties.insert("gyro".to_owned(), gyro_names(&Gyro::ALL));
                required.push("gyro");
            }
            Scope::Link => {
                let names: Vec<&str> = spec.links().into_iter().map(Transport::name).collect();
                properties.insert("link".to_owned(), json!({ "enum": names }));
            }
            Scope::Unit => {}
        }
        object(properties, &required)
    });
    parameters.chain(named).collect()
}

fn expectation() -> Value {
    let mut properties: Map<String, Value> =
        EXPECT_NUMBERS.iter().map(|spec| (spec.name.to_owned(), number(spec))).collect();
    for (key, meaning) in [
        ("id", "its own in the plan"),
        ("after", "from the first start of this fault on"),
        ("condition", "what must hold"),
    ] {
        properties.insert(key.to_owned(), json!({ "type": "string", "description": meaning }));
    }
    let mut schema = object(properties, &["condition"]);
    schema["oneOf"] = json!([{ "required": ["within_s"] }, { "required": ["throughout_s"] }]);
    schema
}

fn manoeuvres() -> Vec<Value> {
    Manoeuvre::KINDS
        .iter()
        .map(|(kind, title)| {
            let manoeuvre = Manoeuvre::of_kind(kind).expect("one of the kinds");
            let mut schema = table(manoeuvre.numbers(), &|_| true);
            schema["properties"]["kind"] = json!({ "const": kind });
            schema["description"] = json!(title);
            let mut required = vec![json!("kind")];
            required.extend(schema["required"].as_array().into_iter().flatten().cloned().collect::<Vec<_>>());
            schema["required"] = Value::Array(required);
            schema
        })
        .collect()
}
