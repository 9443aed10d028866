//! Diagnosis on a running link: which gyro changed, and of which kind the change is.
//!
//! A module uses only those named before it:
//! - `interval`: a rounded value as an interval;
//! - `filter`: follows the residual of one channel;
//! - `bank`: compares the filter's scores with the signatures of changes;
//! - `kind`: which kind of a change is the likeliest;
//! - `channel`: alarms of one channel, and their names;
//! - `event`: what a monitor does and reports;
//! - `reference_model`: the model along the reference;
//! - `monitor`: from samples to residuals and events;
//! - `described`: samples of a described unit to nodes of a monitor.

mod bank;
mod channel;
mod described;
mod event;
mod filter;
mod interval;
mod kind;
mod monitor;
mod reference_model;

pub use channel::{FALSE_ALARM_INTERVAL_DAYS, START_S, THRESHOLD};
pub use described::DeviceMonitor;
pub use event::{Event, Watch};
pub use monitor::Monitor;
