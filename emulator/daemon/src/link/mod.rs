//! The links: each its own file, all given the same sample by the cadence thread.
//!
//! That thread writes to them directly, without ever blocking; what a link cannot take at once is finished, or recovered
//! from, by a task of the runtime on the other thread.
//!
//! Dependencies run one way: this file opens `pty`, `serial`, `tcp` and `can`; the streams among these use `receive` (commands
//! from a client) and `stream_sender` (bytes to it, with `send_buffer`); all use `interface`, `address`, `statistics` and `error`. Physics, faults and the
//! recording are not here: commands go to the shared unit, bytes come from the link model.

mod address;
pub mod can;
mod error;
mod interface;
pub mod pty;
mod receive;
mod send_buffer;
pub mod serial;
mod statistics;
mod stream_sender;
pub mod tcp;

use std::sync::Arc;

use crate::shared_unit::SharedUnit;

pub use address::{CanAddress, LinkAddress, SerialAddress};
pub use error::LinkError;
pub(crate) use interface::Link;
#[cfg(test)]
pub(crate) use interface::LinkInfo;
pub use statistics::LinkStatistics;
pub use tcp::TcpAddress;

/// Opens a link and starts its tasks on the runtime.
///
/// # Errors
/// What stands in the way, and what to do about it.
pub(crate) fn open(address: &LinkAddress, unit: &Arc<SharedUnit>, speedup: f64) -> Result<Box<dyn Link>, LinkError> {
    let model = address.model();
    Ok(match address {
        LinkAddress::Pty(path) => Box::new(pty::open(path, model, unit, speedup)?),
        LinkAddress::Serial(address) => Box::new(serial::open(address, model, unit)?),
        LinkAddress::Can(address) => Box::new(can::open(address, model, unit)?),
        LinkAddress::Tcp(address) => Box::new(tcp::open(address, model, unit, speedup > 1.0)?),
    })
}
