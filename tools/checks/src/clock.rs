//! Receive times compared with the unit's clock: time jumps, outliers, wrong spacing, clock frequency.

use geu_model::Configuration;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::continuity::SequenceStep;
use geu_protocol::field::unit_flag;
use geu_recording::{ClockFit, ReceivedSample};

use super::findings::{FindingCollector, FindingKind};
use super::timeline::SampleTimes;

const TIME_JUMP: FindingKind =
    FindingKind { name: "time-jump", what: "jumps of the receive time against the unit's clock", unit: "s" };
const BACKWARDS: FindingKind =
    FindingKind { name: "time-backwards", what: "receive times before the one before", unit: "s" };
const INTERVAL: FindingKind =
    FindingKind { name: "interval", what: "samples received off their place by more than 0.1 s", unit: "s" };
/// Smallest deviation of an outlier or a time jump.
const MIN_DEVIATION_S: f64 = 0.1;
/// Relative error of a wrong median spacing; a clock is within a tenth of it.
const SPACING_ERROR: f64 = 0.01;
/// Smallest significant difference of the clock frequency.
const SIGNIFICANT_SIGMA: f64 = 5.0;
const SIGNIFICANT_PPM: f64 = 0.05;
/// Maximum number of rows over which the configured frequency is averaged.
const MAX_AVERAGED: usize = 1000;

/// Checks the receive times, if available.
pub fn check(
    rows: &[ReceivedSample],
    timeline: &SampleTimes,
    configuration: &Configuration,
    findings: &mut FindingCollector,
) {
    let is_polled = |row: usize| rows[row].sample.unit_flags & const { unit_flag("polled") } != 0;
    // Stamps at the unit's cadence.
    let stamps: Vec<(usize, f64)> = (0..rows.len())
        .filter(|&row| timeline.steps[row] != SequenceStep::Repeat && !is_polled(row))
        .filter_map(|row| Some((row, timeline.stamp_s[row]?)))
        .collect();
    for pair in stamps.windows(2).filter(|pair| pair[1].1 < pair[0].1) {
        findings.note(BACKWARDS, None, pair[1].0, 1, pair[1].1 - pair[0].1);
    }
    if let Some(spacing_s) = wrong_spacing_s(&stamps, timeline) {
        findings.whole("interval", None, format!("samples are received every {spacing_s:.4} s, not every 0.5 s"));
        return;
    }
    let rate = rate(rows, &stamps, timeline, findings);
    let configured_ppm = configured_ppm(rows, timeline, configuration);
    if let Some((ppm, sigma_ppm)) = rate
        && (ppm - configured_ppm).abs() > (SIGNIFICANT_SIGMA * sigma_ppm).max(SIGNIFICANT_PPM)
    {
        findings.whole(
            "clock-frequency",
            None,
            format!(
                "by receive times the unit's clock is fast by {ppm:.4} ± {sigma_ppm:.4} ppm; the configuration has \
                 {configured_ppm:.4} ppm"
            ),
        );
    }
}

/// The median spacing of consecutive samples, if it is wrong.
fn wrong_spacing_s(stamps: &[(usize, f64)], timeline: &SampleTimes) -> Option<f64> {
    let following = stamps.windows(2).filter(|pair| timeline.steps[pair[1].0] == SequenceStep::Next);
    let mut spacings: Vec<f64> = following.map(|pair| pair[1].1 - pair[0].1).collect();
    if spacings.len() < 10 {
        return None;
    }
    let middle = spacings.len() / 2;
    let spacing_s = *spacings.select_nth_unstable_by(middle, f64::total_cmp).1;
    ((spacing_s / SAMPLE_INTERVAL_S - 1.0).abs() > SPACING_ERROR).then_some(spacing_s)
}

/// Notes outliers and time jumps, and fits the clock between jumps: ppm and sigma.
fn rate(
    rows: &[ReceivedSample],
    stamps: &[(usize, f64)],
    timeline: &SampleTimes,
    findings: &mut FindingCollector,
) -> Option<(f64, f64)> {
    let deviation_s = |at: usize| stamps[at].1 - timeline.samples[stamps[at].0] * SAMPLE_INTERVAL_S;
    let mut fits = vec![ClockFit::default()];
    let mut usual_s: Option<f64> = None;
    for at in 0..stamps.len() {
        let (index, row) = (stamps[at].0, &rows[stamps[at].0]);
        // The elapsed time is unknown if sequence and clock jump.
        if matches!(timeline.steps[index], SequenceStep::Reset | SequenceStep::Jump) {
            usual_s = None;
        }
        let error_s = usual_s.map_or(0.0, |usual_s| deviation_s(at) - usual_s);
        if error_s.abs() > MIN_DEVIATION_S {
            let stays = at + 1 < stamps.len() && (deviation_s(at + 1) - deviation_s(at)).abs() < MIN_DEVIATION_S;
            if !stays {
                findings.note(INTERVAL, None, index, 1, error_s);
                continue;
            }
            findings.note(TIME_JUMP, None, index, 1, error_s);
            fits.push(ClockFit::default());
        }
        usual_s = Some(deviation_s(at));
        if let (Some(time), Some(fit), true) = (row.time, fits.last_mut(), row.has_clock) {
            fit.add(time.t_ns, row.sample.sequence, row.sample.clock_count);
        }
    }
    let (mut weights, mut sum) = (0.0, 0.0);
    for rate in fits.iter().filter_map(ClockFit::rate) {
        // The weight stays finite without scatter.
        let weight = rate.sigma_ppm.max(1e-9).powi(-2);
        (weights, sum) = (weights + weight, sum + weight * rate.clock_ppm);
    }
    (weights > 0.0).then(|| (sum / weights, weights.sqrt().recip()))
}

/// Configured clock error, averaged over the recording.
fn configured_ppm(rows: &[ReceivedSample], timeline: &SampleTimes, configuration: &Configuration) -> f64 {
    let electronics = timeline.electronics(rows, configuration);
    let every = rows.len().div_ceil(MAX_AVERAGED).max(1);
    let errors = (0..rows.len()).step_by(every).map(|row| {
        let interval = electronics.interval(timeline.start_s(row), timeline.end_s[row]);
        configuration.unit.at(&interval).timing().last().map_or(0.0, |timing| timing.clock_error)
    });
    let count = rows.len().div_ceil(every).max(1);
    errors.sum::<f64>() / count as f64 * 1e6
}
