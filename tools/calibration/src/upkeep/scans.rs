//! The stretches that tell scale factor and drift of the Z gyros: at a steady rate about Z, with θ held.

use geu_model::package::Calibration;
use geu_protocol::Gyro;

use crate::calibrate::AttitudeSource;
use crate::counts::AccumulatedCounts;
use crate::observe::ExcludedData;
use crate::transfer::{GyroSet, Transfer};
use crate::window::{LONGEST_SAMPLE_INTERVALS, ManoeuvreWindow, REST_ARCSEC_S, smoothed_rate_control_arcsec_s};

use super::SURVEY_ARCSEC_S;

/// Faster ones, such as slews, would bring the non-linearity in, 0.02 % over the whole range (Casteren §3.2, §5).
pub const MOST_ARCSEC_S: f64 = 1.25 * SURVEY_ARCSEC_S;
/// Shorter stretches are not used: over 120 s of a survey the two roundings are 15 ppm, less than the short-term change allowed.
pub const SHORTEST_S: f64 = 120.0;
/// How far a steady rate departs from its mean.
pub const STEADY_ARCSEC_S: f64 = 2.0;
/// Share of a leg that has to be steady; what is left are its ramps.
const STEADY_SHARE: f64 = 0.8;
/// Ramps make steady stretches of a second or two, which nobody would look for.
const MENTIONED_SAMPLE_INTERVALS: usize = 40;

/// A stretch at a steady rate about Z with θ held: its nodes and its rate.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Steady {
    from: usize,
    to: usize,
    rate_z_arcsec_s: f64,
}

/// The steady stretches of a recording, as its counts tell them.
fn steady(counts: &AccumulatedCounts, calibrations: &[Calibration; 4]) -> Vec<Steady> {
    // Of the Z gyros that which is broken less.
    let broken = |gyro: Gyro| {
        let own = counts.breaks.iter().filter(|found| found.gyros[gyro as usize]);
        own.map(|found| found.to - found.from).sum::<usize>()
    };
    let (in_use, z) = match broken(Gyro::Za) <= broken(Gyro::Zb) {
        true => (GyroSet::WithZa, Gyro::Za),
        false => (GyroSet::WithZb, Gyro::Zb),
    };
    let transfer = Transfer::new(calibrations, in_use);
    let mut is_broken = vec![false; counts.len()];
    for found in counts.breaks.iter().filter(|found| found.gyros[z as usize] || found.gyros[Gyro::Y as usize]) {
        is_broken[found.from..found.to.min(counts.len())].fill(true);
    }
    let mut stretches: Vec<Steady> = Vec::new();
    // The stretch that runs: first node, sum and number of its rates.
    let mut running: Option<(usize, f64, f64)> = None;
    for node in 0..=counts.len() {
        let [_, about_y, rate] = smoothed_rate_control_arcsec_s(counts, &transfer, node);
        let is_whole = node == 0 || !is_broken[node - 1];
        match &mut running {
            Some((_, sum, number))
                if is_whole && about_y.abs() < REST_ARCSEC_S && (rate - *sum / *number).abs() < STEADY_ARCSEC_S =>
            {
                *sum += rate;
                *number += 1.0;
            }
            _ => {
                stretches.extend(running.map(|(from, sum, number)| Steady {
                    from,
                    to: node - 1,
                    rate_z_arcsec_s: sum / number,
                }));
                running = (about_y.abs() < REST_ARCSEC_S).then_some((node, rate, 1.0));
            }
        }
    }
    stretches.extend(running.map(|(from, sum, number)| Steady {
        from,
        to: counts.len(),
        rate_z_arcsec_s: sum / number,
    }));
    stretches.retain(|stretch| stretch.to - stretch.from >= MENTIONED_SAMPLE_INTERVALS);
    stretches
}

/// Why a stretch is not used, if it is not.
fn unsuitable(length_s: f64, rate_z_arcsec_s: f64) -> Option<String> {
    if length_s < SHORTEST_S {
        Some(format!("shorter than {SHORTEST_S:.0} s"))
    } else if rate_z_arcsec_s.abs() > MOST_ARCSEC_S {
        Some(format!(
            "turns about Z faster than {MOST_ARCSEC_S:.0} arcsec/s, where the transfer function is another line"
        ))
    } else {
        None
    }
}

/// The stretches to use: the steady ones of the recording, cut to half an hour; or the legs of a list, or what lies between
/// fixes, as far as they are steady.
pub(super) fn chosen(
    counts: &AccumulatedCounts,
    calibrations: &[Calibration; 4],
    legs: Option<&[ManoeuvreWindow]>,
    attitude: &AttitudeSource,
    left_out: &mut Vec<ExcludedData>,
) -> Vec<ManoeuvreWindow> {
    let zero_s = counts.start_ns as f64 * 1e-9;
    let steady = steady(counts, calibrations);
    let mut leave = |name: &str, start_s: f64, why: String| {
        left_out.push(ExcludedData { name: name.to_owned(), start_s, gyro: None, why });
    };
    let fixes: Vec<ManoeuvreWindow>;
    let legs = match (legs, attitude) {
        (Some(legs), _) => legs,
        (None, AttitudeSource::Sensors(sensors)) => {
            let pairs = sensors.fixes.windows(2).map(|pair| [pair[0].t_ns as f64 * 1e-9, pair[1].t_ns as f64 * 1e-9]);
            fixes =
                pairs.map(|[start_s, end_s]| ManoeuvreWindow { name: "fixes".to_owned(), start_s, end_s }).collect();
            &fixes
        }
        (None, AttitudeSource::Reference(..)) => {
            let mut windows = Vec::new();
            for stretch in steady {
                let start_s = zero_s + counts.node_s[stretch.from];
                let length_s = counts.node_s[stretch.to] - counts.node_s[stretch.from];
                if let Some(why) = unsuitable(length_s, stretch.rate_z_arcsec_s) {
                    leave("stretch", start_s, why);
                    continue;
                }
                let parts = (stretch.to - stretch.from).div_ceil(LONGEST_SAMPLE_INTERVALS);
                let node = |part: usize| stretch.from + (stretch.to - stretch.from) * part / parts;
                windows.extend((0..parts).map(|part| ManoeuvreWindow {
                    name: "stretch".to_owned(),
                    start_s: zero_s + counts.node_s[node(part)],
                    end_s: zero_s + counts.node_s[node(part + 1)],
                }));
            }
            return windows;
        }
    };
    let mut windows = Vec::new();
    for leg in legs {
        // A leg without an end ends with the recording.
        let leg = ManoeuvreWindow { end_s: leg.end_s.min(zero_s + counts.end_s()), ..leg.clone() };
        let (from_s, to_s) = (leg.start_s - zero_s, leg.end_s - zero_s);
        if !["survey", "pointing", "hold", "fixes"].contains(&leg.name.as_str()) {
            leave(&leg.name, leg.start_s, "neither a survey nor a rest (pointing, hold)".to_owned());
            continue;
        }
        let overlap_s =
            |stretch: &Steady| counts.node_s[stretch.to].min(to_s) - counts.node_s[stretch.from].max(from_s);
        let longest = steady.iter().max_by(|a, b| overlap_s(a).total_cmp(&overlap_s(b)));
        let why = match longest {
            _ if to_s - from_s < SHORTEST_S => unsuitable(to_s - from_s, 0.0),
            Some(longest) if overlap_s(longest) >= STEADY_SHARE * (to_s - from_s) => {
                unsuitable(to_s - from_s, longest.rate_z_arcsec_s)
            }
            _ => Some("the rate about Z is not steady, or θ is not held, or counts are missing".to_owned()),
        };
        match why {
            Some(why) => leave(&leg.name, leg.start_s, why),
            None => windows.push(leg),
        }
    }
    windows
}
