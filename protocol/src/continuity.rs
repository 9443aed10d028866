//! Continuity of samples: sequence against clock count.

use crate::field::{CLOCK_MODULUS, CLOCK_PER_SAMPLE};

/// Maximum plausible gap, samples: a week. A larger gap is a corrupt sequence or clock.
pub const MAX_MISSING: u64 = 1_209_600;

/// True if the clock advanced by 500 000 per sequence step; the sequence may have wrapped any number of times.
pub fn clock_follows(before: (u16, u64), now: (u16, u64)) -> bool {
    let steps = u64::from(now.0.wrapping_sub(before.0));
    let advance = now.1.wrapping_sub(before.1) & (CLOCK_MODULUS - 1);
    advance == steps * CLOCK_PER_SAMPLE
        || (advance.is_multiple_of(CLOCK_PER_SAMPLE)
            && (advance / CLOCK_PER_SAMPLE) & 0xFFFF == steps
            && now.1 > before.1)
}

/// True if sequence and clock both count from a RESET_SEQUENCE.
fn restarted((sequence, clock_count): (u16, u64)) -> bool {
    clock_count == (u64::from(sequence) + 1) * CLOCK_PER_SAMPLE
}

/// Rejects clock counts that do not follow the accepted ones. A rejected count is kept; a second count that follows it is
/// accepted again.
#[derive(Debug, Clone, Default)]
pub struct ClockCheck {
    /// Sequence and clock of the last accepted sample.
    accepted: Option<(u16, u64)>,
    /// Sequence and clock of a sample rejected since.
    rejected: Option<(u16, u64)>,
}

impl ClockCheck {
    /// True if this sequence and clock count follow the accepted or the last rejected ones.
    #[inline]
    pub fn accepts(&mut self, sequence: u16, clock_count: u64) -> bool {
        let now = (sequence, clock_count);
        let follows = |before: Option<(u16, u64)>| before.is_some_and(|before| clock_follows(before, now));
        if self.accepted.is_none() || follows(self.accepted) || follows(self.rejected) || restarted(now) {
            (self.accepted, self.rejected) = (Some(now), None);
            true
        } else {
            self.rejected = Some(now);
            false
        }
    }
}

/// Relation of a sample to the one before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SequenceStep {
    /// The first sample.
    First,
    Next,
    Repeat,
    Gap(u64),
    Reset,
    /// The sequence does not follow.
    Jump,
}

/// Follows the sequence through samples, by the clock where both have one.
#[derive(Debug, Clone, Default)]
pub struct Continuity {
    last: Option<(u16, Option<u64>)>,
}

impl Continuity {
    /// Compares a sample with the one before.
    #[inline]
    pub fn step(&mut self, sequence: u16, clock_count: Option<u64>) -> SequenceStep {
        let Some((last_sequence, last_clock)) = self.last.replace((sequence, clock_count)) else {
            return SequenceStep::First;
        };
        let steps = sequence.wrapping_sub(last_sequence);
        match (last_clock, clock_count) {
            (Some(before), Some(now)) if clock_follows((last_sequence, before), (sequence, now)) => {
                match now.wrapping_sub(before) & (CLOCK_MODULUS - 1) {
                    0 => SequenceStep::Repeat,
                    CLOCK_PER_SAMPLE => SequenceStep::Next,
                    advance => SequenceStep::Gap(advance / CLOCK_PER_SAMPLE - 1),
                }
            }
            (Some(_), Some(now)) if restarted((sequence, now)) => SequenceStep::Reset,
            (Some(_), Some(_)) if steps != 1 => SequenceStep::Jump,
            _ => match steps {
                0 => SequenceStep::Repeat,
                1 => SequenceStep::Next,
                0x8000.. => SequenceStep::Jump,
                steps => SequenceStep::Gap(u64::from(steps) - 1),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_wraps_at_48_bits_and_the_sequence_any_number_of_times() {
        assert!(clock_follows((65_535, CLOCK_MODULUS - 500_000), (0, 0)));
        assert!(clock_follows((3, 1_000_000), (4, 1_000_000 + (65_536 + 1) * 500_000)));
        assert!(!clock_follows((3, 1_000_000), (4, 1_000_000)));
        assert!(clock_follows((3, 1_000_000), (3, 1_000_000)));
    }

    #[test]
    fn steps_are_counted_by_the_clock_and_without_it_by_the_sequence() {
        let step = |before: (u16, Option<u64>), now: (u16, Option<u64>)| {
            let mut continuity = Continuity::default();
            assert_eq!(continuity.step(before.0, before.1), SequenceStep::First);
            continuity.step(now.0, now.1)
        };
        let at = |n: u64| (n as u16, Some(7 + n * CLOCK_PER_SAMPLE));
        assert_eq!(step(at(5), at(6)), SequenceStep::Next);
        assert_eq!(step(at(5), at(5)), SequenceStep::Repeat);
        assert_eq!(step(at(5), at(8)), SequenceStep::Gap(2));
        assert_eq!(step(at(5), at(5 + 65_536)), SequenceStep::Gap(65_535));
        assert_eq!(step(at(65_535), at(65_536)), SequenceStep::Next);
        assert_eq!(step(at(5), (0, Some(500_000))), SequenceStep::Reset);
        assert_eq!(step(at(5), (9, Some(1))), SequenceStep::Jump);
        assert_eq!(step((5, None), (8, None)), SequenceStep::Gap(2));
        assert_eq!(step((5, None), at(5)), SequenceStep::Repeat);
        assert_eq!(step((5, None), (4, None)), SequenceStep::Jump);
    }
}
