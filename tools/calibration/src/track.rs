//! On-board attitude determination (Casteren §4): equation 3 on each sample, the attitude, and the parity check of the
//! redundant pair.
//!
//! ```
//! use geu_calibration::{PriorCalibration, GyroSelection, Tracker};
//! use geu_model::{Configuration, GyroUnit};
//! use geu_recording::ReceivedSample;
//! use nalgebra::UnitQuaternion;
//!
//! let configuration = Configuration::reference();
//! let prior = PriorCalibration::from(&configuration);
//! let mut tracker = Tracker::new(&prior, GyroSelection::Za, UnitQuaternion::identity());
//! let sample = GyroUnit::new(&configuration).end_sample().sample;
//! let track = tracker.push(&ReceivedSample { time: None, is_received: false, sample, has_clock: true }).unwrap();
//! // No count of GYRX in the first sample interval: its drift remains, and a trace of Y and Z.
//! assert!((track.increment_control_arcsec.unwrap()[0] - 0.21).abs() < 1e-3);
//! ```

mod described;
mod selection;

use geu_model::units::ARCSEC_PER_RAD;
use geu_protocol::capture::Timestamp;
use geu_protocol::continuity::{Continuity, MAX_MISSING, SequenceStep};
use geu_protocol::{Gyros, Sample};
use geu_recording::ReceivedSample;
use nalgebra::{UnitQuaternion, Vector3};

use crate::counts::{BreakKind, increments, unusable};
use crate::parity::{ParityMonitor, ParityResult};
use crate::prior::PriorCalibration;
use crate::transfer::{GyroSet, Transfer};
pub use described::{DeviceTracker, rotation_of_heads};
pub use selection::{GyroSelection, Reason, TrackerEvent, gyro_set_name};

/// A restart of the sequence within this time of the sample before lost no sample.
const NEXT_NS: i64 = 750_000_000;

#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    pub time: Option<Timestamp>,
    /// The default for a described unit.
    pub sample: Sample,
    /// Number of the sample, missing ones counted, of a described unit.
    pub number: Option<u64>,
    /// Rotation about the control axes over the sample interval (eq 3); `None` if the gyros in use did not measure it.
    pub increment_control_arcsec: Option<[f64; 3]>,
    pub angle_control_arcsec: [f64; 3],
    /// Control frame to inertial.
    pub attitude: UnitQuaternion<f64>,
    /// True if the attitude includes every sample since the start.
    pub is_complete: bool,
    /// Number of samples missing from it, by sequence and clock.
    pub lost_samples: u64,
    pub in_use: Option<GyroSet>,
    /// Heads in use, of a described unit.
    pub heads: Option<Gyros>,
    /// The head of a described unit with the largest residual against all since the start, and the residual, arcsec; `None` for three heads.
    pub residual: Option<(&'static str, f64)>,
    /// The parity check, if both gyros of the redundant pair measured.
    pub parity: Option<ParityResult>,
    /// Why increments before or of this sample are missing or unusable.
    pub reasons: Vec<Reason>,
    pub events: Vec<TrackerEvent>,
}

/// Applies equation 3 to samples in order.
#[derive(Debug, Clone)]
pub struct Tracker {
    choice: GyroSelection,
    transfers: Vec<(GyroSet, Transfer)>,
    parity: ParityMonitor,
    continuity: Continuity,
    last_time: Option<Timestamp>,
    in_use: GyroSet,
    turned: Turned,
    /// Number of samples without increments up to now.
    without: u64,
}

/// Sum and integral of increments.
#[derive(Debug, Clone)]
struct Turned {
    angle_control_arcsec: [f64; 3],
    attitude: UnitQuaternion<f64>,
    /// Increment of the sample before, rad, if it has one.
    before_control_rad: Option<Vector3<f64>>,
    is_complete: bool,
    lost_samples: u64,
}

impl Tracker {
    /// A tracker before the first sample, with the attitude at its start (control frame to inertial).
    pub fn new(prior: &PriorCalibration, choice: GyroSelection, attitude: UnitQuaternion<f64>) -> Tracker {
        let candidates = choice.candidates();
        Tracker {
            choice,
            transfers: candidates.iter().map(|&use_| (use_, Transfer::new(&prior.calibrations, use_))).collect(),
            parity: ParityMonitor::new(prior),
            continuity: Continuity::default(),
            last_time: None,
            in_use: candidates[0],
            turned: Turned::new(attitude),
            without: 0,
        }
    }

    /// Processes a sample; `None` for a repeated one.
    pub fn push(&mut self, row: &ReceivedSample) -> Option<Track> {
        let sample = row.sample;
        let step = self.continuity.step(sample.sequence, row.has_clock.then_some(sample.clock_count));
        let time = row.time.filter(|_| row.is_received);
        let passed_ns = time.zip(self.last_time).map(|(now, before)| now.t_ns - before.t_ns);
        let missing = match step {
            SequenceStep::First | SequenceStep::Next => None,
            SequenceStep::Repeat => return None,
            SequenceStep::Gap(missing) => Some((BreakKind::Gap(missing), missing.min(MAX_MISSING))),
            // RESET_SEQUENCE loses no sample; a restart of the unit does.
            SequenceStep::Reset if sample.sequence == 0 && passed_ns.is_some_and(|ns| (0..NEXT_NS).contains(&ns)) => {
                None
            }
            SequenceStep::Reset => Some((BreakKind::Reset, 0)),
            SequenceStep::Jump => Some((BreakKind::Jump, 0)),
        };
        self.last_time = time;
        let (mut reasons, mut events) = (vec![], vec![]);
        if let Some((kind, samples)) = missing {
            reasons.push(Reason { kind, gyros: Gyros::ALL });
            self.parity.skip(samples);
            self.turned.lose(samples);
            events.push(TrackerEvent::Lost { kind, gyros: Gyros::ALL, other: None });
        }
        let unusable = unusable(&sample).into_iter().filter(|(_, gyros)| gyros.contains(&true));
        reasons.extend(
            unusable.clone().map(|(kind, gyros)| Reason { kind, gyros: Gyros::ALL.filter(|gyro| gyros[gyro]) }),
        );
        let measured: [bool; 4] = std::array::from_fn(|gyro| !unusable.clone().any(|(_, gyros)| gyros[gyro]));
        let counts = increments(&sample);
        let parity = if measured == [true; 4] {
            Some(self.parity.push(counts))
        } else {
            self.parity.skip(1);
            None
        };
        events.extend(parity.iter().flat_map(ParityResult::events));
        let used = self.turn_by(counts, measured, &reasons, &mut events);
        Some(Track {
            sample,
            in_use: used.map(|(in_use, _)| in_use),
            parity,
            reasons,
            events,
            ..self.turned.track(row.time, used.map(|(_, increment)| increment))
        })
    }

    /// Turns the attitude by the counts of the first set of gyros that all measured; returns the set and the increment.
    fn turn_by(
        &mut self,
        counts: [f64; 4],
        measured: [bool; 4],
        reasons: &[Reason],
        events: &mut Vec<TrackerEvent>,
    ) -> Option<(GyroSet, [f64; 3])> {
        let is_measured = |in_use: GyroSet| (0..4).all(|gyro| measured[gyro] || !in_use.gyros()[gyro]);
        let Some(&(in_use, transfer)) = self.transfers.iter().find(|(in_use, _)| is_measured(*in_use)) else {
            let concerns = |reason: &&Reason| {
                let uses = |in_use: GyroSet| (0..4).any(|gyro| reason.gyros[gyro] && in_use.gyros()[gyro]);
                self.transfers.iter().any(|(in_use, _)| uses(*in_use))
            };
            if let Some(&Reason { kind, gyros }) = reasons.iter().rev().find(concerns).filter(|_| self.without == 0) {
                let others = [(GyroSelection::Za, GyroSet::WithZa), (GyroSelection::Zb, GyroSet::WithZb)];
                let other = others.into_iter().find(|&(choice, in_use)| choice != self.choice && is_measured(in_use));
                events.push(TrackerEvent::Lost { kind, gyros, other: other.map(|(choice, _)| choice) });
            }
            self.without += 1;
            self.turned.lose(1);
            return None;
        };
        if self.without > 0 {
            events.push(TrackerEvent::Again { samples: self.without });
        }
        if in_use != self.in_use {
            events.push(TrackerEvent::Switched(in_use));
        }
        (self.in_use, self.without) = (in_use, 0);
        let increment = transfer.about_control_arcsec(counts, 1.0);
        self.turned.turn(increment);
        Some((in_use, increment))
    }
}

impl Turned {
    fn new(attitude: UnitQuaternion<f64>) -> Turned {
        let angle_control_arcsec = [0.0; 3];
        Turned { angle_control_arcsec, attitude, before_control_rad: None, is_complete: true, lost_samples: 0 }
    }

    fn track(&self, time: Option<Timestamp>, increment_control_arcsec: Option<[f64; 3]>) -> Track {
        Track {
            time,
            sample: Sample::default(),
            number: None,
            increment_control_arcsec,
            angle_control_arcsec: self.angle_control_arcsec,
            attitude: self.attitude,
            is_complete: self.is_complete,
            lost_samples: self.lost_samples,
            in_use: None,
            heads: None,
            residual: None,
            parity: None,
            reasons: Vec::new(),
            events: Vec::new(),
        }
    }

    fn lose(&mut self, samples: u64) {
        self.is_complete = false;
        self.lost_samples = self.lost_samples.saturating_add(samples);
        self.before_control_rad = None;
    }

    /// Turns the attitude by an increment. Its parts are integrals of rates about axes that turn themselves: if the rate
    /// changes its direction, the rotation vector has half the integral of angle × rate more (Bortz), which a rate linear
    /// over this sample interval and the one before makes Δ₋₁ × Δ / 12.
    fn turn(&mut self, increment_control_arcsec: [f64; 3]) {
        for (sum, increment) in self.angle_control_arcsec.iter_mut().zip(increment_control_arcsec) {
            *sum += increment;
        }
        let increment = Vector3::from(increment_control_arcsec) / ARCSEC_PER_RAD;
        let coning = self.before_control_rad.map_or_else(Vector3::zeros, |before| before.cross(&increment) / 12.0);
        self.attitude *= UnitQuaternion::from_scaled_axis(increment + coning);
        self.attitude.renormalize_fast();
        self.before_control_rad = Some(increment);
    }
}

#[cfg(test)]
mod tests {
    use geu_model::{Configuration, GyroUnit};
    use geu_protocol::field::unit_flag;

    use super::*;

    fn row(sample: Sample) -> ReceivedSample {
        ReceivedSample { time: None, is_received: false, sample, has_clock: true }
    }

    /// Samples of a unit without drift that stands still.
    fn still(count: u64) -> Vec<Sample> {
        let sample = |index: u64| Sample {
            sequence: index as u16,
            clock_count: (index + 1) * 500_000,
            gyro_flags: 0x0F,
            unit_flags: 0x07,
            ..Sample::default()
        };
        (0..count).map(sample).collect()
    }

    fn track(choice: GyroSelection, samples: &[Sample]) -> Vec<Track> {
        let prior = PriorCalibration::from(&Configuration::parse("neutral", "", &[]).unwrap());
        let mut tracker = Tracker::new(&prior, choice, UnitQuaternion::identity());
        samples.iter().filter_map(|&sample| tracker.push(&row(sample))).collect()
    }

    /// Turning about Z while the input to X goes round: a cone, whose attitude is known at every instant. R = Rz(at)·Rx(b)
    /// ·Rz(−at) has the body rates below; first-order steps and steps without the cross term drift away from it.
    #[test]
    fn coning_is_integrated() {
        let (half_cone, rate) = (0.3_f64, 0.05_f64);
        let mut tracker = Tracker::new(
            &PriorCalibration::from(&Configuration::parse("neutral", "", &[]).unwrap()),
            GyroSelection::Za,
            UnitQuaternion::identity(),
        );
        let at = |t_s: f64| {
            let about = |axis: Vector3<f64>, angle: f64| UnitQuaternion::from_scaled_axis(axis * angle);
            about(Vector3::z(), rate * t_s) * about(Vector3::x(), half_cone) * about(Vector3::z(), -rate * t_s)
        };
        tracker.turned.attitude = at(0.0);
        // ω = rate·(Rᵀz − z), with Rᵀz = (−sin b sin at, sin b cos at, cos b).
        let integral = |t_s: f64| {
            let (sin, cos) = (rate * t_s).sin_cos();
            Vector3::new(half_cone.sin() * cos, half_cone.sin() * sin, rate * t_s * (half_cone.cos() - 1.0))
        };
        let worst = |tracker: &mut Tracker, with_coning: bool| {
            let mut worst_arcsec: f64 = 0.0;
            for k in 0..2400 {
                let (from_s, to_s) = (f64::from(k) * 0.5, f64::from(k + 1) * 0.5);
                if !with_coning {
                    tracker.turned.before_control_rad = None;
                }
                tracker.turned.turn(((integral(to_s) - integral(from_s)) * ARCSEC_PER_RAD).into());
                worst_arcsec = worst_arcsec.max(tracker.turned.attitude.angle_to(&at(to_s)) * ARCSEC_PER_RAD);
            }
            worst_arcsec
        };
        let without = worst(&mut tracker.clone(), false);
        let with = worst(&mut tracker, true);
        assert!(with < 1.0 && without > 20.0 * with, "{with} {without}");
    }

    #[test]
    fn a_day_of_the_reference_unit_has_no_events() {
        let configuration = Configuration::reference();
        let (mut unit, mut tracker) = (
            GyroUnit::new(&configuration),
            Tracker::new(&PriorCalibration::from(&configuration), GyroSelection::All, UnitQuaternion::identity()),
        );
        let last = (0..172_800).filter_map(|_| tracker.push(&row(unit.end_sample().sample))).last().unwrap();
        assert!(last.is_complete && last.lost_samples == 0 && last.events.is_empty());
        assert!((last.attitude.norm() - 1.0).abs() < 1e-12);
        let checked = last.parity.unwrap();
        assert!(checked.accumulated.sigmas() < 5.0 && checked.window.unwrap().sigmas() < 5.0, "{checked:?}");
    }

    #[test]
    fn a_gap_is_reported_once_and_leaves_the_attitude_incomplete() {
        let mut samples = still(10);
        samples.drain(4..6);
        samples.insert(5, samples[4]);
        let tracks = track(GyroSelection::Za, &samples);
        assert_eq!(tracks.len(), 8);
        let complete: Vec<bool> = tracks.iter().map(|track| track.is_complete).collect();
        assert_eq!(complete, [true, true, true, true, false, false, false, false]);
        assert!(tracks.iter().all(|track| track.increment_control_arcsec == Some([0.0; 3])));
        assert_eq!(tracks[7].lost_samples, 2);
        let events: Vec<String> = tracks.iter().flat_map(|track| &track.events).map(TrackerEvent::to_string).collect();
        assert_eq!(events, ["2 samples are missing; the attitude lacks what the unit turned meanwhile"]);
    }

    #[test]
    fn without_gyrza_tracking_continues_only_with_another_selection() {
        let mut samples = still(6);
        for sample in &mut samples[2..4] {
            sample.gyro_flags &= !4;
            sample.increments = [0, 0, 1000, 7];
        }
        let events = |tracks: &[Track]| {
            tracks.iter().flat_map(|track| &track.events).map(TrackerEvent::to_string).collect::<Vec<_>>()
        };
        let tracks = track(GyroSelection::Za, &samples);
        assert_eq!(tracks[3].increment_control_arcsec, None);
        assert_eq!((tracks[3].parity, tracks[3].lost_samples), (None, 2));
        let expected = [
            "GYRZA: the count is not valid; the attitude lacks what the unit turned meanwhile; --gyros zb would continue",
            "increments again, after 2 samples without",
        ];
        assert_eq!(events(&tracks), expected);
        let tracks = track(GyroSelection::Auto, &samples);
        assert_eq!(tracks[5].angle_control_arcsec, [0.0, 0.0, 14.0]);
        assert!(tracks[5].is_complete);
        assert_eq!(events(&tracks), ["continues with zb", "continues with za"]);
        assert!(track(GyroSelection::Zb, &samples)[5].events.is_empty());
        assert!(!track(GyroSelection::All, &samples)[5].is_complete);
    }

    #[test]
    fn saturated_counts_and_a_self_test_are_no_increments() {
        let mut samples = still(4);
        samples[1].gyro_flags |= 0x10;
        samples[3].unit_flags |= unit_flag("self_test");
        let tracks = track(GyroSelection::Auto, &samples);
        let increments: Vec<bool> = tracks.iter().map(|track| track.increment_control_arcsec.is_some()).collect();
        assert_eq!(increments, [true, false, true, false]);
        assert_eq!(tracks[1].reasons[0].to_string(), "GYRX: the count is saturated");
        assert_eq!(tracks[3].reasons[0].to_string(), "the self-test runs");
    }

    #[test]
    fn a_reset_of_the_sequence_loses_no_sample_if_times_are_continuous() {
        let mut samples = still(4);
        for (index, sample) in samples[2..].iter_mut().enumerate() {
            (sample.sequence, sample.clock_count) = (index as u16, (index as u64 + 1) * 500_000);
        }
        let prior = PriorCalibration::from(&Configuration::reference());
        let complete = |interval_ns: i64| {
            let mut tracker = Tracker::new(&prior, GyroSelection::Za, UnitQuaternion::identity());
            let tracks = samples.iter().zip(1..).filter_map(|(&sample, index)| {
                let time = Some(Timestamp { t_ns: index * interval_ns, digits: 6 });
                tracker.push(&ReceivedSample { time, is_received: true, ..row(sample) })
            });
            tracks.last().unwrap().is_complete
        };
        assert!(complete(500_000_000));
        assert!(!complete(1_500_000_000));
        assert!(!track(GyroSelection::Za, &samples)[3].is_complete);
    }
}
