//! The model through its public interface.

mod configuration;
mod discovered;
mod effects;
mod fault_limits;
mod faults;
mod shipped;
mod truth_numbers;
