//! Filter of one channel's residual.
//!
//! States: angle, drift, relative scale about each control axis, width of the pivot clearance, lag. A residual is known to be within
//! half a count of the accumulated count; the posterior is taken as normal, with the score of that interval in place of the innovation.

use geu_calibration::noise::RandomWalks;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::Gyro;
use nalgebra::{SMatrix, SVector};

use crate::interval::Likelihood;

pub const STATES: usize = 7;
/// States that may change: all but the lag.
pub const CHANGES: usize = 6;
pub const ANGLE: usize = 0;
pub const DRIFT: usize = 1;
pub const SCALE: usize = 2;
pub const PIVOT: usize = 5;
const LAG: usize = 6;

/// Deviations of changes: any jump, what the model allows of drift and clearance, and of scale and misalignment a launch's: a float
/// within its stops looks like a misalignment of a hundredth.
const CHANGE: [f64; CHANGES] = [1e4, 10.0, 2e-3, 2e-3, 2e-3, 100.0];
/// Deviations of the states at the start: far beyond the errors of a calibration, so that only changes are reported.
const START: [f64; STATES] = [10.0, 0.05, 2e-3, 2e-3, 2e-3, 5.0, 0.05];
/// Growth of the lag's deviation over a sample, s: clocks drift by some ppm.
const LAG_WALK_S: f64 = 1e-6;
/// Deviation of a clearance that was estimated by its signature, as a share of it.
const NONLINEAR: f64 = 0.3;
/// Sigmas beyond which a clearance is certain.
const CERTAIN: f64 = 3.0;
/// Deviation of the angle at its first sample: the residual is within a count of it.
const FIRST: f64 = 1.0;

/// Clearances that signatures of the pivots are made with: a signature holds for clearances within a factor of about two.
pub const CLEARANCES_ARCSEC: [f64; CLEARANCES] = [1.0, 3.0, 9.0];
pub const CLEARANCES: usize = 3;

/// One sample of a channel, in counts.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    /// Accumulated measurement minus model; `None` if there is none.
    pub residual: Option<f64>,
    /// Samples since the step before.
    pub samples: f64,
    /// True if counts were lost since the step before.
    pub is_new: bool,
    /// Rotation about the control axes since the step before, by the reference and by the counts.
    pub turned: [f64; 3],
    pub counted: [f64; 3],
    /// Change of the accumulated counts per arcsec of pivot clearance, by each of [`CLEARANCES_ARCSEC`].
    pub pivot: [f64; CLEARANCES],
    /// Rate about the input axis, counts/s.
    pub rate: f64,
}

impl Step {
    /// The step with nothing but its residual from a noisy reference, of which errors would look like a signature. A pivot clearance has
    /// none then.
    #[must_use]
    pub fn of_noisy_reference(self) -> Step {
        Step { turned: self.counted, pivot: [0.0; CLEARANCES], rate: 0.0, ..self }
    }
}

/// Noise of a channel.
#[derive(Debug, Clone, Copy)]
pub struct Noise {
    pub walks: RandomWalks,
    /// Variance of a residual beyond rounding and walks: errors of the reference.
    pub white: f64,
    /// Half the interval within which rounding leaves the residual.
    pub half: f64,
}

#[derive(Debug, Clone)]
pub struct Filter {
    pub noise: Noise,
    /// Index of the clearance of which it takes the signature.
    clearance: usize,
    /// Error of that signature, arcsec, and the signature of the step before.
    misfit_arcsec: f64,
    pivot: [f64; CLEARANCES],
    state: SVector<f64, STATES>,
    covariance: SMatrix<f64, STATES, STATES>,
    /// Logarithm of the likelihood of all residuals.
    pub log_likelihood: f64,
}

/// The change of the filter by a step, which carries an error of the states to the next step.
#[derive(Debug, Clone, Copy)]
pub struct Update {
    pub score: f64,
    pub information: f64,
    /// States to residual.
    pub observed: SVector<f64, STATES>,
    /// Covariance of states and residual.
    pub seen: SVector<f64, STATES>,
}

impl Filter {
    pub fn new(noise: Noise) -> Filter {
        let covariance = SMatrix::from_diagonal(&SVector::from(START.map(|sigma| sigma * sigma)));
        Filter {
            noise,
            clearance: 0,
            misfit_arcsec: 0.0,
            pivot: [0.0; CLEARANCES],
            state: SVector::zeros(),
            covariance,
            log_likelihood: 0.0,
        }
    }

    /// Adds a step. `None` without a residual.
    pub fn push(&mut self, step: &Step) -> Option<Update> {
        self.advance(step);
        let residual = step.residual?;
        let pivot = step.pivot[self.clearance];
        if step.is_new {
            self.covariance.row_mut(ANGLE).fill(0.0);
            self.covariance.column_mut(ANGLE).fill(0.0);
            self.covariance[(ANGLE, ANGLE)] = FIRST * FIRST;
            self.state[ANGLE] = residual - pivot * self.state[PIVOT] - step.rate * self.state[LAG];
        }
        let mut observed = SVector::<f64, STATES>::zeros();
        (observed[ANGLE], observed[PIVOT], observed[LAG]) = (1.0, pivot, step.rate);
        let seen = self.covariance.column(ANGLE)
            + self.covariance.column(PIVOT) * pivot
            + self.covariance.column(LAG) * step.rate;
        let variance = observed.dot(&seen) + self.noise.white;
        let mean = observed.dot(&self.state);
        let Likelihood { log, score, information } = Likelihood::new(residual, self.noise.half, mean, variance);
        self.log_likelihood += log;
        if information > 0.0 {
            self.state += seen * score;
            self.covariance -= seen * seen.transpose() * information;
        }
        Some(Update { score, information, observed, seen })
    }

    /// Proceeds to the time of the step.
    fn advance(&mut self, step: &Step) {
        let time_s = step.samples * SAMPLE_INTERVAL_S;
        let coefficients = carried(step);
        for (from, coefficient) in coefficients {
            self.state[ANGLE] += coefficient * self.state[from];
        }
        let mut row = self.covariance.row(ANGLE).into_owned();
        for (from, coefficient) in coefficients {
            row += self.covariance.row(from) * coefficient;
        }
        let own = row[ANGLE] + coefficients.iter().map(|&(from, coefficient)| coefficient * row[from]).sum::<f64>();
        let walks = &self.noise.walks;
        let (angle, drift) = (walks.angle_arcsec_per_sqrt_s.powi(2), walks.drift_arcsec_per_s_per_sqrt_s.powi(2));
        row[ANGLE] = own + angle * time_s + drift * time_s.powi(3) / 3.0;
        row[DRIFT] += drift * time_s.powi(2) / 2.0;
        self.covariance.set_row(ANGLE, &row);
        self.covariance.set_column(ANGLE, &row.transpose());
        self.covariance[(DRIFT, DRIFT)] += drift * time_s;
        // Where floats move, one with another clearance or place moves otherwise.
        let moved = |index: usize| (step.pivot[index] - self.pivot[index]).abs() * CLEARANCES_ARCSEC[index];
        let moved_arcsec = (0..CLEARANCES).map(moved).sum::<f64>();
        self.covariance[(ANGLE, ANGLE)] += NONLINEAR * self.misfit_arcsec * moved_arcsec;
        self.pivot = step.pivot;
        self.covariance[(LAG, LAG)] += LAG_WALK_S.powi(2) * step.samples;
    }

    /// Lets a state change: its deviation grows to that of a change.
    pub fn release(&mut self, state: usize) {
        self.covariance[(state, state)] += CHANGE[state].powi(2);
    }

    /// Lets the pivot clearance change to about this one, and the float be anywhere in it.
    pub fn release_clearance(&mut self, index: usize) {
        for state in [ANGLE, PIVOT] {
            self.covariance[(state, state)] += CLEARANCES_ARCSEC[index].powi(2);
        }
        (self.clearance, self.misfit_arcsec) = (index, misfit_arcsec(CLEARANCES_ARCSEC[index]));
    }

    /// The pivot clearance that the model lacks, if that is certain.
    pub fn missing_clearance(&self) -> Option<f64> {
        let clearance = self.state[PIVOT];
        (clearance * clearance > CERTAIN * CERTAIN * self.covariance[(PIVOT, PIVOT)]).then_some(clearance)
    }

    /// Hands a pivot clearance over to the model, which has it from this step on: what is left is the place of the float, and what the
    /// estimate erred because signatures of clearances are not proportional to them.
    pub fn hand_over(&mut self, clearance: f64, step: &Step) {
        self.state[PIVOT] -= clearance;
        self.state[ANGLE] += step.pivot[self.clearance] * clearance;
        self.covariance[(ANGLE, ANGLE)] += (0.5 * clearance).powi(2);
        self.covariance[(PIVOT, PIVOT)] += (NONLINEAR * clearance).powi(2);
        (self.clearance, self.misfit_arcsec) = (0, misfit_arcsec(clearance.abs()));
    }
}

/// Error of the signature of a clearance; that of the narrowest one is small.
fn misfit_arcsec(clearance: f64) -> f64 {
    if clearance > CLEARANCES_ARCSEC[0] { NONLINEAR * clearance } else { 0.0 }
}

/// By how much each state turns the angle over a step.
pub fn carried(step: &Step) -> [(usize, f64); 4] {
    let [x, y, z] = step.turned;
    [(DRIFT, step.samples * SAMPLE_INTERVAL_S), (SCALE, x), (SCALE + 1, y), (SCALE + 2, z)]
}

/// The random walks of the difference of GYRZA and GYRZB.
pub fn walks_of_pair(walks: &[RandomWalks; 4]) -> RandomWalks {
    let [a, b] = [Gyro::ZA, Gyro::ZB].map(|gyro| walks[gyro.index()]);
    RandomWalks {
        angle_arcsec_per_sqrt_s: a.angle_arcsec_per_sqrt_s.hypot(b.angle_arcsec_per_sqrt_s),
        drift_arcsec_per_s_per_sqrt_s: a.drift_arcsec_per_s_per_sqrt_s.hypot(b.drift_arcsec_per_s_per_sqrt_s),
        correlation_time_s: a.correlation_time_s,
    }
}
