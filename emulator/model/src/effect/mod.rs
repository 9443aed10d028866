//! The effects, one file each, and the lists that name them in physical order. No other shipping code names an effect.
//!
//! The type of an effect states where it acts. Effects of the unit are one list ([`UnitEffects`]), effects of a
//! gyro another ([`GyroEffects`]), faults of a gyro's wiring a third ([`WiringEffects`]); laws are called statically from
//! the list, in the hot loop. The terms of one effect are data, so it is in no list: [`discovered`]. All numbers go
//! through [`Effects`]: configuration and its schema, courses, and whatever searches or moves an amplitude. State stands
//! separate from the numbers, so a fault that changes a number never resets it, and an amplitude of 0 changes no bit.
//!
//! | acts on | when | method |
//! |---|---|---|
//! | [`SampleTiming`] | once per sample interval | [`UnitEffect::timing`] |
//! | the [`GyroSubStep`]s together | in every sub-step | [`UnitEffect::apply`] |
//! | one [`GyroSubStep`] | once per sample interval, then in every sub-step | [`GyroEffect::begin`], [`GyroEffect::apply`] |
//! | the counts | after rounding, before clipping | [`WiringEffect::apply`] |

#[macro_use]
mod list;
pub mod discovered;

use geu_protocol::Gyro;
pub use list::{EffectConfiguration, Effects};

use crate::attitude::MotionStep;
use crate::device::{Head, MAX_HEADS};
use crate::gyro_unit::SubSteps;
use crate::package::{Axes, ResolvedGyro, SubStep};
use crate::parameter_spec::ParameterSet;
use crate::temperature::ElectronicsCourse;
use crate::time_profile::Interval;

/// Specification of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EffectSpec {
    /// Key in the configuration; never another code with the suffix of a time course.
    pub code: &'static str,
    /// A few words.
    pub title: &'static str,
    /// Those of its numbers that are amplitudes: 0 means absent, and time courses change them. The others are shapes.
    pub amplitudes: &'static [Amplitude],
    /// Value in the paper, in words; `0` or `off` if it has none.
    pub paper: &'static str,
    /// Section, table or equation of the paper.
    pub source: &'static str,
}

/// Limits that courses of an amplitude have. The amplitude itself is the number of the same index.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Amplitude {
    /// Largest `-ramp`, per day.
    pub per_day: f64,
    /// Largest `-temperature`, per K.
    pub per_k: f64,
}

/// A definition: numbers and what is said of them together.
pub trait Effect: ParameterSet + Default {
    /// Its specification.
    const SPEC: EffectSpec;
    /// True if it draws random numbers: its amplitude is a deviation, and has no signature in the counts.
    const IS_NOISE: bool = false;
    /// True if it withholds small motions, all of them if it is large enough.
    const FILTERS_MOTION: bool = false;
    /// True if it acts on a gyro with an output axis alone.
    const NEEDS_OUTPUT_AXIS: bool = false;

    /// A number that does not go with the others, each within its own limits, and what was expected of it. Asked with the
    /// amplitudes at the largest that they reach.
    fn consistency_error(&self) -> Option<(&'static str, String)> {
        None
    }
}

/// Temperatures at a moment, °C.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Temperatures {
    /// Electronics.
    pub electronics_c: f64,
    /// The electronics temperature at which the calibration holds.
    pub electronics_reference_c: f64,
    /// Rate of change of the electronics temperature, K/h.
    pub electronics_rate_k_per_h: f64,
    /// Sensor.
    pub sensor_c: f64,
}

impl Temperatures {
    /// At a time, of electronics with this course.
    #[inline]
    pub fn from_course(electronics: &ElectronicsCourse, t_s: f64, sensor_c: f64) -> Temperatures {
        Temperatures {
            electronics_c: electronics.at_c(t_s),
            electronics_rate_k_per_h: electronics.rate_k_per_h(t_s),
            electronics_reference_c: electronics.numbers.reference_c,
            sensor_c,
        }
    }

    /// The sample interval with these temperatures.
    pub fn interval(&self, start_s: f64, end_s: f64) -> Interval {
        let Temperatures { electronics_c, electronics_reference_c, electronics_rate_k_per_h, .. } = *self;
        Interval {
            start_s,
            end_s,
            electronics_excess_k: electronics_c - electronics_reference_c,
            electronics_rate_k_per_h,
        }
    }
}

/// Time as the unit keeps it over one sample interval.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SampleTiming {
    /// Relative error of the unit's clock, positive when it is fast.
    pub clock_error: f64,
    /// Age of the counted motion against the time stamp.
    pub shift_s: f64,
}

/// One gyro over one sub-step, on its way from true rotation to counts.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct GyroSubStep {
    /// Rotation about the input axis with its misalignment, arcsec.
    pub input_arcsec: f64,
    /// Sensed rotation beside the input rotation, arcsec.
    pub added_arcsec: f64,
    /// D over the sub-step: what is sensed and not counted, arcsec.
    pub drift_arcsec: f64,
    /// SF: arcsec per count.
    pub scale_factor: f64,
    /// Counts that come from no rotation.
    pub added_counts: f64,
}

impl GyroSubStep {
    /// N of equation 1, as a real number, with the clock's factors (Casteren §3.2): SF falls by the clock's error, D per
    /// on-board sample by twice as much in all. A sub-step is already shorter by once the error; once remains.
    #[inline]
    pub fn counts(&self, timing: &SampleTiming) -> f64 {
        let clock = 1.0 - timing.clock_error;
        (self.input_arcsec + self.added_arcsec - self.drift_arcsec * clock) / (self.scale_factor * clock)
            + self.added_counts
    }
}

/// Inputs of a gyro's effects beside the sub-step.
#[derive(Debug, Clone, Copy)]
pub struct EffectInputs<'a> {
    /// Motion over the sub-step.
    pub step: &'a MotionStep,
    /// Axes of the gyro.
    pub axes: &'a Axes,
    /// Temperatures, held over the sample interval.
    pub temperatures: &'a Temperatures,
    /// True time since the start of the run at the sub-step's end.
    pub end_s: f64,
    /// Largest rate of the unit.
    pub full_scale_arcsec_s: f64,
}

impl<'a> EffectInputs<'a> {
    /// Value for the gyro of a head over a sub-step.
    #[inline]
    pub fn new(step: &'a SubStep, head: &'a Head, temperatures: &'a Temperatures) -> EffectInputs<'a> {
        let Head { axes, full_scale_arcsec_s, .. } = head;
        let (end_s, full_scale_arcsec_s) = (step.end_s, *full_scale_arcsec_s);
        EffectInputs { step: &step.counted, axes, temperatures, end_s, full_scale_arcsec_s }
    }
}

/// An effect on the whole unit.
pub trait UnitEffect: Effect {
    /// State between sub-steps.
    type State: Clone + std::fmt::Debug + Default;
    /// Acts on the unit's time, once per sample interval.
    #[inline]
    fn timing(&self, _timing: &mut SampleTiming) {}
    /// Acts on the heads over one sub-step; `gyros` has their axes.
    #[inline]
    fn apply(&self, _state: &mut Self::State, _heads: &mut [GyroSubStep], _gyros: &[ResolvedGyro], _step: &MotionStep) {
    }
}

/// State of an effect on one gyro. One without random numbers starts at its default.
pub trait EffectState: Clone + std::fmt::Debug {
    /// The state at the start of a run; `code` is the effect's.
    fn start(seed: u64, gyro: Gyro, code: &str) -> Self;
}

impl<T: Clone + std::fmt::Debug + Default> EffectState for T {
    fn start(_seed: u64, _gyro: Gyro, _code: &str) -> T {
        T::default()
    }
}

/// An effect on one gyro.
pub trait GyroEffect: Effect {
    /// State between sub-steps.
    type State: EffectState;
    /// Called once per sample interval, before the first sub-step; `length_s` is its true length.
    #[inline]
    fn begin(&self, _state: &mut Self::State, _temperatures: &Temperatures, _length_s: f64) {}
    /// Acts over one sub-step. The scale factor must remain positive and finite at any temperature and rate.
    fn apply(&self, state: &mut Self::State, head: &mut GyroSubStep, surroundings: &EffectInputs);
}

/// A fault of one gyro's wiring.
pub trait WiringEffect: Effect {
    /// State between samples.
    type State: Clone + std::fmt::Debug + Default;
    /// Acts on the counts of a sample; the gyro of this number has the fault.
    fn apply(&self, state: &mut Self::State, gyro: usize, counts: &mut [f64]);
}

/// Records the contributions to counts. Columns are those of [`columns`], in order.
pub trait Probe: Default {
    /// True if it records; otherwise no contribution is computed.
    const LOOKS: bool;
    /// A sub-step begins; `true_arcsec` is the true rotation about the gyro's input axis.
    fn begin(&mut self, true_arcsec: f64);
    /// The effect of `column` has acted; N is now `counts`.
    fn after(&mut self, column: usize, counts: f64);
    /// The effect of `column` has changed the count of the sample by `counts`.
    fn changed(&mut self, column: usize, counts: f64);
}

/// Sees nothing, at no cost.
impl Probe for () {
    const LOOKS: bool = false;
    #[inline]
    fn begin(&mut self, _true_arcsec: f64) {}
    #[inline]
    fn after(&mut self, _column: usize, _counts: f64) {}
    #[inline]
    fn changed(&mut self, _column: usize, _counts: f64) {}
}

/// Columns of a trace: the calibration, the effects of the three lists with the discovered one before the gyro effects,
/// self-test, power, faults of heads, saturation.
pub const COLUMNS: usize = 6 + UnitEffects::SPECS.len() + GyroEffects::SPECS.len() + WiringEffects::SPECS.len();
/// Column of the calibration.
pub const CALIBRATION_COLUMN: usize = 0;
/// First column of [`UnitEffects`].
pub const UNIT_COLUMNS: usize = 1;
/// Column of what the terms of [`discovered`] add.
pub const DISCOVERED_COLUMN: usize = UNIT_COLUMNS + UnitEffects::SPECS.len();
/// First column of [`GyroEffects`].
pub const HEAD_COLUMNS: usize = DISCOVERED_COLUMN + 1;
/// First column of [`WiringEffects`].
pub const WIRING_COLUMNS: usize = HEAD_COLUMNS + GyroEffects::SPECS.len();
/// Column of the counts that a self-test adds.
pub const SELF_TEST_COLUMN: usize = COLUMNS - 4;
/// Column of what a stopped gyro does not count.
pub const POWER_COLUMN: usize = COLUMNS - 3;
/// Column of what named faults of a gyro change.
pub const FAULT_COLUMN: usize = COLUMNS - 2;
/// Column of what clipping takes away.
pub const SATURATION_COLUMN: usize = COLUMNS - 1;

/// Codes of the columns, in order.
pub fn columns() -> Vec<&'static str> {
    let codes = |specs: &'static [EffectSpec]| specs.iter().map(|spec| spec.code);
    std::iter::once("calibration")
        .chain(codes(UnitEffects::SPECS))
        .chain([discovered::CODE])
        .chain(codes(GyroEffects::SPECS))
        .chain(codes(WiringEffects::SPECS))
        .chain(["self-test", "gyro-power", "fault", "saturation"])
        .collect()
}

unit_effects! {
    time_offset: TimeOffset,
    misalignment_thermal: MisalignmentThermal,
    clock_frequency: ClockFrequency,
}

head_effects! {
    misalignment: Misalignment,
    output_axis_acceleration: OutputAxisAcceleration,
    anisoinertia: Anisoinertia,
    pivot_clearance: PivotClearance,
    sensor_lag: SensorLag,
    dead_zone: DeadZone,
    scale_factor_nonlinearity: ScaleFactorNonlinearity,
    scale_factor_quadratic: ScaleFactorQuadratic,
    scale_factor_noise: ScaleFactorNoise,
    angle_random_walk: AngleRandomWalk,
    drift: Drift,
    drift_sensor_temperature: DriftSensorTemperature,
    drift_temperature_hysteresis: DriftTemperatureHysteresis,
    drift_random_walk: DriftRandomWalk,
    bias_instability: BiasInstability,
    scale_factor: ScaleFactor,
    scale_factor_asymmetry: ScaleFactorAsymmetry,
    lost_counts: LostCounts,
}

wiring_effects! {
    sign_inversion: SignInversion,
    axis_swap: AxisSwap,
    stuck_output: StuckOutput,
}
