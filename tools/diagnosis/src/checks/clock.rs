//! Receive times against the unit's clock: stamps that jump or stray, a wrong spacing, the clock's frequency.

use geu_model::Configuration;
use geu_model::course::Interval;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::continuity::SequenceStep;
use geu_protocol::field::unit_flag;
use geu_recording::{ClockFit, ReceivedSample};

use super::timeline::SampleTimes;
use super::told::{FindingCollector, FindingKind};

const TIME_JUMP: FindingKind =
    FindingKind { name: "time-jump", what: "jumps of the receive time against the unit's clock", unit: "s" };
const BACKWARDS: FindingKind =
    FindingKind { name: "time-backwards", what: "receive times before the one before", unit: "s" };
const INTERVAL: FindingKind =
    FindingKind { name: "interval", what: "samples received off their place by more than 0.1 s", unit: "s" };
/// A stamp so far from its place strays, or time jumped.
const STRAYS_S: f64 = 0.1;
/// A clock is within 1000 ppm: a median spacing that is off by ten times that is none of a sample.
const SPACING_OFF: f64 = 0.01;
/// A frequency is spoken of beyond so many sigma and so many ppm.
const SIGNIFICANT_SIGMA: f64 = 5.0;
const SIGNIFICANT_PPM: f64 = 0.05;
/// Rows at which the believed frequency is averaged.
const MOST_BELIEVED: usize = 1000;

/// Notes what the receive times show; nothing without them.
pub fn check(
    rows: &[ReceivedSample],
    timeline: &SampleTimes,
    configuration: &Configuration,
    told: &mut FindingCollector,
) {
    let is_polled = |row: usize| rows[row].sample.unit_flags & const { unit_flag("polled") } != 0;
    // Where stamps tell the unit's cadence.
    let stamps: Vec<(usize, f64)> = (0..rows.len())
        .filter(|&row| timeline.steps[row] != SequenceStep::Repeat && !is_polled(row))
        .filter_map(|row| Some((row, timeline.stamp_s[row]?)))
        .collect();
    for pair in stamps.windows(2).filter(|pair| pair[1].1 < pair[0].1) {
        told.note(BACKWARDS, None, pair[1].0, 1, pair[1].1 - pair[0].1);
    }
    if let Some(spacing_s) = wrong_spacing_s(&stamps, timeline) {
        told.whole("interval", None, format!("samples are received every {spacing_s:.4} s, not every 0.5 s"));
        return;
    }
    let rate = rate(rows, &stamps, timeline, told);
    let believed_ppm = believed_ppm(rows, timeline, configuration);
    if let Some((ppm, sigma_ppm)) = rate
        && (ppm - believed_ppm).abs() > (SIGNIFICANT_SIGMA * sigma_ppm).max(SIGNIFICANT_PPM)
    {
        told.whole(
            "clock-frequency",
            None,
            format!(
                "by receive times the unit's clock is fast by {ppm:.4} ± {sigma_ppm:.4} ppm; the configuration has \
                 {believed_ppm:.4} ppm"
            ),
        );
    }
}

/// The median spacing of samples that follow one another, where it is not theirs.
fn wrong_spacing_s(stamps: &[(usize, f64)], timeline: &SampleTimes) -> Option<f64> {
    let following = stamps.windows(2).filter(|pair| timeline.steps[pair[1].0] == SequenceStep::Next);
    let mut spacings: Vec<f64> = following.map(|pair| pair[1].1 - pair[0].1).collect();
    if spacings.len() < 10 {
        return None;
    }
    let middle = spacings.len() / 2;
    let spacing_s = *spacings.select_nth_unstable_by(middle, f64::total_cmp).1;
    ((spacing_s / SAMPLE_INTERVAL_S - 1.0).abs() > SPACING_OFF).then_some(spacing_s)
}

/// Notes stamps that stray and times that jump; between jumps, fits the clock: ppm and sigma.
fn rate(
    rows: &[ReceivedSample],
    stamps: &[(usize, f64)],
    timeline: &SampleTimes,
    told: &mut FindingCollector,
) -> Option<(f64, f64)> {
    let departure_s = |at: usize| stamps[at].1 - timeline.samples[stamps[at].0] * SAMPLE_INTERVAL_S;
    let mut fits = vec![ClockFit::default()];
    let mut usual_s: Option<f64> = None;
    for at in 0..stamps.len() {
        let (index, row) = (stamps[at].0, &rows[stamps[at].0]);
        // Sequence and clock that jump say nothing of how much time passed.
        if matches!(timeline.steps[index], SequenceStep::Reset | SequenceStep::Jump) {
            usual_s = None;
        }
        let strays_s = usual_s.map_or(0.0, |usual_s| departure_s(at) - usual_s);
        if strays_s.abs() > STRAYS_S {
            let stays = at + 1 < stamps.len() && (departure_s(at + 1) - departure_s(at)).abs() < STRAYS_S;
            if !stays {
                told.note(INTERVAL, None, index, 1, strays_s);
                continue;
            }
            told.note(TIME_JUMP, None, index, 1, strays_s);
            fits.push(ClockFit::default());
        }
        usual_s = Some(departure_s(at));
        if let (Some(time), Some(fit), true) = (row.time, fits.last_mut(), row.has_clock) {
            fit.add(time.t_ns, row.sample.sequence, row.sample.clock_count);
        }
    }
    let (mut weights, mut sum) = (0.0, 0.0);
    for rate in fits.iter().filter_map(ClockFit::rate) {
        // Stamps without any scatter would weigh without end.
        let weight = rate.sigma_ppm.max(1e-9).powi(-2);
        (weights, sum) = (weights + weight, sum + weight * rate.clock_ppm);
    }
    (weights > 0.0).then(|| (sum / weights, weights.sqrt().recip()))
}

/// The clock's error that the configuration has, averaged over the recording.
fn believed_ppm(rows: &[ReceivedSample], timeline: &SampleTimes, configuration: &Configuration) -> f64 {
    let reference_c = configuration.electronics.numbers.reference_c;
    let every = rows.len().div_ceil(MOST_BELIEVED).max(1);
    let errors = (0..rows.len()).step_by(every).map(|row| {
        let electronics_c = f64::from(rows[row].sample.electronics_centi_c) * 0.01;
        let (start_s, end_s) = (timeline.start_s(row), timeline.end_s[row]);
        let interval = Interval { start_s, end_s, electronics_excess_k: electronics_c - reference_c };
        configuration.unit.at(&interval).timing().last().map_or(0.0, |timing| timing.clock_error)
    });
    let count = rows.len().div_ceil(every).max(1);
    errors.sum::<f64>() / count as f64 * 1e6
}
