//! The path of the attitude from the gyros through every fix.

use geu_model::units::RAD_PER_DEG;

use super::data::{AbsoluteData, StarFix};
use crate::counts::{AccumulatedCounts, Interpolation};
use crate::observe::CompensatedCounts;
use crate::sun::{Point, follow};
use crate::transfer::Transfer;

/// A fix on the path: its time since the start of the counts, its reading of them, its attitude.
#[derive(Debug, Clone)]
pub(super) struct Station<'a> {
    pub point: Point,
    pub reading: Interpolation,
    pub fix: &'a StarFix,
}

/// The attitude at each node, from the gyros and through every fix.
#[derive(Debug, Clone, Default)]
pub struct GyroPath {
    /// θ and ψ at each node, through every fix.
    pub points: Vec<Point>,
    /// θ and ψ at each node from the gyros alone, through the first fix.
    pub unbent: Vec<Point>,
    /// Inertial rotation about the control axes by the gyros, accumulated to each node, arcsec.
    pub turned_control_arcsec: Vec<[f64; 3]>,
}

/// Lays the gyros' path through the fixes. `transfer` may be rough: its errors are bent away between fixes.
pub fn path(measured: &CompensatedCounts, sensors: &AbsoluteData, transfer: &Transfer) -> Option<GyroPath> {
    let counts = measured.counts;
    let stations = stations(counts, sensors);
    let first = stations.first()?;
    let turned = turned(measured, transfer);
    let nodes = counts.node_s.len();
    let mut points = vec![first.point; nodes];
    // Forwards from the first fix and backwards from it.
    let anchor = (first.reading.samples.round() as usize).min(nodes - 1);
    points[anchor] = Point { t_s: counts.node_s[anchor], ..first.point };
    let step = |from: &Point, node_from: usize, node_to: usize| {
        let about = |axis: usize| turned[node_to][axis] - turned[node_from][axis];
        follow(from, counts.node_s[node_to], about(1), about(2))
    };
    for node in anchor + 1..nodes {
        points[node] = step(&points[node - 1], node - 1, node);
    }
    for node in (0..anchor).rev() {
        points[node] = step(&points[node + 1], node + 1, node);
    }
    let unbent = points.clone();
    // Bend it through the fixes: the difference at each, straight lines between, held before the first and after the last.
    let mut bends: Vec<(f64, [f64; 2])> = Vec::new();
    for station in &stations {
        let at = interpolate(&points, &station.reading);
        let turn = std::f64::consts::TAU;
        // Gyros never miscount a turn, so ψ is taken to the nearest turn, after the bend up to here.
        let so_far = bends.last().map_or([0.0; 2], |last| last.1);
        let mut psi = station.point.psi_rad - at.psi_rad - so_far[1];
        psi -= (psi / turn).round() * turn;
        bends.push((station.reading.samples, [station.point.theta_rad - at.theta_rad, psi + so_far[1]]));
    }
    for (node, point) in points.iter_mut().enumerate() {
        let [theta, psi] = bend(&bends, node as f64);
        point.theta_rad += theta;
        point.psi_rad += psi;
    }
    Some(GyroPath { points, unbent, turned_control_arcsec: turned })
}

pub(super) fn bend(bends: &[(f64, [f64; 2])], x: f64) -> [f64; 2] {
    let after = bends.partition_point(|bend| bend.0 < x);
    match (after.checked_sub(1).map(|before| &bends[before]), bends.get(after)) {
        (Some((x0, from)), Some((x1, to))) if x1 > x0 => {
            let share = (x - x0) / (x1 - x0);
            [0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * share)
        }
        (_, Some(only)) | (Some(only), None) => only.1,
        (None, None) => [0.0; 2],
    }
}

/// Rotation about the control axes at each node by eq 3, without the effects.
pub(super) fn turned(measured: &CompensatedCounts, transfer: &Transfer) -> Vec<[f64; 3]> {
    let at = |node: usize| transfer.about_control_arcsec(measured.at_node(node), node as f64);
    (0..measured.counts.node_s.len()).map(at).collect()
}

pub(super) fn interpolate(points: &[Point], reading: &Interpolation) -> Point {
    let nodes = &points[reading.first..];
    let sum = |of: fn(&Point) -> f64| reading.weights.iter().zip(nodes).map(|(weight, point)| weight * of(point)).sum();
    Point { t_s: sum(|point| point.t_s), theta_rad: sum(|point| point.theta_rad), psi_rad: sum(|point| point.psi_rad) }
}

pub(super) fn stations<'a>(counts: &AccumulatedCounts, sensors: &'a AbsoluteData) -> Vec<Station<'a>> {
    sensors
        .fixes
        .iter()
        .filter_map(|fix| {
            let t_s = (fix.t_ns - counts.start_ns) as f64 * 1e-9;
            let [theta_deg, psi_deg] = mean(&fix.slits.iter().map(|slit| slit.1).collect::<Vec<_>>());
            let point = Point { t_s, theta_rad: theta_deg * RAD_PER_DEG, psi_rad: psi_deg * RAD_PER_DEG };
            // A fix at the very ends of the recording is taken at the first or last node.
            let reading = counts
                .at_rest(t_s.clamp(0.0, counts.end_s()))
                .filter(|_| t_s > -0.26 && t_s < counts.end_s() + 0.26)?;
            Some(Station { point, reading, fix })
        })
        .collect()
}

/// Mean of θ and ψ in degrees; ψ about the first, so that 359.9 and 0.1 are neighbours.
pub(super) fn mean(slits: &[[f64; 2]]) -> [f64; 2] {
    let Some(first) = slits.first() else { return [f64::NAN; 2] };
    let count = slits.len() as f64;
    let near = |psi: f64| psi - first[1] - ((psi - first[1]) / 360.0).round() * 360.0;
    [
        slits.iter().map(|slit| slit[0]).sum::<f64>() / count,
        first[1] + slits.iter().map(|slit| near(slit[1])).sum::<f64>() / count,
    ]
}
