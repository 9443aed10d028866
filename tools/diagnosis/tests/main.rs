//! Diagnoses of simulated and measured recordings.

mod blind;
mod checks;
mod discriminating_test;
mod recorded;
mod runs;
