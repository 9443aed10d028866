//! JSON of a request as TOML, for the reader of fault plans.

use serde_json::{Map, Value};
use toml_edit::{Array, InlineTable, Item, Table};

/// An object as a TOML document, without keys whose value is null.
pub(super) fn text(object: &Map<String, Value>) -> String {
    let pairs = object.iter().filter_map(|(key, value)| Some((key.as_str(), Item::Value(toml_value(value)?))));
    pairs.collect::<Table>().to_string()
}

fn toml_value(value: &Value) -> Option<toml_edit::Value> {
    Some(match value {
        Value::Null => return None,
        Value::Bool(flag) => (*flag).into(),
        Value::Number(number) => match number.as_i64() {
            Some(whole) => whole.into(),
            None => number.as_f64()?.into(),
        },
        Value::String(text) => text.as_str().into(),
        Value::Array(values) => values.iter().filter_map(toml_value).collect::<Array>().into(),
        Value::Object(map) => {
            let pairs = map.iter().filter_map(|(key, value)| Some((key.as_str(), toml_value(value)?)));
            pairs.collect::<InlineTable>().into()
        }
    })
}
