//! The wire of any unit, from its description: frames on a serial line, messages on CAN, and the numbers in them.
//!
//! A [`FrameSet`] is compiled once. It writes a sample to bytes, and reads bytes to samples. No clock, no files.
//!
//! ```
//! use geu_protocol::layout::{Check, Field, Frame, Number, BitField};
//! let number = |at, name| BitField::bytes(at, Number::from_name(name).unwrap());
//! let mut frame = Frame::new("DATA", 7);
//! frame.set_constant(0, &[0xA5]);
//! frame.fields.push(Field::new(0, number(1, "i24be")).scaled(1.0 / 16384.0, 0.0));
//! frame.fields.push(Field::new(1, number(4, "u8")));
//! frame.checks.push(Check::new("CRC-16/XMODEM", number(5, "u16be"), 0..5).unwrap());
//! let mut bytes = Vec::new();
//! frame.write(&[-1.5, 7.0], &mut bytes);
//! assert_eq!(bytes[..5], [0xA5, 0xFF, 0xA0, 0x00, 7]);
//! let mut values = [0.0; 2];
//! assert!(frame.has_constants(&bytes) && frame.checks_hold(&bytes));
//! frame.read(&bytes, &mut values);
//! assert_eq!(values, [-1.5, 7.0]);
//! ```

mod assembly;
mod check;
mod crc_catalogue;
mod dbc;
mod frame;
mod framing;
mod number;
mod plan;

pub use assembly::{Assembled, Assembly, Sequence};
pub use check::{Check, CrcParameters, check_names, sum_names};
pub use dbc::{Database, DatabaseMessage, DatabaseSignal, SignalRole};
pub use frame::{Field, Frame};
pub use framing::SerialFrames;
pub use number::{BitField, Coding, Number};

/// Meaning of a field.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Quantity {
    /// Increment or rate of a head, by its number.
    Output(usize),
    /// Angle of a head since the frame before that carried it.
    Angle(usize),
    /// Temperature of a head, °C.
    Temperature(usize),
    /// 1 where the output of a head is a measurement.
    Valid(usize),
    /// 1 where the output of a head was clipped.
    Saturated(usize),
    /// Number of the sample, modulo something.
    Sequence,
    /// Count of the unit's clock.
    ClockCount,
    /// Age of the sample when it is sent, s.
    Latency,
    /// Temperature of the electronics, °C.
    Electronics,
    /// Temperature of the sensor, °C.
    Sensor,
    /// A bit of the unit's state, by its name.
    Status(String),
}

/// A value of a sample on a link.
#[derive(Debug, Clone, PartialEq)]
pub struct ValueSpec {
    pub quantity: Quantity,
    /// Name of its column in a table, unit last.
    pub name: String,
    /// Unit in a description; empty for a flag.
    pub unit: &'static str,
    /// Size of its unit: arcsec, arcsec/s, s, °C or counts.
    pub factor: f64,
}

/// Frames of a link, and the values of a sample that their fields carry.
#[derive(Debug, Clone)]
pub struct FrameSet {
    pub frames: Vec<Frame>,
    pub values: Vec<ValueSpec>,
    /// Modulus of the sequence, and its growth from sample to sample.
    pub sequence: (u64, u64),
}

impl FrameSet {
    /// Place of a quantity among the values of a sample.
    pub fn slot(&self, quantity: &Quantity) -> Option<usize> {
        self.values.iter().position(|value| value.quantity == *quantity)
    }

    /// The samples with which a frame comes, in words.
    pub fn cadence(&self, frame: &Frame) -> String {
        let other = frame.instead_of.map(|other| format!("instead of {}", self.frames[other].name));
        match (frame.every, other) {
            (1, other) => other.unwrap_or_else(|| "with every sample".to_owned()),
            (every, None) => format!("every {every} samples"),
            (every, Some(other)) => format!("{other} every {every} samples"),
        }
    }

    /// The frames that a unit sends with the sample of this number. Of several that are due instead of one, the last listed comes.
    pub fn due(&self, index: u64) -> impl Iterator<Item = &Frame> {
        let is_due = move |frame: &Frame| index.is_multiple_of(frame.every.into());
        let instead = move |place: usize| {
            let mut others = self.frames.iter().rev().filter(move |frame| frame.instead_of == Some(place));
            others.find(|frame| frame.every > 1 && is_due(frame))
        };
        let all = self.frames.iter().enumerate().filter(move |(_, frame)| frame.instead_of.is_none() && is_due(frame));
        all.map(move |(place, frame)| instead(place).unwrap_or(frame))
    }
}
