//! The paper's first-order method (Casteren §6, eq 4): products of small terms dropped, one gyro's scale factor and drift from
//! the manoeuvres that hardly turn and those about its own axis, then each misalignment from the manoeuvres about that axis.
//!
//! The paper asks whether this is accurate enough; the answer is its difference from the full solution.

use geu_model::package::Calibration;
use geu_model::units::{ARCSEC_PER_DEG, ARCSEC_PER_RAD};
use geu_protocol::Gyro;
use nalgebra::{DMatrix, DVector};

use crate::solve::{Observation, off_axes, own_axis};

/// A manoeuvre that turns less than this about every axis is a pointing: with misalignments of an arcminute what eq 4
/// drops is below a tenth of an arcsecond.
const POINTING_ARCSEC: f64 = 0.1 * ARCSEC_PER_DEG;
/// A manoeuvre whose rotation about X has this share of its largest rotation is the X-scan: it turns about X by cot 60° =
/// 0.577 of the rotation about Z (Casteren §5.4).
const X_SHARE: f64 = 0.5;

/// The axis that a manoeuvre determines; `None` for a pointing.
fn axis_served(observation: &Observation) -> Option<usize> {
    let turned = observation.rotation_control_arcsec.map(f64::abs);
    let largest = (0..3).max_by(|&a, &b| turned[a].total_cmp(&turned[b]))?;
    match turned[largest] {
        angle if angle < POINTING_ARCSEC => None,
        angle if turned[0] >= X_SHARE * angle => Some(0),
        _ => Some(largest),
    }
}

/// Solves one gyro after the other.
///
/// # Errors
/// The missing kind of manoeuvre.
pub fn solve(observations: &[Observation], prior: &[Calibration]) -> Result<[Calibration; 4], String> {
    let mut calibrations = std::array::from_fn(|gyro| prior[gyro]);
    for gyro in Gyro::ALL {
        solve_gyro(gyro, observations, &mut calibrations[gyro.index()])?;
    }
    Ok(calibrations)
}

fn solve_gyro(gyro: Gyro, observations: &[Observation], calibration: &mut Calibration) -> Result<(), String> {
    let own = own_axis(gyro);
    let usable: Vec<(&Observation, f64)> =
        observations.iter().filter_map(|observation| Some((observation, observation.counts[gyro.index()]?))).collect();
    let serving = |axis: Option<usize>| usable.iter().filter(move |(found, _)| axis_served(found) == axis);
    let missing = |what: &str| Err(format!("{}: no {what}", gyro.name()));
    if serving(Some(own)).next().is_none() {
        return missing("manoeuvre about its own axis");
    }
    if serving(None).next().is_none() {
        return missing("pointing");
    }
    let first: Vec<_> = serving(None).chain(serving(Some(own))).collect();
    // Equation 4: N·SF + n·D = Δφ, the same for every manoeuvre.
    let design =
        DMatrix::from_fn(first.len(), 2, |row, column| if column == 0 { first[row].1 } else { first[row].0.samples });
    let right = DVector::from_fn(first.len(), |row, _| first[row].0.rotation_control_arcsec[own]);
    let solved = design.svd(true, true).solve(&right, 0.0).map_err(|reason| format!("{}: {reason}", gyro.name()))?;
    (calibration.scale_factor, calibration.drift_arcsec_per_half_s) = (solved[0], solved[1]);
    // The remaining equations (3) give a misalignment each, X last, since its scan turns about Z too.
    let off = off_axes(gyro);
    let mut known_rad = [0.0; 3];
    for axis in [2, 1, 0].into_iter().filter(|axis| off.contains(axis)) {
        let mut sums = (0.0, 0.0);
        for (observation, counts) in serving(Some(axis)) {
            let turned = observation.rotation_control_arcsec;
            let explained: f64 = turned.iter().zip(known_rad).map(|(angle, part)| angle * part).sum();
            let left = counts * solved[0] + observation.samples * solved[1] - turned[own] - explained;
            sums.0 += left * turned[axis];
            sums.1 += turned[axis] * turned[axis];
        }
        if sums.1 == 0.0 {
            return missing(&format!("manoeuvre about {}", ["X", "Y", "Z"][axis]));
        }
        known_rad[axis] = sums.0 / sums.1;
        let Calibration { x_arcsec, y_arcsec, z_arcsec, .. } = calibration;
        *[x_arcsec, y_arcsec, z_arcsec][axis] = known_rad[axis] * ARCSEC_PER_RAD;
    }
    Ok(())
}
