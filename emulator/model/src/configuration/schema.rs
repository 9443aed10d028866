//! JSON schemas from the specifications that reading uses.

use geu_protocol::Gyro;
use serde_json::{Map, Value, json};

use super::fault::{ExpectationNumbers, FAULT_TEXTS, FaultNumbers};
use crate::device::Device;
use crate::fault::ParameterRef;
use crate::fault::catalogue::{CATALOGUE, Scope, Transport};
use crate::parameter_spec::{DefaultValue, ParameterSet, ParameterSpec, ValueFormat};
use crate::time_profile::FAULT_PROFILES;

/// A table with these properties.
pub(super) fn properties<const N: usize>(properties: [(&str, Value); N], required: &[&str]) -> Value {
    object(properties.into_iter().map(|(key, schema)| (key.to_owned(), schema)).collect(), required)
}

/// Names of the numbers that are required.
pub(super) fn required<'a>(specs: impl IntoIterator<Item = &'a ParameterSpec>) -> Vec<&'static str> {
    let required = specs.into_iter().filter(|spec| spec.default == DefaultValue::Required);
    required.map(|spec| spec.name).collect()
}

pub(super) fn object(properties: Map<String, Value>, required: &[&str]) -> Value {
    let mut object = json!({ "type": "object", "additionalProperties": false, "properties": properties });
    if !required.is_empty() {
        object["required"] = json!(required);
    }
    object
}

pub(super) fn limited(form: ValueFormat, min: f64, max: f64, meaning: &str) -> Value {
    let mut schema = match form {
        // Editors convert TOML to JSON, where infinities are null.
        ValueFormat::Real if max.is_infinite() => json!({ "type": ["number", "null"] }),
        ValueFormat::Real => json!({ "type": "number" }),
        ValueFormat::Flag => json!({ "type": "boolean" }),
        ValueFormat::Gyro => json!({ "enum": Gyro::ALL.map(Gyro::name) }),
        ValueFormat::Whole => json!({ "type": "integer" }),
        ValueFormat::Choice(names) => json!({ "enum": names }),
    };
    schema["description"] = json!(meaning);
    // JSON has no infinities: such a limit is none.
    for (key, limit) in [("minimum", min), ("maximum", max)] {
        if matches!(form, ValueFormat::Real | ValueFormat::Whole) && limit.is_finite() {
            schema[key] = json!(limit);
        }
    }
    schema
}

pub(super) fn number(spec: &ParameterSpec) -> Value {
    let mut schema = limited(spec.form, spec.min, spec.max, spec.meaning);
    match (spec.form, spec.default) {
        (ValueFormat::Real, DefaultValue::Value(value)) if value.is_finite() => schema["default"] = json!(value),
        (ValueFormat::Whole, DefaultValue::Value(value)) => schema["default"] = json!(value as i64),
        (ValueFormat::Choice(names), DefaultValue::Value(value)) => schema["default"] = json!(names[value as usize]),
        (ValueFormat::Flag, DefaultValue::Value(value)) => schema["default"] = json!(value != 0.0),
        _ => {}
    }
    schema
}

pub(super) fn table(numbers: &dyn ParameterSet, has: &dyn Fn(&str) -> bool) -> Value {
    let specs: Vec<&ParameterSpec> = numbers.specs().iter().filter(|spec| has(spec.name)).collect();
    object(specs.iter().map(|spec| (spec.name.to_owned(), number(spec))).collect(), &required(specs.iter().copied()))
}

/// Keys of every fault: trigger and duration.
fn common() -> Map<String, Value> {
    let texts = FAULT_TEXTS
        .iter()
        .map(|(key, meaning)| ((*key).to_owned(), json!({ "type": "string", "description": meaning })));
    let numbers = FaultNumbers::NUMBERS.iter().map(|spec| (spec.name.to_owned(), number(spec)));
    texts.chain(numbers).chain([("seed".to_owned(), json!({ "type": "integer", "minimum": 0 }))]).collect()
}

fn gyro_names(gyros: &[Gyro]) -> Value {
    json!({ "enum": gyros.iter().map(|gyro| gyro.name()).collect::<Vec<_>>() })
}

/// One schema for each parameter and each fault that has a name.
pub(super) fn faults(device: &Device) -> Vec<Value> {
    let parameters = ParameterRef::all().into_iter().map(|target| {
        let (min, max) = target.limits();
        let courses: Vec<Value> = FAULT_PROFILES
            .iter()
            .filter(|kind| !target.is_switch() || kind.name == "step")
            .map(|kind| {
                let mut properties: Map<String, Value> =
                    kind.shapes.iter().map(|spec| (spec.name.to_owned(), number(spec))).collect();
                let required = [&[kind.name], &required(kind.shapes)[..]].concat();
                properties.insert(kind.name.to_owned(), limited(target.number().form, min, max, kind.meaning));
                object(properties, &required)
            })
            .collect();
        let mut properties = common();
        properties.insert("parameter".to_owned(), json!({ "const": target.name() }));
        properties.insert("course".to_owned(), json!({ "oneOf": courses }));
        let mut required = vec!["parameter", "course"];
        if !target.gyros(device).is_empty() {
            properties.insert("gyro".to_owned(), gyro_names(&target.gyros(device)));
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
        let mut required = [&["fault"], &required(spec.numbers)[..]].concat();
        match spec.scope {
            Scope::Gyro => {
                properties.insert("gyro".to_owned(), gyro_names(&device.gyros().collect::<Vec<_>>()));
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

pub(super) fn expectation() -> Value {
    let mut properties: Map<String, Value> =
        ExpectationNumbers::NUMBERS.iter().map(|spec| (spec.name.to_owned(), number(spec))).collect();
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
