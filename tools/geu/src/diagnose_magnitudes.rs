//! `geu diagnose` of a described unit against the magnitude of its rate.

mod samples;

use std::ops::Range;

use geu_magnitudes::{Gyro, Verdict, Windows, diagnose};
use geu_model::device::Device;
use geu_recording::{DecoderOptions, MagnitudeRow};
use geu_report::magnitudes;

use self::samples::{HEADS, Sample, Samples};
use crate::command_error::{CommandError, say};
use crate::outputs::OutputFile;

/// Smallest share of a window that samples fill.
const MIN_SHARE: f64 = 0.5;

/// Diagnoses recordings, each of which is a separate group, against magnitudes: file names of `(recordings, reference)`, rows of the
/// reference.
///
/// # Errors
/// An input cannot be read or is too short, a file cannot be written, the residual is not explained.
pub fn run(
    device: &Device,
    (links, options, reference): (&[String], DecoderOptions, &str),
    rows: &[MagnitudeRow],
    seed: u64,
    json: Option<&OutputFile>,
) -> Result<(), CommandError> {
    let failed = |error| CommandError::input(format!("{reference}: {error}"));
    let gyros = device.heads.iter();
    let gyros = gyros.map(|head| Gyro { name: head.gyro.name().to_owned(), input: head.axes.input_control }).collect();
    let mut windows = Windows::new(gyros).map_err(failed)?;
    let mut samples = Samples::new(device);
    for link in links {
        samples.read(link, options.clone())?;
    }
    let own = rows.iter().filter(|row| row.window_ns.is_none());
    for row in own {
        let group = if row.group.is_empty() { reference } else { &row.group };
        windows.push(group, &row.rates_arcsec_s, row.magnitude_arcsec_s);
    }
    let timed = rows.iter().filter_map(|row| Some((row, row.window_ns?)));
    if timed.clone().next().is_some() {
        samples.order();
    }
    for (row, (start_ns, end_ns)) in timed.clone() {
        for (group, trial, samples) in &samples.groups {
            let is_own = row.group.is_empty() || trial.is_empty() || row.group == *trial;
            if let Some(mean) = mean(samples, start_ns, end_ns).filter(|_| is_own) {
                windows.push(group, &mean, row.magnitude_arcsec_s);
            }
        }
    }
    if windows.all().is_empty()
        && let Some(times) = span(timed.map(|(_, window_ns)| window_ns))
    {
        let ends = samples.groups.iter().flat_map(|(_, _, samples)| samples).map(|own| (own.end_ns, own.end_ns));
        let got = span(ends).map_or("none".to_owned(), |got| format!("samples from {} to {} s", got.start, got.end));
        return Err(CommandError::input(format!(
            "{}: expected samples in half of a window of {reference} or more, from {} to {} s; got {got}",
            links.join(" "),
            times.start,
            times.end
        )));
    }
    let diagnosis = diagnose(&windows, seed).map_err(failed)?;
    if let Some(file) = json {
        file.write(format!("{:#}\n", magnitudes::json(&diagnosis, &samples.findings)))?;
    }
    // The remark is on the described windows; rows with times are another reference.
    let described = device.table.as_ref().and_then(|table| table.reference.as_ref());
    let described = described.filter(|_| rows.iter().all(|row| row.window_ns.is_none()));
    let caveat = described.and_then(|reference| reference.caveat.as_deref());
    say!("{}", magnitudes::text(&diagnosis, &samples.findings, caveat))?;
    match diagnosis.verdict {
        Verdict::Unexplained => Err(CommandError::unexplained()),
        _ => Ok(()),
    }
}

/// Mean rates of the samples that end in a window; `None` if they fill too little of it.
fn mean(samples: &[Sample], start_ns: i64, end_ns: i64) -> Option<[f64; HEADS]> {
    let [from, to] = [start_ns, end_ns].map(|t_ns| samples.partition_point(|sample| sample.end_ns <= t_ns));
    let inside = &samples[from..to.max(from)];
    let length_s: f64 = inside.iter().map(|sample| sample.length_s).sum();
    if inside.is_empty() || length_s < MIN_SHARE * end_ns.saturating_sub(start_ns) as f64 * 1e-9 {
        return None;
    }
    let angle_arcsec = |head: usize| inside.iter().map(|own| own.rates_arcsec_s[head] * own.length_s).sum::<f64>();
    Some(std::array::from_fn(|head| angle_arcsec(head) / length_s))
}

/// The times that these intervals span, s.
fn span(intervals_ns: impl Iterator<Item = (i64, i64)>) -> Option<Range<f64>> {
    let joined = intervals_ns.reduce(|one, other| (one.0.min(other.0), one.1.max(other.1)));
    joined.map(|(start_ns, end_ns)| start_ns as f64 * 1e-9..end_ns as f64 * 1e-9)
}
