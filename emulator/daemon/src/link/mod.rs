//! The links: one file per transport; the cadence thread passes each sample to all of them.
//!
//! That thread writes to them directly, without blocking; a task of the runtime on the other thread completes partial writes and
//! handles errors.
//!
//! Dependencies run one way: this file opens `pty`, `serial`, `tcp` and `can`; the streams among these use `receive` (commands
//! from a client) and `stream_sender` (bytes to it, with `send_buffer`); all use `interface`, `address`, `statistics` and
//! `error`. Physics, faults and the recording are not here: the shared unit executes commands, the link model makes the bytes.

mod address;
pub mod can;
mod error;
mod interface;
pub(crate) mod port;
pub mod pty;
mod receive;
mod send_buffer;
pub mod serial;
mod statistics;
mod stream_sender;
pub mod tcp;

use std::sync::Arc;

use crate::shared_unit::SharedUnit;

pub use address::{CanAddress, LinkAddress, PtyAddress, SerialAddress};
pub use error::LinkError;
pub(crate) use interface::Link;
#[cfg(test)]
pub(crate) use interface::LinkInfo;
pub use statistics::LinkStatistics;
#[cfg(test)]
pub(crate) use stream_sender::StreamLink;
pub use tcp::TcpAddress;

/// Opens a link and starts its tasks on the runtime.
///
/// # Errors
/// The reason why it cannot be opened, with the way to correct it.
pub(crate) fn open(address: &LinkAddress, unit: &Arc<SharedUnit>, speedup: f64) -> Result<Box<dyn Link>, LinkError> {
    let model = address.model(&unit.device);
    Ok(match address {
        LinkAddress::Pty(address) => Box::new(pty::open(address, model, unit, speedup)?),
        LinkAddress::Serial(address) => Box::new(serial::open(address, model, unit)?),
        LinkAddress::Can(address) => Box::new(can::open(address, model, unit)?),
        LinkAddress::Tcp(address) => Box::new(tcp::open(address, model, unit, speedup > 1.0)?),
        #[cfg(test)]
        LinkAddress::Simulated(link) => Box::new(link.open(model, unit, speedup)),
    })
}
