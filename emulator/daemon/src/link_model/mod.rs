//! Links without a device: samples and replies as bytes or CAN frames, with what the faults of links make of them. Pure, so
//! that a recording holds what every link of its kind carried.
//!
//! Dependencies run one way: `model` uses `fault` (one file per fault), both use `transmission`; `transmit_queue` decides
//! when transmissions are due and uses `transmission` alone. No file, no clock, no client.

mod fault;
mod model;
mod transmission;
mod transmit_queue;

pub(crate) use fault::{ActiveLinkFault, acts_on_replies_alone};
pub use model::LinkModel;
pub use transmission::{Encoding, Transmission, WireData};
pub(crate) use transmit_queue::TransmitQueue;
