//! Signatures: what each amplitude of the model, with each course, would add to the channels of this recording.
//!
//! A signature comes from running the model with the amplitude moved. A course in time takes the signature of the constant amplitude
//! apart and puts it together again with the course's own law, by its increments (what adds a rate: a drift) or by its values (what
//! adds an angle: lost counts), whichever one run with a step in its middle shows to be right. That is for finding; what is found
//! is fitted by the model itself.

use std::ops::Range;
use std::sync::Arc;

use geu_model::Configuration;
use geu_model::course::KINDS;
use geu_model::number::{DefaultValue, Role};
use rayon::prelude::*;

use crate::amplitude::{AmplitudeRef, STEP, is_real};
pub use crate::courses::Variation;
use crate::courses::{Courses, Mode, SHORTEST_BLOCKS, is_onset};
use crate::gyros::ALL_GYROS;
use crate::hypothesis::Hypothesis;
use crate::measured::{BLOCK_S, CHANNELS, MeasuredData, Series, Shifts, TIMING};

/// A signature is run with this share of the largest value accepted.
const SHARE: f64 = 1e-3;
/// Whether it is linear is tried with this share.
const TRIED_SHARE: f64 = 0.1;
/// Coefficient with which the signature of a formula is run.
const COEFFICIENT: f64 = 1e-6;
/// Cosine of the signature put together with the one that was run, above which the former stands for the latter.
const ALIKE: f64 = 0.95;
/// Factor between neighbouring sizes of an amplitude that is not linear.
const SIZE_FACTOR: f64 = 1.5;
/// Least size of an amplitude that is not linear, as a share of the largest accepted.
const LEAST_SIZE: f64 = 0.002;
/// Sizes, over the one that was run, for which a signature that is not linear stands: the next that are run lie within.
const NEAR_SIZES: Range<f64> = 0.4..2.5;
/// Time constants looked for, the ratio of neighbours.
const TIME_FACTOR: f64 = 3.0;
/// Blocks of a jump of the angle that are looked at: the filter has forgotten it after.
const JUMP_BLOCKS: usize = 120;
/// Blocks between onsets of what moves an angle at once.
const SUDDEN_BLOCKS: usize = 2;

/// The signature of a constant amplitude, for one unit of its size.
#[derive(Debug, Clone)]
pub struct ConstantSignature {
    /// Which.
    pub amplitude: AmplitudeRef,
    /// Values of its own shapes.
    pub own_shapes: Vec<f64>,
    /// The size with which it was run.
    pub size: f64,
    /// Whether another size has the same signature.
    pub is_linear: bool,
    /// Averages over blocks.
    series: [Arc<[f64]>; CHANNELS],
    mode: Mode,
}

impl ConstantSignature {
    /// What one unit of its size adds to a channel.
    pub fn values(&self, channel: usize) -> &[f64] {
        &self.series[channel]
    }

    /// Whether its signature is that of another size too: what is not linear was run at one size, and tells of those near it.
    pub fn is_valid_at(&self, size: f64) -> bool {
        self.is_linear || NEAR_SIZES.contains(&(size / self.size))
    }

    /// The family of a course of it.
    pub fn family(&self, variation: &Variation) -> HypothesisFamily {
        let begins = variation.kind().is_some_and(|kind| KINDS[kind].shapes.iter().any(is_onset));
        match variation {
            _ if self.amplitude.formula().is_some() => HypothesisFamily::FORMULA,
            // What shows at once stands in the noise of jumps.
            _ if begins && self.mode == Mode::Level => HypothesisFamily::SUDDEN,
            Variation::Constant => HypothesisFamily::CONSTANT,
            Variation::Course { kind, .. } => HypothesisFamily::of_kind(*kind),
            Variation::Onset { .. } => HypothesisFamily::SUDDEN,
        }
    }
}

/// A kind of question, which has a threshold of its own: short answers stand in other noise than long ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct HypothesisFamily(pub usize);

impl HypothesisFamily {
    /// Constant, each of [`KINDS`], sudden, a noise, a formula.
    pub const COUNT: usize = KINDS.len() + 4;
    /// A constant amplitude.
    pub const CONSTANT: HypothesisFamily = HypothesisFamily(0);
    /// A course of one of [`KINDS`].
    pub const fn of_kind(kind: usize) -> HypothesisFamily {
        HypothesisFamily(1 + kind)
    }
    /// An angle that jumps, or what shows from some time on as an angle.
    pub const SUDDEN: HypothesisFamily = HypothesisFamily(KINDS.len() + 1);
    /// A noise that is larger than configured.
    pub const NOISE: HypothesisFamily = HypothesisFamily(KINDS.len() + 2);
    /// A formula that stands in no catalogue.
    pub const FORMULA: HypothesisFamily = HypothesisFamily(KINDS.len() + 3);
}

/// A signature on one channel: 0 before the block `from`.
pub struct Column {
    /// First block told.
    pub from: usize,
    /// The rest, or as much of it as matters.
    pub values: Vec<f64>,
}

/// The signatures of all amplitudes beside one recording.
#[derive(Debug, Clone)]
pub struct SignatureBank {
    /// Each amplitude, its shapes and, where it is not linear, sizes.
    pub bases: Vec<ConstantSignature>,
    courses: Courses,
}

impl SignatureBank {
    /// Runs the model of `configuration` once for each amplitude and value of its shapes.
    pub fn new(measured: &MeasuredData, configuration: &Configuration) -> SignatureBank {
        let base = measured.run(configuration, Shifts::default());
        let reference_c = configuration.electronics.numbers.reference_c;
        let excess_k = measured.electronics_c().iter().map(|electronics_c| electronics_c - reference_c).collect();
        let mut bank = SignatureBank { bases: Vec::new(), courses: Courses::new(excess_k) };
        let runs: Vec<ConstantSignature> = AmplitudeRef::all()
            .into_par_iter()
            .filter(is_real)
            .flat_map_iter(|amplitude| {
                let shapes = own_shapes(&amplitude, configuration);
                shapes.into_iter().map(move |own_shapes| (amplitude, own_shapes))
            })
            .flat_map_iter(|(amplitude, own_shapes)| bank.run(measured, configuration, &base, amplitude, own_shapes))
            .collect();
        bank.bases = runs;
        bank
    }

    /// The signatures of both.
    #[must_use]
    pub fn and(&self, other: &SignatureBank) -> SignatureBank {
        let mut both = self.clone();
        both.bases.extend(other.bases.iter().cloned());
        both
    }

    /// The same where the temperature is told so much later than it was.
    #[must_use]
    pub fn late(&self, temperature_s: f64) -> SignatureBank {
        SignatureBank { bases: self.bases.clone(), courses: self.courses.late(temperature_s) }
    }

    /// The terms that stand in no catalogue: the signature of each formula, on every gyro. A run tells four of them, one for each
    /// gyro: what a term adds is the same on all of them, but for the scale factor.
    pub fn formulas(&self, measured: &MeasuredData, configuration: &Configuration) -> SignatureBank {
        let from = measured.run(configuration, Shifts::default());
        let run = |four: &[AmplitudeRef]| -> Vec<ConstantSignature> {
            let mut moved = configuration.clone();
            for (gyro, &amplitude) in four.iter().enumerate() {
                let gyros = std::array::from_fn(|other| other == gyro);
                Hypothesis::constant(amplitude, COEFFICIENT, gyros).apply(&mut moved);
            }
            let mut series = measured.difference(&measured.run(&moved, Shifts::default()), &from);
            let base = |(gyro, &amplitude): (usize, &AmplitudeRef)| {
                let mut own = std::mem::take(&mut series[gyro]);
                own.iter_mut().for_each(|value| *value /= COEFFICIENT);
                let none: Arc<[f64]> = vec![0.0; own.len()].into();
                let own: Arc<[f64]> = own.into();
                let of_channel = |channel: usize| if channel == TIMING { none.clone() } else { own.clone() };
                ConstantSignature {
                    amplitude,
                    own_shapes: Vec::new(),
                    size: COEFFICIENT,
                    is_linear: true,
                    series: std::array::from_fn(of_channel),
                    mode: Mode::Rate,
                }
            };
            four.iter().enumerate().map(base).collect()
        };
        let bases = AmplitudeRef::formulas().par_chunks(TIMING).flat_map_iter(run).collect();
        SignatureBank { bases, courses: self.courses.clone() }
    }

    /// The bases of one amplitude: one where it is linear, else one for each of several sizes.
    fn run(
        &self,
        measured: &MeasuredData,
        configuration: &Configuration,
        from: &Series,
        amplitude: AmplitudeRef,
        own_shapes: Vec<f64>,
    ) -> Vec<ConstantSignature> {
        let limits = amplitude.size();
        let of = |change: &Hypothesis| {
            let mut moved = configuration.clone();
            change.apply(&mut moved);
            let mut series = measured.difference(&measured.run(&moved, Shifts::default()), from);
            series.iter_mut().flatten().for_each(|value| *value /= change.value);
            series
        };
        let change = |size: f64| Hypothesis {
            own_shapes: own_shapes.clone(),
            ..Hypothesis::constant(amplitude, size, amplitude.gyros())
        };
        let base = |size: f64, series: Series, is_linear: bool| ConstantSignature {
            amplitude,
            own_shapes: own_shapes.clone(),
            size,
            is_linear,
            series: series.map(Arc::from),
            mode: Mode::Rate,
        };
        let mut small = base(limits.greatest * SHARE, of(&change(limits.greatest * SHARE)), true);
        // One run with a step in the middle, of a size that shows whether the size matters.
        let middle_s = (self.courses.blocks() / 2) as f64 * BLOCK_S;
        let mut tried = change(limits.greatest * TRIED_SHARE);
        let onset = amplitude.own_shapes().iter().position(is_onset);
        match onset {
            Some(index) => tried.own_shapes[index] = middle_s,
            None => {
                let Some(stepped) = amplitude.with(STEP) else { return vec![small] };
                (tried.amplitude, tried.course_shapes) = (stepped, vec![middle_s]);
            }
        }
        let ran = of(&tried);
        let step = Variation::Course { kind: STEP, shapes: vec![middle_s] };
        let alike = |small: &ConstantSignature| {
            let values = self.courses.values(small.mode, &step, 0..self.courses.blocks());
            let course: Series = small
                .series
                .each_ref()
                .map(|series| put(series, small.mode, values.as_deref(), 0..self.courses.blocks()));
            cosine(&course, &ran)
        };
        let by_rate = alike(&small);
        small.mode = Mode::Level;
        let by_level = alike(&small);
        if by_rate >= by_level {
            small.mode = Mode::Rate;
        }
        let is_silent = cosine(&ran, &ran) == 0.0;
        if is_silent || by_rate.max(by_level) >= ALIKE || cosine(&small.series, &of(&change(tried.value))) >= ALIKE {
            return vec![small];
        }
        let mode = small.mode;
        let mut sizes = Vec::new();
        let mut size = limits.greatest;
        while size > LEAST_SIZE * limits.greatest {
            sizes.push(size);
            if limits.least < 0.0 {
                sizes.push(-size);
            }
            size /= SIZE_FACTOR;
        }
        let sized = |size: &f64| ConstantSignature { mode, ..base(*size, of(&change(*size)), false) };
        sizes.par_iter().map(sized).collect()
    }

    /// Every course of a base that is looked for, waves at the phase 0.
    pub fn variations(&self, base: &ConstantSignature) -> Vec<Variation> {
        if base.amplitude.formula().is_some() {
            return vec![Variation::Constant];
        }
        let has_onset = base.amplitude.own_shapes().iter().any(is_onset);
        let mut all = match has_onset {
            true => (1..self.courses.blocks() / SUDDEN_BLOCKS)
                .map(|onset| Variation::Onset { block: onset * SUDDEN_BLOCKS })
                .collect(),
            false => vec![Variation::Constant],
        };
        // Courses of what is not linear stand beside a few of its sizes.
        let is_tried = base.is_linear || (base.size.abs().ln() / SIZE_FACTOR.ln()).round() as i64 % 3 == 0;
        for kind in (0..KINDS.len()).filter(|&kind| is_tried && base.amplitude.with(kind).is_some()) {
            all.extend(self.courses.variations(kind, base.mode));
        }
        all
    }

    /// The signature of a course for one unit of size; nothing on channels that it does not reach. Of a jump as much as matters.
    pub fn columns(&self, base: &ConstantSignature, variation: &Variation) -> [Option<Column>; CHANNELS] {
        let from = match variation {
            Variation::Onset { block } => *block,
            Variation::Course { kind, shapes } => {
                let first = KINDS[*kind].shapes.iter().zip(shapes).find(|(number, _)| is_onset(number));
                first.map_or(0, |(_, onset_s)| (onset_s / BLOCK_S) as usize)
            }
            Variation::Constant => 0,
        };
        let to = match variation {
            Variation::Onset { block } => self.courses.blocks().min(block + JUMP_BLOCKS),
            _ => self.courses.blocks(),
        };
        let values = self.courses.values(base.mode, variation, from..to);
        std::array::from_fn(|channel| {
            let series = &base.series[channel];
            let is_reached = series.iter().any(|&value| value != 0.0);
            is_reached.then(|| Column { from, values: put(series, base.mode, values.as_deref(), from..to) })
        })
    }

    /// The hypothesis of that size.
    pub fn hypothesis(
        &self,
        base: &ConstantSignature,
        variation: &Variation,
        size: f64,
        gyros: [bool; 4],
    ) -> Hypothesis {
        let gyros = if base.amplitude.is_of_unit() { ALL_GYROS } else { gyros };
        let mut change =
            Hypothesis { own_shapes: base.own_shapes.clone(), ..Hypothesis::constant(base.amplitude, size, gyros) };
        match variation {
            Variation::Constant => {}
            Variation::Course { kind, shapes } => {
                change.amplitude.kind = Some(*kind);
                change.course_shapes.clone_from(shapes);
            }
            Variation::Onset { block } => {
                for (number, value) in base.amplitude.own_shapes().iter().zip(&mut change.own_shapes) {
                    if is_onset(number) {
                        *value = *block as f64 * BLOCK_S;
                    }
                }
            }
        }
        change
    }
}

/// Values of an effect's own shapes that are looked for, the defaults first: times by their limits; what else has a default is
/// taken there, and fitted where the effect is found. An effect that the configuration has keeps its own.
fn own_shapes(amplitude: &AmplitudeRef, configuration: &Configuration) -> Vec<Vec<f64>> {
    if let Some(configured) = amplitude.configured_shapes(configuration) {
        return vec![configured];
    }
    let defaults: Vec<f64> = amplitude
        .own_shapes()
        .iter()
        .map(|number| match number.default {
            DefaultValue::Value(value) => value,
            DefaultValue::Required | DefaultValue::Absent => number.least.max(0.0),
        })
        .collect();
    let mut all = vec![defaults.clone()];
    for (index, number) in amplitude.own_shapes().iter().enumerate() {
        let is_time = number.role == Role::TimeConstant && number.least > 0.0;
        if !is_time || !defaults[index].is_finite() {
            continue;
        }
        for factor in [TIME_FACTOR.powi(-2), 1.0 / TIME_FACTOR, TIME_FACTOR, TIME_FACTOR.powi(2)] {
            let value = defaults[index] * factor;
            if (number.least..=number.greatest).contains(&value) && value >= SHORTEST_BLOCKS * BLOCK_S {
                let mut shapes = defaults.clone();
                shapes[index] = value;
                all.push(shapes);
            }
        }
    }
    all
}

/// A course put on a signature, over some blocks.
fn put(series: &[f64], mode: Mode, course: Option<&[f64]>, blocks: Range<usize>) -> Vec<f64> {
    let from = blocks.start;
    let Some(course) = course else { return series[blocks].to_vec() };
    let own = series[blocks].iter().zip(course);
    match mode {
        Mode::Level => own.map(|(value, factor)| value * factor).collect(),
        Mode::Rate => {
            let (mut sum, mut before) = (0.0, if from == 0 { 0.0 } else { series[from - 1] });
            own.map(|(value, factor)| {
                sum += (value - std::mem::replace(&mut before, *value)) * factor;
                sum
            })
            .collect()
        }
    }
}

fn cosine(one: &[impl AsRef<[f64]>; CHANNELS], other: &Series) -> f64 {
    // Of increments: a constant or a slow part would outweigh the rest. The channel of the times has a unit of its own.
    let increments = |values: &[f64]| -> Vec<f64> { values.windows(2).map(|pair| pair[1] - pair[0]).collect() };
    let (mut both, mut ones, mut others) = (0.0, 0.0, 0.0);
    for channel in (0..CHANNELS).filter(|&channel| channel != TIMING) {
        for (a, b) in increments(one[channel].as_ref()).into_iter().zip(increments(&other[channel])) {
            both += a * b;
            ones += a * a;
            others += b * b;
        }
    }
    if ones == 0.0 || others == 0.0 { 0.0 } else { both / (ones * others).sqrt() }
}
