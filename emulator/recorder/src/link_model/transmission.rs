//! Data of a link, bytes of a stream or CAN frames, with its time.

use geu_protocol::command::hex;
use geu_protocol::serial::{FrameType, data_frame, frame};
use geu_protocol::{CanFrame, CanIdMap, Reply, Sample};

/// Encoding of the messages of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Encoding {
    /// Frames in a stream of bytes.
    Serial {
        /// Baud.
        baud: u32,
    },
    /// CAN frames.
    Can(CanIdMap),
}

impl Encoding {
    pub(crate) fn sample(self, sample: &Sample) -> Vec<WireData> {
        match self {
            Encoding::Serial { .. } => vec![WireData::Bytes(data_frame(sample).to_vec())],
            Encoding::Can(plan) => plan.frames(sample).into_iter().map(WireData::Frame).collect(),
        }
    }

    pub(crate) fn reply(self, reply: &Reply) -> WireData {
        match self {
            Encoding::Serial { .. } => WireData::Bytes(frame(FrameType::Reply, reply.bytes())),
            Encoding::Can(plan) => WireData::Frame(plan.reply(reply)),
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
            write!(f, "{:03X}#", frame.id())?;
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
