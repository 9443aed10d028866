//! Diagnoses of simulated and measured recordings.

mod discriminating_test;
mod recorded;
mod runs;
