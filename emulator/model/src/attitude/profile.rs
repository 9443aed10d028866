//! The attitude profile of a scenario: its manoeuvres as segments, in order.
//!
//! A manoeuvre starts and ends at rest in θ and ψ. A turn ramps up, cruises and ramps down; one that is shorter than its
//! two ramps is infeasible, as is a θ outside 60°…120°. The profile is verified when the scenario is read; only a survey
//! without end is computed during the run.

use std::collections::VecDeque;

use super::manoeuvre::{Eclipse, Manoeuvre, Pointing, Raster, Scenario, Stabilise, Survey, YScan};
use super::{Quadratic, Segment};
use crate::units::{ARCSEC_PER_DEG, ARCSEC_PER_RAD, RAD_PER_DEG};

/// Limits of the solar aspect angle (Casteren §1).
pub const THETA_LIMITS_DEG: (f64, f64) = (60.0, 120.0);

/// An infeasible manoeuvre.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{reason}")]
pub struct InfeasibleManoeuvre {
    pub index: usize,
    pub field: &'static str,
    /// Expected and actual value.
    pub reason: String,
}

/// One manoeuvre, or one scan or slew of a survey, laid out.
#[derive(Debug, Clone, PartialEq)]
pub struct Leg {
    /// Name in `manoeuvres.csv`.
    pub name: &'static str,
    /// Start, true time since the start of the scenario.
    pub start_s: f64,
    /// End; infinite for a hold without end.
    pub end_s: f64,
    /// θ and ψ at the start, at rest; ψ is not reduced to one turn.
    pub start_rad: [f64; 2],
    /// θ and ψ at the end, at rest.
    pub end_rad: [f64; 2],
    /// True in eclipse.
    pub eclipse: bool,
}

/// A scenario as segments, up to slightly after the current time.
#[derive(Debug, Clone)]
pub struct AttitudeProfile {
    manoeuvres: Vec<Manoeuvre>,
    /// The manoeuvre to be laid out next, and which part of it.
    next: (usize, u64),
    /// Attitude and time at the end of what is laid out.
    theta_rad: f64,
    psi_rad: f64,
    end_s: f64,
    /// Direction of the survey's next step in θ.
    theta_direction: f64,
    segments: VecDeque<Segment>,
    legs: Vec<Leg>,
}

impl AttitudeProfile {
    /// Lays the scenario out; every manoeuvre is tried, a survey without end up to its second turn-back.
    ///
    /// # Errors
    /// The first infeasible manoeuvre.
    pub fn new(scenario: &Scenario) -> Result<AttitudeProfile, InfeasibleManoeuvre> {
        let plan = AttitudeProfile {
            manoeuvres: scenario.manoeuvres.clone(),
            next: (0, 0),
            theta_rad: scenario.theta_deg * RAD_PER_DEG,
            psi_rad: scenario.psi_deg * RAD_PER_DEG,
            end_s: 0.0,
            theta_direction: 1.0,
            segments: VecDeque::new(),
            legs: Vec::new(),
        };
        let mut trial = plan.clone();
        for index in 0..scenario.manoeuvres.len() {
            // The first scan of a survey is checked for every θ it can reach, and the first step shows whether all are
            // feasible; a survey without end needs no more.
            let is_endless = is_endless(&scenario.manoeuvres[index]);
            while trial.next.0 == index && !(is_endless && trial.next.1 > 2) {
                trial.lay_out().map_err(|(field, reason)| InfeasibleManoeuvre { index, field, reason })?;
                trial.segments.clear();
                trial.legs.clear();
            }
            if trial.next.0 == index {
                if index + 1 < scenario.manoeuvres.len() {
                    return Err(InfeasibleManoeuvre {
                        index: index + 1,
                        field: "kind",
                        reason: format!(
                            "expected no manoeuvre after a survey without end (manoeuvre {}); give that survey a number of scans",
                            index + 1
                        ),
                    });
                }
                break;
            }
        }
        Ok(plan)
    }

    /// Duration of a scenario; `None` if it has no end or no manoeuvres.
    pub fn length_s(scenario: &Scenario) -> Option<f64> {
        if scenario.manoeuvres.is_empty() || scenario.manoeuvres.iter().any(is_endless) {
            return None;
        }
        let mut plan = AttitudeProfile::new(scenario).ok()?;
        while plan.next_segment().duration_s.is_finite() {
            plan.legs.clear();
        }
        Some(plan.end_s)
    }

    /// A rest of this length before the first manoeuvre.
    pub fn rest_before(&self, duration_s: f64) -> Segment {
        Segment { duration_s, theta: Quadratic::at(self.theta_rad), psi: Quadratic::at(self.psi_rad) }
    }

    /// The next segment; without end the last.
    pub fn next_segment(&mut self) -> Segment {
        loop {
            if let Some(segment) = self.segments.pop_front() {
                return segment;
            }
            self.lay_out().unwrap_or_else(|(field, reason)| unreachable!("tried when laid out: {field}: {reason}"));
        }
    }

    /// The legs laid out since the last call, in order: all that have begun, and perhaps one more.
    pub fn take_legs(&mut self) -> Vec<Leg> {
        std::mem::take(&mut self.legs)
    }

    /// Drops the legs that ended before `t_s`.
    pub fn forget_legs_before(&mut self, t_s: f64) {
        self.legs.retain(|leg| leg.end_s >= t_s);
    }

    fn lay_out(&mut self) -> Result<(), (&'static str, String)> {
        let (index, part) = self.next;
        self.next = (index + 1, 0);
        let Some(manoeuvre) = self.manoeuvres.get(index).cloned() else {
            self.rest("hold", f64::INFINITY);
            return Ok(());
        };
        let name = manoeuvre.kind();
        match manoeuvre {
            Manoeuvre::Pointing(Pointing { duration_s }) => {
                self.rest(name, duration_s);
                Ok(())
            }
            Manoeuvre::Stabilise(Stabilise { orbits, rate_arcmin_s, acceleration_arcsec_s2 }) => {
                self.turn(name, "orbits", [0.0, 360.0 * orbits], rate_arcmin_s, acceleration_arcsec_s2)
            }
            Manoeuvre::ZScan(scan) => {
                if (self.theta_deg() - 90.0).abs() > 1e-6 {
                    return Err((
                        "kind",
                        format!("expected theta at 90 deg before a z-scan, got {}", self.theta_deg()),
                    ));
                }
                self.turn(name, "angle_deg", [0.0, scan.angle_deg], scan.rate_arcmin_s, scan.acceleration_arcsec_s2)
            }
            Manoeuvre::XScan(scan) => {
                if (self.theta_deg() - 90.0).abs() < 1e-6 {
                    return Err((
                        "kind",
                        "expected theta away from 90 deg before an x-scan (60 deg is usual), got 90".to_owned(),
                    ));
                }
                self.turn(name, "angle_deg", [0.0, scan.angle_deg], scan.rate_arcmin_s, scan.acceleration_arcsec_s2)
            }
            Manoeuvre::YScan(YScan { to_theta_deg, rate_arcmin_s, acceleration_arcsec_s2 }) => {
                let by_deg = to_theta_deg - self.theta_deg();
                self.turn(name, "to_theta_deg", [by_deg, 0.0], rate_arcmin_s, acceleration_arcsec_s2)
            }
            Manoeuvre::Slew(slew) => {
                let theta_deg = if slew.to_theta_deg.is_nan() { 0.0 } else { slew.to_theta_deg - self.theta_deg() };
                let psi_deg = match (slew.to_psi_deg.is_nan(), slew.by_psi_deg.is_nan()) {
                    (false, false) => {
                        return Err(("by_psi_deg", "expected to_psi_deg or by_psi_deg, got both".to_owned()));
                    }
                    (true, true) => 0.0,
                    (true, false) => slew.by_psi_deg,
                    (false, true) => shorter_way_deg(slew.to_psi_deg - self.psi_rad / RAD_PER_DEG),
                };
                self.turn(name, "kind", [theta_deg, psi_deg], slew.rate_arcmin_s, slew.acceleration_arcsec_s2)
            }
            Manoeuvre::Survey(survey) => self.survey(index, part, &survey),
            Manoeuvre::Raster(raster) => self.raster(index, part, &raster),
            Manoeuvre::Eclipse(eclipse) => self.eclipse(name, &eclipse),
        }
    }

    /// Part 2n is a scan, part 2n + 1 the slew after it.
    fn survey(&mut self, index: usize, part: u64, survey: &Survey) -> Result<(), (&'static str, String)> {
        let within = survey.theta_least_deg - 1e-6..=survey.theta_greatest_deg + 1e-6;
        if !within.contains(&self.theta_deg()) {
            return Err((
                "theta_least_deg",
                format!(
                    "expected theta within the survey's {}…{} deg at its start, got {}; slew there first",
                    survey.theta_least_deg,
                    survey.theta_greatest_deg,
                    self.theta_deg()
                ),
            ));
        }
        if part == 0 && survey.theta_step_deg != 0.0 {
            // ψ' is largest, and its ramps longest, at the limit with the smaller sin θ.
            let sines = [survey.theta_least_deg, survey.theta_greatest_deg].map(|deg| libm::sin(deg * RAD_PER_DEG));
            let rate_arcsec_s = survey.rate_z_arcmin_s * 60.0 / sines[0].min(sines[1]);
            let ramps_deg = rate_arcsec_s * rate_arcsec_s / survey.acceleration_arcsec_s2 / ARCSEC_PER_DEG;
            if survey.angle_deg < ramps_deg {
                let reason = format!(
                    "expected scans of {ramps_deg:.6} deg or more, the ramps at the survey's limits of theta; got {}",
                    survey.angle_deg
                );
                return Err(("angle_deg", reason));
            }
        }
        let last = survey.scans != 0.0 && part + 2 >= 2 * survey.scans as u64;
        if !last {
            self.next = (index, part + 1);
        }
        if part.is_multiple_of(2) {
            let rate_arcmin_s = survey.rate_z_arcmin_s / libm::sin(self.theta_rad);
            return self.turn(
                "survey",
                "angle_deg",
                [0.0, survey.angle_deg],
                rate_arcmin_s,
                survey.acceleration_arcsec_s2,
            );
        }
        let mut step_deg = survey.theta_step_deg * self.theta_direction;
        if !within.contains(&(self.theta_deg() + step_deg)) {
            self.theta_direction = -self.theta_direction;
            step_deg = -step_deg;
        }
        if !within.contains(&(self.theta_deg() + step_deg)) {
            return Err((
                "theta_step_deg",
                format!(
                    "expected a step that stays within theta_least_deg…theta_greatest_deg one way or the other, got {}",
                    survey.theta_step_deg
                ),
            ));
        }
        if step_deg == 0.0 {
            return Ok(());
        }
        self.turn("slew", "theta_step_deg", [step_deg, 0.0], survey.slew_rate_arcmin_s, survey.acceleration_arcsec_s2)
    }

    /// Part 2n is a line, part 2n + 1 the step after it.
    fn raster(&mut self, index: usize, part: u64, raster: &Raster) -> Result<(), (&'static str, String)> {
        if part + 2 < 2 * raster.lines as u64 {
            self.next = (index, part + 1);
        }
        if part % 2 == 1 {
            if raster.theta_step_arcmin == 0.0 {
                return Ok(());
            }
            let by_deg = raster.theta_step_arcmin / 60.0;
            return self.turn(
                "raster",
                "theta_step_arcmin",
                [by_deg, 0.0],
                raster.step_rate_arcmin_s,
                raster.acceleration_arcsec_s2,
            );
        }
        let by_deg = if part.is_multiple_of(4) { raster.angle_deg } else { -raster.angle_deg };
        let rate_arcmin_s = raster.rate_z_arcmin_s / libm::sin(self.theta_rad);
        self.turn("raster", "angle_deg", [0.0, by_deg], rate_arcmin_s, raster.acceleration_arcsec_s2)
    }

    fn eclipse(&mut self, name: &'static str, eclipse: &Eclipse) -> Result<(), (&'static str, String)> {
        let Eclipse { duration_s, rate_z_arcmin_s, acceleration_arcsec_s2 } = *eclipse;
        if rate_z_arcmin_s == 0.0 {
            self.rest(name, duration_s);
        } else {
            // A turn at rest at both ends lasts one ramp longer than its angle takes at full rate.
            let rate_arcmin_s = rate_z_arcmin_s.abs() / libm::sin(self.theta_rad);
            let ramp_s = rate_arcmin_s * 60.0 / acceleration_arcsec_s2;
            if duration_s < 2.0 * ramp_s {
                let reason = format!("expected at least its two ramps, {:.6} s, got {duration_s}", 2.0 * ramp_s);
                return Err(("duration_s", reason));
            }
            let by_deg = (rate_arcmin_s / 60.0 * (duration_s - ramp_s)).copysign(rate_z_arcmin_s);
            self.turn(name, "duration_s", [0.0, by_deg], rate_arcmin_s, acceleration_arcsec_s2)?;
        }
        if let Some(leg) = self.legs.last_mut() {
            leg.eclipse = true;
        }
        Ok(())
    }

    fn theta_deg(&self) -> f64 {
        self.theta_rad / RAD_PER_DEG
    }

    fn rest(&mut self, name: &'static str, duration_s: f64) {
        self.push(Segment { duration_s, theta: Quadratic::at(self.theta_rad), psi: Quadratic::at(self.psi_rad) });
        let (start_s, start_rad) =
            (self.end_s - if duration_s.is_finite() { duration_s } else { 0.0 }, [self.theta_rad, self.psi_rad]);
        let end_s = if duration_s.is_finite() { self.end_s } else { f64::INFINITY };
        self.legs.push(Leg { name, start_s, end_s, start_rad, end_rad: start_rad, eclipse: false });
    }

    fn push(&mut self, segment: Segment) {
        if segment.duration_s.is_finite() {
            self.end_s += segment.duration_s;
            self.theta_rad = segment.theta.angle_rad(segment.duration_s);
            self.psi_rad = segment.psi.angle_rad(segment.duration_s);
        }
        self.segments.push_back(segment);
    }

    /// A turn of (θ, ψ) by `by_deg`: ramp up, cruise, ramp down; the longer of the two has the rate and acceleration.
    fn turn(
        &mut self,
        name: &'static str,
        field: &'static str,
        by_deg: [f64; 2],
        rate_arcmin_s: f64,
        acceleration_arcsec_s2: f64,
    ) -> Result<(), (&'static str, String)> {
        let longer_deg = by_deg[0].abs().max(by_deg[1].abs());
        let rate_arcsec_s = rate_arcmin_s * 60.0;
        let ramp_s = rate_arcsec_s / acceleration_arcsec_s2;
        let cruise_s = longer_deg * ARCSEC_PER_DEG / rate_arcsec_s - ramp_s;
        let theta_deg = self.theta_deg() + by_deg[0];
        let (min, max) = THETA_LIMITS_DEG;
        if theta_deg < min - 1e-9 || theta_deg > max + 1e-9 {
            return Err((field, format!("expected theta within {min}…{max} deg, got {theta_deg:.6}")));
        }
        // A turn of exactly its two ramps has no cruise; less is impossible.
        if longer_deg * ARCSEC_PER_DEG < 1e-9 || cruise_s < -1e-9 {
            return Err((
                field,
                format!(
                    "expected a turn of {:.6} deg or more, the ramps at {rate_arcmin_s:.4} arcmin/s and {acceleration_arcsec_s2} arcsec/s2; got {longer_deg:.6}",
                    (rate_arcsec_s * ramp_s / ARCSEC_PER_DEG).max(1e-12),
                ),
            ));
        }
        let target_rad = [self.theta_rad + by_deg[0] * RAD_PER_DEG, self.psi_rad + by_deg[1] * RAD_PER_DEG];
        let share = by_deg.map(|by| by / longer_deg);
        let (start_s, start_rad) = (self.end_s, [self.theta_rad, self.psi_rad]);
        let (mut rate, acceleration) = (0.0, acceleration_arcsec_s2 / ARCSEC_PER_RAD);
        for (duration_s, sign) in [(ramp_s, 1.0), (cruise_s.max(0.0), 0.0), (ramp_s, -1.0)] {
            let part = |start_rad: f64, share: f64| Quadratic {
                start_rad,
                rate_rad_s: rate * share,
                acceleration_rad_s2: acceleration * sign * share,
            };
            if duration_s > 0.0 {
                self.push(Segment {
                    duration_s,
                    theta: part(self.theta_rad, share[0]),
                    psi: part(self.psi_rad, share[1]),
                });
            }
            rate += acceleration * sign * duration_s;
        }
        // Land on the target itself, so that no rounding accumulates over a long survey.
        [self.theta_rad, self.psi_rad] = target_rad;
        self.legs.push(Leg { name, start_s, end_s: self.end_s, start_rad, end_rad: target_rad, eclipse: false });
        Ok(())
    }
}

fn is_endless(manoeuvre: &Manoeuvre) -> bool {
    matches!(manoeuvre, Manoeuvre::Survey(survey) if survey.scans == 0.0)
}

/// `deg` reduced to −180…180.
fn shorter_way_deg(deg: f64) -> f64 {
    deg - 360.0 * (deg / 360.0).round()
}

#[cfg(test)]
mod tests;
