//! Calibrations of simulated recordings.

mod checkout;
mod effects;
mod update;
