//! The frames and samples of a unit in its bytes and messages.

use std::sync::Arc;

use geu_daemon::replay::TrafficOrigin;
use geu_model::device::Device;
use geu_protocol::continuity::SequenceStep;
use geu_protocol::deframer::{FrameEvent, FrameFinder};
use geu_protocol::field::CLOCK_PER_SAMPLE;
use geu_protocol::layout::{Assembled, Assembly, FrameSet, Sequence, SerialFrames};
use geu_protocol::serial::{Deframer, DeframerEvent, FrameType, OVERHEAD, read_data};
use geu_protocol::{CanFrame, Sample};

/// Bytes of a frame, of a described unit of all frames of a sample.
pub(crate) struct UnitFrame {
    /// Offset in the stream.
    pub at: u64,
    pub length: usize,
    pub origin: TrafficOrigin,
    pub sample: Option<Sample>,
}

/// Finds the frames of a unit in serial bytes.
pub(crate) enum Finder {
    Default(Deframer),
    Described(FrameFinder<SerialFrames>, Box<Samples>),
}

impl Finder {
    pub fn new(device: &Device) -> Finder {
        match device.serial.as_ref().map(|serial| &serial.frames) {
            Some(frames) => {
                Finder::Described(FrameFinder::new(SerialFrames::new(frames.clone())), Box::new(Samples::new(frames)))
            }
            None => Finder::Default(Deframer::default()),
        }
    }

    /// Offset in the stream of the first byte not yet consumed.
    pub fn offset(&self) -> u64 {
        match self {
            Finder::Default(finder) => finder.offset(),
            Finder::Described(finder, _) => finder.offset(),
        }
    }

    /// The frames in the next bytes of the stream. The next call must begin with the bytes not consumed.
    pub fn consume(&mut self, bytes: &[u8]) -> Vec<UnitFrame> {
        let mut all = Vec::new();
        match self {
            Finder::Default(finder) => {
                finder.consume(bytes, &mut |event| {
                    if let DeframerEvent::Frame { at, kind, payload } = event {
                        let (sample, origin) = match kind {
                            FrameType::Data => (Some(read_data(payload)), TrafficOrigin::Sample),
                            FrameType::Command => (None, TrafficOrigin::Command),
                            _ => (None, TrafficOrigin::Unit),
                        };
                        all.push(UnitFrame { at, length: OVERHEAD + payload.len(), origin, sample });
                    }
                });
            }
            Finder::Described(finder, samples) => {
                finder.consume(bytes, &mut |event| {
                    if let FrameEvent::Frame { at, kind, payload } = event
                        && let Some(sample) = samples.push(at, kind, payload)
                    {
                        let length = (at - samples.begin) as usize + payload.len();
                        all.push(UnitFrame {
                            at: samples.begin,
                            length,
                            origin: TrafficOrigin::Sample,
                            sample: Some(sample),
                        });
                    }
                });
            }
        }
        all
    }
}

/// Samples of a described unit from its frames.
pub(crate) struct Samples {
    frames: Arc<FrameSet>,
    assembly: Assembly,
    sequence: Sequence,
    /// Offset of the first frame of the sample, and whether it has come.
    begin: u64,
    is_begun: bool,
    /// Number of the sample, missing ones counted.
    number: u64,
}

impl Samples {
    pub fn new(frames: &Arc<FrameSet>) -> Samples {
        let (assembly, sequence) = (Assembly::new(frames.clone()), Sequence::new(frames));
        Samples { frames: frames.clone(), assembly, sequence, begin: 0, is_begun: false, number: 0 }
    }

    /// The sample, with its number as sequence and clock, that this frame completes.
    fn push(&mut self, at: u64, kind: usize, bytes: &[u8]) -> Option<Sample> {
        let assembled = self.assembly.push(kind, bytes);
        if !self.is_begun || assembled == Assembled::Restarted {
            self.begin = at;
        }
        self.is_begun = matches!(assembled, Assembled::Waiting | Assembled::Restarted);
        if assembled != Assembled::Complete {
            return None;
        }
        self.number = self.number.saturating_add(match self.sequence.step(self.assembly.values(), None) {
            SequenceStep::First | SequenceStep::Repeat => 0,
            SequenceStep::Gap(missing) => missing.saturating_add(1),
            SequenceStep::Next | SequenceStep::Reset | SequenceStep::Jump => 1,
        });
        Some(self.sample())
    }

    fn sample(&self) -> Sample {
        let clock_count = self.number.saturating_mul(CLOCK_PER_SAMPLE);
        Sample { sequence: self.number as u16, clock_count, ..Sample::default() }
    }

    /// True if the unit sends messages of this identifier.
    pub fn has(&self, id: u32, is_extended: bool) -> bool {
        self.frames.frames.iter().any(|frame| frame.id == Some((id, is_extended)))
    }

    /// The sample that begins with this message of the unit, and whether the message belongs to a sample.
    pub fn begin(&mut self, message: &CanFrame) -> (Option<Sample>, bool) {
        let (id, data) = (Some((message.id(), message.is_extended())), message.data());
        let fits = |frame: &geu_protocol::layout::Frame| {
            frame.id == id && frame.length() == data.len() && frame.has_constants(data) && frame.checks_hold(data)
        };
        let Some(kind) = self.frames.frames.iter().position(fits) else { return (None, false) };
        let assembled = self.assembly.push(kind, data);
        let begins = !self.is_begun && assembled != Assembled::Orphan || assembled == Assembled::Restarted;
        self.is_begun = matches!(assembled, Assembled::Waiting | Assembled::Restarted);
        self.number += u64::from(begins);
        (begins.then(|| self.sample()), assembled != Assembled::Orphan)
    }
}
