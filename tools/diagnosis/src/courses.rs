//! Searched time courses: their grid, and their values in each block. The grid is cached, since every signature uses it.

use std::borrow::Cow;
use std::collections::HashMap;
use std::f64::consts::FRAC_PI_2;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use geu_model::Configuration;
use geu_model::effect::GyroEffects;
use geu_model::parameter_spec::{ParameterSpec, Role};
use geu_model::temperature::RATE_SPAN_S;
use geu_model::time_profile::{COURSES, Interval, TimeCourse};
use geu_model::units::S_PER_H;

use crate::measured::{BLOCK, MeasuredData};
use geu_hypothesis::amplitude::STEP;

/// Shortest searched time constant, duration or quarter period, blocks: shorter ones average out.
pub const SHORTEST: f64 = 6.0;
/// Quarter periods in the recording: of the shortest searched period; the longest has two.
const QUARTER_TURNS: usize = 64;
/// Searched onsets of permanent effects. Steps of a rate have a multiple of that, if the filter forgets a rate sooner than from one onset
/// to the next.
const ONSETS: usize = 64;
/// Largest multiple: onsets every 20 s in three hours.
const MAX_FINER: f64 = 8.0;
/// Searched onsets of effects that settle; the first is the start of the recording.
const SETTLING_ONSETS: usize = 32;
/// Searched time constants, as shares of the recording: twice from one to the next, since a signature changes slowly with it.
const TIME_CONSTANTS: [f64; 6] = [1.0 / 64.0, 1.0 / 32.0, 1.0 / 16.0, 0.125, 0.25, 0.5];
/// Searched durations, in steps between onsets.
const DURATIONS: [usize; 10] = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32];
/// Searched onsets of immediate effects, which end with the manoeuvre.
const SUDDEN_ONSETS: usize = 4 * ONSETS;

/// Variation of a temperature course, as a share of its largest value, below which it is a constant: of 50 K less than any thermometer of a unit
/// resolves. The calibration parameters contain a constant, so that a larger variation alone is the signature of a drift.
const STEADY: f64 = 1e-3;

/// Time after which a step of a rate is as uncertain by the rate's own noise as by the angles, on the gyro with the largest noise: the
/// whitening filter remembers no longer.
fn memory_s(configuration: &Configuration) -> f64 {
    let interval_s = configuration.device.interval_s;
    let of_gyro = |own: &GyroEffects| {
        // The variance of a rate from angles with the density S over t is 12 S/t³; rounding has the twelfth of a sample interval.
        let angles = 12.0 * (interval_s / 12.0 + own.angle_random_walk.arcsec_per_sqrt_s.powi(2));
        let walk_s = (angles / own.drift_random_walk.arcsec_per_s_per_sqrt_s.powi(2)).powf(0.25);
        let flicker_s = (angles / (own.bias_instability.arcsec_per_h / S_PER_H).powi(2)).cbrt();
        walk_s.min(flicker_s)
    };
    configuration.gyros.iter().map(|gyro| of_gyro(&gyro.effects.constant)).fold(f64::INFINITY, f64::min)
}

/// True if a kind of [`COURSES`] has no values but 0 and 1.
pub fn is_switch(kind: usize) -> bool {
    let shapes = COURSES[kind].shapes;
    !shapes.is_empty() && shapes.iter().all(|shape| matches!(shape.role, Role::Onset | Role::Duration))
}

/// Application of a time course to a signature.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
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

    /// True for a constant, and for a time course that depends on time alone.
    pub fn is_of_time(&self) -> bool {
        self.kind().is_none_or(|kind| !COURSES[kind].follows_temperature)
    }

    /// The block of its onset, before which it is 0.
    pub fn first_block(&self, block_s: f64) -> usize {
        match self {
            Variation::Constant => 0,
            Variation::Onset { block } => *block,
            Variation::Course { kind, shapes } => {
                let first = COURSES[*kind].shapes.iter().zip(shapes).find(|(number, _)| is_onset(number));
                first.map_or(0, |(_, onset_s)| (onset_s / block_s) as usize)
            }
        }
    }

    /// Value of its first shape with this role.
    pub fn shape(&self, role: Role) -> Option<f64> {
        let Variation::Course { kind, shapes } = self else { return None };
        COURSES[*kind].shapes.iter().position(|number| number.role == role).map(|index| shapes[index])
    }

    /// Ratio of its values in two consecutive blocks after its onset, 1 for a step; `None` for other forms.
    pub fn decay(&self, block_s: f64) -> Option<f64> {
        let onset_s = self.shape(Role::Onset).filter(|_| self.shape(Role::Duration).is_none());
        onset_s.map(|_| self.shape(Role::TimeConstant).map_or(1.0, |constant_s| (-block_s / constant_s).exp()))
    }

    /// Bits of that ratio and the block from which it holds: the mean over the two before may include its onset.
    pub fn tail(&self, block_s: f64) -> Option<(u64, usize)> {
        Some((self.decay(block_s)?.to_bits(), self.first_block(block_s) + 2))
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

fn key(mode: Mode, variation: &Variation) -> Option<Key> {
    let Variation::Course { kind, shapes } = variation else { return None };
    Some((mode, *kind, std::array::from_fn(|index| shapes.get(index).map_or(0, |shape| shape.to_bits()))))
}

/// Onset and end of a pulse: it is the difference of two steps; `None` for other time courses.
pub fn pulse_onsets_s(variation: &Variation) -> Option<[f64; 2]> {
    let (onset_s, duration_s) = (variation.shape(Role::Onset)?, variation.shape(Role::Duration)?);
    Some([onset_s, onset_s + duration_s])
}

/// The shortest searched value of a time constant or of a duration; `None` for other shape parameters.
pub fn shortest_s(role: Role, block_s: f64) -> Option<f64> {
    matches!(role, Role::TimeConstant | Role::Duration).then_some(SHORTEST * block_s)
}

/// True if a kind of [`COURSES`] has a shape parameter with this role.
fn has(kind: usize, role: Role) -> bool {
    COURSES[kind].shapes.iter().any(|number| number.role == role)
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
    /// Length of a block.
    pub block_s: f64,
    /// Start of the recording on the time scale of the courses.
    start_s: f64,
    /// Searched onsets of steps of a rate.
    rate_steps: usize,
    /// Memory of the whitening filter for a rate.
    memory_s: f64,
    /// Values of the grid's courses of time alone, from the first block on, once they were asked for.
    grid: Arc<HashMap<Key, OnceLock<Vec<f64>>>>,
}

/// A course of the grid: mode, index in [`COURSES`] and bits of the shapes.
type Key = (Mode, usize, [u64; 2]);

impl Courses {
    /// Time courses on a recording.
    pub fn on(measured: &MeasuredData, configuration: &Configuration) -> Courses {
        let reference_c = configuration.electronics.numbers.reference_c;
        let excess_k = measured.electronics_c().iter().map(|electronics_c| electronics_c - reference_c).collect();
        let all = Courses { start_s: measured.start_s, ..Courses::at(excess_k, measured.block_s()) };
        let memory_s = memory_s(configuration);
        let finer = (all.duration_s() / ONSETS as f64 / memory_s).ceil().clamp(1.0, MAX_FINER);
        Courses { rate_steps: finer as usize * ONSETS, memory_s, ..all }
    }

    /// With a cache of the values on the grid.
    #[must_use]
    pub fn with_grid(self) -> Courses {
        let of_mode = |mode: Mode| {
            let all = (0..COURSES.len()).flat_map(|kind| self.variations(kind, mode)).filter(Variation::is_of_time);
            let with_quarters = all.flat_map(|course| [course.at_phase(FRAC_PI_2), Some(course)]).flatten();
            with_quarters.filter_map(move |course| Some((key(mode, &course)?, OnceLock::new()))).collect::<Vec<_>>()
        };
        let grid = [Mode::Rate, Mode::Level].into_iter().flat_map(of_mode).collect();
        Courses { grid: Arc::new(grid), ..self }
    }

    /// Without a cache, with this electronics temperature minus the reference temperature in each block.
    fn at(excess_k: Vec<f64>, block_s: f64) -> Courses {
        let (half, last) = ((0.5 * RATE_SPAN_S / block_s) as usize, excess_k.len().saturating_sub(1));
        let rate = |block: usize| {
            let (from, to) = (block.saturating_sub(half), (block + half).min(last));
            (excess_k[to] - excess_k[from]) / (to.max(from + 1) - from) as f64 / block_s * S_PER_H
        };
        let rate_k_per_h = (0..excess_k.len()).map(rate).collect();
        Courses {
            rate_k_per_h,
            excess_k,
            block_s,
            start_s: 0.0,
            rate_steps: ONSETS,
            memory_s: f64::INFINITY,
            grid: Arc::default(),
        }
    }

    /// Blocks of the recording.
    pub fn blocks(&self) -> usize {
        self.excess_k.len()
    }

    /// The time courses with a delay of the recorded temperature.
    #[must_use]
    pub fn late(&self, temperature_s: f64) -> Courses {
        let last = self.blocks().saturating_sub(1) as f64;
        let source = |block: usize| (block as f64 + temperature_s / self.block_s).round().clamp(0.0, last) as usize;
        let excess_k = (0..self.blocks()).map(|block| self.excess_k[source(block)]).collect();
        let Courses { excess_k, rate_k_per_h, .. } = Courses::at(excess_k, self.block_s);
        Courses { excess_k, rate_k_per_h, ..self.clone() }
    }

    /// Searched time courses of a kind of [`COURSES`], waves at phase 0.
    pub fn variations(&self, kind: usize, mode: Mode) -> Vec<Variation> {
        let onsets = self.onsets(kind, mode);
        let mut all: Vec<Vec<f64>> = vec![vec![]];
        for number in COURSES[kind].shapes {
            let values = self.shape_values(number, onsets.clone());
            all = all.iter().flat_map(|before| values.iter().map(|value| [&before[..], &[*value]].concat())).collect();
        }
        let is_inside = |shapes: &Vec<f64>| {
            !has(kind, Role::Duration) || shapes.iter().sum::<f64>() < self.duration_s() - self.block_s
        };
        let all = all.into_iter().filter(is_inside).map(|shapes| Variation::Course { kind, shapes });
        all.filter(|variation| variation.is_of_time() || self.varies(mode, variation)).collect()
    }

    /// Searched onsets of a kind, in parts of the recording.
    fn onsets(&self, kind: usize, mode: Mode) -> Range<usize> {
        match mode {
            Mode::Rate if has(kind, Role::TimeConstant) => 0..SETTLING_ONSETS,
            Mode::Level if has(kind, Role::TimeConstant) => 0..2 * ONSETS,
            Mode::Level if !has(kind, Role::Duration) => 1..SUDDEN_ONSETS,
            Mode::Rate if kind == STEP => 1..self.rate_steps,
            _ => 1..ONSETS,
        }
    }

    /// Independent time courses of a rate for each searched course of a kind, 1 or more: the filter's memory, of a block or more, separates
    /// onsets, and ends. Ends long after the onset have a coarser grid; that is not counted.
    pub fn independent_courses(&self, kind: usize) -> f64 {
        let spacing_s = self.duration_s() / self.onsets(kind, Mode::Rate).end as f64;
        let separate = (spacing_s / self.memory_s.max(self.block_s)).max(1.0);
        let ends = [Role::Onset, Role::Duration].into_iter().filter(|role| has(kind, *role));
        ends.map(|_| separate).product()
    }

    /// False for a course of the temperature that is a constant in this recording: the amplitude without a course explains the same.
    fn varies(&self, mode: Mode, variation: &Variation) -> bool {
        let values = self.values(mode, variation, 0..self.blocks()).unwrap_or_default();
        let [min, max] = values
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[min, max], value| [value.min(min), value.max(max)]);
        max - min > STEADY * max.max(-min)
    }

    /// Spacing of steps of a rate, if it is less than that of other courses.
    pub fn rate_step_spacing_s(&self) -> Option<f64> {
        (self.rate_steps > ONSETS).then(|| self.duration_s() / self.rate_steps as f64)
    }

    fn duration_s(&self) -> f64 {
        self.blocks() as f64 * self.block_s
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
                .filter(|&constant_s| constant_s >= SHORTEST * self.block_s)
                .collect(),
            Role::Phase => vec![0.0],
            // A period.
            _ => (2..=QUARTER_TURNS)
                .map(|quarter_turns| 4.0 * duration_s / quarter_turns as f64)
                .filter(|&period_s| period_s >= 4.0 * SHORTEST * self.block_s)
                .collect(),
        }
    }

    /// Values of a time course in these blocks; `None` for a constant 1.
    pub fn values(&self, mode: Mode, variation: &Variation, blocks: Range<usize>) -> Option<Cow<'_, [f64]>> {
        let profile = match variation {
            Variation::Constant => return None,
            Variation::Course { kind, shapes } => COURSES[*kind].with(shapes),
            Variation::Onset { block } => COURSES[STEP].with(&[*block as f64 * self.block_s]),
        };
        let course = TimeCourse { effect: 0, amplitude: 0, size: 1.0, profile };
        // An increment lies between the middles of two blocks, a value in its own.
        let value = |block: usize| {
            let end_s = self.start_s
                + match mode {
                    Mode::Rate => middle_s(block, self.block_s),
                    Mode::Level => (block + 1) as f64 * self.block_s,
                };
            course.value(&Interval {
                start_s: end_s - self.block_s,
                end_s,
                electronics_excess_k: self.excess_k[block],
                electronics_rate_k_per_h: self.rate_k_per_h[block],
            })
        };
        let first = variation.first_block(self.block_s);
        match key(mode, variation).and_then(|key| self.grid.get(&key)).filter(|_| first <= blocks.start) {
            Some(values) => {
                let values = values.get_or_init(|| (first..self.blocks()).map(value).collect());
                Some(Cow::Borrowed(&values[blocks.start - first..blocks.end - first]))
            }
            None => Some(Cow::Owned(blocks.map(value).collect())),
        }
    }
}

/// Middle of a block: of the times of its nodes, s.
fn middle_s(block: usize, block_s: f64) -> f64 {
    (block as f64 + 0.5) * block_s + 0.5 * block_s / BLOCK as f64
}

/// A time course applied to a signature, over some blocks.
pub fn put(series: &[f64], mode: Mode, course: Option<&[f64]>, blocks: Range<usize>) -> Vec<f64> {
    let from = blocks.start;
    // A unit with fewer gyros leaves channels empty.
    let own = series.get(blocks).unwrap_or_default();
    let Some(course) = course else { return own.to_vec() };
    let own = own.iter().zip(course);
    match mode {
        Mode::Level => own.map(|(value, factor)| value * factor).collect(),
        Mode::Rate => {
            let (mut sum, mut before) =
                (0.0, if from == 0 { 0.0 } else { series.get(from - 1).copied().unwrap_or(0.0) });
            own.map(|(value, factor)| {
                sum += (value - std::mem::replace(&mut before, *value)) * factor;
                sum
            })
            .collect()
        }
    }
}

#[cfg(test)]
mod tests;
