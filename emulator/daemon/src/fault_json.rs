//! Faults as JSON, in `faults.jsonl` and in the control interface.

use geu_model::configuration::fault::fault_text;
use geu_model::fault::Fault;
use geu_model::fault::acting::FaultEvent;
use geu_model::fault::expectation::ExpectationResult;
use geu_model::units::on_board_s;
use serde_json::{Value, json};

/// The keys of a fault as JSON, as the control interface takes them.
pub(crate) fn keys(fault: &Fault) -> Value {
    let text = fault_text(fault);
    let document: toml_edit::DocumentMut = text.parse().expect("written as TOML");
    let keys = document.iter().map(|(key, item)| (key.to_owned(), json_of(item.as_value().expect("keys of a fault"))));
    Value::Object(keys.collect())
}

fn json_of(value: &toml_edit::Value) -> Value {
    match value {
        toml_edit::Value::String(text) => json!(text.value()),
        toml_edit::Value::Integer(number) => json!(number.value()),
        toml_edit::Value::Float(number) => json!(number.value()),
        toml_edit::Value::Boolean(flag) => json!(flag.value()),
        toml_edit::Value::InlineTable(table) => {
            Value::Object(table.iter().map(|(key, value)| (key.to_owned(), json_of(value))).collect())
        }
        other => json!(other.to_string()),
    }
}

/// What happened to a fault or an expectation; `frame` is the sample that begins.
pub(crate) fn happening(frame: u64, happening: &FaultEvent) -> Value {
    let t_s = on_board_s(frame);
    match happening {
        FaultEvent::Started(fault) => json!({
            "what": "start", "t_s": t_s, "half_second": frame, "id": fault.id, "trigger": fault.trigger(),
            "fault": fault.action.name(), "gyro": fault.gyro.map(|gyro| gyro.name()), "link": fault.link.map(|link| link.name()),
        }),
        FaultEvent::Ended(fault, samples) => json!({
            "what": "end", "t_s": t_s, "half_second": frame, "id": fault.id, "half_seconds": samples,
        }),
        FaultEvent::Decided(watch) => json!({
            "what": "expectation", "t_s": t_s, "half_second": frame, "id": watch.expectation.id,
            "condition": watch.expectation.condition.to_string(),
            "verdict": if matches!(watch.verdict, ExpectationResult::Met(_)) { "met" } else { "not met" },
        }),
    }
}
