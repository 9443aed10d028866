//! Signatures: the residual per unit amplitude on this recording, of each amplitude of the model with each time course.
//!
//! A model run with a changed amplitude gives the signature of the constant amplitude. That of a time course is computed from it, with
//! the course applied to its increments (an effect that adds a rate, such as a drift) or to its values (one that adds an angle, such as
//! lost counts), whichever agrees with a run with a step in the middle. This is for the search; the fit runs the model.

mod amplitude_runs;
mod grid;

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use geu_model::Configuration;
use geu_model::effect::discovered::Formula;
use geu_model::effect::{Effect, TimeOffset};
use geu_model::parameter_spec::{DefaultValue, ParameterSpec, Role};
use geu_model::time_profile::COURSES;
use rayon::prelude::*;

use crate::course_products::ProductCache;
pub use crate::courses::Variation;
use crate::courses::{Courses, Mode, is_onset, is_switch, put};
use crate::measured::{CHANNELS, MeasuredData, Shifts, TIMING};
use crate::normal_equations::Nuisance;
use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::{AmplitudeRef, AmplitudeSource, is_real};
use geu_protocol::Gyros;

use amplitude_runs::AmplitudeRuns;
use grid::{NEAR_SIZES, own_shapes};
pub use grid::{PARTS, SIZE_FACTOR};

/// Amplitude of a signature's run, as a share of the largest accepted value.
pub(crate) const SHARE: f64 = 1e-3;
/// Formulas that are integrated in one run along the motion.
const FORMULAS_OF_A_RUN: usize = 64;
/// Minimum cosine from which a fit uses the computed signature: the change of χ² by the rest is 1 in 10 000.
pub const EXACT_SIGNATURE: f64 = 0.9999;
/// Blocks after a jump of the angle that are evaluated with an exact reference: the filter forgets it. With a noisy one it remembers.
const JUMP_BLOCKS: usize = 120;
/// Blocks between the onsets of an immediate effect.
const SUDDEN_BLOCKS: usize = 2;

/// Signature of a constant amplitude, per unit.
#[derive(Debug, Clone)]
pub struct ConstantSignature {
    /// The amplitude.
    pub amplitude: AmplitudeRef,
    /// The gyros that can have it.
    pub gyros: Gyros,
    /// Values of the effect's shape parameters.
    pub own_shapes: Vec<f64>,
    /// The value with which it was run, and that configured on each gyro.
    pub size: f64,
    pub configured: [f64; TIMING],
    /// True if other values have the same signature.
    pub is_linear: bool,
    /// True if computed signatures are exact.
    pub is_exact: bool,
    /// True if its time courses are searched.
    pub has_courses: bool,
    /// Fitted values, over the value of the run, for which a nonlinear signature is valid.
    pub valid: Range<f64>,
    /// Averages over blocks.
    pub series: [Arc<[f64]>; CHANNELS],
    /// Application of time courses.
    pub mode: Mode,
    /// True if a step is that of an angle, or as similar to one: then it has the noise of jumps.
    pub jumps: bool,
    /// Products of its time courses.
    pub products: ProductCache,
}

impl ConstantSignature {
    /// True if it acts on a channel.
    pub fn reaches(&self, channel: usize) -> bool {
        self.series[channel].iter().any(|&value| value != 0.0)
    }

    /// True if its signature is that of another value.
    pub fn is_valid_at(&self, size: f64) -> bool {
        self.is_linear || self.valid.contains(&(size / self.size))
    }

    /// True for a dead zone, which withholds rates: another value has another signature.
    pub fn is_zone(&self) -> bool {
        self.amplitude.filters_motion() && !self.is_linear && self.amplitude.number().unit == "arcsec/s"
    }

    /// True if neighbouring values add much more or less in proportion: then a fit does not converge from there.
    pub fn is_steep(&self) -> bool {
        !self.is_linear && self.valid != NEAR_SIZES
    }

    /// Family of a time course.
    pub fn family(&self, variation: &Variation) -> HypothesisFamily {
        let begins = variation.kind().is_some_and(|kind| COURSES[kind].shapes.iter().any(is_onset));
        match variation {
            _ if self.amplitude.formula().is_some() => HypothesisFamily::FORMULA,
            _ if begins && self.jumps => HypothesisFamily::SUDDEN,
            Variation::Constant => HypothesisFamily::CONSTANT,
            Variation::Course { kind, .. } => HypothesisFamily::of_kind(*kind),
            Variation::Onset { .. } => HypothesisFamily::SUDDEN,
        }
    }
}

/// A family of hypotheses with a common threshold: short time courses have another noise than long ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct HypothesisFamily(pub usize);

impl HypothesisFamily {
    /// Number of families: constant, each of [`COURSES`], sudden, noise, formula.
    pub const COUNT: usize = COURSES.len() + 4;
    /// A constant amplitude.
    pub const CONSTANT: HypothesisFamily = HypothesisFamily(0);
    /// A kind of [`COURSES`].
    pub const fn of_kind(kind: usize) -> HypothesisFamily {
        HypothesisFamily(1 + kind)
    }
    /// A jump or a step of an angle.
    pub const SUDDEN: HypothesisFamily = HypothesisFamily(COURSES.len() + 1);
    /// A noise above its configured level.
    pub const NOISE: HypothesisFamily = HypothesisFamily(COURSES.len() + 2);
    /// A formula outside the catalogue.
    pub const FORMULA: HypothesisFamily = HypothesisFamily(COURSES.len() + 3);
}

/// A signature on one channel: 0 before the block `from`.
pub struct Column {
    /// First block of the values.
    pub from: usize,
    /// The values from there on; later ones may be left out if they have no effect.
    pub values: Vec<f64>,
}

/// Signatures of all amplitudes on one recording.
#[derive(Debug, Clone)]
pub struct SignatureBank {
    /// Each amplitude, its shapes and, where it is not linear, sizes.
    pub bases: Vec<ConstantSignature>,
    gyros: Gyros,
    courses: Courses,
    jump_blocks: usize,
    /// Rate up to which dead zones are left out, arcsec/s, if they have no time courses but switches; `None` if all are signatures.
    pub(crate) unknown_rate_arcsec_per_s: Option<f64>,
}

impl SignatureBank {
    /// Runs the model of `configuration` for each amplitude and value of its shape parameters.
    pub fn new(measured: &MeasuredData, configuration: &Configuration) -> SignatureBank {
        let base = measured.run(configuration, Shifts::default());
        let jump_blocks = if measured.smoothed.is_some() { measured.block_count() } else { JUMP_BLOCKS };
        let mut bank = SignatureBank {
            bases: Vec::new(),
            gyros: measured.gyros(),
            courses: Courses::on(measured, configuration).with_grid(),
            jump_blocks,
            unknown_rate_arcsec_per_s: None,
        };
        bank.bases = AmplitudeRef::all(&configuration.device)
            .into_par_iter()
            .filter(is_real)
            .flat_map_iter(|amplitude| {
                let shapes = own_shapes(&amplitude, configuration, measured.block_s());
                shapes.into_iter().map(move |own_shapes| (amplitude, own_shapes))
            })
            .flat_map_iter(|(amplitude, own_shapes)| {
                bank.run(&AmplitudeRuns { measured, configuration, from: &base, amplitude, own_shapes })
            })
            .collect();
        bank
    }

    /// Takes the signature of the lag for a time offset: by the noise of a reference in their difference a time offset would explain noise.
    pub fn set_lag(&mut self, lag: &Nuisance) {
        for base in self.bases.iter_mut().filter(|base| base.amplitude.code() == TimeOffset::SPEC.code) {
            base.series = lag.each_ref().map(|own| own.as_deref().unwrap_or_default().into());
        }
    }

    /// Amplitudes with exact computed signatures only, and how time courses act on them.
    pub fn linear(&self) -> Vec<(AmplitudeSource, Mode)> {
        let is_exact = |own: &ConstantSignature| {
            let mut same = self.bases.iter().filter(|base| base.amplitude == own.amplitude);
            same.all(|base| base.is_exact && !base.amplitude.filters_motion())
        };
        let exact = self.bases.iter().filter(|own| is_exact(own));
        exact.map(|own| (own.amplitude.parameter, own.mode)).collect()
    }

    /// Signatures of both banks.
    #[must_use]
    pub fn and(&self, other: &SignatureBank) -> SignatureBank {
        let mut both = self.clone();
        both.bases.extend(other.bases.iter().cloned());
        both
    }

    /// The signatures with a delay of the recorded temperature.
    #[must_use]
    pub fn late(&self, temperature_s: f64) -> SignatureBank {
        SignatureBank { courses: self.courses.late(temperature_s), ..self.clone() }
    }

    /// Signatures of all formulas on every gyro.
    pub fn formulas(&self, measured: &MeasuredData, configuration: &Configuration) -> SignatureBank {
        let all = Formula::all();
        let none: Arc<[f64]> = Arc::default();
        let of_gyro = |gyro: usize, arcsec: &Arc<[f64]>| match configuration.gyros[gyro].calibration.scale_factor {
            1.0 => arcsec.clone(),
            per_count => arcsec.iter().map(|arcsec| arcsec / per_count).collect(),
        };
        let signature = |(formula, arcsec): (&Formula, [Arc<[f64]>; TIMING])| ConstantSignature {
            amplitude: AmplitudeRef::term(*formula),
            gyros: measured.gyros(),
            own_shapes: Vec::new(),
            size: 1.0,
            configured: [0.0; TIMING],
            is_linear: true,
            is_exact: false,
            has_courses: false,
            valid: NEAR_SIZES,
            series: std::array::from_fn(|channel| {
                let own = arcsec.get(channel).filter(|own| !own.is_empty());
                own.map_or_else(|| none.clone(), |arcsec| of_gyro(channel, arcsec))
            }),
            mode: Mode::Rate,
            jumps: false,
            products: ProductCache::default(),
        };
        let signatures = |formulas: &[Formula]| -> Vec<ConstantSignature> {
            formulas.iter().zip(measured.terms(configuration, formulas)).map(signature).collect()
        };
        let bases = all.par_chunks(FORMULAS_OF_A_RUN).flat_map_iter(signatures).collect();
        SignatureBank { bases, ..self.clone() }
    }

    /// All time courses of a signature that are searched, waves at phase 0.
    pub fn variations(&self, base: &ConstantSignature) -> Vec<Variation> {
        let has_onset = base.amplitude.own_shapes().iter().any(is_onset);
        let mut all = match has_onset {
            true => (1..self.courses.blocks() / SUDDEN_BLOCKS)
                .map(|onset| Variation::Onset { block: onset * SUDDEN_BLOCKS })
                .collect(),
            false => vec![Variation::Constant],
        };
        // Courses at the default width alone.
        let is_default = |(number, value): (&ParameterSpec, &f64)| {
            number.role != Role::Width || number.default == DefaultValue::Value(*value)
        };
        let is_tried = base.has_courses && base.amplitude.own_shapes().iter().zip(&base.own_shapes).all(is_default);
        let has_all = !base.is_zone() || self.unknown_rate_arcsec_per_s.is_none();
        let is_searched = |kind: &usize| base.amplitude.with(*kind).is_some() && (has_all || is_switch(*kind));
        for kind in (0..COURSES.len()).filter(|kind| is_tried && is_searched(kind)) {
            all.extend(self.courses.variations(kind, base.mode));
        }
        all
    }

    /// Values of a time course from its first block on; `None` for a constant.
    pub fn values(&self, base: &ConstantSignature, variation: &Variation) -> Option<Cow<'_, [f64]>> {
        self.courses.values(base.mode, variation, variation.first_block(self.block_s())..self.courses.blocks())
    }

    /// Signature of a time course, per unit; `None` on channels that it does not reach. That of a jump ends when the filter forgets it.
    pub fn columns(&self, base: &ConstantSignature, variation: &Variation) -> [Option<Column>; CHANNELS] {
        let from = variation.first_block(self.block_s());
        let to = match variation {
            Variation::Onset { block } => self.courses.blocks().min(block + self.jump_blocks),
            _ => self.courses.blocks(),
        };
        let values = self.courses.values(base.mode, variation, from..to);
        std::array::from_fn(|channel| {
            let series = &base.series[channel];
            base.reaches(channel).then(|| Column { from, values: put(series, base.mode, values.as_deref(), from..to) })
        })
    }

    /// Spacing of steps, if the filter forgets one sooner than the next onset of the grid: a jump of the angle with an exact reference, so
    /// that its time is known within blocks, and a step of a rate beside large walks.
    pub fn step_spacing_s(&self, mode: Mode) -> Option<f64> {
        match mode {
            Mode::Level => (self.jump_blocks < self.courses.blocks()).then_some(SUDDEN_BLOCKS as f64 * self.block_s()),
            Mode::Rate => self.courses.rate_step_spacing_s(),
        }
    }

    /// Independent time courses of a rate for each searched course of a kind of [`COURSES`], 1 or more.
    pub fn independent_courses(&self, kind: usize) -> f64 {
        self.courses.independent_courses(kind)
    }

    /// All gyros of the unit.
    pub fn gyros(&self) -> Gyros {
        self.gyros
    }

    /// Length of a block, s.
    pub fn block_s(&self) -> f64 {
        self.courses.block_s
    }

    /// Blocks of each signature.
    pub fn block_count(&self) -> usize {
        self.courses.blocks()
    }

    /// The hypothesis with this value.
    pub fn hypothesis(&self, base: &ConstantSignature, variation: &Variation, size: f64, gyros: Gyros) -> Hypothesis {
        let gyros = if base.amplitude.is_of_unit() { gyros.unit() } else { gyros };
        let mut hypothesis =
            Hypothesis { own_shapes: base.own_shapes.clone(), ..Hypothesis::constant(base.amplitude, size, gyros) };
        match variation {
            Variation::Constant => {}
            Variation::Course { kind, shapes } => {
                hypothesis.amplitude.kind = Some(*kind);
                hypothesis.course_shapes.clone_from(shapes);
            }
            Variation::Onset { block } => {
                for (number, value) in base.amplitude.own_shapes().iter().zip(&mut hypothesis.own_shapes) {
                    if is_onset(number) {
                        *value = *block as f64 * self.block_s();
                    }
                }
            }
        }
        hypothesis
    }
}
