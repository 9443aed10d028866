//! Closed loop of spacecraft, emulator and on-board computer.
//!
//! The sample that ends at T sets the torque from T + 0.25 s to T + 0.75 s, the delay of a computer. So the truth is known
//! and sent a quarter second beyond the running sample, also with an error of the unit's clock.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::sync::atomic::Ordering::Relaxed;

use geu_calibration::noise::RandomWalks;
use geu_calibration::{GyroSelection, PriorCalibration};
use geu_files::interruption::stop_flag;
use geu_model::units::ARCSEC_PER_RAD;
use nalgebra::Vector3;

use crate::controller::AttitudeController;
use crate::emulator::Emulator;
use crate::spacecraft::Spacecraft;

/// Rate of the spacecraft at the start, as after a slew, arcsec/s.
const START_RATE_ARCSEC_S: [f64; 3] = [10.0, -6.0, 4.0];
/// Settling time of the start, s: six times the loop's 1/0.15 s. Later errors count.
pub const SETTLED_S: u32 = 40;
/// Largest oscillation of a stable loop, arcsec: counts are rounded to 1″, so the estimate is off by half of that about each
/// axis and the rate by 2″/s; wheels and sun add a half.
const OSCILLATION_ARCSEC: f64 = 4.0;
/// Standard deviations of the gyros' noise in the bound.
const SIGMAS: f64 = 5.0;
/// Step of the truth, in microseconds of the unit's clock.
const QUARTER_US: u64 = 250_000;

/// Result of a run.
pub struct ClosedLoopResult {
    /// The largest true pointing error after the settling time, arcsec.
    pub worst_arcsec: f64,
    /// On-board time of this error, s.
    pub worst_s: f64,
}

/// Largest error of a held pointing, arcsec: the loop's oscillation, and the random walks of a gyro's angle and drift over this
/// time.
pub fn bound_arcsec(prior: &PriorCalibration, seconds: u32) -> f64 {
    let run = (0.0, f64::from(seconds));
    let variance = |walks: &RandomWalks| walks.angle_covariance(run, run) + walks.drift_covariance(run, run);
    OSCILLATION_ARCSEC + SIGMAS * prior.walks.iter().map(variance).fold(0.0, f64::max).sqrt()
}

struct ClosedLoop<'a> {
    emulator: &'a mut Emulator,
    spacecraft: Spacecraft,
    /// Simulated time.
    t_us: u64,
    /// States that are not yet printed.
    states: VecDeque<State>,
}

#[derive(Clone, Copy)]
struct State {
    t_us: u64,
    error_arcsec: f64,
    rate_arcsec_s: f64,
}

/// Runs for `seconds` of on-board time, and prints a line for each.
///
/// # Errors
/// A link fails; SIGINT or SIGTERM before the end.
pub fn run(
    emulator: &mut Emulator,
    prior: &PriorCalibration,
    gyros: GyroSelection,
    seconds: u32,
    seed: u64,
) -> Result<ClosedLoopResult, String> {
    let spacecraft = Spacecraft::new(Vector3::from(START_RATE_ARCSEC_S) / ARCSEC_PER_RAD, seed);
    let mut closed_loop = ClosedLoop { emulator, spacecraft, t_us: 0, states: VecDeque::new() };
    let mut controller = AttitudeController::new(prior, gyros);
    let mut result = ClosedLoopResult { worst_arcsec: 0.0, worst_s: 0.0 };
    let start = closed_loop.truth_line();
    closed_loop.emulator.send_truth(&start);
    closed_loop.advance_to(3 * QUARTER_US, Vector3::zeros());
    let end_us = u64::from(seconds) * 1_000_000;
    let mut first = None;
    let stop = stop_flag().map_err(|error| format!("signals cannot be watched: {error}"))?;
    loop {
        let completed = closed_loop.emulator.next(stop);
        if stop.load(Relaxed) {
            return Err(format!("interrupted before {seconds} s: the pointing is not judged"));
        }
        let completed = completed?;
        // The index of a running unit does not start at 0. A sample that was not received keeps the last known torque.
        let now_us = (completed.index.saturating_sub(*first.get_or_insert(completed.index)) + 1) * 2 * QUARTER_US;
        let events: Vec<String> = completed.samples.into_iter().flat_map(|sample| controller.push(sample)).collect();
        let torque = controller.torque_n_m();
        let state = closed_loop.state_at(now_us);
        if now_us > u64::from(SETTLED_S) * 1_000_000 && state.error_arcsec > result.worst_arcsec {
            (result.worst_arcsec, result.worst_s) = (state.error_arcsec, now_us as f64 * 1e-6);
        }
        events.iter().for_each(|event| print(&format!("{:7.1} s  {event}", now_us as f64 * 1e-6)));
        if now_us.is_multiple_of(1_000_000) {
            print_state(&state, controller.error_rad.norm() * ARCSEC_PER_RAD, &torque);
        }
        if now_us >= end_us {
            return Ok(result);
        }
        closed_loop.advance_to(now_us + 3 * QUARTER_US, torque);
    }
}

impl ClosedLoop<'_> {
    /// Simulates the spacecraft under a torque, and sends its attitude to the emulator.
    fn advance_to(&mut self, t_us: u64, torque_n_m: Vector3<f64>) {
        let mut lines = String::new();
        while self.t_us < t_us {
            self.spacecraft.advance(torque_n_m, QUARTER_US as f64 * 1e-6);
            self.t_us += QUARTER_US;
            lines += &self.truth_line();
        }
        self.emulator.send_truth(&lines);
    }

    /// The present attitude, in the format of the emulator.
    fn truth_line(&mut self) -> String {
        let q = self.spacecraft.attitude;
        self.states.push_back(State {
            t_us: self.t_us,
            error_arcsec: q.angle() * ARCSEC_PER_RAD,
            rate_arcsec_s: self.spacecraft.rate_rad_s.norm() * ARCSEC_PER_RAD,
        });
        let t_s = self.t_us as f64 * 1e-6;
        format!("{{\"t_s\": {t_s}, \"q\": [{}, {}, {}, {}]}}\n", q.w, q.i, q.j, q.k)
    }

    /// The state at a time; earlier states are removed.
    fn state_at(&mut self, t_us: u64) -> State {
        while self.states.len() > 1 && self.states.get(1).is_some_and(|next| next.t_us <= t_us) {
            self.states.pop_front();
        }
        self.states.front().copied().unwrap_or(State { t_us, error_arcsec: 0.0, rate_arcsec_s: 0.0 })
    }
}

/// Prints the state of a second.
fn print_state(state: &State, estimated_arcsec: f64, torque_n_m: &Vector3<f64>) {
    let State { t_us, error_arcsec, rate_arcsec_s } = *state;
    print(&format!(
        "{:7.1} s  pointing error: true {error_arcsec:8.2}″  estimated {estimated_arcsec:8.2}″  rate {rate_arcsec_s:6.2}″/s  torque {:7.2} mN m",
        t_us as f64 * 1e-6,
        torque_n_m.norm() * 1e3
    ));
}

/// Prints a line on standard output; a failure is ignored.
pub fn print(line: &str) {
    let _ = writeln!(io::stdout(), "{line}");
}
