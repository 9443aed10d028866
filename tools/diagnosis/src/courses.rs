//! Searched time courses: their grid, and their values in each block. Waves are cached, since every signature uses them.

use std::borrow::Cow;
use std::f64::consts::FRAC_PI_2;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use geu_model::parameter_spec::{ParameterSpec, Role};
use geu_model::temperature::RATE_SPAN_S;
use geu_model::time_profile::{COURSES, Interval, TimeCourse};
use geu_model::units::S_PER_H;

use crate::amplitude::STEP;
use crate::measured::{BLOCK_S, MeasuredData};

/// Shortest searched time constant or period, in blocks: shorter ones average out.
pub const SHORTEST_BLOCKS: f64 = 6.0;
/// Quarter periods in the recording: of the shortest searched period; the longest has two.
const QUARTER_TURNS: usize = 64;
/// Searched onsets of permanent effects.
const ONSETS: usize = 64;
/// Searched onsets of effects that settle; the first is the start of the recording.
const SETTLING_ONSETS: usize = 32;
/// Searched time constants, as shares of the recording: twice from one to the next, since a signature changes slowly with it.
const TIME_CONSTANTS: [f64; 6] = [1.0 / 64.0, 1.0 / 32.0, 1.0 / 16.0, 0.125, 0.25, 0.5];
/// Searched durations, in steps between onsets.
const DURATIONS: [usize; 10] = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32];
/// Searched onsets of immediate effects, which end with the manoeuvre.
const SUDDEN_ONSETS: usize = 4 * ONSETS;

/// Application of a time course to a signature.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// On its increments.
    Rate,
    /// On its values.
    Level,
}

/// A course put on a base.
#[derive(Debug, Clone, PartialEq)]
pub enum Variation {
    /// None.
    Constant,
    /// A kind of [`COURSES`].
    Course {
        /// Index of the kind.
        kind: usize,
        /// Shapes.
        shapes: Vec<f64>,
    },
    /// The effect's own onset, at the start of this block.
    Onset {
        /// The block.
        block: usize,
    },
}

impl Variation {
    /// Index of its course in [`COURSES`].
    pub fn kind(&self) -> Option<usize> {
        match self {
            Variation::Course { kind, .. } => Some(*kind),
            Variation::Constant | Variation::Onset { .. } => None,
        }
    }

    /// The wave with another phase; `None` if it is not a wave. It is the wave of phase 0 times the cosine of the phase plus the wave a
    /// quarter period later times the sine.
    pub fn at_phase(&self, phase_rad: f64) -> Option<Variation> {
        let Variation::Course { kind, shapes } = self else { return None };
        let index = COURSES[*kind].shapes.iter().position(|number| number.role == Role::Phase)?;
        let mut shapes = shapes.clone();
        shapes[index] = phase_rad;
        Some(Variation::Course { kind: *kind, shapes })
    }
}

/// Onset and end of a pulse: it is the difference of two steps; `None` for other time courses.
pub fn pulse_onsets_s(variation: &Variation) -> Option<[f64; 2]> {
    let Variation::Course { kind, shapes } = variation else { return None };
    let at = |role: Role| COURSES[*kind].shapes.iter().position(|number| number.role == role);
    let (onset_s, duration_s) = (shapes[at(Role::Onset)?], shapes[at(Role::Duration)?]);
    Some([onset_s, onset_s + duration_s])
}

/// True if a shape parameter is an onset.
pub fn is_onset(number: &ParameterSpec) -> bool {
    number.role == Role::Onset
}

/// Courses on one recording.
#[derive(Debug, Clone)]
pub struct Courses {
    /// By how much the electronics are warmer than the reference temperature, in each block.
    excess_k: Vec<f64>,
    /// Rate of change of that, K/h.
    rate_k_per_h: Vec<f64>,
    /// The waves of the grid.
    waves: Arc<[Wave]>,
}

/// A wave, a value for each block once it was asked for.
#[derive(Debug)]
struct Wave {
    mode: Mode,
    variation: Variation,
    values: OnceLock<Vec<f64>>,
}

impl Courses {
    /// Time courses on a recording with this electronics temperature minus the reference temperature in each block.
    pub fn new(excess_k: Vec<f64>) -> Courses {
        let none = Courses::without_waves(excess_k);
        let of_mode = |mode: Mode| {
            let all = (0..COURSES.len()).flat_map(|kind| none.variations(kind, mode));
            let quarters = all.filter_map(|wave| Some([wave.at_phase(FRAC_PI_2)?, wave])).flatten();
            quarters.map(|variation| Wave { mode, variation, values: OnceLock::new() }).collect::<Vec<_>>()
        };
        let waves = [Mode::Rate, Mode::Level].into_iter().flat_map(of_mode).collect();
        Courses { waves, ..none }
    }

    fn without_waves(excess_k: Vec<f64>) -> Courses {
        let (half, last) = ((0.5 * RATE_SPAN_S / BLOCK_S) as usize, excess_k.len().saturating_sub(1));
        let rate = |block: usize| {
            let (from, to) = (block.saturating_sub(half), (block + half).min(last));
            (excess_k[to] - excess_k[from]) / (to.max(from + 1) - from) as f64 / BLOCK_S * S_PER_H
        };
        Courses { rate_k_per_h: (0..excess_k.len()).map(rate).collect(), excess_k, waves: Arc::default() }
    }

    /// Blocks of the recording.
    pub fn blocks(&self) -> usize {
        self.excess_k.len()
    }

    /// The time courses with a delay of the recorded temperature.
    #[must_use]
    pub fn late(&self, temperature_s: f64) -> Courses {
        let last = self.blocks().saturating_sub(1) as f64;
        let source = |block: usize| (block as f64 + temperature_s / BLOCK_S).round().clamp(0.0, last) as usize;
        let excess_k = (0..self.blocks()).map(|block| self.excess_k[source(block)]).collect();
        Courses { waves: self.waves.clone(), ..Courses::without_waves(excess_k) }
    }

    /// Searched time courses of a kind of [`COURSES`], waves at phase 0.
    pub fn variations(&self, kind: usize, mode: Mode) -> Vec<Variation> {
        let has = |role: Role| COURSES[kind].shapes.iter().any(|number| number.role == role);
        let (settles, ends) = (has(Role::TimeConstant), has(Role::Duration));
        let onsets = match mode {
            _ if settles => 0..SETTLING_ONSETS,
            Mode::Level if !ends => 1..SUDDEN_ONSETS,
            _ => 1..ONSETS,
        };
        let mut all: Vec<Vec<f64>> = vec![vec![]];
        for number in COURSES[kind].shapes {
            let values = self.shape_values(number, onsets.clone());
            all = all.iter().flat_map(|before| values.iter().map(|value| [&before[..], &[*value]].concat())).collect();
        }
        let is_inside = |shapes: &Vec<f64>| !ends || shapes.iter().sum::<f64>() < self.duration_s() - BLOCK_S;
        all.into_iter().filter(is_inside).map(|shapes| Variation::Course { kind, shapes }).collect()
    }

    fn duration_s(&self) -> f64 {
        self.blocks() as f64 * BLOCK_S
    }

    /// Values of a course's shape that are looked for.
    fn shape_values(&self, number: &ParameterSpec, onsets: Range<usize>) -> Vec<f64> {
        let duration_s = self.duration_s();
        match number.role {
            Role::Onset => onsets.clone().map(|onset| duration_s * onset as f64 / onsets.end as f64).collect(),
            Role::Duration => DURATIONS.map(|steps| duration_s * steps as f64 / onsets.end as f64).to_vec(),
            Role::TimeConstant => TIME_CONSTANTS
                .map(|share| duration_s * share)
                .into_iter()
                .filter(|&constant_s| constant_s >= SHORTEST_BLOCKS * BLOCK_S)
                .collect(),
            Role::Phase => vec![0.0],
            // A period.
            _ => (2..=QUARTER_TURNS)
                .map(|quarter_turns| 4.0 * duration_s / quarter_turns as f64)
                .filter(|&period_s| period_s >= 4.0 * SHORTEST_BLOCKS * BLOCK_S)
                .collect(),
        }
    }

    /// Values of a time course in these blocks; `None` for a constant 1.
    pub fn values(&self, mode: Mode, variation: &Variation, blocks: Range<usize>) -> Option<Cow<'_, [f64]>> {
        let profile = match variation {
            Variation::Constant => return None,
            Variation::Course { kind, shapes } => COURSES[*kind].with(shapes),
            Variation::Onset { block } => COURSES[STEP].with(&[*block as f64 * BLOCK_S]),
        };
        let course = TimeCourse { effect: 0, amplitude: 0, size: 1.0, profile };
        // An increment lies between the middles of two blocks, a value in its own.
        let value = |block: usize| {
            let end_s = match mode {
                Mode::Rate => MeasuredData::middle_s(block),
                Mode::Level => (block + 1) as f64 * BLOCK_S,
            };
            course.value(&Interval {
                start_s: end_s - BLOCK_S,
                end_s,
                electronics_excess_k: self.excess_k[block],
                electronics_rate_k_per_h: self.rate_k_per_h[block],
            })
        };
        match self.waves.iter().find(|wave| wave.mode == mode && wave.variation == *variation) {
            Some(wave) => {
                let whole = wave.values.get_or_init(|| (0..self.blocks()).map(value).collect());
                Some(Cow::Borrowed(&whole[blocks]))
            }
            None => Some(Cow::Owned(blocks.map(value).collect())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cached_waves_equal_computed_waves() {
        let excess_k: Vec<f64> = (0..500).map(|block| (block as f64 * 0.01).sin()).collect();
        let own = Courses::new(excess_k.clone());
        let none = Courses::without_waves(excess_k);
        let late = own.late(150.0);
        for mode in [Mode::Rate, Mode::Level] {
            let (mut waves, mut followers) = (0, 0);
            for variation in (0..COURSES.len()).flat_map(|kind| none.variations(kind, mode)) {
                let values = none.values(mode, &variation, 30..200);
                assert_eq!(own.values(mode, &variation, 30..200), values, "{variation:?}");
                let is_wave = variation.at_phase(0.0).is_some();
                let is_kept = matches!(own.values(mode, &variation, 0..10), Some(Cow::Borrowed(_)));
                assert_eq!(is_kept, is_wave, "{variation:?}");
                waves += usize::from(is_wave);
                // Only the courses that follow the temperature depend on its delay.
                if late.values(mode, &variation, 30..200) != values {
                    assert_eq!(late.values(mode, &variation, 30..200), none.values(mode, &variation, 60..230));
                    followers += 1;
                }
            }
            assert!(waves > 10 && followers == 2, "{waves} {followers}");
        }
    }
}
