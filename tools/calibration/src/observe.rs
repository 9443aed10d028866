//! Observations: the counts of a manoeuvre between two instants and its rotation, and the data that cannot be used.

use geu_model::package::Calibration;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::Gyro;
use geu_recording::ReferenceAttitude;

use crate::counts::{AccumulatedCounts, Discontinuity, Interpolation};
use crate::effects::EffectContribution;
use crate::noise::{ErrorSource, ErrorTerm, ROUNDING_VARIANCE};
use crate::solve::{Observation, own_axis};
use crate::window::ManoeuvreWindow;

/// A manoeuvre, or one gyro of it, that is not used.
#[derive(Debug, Clone, PartialEq)]
pub struct ExcludedData {
    pub name: String,
    /// Start on the time scale of the list, s.
    pub start_s: f64,
    /// The excluded gyro; `None` for the whole manoeuvre.
    pub gyro: Option<Gyro>,
    pub why: String,
}

impl std::fmt::Display for ExcludedData {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let gyro = self.gyro.map_or_else(String::new, |gyro| format!(", {}", gyro.name()));
        write!(f, "{} at {:.1} s{gyro}: {}", self.name, self.start_s, self.why)
    }
}

/// Counts without the contributions of configured effects.
#[derive(Debug, Clone, Copy)]
pub struct CompensatedCounts<'a> {
    pub counts: &'a AccumulatedCounts,
    pub effects: Option<&'a EffectContribution>,
}

impl CompensatedCounts<'_> {
    /// Counts of each gyro of the default unit up to a node.
    pub fn at_node(&self, node: usize) -> [f64; 4] {
        std::array::from_fn(|gyro| self.of_gyro(gyro, node))
    }

    /// Counts of a gyro up to a node.
    pub fn of_gyro(&self, gyro: usize, node: usize) -> f64 {
        self.counts.accumulated[gyro][node] - self.effects.map_or(0.0, |effects| effects.at_node(gyro, node))
    }

    /// Counts of a gyro between two instants.
    pub fn between(&self, gyro: usize, from: &Interpolation, to: &Interpolation) -> f64 {
        let counted = self.counts.count(gyro, to) - self.counts.count(gyro, from);
        counted - self.effects.map_or(0.0, |effects| effects.between(gyro, from, to))
    }

    /// Counts of each gyro between two instants, with their errors; the rotation is still to add. Gyros with broken counts
    /// are added to `left_out`.
    ///
    /// # Errors
    /// The reason, if one discontinuity breaks the counts of all gyros.
    pub(crate) fn observe(
        &self,
        window: &ManoeuvreWindow,
        [from, to]: [&Interpolation; 2],
        [start_s, end_s]: [f64; 2],
        left_out: &mut Vec<ExcludedData>,
    ) -> Result<Observation, String> {
        let AccumulatedCounts { gyros, interval_s, rounded_to, .. } = self.counts;
        let breaks: Vec<Option<&Discontinuity>> =
            (0..gyros.heads()).map(|gyro| self.counts.broken(gyro, from, to)).collect();
        if let Some(first) = breaks[0].filter(|&first| breaks.iter().all(|found| *found == Some(first))) {
            return Err(self.counts.describe(first));
        }
        let mut disturbances = Vec::new();
        let counts = gyros.gyros().map(|name| {
            let gyro = name.index();
            if let Some(broken) = breaks[gyro] {
                left_out.push(window.excluded(Some(name), self.counts.describe(broken)));
                return None;
            }
            for (end, sign) in [(to, 1.0), (from, -1.0)] {
                disturbances.extend(end.nodes().map(|(node, weight)| {
                    let variance = ROUNDING_VARIANCE * rounded_to[gyro].powi(2);
                    ErrorTerm::of_count(ErrorSource::Rounding { gyro, node }, variance, gyro, sign * weight)
                }));
            }
            disturbances.extend(self.effects.and_then(|effects| effects.disturbance(gyro, from, to)));
            Some(self.between(gyro, from, to))
        });
        Ok(Observation {
            name: window.name.clone(),
            start_s,
            end_s,
            samples: (to.samples - from.samples) * (interval_s / SAMPLE_INTERVAL_S),
            counts: counts.collect(),
            rotation_control_arcsec: [0.0; 3],
            timing_control_arcsec: Default::default(),
            disturbances,
        })
    }
}

/// Observes each of `windows`; windows that `observe` refuses are left out, with the reason.
pub(crate) fn observe_each(
    windows: &[ManoeuvreWindow],
    mut observe: impl FnMut(&ManoeuvreWindow, &mut Vec<ExcludedData>) -> Result<Observation, String>,
) -> (Vec<Observation>, Vec<ExcludedData>) {
    let (mut observations, mut left_out) = (Vec::new(), Vec::new());
    for window in windows {
        match observe(window, &mut left_out) {
            Ok(observation) => observations.push(observation),
            Err(why) => left_out.push(window.excluded(None, why)),
        }
    }
    (observations, left_out)
}

/// An instant in microseconds, which identifies an error source.
pub(crate) fn micros(t_s: f64) -> i64 {
    (t_s * 1e6).round() as i64
}

/// Extrapolation of a reference at its ends, s: the error of receive times.
const BEYOND_S: f64 = 0.05;

/// Half of the interval over which a rate of the reference is taken, s.
const RATE_S: f64 = 0.02;

/// Observations of `windows` with the rotations of a reference attitude, whose noise about each axis is `sigma_arcsec`.
/// Windows start and end at the nearest node, where counts need no interpolation.
pub fn with_reference(
    measured: &CompensatedCounts,
    windows: &[ManoeuvreWindow],
    reference: &ReferenceAttitude,
    sigma_arcsec: [f64; 3],
) -> (Vec<Observation>, Vec<ExcludedData>) {
    let (counts, truth) = (measured.counts, &reference.truth);
    let (start_s, offset_s, mut near) = (counts.start_s(), counts.offset_s(reference), 0);
    observe_each(windows, |window, left_out| {
        // A window without an end ends with the recording.
        let end_s = if window.end_s.is_finite() { window.end_s - start_s } else { counts.end_s() };
        let (Some(from), Some(to)) = (counts.nearest(window.start_s - start_s), counts.nearest(end_s)) else {
            return Err(outside([start_s, start_s + counts.end_s()], window));
        };
        if to <= from + 1 {
            return Err(TOO_SHORT.to_owned());
        }
        let ends_s = [from, to].map(|node| counts.node_s[node] + offset_s);
        let zero_s = reference.start_ns as f64 * 1e-9;
        if ends_s[0] < truth.start_s() - BEYOND_S {
            return Err(format!("the reference does not cover it: it begins at {:.1} s", zero_s + truth.start_s()));
        }
        if ends_s[1] > truth.end_s() + BEYOND_S {
            return Err(format!("the reference does not cover it: it ends at {:.1} s", zero_s + truth.end_s()));
        }
        if !ends_s.iter().all(|t_s| truth.is_known(*t_s)) {
            return Err("the reference has a gap at its start or end".to_owned());
        }
        let [before, after] = ends_s.map(|t_s| truth.at(t_s, &mut near).0);
        let nodes_s = [counts.node_s[from], counts.node_s[to]];
        let mut observation =
            measured.observe(window, [&counts.at_node(from), &counts.at_node(to)], nodes_s, left_out)?;
        observation.rotation_control_arcsec = std::array::from_fn(|axis| after[axis] - before[axis]);
        observation.timing_control_arcsec = timing(reference, [from, to].map(|node| counts.node_s[node]), offset_s);
        // The error of a row that ends in the window.
        let rows = truth.rows().map(|row| row.0).zip(&reference.turn_sigma_arcsec).enumerate();
        for (row, (_, sigmas)) in rows.filter(|(_, (t_s, _))| *t_s > ends_s[0] && *t_s <= ends_s[1]) {
            for (axis, sigma_arcsec) in sigmas.iter().enumerate().filter(|(_, sigma)| **sigma > 0.0) {
                let mut rotation = [0.0; 3];
                rotation[axis] = 1.0;
                let source = ErrorSource::Turn { axis, row };
                observation.disturbances.push(ErrorTerm::of_rotation(source, sigma_arcsec * sigma_arcsec, rotation));
            }
        }
        for (axis, sigma_arcsec) in sigma_arcsec.into_iter().enumerate().filter(|(_, sigma)| *sigma > 0.0) {
            for (node, sign) in [(from, -1.0), (to, 1.0)] {
                let mut rotation = [0.0; 3];
                rotation[axis] = sign;
                let source = ErrorSource::Reference { axis, node };
                observation.disturbances.push(ErrorTerm::of_rotation(source, sigma_arcsec * sigma_arcsec, rotation));
            }
        }
        Ok(observation)
    })
}

/// Change of the rotation between two instants with a time offset of the counts, arcsec/s, and with the frequency error of a clock that
/// starts with them, arcsec.
fn timing(reference: &ReferenceAttitude, ends_s: [f64; 2], offset_s: f64) -> [[f64; 3]; 2] {
    let (truth, mut near) = (&reference.truth, 0);
    let [first, last] = ends_s.map(|t_s| {
        let at_s = (t_s + offset_s).clamp(truth.start_s() + RATE_S, truth.end_s() - RATE_S);
        let [before, after] = [-RATE_S, RATE_S].map(|by_s| truth.at(at_s + by_s, &mut near).0);
        std::array::from_fn::<f64, 3, _>(|axis| (after[axis] - before[axis]) / (2.0 * RATE_S))
    });
    let between = |[from, to]: [f64; 2]| std::array::from_fn(|axis| to * last[axis] - from * first[axis]);
    [between([1.0; 2]), between(ends_s)]
}

pub(crate) const TOO_SHORT: &str = "it is shorter than two samples";

/// The reason to exclude a window that lies outside the recording.
pub(crate) fn outside([start_s, end_s]: [f64; 2], window: &ManoeuvreWindow) -> String {
    if window.start_s < start_s - 0.5 * SAMPLE_INTERVAL_S {
        return format!("the recording does not cover it: it begins at {start_s:.1} s");
    }
    format!("the recording does not cover it: it ends at {end_s:.1} s, and the manoeuvre at {:.1} s", window.end_s)
}

/// Mean square of a normal deviate without the largest hundredth of its squares.
const TRIMMED: f64 = 0.9247;

/// Mean without the largest hundredth, since gaps and jumps are no noise; `None` for fewer than 100 squares.
fn trimmed_mean(squares: &mut [f64]) -> Option<f64> {
    let kept = squares.len() * 99 / 100;
    if squares.len() < 100 {
        return None;
    }
    squares.select_nth_unstable_by(kept, f64::total_cmp);
    Some(squares[..kept].iter().sum::<f64>() / kept as f64)
}

/// Variance of differences of a noise, from their squares; `None` for fewer than 100.
pub(crate) fn variance(squares: &mut [f64]) -> Option<f64> {
    Some(trimmed_mean(squares)? / TRIMMED)
}

/// Estimates the white noise of a reference about each control axis, arcsec, from its second differences against the
/// counts, in which motion, drift and scale factors cancel. Noise below 0.2″ over the rounding counts as 0. `None` if they have too little
/// in common.
pub fn reference_sigma_arcsec(
    counts: &AccumulatedCounts,
    reference: &ReferenceAttitude,
    calibrations: &[Calibration],
) -> Option<[f64; 3]> {
    let (truth, offset_s) = (&reference.truth, counts.offset_s(reference));
    let mut sigmas = [0.0; 3];
    for gyro in [Gyro::X, Gyro::Y, Gyro::ZA] {
        let (axis, mut near) = (own_axis(gyro), 0);
        let inside = |t_s: f64| t_s >= truth.start_s() && t_s <= truth.end_s() && truth.is_known(t_s);
        let difference: Vec<Option<f64>> = (0..counts.node_s.len())
            .map(|node| {
                let t_s = counts.node_s[node] + offset_s;
                let counted = counts.accumulated[gyro.index()][node] * calibrations[gyro.index()].scale_factor;
                inside(t_s).then(|| counted - truth.at(t_s, &mut near).0[axis])
            })
            .collect();
        let mut squares: Vec<f64> =
            difference.windows(3).filter_map(|of| Some((of[0]? - 2.0 * of[1]? + of[2]?).powi(2))).collect();
        let variance = trimmed_mean(&mut squares)? / (6.0 * TRIMMED) - ROUNDING_VARIANCE;
        sigmas[axis] = if variance > 0.04 { variance.sqrt() } else { 0.0 };
    }
    Some(sigmas)
}
