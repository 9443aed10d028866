//! A flight: spacecraft, emulator and on-board computer in a closed loop.
//!
//! The sample that ends at T is answered by a torque from T + 0.25 s to T + 0.75 s: a computer needs its time. So the
//! truth is always known, and told, a quarter second beyond the sample that runs, whatever the unit's clock is worth.

use std::collections::VecDeque;
use std::fmt::Write;
use std::io::{self, Write as _};
use std::sync::atomic::Ordering::Relaxed;

use geu_calibration::noise::RandomWalks;
use geu_calibration::{GyroSelection, PriorCalibration};
use geu_files::interruption::stop_flag;
use geu_model::units::ARCSEC_PER_RAD;
use nalgebra::Vector3;

use crate::computer::AttitudeController;
use crate::emulator::Emulator;
use crate::spacecraft::Spacecraft;

/// The spacecraft turns so at the start, as after a slew, arcsec/s.
const START_RATE_ARCSEC_S: [f64; 3] = [10.0, -6.0, 4.0];
/// So long the start may take to settle, s: six times the loop's own 1/0.15 s. Later it counts.
pub const SETTLED_S: u32 = 40;
/// A loop that holds swings by so much at most, arcsec: counts are rounded to 1″, so what it believes is off by half of that
/// about each axis and the rate by 2″/s; wheels and sun add a half.
const SWING_ARCSEC: f64 = 4.0;
/// What the gyros' own noise turns unseen is allowed for by so many standard deviations.
const SIGMAS: f64 = 5.0;
/// The truth is told for every quarter second, in microseconds of the unit's clock.
const QUARTER_US: u64 = 250_000;

/// How a flight went.
pub struct ClosedLoopResult {
    /// The largest true pointing error after the start had settled, arcsec, and when.
    pub worst_arcsec: f64,
    /// On-board time of it, s.
    pub worst_s: f64,
}

/// Pointing that is further off at the end of a flight was not held, arcsec: the loop's swing, and the walks of a gyro's angle
/// and drift over so long.
pub fn bound_arcsec(believed: &PriorCalibration, seconds: u32) -> f64 {
    let flight = (0.0, f64::from(seconds));
    let variance =
        |walks: &RandomWalks| walks.angle_covariance(flight, flight) + walks.drift_covariance(flight, flight);
    SWING_ARCSEC + SIGMAS * believed.walks.iter().map(variance).fold(0.0, f64::max).sqrt()
}

struct ClosedLoop<'a> {
    emulator: &'a mut Emulator,
    spacecraft: Spacecraft,
    /// How far it has flown.
    flown_us: u64,
    /// Where it was, not yet told to the reader of the report.
    states: VecDeque<State>,
}

#[derive(Clone, Copy)]
struct State {
    t_us: u64,
    error_arcsec: f64,
    rate_arcsec_s: f64,
}

/// Flies for so many seconds of on-board time, and prints a line for each.
///
/// # Errors
/// A link that fails, SIGINT or SIGTERM before the end.
pub fn fly(
    emulator: &mut Emulator,
    believed: &PriorCalibration,
    gyros: GyroSelection,
    seconds: u32,
    seed: u64,
) -> Result<ClosedLoopResult, String> {
    let spacecraft = Spacecraft::new(Vector3::from(START_RATE_ARCSEC_S) / ARCSEC_PER_RAD, seed);
    let mut flight = ClosedLoop { emulator, spacecraft, flown_us: 0, states: VecDeque::new() };
    let mut computer = AttitudeController::new(believed, gyros);
    let mut flown = ClosedLoopResult { worst_arcsec: 0.0, worst_s: 0.0 };
    flight.tell_start();
    flight.fly_to(3 * QUARTER_US, Vector3::zeros());
    let end_us = u64::from(seconds) * 1_000_000;
    let mut first = None;
    let stop = stop_flag().map_err(|error| format!("signals cannot be watched: {error}"))?;
    loop {
        let ended = flight.emulator.next(stop);
        if stop.load(Relaxed) {
            return Err(format!("interrupted before {seconds} s: the pointing is not judged"));
        }
        let ended = ended?;
        // A unit that runs since before has counted on. A sample of which the link brought nothing is flown all the
        // same, under the torque of what is known.
        let now_us = (ended.index.saturating_sub(*first.get_or_insert(ended.index)) + 1) * 2 * QUARTER_US;
        let events: Vec<String> = ended.samples.into_iter().flat_map(|sample| computer.take(sample)).collect();
        let torque = computer.torque_n_m();
        let state = flight.state_at(now_us);
        if now_us > u64::from(SETTLED_S) * 1_000_000 && state.error_arcsec > flown.worst_arcsec {
            (flown.worst_arcsec, flown.worst_s) = (state.error_arcsec, now_us as f64 * 1e-6);
        }
        events.iter().for_each(|event| say(&format!("{:7.1} s  {event}", now_us as f64 * 1e-6)));
        if now_us.is_multiple_of(1_000_000) {
            report(&state, computer.error_rad.norm() * ARCSEC_PER_RAD, &torque);
        }
        if now_us >= end_us {
            return Ok(flown);
        }
        flight.fly_to(now_us + 3 * QUARTER_US, torque);
    }
}

impl ClosedLoop<'_> {
    fn tell_start(&mut self) {
        let line = self.line();
        self.emulator.tell(&line);
    }

    /// Flies on under a torque, and tells the emulator where that goes.
    fn fly_to(&mut self, t_us: u64, torque_n_m: Vector3<f64>) {
        let mut lines = String::new();
        while self.flown_us < t_us {
            self.spacecraft.advance(torque_n_m, QUARTER_US as f64 * 1e-6);
            self.flown_us += QUARTER_US;
            lines += &self.line();
        }
        self.emulator.tell(&lines);
    }

    /// Where the spacecraft is now, as the emulator reads it.
    fn line(&mut self) -> String {
        let q = self.spacecraft.attitude;
        self.states.push_back(State {
            t_us: self.flown_us,
            error_arcsec: q.angle() * ARCSEC_PER_RAD,
            rate_arcsec_s: self.spacecraft.rate_rad_s.norm() * ARCSEC_PER_RAD,
        });
        let mut line = String::new();
        let t_s = self.flown_us as f64 * 1e-6;
        let _ = writeln!(line, r#"{{"t_s": {t_s}, "q": [{}, {}, {}, {}]}}"#, q.w, q.i, q.j, q.k);
        line
    }

    /// Where it was then; what was before is forgotten.
    fn state_at(&mut self, t_us: u64) -> State {
        while self.states.len() > 1 && self.states.get(1).is_some_and(|next| next.t_us <= t_us) {
            self.states.pop_front();
        }
        self.states.front().copied().unwrap_or(State { t_us, error_arcsec: 0.0, rate_arcsec_s: 0.0 })
    }
}

/// A line for a second of the flight.
fn report(state: &State, believed_arcsec: f64, torque_n_m: &Vector3<f64>) {
    let State { t_us, error_arcsec, rate_arcsec_s } = *state;
    say(&format!(
        "{:7.1} s  pointing error: true {error_arcsec:8.2}″  believed {believed_arcsec:8.2}″  rate {rate_arcsec_s:6.2}″/s  torque {:7.2} mN m",
        t_us as f64 * 1e-6,
        torque_n_m.norm() * 1e3
    ));
}

/// A line on standard output; nobody is left to tell where it cannot be written.
pub fn say(line: &str) {
    let _ = writeln!(io::stdout(), "{line}");
}
