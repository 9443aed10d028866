//! The catalogue of faults as JSON, with units and limits, for the bench page and other clients.

use geu_model::device::Device;
use geu_model::fault::catalogue::{CATALOGUE, FaultSpec, Transport};
use geu_model::fault::{EffectList, ParameterRef, expression};
use geu_model::parameter_spec::{DefaultValue, ParameterSpec, ValueFormat};
use geu_model::time_profile::FAULT_PROFILES;
use geu_protocol::Gyro;
use serde_json::{Value, json};

use crate::control;

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
        "least": spec.min,
        "greatest": spec.max,
        "required": spec.default == DefaultValue::Required,
        "default": if let DefaultValue::Value(default) = spec.default { value(default) } else { Value::Null },
        "unit": spec.unit,
        "meaning": spec.meaning,
    })
}

/// A number of a named fault, with the lower limits of single transports.
fn bounded(own: &ParameterSpec, spec: &FaultSpec) -> Value {
    let mut json = number(own);
    for bound in spec.bounds.iter().filter(|bound| bound.number == own.name) {
        json["greatest_on"] = bound.links.iter().map(|link| (link.name(), bound.most)).collect();
    }
    json
}

/// Gyros, parameters with time courses, named faults, commands, variables of conditions.
pub fn catalogue(device: &Device) -> Value {
    let names = |gyros: &[Gyro]| gyros.iter().map(|gyro| gyro.name()).collect::<Value>();
    let parameters = ParameterRef::all().into_iter().map(|target| {
        let ((min, max), spec) = (target.limits_of(device), target.number());
        json!({
            "parameter": target.name(),
            "title": target.effect().title,
            "per_gyro": target.list != EffectList::Unit,
            "gyros": names(&target.gyros(device)),
            "form": form(spec.form),
            "least": min,
            "greatest": max,
            "unit": spec.unit,
            "meaning": spec.meaning,
        })
    });
    let courses = FAULT_PROFILES.iter().map(|kind| {
        // The amplitude is named as the course and has the limits of the parameter.
        let amplitude = json!({ "name": kind.name, "form": "real", "required": true, "meaning": kind.meaning });
        let numbers: Value = std::iter::once(amplitude).chain(kind.shapes.iter().map(number)).collect();
        json!({ "course": kind.name, "meaning": kind.meaning, "numbers": numbers })
    });
    let faults = CATALOGUE.iter().map(|spec| {
        let unable =
            |kind: Transport| spec.unable_on(kind).or_else(|| device.unable(spec.code, kind == Transport::Can));
        let links: Value = Transport::ALL.into_iter().map(|kind| (kind.name(), unable(kind))).collect();
        json!({
            "fault": spec.code,
            "scope": spec.scope.name(),
            "title": spec.code.replace('-', " "),
            "meaning": spec.meaning,
            "numbers": spec.numbers.iter().map(|own| bounded(own, spec)).collect::<Value>(),
            "for_s": spec.for_s,
            "links": links,
        })
    });
    let variables = expression::vocabulary().into_iter();
    let conditions = variables.map(|(name, meaning)| json!({ "name": name, "meaning": meaning }));
    json!({
        "gyros": device.gyros().map(Gyro::name).collect::<Value>(),
        "parameters": parameters.collect::<Value>(),
        "courses": courses.collect::<Value>(),
        "faults": faults.collect::<Value>(),
        "commands": if device.is_iras() { control::commands() } else { json!([]) },
        "conditions": conditions.collect::<Value>(),
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use geu_model::configuration::fault::FaultNumbers;

    use super::*;

    /// Counts, fractions and values without a unit.
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
    fn every_number_has_a_unit_or_is_listed_without() {
        let named = CATALOGUE.iter().flat_map(|spec| spec.numbers).chain(FaultNumbers::NUMBERS);
        let of_courses = FAULT_PROFILES.iter().flat_map(|kind| kind.shapes);
        let units: BTreeSet<(&str, &str)> = ParameterRef::all()
            .iter()
            .map(|target| target.number())
            .chain(named.chain(of_courses))
            .map(|number| (number.name, number.unit))
            .collect();
        let without: Vec<&str> = units.iter().filter(|(_, unit)| unit.is_empty()).map(|(name, _)| *name).collect();
        assert_eq!(without, NONE);
        assert!(units.contains(&("arcsec_per_s_per_sqrt_s", "arcsec/s/√s")), "{units:?}");
        let names: BTreeSet<&str> = units.iter().map(|(name, _)| *name).collect();
        assert_eq!(names.len(), units.len(), "a name with two units: {units:?}");
        for (name, unit) in units {
            let parts = name.matches("_per_").count();
            assert_eq!(unit.matches('/').count(), parts, "{name}: {unit}");
            assert_eq!(unit.matches('√').count(), name.matches("_sqrt_").count(), "{name}: {unit}");
        }
    }
}
