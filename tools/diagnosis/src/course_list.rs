//! The time courses of a signature in the order of a sweep. Pulses and waves follow from two evaluated courses.
//!
//! A wave of any phase is a sum of two waves with a quarter period between them; a pulse is the difference of two steps.

use std::cmp::Reverse;
use std::f64::consts::FRAC_PI_2;
use std::hash::{DefaultHasher, Hash, Hasher};

use crate::courses::{Variation, pulse_onsets_s};
use crate::signature_bank::{ConstantSignature, SignatureBank};
use geu_hypothesis::amplitude::STEP;

/// Onsets of the grid differ by more.
const SAME_ONSET_S: f64 = 1e-3;

/// Bits of the ratio of the values in consecutive blocks, and the first of these.
pub type TailStart = (u64, Reverse<usize>);

/// A result of a sweep, with the places of its courses.
pub enum Sweep {
    /// A course itself.
    Course(usize),
    /// A pulse: a step minus another.
    Pulse(Variation, [usize; 2]),
    /// Waves of all phases.
    Wave([usize; 2]),
}

/// Courses and results.
pub struct CourseList {
    /// The courses.
    pub courses: Vec<Variation>,
    /// Results.
    pub results: Vec<Sweep>,
}

impl CourseList {
    pub fn new(bank: &SignatureBank, base: &ConstantSignature) -> CourseList {
        let mut list = CourseList { courses: Vec::new(), results: Vec::new() };
        // In order of their onsets, as the grid has them.
        let mut steps: Vec<(f64, usize)> = Vec::new();
        for variation in bank.variations(base) {
            if let Some(onsets_s) = pulse_onsets_s(&variation) {
                let at = |onset_s: f64| {
                    let place = steps.partition_point(|step| step.0 <= onset_s - SAME_ONSET_S);
                    steps.get(place).filter(|step| step.0 < onset_s + SAME_ONSET_S)
                };
                if let [Some((_, begin)), Some((_, end))] = onsets_s.map(at) {
                    list.results.push(Sweep::Pulse(variation, [*begin, *end]));
                }
                continue;
            }
            let place = list.courses.len();
            if let (Some(STEP), Variation::Course { shapes, .. }) = (variation.kind(), &variation) {
                steps.push((shapes[0], place));
            }
            let quarter = variation.at_phase(FRAC_PI_2);
            list.results.push(quarter.as_ref().map_or(Sweep::Course(place), |_| Sweep::Wave([place, place + 1])));
            list.courses.push(variation);
            list.courses.extend(quarter);
        }
        list
    }

    /// Places of the two courses of each pulse and wave.
    pub fn pairs(&self) -> impl Iterator<Item = [usize; 2]> {
        self.results.iter().filter_map(|result| match result {
            Sweep::Course(_) => None,
            Sweep::Pulse(_, two) | Sweep::Wave(two) => Some(*two),
        })
    }

    /// True if products with a course are kept: not with a part of the recording alone, nor with courses of the temperature, which has a
    /// delay.
    pub fn is_kept(&self, place: usize) -> bool {
        self.courses[place].is_of_time() && !matches!(self.courses[place], Variation::Onset { .. })
    }

    /// From which block on a kept course decays to the end, at most the last one; `None` for other forms.
    pub fn tail(&self, place: usize, blocks: usize, block_s: f64) -> Option<TailStart> {
        let (decay, block) = self.courses[place].tail(block_s).filter(|_| self.is_kept(place))?;
        Some((decay, Reverse(block.min(blocks - 1))))
    }

    /// Hash of the kinds of the courses: courses of the temperature depend on its delay.
    pub fn key(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        self.courses.iter().for_each(|course| course.kind().hash(&mut hasher));
        hasher.finish()
    }

    /// Places of the kept courses that are whitened, `most` of a kind at once; if they have tails, without courses that decay to the end.
    pub fn whitened(&self, most: usize, has_tails: bool, block_s: f64) -> Vec<Vec<usize>> {
        let is_whitened = |place: &usize| {
            let has_tail = has_tails && self.courses[*place].tail(block_s).is_some();
            self.is_kept(*place) && !has_tail
        };
        let all: Vec<usize> = (0..self.courses.len()).filter(is_whitened).collect();
        let same = |one: &usize, other: &usize| self.courses[*one].kind() == self.courses[*other].kind();
        all.chunk_by(same).flat_map(|same| same.chunks(most)).map(<[usize]>::to_vec).collect()
    }
}
