//! Links without a device: encodes samples and replies as bytes or CAN frames, and applies the faults of links. Pure, so that a
//! recording has the data of any link of its transport.
//!
//! Dependencies run one way: `model` uses `fault` (one file per fault), both use `transmission`; `transmit_queue` determines
//! their times and uses only `transmission`. No file, no clock, no client.

mod fault;
mod model;
mod transmission;
mod transmit_queue;

pub(crate) use fault::ActiveLinkFault;
pub use fault::changes_replies;
pub use model::LinkModel;
pub use transmission::{CATCH_UP_NS, Encoding, Transmission, WireData};
pub use transmit_queue::TransmitQueue;
