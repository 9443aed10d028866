//! Seed, start, manoeuvres, external truth and the electronics table of a configuration.

use serde_json::{Map, Value as Json, json};

use super::document::{Node, Read};
use super::tree::{Part, comment, describe, line, one, present};
use super::{schema, unix_ns};
use crate::attitude::{AttitudeProfile, Manoeuvre, RateSegment, Scenario, TruthNumbers};
use crate::parameter_spec::{DefaultValue, ParameterSet, ParameterSpec, REAL, ValueFormat, number};
use crate::temperature::Electronics;

const START: ParameterSpec = number(
    "start_unix_s",
    "s",
    REAL,
    DefaultValue::Value(0.0),
    0.0,
    4e9,
    "time at the start of the first sample interval, Unix time",
);

/// The seed.
impl Part for &mut u64 {
    fn read(&mut self, node: &Node, key: &str) -> Read<()> {
        **self = node.whole_number(key)?.unwrap_or(1);
        Ok(())
    }

    fn show(&self, key: &str, _complete: bool, text: &mut String) {
        line!(text, "{key} = {self}");
    }

    fn schema(&self, key: &str) -> Map<String, Json> {
        one(key, json!({ "type": "integer", "minimum": 0, "default": 1 }))
    }
}

/// The start in Unix time, ns.
impl Part for &mut i64 {
    fn read(&mut self, node: &Node, _key: &str) -> Read<()> {
        **self = unix_ns(node.number(&START)?);
        Ok(())
    }

    fn show(&self, key: &str, complete: bool, text: &mut String) {
        // From integers: a product of floats is off by a microsecond late in the range.
        let start_us = **self / 1000;
        let (s, us) = (start_us / 1_000_000, start_us % 1_000_000);
        line!(text, "{key} = {s}.{us:06}{}", comment(complete, START.meaning));
    }

    fn schema(&self, key: &str) -> Map<String, Json> {
        one(key, schema::number(&START))
    }
}

impl Part for &mut Vec<Manoeuvre> {
    fn read(&mut self, node: &Node, key: &str) -> Read<()> {
        let kinds: Vec<&str> = Manoeuvre::KINDS.iter().map(|kind| kind.0).collect();
        for node in node.tables(key)? {
            let mut manoeuvre = Manoeuvre::of_kind(node.choice("kind", &kinds)?).expect("a listed kind");
            node.fill(manoeuvre.numbers_mut(), |_| true, &["kind"])?;
            self.push(manoeuvre);
        }
        Ok(())
    }

    fn show(&self, key: &str, complete: bool, text: &mut String) {
        if complete {
            line!(
                text,
                "\n# Manoeuvres, one after the other; a hold without end follows the last. Kinds and their numbers:"
            );
            for (kind, title) in Manoeuvre::KINDS {
                let manoeuvre = Manoeuvre::of_kind(kind).expect("a listed kind");
                line!(text, "# {kind}: {title}");
                describe_with_defaults(text, manoeuvre.numbers().specs());
            }
        }
        for manoeuvre in self.iter() {
            line!(text, "\n[[{key}]]\nkind = {:?}", manoeuvre.kind());
            for (number, value) in present(manoeuvre.numbers()) {
                line!(text, "{} = {value:?}", number.name);
            }
        }
    }

    fn schema(&self, key: &str) -> Map<String, Json> {
        let kinds = Manoeuvre::KINDS.iter().map(|(kind, title)| {
            let manoeuvre = Manoeuvre::of_kind(kind).expect("a listed kind");
            let mut schema = schema::table(manoeuvre.numbers(), &|_| true);
            schema["properties"]["kind"] = json!({ "const": kind });
            schema["description"] = json!(title);
            schema["required"] = [&["kind"], &schema::required(manoeuvre.numbers().specs())[..]].concat().into();
            schema
        });
        one(key, json!({ "type": "array", "items": { "oneOf": kinds.collect::<Vec<_>>() } }))
    }
}

/// Most segments of a motion.
const MAX_SEGMENTS: usize = 10_000;

/// Comment lines with meaning, limits and default of each number.
fn describe_with_defaults(text: &mut String, specs: &[ParameterSpec]) {
    for spec in specs {
        let default = match spec.default {
            DefaultValue::Value(value) => format!("default {value:?}"),
            DefaultValue::Required => "required".to_owned(),
            DefaultValue::Absent => "optional".to_owned(),
        };
        line!(text, "#   {}: {} ({}; {default})", spec.name, spec.meaning, spec.limits());
    }
}

/// Prescribed rates.
impl Part for &mut Vec<RateSegment> {
    fn read(&mut self, node: &Node, key: &str) -> Read<()> {
        let nodes = node.tables(key)?;
        if nodes.len() > MAX_SEGMENTS {
            return Err(
                node.error(key, format!("expected at most {MAX_SEGMENTS} tables [[{key}]], got {}", nodes.len()))
            );
        }
        for node in nodes {
            let mut segment = RateSegment::default();
            node.fill(&mut segment, |_| true, &[])?;
            self.push(segment);
        }
        Ok(())
    }

    fn show(&self, key: &str, complete: bool, text: &mut String) {
        if complete {
            line!(
                text,
                "\n# Prescribed rates about the control axes, [[{key}]], in place of scenario and manoeuvres. Numbers of each:"
            );
            describe_with_defaults(text, RateSegment::NUMBERS);
        }
        for segment in self.iter() {
            line!(text, "\n[[{key}]]");
            for (number, value) in present(segment).filter(|(number, value)| number.default.initial() != *value) {
                line!(text, "{} = {value:?}", number.name);
            }
        }
    }

    fn schema(&self, key: &str) -> Map<String, Json> {
        let segment = schema::table(&RateSegment::default(), &|_| true);
        one(key, json!({ "type": "array", "items": segment }))
    }
}

/// Verifies that the manoeuvres are feasible.
///
/// # Errors
/// The first infeasible manoeuvre, at its place in the document.
pub(super) fn verify(root: &Node, scenario: &Scenario) -> Read<()> {
    AttitudeProfile::new(scenario).map(|_| ()).or_else(|infeasible| {
        let message = format!("impossible manoeuvre {}: {}", infeasible.index + 1, infeasible.reason);
        Err(root.tables("manoeuvre")?[infeasible.index].error(infeasible.field, message))
    })
}

/// External truth.
impl Part for &mut TruthNumbers {
    fn read(&mut self, node: &Node, key: &str) -> Read<()> {
        node.table(key)?.map_or(Ok(()), |node| node.fill(*self, |_| true, &[]))
    }

    fn show(&self, key: &str, complete: bool, text: &mut String) {
        if !complete && **self == TruthNumbers::default() {
            return;
        }
        line!(text, "\n[{key}]");
        if complete {
            line!(text, "# a truth that a simulator reports while the unit runs (geu run --truth)");
            describe(text, self.specs());
        }
        for (number, value) in present(*self) {
            line!(text, "{} = {}", number.name, number.written(value));
        }
    }

    fn schema(&self, key: &str) -> Map<String, Json> {
        one(key, schema::table(*self, &|_| true))
    }
}

/// The table of electronics temperatures, (s, °C).
impl Part for &mut Vec<(f64, f64)> {
    fn read(&mut self, node: &Node, key: &str) -> Read<()> {
        **self = node.pairs(key)?;
        let ParameterSpec { min, max, .. } = Electronics::NUMBERS[0];
        if let Some((_, celsius)) = self.iter().find(|(_, celsius)| !(min..=max).contains(celsius)) {
            let expected = ValueFormat::Real.limits(min, max);
            return Err(node.error(key, format!("expected {expected} °C for each temperature, got {celsius}")));
        }
        if !self.is_sorted_by(|a, b| a.0 < b.0) {
            return Err(node.error(key, "expected the table's times to rise from point to point".to_owned()));
        }
        Ok(())
    }

    fn show(&self, key: &str, complete: bool, text: &mut String) {
        if !self.is_empty() {
            let points: Vec<String> =
                self.iter().map(|(time_s, celsius)| format!("[{time_s:?}, {celsius:?}]")).collect();
            line!(text, "{key} = [{}]", points.join(", "));
        } else if complete {
            line!(text, "# {key} = [[0.0, 20.0], [3600.0, 21.5]]  # time_s, degC; takes the mean's place");
        }
    }

    fn schema(&self, key: &str) -> Map<String, Json> {
        let number = json!({ "type": "number" });
        let point = json!({ "type": "array", "prefixItems": [number, number], "items": false });
        one(key, json!({ "type": "array", "items": point }))
    }
}
