//! The filter forward and the smoother backward over the nodes.

use geu_model::package::Calibration;
use geu_model::units::{ARCSEC_PER_RAD, RAD_PER_DEG, SAMPLE_INTERVAL_S, SUN_RATE_RAD_S};
use nalgebra::{Matrix3, Matrix3x4, Matrix4, UnitQuaternion, Vector3};

use super::covariance::{
    ATTITUDE, Adjoint, Covariance, DRIFT, GYROS, Gain, MISALIGNMENT, SCALE_FACTOR, SYSTEMATIC, Step, THERMAL, Vector,
};
use super::{AttitudeFix, FilterNoise, FixMeasurement, Innovation, NodeEstimates, StateEstimate};
use crate::counts::AccumulatedCounts;
use crate::transfer::{GyroSet, Transfer};

/// The axes about which the gyros in use are misaligned: the two that are not their own.
const OFF_AXIS: [[usize; 2]; GYROS] = [[1, 2], [0, 2], [0, 1]];
/// An attitude less certain than this is lost: the next fix of the whole attitude starts it anew. A degree, at which the
/// square of the error, 63″, is no longer small.
const LOST_ARCSEC: f64 = 3600.0;
/// Samples between checkpoints, from which the smoother makes the nodes again: 3 MB at a time, where the nodes of a day take 550 MB.
const CHECKPOINT: usize = 1024;

/// The nominal values whose errors are estimated.
#[derive(Debug, Clone, Copy)]
pub(super) struct State {
    /// Package frame to inertial.
    package: UnitQuaternion<f64>,
    pub calibrations: [Calibration; 4],
    /// The star sensor's systematic errors.
    systematic_arcsec: [f64; 2],
    pub thermal_arcsec_per_deg: f64,
}

impl State {
    /// With an error, as the filter or smoother finds it, put in.
    fn corrected(&self, error: &Vector, gyros: [usize; GYROS]) -> State {
        let mut state = *self;
        let turn = Vector3::new(error[0], error[1], error[2]) / ARCSEC_PER_RAD;
        state.package = UnitQuaternion::from_scaled_axis(turn) * state.package;
        for (slot, gyro) in gyros.into_iter().enumerate() {
            let own = &mut state.calibrations[gyro];
            own.drift_arcsec_per_half_s += error[DRIFT + slot];
            own.scale_factor += error[SCALE_FACTOR + slot] * 1e-6;
            let off_axis = [&mut own.x_arcsec, &mut own.y_arcsec, &mut own.z_arcsec];
            for (index, axis) in OFF_AXIS[slot].into_iter().enumerate() {
                *off_axis[axis] += error[MISALIGNMENT + 2 * slot + index];
            }
        }
        for (own, error) in state.systematic_arcsec.iter_mut().zip(&error.as_slice()[SYSTEMATIC..]) {
            *own += error;
        }
        state.thermal_arcsec_per_deg += error[THERMAL];
        state
    }

    /// Turn of the package about Y out of the control frame.
    fn turn(&self, lagged_deg: f64) -> UnitQuaternion<f64> {
        let turn_rad = self.thermal_arcsec_per_deg * lagged_deg / ARCSEC_PER_RAD;
        UnitQuaternion::from_scaled_axis(Vector3::y() * turn_rad)
    }

    /// Control frame to inertial.
    fn control(&self, lagged_deg: f64) -> UnitQuaternion<f64> {
        self.package * self.turn(lagged_deg).inverse()
    }
}

/// The nominal motion at a node.
#[derive(Debug, Clone, Copy)]
struct Nominal {
    state: State,
    /// θ − 90°, lagged.
    lagged_deg: f64,
    /// Turn over the sample before.
    turn_before_rad: Vector3<f64>,
}

/// The filter at a node, after its fixes.
#[derive(Debug, Clone, Copy)]
struct Node {
    nominal: Nominal,
    covariance: Covariance,
}

/// A change of the estimate at a node.
enum Event {
    Restart,
    Update(Box<Gain>),
}

pub(super) struct Filter<'a> {
    counts: &'a AccumulatedCounts,
    lost: Vec<[u32; 4]>,
    noise: &'a FilterNoise,
    in_use: GyroSet,
    /// The gyros in use, a slot each, in the order of their axes.
    gyros: [usize; GYROS],
    /// Equation 3 with the present state put in.
    transfer: Transfer,
    /// M⁻¹ of the calibration given: rotations about the input axes in use to those about the control axes.
    inverse: Matrix3<f64>,
    /// Share of the lag that is left after a sample.
    lag_decay: f64,
    /// The node that is reached.
    now: Node,
    checkpoints: Vec<(usize, Node)>,
    events: Vec<(usize, Event)>,
    innovations: Vec<Innovation>,
}

impl<'a> Filter<'a> {
    /// The filter at node 0; `None` without a fix of the whole attitude.
    pub fn start(
        counts: &'a AccumulatedCounts,
        lost: Vec<[u32; 4]>,
        calibrations: &[Calibration; 4],
        (in_use, gyros): (GyroSet, [usize; GYROS]),
        noise: &'a FilterNoise,
        fixes: &[(usize, &AttitudeFix)],
    ) -> Option<Filter<'a>> {
        let transfer = Transfer::new(calibrations, in_use);
        let mut state = State {
            package: UnitQuaternion::identity(),
            calibrations: *calibrations,
            systematic_arcsec: [0.0; 2],
            thermal_arcsec_per_deg: 0.0,
        };
        let (node, attitude) = fixes.iter().find_map(|(node, fix)| match fix.seen {
            FixMeasurement::Attitude(attitude) => Some((*node, attitude)),
            FixMeasurement::Direction { .. } => None,
        })?;
        let mut filter = Filter {
            counts,
            lost,
            noise,
            in_use,
            gyros,
            inverse: Matrix3::from_columns(&gyros.map(|gyro| transfer.inverse.column(gyro))),
            transfer,
            lag_decay: libm::exp(-SAMPLE_INTERVAL_S / noise.thermal_time_constant_s),
            now: Node {
                nominal: Nominal { state, lagged_deg: 0.0, turn_before_rad: Vector3::zeros() },
                covariance: Covariance::start(noise, &attitude),
            },
            checkpoints: Vec::new(),
            events: Vec::new(),
            innovations: Vec::new(),
        };
        (0..node).for_each(|sample| filter.turn(sample));
        state.package = attitude * filter.now.nominal.state.package.inverse();
        filter.now.nominal = Nominal { state, lagged_deg: 0.0, turn_before_rad: Vector3::zeros() };
        filter.now.nominal.lagged_deg = filter.above_90_deg(0);
        Some(filter)
    }

    fn increments(&self, sample: usize) -> [f64; 4] {
        std::array::from_fn(|gyro| self.counts.accumulated[gyro][sample + 1] - self.counts.accumulated[gyro][sample])
    }

    /// Rotation about the package's axes over counts and samples (eq 3).
    fn turned_arcsec(&self, counts: [f64; 4], samples: f64) -> Vector3<f64> {
        self.transfer.about_control_arcsec(counts, samples).into()
    }

    /// Turns the nominal attitude over a sample interval. Increments are integrals of rates about axes that turn meanwhile:
    /// the first term that does not commute is a twelfth of the cross product with the increment before (Miller 1983).
    fn turn(&mut self, sample: usize) {
        let turn = self.turned_arcsec(self.increments(sample), 1.0) / ARCSEC_PER_RAD;
        let Nominal { state, turn_before_rad, .. } = &mut self.now.nominal;
        let whole = turn + turn_before_rad.cross(&turn) / 12.0;
        state.package *= UnitQuaternion::from_scaled_axis(whole);
        *turn_before_rad = turn;
    }

    /// θ − 90° of the nominal attitude at a node, to within what the turn itself is.
    fn above_90_deg(&self, node: usize) -> f64 {
        let boresight = self.now.nominal.state.package * Vector3::x();
        let (sin, cos) = libm::sincos(SUN_RATE_RAD_S * self.counts.node_s[node]);
        -libm::asin((boresight.x * cos + boresight.y * sin).clamp(-1.0, 1.0)) / RAD_PER_DEG
    }

    pub fn forward(&mut self, fixes: &[(usize, &AttitudeFix)]) {
        let mut fixes = fixes.iter().peekable();
        for node in 0..=self.counts.len() {
            let mut is_updated = false;
            while let Some((_, fix)) = fixes.next_if(|(own, _)| *own == node) {
                self.update(node, fix);
                is_updated = true;
            }
            if is_updated || node % CHECKPOINT == 0 {
                self.checkpoints.push((node, self.now));
            }
            if node < self.counts.len() {
                let step = self.step(node);
                self.advance(node, &step);
            }
        }
    }

    /// Goes to the next node, before its fixes.
    fn advance(&mut self, node: usize, step: &Step) {
        self.now.covariance.advance(step);
        let from_deg = self.above_90_deg(node);
        self.turn(node);
        let to_deg = self.above_90_deg(node + 1);
        let lagged_deg = &mut self.now.nominal.lagged_deg;
        *lagged_deg = 0.5 * (from_deg + to_deg) * (1.0 - self.lag_decay) + *lagged_deg * self.lag_decay;
    }

    /// Propagation of errors over the sample interval that begins.
    fn step(&self, sample: usize) -> Step {
        let rotation = self.now.nominal.state.package.to_rotation_matrix();
        let to_inertial = rotation.matrix() * self.inverse;
        let increments = self.increments(sample);
        let counts = self.gyros.map(|gyro| increments[gyro]);
        // A count is an arcsecond about the own axis but for 0.2 % (Casteren §3.2), of 3″ of misalignment.
        let off_axis_rad = OFF_AXIS.map(|axes| axes.map(|axis| counts[axis] / ARCSEC_PER_RAD));
        let mut step = Step::new(&to_inertial, counts, off_axis_rad, self.noise);
        let sigma_arcsec = self.noise.lost_rate_arcsec_s * SAMPLE_INTERVAL_S;
        for (slot, gyro) in self.gyros.into_iter().enumerate() {
            let on_end = self.lost.get(sample).map_or(0, |lost| lost[gyro]);
            if on_end > 0 {
                // One rate is wrong throughout, so the angle grows with time and its variance with the square.
                let variance = sigma_arcsec.powi(2) * f64::from(2 * on_end - 1);
                step.lose(&to_inertial.column(slot).into_owned(), variance);
            }
        }
        step
    }

    fn update(&mut self, node: usize, fix: &AttitudeFix) {
        if let FixMeasurement::Attitude(attitude) = fix.seen
            && self.now.covariance.attitude().diagonal().max().sqrt() > LOST_ARCSEC
        {
            // The attitude at the node for which the prediction of the fix is what it saw.
            let turn_since = self.turn_since(node, fix.t_s);
            self.now.nominal.state.package =
                attitude * self.now.nominal.state.turn(self.now.nominal.lagged_deg) * turn_since.inverse();
            self.now.covariance.restart(self.noise, &attitude);
            self.events.push((node, Event::Restart));
        }
        let turn = self.now.nominal.state.turn(self.now.nominal.lagged_deg);
        let package = self.now.nominal.state.package * self.turn_since(node, fix.t_s);
        let control = package * turn.inverse();
        let seen = fix.residual_control_arcsec(&control);
        let mut error = Vector::zeros();
        for (component, axis_of_fix) in fix.axes.iter().enumerate() {
            let direction = control * axis_of_fix.direction_control;
            let mut row = Vector::zeros();
            row.fixed_rows_mut::<3>(ATTITUDE).copy_from(&direction);
            for (index, part) in axis_of_fix.systematic.into_iter().enumerate() {
                row[SYSTEMATIC + index] = part;
            }
            row[THERMAL] = -self.now.nominal.lagged_deg * axis_of_fix.direction_control.y;
            let expected: f64 = axis_of_fix
                .systematic
                .iter()
                .zip(self.now.nominal.state.systematic_arcsec)
                .map(|(part, error)| part * error)
                .sum();
            let residual = axis_of_fix.direction_control.dot(&seen) - expected - row.dot(&error);
            let variance =
                axis_of_fix.sigma_arcsec.powi(2) + self.noise.bounded_variance_arcsec2() * direction.norm_squared();
            let gain = self.now.covariance.update(row, residual, variance);
            error += gain.gain * residual;
            let normalised = residual / gain.variance.sqrt();
            self.innovations.push(Innovation { component, normalised });
            self.events.push((node, Event::Update(Box::new(gain))));
        }
        self.now.nominal.state = self.now.nominal.state.corrected(&error, self.gyros);
        self.transfer = Transfer::new(&self.now.nominal.state.calibrations, self.in_use);
    }

    /// The turn from a node to an instant near it, from counts interpolated between samples (Casteren §6).
    fn turn_since(&self, node: usize, t_s: f64) -> UnitQuaternion<f64> {
        let Some(reading) = self.counts.at(t_s) else { return UnitQuaternion::identity() };
        let counts =
            std::array::from_fn(|gyro| self.counts.count(gyro, &reading) - self.counts.accumulated[gyro][node]);
        let turned = self.turned_arcsec(counts, reading.samples - node as f64);
        UnitQuaternion::from_scaled_axis(turned / ARCSEC_PER_RAD)
    }

    /// `errors`: covariance of the attitude and of the thermal turn, in inertial axes; `variances` of drifts and scale
    /// factors in use.
    fn estimate(
        &self,
        state: &State,
        lagged_deg: f64,
        (errors, variances): (Matrix4<f64>, [f64; 2 * GYROS]),
    ) -> StateEstimate {
        let mut drift_sigma_arcsec_per_half_s = [self.noise.start_drift_arcsec_per_half_s(); 4];
        let mut scale_factor_sigma = [self.noise.start_scale_factor_ppm * 1e-6; 4];
        for (slot, gyro) in self.gyros.into_iter().enumerate() {
            drift_sigma_arcsec_per_half_s[gyro] = variances[slot].max(0.0).sqrt();
            scale_factor_sigma[gyro] = variances[GYROS + slot].max(0.0).sqrt() * 1e-6;
        }
        let attitude = state.control(lagged_deg);
        let rotation = attitude.to_rotation_matrix();
        // Control error = attitude error less the turn that is not known, about Y.
        let mut map = Matrix3x4::zeros();
        map.fixed_columns_mut::<3>(0).copy_from(&rotation.matrix().transpose());
        map[(1, 3)] = -lagged_deg;
        let bounded = Matrix3::from_diagonal_element(self.noise.bounded_variance_arcsec2());
        StateEstimate {
            attitude,
            covariance_control_arcsec2: map * errors * map.transpose() + bounded,
            drift_arcsec_per_half_s: state.calibrations.map(|own| own.drift_arcsec_per_half_s),
            drift_sigma_arcsec_per_half_s,
            scale_factor: state.calibrations.map(|own| own.scale_factor),
            scale_factor_sigma,
        }
    }

    /// Smooths from the last node to the first, and passes the estimates of each to `visit`; returns the innovations.
    pub fn backward(mut self, mut visit: impl FnMut(usize, &NodeEstimates)) -> Vec<Innovation> {
        let mut adjoint = Adjoint::zero();
        let events = std::mem::take(&mut self.events);
        let mut events = events.iter().rev().peekable();
        let mut last = self.counts.len();
        let mut nodes = Vec::with_capacity(CHECKPOINT);
        while let Some((first, checkpoint)) = self.checkpoints.pop() {
            // The nodes of this interval once more, and the steps between them.
            nodes.clear();
            self.now = checkpoint;
            self.transfer = Transfer::new(&checkpoint.nominal.state.calibrations, self.in_use);
            for node in first..=last {
                let step = (node < self.counts.len()).then(|| self.step(node));
                nodes.push((self.now, step));
                if let Some(step) = step.filter(|_| node < last) {
                    self.advance(node, &step);
                }
            }
            for (node, (own, step)) in (first..last + 1).zip(&nodes).rev() {
                if let Some(step) = step {
                    adjoint.pass_back(step);
                }
                let (Nominal { state, lagged_deg, .. }, covariance) = (&own.nominal, &own.covariance);
                let corrected = state.corrected(&adjoint.correction(covariance), self.gyros);
                visit(
                    node,
                    &NodeEstimates {
                        filtered: self.estimate(state, *lagged_deg, covariance.reported()),
                        smoothed: self.estimate(&corrected, *lagged_deg, adjoint.smoothed(covariance)),
                    },
                );
                while let Some((_, event)) = events.next_if(|(own, _)| *own == node) {
                    match event {
                        Event::Restart => adjoint.forget_attitude(),
                        Event::Update(gain) => adjoint.undo(gain),
                    }
                }
            }
            last = first.saturating_sub(1);
        }
        self.innovations
    }
}
