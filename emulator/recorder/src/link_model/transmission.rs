//! Data of a link, bytes of a stream or CAN frames, with its time.

use std::sync::Arc;

use geu_model::CompletedSample;
use geu_model::device::Device;
use geu_protocol::command::hex;
use geu_protocol::layout::Frame;
use geu_protocol::serial::{FrameType, MAX_FRAME, data_frame, frame};
use geu_protocol::{CanFrame, CanIdMap, Reply};

/// Lateness up to which samples are sent, if it is longer than their interval.
pub const CATCH_UP_NS: i64 = 100_000_000;

/// Encoding of the messages of a link.
#[derive(Debug, Clone, PartialEq)]
pub enum Encoding {
    /// Frames in a stream of bytes.
    Serial {
        /// Baud.
        baud: u32,
    },
    /// CAN frames.
    Can(CanIdMap),
    /// Frames of a described unit in a stream of bytes.
    DescribedSerial { device: Arc<Device>, baud: u32 },
    /// CAN frames of a described unit.
    DescribedCan(Arc<Device>),
}

impl Encoding {
    /// True for CAN frames, false for a stream of bytes.
    pub fn is_can(&self) -> bool {
        matches!(self, Encoding::Can(_) | Encoding::DescribedCan(_))
    }

    /// Baud rate of a stream of bytes.
    pub fn baud(&self) -> Option<u32> {
        match self {
            Encoding::Serial { baud } | Encoding::DescribedSerial { baud, .. } => Some(*baud),
            Encoding::Can(_) | Encoding::DescribedCan(_) => None,
        }
    }

    /// The unit, if it is a described one.
    pub fn device(&self) -> Option<&Arc<Device>> {
        match self {
            Encoding::DescribedSerial { device, .. } | Encoding::DescribedCan(device) => Some(device),
            Encoding::Serial { .. } | Encoding::Can(_) => None,
        }
    }

    /// Largest number of bytes of a sample in a stream, and the samples within [`CATCH_UP_NS`].
    pub fn sample_bytes(&self) -> (usize, usize) {
        let Some(device) = self.device() else { return (MAX_FRAME, 1) };
        let frames = device.frames(false).map_or(&[][..], |set| &set.frames);
        let instead = |place| frames.iter().filter(move |frame| frame.instead_of == Some(place)).map(Frame::length);
        let own = frames.iter().enumerate().filter(|(_, frame)| frame.instead_of.is_none());
        let length = own.map(|(place, frame)| instead(place).fold(frame.length(), usize::max)).sum();
        (length, (CATCH_UP_NS / device.interval_ns().max(1)).max(1) as usize)
    }

    pub(crate) fn sample(&self, sample: &CompletedSample) -> Vec<WireData> {
        match self {
            Encoding::Serial { .. } => vec![WireData::Bytes(data_frame(&sample.sample).to_vec())],
            Encoding::Can(plan) => plan.frames(&sample.sample).into_iter().map(WireData::Frame).collect(),
            Encoding::DescribedSerial { device, .. } => {
                device.encode(false, sample).into_iter().map(|(_, bytes)| WireData::Bytes(bytes)).collect()
            }
            Encoding::DescribedCan(device) => {
                let frame = |(frame, bytes): (&Frame, Vec<u8>)| match frame.id? {
                    (id, true) => CanFrame::extended(id, &bytes),
                    (id, false) => CanFrame::new(id as u16, &bytes),
                };
                device.encode(true, sample).into_iter().filter_map(frame).map(WireData::Frame).collect()
            }
        }
    }

    /// A reply of the default unit.
    pub(crate) fn reply(&self, reply: &Reply) -> WireData {
        match self {
            Encoding::Can(plan) => WireData::Frame(plan.reply(reply)),
            _ => WireData::Bytes(frame(FrameType::Reply, reply.bytes())),
        }
    }
}

/// Bytes of a stream, or a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum WireData {
    /// Bytes of a stream.
    Bytes(Vec<u8>),
    /// Frame on a bus.
    Frame(CanFrame),
}

impl WireData {
    /// The bytes, of a CAN frame its data.
    pub fn bytes(&self) -> &[u8] {
        match self {
            WireData::Bytes(bytes) => bytes,
            WireData::Frame(frame) => frame.data(),
        }
    }

    /// Replaces the bytes; a CAN frame keeps its data if these are more than eight.
    pub(super) fn set_bytes(&mut self, data: Vec<u8>) {
        match self {
            WireData::Bytes(bytes) => *bytes = data,
            WireData::Frame(frame) => *frame = frame.with_data(&data).unwrap_or(*frame),
        }
    }

    /// Truncates bytes to `length`; a CAN frame is also padded with zeros.
    pub(super) fn set_length(&mut self, length: usize) {
        let mut data = self.bytes().to_vec();
        match self {
            WireData::Bytes(_) => data.truncate(length),
            WireData::Frame(_) => data.resize(length, 0),
        }
        self.set_bytes(data);
    }
}

/// Hexadecimal; a CAN frame as candump writes it.
impl std::fmt::Display for WireData {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if let WireData::Frame(frame) = self {
            match frame.is_extended() {
                true => write!(f, "{:08X}#", frame.id())?,
                false => write!(f, "{:03X}#", frame.id())?,
            }
        }
        f.write_str(&hex(self.bytes()))
    }
}

/// Data with its time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Transmission {
    /// Index of the sample with which it is sent.
    pub frame: u64,
    /// On-board time after the end of that sample, ns.
    pub after_ns: i64,
    /// The bytes or the frame.
    pub content: WireData,
    /// The next transmission is the rest of the same frame: no other data is sent between them.
    pub more_fragments: bool,
}

impl Transmission {
    /// Data that is sent at the end of sample `frame`.
    pub fn on_time(frame: u64, content: WireData) -> Transmission {
        Transmission { frame, after_ns: 0, content, more_fragments: false }
    }
}
