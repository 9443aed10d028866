//! Runs of the model that give the signatures of one amplitude.

use std::ops::Range;
use std::sync::Arc;

use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::{AmplitudeRef, RAMP, STEP};
use geu_model::Configuration;

use super::grid::{NEAR_SIZES, visible};
use super::{ConstantSignature, EXACT_SIGNATURE, SHARE, SignatureBank, Variation};
use crate::course_products::ProductCache;
use crate::courses::{Mode, is_onset, put};
use crate::linear_algebra::increment_products;
use crate::measured::{CHANNELS, MeasuredData, ModelRun, Series, Shifts, TIMING};

/// Amplitude of the run that tests linearity, as a share of the largest accepted value.
const TRIED_SHARE: f64 = 0.1;
/// Minimum cosine between a computed signature and a run.
const SAME_SIGNATURE: f64 = 0.95;

/// An amplitude with values of its effect's shape parameters, and the run that it is added to.
pub(super) struct AmplitudeRuns<'a> {
    pub(super) measured: &'a MeasuredData,
    pub(super) configuration: &'a Configuration,
    pub(super) from: &'a ModelRun,
    pub(super) amplitude: AmplitudeRef,
    pub(super) own_shapes: Vec<f64>,
}

impl AmplitudeRuns<'_> {
    fn hypothesis(&self, size: f64) -> Hypothesis {
        let own_shapes = self.own_shapes.clone();
        Hypothesis {
            own_shapes,
            ..Hypothesis::constant(self.amplitude, size, self.amplitude.gyros(&self.configuration.device))
        }
    }

    /// The hypothesis with a step at this time; `None` if the amplitude has no steps.
    fn stepped(&self, mut hypothesis: Hypothesis, onset_s: f64) -> Option<Hypothesis> {
        match self.amplitude.own_shapes().iter().position(is_onset) {
            Some(index) => hypothesis.own_shapes[index] = onset_s,
            None => (hypothesis.amplitude, hypothesis.course_shapes) = (self.amplitude.with(STEP)?, vec![onset_s]),
        }
        Some(hypothesis)
    }

    /// Block averages of what hypotheses add, per unit.
    fn series(&self, hypotheses: &[Hypothesis]) -> Vec<Series> {
        let moved = |hypothesis: &Hypothesis| {
            let mut moved = self.configuration.clone();
            hypothesis.apply(&mut moved);
            moved
        };
        let moved: Vec<Configuration> = hypotheses.iter().map(moved).collect();
        let per_unit = |(run, hypothesis): (ModelRun, &Hypothesis)| {
            let mut series = self.measured.difference(&run, self.from);
            series.iter_mut().flatten().for_each(|value| *value /= hypothesis.value);
            series
        };
        self.measured.run_all(&moved, Shifts::default()).into_iter().zip(hypotheses).map(per_unit).collect()
    }

    fn signature(&self, size: f64, series: Series, mode: Mode, is_linear: bool) -> ConstantSignature {
        ConstantSignature {
            amplitude: self.amplitude,
            gyros: self.amplitude.gyros(&self.configuration.device),
            own_shapes: self.own_shapes.clone(),
            size,
            configured: self.amplitude.configured_value(self.configuration),
            is_linear,
            is_exact: false,
            has_courses: is_linear,
            valid: NEAR_SIZES,
            series: series.map(Arc::from),
            mode,
            jumps: mode == Mode::Level,
            products: ProductCache::default(),
        }
    }

    /// Signatures of several values of a nonlinear amplitude.
    fn nonlinear(&self, sizes: &[f64], mode: Mode) -> Vec<ConstantSignature> {
        let hypotheses: Vec<Hypothesis> = sizes.iter().map(|&size| self.hypothesis(size)).collect();
        let series = self.series(&hypotheses).into_iter().zip(sizes);
        series.map(|(series, &size)| self.signature(size, series, mode, false)).collect()
    }
}

impl SignatureBank {
    /// Signatures of one amplitude: one if it is linear, else one for each of several values.
    pub(super) fn run(&self, runs: &AmplitudeRuns) -> Vec<ConstantSignature> {
        let limits = runs.amplitude.size();
        let blocks = self.courses.blocks();
        let middle_s = (blocks / 2) as f64 * self.block_s();
        let (small, tried) = (runs.hypothesis(limits.max * SHARE), runs.hypothesis(limits.max * TRIED_SHARE));
        // A run with a step in the middle, with a larger value that tests linearity.
        let both: Vec<Hypothesis> = [small].into_iter().chain(runs.stepped(tried.clone(), middle_s)).collect();
        let mut both = runs.series(&both).into_iter();
        let mut small = runs.signature(limits.max * SHARE, both.next().unwrap_or_default(), Mode::Rate, true);
        let Some(stepped) = both.next() else { return vec![small] };
        let step = Variation::Course { kind: STEP, shapes: vec![middle_s] };
        let similarity = |mode: Mode, course: &Variation, expected: &Series, channels: Range<usize>| {
            let values = self.courses.values(mode, course, 0..blocks);
            let course = small.series.each_ref().map(|series| put(series, mode, values.as_deref(), 0..blocks));
            cosine(&course, expected, channels)
        };
        // A clock is known by the times; what it turns the gyros by follows neither mode.
        let has_times = small.series[TIMING].iter().any(|&value| value != 0.0);
        let known = if has_times { TIMING..CHANNELS } else { 0..TIMING };
        let of_modes = |course: &Variation, expected: &Series| {
            [Mode::Rate, Mode::Level].map(|mode| similarity(mode, course, expected, known.clone()))
        };
        let mut by_mode = of_modes(&step, &stepped);
        small.jumps = by_mode[1] > by_mode[0];
        // A step between two motions agrees with both: a ramp does not.
        if by_mode[0].min(by_mode[1]) >= SAME_SIGNATURE
            && let Some(ramped) = runs.amplitude.with(RAMP)
        {
            let ramped = Hypothesis { amplitude: ramped, ..runs.hypothesis(ramped.size().max * SHARE) };
            let ramp = Variation::Course { kind: RAMP, shapes: Vec::new() };
            by_mode = of_modes(&ramp, &runs.series(&[ramped])[0]);
        }
        let mode = if by_mode[0] >= by_mode[1] { Mode::Rate } else { Mode::Level };
        let similarity = similarity(mode, &step, &stepped, 0..TIMING);
        (small.mode, small.is_exact) = (mode, similarity >= EXACT_SIGNATURE);
        let is_silent = cosine(&stepped, &stepped, 0..TIMING) == 0.0;
        if is_silent
            || similarity >= SAME_SIGNATURE
            || cosine(&small.series, &runs.series(&[tried])[0], 0..TIMING) >= SAME_SIGNATURE
        {
            return vec![small];
        }
        visible(limits, |sizes| runs.nonlinear(sizes, mode))
    }
}

/// Cosine of the increments of two signatures on channels of one unit: the gyros, or the times.
fn cosine(one: &[impl AsRef<[f64]>; CHANNELS], other: &Series, channels: Range<usize>) -> f64 {
    let mut sums = [0.0; 3];
    for (one, other) in one[channels.clone()].iter().zip(&other[channels]) {
        let products = increment_products(one.as_ref(), other);
        sums.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
    }
    let [both, own, others] = sums;
    if own == 0.0 || others == 0.0 { 0.0 } else { both / (own * others).sqrt() }
}
