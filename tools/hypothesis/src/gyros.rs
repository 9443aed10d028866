//! Sets of gyros and their names; in JSON a list of names.

use geu_protocol::Gyro;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

/// A set of gyros.
pub type Gyros = [bool; 4];

/// All four, as an effect of the unit has them.
pub const ALL_GYROS: Gyros = [true; 4];

/// Names of gyros.
pub fn names(gyros: &Gyros) -> Vec<&'static str> {
    Gyro::ALL.into_iter().filter(|gyro| gyros[gyro.index()]).map(Gyro::name).collect()
}

/// The gyros with these names; `None` without a name, or with another name.
pub fn from_names(names: &[&str]) -> Option<Gyros> {
    let is_gyro = |name: &&str| Gyro::ALL.iter().any(|gyro| gyro.name() == *name);
    (!names.is_empty() && names.iter().all(is_gyro)).then(|| Gyro::ALL.map(|gyro| names.contains(&gyro.name())))
}

/// The set of one gyro.
pub fn only(gyro: usize) -> Gyros {
    std::array::from_fn(|other| other == gyro)
}

/// True if all gyros are among the others.
pub fn is_within(gyros: &Gyros, others: &Gyros) -> bool {
    gyros.iter().zip(others).all(|(own, other)| !own || *other)
}

/// True if the sets have a gyro in common.
pub fn overlap(one: &Gyros, other: &Gyros) -> bool {
    one.iter().zip(other).any(|(one, other)| *one && *other)
}

pub fn serialize<S: Serializer>(gyros: &Gyros, serializer: S) -> Result<S::Ok, S::Error> {
    names(gyros).serialize(serializer)
}

pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Gyros, D::Error> {
    let names = Vec::<String>::deserialize(deserializer)?;
    from_names(&names.iter().map(String::as_str).collect::<Vec<_>>()).ok_or_else(|| D::Error::custom("expected gyros"))
}
