//! The gyro unit's physics: pure, deterministic, and unable to fail once configured.

mod unit;

pub use unit::{Answer, Ended, Unit};
