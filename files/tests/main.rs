//! Outputs that are complete or absent.

mod interruption;
mod output;
