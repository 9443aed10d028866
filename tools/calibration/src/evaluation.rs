//! The steps that every evaluation of a recording shares: clock and time offset corrected, contributions of configured
//! effects computed along the motion, windows observed.

use std::borrow::Cow;

use geu_model::Configuration;
use geu_model::effect::WiringEffects;
use geu_model::package::Calibration;
use geu_model::sensor::SensorNumbers;
use geu_recording::ReferenceAttitude;

use crate::absolute::{self, AbsoluteData, GyroPath};
use crate::calibrate::CalibrateError;
use crate::counts::AccumulatedCounts;
use crate::effects::{EffectContribution, MotionSteps};
use crate::noise::RandomWalks;
use crate::observe::{self, CompensatedCounts, ExcludedData, reference_sigma_arcsec};
use crate::solve::Observation;
use crate::transfer::{GyroSet, Transfer};
use crate::window::ManoeuvreWindow;

/// The source of the inertial rotations.
#[derive(Debug, Clone, Copy)]
pub enum AttitudeSource<'a> {
    /// A reference attitude and its noise about each axis, 1 sigma, arcsec; the noise is estimated from the data if it is `None`.
    Reference(&'a ReferenceAttitude, Option<[f64; 3]>),
    Sensors(&'a AbsoluteData),
}

/// A wiring fault in the configuration: its contribution to the counts cannot be subtracted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "gyro.{gyro}: expected a unit without wiring faults, got {code}; correct the recording, or remove the fault from the configuration"
)]
pub struct ConfiguredWiringFault {
    pub gyro: &'static str,
    pub code: &'static str,
}

/// A recording to evaluate, with its times corrected by the configured clock and time offset.
pub(crate) struct Evaluation<'a> {
    /// The configuration without the time offset, which the counts no longer have.
    pub configuration: Cow<'a, Configuration>,
    pub counts: Cow<'a, AccumulatedCounts>,
    pub attitude: &'a AttitudeSource<'a>,
    /// The configured calibration of each gyro.
    pub prior: Vec<Calibration>,
    pub walks: Vec<RandomWalks>,
}

/// The observations that one calibration gives.
pub(crate) struct Observed {
    pub observations: Vec<Observation>,
    pub left_out: Vec<ExcludedData>,
    /// For the next pass, whose path they correct.
    pub effects: Option<EffectContribution>,
}

impl<'a> Evaluation<'a> {
    /// # Errors
    /// Fewer than four samples, or a wiring fault in the configuration.
    pub fn new(
        configuration: &'a Configuration,
        counts: &'a AccumulatedCounts,
        attitude: &'a AttitudeSource<'a>,
    ) -> Result<Evaluation<'a>, CalibrateError> {
        if counts.len() < 4 {
            return Err(CalibrateError::TooShort(counts.len()));
        }
        for (own, gyro) in configuration.gyros.iter().zip(configuration.device.gyros()) {
            if let Some(index) = (0..WiringEffects::SPECS.len()).find(|&index| own.wiring.has(index)) {
                let code = WiringEffects::SPECS[index].code;
                return Err(ConfiguredWiringFault { gyro: gyro.name(), code }.into());
            }
        }
        let prior = configuration.gyros.iter().map(|gyro| gyro.calibration).collect();
        let walks = configuration.gyros.iter().map(RandomWalks::from).collect();
        let (mut configuration, mut counts) = (Cow::Borrowed(configuration), Cow::Borrowed(counts));
        let clock_ppm = configuration.unit.constant.clock_frequency.ppm;
        if !counts.is_received && clock_ppm != 0.0 {
            counts.to_mut().correct_clock(clock_ppm);
        }
        // Counts at t report the motion of t − seconds: those of an earlier unit without the offset.
        let offset_s = configuration.unit.constant.time_offset.seconds;
        if offset_s != 0.0 {
            configuration.to_mut().unit.constant.time_offset = Default::default();
            counts.to_mut().start_ns -= (offset_s * 1e9).round() as i64;
        }
        Ok(Evaluation { configuration, counts, attitude, prior, walks })
    }

    /// Observes the windows that `windows` selects. `calibrations` and the effects of the pass before lay the path between
    /// star fixes; `numbers` are the sensors' errors.
    pub fn observe(
        &self,
        calibrations: &[Calibration],
        numbers: &SensorNumbers,
        effects: Option<&EffectContribution>,
        windows: impl FnOnce(
            &CompensatedCounts,
            &Transfer,
            &mut Vec<ExcludedData>,
        ) -> Result<Vec<ManoeuvreWindow>, CalibrateError>,
    ) -> Result<Observed, CalibrateError> {
        let (counts, transfer) = (&*self.counts, Transfer::new(calibrations, GyroSet::WithZa));
        let simulated =
            |steps: &dyn Fn() -> MotionSteps| EffectContribution::simulate(&self.configuration, counts, steps);
        let mut left_out = Vec::new();
        let (effects, (observations, broken)) = match self.attitude {
            AttitudeSource::Reference(reference, sigma_arcsec) => {
                let estimated = || reference_sigma_arcsec(counts, reference, &self.prior).unwrap_or_default();
                let sigma_arcsec = sigma_arcsec.unwrap_or_else(estimated);
                let effects = simulated(&|| steps_of_reference(counts, reference));
                let measured = CompensatedCounts { counts, effects: effects.as_ref() };
                let windows = windows(&measured, &transfer, &mut left_out)?;
                let observed = observe::with_reference(&measured, &windows, reference, sigma_arcsec);
                (effects, observed)
            }
            AttitudeSource::Sensors(sensors) => {
                let path =
                    absolute::path(&CompensatedCounts { counts, effects }, sensors, &transfer).ok_or_else(|| {
                        let from_s = counts.start_s();
                        CalibrateError::NoFixes { from_s, to_s: from_s + counts.end_s() }
                    })?;
                let effects = simulated(&|| steps_of_path(&path));
                let measured = CompensatedCounts { counts, effects: effects.as_ref() };
                let windows = windows(&measured, &transfer, &mut left_out)?;
                let observed = absolute::with_sensors(&measured, &windows, sensors, numbers, &self.walks, &path);
                (effects, observed)
            }
        };
        left_out.extend(broken);
        Ok(Observed { observations, left_out, effects })
    }
}

pub(crate) fn steps_of_reference(counts: &AccumulatedCounts, reference: &ReferenceAttitude) -> MotionSteps {
    let (truth, offset_s, mut near) = (&reference.truth, counts.offset_s(reference), 0);
    let mut before = truth.at(counts.node_s[0] + offset_s, &mut near).0;
    counts.node_s[1..]
        .iter()
        .map(|&node_s| {
            let (turned, moment) = truth.at(node_s + offset_s, &mut near);
            let step = std::array::from_fn(|axis| turned[axis] - before[axis]);
            before = turned;
            (step, truth.knows_sun().then_some((moment.theta_rad, moment.psi_rad)))
        })
        .collect()
}

fn steps_of_path(path: &GyroPath) -> MotionSteps {
    let pairs = path.turned_control_arcsec.windows(2).zip(&path.points[1..]);
    pairs
        .map(|(pair, point)| {
            (std::array::from_fn(|axis| pair[1][axis] - pair[0][axis]), Some((point.theta_rad, point.psi_rad)))
        })
        .collect()
}
