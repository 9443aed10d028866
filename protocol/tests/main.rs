//! The protocol against its published vectors and description.

mod describe;
mod devices;
mod exhaustive;
mod vectors;
