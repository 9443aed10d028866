//! Diagnoses of simulated and measured recordings.

mod discriminating_test;
mod linear_signatures;
mod recorded;
mod runs;
