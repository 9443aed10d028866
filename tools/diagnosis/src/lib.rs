//! Model against measurement: where the two part, which effect is missing, on which gyro, how large it is.

pub mod checks;
mod finding;

pub use finding::Finding;
