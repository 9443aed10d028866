//! Faults and expectations as TOML, and as a part of the configuration's tree.

use geu_protocol::Gyro;
use serde_json::{Map, Value as Json, json};

use super::document::{Node, Read};
use super::fault::{EXPECT, FAULT, FAULT_TEXTS, FaultNumbers};
use super::schema;
use super::tree::{Part, describe, line, one, present, quoted};
use crate::device::Device;
use crate::fault::expectation::{Expectation, TimeWindow};
use crate::fault::{Fault, FaultKind};
use crate::parameter_spec::ParameterSpec;

/// One fault of a unit as TOML, its keys alone.
pub fn fault_text(device: &Device, fault: &Fault) -> String {
    let gyros: Vec<Gyro> = device.gyros().collect();
    let written = |number: &ParameterSpec, value: f64| number.form.written_of(value, &gyros);
    let mut text = String::new();
    let mut put = |key: &str, value: String| line!(text, "{key} = {value}");
    put("id", format!("{:?}", fault.id));
    match &fault.action {
        FaultKind::Parameter { target, size, course } => {
            put("parameter", format!("{:?}", target.name()));
            let kind = course.spec;
            let shapes = kind.shapes.iter().zip(course.shapes()).filter(|(_, value)| value.is_finite());
            let course: Vec<String> = std::iter::once(format!("{} = {}", kind.name, written(target.number(), *size)))
                .chain(shapes.map(|(number, value)| format!("{} = {}", number.name, written(number, *value))))
                .collect();
            put("course", format!("{{ {} }}", course.join(", ")));
        }
        FaultKind::Named { spec, values } => {
            put("fault", format!("{:?}", spec.code));
            spec.numbers.iter().zip(values).for_each(|(number, value)| put(number.name, written(number, *value)));
        }
    }
    if let Some(gyro) = fault.gyro {
        put("gyro", format!("{:?}", gyro.name()));
    }
    if let Some(link) = fault.link {
        put("link", format!("{:?}", link.name()));
    }
    for (key, condition) in [("when", &fault.when), ("end_when", &fault.end_when)] {
        if let Some(condition) = condition {
            put(key, quoted(&condition.to_string()));
        }
    }
    let numbers = FaultNumbers {
        at_s: fault.at_s,
        probability: fault.probability,
        by_hand: f64::from(u8::from(fault.by_hand)),
        for_s: fault.for_s.unwrap_or(f64::NAN),
        until_s: if fault.until_s.is_finite() { fault.until_s } else { f64::NAN },
        release_s: fault.release_s,
        times: fault.times as f64,
    };
    for (number, value) in present(&numbers) {
        if number.default.initial() != value || number.name == "at_s" && fault.when.is_none() {
            put(number.name, written(number, value));
        }
    }
    if let Some(seed) = fault.seed {
        put("seed", seed.to_string());
    }
    text
}

/// Faults and expectations of a unit as a plan.
pub fn plan_text(device: &Device, faults: &[Fault], expectations: &[Expectation]) -> String {
    let mut text = String::new();
    for fault in faults {
        text += &format!("\n[[{FAULT}]]\n{}", fault_text(device, fault));
    }
    for Expectation { id, after, at_s, condition, window } in expectations {
        text += &format!("\n[[{EXPECT}]]\nid = {id:?}\n");
        if let Some(after) = after {
            text += &format!("after = {after:?}\n");
        }
        let (key, length_s) = match window {
            TimeWindow::Within(length_s) => ("within_s", length_s),
            TimeWindow::Throughout(length_s) => ("throughout_s", length_s),
        };
        let condition = quoted(&condition.to_string());
        text += &format!("at_s = {at_s:?}\ncondition = {condition}\n{key} = {length_s:?}\n");
    }
    text
}

/// Faults and expectations of a configuration, which are read after everything that they refer to.
pub(super) struct Plan<'a> {
    pub device: &'a Device,
    pub faults: &'a [Fault],
    pub expectations: &'a [Expectation],
}

impl Part for Plan<'_> {
    fn read(&mut self, _node: &Node, _key: &str) -> Read<()> {
        Ok(())
    }

    /// Shows both lists at the key of faults.
    fn show(&self, key: &str, complete: bool, text: &mut String) {
        if key != FAULT {
            return;
        }
        if complete {
            line!(text, "\n# Faults; `geu faults list` shows all of them. Keys of each:");
            for (key, meaning) in FAULT_TEXTS {
                line!(text, "#   {key}: {meaning}");
            }
            describe(text, FaultNumbers::NUMBERS);
            let (gyro, parameter) = match self.device.is_iras() {
                true => ("GYRX", "pivot-clearance.clearance_arcsec"),
                false => (self.device.heads[0].gyro.name(), "drift.arcsec_per_h"),
            };
            let fault = format!("at_s = 100.0, gyro = {gyro:?}, parameter = {parameter:?}");
            line!(text, "# fault = [{{ {fault}, course = {{ step = 11.5 }}, for_s = 600.0 }}]");
        }
        *text += &plan_text(self.device, self.faults, self.expectations);
    }

    fn schema(&self, key: &str) -> Map<String, Json> {
        let items = if key == FAULT { json!({ "oneOf": schema::faults(self.device) }) } else { schema::expectation() };
        one(key, json!({ "type": "array", "items": items }))
    }
}
