//! Exact checks of the heads of a described unit against the reference: exchanged and inverted heads, units, constant and clipped output.
//!
//! A head's angle is compared with the turn of the reference about each head's nominal axis over windows of ten nodes. What is certain is
//! corrected: exchanged heads, signs and factors of units; constant and clipped output is left out.

use std::ops::Range;

use geu_calibration::counts::{AccumulatedCounts, BreakKind, ConstantRun, DeviceRecording, Discontinuity};
use geu_calibration::transfer::sensing_matrix;
use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::{AmplitudeRef, PULSE, STEP};
use geu_model::Configuration;
use geu_model::fault::ParameterRef;
use geu_protocol::{Gyro, Gyros};
use geu_recording::ReferenceAttitude;
use nalgebra::{MatrixXx3, Vector3};

use crate::correlation::{Sense, known_factor, opposite};
use crate::follows::{EXPLAINED, FOLLOWS, Follows, MIN_WINDOWS};
use crate::{Finding, WiringFault};

/// Samples of a run of one value, and the turn meanwhile that the output does not show, in counts and as a share of the range of angles.
const STUCK_SAMPLES: u64 = 20;
const UNSEEN: f64 = 1e-3;
/// Changes of the output within a node, in the smallest ones, from which it is noisy: 20 samples with such noise do not have one value.
const NOISE_STEPS: f64 = 4.0;
/// Runs of one value from which it is a limit.
const CLIPPED_RUNS: usize = 2;
/// Share of the nodes that may exceed a limit: outliers do.
const EXCEEDED_SHARE: f64 = 1e-3;
/// Cosine of the angle between input axes from which they are one: within 10 degrees.
const ONE_AXIS: f64 = 0.985;
/// Share of a recording with constant output from which its head is named.
const NAMED_SHARE: f64 = 0.02;

/// The checked recording.
pub struct HeadCheck {
    pub counts: AccumulatedCounts,
    pub faults: Vec<WiringFault>,
    pub findings: Vec<Finding>,
    /// Set if every head turns against the motion, which is then of opposite sign.
    pub mismatch: Option<String>,
}

/// Values of single samples, see [`DeviceRecording`].
struct SampleValues {
    constant: Vec<ConstantRun>,
    extremes: Vec<Vec<[f64; 2]>>,
    steps: Vec<f64>,
    rate_arcsec: Vec<f64>,
}

/// Checks the recording of a described unit. Rows without receive times begin with the reference.
pub fn check_heads(
    recording: DeviceRecording,
    configuration: &Configuration,
    reference: &ReferenceAttitude,
) -> HeadCheck {
    let matrix = sensing_matrix(configuration);
    let mut findings = samples(&recording);
    let DeviceRecording { mut counts, constant, extremes, steps, mut rate_arcsec, .. } = recording;
    let turned = turns(&counts, reference);
    let heads = counts.gyros.heads();
    // What a run of one value does not show of the turn is known in the right unit.
    let follows = |head: usize| {
        let excluded = |without: &[ConstantRun]| Follows::find(head, &counts, without, &turned, &matrix, configuration);
        excluded(&constant).or_else(|| excluded(&[])).filter(|own| own.explained > EXPLAINED)
    };
    let measured: Vec<Option<f64>> = (0..heads).map(|head| follows(head).map(|own| own.unit())).collect();
    // Heads that the motion does not turn are in the unit of all others.
    let exact = |factor: f64| known_factor(factor).map_or(factor, |known| known.0);
    let mut others = measured.iter().flatten().copied().map(exact);
    let common = others.next().filter(|first| others.all(|other| other == *first));
    for (head, measured) in measured.into_iter().enumerate() {
        let Some(factor) = measured.or(common).filter(|factor| *factor != 1.0) else { continue };
        let likely = known_factor(factor).map_or(String::new(), |(_, name)| format!(", as by {name}"));
        let by = if measured.is_some() { "what the motion predicts" } else { "the angle, as that of the others" };
        let text = format!("the output is {factor:.6} times {by}{likely}: it is divided by that");
        let place = configuration.device.heads[head].gyro.name().to_owned();
        findings.push(Finding { kind: Finding::UNIT_FACTOR.to_owned(), place, text });
        counts.multiply(head, 1.0 / exact(factor));
        rate_arcsec[head] /= exact(factor).abs();
    }
    let values = SampleValues { constant, extremes, steps, rate_arcsec };
    let mut faults = constant_output(&mut counts, &values, &turned, &matrix, &mut findings);
    let found: Vec<Option<Follows>> =
        (0..heads).map(|head| Follows::find(head, &counts, &[], &turned, &matrix, configuration)).collect();
    let by_own: Vec<Follows> = (0..heads).map(|head| found[head].unwrap_or(Follows::nominal(head))).collect();
    for (head, own) in by_own.iter().enumerate().filter(|(_, own)| own.explained < FOLLOWS) {
        let correlation = own.explained.sqrt();
        let text = format!("the output does not follow the motion: their correlation is {correlation:.2}");
        let place = configuration.device.heads[head].gyro.name().to_owned();
        findings.push(Finding { kind: "not-following".to_owned(), place, text });
        let (from, to, gyros) = (0, counts.len(), counts.gyros.only(head));
        counts.breaks.push(Discontinuity { from, to, gyros, kind: BreakKind::Invalid });
    }
    let mismatch = opposite(found.iter().enumerate().filter_map(|(head, own)| {
        let own = own.filter(|own| own.axis == head && own.explained > EXPLAINED)?;
        let sense = if own.factor < 0.0 { Sense::Against } else { Sense::Follows };
        Some((configuration.device.heads[head].gyro.name(), sense))
    }));
    let is_of_one_axis = matrix.row_iter().all(|row| row.normalize().dot(&matrix.row(0).normalize()).abs() > ONE_AXIS);
    let mismatch = mismatch.filter(|_| !is_of_one_axis);
    faults.extend(exchange(&mut counts, &by_own, configuration, &mut findings));
    HeadCheck { counts, faults, findings, mismatch }
}

/// Findings of the samples alone.
fn samples(recording: &DeviceRecording) -> Vec<Finding> {
    let DeviceRecording { counts, samples, missing, interpolated, defects, outliers, left_out, .. } = recording;
    let whole = |kind: &str, text: String| Finding { kind: kind.to_owned(), place: "the recording".to_owned(), text };
    let share = 100.0 * *missing as f64 / (samples + missing).max(1) as f64;
    let treatment = match (interpolated, missing - interpolated) {
        (0, _) => "left out".to_owned(),
        (_, 0) => "interpolated".to_owned(),
        (few, others) => format!("{few} in short gaps are interpolated, {others} left out"),
    };
    let missing = (*missing > 0)
        .then(|| whole("samples-lost", format!("{missing} samples are missing, {share:.2} % of all: {treatment}")));
    let defects = (*defects > 0).then(|| whole("defects", format!("{defects} in the input; `geu decode` lists them")));
    let rows = [
        (left_out.repeated, "are at the time of an earlier row or before it"),
        (
            left_out.of_other_trials,
            "are of other trials than the reference's, far from its rows, or of others than the first",
        ),
        (left_out.after_gap, "come after a longer gap than a recording may have (split it there)"),
    ];
    let left_out = rows.into_iter().filter(|(count, _)| *count > 0);
    let left_out = left_out.map(|(count, reason)| whole("rows-left-out", format!("{count} rows {reason}: left out")));
    let outlier = |gyro: Gyro| {
        let count = outliers[gyro.index()];
        let text = format!("{count} samples are far from their neighbours: left out");
        (count > 0).then(|| Finding { kind: "outliers".to_owned(), place: gyro.name().to_owned(), text })
    };
    missing.into_iter().chain(defects).chain(left_out).chain(counts.gyros.gyros().filter_map(outlier)).collect()
}

/// Turn of the reference up to each node, where it covers it.
fn turns(counts: &AccumulatedCounts, reference: &ReferenceAttitude) -> Vec<Option<Vector3<f64>>> {
    let (offset_s, mut near) = (counts.offset_s(reference), 0);
    let mut at = |node_s: &f64| {
        let t_s = node_s + offset_s;
        let is_covered = (0.0..=reference.truth.end_s()).contains(&t_s) && reference.truth.is_known(t_s);
        let (angle, _) = reference.truth.at(t_s, &mut near);
        is_covered.then_some(angle.into())
    };
    counts.node_s.iter().map(&mut at).collect()
}

/// Leaves out constant output while the unit turns; returns the heads that stand out by it.
fn constant_output(
    counts: &mut AccumulatedCounts,
    SampleValues { constant, extremes, steps, rate_arcsec }: &SampleValues,
    turned: &[Option<Vector3<f64>>],
    matrix: &MatrixXx3<f64>,
    findings: &mut Vec<Finding>,
) -> Vec<WiringFault> {
    let mut faults = Vec::new();
    let wrong_runs = |head: usize| {
        let axis = matrix.row(head).transpose();
        let angle = |node: usize| turned[node].map(|turned| axis.dot(&turned));
        let known: Vec<f64> = (0..turned.len()).filter_map(angle).collect();
        let range = known.iter().copied().fold(f64::NEG_INFINITY, f64::max)
            - known.iter().copied().fold(f64::INFINITY, f64::min);
        let limit = UNSEEN * range.max(0.0) + 20.0 * counts.rounded_to[head];
        // Largest difference of the turn and of the output within a run, and that of the turn less that of the output.
        let unseen = |from: usize, to: usize| {
            let off = (from..=to).filter_map(|node| Some(angle(node)? - counts.accumulated[head][node]));
            let (low, high) =
                off.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), own| (low.min(own), high.max(own)));
            high - low
        };
        // At other times of as little motion about the axis the output is noisy.
        let is_noiseless = |run: &ConstantRun| {
            let turn = |node: usize| angle(node + 1).zip(angle(node)).map_or(f64::NAN, |(to, from)| (to - from).abs());
            let largest = (run.from..run.to).map(turn).fold(0.0, f64::max);
            // A node in which the motion reverses has neighbours of more.
            let is_still = |node: &usize| (node - 1..=node + 1).all(|node| turn(node) <= largest);
            let others = (1..run.from).chain(run.to..turned.len().saturating_sub(2)).filter(is_still);
            let (noisy, constant): (Vec<[f64; 2]>, Vec<[f64; 2]>) = others
                .filter_map(|node| extremes[head].get(node).copied())
                .partition(|[low, high]| high - low >= NOISE_STEPS * steps[head]);
            noisy.len() >= MIN_WINDOWS.max(2 * constant.len())
        };
        let is_wrong =
            |run: &&ConstantRun| unseen(run.from, run.to) > limit || run.samples >= STUCK_SAMPLES && is_noiseless(run);
        constant.iter().filter(|run| run.gyro == head).filter(is_wrong).collect()
    };
    let wrong: Vec<Vec<&ConstantRun>> = (0..counts.gyros.heads()).map(wrong_runs).collect();
    for (head, size_arcsec) in rate_arcsec.iter().enumerate() {
        // A rate that stays for n samples has n times the rounding error of a sample.
        let kept = constant.iter().filter(|run| run.gyro == head && !wrong[head].contains(run));
        let variance: f64 = kept.map(|run| (run.samples as f64 * size_arcsec).powi(2) / 12.0).sum();
        counts.rounding_walk[head] = (variance / counts.end_s()).sqrt();
    }
    let limits = limits(wrong.iter().flatten().map(|run| run.arcsec.abs()).collect());
    for (gyro, own) in counts.gyros.gyros().zip(wrong) {
        let head = gyro.index();
        let [low, high] = [-1.0, 1.0].map(|sign| output_limit(&limits, &extremes[head], sign));
        let is_limit = |arcsec: f64| arcsec.is_finite() && (arcsec >= high || arcsec <= low);
        let is_stuck = |run: &&ConstantRun| run.samples >= STUCK_SAMPLES && !is_limit(run.arcsec);
        let stuck: Vec<&ConstantRun> = own.into_iter().filter(is_stuck).collect();
        // Samples at the limit that are alone or few are clipped too.
        let at_limit = |node: &usize| extremes[head][*node].into_iter().any(is_limit);
        let nodes: Vec<usize> = (0..extremes[head].len()).filter(at_limit).collect();
        let runs = nodes.chunk_by(|one, next| next - one <= 1);
        let clipped: Vec<Range<usize>> = runs.map(|run| run[0]..run[run.len() - 1] + 1).collect();
        let constant = stuck.iter().map(|run| run.from..run.to).collect();
        for (all, kind, name, what) in [
            (constant, BreakKind::Constant, "stuck-output", "the output stays while the unit turns, or has no noise"),
            (clipped, BreakKind::Saturated, "clipped", "the output stays at its limit while the unit turns faster"),
        ] {
            let (Some(first), Some(last)) = (all.first(), all.last()) else { continue };
            let share = all.iter().map(Range::len).sum::<usize>() as f64 / counts.len().max(1) as f64;
            let gyros = counts.gyros.only(head);
            let [from_s, to_s] = [first.start, last.end.min(counts.len())].map(|node| counts.node_s[node]);
            let text = format!("{what}: left out; {} times, {:.1} % of the time", all.len(), 100.0 * share);
            let place = format!("{}, {from_s:.1}\u{2013}{to_s:.1} s", gyro.name());
            findings.push(Finding { kind: name.to_owned(), place, text });
            if kind == BreakKind::Constant && share > NAMED_SHARE {
                // An effect has one time: that of the longest.
                let Range { start, end } = all.iter().max_by_key(|own| own.len()).unwrap_or(first).clone();
                let onset_s = (start > 1).then(|| counts.node_s[start]);
                let samples = stuck.iter().map(|run| run.samples as usize).sum();
                let end_s = (end < counts.len()).then(|| counts.node_s[end]);
                faults.push(fault("stuck-output.on", gyro, 1.0, counts.gyros, onset_s, end_s, samples));
            }
            let last = counts.len();
            let discontinuity =
                |own: Range<usize>| Discontinuity { from: own.start, to: own.end.min(last), gyros, kind };
            counts.breaks.extend(all.into_iter().map(discontinuity));
        }
    }
    counts.breaks.sort_by_key(|found| found.from);
    faults
}

/// Sizes at which output stays in several runs of all heads: a head may reach the limit of the unit once.
fn limits(mut sizes: Vec<f64>) -> Vec<f64> {
    sizes.sort_by(f64::total_cmp);
    let several = sizes.chunk_by(|one, next| one == next).filter(|same| same.len() >= CLIPPED_RUNS && same[0] > 0.0);
    several.map(|same| same[0]).collect()
}

/// The smallest of these limits, in rising order, that a head reaches to the side of a sign, and that few nodes exceed; infinite without one.
fn output_limit(limits: &[f64], extremes: &[[f64; 2]], sign: f64) -> f64 {
    let nodes = |is: &dyn Fn(f64) -> bool| extremes.iter().filter(|own| own.iter().any(|own| is(sign * own))).count();
    let is_limit = |limit: &&f64| {
        let exceeded = nodes(&|own| own.is_finite() && own > **limit);
        nodes(&|own| own == **limit) > 0 && exceeded as f64 <= EXCEEDED_SHARE * extremes.len() as f64
    };
    sign * limits.iter().find(is_limit).copied().unwrap_or(f64::INFINITY)
}

/// A wiring fault that the comparison with the reference shows.
fn fault(
    number: &str,
    gyro: Gyro,
    value: f64,
    unit: Gyros,
    onset_s: Option<f64>,
    end_s: Option<f64>,
    samples: usize,
) -> WiringFault {
    let target = ParameterRef::from_name(number).expect("a number of the wiring effects");
    let (course, course_shapes) = match (onset_s, end_s) {
        (None, None) => (None, vec![]),
        (Some(onset_s), None) => (Some(STEP), vec![onset_s]),
        (onset_s, Some(end_s)) => {
            let onset_s = onset_s.unwrap_or(0.0);
            (Some(PULSE), vec![onset_s, end_s - onset_s])
        }
    };
    let amplitude = AmplitudeRef::new(target, course);
    let hypothesis = Hypothesis { course_shapes, ..Hypothesis::constant(amplitude, value, unit.only(gyro.index())) };
    WiringFault {
        hypothesis,
        gyros: vec![gyro],
        onset_s,
        onset_between_s: [onset_s.unwrap_or(0.0); 2],
        end_s,
        samples,
        without_rms_counts: 0.0,
        with_rms_counts: 0.0,
    }
}

/// Puts exchanged heads in their places and inverts signs.
fn exchange(
    counts: &mut AccumulatedCounts,
    follows: &[Follows],
    configuration: &Configuration,
    findings: &mut Vec<Finding>,
) -> Vec<WiringFault> {
    let heads = follows.len();
    let gyro = |head: usize| configuration.device.heads[head].gyro;
    let mut axes: Vec<usize> = follows.iter().map(|own| own.axis).collect();
    let mut sorted = axes.clone();
    sorted.sort_unstable();
    if sorted != (0..heads).collect::<Vec<_>>() {
        for (head, own) in follows.iter().enumerate().filter(|(head, own)| own.axis != *head) {
            let text = format!("the output follows the axis of {}, as another head does", gyro(own.axis).name());
            findings.push(Finding { kind: "axis".to_owned(), place: gyro(head).name().to_owned(), text });
        }
        axes = (0..heads).collect();
    }
    let mut faults = Vec::new();
    for head in 0..heads {
        if follows[head].factor < 0.0 && follows[head].explained > EXPLAINED {
            counts.multiply(head, -1.0);
            let place = if axes[head] == follows[head].axis { axes[head] } else { head };
            faults.push(fault("sign-inversion.on", gyro(place), 1.0, counts.gyros, None, None, counts.len()));
        }
    }
    while let Some(head) = (0..heads).find(|&head| axes[head] != head) {
        let other = axes[head];
        counts.exchange(head, other);
        for found in &mut counts.breaks {
            let both = [found.gyros[other], found.gyros[head]];
            found.gyros = found.gyros.unit().filter(|gyro| match gyro {
                gyro if gyro == head => both[0],
                gyro if gyro == other => both[1],
                gyro => found.gyros[gyro],
            });
        }
        axes.swap(head, other);
        let swap = fault("axis-swap.with", gyro(head), other as f64 + 1.0, counts.gyros, None, None, counts.len());
        faults.push(WiringFault { gyros: vec![gyro(head), gyro(other)], ..swap });
    }
    for found in &faults {
        let names: Vec<&str> = found.gyros.iter().map(|gyro| gyro.name()).collect();
        let text = "the output follows the motion with it, over the whole recording: corrected".to_owned();
        findings.push(Finding { kind: found.code(), place: names.join(", "), text });
    }
    faults
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_have_the_limit_of_all_that_they_reach_and_do_not_exceed() {
        // Two runs at a limit, of any heads and signs; one stuck elsewhere, two at 0.
        let limits = limits(vec![25.0, 3.0, 0.0, 25.0, 0.0]);
        assert_eq!(limits, [25.0]);
        let mut extremes = vec![[-4.0, 4.0]; 5000];
        assert_eq!(output_limit(&limits, &extremes, 1.0), f64::INFINITY);
        extremes[7] = [-25.0, 1.0];
        assert_eq!([-1.0, 1.0].map(|sign| output_limit(&limits, &extremes, sign)), [-25.0, f64::INFINITY]);
        extremes[8] = [-40.0, 1.0];
        assert_eq!(output_limit(&limits, &extremes, -1.0), -25.0);
        extremes[10..20].fill([-30.0, 1.0]);
        assert_eq!(output_limit(&limits, &extremes, -1.0), f64::NEG_INFINITY);
    }
}
