//! Samples from frames, each with a part of the values.

use std::sync::Arc;

use super::{FrameSet, Quantity};
use crate::continuity::SequenceStep;

/// Puts the values of frames together: a sample is complete when every frame that is sent with each sample has come.
///
/// A frame that is sent less often comes before the others of its sample.
#[derive(Debug, Clone)]
pub struct Assembly {
    frames: Arc<FrameSet>,
    values: Vec<f64>,
    /// Frames that have come, a bit for each.
    seen: u64,
    /// Frames of every sample.
    every: u64,
}

/// Result of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Assembled {
    /// More frames are missing.
    Waiting,
    /// The sample is complete; [`Assembly::values`] are its values.
    Complete,
    /// The frame came again before the sample before was complete.
    Restarted,
}

impl Assembly {
    /// Largest number of frames.
    pub const MAX_FRAMES: usize = 64;

    pub fn new(frames: Arc<FrameSet>) -> Assembly {
        let bits = frames.frames.iter().take(Assembly::MAX_FRAMES).enumerate();
        let every = bits.filter(|(_, frame)| frame.every == 1).map(|(index, _)| 1 << index).sum();
        Assembly { values: vec![f64::NAN; frames.values.len()], frames, seen: 0, every }
    }

    /// Values of the complete sample, in the order of the quantities; `NaN` where no frame had it.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// True if a sample has begun.
    pub fn is_waiting(&self) -> bool {
        self.seen & self.every != 0 && self.seen & self.every != self.every
    }

    /// Reads a frame of this number; its check holds.
    #[inline]
    pub fn push(&mut self, kind: usize, bytes: &[u8]) -> Assembled {
        let bit = 1 << kind;
        let is_complete = self.seen & self.every == self.every;
        let is_again = !is_complete && self.seen & bit != 0;
        if is_complete || is_again {
            self.seen = 0;
            self.values.fill(f64::NAN);
        }
        self.seen |= bit;
        self.frames.frames[kind].read(bytes, &mut self.values);
        match is_again {
            _ if self.seen & self.every == self.every => Assembled::Complete,
            true => Assembled::Restarted,
            false => Assembled::Waiting,
        }
    }
}

/// Follows the sequence through samples.
#[derive(Debug, Clone)]
pub struct Sequence {
    slot: Option<usize>,
    modulus: u64,
    step: u64,
    last: Option<u64>,
}

impl Sequence {
    /// The sequence of these frames, if they have one.
    pub fn new(frames: &FrameSet) -> Sequence {
        let (modulus, step) = frames.sequence;
        Sequence { slot: frames.slot(&Quantity::Sequence), modulus, step, last: None }
    }

    /// Compares a sample with the one before; without a sequence each is the next.
    pub fn step(&mut self, values: &[f64]) -> SequenceStep {
        let number = self.slot.map_or(0.0, |slot| values[slot]);
        let Some(last) = self.last.replace(number as u64) else { return SequenceStep::First };
        if self.slot.is_none() {
            return SequenceStep::Next;
        }
        let ahead = (number as u64 + self.modulus - last % self.modulus) % self.modulus;
        match ahead / self.step {
            _ if ahead == 0 => SequenceStep::Repeat,
            _ if !ahead.is_multiple_of(self.step) || ahead > self.modulus / 2 => SequenceStep::Jump,
            1 => SequenceStep::Next,
            steps => SequenceStep::Gap(steps - 1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::{BitField, Field, Frame, Number, ValueSpec};

    fn frames(sequence: (u64, u64)) -> Arc<FrameSet> {
        let frame = |name: &str, slot, every| {
            let mut frame = Frame::new(name, 1);
            frame.fields.push(Field::new(slot, BitField::bytes(0, Number::from_name("u8").unwrap())));
            frame.every = every;
            frame
        };
        let value = |quantity| ValueSpec { quantity, name: String::new(), factor: 1.0 };
        let values = [Quantity::Sensor, Quantity::Output(0), Quantity::Sequence].map(value).to_vec();
        let frames = vec![frame("SLOW", 0, 10), frame("A", 1, 1), frame("B", 2, 1)];
        Arc::new(FrameSet { frames, values, sequence })
    }

    #[test]
    fn a_sample_is_complete_with_its_frames_in_any_order() {
        let mut assembly = Assembly::new(frames((256, 1)));
        assert_eq!(assembly.push(0, &[70]), Assembled::Waiting);
        assert_eq!(assembly.push(2, &[5]), Assembled::Waiting);
        assert!(assembly.is_waiting());
        assert_eq!(assembly.push(1, &[8]), Assembled::Complete);
        assert_eq!(assembly.values(), [70.0, 8.0, 5.0]);
        assert_eq!(assembly.push(1, &[9]), Assembled::Waiting);
        assert_eq!(assembly.push(1, &[10]), Assembled::Restarted);
        assert_eq!(assembly.push(2, &[6]), Assembled::Complete);
        assert!(assembly.values()[0].is_nan() && assembly.values()[1..] == [10.0, 6.0]);
        assert!(!assembly.is_waiting());
    }

    #[test]
    fn missing_samples_are_counted_by_the_sequence() {
        let steps = |numbers: &[u8], modulus, step| {
            let mut sequence = Sequence::new(&frames((modulus, step)));
            numbers.iter().map(|number| sequence.step(&[0.0, 0.0, f64::from(*number)])).collect::<Vec<_>>()
        };
        use SequenceStep::{First, Gap, Jump, Next, Repeat};
        assert_eq!(steps(&[126, 127, 0, 3, 3, 2], 128, 1), [First, Next, Next, Gap(2), Repeat, Jump]);
        assert_eq!(steps(&[240, 0, 48, 50], 256, 16), [First, Next, Gap(2), Jump]);
    }
}
