//! Sets of gyros as lists of names, for `#[serde(with)]`.

use geu_protocol::Gyros;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

pub fn serialize<S: Serializer>(gyros: &Gyros, serializer: S) -> Result<S::Ok, S::Error> {
    gyros.names().serialize(serializer)
}

/// Reads a set of gyros of the default unit.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Gyros, D::Error> {
    let names = Vec::<String>::deserialize(deserializer)?;
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    Gyros::ALL.from_names(&names).ok_or_else(|| D::Error::custom("expected gyros"))
}
