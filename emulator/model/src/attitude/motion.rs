//! Inertial rotation about the control axes, integrated exactly (Casteren eqs 5 and 6):
//!
//! ```text
//! ω_x = ψ' cos θ + ω_sun cos ψ sin θ  + limit cycle
//! ω_y = θ'       − ω_sun sin ψ        + limit cycle
//! ω_z = ψ' sin θ − ω_sun cos ψ cos θ
//! ```

use std::sync::Arc;

use super::Segment;
use super::body_rates::{RateMotion, RateSegment};
use super::profile::{AttitudeProfile, Leg};
use super::recorded::RecordedAttitude;
use super::streamed::{self, StreamedAttitude};
use super::sun::Sun;
use crate::parameter_spec::numbers;
use crate::units::{ARCSEC_PER_RAD, SUN_RATE_RAD_S};

numbers! {
    /// The limit cycle of the attitude control about X and Y; added to the rates, never to θ and ψ (Casteren §3.3, §6).
    pub struct LimitCycle {
        /// Largest rate; 0 for none.
        rate_arcsec_s: 0.0, 0.0..=5.0, "arcsec/s";
        /// Period.
        period_s: 5.0, 0.5..=3600.0, "s";
        /// Phase about X at the start.
        phase_x_rad: 0.0, -100.0..=100.0, "rad";
        /// Phase about Y at the start: a quarter period before X.
        phase_y_rad: (std::f64::consts::FRAC_PI_2), -100.0..=100.0, "rad";
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

/// Motion over an interval.
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
/// Longest interval of one integration step.
const LONGEST_S: f64 = 0.1;

/// Follows a scenario or another truth, forward only, in intervals of any length.
#[derive(Debug, Clone)]
pub struct Motion {
    source: Source,
    now: MotionState,
}

#[derive(Debug, Clone)]
enum Source {
    Scenario(Box<ScenarioMotion>),
    Rates(Box<RateMotion>),
    Recorded {
        rows: Arc<RecordedAttitude>,
        near: usize,
        angle_control_arcsec: [f64; 3],
    },
    /// Not read before the first interval: the truth may not be known yet.
    Stepped {
        truth: Arc<StreamedAttitude>,
        angle_control_arcsec: Option<[f64; 3]>,
        /// The sun at the end of the last interval.
        sun: Option<Sun>,
    },
}

#[derive(Debug, Clone)]
struct ScenarioMotion {
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
        let scenario = ScenarioMotion { plan, limit_cycle, segment, segment_start_s: -before_s, phases };
        Motion { now: scenario.moment(-before_s), source: Source::Scenario(Box::new(scenario)) }
    }

    /// At the start of a motion of prescribed rates, or at rest before it.
    pub fn of_rates(segments: &[RateSegment], seed: u64, t_s: f64) -> Motion {
        let mut rates = RateMotion::new(segments, seed);
        let (_, now) = rates.advance(t_s);
        Motion { source: Source::Rates(Box::new(rates)), now }
    }

    /// At `t_s` of a recorded truth; at rest before its start and after its end.
    pub fn recorded(rows: Arc<RecordedAttitude>, t_s: f64) -> Motion {
        let mut near = 0;
        let (angle_control_arcsec, now) = rows.at(t_s, &mut near);
        Motion { source: Source::Recorded { rows, near, angle_control_arcsec }, now }
    }

    /// At `t_s` of a truth that is received during the run.
    pub fn stepped(truth: Arc<StreamedAttitude>, t_s: f64) -> Motion {
        let source = Source::Stepped { truth, angle_control_arcsec: None, sun: None };
        Motion { source, now: streamed::moment(t_s, None) }
    }

    /// Moves on to `end_s` (true time since the start) and returns the motion since the last call; no motion if `end_s`
    /// lies before that.
    #[inline]
    pub fn advance(&mut self, end_s: f64) -> MotionStep {
        let start = self.now;
        if end_s <= start.t_s {
            return MotionStep { start, end: start, ..MotionStep::default() };
        }
        let mut step = MotionStep { start, length_s: end_s - start.t_s, ..MotionStep::default() };
        match &mut self.source {
            Source::Scenario(scenario) => {
                step.angle_control_arcsec = scenario.advance(start.t_s, end_s);
                self.now = scenario.moment(end_s);
                step.end = self.now;
            }
            Source::Rates(rates) => {
                (step.angle_control_arcsec, self.now) = rates.advance(end_s);
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

    /// Attitude and rates at the end of the last interval.
    pub fn now(&self) -> &MotionState {
        &self.now
    }

    /// True if θ and ψ of [`Motion::now`] are known; an external truth may not have them, and has none before the first
    /// interval.
    pub fn knows_sun(&self) -> bool {
        match &self.source {
            Source::Scenario(_) => true,
            Source::Rates(_) => false,
            Source::Recorded { rows, .. } => rows.knows_sun(),
            Source::Stepped { sun, .. } => sun.is_some(),
        }
    }

    /// Variables of a fault's condition that are not available, as far as it is known.
    pub fn unavailable(&self) -> &'static [&'static str] {
        let has_sun = match &self.source {
            Source::Stepped { truth, .. } => truth.has_sun(),
            Source::Scenario(_) | Source::Rates(_) | Source::Recorded { .. } => self.knows_sun(),
        };
        if has_sun { &[] } else { &["theta_deg", "psi_deg"] }
    }

    /// Current rotation about X and Y of the attitude from the one that θ and ψ define.
    ///
    /// The limit cycle is in the rates, never in θ and ψ: in a scenario this is its integral; in a recorded truth what the
    /// file's rotation has more than its θ and ψ mean (eqs 5 and 6), counted from its first row.
    pub fn departure_control_arcsec(&self) -> [f64; 2] {
        match &self.source {
            Source::Scenario(scenario) => scenario.limit_cycle.departure_control_arcsec(self.now.t_s),
            Source::Rates(_) => [0.0; 2],
            Source::Recorded { rows, near, .. } => rows.departure_control_arcsec(self.now.t_s, *near),
            Source::Stepped { sun, .. } => sun.map_or([0.0; 2], |sun| sun.departure_control_arcsec),
        }
    }

    /// The legs that began since the last call, and perhaps the next one. Only legs that ended after the start of the
    /// last interval are kept: call this after every interval or never.
    pub fn take_legs(&mut self) -> Vec<Leg> {
        match &mut self.source {
            Source::Scenario(scenario) => scenario.plan.take_legs(),
            Source::Rates(_) | Source::Recorded { .. } | Source::Stepped { .. } => Vec::new(),
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

impl ScenarioMotion {
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
            // The small excess allows an interval of 0.1 s with a rounding error in one step.
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

    /// Attitude and rates at `t_s`.
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
mod tests;
