//! Recordings in memory: a unit on its scenario, received as a link delivers it, beside the exact attitude.

use std::fmt::Write;
use std::sync::Arc;

use geu_model::attitude::{self, RecordedAttitude};
use geu_model::noise::NoiseStream;
use geu_model::simulation::ReferenceSample;
use geu_model::units::{RAD_PER_DEG, SAMPLE_INTERVAL_S};
use geu_model::{Configuration, Simulation};
use geu_protocol::CanIdMap;
use geu_protocol::capture::Timestamp;
use geu_recording::{ReceivedSample, ReferenceAttitude};

/// By how much a receive time is later than the sample's end.
const LATE_S: f64 = 0.9e-3;
/// One sigma of that.
const JITTER_S: f64 = 0.15e-3;
/// Decimals of a receive time.
const DIGITS: u8 = 6;

/// What a unit told, and what truly happened.
#[derive(Debug, Clone)]
pub struct SimulatedRecording {
    /// Samples as they were received.
    pub rows: Vec<ReceivedSample>,
    /// The true attitude.
    pub reference: ReferenceAttitude,
    /// Its rows; the first is the start.
    motion: Vec<attitude::AttitudeRow>,
}

/// Flies a unit on its scenario for so long on-board time; receive times are late and jitter by the configuration's seed.
pub fn fly(configuration: &Configuration, duration_s: f64) -> SimulatedRecording {
    let start_ns = configuration.start_unix_ns;
    let simulation = Simulation::new(configuration);
    let mut late = NoiseStream::of_sensor(configuration.seed, "receiver");
    let mut truth = vec![simulation.start()];
    let mut rows = Vec::new();
    for (ended, reference) in simulation.take((duration_s / SAMPLE_INTERVAL_S).round() as usize) {
        let late_ns = (LATE_S + JITTER_S * late.standard_normal()).max(0.0) * 1e9;
        let t_us = (start_ns + ended.end_ns + late_ns as i64 + 500) / 1000;
        rows.push(ReceivedSample {
            time: Some(Timestamp { t_ns: t_us * 1000, digits: DIGITS }),
            is_received: true,
            sample: ended.sample,
            has_clock: true,
        });
        truth.extend(reference.iter().map(ReferenceSample::row));
    }
    // A shorter flight has no truth of its own: three rows, at rest.
    for index in truth.len()..4 {
        truth.push(attitude::AttitudeRow {
            t_s: index as f64 * SAMPLE_INTERVAL_S,
            angle_control_arcsec: [0.0; 3],
            ..truth[0]
        });
    }
    let recorded = RecordedAttitude::new(&truth).expect("rows of half a second each");
    SimulatedRecording {
        rows,
        reference: ReferenceAttitude { start_ns, truth: Arc::new(recorded), time_system: None },
        motion: truth,
    }
}

impl SimulatedRecording {
    /// `link.log`, as `candump -l` writes.
    pub fn link_log(&self) -> String {
        let (plan, mut text) = (CanIdMap::default(), String::new());
        for row in &self.rows {
            let stamp = stamp(row.time.map_or(0, |time| time.t_ns));
            for frame in plan.frames(&row.sample) {
                let _ = write!(text, "({stamp}) can0 {:03X}#", frame.id());
                frame.data().iter().for_each(|byte| {
                    let _ = write!(text, "{byte:02X}");
                });
                text.push('\n');
            }
        }
        text
    }

    /// `reference.csv` (icd.md).
    pub fn reference_csv(&self) -> String {
        let mut text = "t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s,theta_deg,psi_deg\n".to_owned();
        for pair in self.motion.windows(2) {
            let end = stamp(self.reference.start_ns + (pair[1].t_s * 1e9).round() as i64);
            let length_s = pair[1].t_s - pair[0].t_s;
            let [x, y, z] = pair[1].angle_control_arcsec.map(|angle| angle / length_s);
            let (theta_rad, psi_rad) = pair[1].theta_psi_rad.unwrap_or_default();
            let [theta_deg, psi_deg] = [theta_rad, psi_rad].map(|rad| rad / RAD_PER_DEG);
            let psi_deg = psi_deg.rem_euclid(360.0);
            let _ = writeln!(text, "{end},{x:.9},{y:.9},{z:.9},{theta_deg:.9},{psi_deg:.9}");
        }
        text
    }
}

/// A time in ns as seconds with six decimals.
fn stamp(ns: i64) -> String {
    let micros = (ns + 500) / 1000;
    format!("{}.{:06}", micros / 1_000_000, micros % 1_000_000)
}
