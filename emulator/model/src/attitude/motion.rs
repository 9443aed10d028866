//! Inertial rotation about the control axes, integrated exactly (Casteren eqs 5 and 6):
//!
//! ```text
//! ω_x = ψ' cos θ + ω_sun cos ψ sin θ  + limit cycle
//! ω_y = θ'       − ω_sun sin ψ        + limit cycle
//! ω_z = ψ' sin θ − ω_sun cos ψ cos θ
//! ```

use std::sync::Arc;

use super::Segment;
use super::plan::{AttitudeProfile, Leg};
use super::recorded::RecordedAttitude;
use super::stepped::{self, StreamedAttitude};
use super::sun::Sun;
use crate::number::numbers;
use crate::units::{ARCSEC_PER_RAD, SUN_RATE_RAD_S};

numbers! {
    /// The limit cycle of the attitude control about X and Y; added to the rates, never to θ and ψ (Casteren §3.3, §6).
    pub struct LimitCycle {
        /// Largest rate; 0 for none.
        rate_arcsec_s: 0.0, 0.0..=5.0;
        /// Period.
        period_s: 5.0, 0.5..=3600.0;
        /// Phase about X at the start.
        phase_x_rad: 0.0, -100.0..=100.0;
        /// Phase about Y at the start: a quarter period before X.
        phase_y_rad: (std::f64::consts::FRAC_PI_2), -100.0..=100.0;
    }
}

/// Attitude and rates at an instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotionState {
    /// True time since the start of the run.
    pub t_s: f64,
    /// Inertial rates about the control axes.
    pub rate_control_arcsec_s: [f64; 3],
    pub theta_rad: f64,
    /// Angle about the sun vector, not reduced to one turn.
    pub psi_rad: f64,
}

/// Motion over one stretch of time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotionStep {
    pub start: MotionState,
    pub end: MotionState,
    /// Length, true time.
    pub length_s: f64,
    /// Rotation about the control axes: the integral of the inertial rates.
    pub angle_control_arcsec: [f64; 3],
}

/// Nodes and weight of the two-point Gauss-Legendre rule on 0…1. Over 0.1 s at 720″/s the integrand turns by 3.5·10⁻⁴
/// rad, and the rule's error, 1/4320 of the fourth power of that, is below the rounding of the numbers.
const NODES: [f64; 2] = [0.211_324_865_405_187_1, 0.788_675_134_594_812_9];
/// Longest stretch integrated in one piece.
const LONGEST_S: f64 = 0.1;

/// Walks along a scenario or another truth, forward only, in stretches of any length.
#[derive(Debug, Clone)]
pub struct Motion {
    source: Source,
    now: MotionState,
}

#[derive(Debug, Clone)]
enum Source {
    Scenario(Box<Flight>),
    Recorded {
        rows: Arc<RecordedAttitude>,
        near: usize,
        angle_control_arcsec: [f64; 3],
    },
    /// Nothing of it is read before the first stretch is asked for: it may not be known yet.
    Stepped {
        truth: Arc<StreamedAttitude>,
        angle_control_arcsec: Option<[f64; 3]>,
        /// The sun at the end of the last stretch.
        sun: Option<Sun>,
    },
}

#[derive(Debug, Clone)]
struct Flight {
    plan: AttitudeProfile,
    limit_cycle: LimitCycle,
    segment: Segment,
    segment_start_s: f64,
    phases: Phases,
}

impl Motion {
    /// At the start of a scenario.
    pub fn new(plan: AttitudeProfile, limit_cycle: LimitCycle) -> Motion {
        Motion::starting_before(plan, limit_cycle, 0.0)
    }

    /// `before_s` before the start of a scenario, at rest until then.
    pub fn starting_before(mut plan: AttitudeProfile, limit_cycle: LimitCycle, before_s: f64) -> Motion {
        let segment = if before_s > 0.0 { plan.rest_before(before_s) } else { plan.next_segment() };
        let phases = Phases {
            theta: Turned::at(segment.theta.start_rad),
            psi: Turned::at(segment.psi.start_rad),
            cycle: limit_cycle.phases(-before_s),
        };
        let flight = Flight { plan, limit_cycle, segment, segment_start_s: -before_s, phases };
        Motion { now: flight.moment(-before_s), source: Source::Scenario(Box::new(flight)) }
    }

    /// At `t_s` of a recorded truth; at rest before its start and after its end.
    pub fn recorded(rows: Arc<RecordedAttitude>, t_s: f64) -> Motion {
        let mut near = 0;
        let (angle_control_arcsec, now) = rows.at(t_s, &mut near);
        Motion { source: Source::Recorded { rows, near, angle_control_arcsec }, now }
    }

    /// At `t_s` of a truth that becomes known as time goes on.
    pub fn stepped(truth: Arc<StreamedAttitude>, t_s: f64) -> Motion {
        let source = Source::Stepped { truth, angle_control_arcsec: None, sun: None };
        Motion { source, now: stepped::moment(t_s, None) }
    }

    /// Moves on to `end_s` (true time since the start) and tells the motion since the last call; no motion where `end_s`
    /// lies before that.
    #[inline]
    pub fn advance(&mut self, end_s: f64) -> MotionStep {
        let start = self.now;
        if end_s <= start.t_s {
            return MotionStep { start, end: start, ..MotionStep::default() };
        }
        let mut step = MotionStep { start, length_s: end_s - start.t_s, ..MotionStep::default() };
        match &mut self.source {
            Source::Scenario(flight) => {
                step.angle_control_arcsec = flight.advance(start.t_s, end_s);
                self.now = flight.moment(end_s);
                step.end = self.now;
            }
            Source::Recorded { rows, near, angle_control_arcsec } => {
                let (angle, moment) = rows.at(end_s, near);
                step.angle_control_arcsec = std::array::from_fn(|axis| angle[axis] - angle_control_arcsec[axis]);
                (*angle_control_arcsec, self.now, step.end) = (angle, moment, moment);
            }
            Source::Stepped { truth, angle_control_arcsec, sun } => {
                let before = angle_control_arcsec.unwrap_or_else(|| {
                    let (angle, moment, _) = truth.at(start.t_s);
                    step.start = moment;
                    angle
                });
                let (angle, moment, sun_now) = truth.at(end_s);
                step.angle_control_arcsec = std::array::from_fn(|axis| angle[axis] - before[axis]);
                (*angle_control_arcsec, *sun) = (Some(angle), sun_now);
                (self.now, step.end) = (moment, moment);
            }
        }
        step
    }

    /// Attitude and rates at the end of the last stretch.
    pub fn now(&self) -> &MotionState {
        &self.now
    }

    /// Whether θ and ψ of [`Motion::now`] are known; a truth from outside may not tell them, and tells nothing before the
    /// first stretch.
    pub fn knows_sun(&self) -> bool {
        match &self.source {
            Source::Scenario(_) => true,
            Source::Recorded { rows, .. } => rows.knows_sun(),
            Source::Stepped { sun, .. } => sun.is_some(),
        }
    }

    /// Variables of a fault's condition that it does not tell, as far as it is known.
    pub fn untold(&self) -> &'static [&'static str] {
        let tells_sun = match &self.source {
            Source::Stepped { truth, .. } => truth.tells_sun(),
            Source::Scenario(_) | Source::Recorded { .. } => self.knows_sun(),
        };
        if tells_sun { &[] } else { &["theta_deg", "psi_deg"] }
    }

    /// Turns about X and Y of the attitude out of the one that θ and ψ tell, now.
    ///
    /// The limit cycle is in the rates, never in θ and ψ: in a scenario this is its integral; in a recorded truth what the
    /// file's rotation has more than its θ and ψ mean (eqs 5 and 6), counted from its first row.
    pub fn departure_control_arcsec(&self) -> [f64; 2] {
        match &self.source {
            Source::Scenario(flight) => flight.limit_cycle.departure_control_arcsec(self.now.t_s),
            Source::Recorded { rows, near, .. } => rows.departure_control_arcsec(self.now.t_s, *near),
            Source::Stepped { sun, .. } => sun.map_or([0.0; 2], |sun| sun.departure_control_arcsec),
        }
    }

    /// The legs that began since the last call, and perhaps one that is about to. Only those that were still flown
    /// during the last stretch are kept, so they must be taken after every stretch or not at all.
    pub fn take_legs(&mut self) -> Vec<Leg> {
        match &mut self.source {
            Source::Scenario(flight) => flight.plan.take_legs(),
            Source::Recorded { .. } | Source::Stepped { .. } => Vec::new(),
        }
    }
}

/// Sine and cosine of an angle.
#[derive(Debug, Clone, Copy, Default)]
struct Turned {
    sin: f64,
    cos: f64,
}

impl Turned {
    #[inline]
    fn at(rad: f64) -> Turned {
        let (sin, cos) = libm::sincos(rad);
        Turned { sin, cos }
    }

    /// Turned further by an angle of 10⁻³ rad at most: the series' next term is below 10⁻²⁰.
    #[inline]
    fn by(self, rad: f64) -> Turned {
        let square = rad * rad;
        let (sin, cos) =
            (rad * (1.0 - square / 6.0 * (1.0 - square / 20.0)), 1.0 - square / 2.0 * (1.0 - square / 12.0));
        Turned { sin: self.sin * cos + self.cos * sin, cos: self.cos * cos - self.sin * sin }
    }
}

/// θ, ψ and the phases of the limit cycle about X and Y at a moment.
#[derive(Debug, Clone, Copy, Default)]
struct Phases {
    theta: Turned,
    psi: Turned,
    cycle: [Turned; 2],
}

impl Flight {
    /// Rotation from the last call to `end_s`, arcsec.
    #[inline]
    fn advance(&mut self, start_s: f64, end_s: f64) -> [f64; 3] {
        self.plan.forget_legs_before(start_s);
        let mut angle_rad = [0.0; 3];
        let mut now_s = start_s;
        let mut cycle = self.phases.cycle;
        while now_s < end_s {
            let segment_end_s = self.segment_start_s + self.segment.duration_s;
            if segment_end_s <= now_s {
                self.segment = self.plan.next_segment();
                self.segment_start_s = segment_end_s;
                continue;
            }
            // The small excess keeps a stretch of 0.1 s and a rounding error in one piece.
            let until_s = if end_s - now_s > LONGEST_S * (1.0 + 1e-9) { now_s + LONGEST_S } else { end_s };
            let until_s = until_s.min(segment_end_s);
            self.integrate(now_s, until_s, &mut angle_rad);
            self.turn_to(until_s);
            now_s = until_s;
        }
        let mut angle_control_arcsec = angle_rad.map(|angle| angle * ARCSEC_PER_RAD);
        if self.limit_cycle.rate_arcsec_s != 0.0 {
            self.phases.cycle = self.limit_cycle.phases(end_s);
            let radius_arcsec = self.limit_cycle.rate_arcsec_s / self.limit_cycle.turn_rad_s();
            for ((angle, before), after) in angle_control_arcsec.iter_mut().zip(&mut cycle).zip(self.phases.cycle) {
                *angle += radius_arcsec * (before.cos - after.cos);
            }
        }
        angle_control_arcsec
    }

    /// The moment that the flight has reached.
    #[inline]
    fn moment(&self, t_s: f64) -> MotionState {
        let (theta, psi, since_s) = (&self.segment.theta, &self.segment.psi, t_s - self.segment_start_s);
        let rates = rates(self.phases.theta, self.phases.psi, theta.rate_rad_s(since_s), psi.rate_rad_s(since_s));
        let mut rate_control_arcsec_s = rates.map(|rate| rate * ARCSEC_PER_RAD);
        for (rate, phase) in rate_control_arcsec_s.iter_mut().zip(self.phases.cycle) {
            *rate += self.limit_cycle.rate_arcsec_s * phase.sin;
        }
        MotionState { t_s, rate_control_arcsec_s, theta_rad: theta.angle_rad(since_s), psi_rad: psi.angle_rad(since_s) }
    }

    #[inline]
    fn turn_to(&mut self, t_s: f64) {
        let since_s = t_s - self.segment_start_s;
        if !self.segment.theta.is_at_rest() {
            self.phases.theta = Turned::at(self.segment.theta.angle_rad(since_s));
        }
        if !self.segment.psi.is_at_rest() {
            self.phases.psi = Turned::at(self.segment.psi.angle_rad(since_s));
        }
    }

    #[inline]
    fn integrate(&self, start_s: f64, end_s: f64, angle_rad: &mut [f64; 3]) {
        let (start, length_s) = (start_s - self.segment_start_s, end_s - start_s);
        let Segment { theta, psi, .. } = &self.segment;
        let (theta_before, psi_before) = (theta.change_rad(start), psi.change_rad(start));
        let mut sum = [0.0; 3];
        for node in NODES {
            let t_s = start + node * length_s;
            let theta_at = self.phases.theta.by(theta.change_rad(t_s) - theta_before);
            let psi_at = self.phases.psi.by(psi.change_rad(t_s) - psi_before);
            for (sum, rate) in sum.iter_mut().zip(rates(theta_at, psi_at, 0.0, psi.rate_rad_s(t_s))) {
                *sum += rate;
            }
        }
        angle_rad[0] += 0.5 * length_s * sum[0];
        angle_rad[1] += 0.5 * length_s * sum[1] + theta.change_rad(start + length_s) - theta_before;
        angle_rad[2] += 0.5 * length_s * sum[2];
    }
}

impl LimitCycle {
    #[inline]
    fn turn_rad_s(&self) -> f64 {
        std::f64::consts::TAU / self.period_s
    }

    /// The attitude's departure by the limit cycle, as small turns about X and Y: the integral of its rates, about the
    /// attitude that the control holds, so that its mean is zero (Casteren §3.3, §6).
    pub fn departure_control_arcsec(&self, t_s: f64) -> [f64; 2] {
        [self.phase_x_rad, self.phase_y_rad]
            .map(|phase_rad| -self.rate_arcsec_s / self.turn_rad_s() * libm::cos(self.turn_rad_s() * t_s + phase_rad))
    }

    #[inline]
    fn phases(&self, t_s: f64) -> [Turned; 2] {
        if self.rate_arcsec_s == 0.0 {
            return Default::default();
        }
        [self.phase_x_rad, self.phase_y_rad].map(|phase_rad| Turned::at(self.turn_rad_s() * t_s + phase_rad))
    }
}

/// Inertial rates without the limit cycle, rad/s.
#[inline]
fn rates(theta: Turned, psi: Turned, theta_rate: f64, psi_rate: f64) -> [f64; 3] {
    [
        psi_rate * theta.cos + SUN_RATE_RAD_S * psi.cos * theta.sin,
        theta_rate - SUN_RATE_RAD_S * psi.sin,
        psi_rate * theta.sin - SUN_RATE_RAD_S * psi.cos * theta.cos,
    ]
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::attitude::{Manoeuvre, Scenario};

    fn motion(scenario: &Scenario) -> Motion {
        Motion::new(AttitudeProfile::new(scenario).expect("possible"), scenario.limit_cycle)
    }

    fn still() -> Scenario {
        Scenario { theta_deg: 90.0, psi_deg: 0.0, limit_cycle: LimitCycle::default(), manoeuvres: Vec::new() }
    }

    #[test]
    fn a_pointing_turns_with_the_sun() {
        // Casteren eq 8, with the misprint mended: θ = 60°, ψ = 40°, one hour; ω_sun = 360·3600/365.25/24 = 147.844″/h (a pocket calculator).
        let scenario = Scenario { theta_deg: 60.0, psi_deg: 40.0, ..still() };
        let angle = motion(&scenario).advance(3600.0).angle_control_arcsec;
        for (got, expected) in angle.into_iter().zip([98.081734, -95.032254, -56.627515]) {
            assert!((got - expected).abs() < 1e-5, "{got} {expected}");
        }
    }

    #[test]
    fn whole_and_pieces_agree_through_every_kind_of_manoeuvre() {
        let scenario = crate::Configuration::reference().scenario;
        let (mut coarse, mut fine) = (motion(&scenario), motion(&scenario));
        for sample in 1..=40_000 {
            let end_s = 0.5 * f64::from(sample);
            let whole = coarse.advance(end_s);
            let mut sum = [0.0; 3];
            for piece in (0..7).rev() {
                let step = fine.advance(end_s - 0.5 * f64::from(piece) / 7.0);
                for (sum, angle) in sum.iter_mut().zip(step.angle_control_arcsec) {
                    *sum += angle;
                }
            }
            for (a, b) in whole.angle_control_arcsec.into_iter().zip(sum) {
                assert!((a - b).abs() < 1e-9, "{end_s}: {a} {b}");
            }
        }
    }

    #[test]
    fn a_scan_about_the_sun_vector_turns_once_about_it() {
        // A Z-scan at θ = 90°: Δψ = 360° about Z, and the sun's part about Z vanishes with cos θ.
        let scenario = Scenario { manoeuvres: vec![Manoeuvre::of_kind("z-scan").expect("a kind")], ..still() };
        let angle = motion(&scenario).advance(7000.0).angle_control_arcsec;
        assert!((angle[2] - TAU * ARCSEC_PER_RAD).abs() < 1e-6, "{}", angle[2]);
    }

    #[test]
    fn the_departure_by_the_limit_cycle_is_its_integral_about_zero() {
        let cycle = LimitCycle { rate_arcsec_s: 4.0, phase_x_rad: 0.7, ..LimitCycle::default() };
        let mut with = motion(&Scenario { limit_cycle: cycle, ..still() });
        let mut without = motion(&still());
        let (mut turned, start) = ([0.0; 2], with.departure_control_arcsec());
        for tenth in 1..=100 {
            let end_s = f64::from(tenth) * 0.1;
            let (a, b) = (with.advance(end_s).angle_control_arcsec, without.advance(end_s).angle_control_arcsec);
            for axis in 0..2 {
                turned[axis] += a[axis] - b[axis];
                let departure = with.departure_control_arcsec()[axis];
                assert!((departure - start[axis] - turned[axis]).abs() < 1e-9);
                // 4·5/2π, under the 5 arcsec of Casteren §6.
                assert!(departure.abs() < 3.184);
            }
        }
    }

    #[test]
    fn the_limit_cycle_swings_by_its_rate_times_its_period() {
        let with = Scenario { limit_cycle: LimitCycle { rate_arcsec_s: 4.0, ..LimitCycle::default() }, ..still() };
        let half_swing = |scenario: &Scenario| motion(scenario).advance(2.5).angle_control_arcsec[0];
        // The integral of 4 sin(2πt/5) over half a period is 4·5/π.
        assert!((half_swing(&with) - half_swing(&still()) - 20.0 / std::f64::consts::PI).abs() < 1e-12);
    }
}
