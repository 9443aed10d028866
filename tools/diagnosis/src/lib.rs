//! Model against measurement: where the two part, which effect is missing, on which gyro, how large it is.

mod finding;

pub use finding::Finding;
