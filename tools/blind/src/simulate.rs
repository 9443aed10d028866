//! Recordings in memory: the samples of a unit on its scenario, as received on a link, and the exact attitude.

use std::fmt::Write;
use std::sync::Arc;

use geu_model::attitude::{AttitudeRow, RecordedAttitude};
use geu_model::noise::NoiseStream;
use geu_model::simulation::ReferenceSample;
use geu_model::units::{RAD_PER_DEG, SAMPLE_INTERVAL_S};
use geu_model::{Configuration, Simulation};
use geu_protocol::CanIdMap;
use geu_protocol::capture::Timestamp;
use geu_recording::{ReceivedSample, ReferenceAttitude};

/// Mean delay of a receive time after the end of the sample, and its sigma.
const LATENCY_S: f64 = 0.9e-3;
const JITTER_S: f64 = 0.15e-3;
/// Minimum number of rows of an attitude.
const MIN_ATTITUDE_ROWS: usize = 4;

/// Samples of a unit and the true attitude.
#[derive(Debug, Clone)]
pub struct SimulatedRecording {
    /// Samples as received.
    pub rows: Vec<ReceivedSample>,
    /// The true attitude.
    pub reference: ReferenceAttitude,
    /// Rows of the true attitude; the first is the start.
    motion: Vec<AttitudeRow>,
}

/// Simulates a unit on its scenario for `duration_s` of on-board time. The seed of the configuration determines the jitter of the
/// receive times.
pub fn simulate(configuration: &Configuration, duration_s: f64) -> SimulatedRecording {
    let start_ns = configuration.start_unix_ns;
    let simulation = Simulation::new(configuration);
    let mut delay = NoiseStream::of_sensor(configuration.seed, "receiver");
    let mut motion = vec![simulation.start()];
    let mut rows = Vec::new();
    for (completed, reference) in simulation.take((duration_s / SAMPLE_INTERVAL_S).round() as usize) {
        let delay_ns = (LATENCY_S + JITTER_S * delay.standard_normal()).max(0.0) * 1e9;
        let time = Some(Timestamp::micros(start_ns + completed.end_ns + delay_ns as i64));
        rows.push(ReceivedSample { time, is_received: true, sample: completed.sample, has_clock: true });
        motion.extend(reference.iter().map(ReferenceSample::row));
    }
    // A shorter recording is completed at rest.
    for index in motion.len()..MIN_ATTITUDE_ROWS {
        let t_s = index as f64 * SAMPLE_INTERVAL_S;
        motion.push(AttitudeRow { t_s, angle_control_arcsec: [0.0; 3], ..motion[0] });
    }
    let truth = Arc::new(RecordedAttitude::new(motion.clone()).expect("rows every 0.5 s"));
    SimulatedRecording { rows, reference: ReferenceAttitude::of_truth(start_ns, truth), motion }
}

impl SimulatedRecording {
    /// `link.log` in the format of `candump -l`.
    pub fn link_log(&self) -> String {
        let (map, mut text) = (CanIdMap::default(), String::new());
        for row in &self.rows {
            let stamp = row.time.unwrap_or(Timestamp::micros(0));
            for frame in map.frames(&row.sample) {
                let _ = write!(text, "({stamp}) can0 {:03X}#", frame.id());
                frame.data().iter().for_each(|byte| {
                    let _ = write!(text, "{byte:02X}");
                });
                text.push('\n');
            }
        }
        text
    }

    /// `reference.csv` (protocol/ICD.md).
    pub fn reference_csv(&self) -> String {
        let mut text = "t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s,theta_deg,psi_deg\n".to_owned();
        for pair in self.motion.windows(2) {
            let end = Timestamp::micros(self.reference.start_ns + (pair[1].t_s * 1e9).round() as i64);
            let length_s = pair[1].t_s - pair[0].t_s;
            let [x, y, z] = pair[1].angle_control_arcsec.map(|angle| angle / length_s);
            let (theta_rad, psi_rad) = pair[1].theta_psi_rad.unwrap_or_default();
            let (theta_deg, psi_deg) = (theta_rad / RAD_PER_DEG, (psi_rad / RAD_PER_DEG).rem_euclid(360.0));
            let _ = writeln!(text, "{end},{x:.9},{y:.9},{z:.9},{theta_deg:.9},{psi_deg:.9}");
        }
        text
    }
}
