//! Samples from frames, each with a part of the values.

use std::sync::Arc;

use super::plan::FieldPlan;
use super::{Frame, FrameSet, Quantity};
use crate::continuity::SequenceStep;

/// Puts the values of frames together: a sample is complete when every frame that is sent with each sample has come.
///
/// Frames with the same number of the sequence make a sample. Where not all of them have the sequence, the first one listed begins a
/// sample. A frame that is sent less often comes before the others of its sample. A frame may come instead of another.
#[derive(Debug, Clone)]
pub struct Assembly {
    frames: Arc<FrameSet>,
    plans: Vec<FieldPlan>,
    values: Vec<f64>,
    /// Frames that have come, a bit for each.
    seen: u64,
    /// Frames of every sample.
    every: u64,
    /// Place of the sequence in the values, and the frames that have it.
    sequence: Option<(usize, u64)>,
    /// The frame that begins a sample, if they have no common sequence.
    first: Option<usize>,
}

/// Result of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Assembled {
    /// More frames are missing.
    Waiting,
    /// The sample is complete; [`Assembly::values`] are its values.
    Complete,
    /// The frame begins another sample before the sample before was complete.
    Restarted,
    /// The frame belongs to a sample of which the beginning is missing.
    Orphan,
}

impl Assembly {
    /// Largest number of frames.
    pub const MAX_FRAMES: usize = 64;

    pub fn new(frames: Arc<FrameSet>) -> Assembly {
        let bits = |wanted: &dyn Fn(&Frame) -> bool| {
            let all = frames.frames.iter().take(Assembly::MAX_FRAMES).enumerate();
            all.filter(|(_, frame)| wanted(frame)).map(|(index, _)| 1u64 << index).sum::<u64>()
        };
        let every = bits(&|frame| frame.every == 1 && frame.instead_of.is_none());
        let slot = frames.slot(&Quantity::Sequence);
        let sequence = slot.map(|slot| (slot, bits(&|frame| frame.fields.iter().any(|field| field.slot == slot))));
        let sent = bits(&|frame| frame.every == 1);
        let is_common = sequence.is_some_and(|(_, own)| own & sent == sent);
        Assembly {
            values: vec![f64::NAN; frames.values.len()],
            plans: frames.frames.iter().map(|frame| FieldPlan::new(&frame.fields, frame.length())).collect(),
            frames,
            seen: 0,
            every,
            sequence,
            first: (!is_common).then_some(every.trailing_zeros() as usize),
        }
    }

    /// Values of the complete sample, in the order of the set's values; `NaN` where no frame had it.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// True if a sample has begun.
    pub fn is_waiting(&self) -> bool {
        self.seen & self.every != 0 && !self.is_complete()
    }

    fn is_complete(&self) -> bool {
        self.seen & self.every == self.every
    }

    /// True if a frame has the sequence, with another number than the sample.
    fn is_other(&self, kind: usize, bytes: &[u8]) -> bool {
        let Some((slot, _)) = self.sequence.filter(|(_, own)| own & 1 << kind != 0) else { return false };
        let field = self.frames.frames[kind].fields.iter().find(|field| field.slot == slot);
        !self.values[slot].is_nan() && field.is_some_and(|field| field.read(bytes) != self.values[slot])
    }

    /// Reads a frame of this number; its check holds.
    #[inline]
    pub fn push(&mut self, kind: usize, bytes: &[u8]) -> Assembled {
        let place = self.frames.frames[kind].instead_of.unwrap_or(kind);
        let bit = 1u64 << place;
        let is_complete = self.is_complete();
        let is_restart = self.seen != 0 && !is_complete && (self.seen & bit != 0 || self.is_other(kind, bytes));
        let was_waiting = self.is_waiting();
        if is_complete || is_restart {
            self.seen = 0;
            self.values.fill(f64::NAN);
        }
        let is_orphan = self.first.is_some_and(|first| place != first && self.seen & 1 << first == 0);
        if is_orphan && bit & self.every != 0 {
            return Assembled::Orphan;
        }
        self.seen |= bit;
        self.plans[kind].read(bytes, &mut self.values);
        match self.is_complete() {
            true => Assembled::Complete,
            false if is_restart && was_waiting => Assembled::Restarted,
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
        let is_carried =
            |slot: &usize| frames.frames.iter().flat_map(|frame| &frame.fields).any(|field| field.slot == *slot);
        Sequence { slot: frames.slot(&Quantity::Sequence).filter(is_carried), modulus, step, last: None }
    }

    /// Compares a sample with the one before; without a sequence each is the next. `intervals`, if known, is the time between the two: it
    /// decides how often the sequence began anew.
    pub fn step(&mut self, values: &[f64], intervals: Option<f64>) -> SequenceStep {
        let number = self.slot.map_or(0, |slot| values[slot] as u64);
        let number = if number < self.modulus { number } else { number % self.modulus };
        let Some(last) = self.last.replace(number) else { return SequenceStep::First };
        if self.slot.is_none() {
            return SequenceStep::Next;
        }
        // The usual step, without divisions.
        let next = last + self.step;
        let next = if next >= self.modulus { next - self.modulus } else { next };
        if number == next && intervals.is_none_or(|intervals| intervals * 2.0 < (self.modulus / self.step) as f64) {
            return SequenceStep::Next;
        }
        let ahead = (number + self.modulus - last) % self.modulus;
        if !ahead.is_multiple_of(self.step) {
            return SequenceStep::Jump;
        }
        let (ahead, cycle) = (ahead / self.step, self.modulus / self.step);
        let anew = intervals.map_or(0.0, |intervals| ((intervals - ahead as f64) / cycle as f64).round());
        match ahead + cycle * anew.clamp(0.0, MAX_CYCLES) as u64 {
            0 => SequenceStep::Repeat,
            1 => SequenceStep::Next,
            steps if steps as f64 - intervals.unwrap_or(0.0) > cycle as f64 / 2.0 => SequenceStep::Jump,
            steps => SequenceStep::Gap(steps - 1),
        }
    }
}

/// Cycles of the sequence in one gap, at most; more are a wrong time.
const MAX_CYCLES: f64 = 1e9;

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
        let value = |quantity| ValueSpec { quantity, name: String::new(), unit: "", factor: 1.0 };
        let values = [Quantity::Sensor, Quantity::Output(0), Quantity::Sequence].map(value).to_vec();
        let frames = vec![frame("SLOW", 0, 10), frame("A", 1, 1), frame("B", 2, 1)];
        Arc::new(FrameSet { frames, values, sequence })
    }

    #[test]
    fn a_sample_is_complete_with_its_frames() {
        let mut assembly = Assembly::new(frames((256, 1)));
        assert_eq!(assembly.push(0, &[70]), Assembled::Waiting);
        assert!(!assembly.is_waiting());
        assert_eq!(assembly.push(1, &[8]), Assembled::Waiting);
        assert!(assembly.is_waiting());
        assert_eq!(assembly.push(2, &[5]), Assembled::Complete);
        assert_eq!(assembly.values(), [70.0, 8.0, 5.0]);
        assert_eq!(assembly.push(1, &[9]), Assembled::Waiting);
        assert_eq!(assembly.push(1, &[10]), Assembled::Restarted);
        assert_eq!(assembly.push(2, &[6]), Assembled::Complete);
        assert!(assembly.values()[0].is_nan() && assembly.values()[1..] == [10.0, 6.0]);
        assert!(!assembly.is_waiting());
    }

    #[test]
    fn a_missing_frame_never_joins_two_samples() {
        // A common sequence: by its number; without one: by the order.
        let frame = |slots: &[usize]| {
            let mut frame = Frame::new("F", 2);
            for (at, slot) in slots.iter().enumerate() {
                frame.fields.push(Field::new(*slot, BitField::bytes(at, Number::from_name("u8").unwrap())));
            }
            frame
        };
        let set = |frames| {
            let value = |quantity| ValueSpec { quantity, name: String::new(), unit: "", factor: 1.0 };
            let values = [Quantity::Output(0), Quantity::Output(1), Quantity::Sequence].map(value).to_vec();
            Assembly::new(Arc::new(FrameSet { frames, values, sequence: (256, 1) }))
        };
        let mut common = set(vec![frame(&[0, 2]), frame(&[1, 2])]);
        assert_eq!(common.push(1, &[7, 1]), Assembled::Waiting);
        assert_eq!(common.push(0, &[8, 2]), Assembled::Restarted);
        assert_eq!(common.push(1, &[9, 2]), Assembled::Complete);
        assert_eq!(common.values(), [8.0, 9.0, 2.0]);
        let mut ordered = set(vec![frame(&[0]), frame(&[1])]);
        assert_eq!(ordered.push(1, &[7, 0]), Assembled::Orphan);
        assert_eq!(ordered.push(0, &[8, 0]), Assembled::Waiting);
        assert_eq!(ordered.push(1, &[9, 0]), Assembled::Complete);
        assert_eq!(ordered.push(1, &[9, 0]), Assembled::Orphan);
    }

    #[test]
    fn a_frame_may_come_instead_of_another() {
        let mut set = (*frames((256, 1))).clone();
        let mut other = set.frames[1].clone();
        other.instead_of = Some(1);
        set.frames.push(other);
        let mut assembly = Assembly::new(Arc::new(set));
        for kind in [1, 3, 1] {
            assert_eq!(assembly.push(kind, &[kind as u8]), Assembled::Waiting);
            assert_eq!(assembly.push(2, &[5]), Assembled::Complete);
            assert_eq!(assembly.values()[1..], [kind as f64, 5.0]);
        }
        assert_eq!(assembly.push(1, &[8]), Assembled::Waiting);
        assert_eq!(assembly.push(3, &[9]), Assembled::Restarted);
    }

    #[test]
    fn a_link_without_the_sequence_of_another_has_none() {
        let mut set = (*frames((256, 1))).clone();
        set.frames.pop();
        let mut sequence = Sequence::new(&set);
        let steps = [0, 1].map(|_| sequence.step(&[0.0, 0.0, f64::NAN], None));
        assert_eq!(steps, [SequenceStep::First, SequenceStep::Next]);
    }

    #[test]
    fn the_time_decides_how_often_the_sequence_began_anew() {
        let mut sequence = Sequence::new(&frames((16, 1)));
        let mut step = |number: f64, intervals| sequence.step(&[0.0, 0.0, number], intervals);
        assert_eq!(step(3.0, None), SequenceStep::First);
        assert_eq!(step(4.0, Some(1.3)), SequenceStep::Next);
        assert_eq!(step(14.0, Some(10.2)), SequenceStep::Gap(9));
        assert_eq!(step(15.0, Some(32.9)), SequenceStep::Gap(32));
        assert_eq!(step(15.0, Some(0.1)), SequenceStep::Repeat);
        // A number before the last one, and a time before the last one.
        assert_eq!(step(14.0, Some(0.1)), SequenceStep::Jump);
        assert_eq!(step(13.0, Some(-99.0)), SequenceStep::Jump);
    }

    #[test]
    fn missing_samples_are_counted_by_the_sequence() {
        let steps = |numbers: &[u8], modulus, step| {
            let mut sequence = Sequence::new(&frames((modulus, step)));
            numbers.iter().map(|number| sequence.step(&[0.0, 0.0, f64::from(*number)], None)).collect::<Vec<_>>()
        };
        use SequenceStep::{First, Gap, Jump, Next, Repeat};
        assert_eq!(steps(&[126, 127, 0, 3, 3, 2], 128, 1), [First, Next, Next, Gap(2), Repeat, Jump]);
        assert_eq!(steps(&[240, 0, 48, 50], 256, 16), [First, Next, Gap(2), Jump]);
    }
}
