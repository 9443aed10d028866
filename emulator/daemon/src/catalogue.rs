//! The catalogue of faults as JSON: what a page, or anybody who asks, can inject, with units and limits.

use geu_model::fault::catalogue::{CATALOGUE, FaultSpec, Transport};
use geu_model::fault::{ParameterRef, expression, shape};
use geu_model::number::{DefaultValue, ParameterSpec, ValueFormat};
use geu_protocol::Gyro;
use serde_json::{Map, Value, json};

use crate::control;

/// The unit of a number, which its name ends with.
fn unit(name: &str) -> &'static str {
    const UNITS: [(&str, &str); 15] = [
        ("arcsec_per_s_per_sqrt_s", "arcsec/s/√s"),
        ("arcsec_per_sqrt_s", "arcsec/√s"),
        ("arcsec_per_h_per_k", "arcsec/h/K"),
        ("arcsec_per_deg", "arcsec/°"),
        ("arcsec_per_h", "arcsec/h"),
        ("arcsec", "arcsec"),
        ("counts", "counts"),
        ("cycles", "cycles"),
        ("bytes", "byte"),
        ("bits", "bit"),
        ("seconds", "s"),
        ("ppm", "ppm"),
        ("rad", "rad"),
        ("baud", "baud"),
        ("_s", "s"),
    ];
    UNITS.iter().find(|(ending, _)| name.ends_with(ending)).map_or("", |(_, unit)| unit)
}

fn form(form: ValueFormat) -> &'static str {
    match form {
        ValueFormat::Real => "real",
        ValueFormat::Flag => "flag",
        ValueFormat::Gyro => "gyro",
        ValueFormat::Whole => "whole",
        ValueFormat::Choice(_) => "choice",
    }
}

fn number(spec: &ParameterSpec) -> Value {
    let value = |value: f64| match spec.form {
        ValueFormat::Choice(names) => json!(names.get(value as usize)),
        ValueFormat::Flag => json!(value != 0.0),
        _ => json!(value),
    };
    json!({
        "name": spec.name,
        "form": form(spec.form),
        "choices": if let ValueFormat::Choice(names) = spec.form { json!(names) } else { Value::Null },
        "least": spec.least,
        "greatest": spec.greatest,
        "required": spec.default == DefaultValue::Required,
        "default": if let DefaultValue::Value(default) = spec.default { value(default) } else { Value::Null },
        "unit": unit(spec.name),
        "meaning": spec.meaning.trim(),
    })
}

/// A number of a named fault, with what single links hold it to.
fn bounded(own: &ParameterSpec, spec: &FaultSpec) -> Value {
    let mut told = number(own);
    for bound in spec.bounds.iter().filter(|bound| bound.number == own.name) {
        let on: Map<String, Value> =
            bound.links.iter().map(|link| (link.name().to_owned(), json!(bound.most))).collect();
        told["greatest_on"] = on.into();
    }
    told
}

/// Gyros, parameters with courses, faults that have a name, commands, the words of a condition.
pub fn catalogue() -> Value {
    let names = |gyros: &[Gyro]| gyros.iter().map(|gyro| gyro.name()).collect::<Vec<_>>();
    let parameters = ParameterRef::all().into_iter().map(|target| {
        let ((least, greatest), spec) = (target.limits(), target.number());
        json!({
            "parameter": target.name(),
            "title": target.effect().title,
            "per_gyro": !target.gyros().is_empty(),
            "gyros": names(&target.gyros()),
            "form": form(spec.form),
            "least": least,
            "greatest": greatest,
            "unit": unit(spec.name),
            "meaning": spec.meaning.trim(),
        })
    });
    let courses = shape::KINDS.iter().map(|kind| {
        // The size, whose limits are the parameter's, goes by the course's name.
        let size = json!({ "name": kind.name, "form": "real", "required": true, "meaning": kind.meaning });
        let numbers: Vec<Value> = std::iter::once(size).chain(kind.numbers.iter().map(number)).collect();
        json!({ "course": kind.name, "meaning": kind.meaning, "numbers": numbers })
    });
    let faults = CATALOGUE.iter().map(|spec| {
        let links: Map<String, Value> =
            Transport::ALL.into_iter().map(|kind| (kind.name().to_owned(), json!(spec.unable_on(kind)))).collect();
        json!({
            "fault": spec.code,
            "scope": spec.scope.name(),
            "title": spec.code.replace('-', " "),
            "meaning": spec.meaning,
            "numbers": spec.numbers.iter().map(|own| bounded(own, spec)).collect::<Vec<_>>(),
            "for_s": spec.for_s,
            "links": links,
        })
    });
    let words: Vec<Value> = expression::vocabulary()
        .into_iter()
        .map(|(name, meaning)| json!({ "name": name, "meaning": meaning }))
        .collect();
    json!({
        "gyros": Gyro::ALL.map(Gyro::name),
        "parameters": parameters.collect::<Vec<_>>(),
        "courses": courses.collect::<Vec<_>>(),
        "faults": faults.collect::<Vec<_>>(),
        "commands": control::commands(),
        "conditions": words,
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use geu_model::configuration::fault::FAULT_NUMBERS;

    use super::*;

    /// Numbers that count something which is in their name, are a part of something, or no quantity at all.
    const NONE: [&str; 18] = [
        "amount",
        "by",
        "by_hand",
        "byte",
        "copies",
        "crc",
        "factor",
        "frames",
        "gyro_flags",
        "identifier",
        "law",
        "length",
        "negative",
        "on",
        "probability",
        "times",
        "unit_flags",
        "with",
    ];

    #[test]
    fn every_number_has_its_unit_or_is_known_to_have_none() {
        let named = CATALOGUE.iter().flat_map(|spec| spec.numbers).chain(FAULT_NUMBERS);
        let of_courses = shape::KINDS.iter().flat_map(|kind| kind.numbers);
        let names: BTreeSet<&str> = ParameterRef::all()
            .iter()
            .map(|target| target.number().name)
            .chain(named.chain(of_courses).map(|number| number.name))
            .collect();
        let without: Vec<&str> = names.iter().copied().filter(|name| unit(name).is_empty()).collect();
        assert_eq!(without, NONE);
        for name in names {
            let (unit, parts) = (unit(name), name.matches("_per_").count());
            assert_eq!(unit.matches('/').count(), parts, "{name}: {unit}");
            assert_eq!(unit.matches('√').count(), name.matches("_sqrt_").count(), "{name}: {unit}");
        }
        assert_eq!(unit("arcsec_per_s_per_sqrt_s"), "arcsec/s/√s");
    }
}
