//! Diagnoses of simulated and measured recordings.

mod checks;
mod discriminating_test;
mod recorded;
mod runs;
