//! The motion segments that determine scale factor and drift of the Z gyros: at a steady rate about Z, with θ held.

use geu_model::package::Calibration;
use geu_protocol::Gyro;

use crate::calibrate::AttitudeSource;
use crate::counts::AccumulatedCounts;
use crate::observe::ExcludedData;
use crate::transfer::{GyroSet, Transfer};
use crate::window::{LONGEST_SAMPLE_INTERVALS, ManoeuvreWindow, REST_ARCSEC_S, smoothed_rate_control_arcsec_s};

use super::SURVEY_ARCSEC_S;

/// Faster segments, such as slews, would bring the non-linearity in, 0.02 % over the whole range (Casteren §3.2, §5).
pub const MAX_SCAN_ARCSEC_S: f64 = 1.25 * SURVEY_ARCSEC_S;
/// Shorter segments are not used: over 120 s of a survey the two roundings are 15 ppm, less than the short-term change allowed.
pub const SHORTEST_S: f64 = 120.0;
/// Maximum departure of a steady rate from its mean.
pub const STEADY_WITHIN_ARCSEC_S: f64 = 2.0;
/// Share of a leg that has to be steady; the rest are its ramps.
const STEADY_SHARE: f64 = 0.8;
/// Shorter steady segments, as in ramps, are ignored.
const MIN_SAMPLE_INTERVALS: usize = 40;

/// A motion segment at a steady rate about Z with θ held: its nodes and its rate.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SteadySegment {
    from: usize,
    to: usize,
    rate_z_arcsec_s: f64,
}

/// Finds the steady segments of a recording by its counts.
fn steady_segments(counts: &AccumulatedCounts, calibrations: &[Calibration]) -> Vec<SteadySegment> {
    // By the Z gyro with fewer broken samples.
    let broken = |gyro: Gyro| {
        let own = counts.breaks.iter().filter(|found| found.gyros[gyro.index()]);
        own.map(|found| found.to - found.from).sum::<usize>()
    };
    let (in_use, z) = match broken(Gyro::ZA) <= broken(Gyro::ZB) {
        true => (GyroSet::WithZa, Gyro::ZA),
        false => (GyroSet::WithZb, Gyro::ZB),
    };
    let transfer = Transfer::new(calibrations, in_use);
    let mut is_broken = vec![false; counts.len()];
    for found in counts.breaks.iter().filter(|found| found.gyros[z.index()] || found.gyros[Gyro::Y.index()]) {
        is_broken[found.from..found.to.min(counts.len())].fill(true);
    }
    let mut segments: Vec<SteadySegment> = Vec::new();
    // The current segment: first node, sum and number of its rates.
    let mut current: Option<(usize, f64, f64)> = None;
    let mut end = |current: Option<(usize, f64, f64)>, to: usize| {
        let segment = current.map(|(from, sum, number)| SteadySegment { from, to, rate_z_arcsec_s: sum / number });
        segments.extend(segment.filter(|segment| segment.to - segment.from >= MIN_SAMPLE_INTERVALS));
    };
    for node in 0..=counts.len() {
        let [_, about_y, rate] = smoothed_rate_control_arcsec_s(counts, &transfer, node);
        let (is_whole, is_held) = (node == 0 || !is_broken[node - 1], about_y.abs() < REST_ARCSEC_S);
        current = match current {
            Some((from, sum, number))
                if is_whole && is_held && (rate - sum / number).abs() < STEADY_WITHIN_ARCSEC_S =>
            {
                Some((from, sum + rate, number + 1.0))
            }
            _ => {
                end(current, node.saturating_sub(1));
                is_held.then_some((node, rate, 1.0))
            }
        };
    }
    end(current, counts.len());
    segments
}

/// Why a segment is not used, if it is not.
fn unsuitable(length_s: f64, rate_z_arcsec_s: f64) -> Option<String> {
    if length_s < SHORTEST_S {
        Some(format!("shorter than {SHORTEST_S:.0} s"))
    } else if rate_z_arcsec_s.abs() > MAX_SCAN_ARCSEC_S {
        Some(format!(
            "turns about Z faster than {MAX_SCAN_ARCSEC_S:.0} arcsec/s, where the transfer function is another line"
        ))
    } else {
        None
    }
}

/// Selects the segments to use: the steady ones of the recording, cut to half an hour; or the legs of a list, or the
/// intervals between fixes, as far as they are steady.
pub(super) fn select_segments(
    counts: &AccumulatedCounts,
    calibrations: &[Calibration],
    legs: Option<&[ManoeuvreWindow]>,
    attitude: &AttitudeSource,
    left_out: &mut Vec<ExcludedData>,
) -> Vec<ManoeuvreWindow> {
    let steady = steady_segments(counts, calibrations);
    let node_s = |node: usize| counts.start_s() + counts.node_s[node];
    let mut windows = Vec::new();
    let mut use_or_exclude = |window: ManoeuvreWindow, why: Option<String>, parts: Vec<ManoeuvreWindow>| match why {
        Some(why) => left_out.push(window.excluded(None, why)),
        None => windows.extend(parts),
    };
    let fixes: Vec<ManoeuvreWindow>;
    let legs = match (legs, attitude) {
        (Some(legs), _) => legs,
        (None, AttitudeSource::Sensors(sensors)) => {
            let between = sensors.between_fixes();
            fixes = between.map(|[start_s, end_s]| ManoeuvreWindow::new("fixes", start_s, end_s)).collect();
            &fixes
        }
        (None, AttitudeSource::Reference(..)) => {
            for SteadySegment { from, to, rate_z_arcsec_s } in steady {
                let why = unsuitable(counts.node_s[to] - counts.node_s[from], rate_z_arcsec_s);
                let parts = (to - from).div_ceil(LONGEST_SAMPLE_INTERVALS);
                let start_s = |part: usize| node_s(from + (to - from) * part / parts);
                let parts = (0..parts).map(|part| ManoeuvreWindow::new("stretch", start_s(part), start_s(part + 1)));
                use_or_exclude(ManoeuvreWindow::new("stretch", node_s(from), node_s(to)), why, parts.collect());
            }
            return windows;
        }
    };
    for leg in legs {
        // A leg without an end ends with the recording.
        let leg = ManoeuvreWindow { end_s: leg.end_s.min(counts.start_s() + counts.end_s()), ..leg.clone() };
        let (from_s, to_s) = (leg.start_s - counts.start_s(), leg.end_s - counts.start_s());
        let overlap_s =
            |segment: &SteadySegment| counts.node_s[segment.to].min(to_s) - counts.node_s[segment.from].max(from_s);
        let longest = steady.iter().max_by(|a, b| overlap_s(a).total_cmp(&overlap_s(b)));
        let why = match longest {
            _ if !["survey", "pointing", "hold", "fixes"].contains(&leg.name.as_str()) => {
                Some("neither a survey nor a rest (pointing, hold)".to_owned())
            }
            _ if to_s - from_s < SHORTEST_S => unsuitable(to_s - from_s, 0.0),
            Some(longest) if overlap_s(longest) >= STEADY_SHARE * (to_s - from_s) => {
                unsuitable(to_s - from_s, longest.rate_z_arcsec_s)
            }
            _ => Some("the rate about Z is not steady, or θ is not held, or counts are missing".to_owned()),
        };
        use_or_exclude(leg.clone(), why, vec![leg]);
    }
    windows
}
