//! From a recording to the equations of its manoeuvres: counts between two instants, and what may not be used and why.

use geu_model::attitude::RecordedAttitude;
use geu_model::package::Calibration;
use geu_protocol::Gyro;

use crate::counts::{AccumulatedCounts, Discontinuity, Interpolation};
use crate::noise::{ErrorSource, ErrorTerm, ROUNDING_VARIANCE};
use crate::solve::{Observation, own_axis};
use crate::window::ManoeuvreWindow;

/// A manoeuvre, or one gyro of it, that is not used.
#[derive(Debug, Clone, PartialEq)]
pub struct ExcludedData {
    pub name: String,
    /// Start on the time scale of the list, s.
    pub start_s: f64,
    /// The gyro, where only that one is left out.
    pub gyro: Option<Gyro>,
    pub why: String,
}

impl std::fmt::Display for ExcludedData {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let gyro = self.gyro.map_or_else(String::new, |gyro| format!(", {}", gyro.name()));
        write!(f, "{} at {:.1} s{gyro}: {}", self.name, self.start_s, self.why)
    }
}

/// Counts with everything that configured effects add taken off.
#[derive(Debug, Clone, Copy)]
pub struct CompensatedCounts<'a> {
    pub counts: &'a AccumulatedCounts,
    /// What effects of the configuration added up to each node, counts.
    pub effects: Option<&'a crate::effects::EffectContribution>,
}

impl CompensatedCounts<'_> {
    /// What each gyro counted up to a node, without the effects.
    pub fn at_node(&self, node: usize) -> [f64; 4] {
        let added = self.effects.map_or([0.0; 4], |effects| effects.at_node(node));
        std::array::from_fn(|gyro| self.counts.accumulated[gyro][node] - added[gyro])
    }

    /// What a gyro counted over a stretch, without the effects.
    pub fn between(&self, gyro: usize, from: &Interpolation, to: &Interpolation) -> f64 {
        let counted = self.counts.count(gyro, to) - self.counts.count(gyro, from);
        counted - self.effects.map_or(0.0, |effects| effects.between(gyro, from, to))
    }

    /// Counts of each gyro over a window, and their disturbances; what is broken is added to `left_out`. Nothing where no gyro
    /// has counts that can be trusted.
    pub(crate) fn observe(
        &self,
        window: &ManoeuvreWindow,
        from: &Interpolation,
        to: &Interpolation,
        left_out: &mut Vec<ExcludedData>,
    ) -> Option<([Option<f64>; 4], Vec<ErrorTerm>)> {
        let mut disturbances = Vec::new();
        let leave = |gyro: Option<Gyro>, broken: &Discontinuity| {
            let at_s = self.counts.start_ns as f64 * 1e-9 + self.counts.node_s[broken.from];
            let why = format!("{} at {at_s:.1} s", broken.kind);
            ExcludedData { name: window.name.clone(), start_s: window.start_s, gyro, why }
        };
        let breaks: [Option<&Discontinuity>; 4] = std::array::from_fn(|gyro| self.counts.broken(gyro, from, to));
        if let [Some(first), Some(_), Some(_), Some(_)] = breaks
            && breaks.iter().all(|found| *found == Some(first))
        {
            left_out.push(leave(None, first));
            return None;
        }
        let counts = std::array::from_fn(|gyro| {
            if let Some(broken) = breaks[gyro] {
                left_out.push(leave(Some(Gyro::ALL[gyro]), broken));
                return None;
            }
            for (reading, sign) in [(to, 1.0), (from, -1.0)] {
                for (index, weight) in reading.weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
                    let mut part = [0.0; 4];
                    part[gyro] = sign * weight;
                    disturbances.push(ErrorTerm {
                        source: ErrorSource::Rounding { gyro, node: reading.first + index },
                        variance: ROUNDING_VARIANCE,
                        counts: part,
                        rotation_control_arcsec: [0.0; 3],
                    });
                }
            }
            if let Some(effects) = self.effects {
                disturbances.extend(effects.disturbance(gyro, from, to));
            }
            Some(self.between(gyro, from, to))
        });
        Some((counts, disturbances))
    }
}

/// A microsecond of an instant, by which sources are told apart.
pub(crate) fn micros(t_s: f64) -> i64 {
    (t_s * 1e6).round() as i64
}

/// A reference attitude on the time scale of the counts.
#[derive(Debug, Clone, Copy)]
pub struct ReferenceSeries<'a> {
    pub truth: &'a RecordedAttitude,
    /// Its time 0, ns on the time scale of the capture.
    pub start_ns: i64,
    /// Its noise about each axis, 1 sigma.
    pub sigma_arcsec: [f64; 3],
}

/// How far beyond its ends a reference is believed: what receive times can be off.
const BEYOND_S: f64 = 0.05;

/// The equations of `windows`, with the rotations of a reference attitude. Windows begin and end at the nearest half
/// second, where counts need no interpolation.
pub fn with_reference(
    measured: &CompensatedCounts,
    windows: &[ManoeuvreWindow],
    known: &ReferenceSeries,
) -> (Vec<Observation>, Vec<ExcludedData>) {
    let counts = measured.counts;
    let (mut observations, mut left_out) = (Vec::new(), Vec::new());
    let ReferenceSeries { truth, start_ns, sigma_arcsec } = *known;
    let reference_s = (counts.start_ns - start_ns) as f64 * 1e-9;
    let start_s = counts.start_ns as f64 * 1e-9;
    let mut near = 0;
    for window in windows {
        let mut leave = |why: String| {
            left_out.push(ExcludedData { name: window.name.clone(), start_s: window.start_s, gyro: None, why });
        };
        // A window without an end ends with the recording.
        let end_s = if window.end_s.is_finite() { window.end_s - start_s } else { counts.end_s() };
        let (Some(from), Some(to)) = (counts.nearest(window.start_s - start_s), counts.nearest(end_s)) else {
            leave(outside(counts, window));
            continue;
        };
        if to <= from + 1 {
            leave("it is shorter than two samples".to_owned());
            continue;
        }
        let ends_s = [from, to].map(|node| counts.node_s[node] + reference_s);
        if ends_s[0] < truth.start_s() - BEYOND_S || ends_s[1] > truth.end_s() + BEYOND_S {
            let zero_s = start_ns as f64 * 1e-9;
            let told = format!("{:.1}…{:.1} s", zero_s + truth.start_s(), zero_s + truth.end_s());
            leave(format!("the reference does not cover it: it tells {told}"));
            continue;
        }
        let [before, after] = ends_s.map(|t_s| truth.at(t_s, &mut near).0);
        let (from, to) = (counts.at_node(from), counts.at_node(to));
        let Some((own, mut disturbances)) = measured.observe(window, &from, &to, &mut left_out) else { continue };
        for (axis, sigma_arcsec) in sigma_arcsec.into_iter().enumerate().filter(|(_, sigma)| *sigma > 0.0) {
            for (t_s, sign) in ends_s.into_iter().zip([-1.0, 1.0]) {
                let mut part = [0.0; 3];
                part[axis] = sign;
                disturbances.push(ErrorTerm {
                    source: ErrorSource::Reference { axis, at_us: micros(t_s) },
                    variance: sigma_arcsec * sigma_arcsec,
                    counts: [0.0; 4],
                    rotation_control_arcsec: part,
                });
            }
        }
        observations.push(Observation {
            name: window.name.clone(),
            start_s: counts.node_s[from.samples as usize],
            end_s: counts.node_s[to.samples as usize],
            samples: to.samples - from.samples,
            counts: own,
            rotation_control_arcsec: std::array::from_fn(|axis| after[axis] - before[axis]),
            disturbances,
        });
    }
    (observations, left_out)
}

pub(crate) fn outside(counts: &AccumulatedCounts, window: &ManoeuvreWindow) -> String {
    let start_s = counts.start_ns as f64 * 1e-9;
    format!(
        "the recording does not cover it: it holds {start_s:.1}…{:.1} s, and it lasts until {:.1} s",
        start_s + counts.end_s(),
        window.end_s
    )
}

/// Mean square of a normal deviate without the largest hundredth of its squares.
const TRIMMED: f64 = 0.9247;

/// White noise of a reference about each control axis, arcsec, from its second differences against the counts, in which
/// motion, drift and scale factors have no part. What does not stand out of the rounding by a fifth of an arcsecond is
/// none.
pub fn reference_sigma_arcsec(
    counts: &AccumulatedCounts,
    truth: &RecordedAttitude,
    start_ns: i64,
    calibrations: &[Calibration; 4],
) -> [f64; 3] {
    let offset_s = (counts.start_ns - start_ns) as f64 * 1e-9;
    let mut sigmas = [0.0; 3];
    for gyro in [Gyro::X, Gyro::Y, Gyro::Za] {
        let (axis, mut near) = (own_axis(gyro), 0);
        let inside = |t_s: f64| t_s >= truth.start_s() && t_s <= truth.end_s();
        let difference: Vec<Option<f64>> = (0..counts.node_s.len())
            .map(|node| {
                let t_s = counts.node_s[node] + offset_s;
                let counted = counts.accumulated[gyro as usize][node] * calibrations[gyro as usize].scale_factor;
                inside(t_s).then(|| counted - truth.at(t_s, &mut near).0[axis])
            })
            .collect();
        let mut squares: Vec<f64> =
            difference.windows(3).filter_map(|of| Some((of[0]? - 2.0 * of[1]? + of[2]?).powi(2))).collect();
        if squares.len() < 100 {
            continue;
        }
        // Without the largest hundredth: gaps and jumps are no noise.
        let kept = squares.len() * 99 / 100;
        squares.select_nth_unstable_by(kept, f64::total_cmp);
        let variance = squares[..kept].iter().sum::<f64>() / kept as f64 / (6.0 * TRIMMED) - ROUNDING_VARIANCE;
        sigmas[axis] = if variance > 0.04 { variance.sqrt() } else { 0.0 };
    }
    sigmas
}
