//! Calibrations of simulated recordings.

mod checkout;
mod device_counts;
mod effects;
mod update;
