//! Faults as JSON, in `faults.jsonl` and in the control interface.

use geu_model::configuration::fault::fault_text;
use geu_model::device::Device;
use geu_model::fault::Fault;
use geu_model::fault::engine::FaultEvent;
use geu_model::fault::expectation::ExpectationResult;
use serde_json::{Value, json};
use toml_edit::Value as TomlValue;

/// The keys of a fault of a unit, as the control interface accepts them.
pub fn keys(device: &Device, fault: &Fault) -> Value {
    let document: toml_edit::DocumentMut = fault_text(device, fault).parse().expect("written as TOML");
    let keys = document.iter().map(|(key, item)| (key, from_toml(item.as_value().expect("a fault has no tables"))));
    keys.collect()
}

fn from_toml(value: &TomlValue) -> Value {
    match value {
        TomlValue::String(text) => json!(text.value()),
        TomlValue::Integer(number) => json!(number.value()),
        TomlValue::Float(number) => json!(number.value()),
        TomlValue::Boolean(flag) => json!(flag.value()),
        TomlValue::InlineTable(table) => table.iter().map(|(key, value)| (key, from_toml(value))).collect(),
        other => json!(other.to_string()),
    }
}

/// An event of a fault or an expectation at the start of sample `sample`.
pub fn event(device: &Device, sample: u64, event: &FaultEvent) -> Value {
    let t_s = device.on_board_s(sample);
    match event {
        FaultEvent::Started(fault) => json!({
            "what": "start", "t_s": t_s, "half_second": sample, "id": fault.id, "trigger": fault.trigger(),
            "fault": fault.action.name(), "gyro": fault.gyro.map(|gyro| gyro.name()), "link": fault.link.map(|link| link.name()),
        }),
        FaultEvent::Ended(fault, samples) => json!({
            "what": "end", "t_s": t_s, "half_second": sample, "id": fault.id, "half_seconds": samples,
        }),
        FaultEvent::Decided(monitor) => json!({
            "what": "expectation", "t_s": t_s, "half_second": sample, "id": monitor.expectation.id,
            "condition": monitor.expectation.condition.to_string(), "verdict": verdict(&monitor.verdict),
        }),
    }
}

fn verdict(result: &ExpectationResult) -> &'static str {
    if matches!(result, ExpectationResult::Met(_)) { "met" } else { "not met" }
}

/// Kind and text of the event's line in the timeline.
pub fn kind_and_text(device: &Device, event: &FaultEvent) -> (&'static str, String) {
    match event {
        FaultEvent::Started(fault) => ("fault-start", format!("{} active: {}", fault.id, fault.action.name())),
        FaultEvent::Ended(fault, samples) => {
            ("fault-end", format!("{} ended after {} s", fault.id, device.on_board_s(*samples)))
        }
        FaultEvent::Decided(monitor) => {
            let expectation = &monitor.expectation;
            let verdict = verdict(&monitor.verdict);
            ("expectation", format!("{} is {verdict}: {}", expectation.id, expectation.condition))
        }
    }
}
