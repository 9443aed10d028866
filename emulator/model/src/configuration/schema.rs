//! The JSON schema of a configuration, made from the same numbers that read it.

use geu_protocol::Gyro;
use serde_json::{Map, Value, json};

use super::{Configuration, DURATION, PSI, START, THETA, WireForm};
use crate::attitude::{LimitCycle, Manoeuvre};
use crate::course::{KINDS, Size};
use crate::effect::discovered::{self, Regressor};
use crate::effect::{Effects, HeadEffects, UnitEffects, WiringEffects};
use crate::number::{Default, Form, Number, Numbers};
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
                let mut properties = effects::<HeadEffects>(&has);
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
            "temperature": object(map(json!({
                "electronics": table(&Electronics::default(), &|_| true),
                "electronics_table": { "type": "array", "items": { "type": "array", "prefixItems": [{ "type": "number" }, { "type": "number" }], "items": false } },
            })), &[]),
            "unit": object(effects::<UnitEffects>(&|_| true), &[]),
            "gyro": object(gyros, &[]),
            "sensors": object(sensors, &[]),
            "run": object(map(json!({
                DURATION.name: number(&DURATION),
                "wire": { "enum": WireForm::NAMES },
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

fn limited(form: Form, least: f64, greatest: f64, meaning: &str) -> Value {
    let mut schema = match form {
        Form::Real => json!({ "type": "number" }),
        Form::Flag => json!({ "type": "boolean" }),
        Form::Gyro => json!({ "enum": Gyro::ALL.map(Gyro::name) }),
    };
    schema["description"] = json!(meaning.trim());
    // JSON has no infinities: such a limit is none.
    for (key, limit) in [("minimum", least), ("maximum", greatest)] {
        if form == Form::Real && limit.is_finite() {
            schema[key] = json!(limit);
        }
    }
    schema
}

fn number(spec: &Number) -> Value {
    let mut schema = limited(spec.form, spec.least, spec.greatest, spec.meaning);
    match (spec.form, spec.default) {
        (Form::Real, Default::Value(value)) if value.is_finite() => schema["default"] = json!(value),
        (Form::Flag, Default::Value(value)) => schema["default"] = json!(value != 0.0),
        _ => {}
    }
    schema
}

fn table(numbers: &dyn Numbers, has: &dyn Fn(&str) -> bool) -> Value {
    let specs: Vec<&Number> = numbers.specs().iter().filter(|spec| has(spec.name)).collect();
    let required: Vec<&str> =
        specs.iter().filter(|spec| spec.default == Default::Required).map(|spec| spec.name).collect();
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
            let required: Vec<&str> =
                kind.shapes.iter().filter(|shape| shape.default == Default::Required).map(|shape| shape.name).collect();
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
