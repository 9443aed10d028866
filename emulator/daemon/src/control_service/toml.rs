//! What comes as JSON, as the reader of plans takes it.

use serde_json::{Map, Value};
use toml_edit::{Array, DocumentMut, InlineTable, Item};

/// An object as TOML; keys without a value are not there.
pub(super) fn text(object: &Map<String, Value>) -> String {
    let mut document = DocumentMut::new();
    for (key, value) in object {
        if let Some(value) = of(value) {
            document.insert(key, Item::Value(value));
        }
    }
    document.to_string()
}

fn of(value: &Value) -> Option<toml_edit::Value> {
    Some(match value {
        Value::Null => return None,
        Value::Bool(flag) => (*flag).into(),
        Value::Number(number) => match number.as_i64() {
            Some(whole) => whole.into(),
            None => number.as_f64()?.into(),
        },
        Value::String(text) => text.as_str().into(),
        Value::Array(values) => values.iter().filter_map(of).collect::<Array>().into(),
        Value::Object(map) => {
            let pairs = map.iter().filter_map(|(key, value)| Some((key.as_str(), of(value)?)));
            pairs.collect::<InlineTable>().into()
        }
    })
}
