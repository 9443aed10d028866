//! The gyro electronics unit on the wire.
//!
//! Bytes only: no clock, no files, no async. Each field and message is defined once, in [`field`] and
//! [`message`]; the codec, the CAN database, the C header, the Wireshark dissector and the interface control document
//! are generated from it or tested against it.
//!
//! ```
//! use geu_protocol::{CanIdMap, Sample};
//! let sample = Sample { increments: [-2, -2, 5, 5], gyro_flags: 0x0F, unit_flags: 0x07,
//!     electronics_centi_c: 2064, clock_count: 500_000, sensor_centi_c: 7000, ..Sample::default() };
//! let [increments, status, clock] = CanIdMap::default().frames(&sample);
//! assert_eq!((increments.id(), increments.data()), (0x1A0, &[0xFF, 0xFE, 0xFF, 0xFE, 0, 5, 0, 5][..]));
//! assert_eq!(status.data()[6..], [0xDD, 0x5E]);
//! assert_eq!(clock.id(), 0x1A2);
//! ```

pub mod calendar;
pub mod can;
pub mod capture;
pub mod command;
pub mod continuity;
pub mod crc;
pub mod deframer;
pub mod describe;
pub mod excerpt;
pub mod field;
mod gyros;
pub mod hex;
pub mod layout;
pub mod message;
mod named;
pub mod serial;
pub mod suggestion;
pub mod template;

pub use can::{Assembler, CanFrame, CanIdMap};
pub use command::{Command, CommandResult, Reply};
pub use field::{CLOCK_PER_SAMPLE, Gyro, Sample};
pub use gyros::Gyros;

/// Version of the link that this crate speaks: major, minor (answered to PING).
pub const LINK_VERSION: (u8, u8) = (1, 0);
