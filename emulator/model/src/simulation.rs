//! The unit and what is measured beside it, stepped together: reference attitude, manoeuvre legs, sun sensor, star sensor.
//!
//! [`Simulation`] steps both for what runs at no pace of its own (checkouts, survey days, blind trials). What steps the unit
//! itself, such as a recorder beside a live run, takes [`ReferenceSource`] alone.

use crate::attitude::{AttitudeRow, Leg, Motion, MotionStep};
use crate::configuration::Configuration;
use crate::gyro_unit::{CompletedSample, GyroUnit, Truth};
use crate::sensor::{SLITS, SlitFix, StarSensor, SunAngles, SunSensor};

/// True attitude and absolute sensors along a truth.
#[derive(Debug, Clone)]
pub struct ReferenceSource {
    motion: Motion,
    sun_sensor: SunSensor,
    star_sensor: StarSensor,
}

/// Measurements of the motion over one step.
#[derive(Debug, Clone)]
pub struct ReferenceSample {
    /// True time since the start, s: the end of the step.
    pub t_s: f64,
    /// The motion since the sample before.
    pub step: MotionStep,
    /// θ and ψ at the end, where the truth has them.
    pub theta_psi_rad: Option<(f64, f64)>,
    pub legs: Vec<Leg>,
    /// The sun, except in an eclipse.
    pub sun: Option<SunAngles>,
    /// Star fixes, a set of slits each.
    pub fixes: Vec<[SlitFix; SLITS.len()]>,
}

impl ReferenceSource {
    /// At the start of a run on `truth`.
    pub fn new(configuration: &Configuration, truth: &Truth) -> ReferenceSource {
        let sensors = &configuration.sensors;
        ReferenceSource {
            motion: truth.motion(configuration, 0.0),
            sun_sensor: SunSensor::new(sensors.fss, configuration.seed),
            star_sensor: StarSensor::new(sensors.sse, configuration.seed, configuration.scenario.limit_cycle),
        }
    }

    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Attitude of the start, as a row before the first sample.
    pub fn start(&self) -> AttitudeRow {
        AttitudeRow { t_s: self.motion.now().t_s, angle_control_arcsec: [0.0; 3], theta_psi_rad: self.theta_psi_rad() }
    }

    fn theta_psi_rad(&self) -> Option<(f64, f64)> {
        let now = self.motion.now();
        self.motion.knows_sun().then_some((now.theta_rad, now.psi_rad))
    }

    /// Moves on to `t_s`, true time since the start.
    pub fn advance(&mut self, t_s: f64) -> ReferenceSample {
        let step = self.motion.advance(t_s);
        let legs = self.motion.take_legs();
        for leg in &legs {
            self.sun_sensor.begin_leg(leg);
            self.star_sensor.begin_leg(leg);
        }
        let sun = self.sun_sensor.see(&self.motion);
        let fixes = std::iter::from_fn(|| self.star_sensor.fixes_until(t_s)).collect();
        ReferenceSample { t_s, step, theta_psi_rad: self.theta_psi_rad(), legs, sun, fixes }
    }
}

impl ReferenceSample {
    /// Row of a reference attitude.
    pub fn row(&self) -> AttitudeRow {
        let angle_control_arcsec = self.step.angle_control_arcsec;
        AttitudeRow { t_s: self.t_s, angle_control_arcsec, theta_psi_rad: self.theta_psi_rad }
    }
}

/// A unit on a truth with its reference; yields samples without end.
#[derive(Debug, Clone)]
pub struct Simulation {
    /// The unit, to send commands to.
    pub unit: GyroUnit,
    reference: ReferenceSource,
    reference_samples: i64,
    reference_interval_ns: i64,
}

impl Simulation {
    /// At the start of a run on the configuration's scenario.
    pub fn new(configuration: &Configuration) -> Simulation {
        let truth = Truth::Scenario;
        Simulation {
            unit: GyroUnit::on(configuration, &truth),
            reference: ReferenceSource::new(configuration, &truth),
            reference_samples: 0,
            reference_interval_ns: configuration.device.reference_interval_ns(),
        }
    }

    pub fn start(&self) -> AttitudeRow {
        self.reference.start()
    }
}

impl Iterator for Simulation {
    /// A sample, and the references that start before its end. The reference has one at each of its intervals of true time,
    /// whatever the unit's clock does.
    type Item = (CompletedSample, Vec<ReferenceSample>);

    fn next(&mut self) -> Option<Self::Item> {
        let ended = self.unit.end_sample();
        let mut samples = Vec::with_capacity(1);
        while self.reference_samples * self.reference_interval_ns < ended.end_ns {
            self.reference_samples += 1;
            samples.push(self.reference.advance((self.reference_samples * self.reference_interval_ns) as f64 * 1e-9));
        }
        Some((ended, samples))
    }
}
