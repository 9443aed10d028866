//! `geu reconstruct`: attitude and transfer functions between fixes, of a recording or of a simulated survey day.

use std::fmt::Write as _;
use std::io::{self, BufWriter, Write};

use clap::Args;
use geu_calibration::absolute::AbsoluteData;
use geu_calibration::compare::MIN_PROBABILITY;
use geu_calibration::filter::{
    AttitudeErrorStats, AttitudeFix, FilterNoise, NodeEstimates, REQUIREMENT_ARCSEC, SurveyDayReport, Whiteness,
    checkout_calibration, cost_of_effects, reconstruct, survey_day,
};
use geu_calibration::{AccumulatedCounts, GyroSet};
use geu_model::Configuration;
use geu_model::configuration::unix_ns;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::{CanIdMap, Gyro};
use geu_recording::DecoderOptions;
use nalgebra::UnitQuaternion;

use crate::calibrate::{not_written_without, read_counts, start_of_sensors_ns};
use crate::command_error::{CommandError, note, say};
use crate::outputs::OutputFile;
use crate::settings::{ConfigArgs, LONGEST_S, NamedConfigArgs, choice, within};

/// Reconstructs the attitude between star fixes by a Kalman filter and a smoother.
///
/// Without a recording: simulates a survey day of the configuration, reconstructs it, compares it with the exact attitude
/// and with the mission's requirement, and prints the error that each effect adds.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    unit: NamedConfigArgs,
    /// Gyro used about Z
    #[arg(long, value_name = "GYRO", default_value = "za", value_parser = choice(Z_GYROS))]
    z: GyroSet,
    /// On-board time of the survey day
    #[arg(
        long,
        value_name = "DURATION",
        default_value = "1d",
        allow_negative_numbers = true,
        value_parser = crate::settings::duration(0.0, LONGEST_S),
        conflicts_with = "link"
    )]
    duration: f64,
    /// Leave out the table of effects, which takes two more simulated days for each effect
    #[arg(long, conflicts_with = "link")]
    brief: bool,
    /// Recording of the link, CAN or serial; several are one stream
    #[arg(long, num_args = 1.., value_name = "FILE", requires = "sse")]
    link: Vec<String>,
    /// Fixes of the star sensor
    #[arg(long, value_name = "FILE", requires = "link")]
    sse: Option<String>,
    /// History of the sun sensor; one sample in ten minutes is used
    #[arg(long, value_name = "FILE", requires = "link")]
    fss: Option<String>,
    /// Time at which the unit's clock was 0, for recordings without receive times [default: start of the sun sensor's data,
    /// else the configuration's]
    #[arg(long, value_name = "UNIX_SECONDS", allow_negative_numbers = true, requires = "link", value_parser = crate::settings::start)]
    start: Option<f64>,
    /// Base of the CAN identifiers, hexadecimal
    #[arg(long, value_name = "ID", value_parser = crate::settings::can_base, requires = "link")]
    base: Option<CanIdMap>,
    /// Write the smoothed attitude of each sample, with sigmas, as CSV
    #[arg(long, value_name = "CSV", requires = "link")]
    out: Option<OutputFile>,
    /// Write --out even though the fixes depart by more than the sigmas
    #[arg(long, requires = "out")]
    anyway: bool,
}

const Z_GYROS: &[(&str, GyroSet, &str)] = &[("za", GyroSet::WithZa, "GYRZA"), ("zb", GyroSet::WithZb, "GYRZB")];

/// Runs `geu reconstruct`.
///
/// # Errors
/// An input cannot be read, there is no star fix, a file cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let configuration = ConfigArgs::from(&arguments.unit).read()?;
    match &arguments.sse {
        Some(sse) => recording(arguments, &configuration, arguments.z, sse),
        None => simulated_day(arguments, &configuration, arguments.z),
    }
}

fn simulated_day(arguments: &Arguments, configuration: &Configuration, in_use: GyroSet) -> Result<(), CommandError> {
    let count = (within(arguments.duration)? / SAMPLE_INTERVAL_S).ceil() as usize;
    let day = |with_sun| survey_day(configuration, count, in_use, with_sun).map_err(CommandError::input);
    let SurveyDayReport { filtered, smoothed, fixes, reconstruction, .. } = day(false)?;
    let with_sun = day(true)?;
    say!("survey of {} s, gyros {in_use}, {fixes} star fixes", count as f64 * 0.5, in_use = names(in_use))?;
    say!("boresight against the exact attitude, arcsec; {REQUIREMENT_ARCSEC} required (Casteren §1)")?;
    say!("{:<28} {:>7} {:>7} {:>7}  met by, at the worst", "", "rms", "95 %", "max")?;
    for (name, share) in
        [("filtered", filtered), ("smoothed", smoothed), ("smoothed, sun sensor too", with_sun.smoothed)]
    {
        let AttitudeErrorStats { rms_arcsec, p95_arcsec, max_arcsec } = share;
        let margin_arcsec = REQUIREMENT_ARCSEC - max_arcsec;
        say!("{name:<28} {rms_arcsec:>7.2} {p95_arcsec:>7.2} {max_arcsec:>7.2}  {margin_arcsec:.1}")?;
    }
    say!("{}", whiteness_text(&reconstruction.whiteness))?;
    if arguments.brief {
        return Ok(());
    }
    let bar = indicatif::ProgressBar::new(1);
    let (none, costs) = cost_of_effects(configuration, count, in_use, |done, runs| {
        bar.set_length(runs as u64);
        bar.set_position(done as u64);
    })
    .map_err(CommandError::input)?;
    bar.finish_and_clear();
    let three = |share: &AttitudeErrorStats| {
        format!("{:>7.2} {:>7.2} {:>7.2}", share.rms_arcsec, share.p95_arcsec, share.max_arcsec)
    };
    let mut text = format!("\n{:<28} {:^23}   {:^23}\n", "smoothed", "this effect alone", "all but this effect");
    let _ = writeln!(
        text,
        "{:<28} {columns}   {columns}",
        "",
        columns = format!("{:>7} {:>7} {:>7}", "rms", "95 %", "max")
    );
    let _ = writeln!(text, "{:<28} {}   {}", "(no effect; all effects)", three(&none), three(&smoothed));
    for cost in &costs {
        let _ = writeln!(text, "{:<28} {}   {}", cost.code, three(&cost.alone), three(&cost.without));
    }
    say!("{}", text.trim_end())
}

fn names(in_use: GyroSet) -> String {
    let used = Gyro::ALL.into_iter().zip(in_use.gyros()).filter(|(_, used)| *used).map(|(gyro, _)| gyro.name());
    used.collect::<Vec<_>>().join(" ")
}

fn whiteness_text(whiteness: &Whiteness) -> String {
    let Whiteness { nis, nis_dof, nis_p, ljung_box, ljung_box_dof, ljung_box_p } = whiteness;
    let verdict = if whiteness.is_white() { "white" } else { "not white: the filter lacks an effect" };
    format!(
        "innovations: NIS {nis:.1} of {nis_dof} (p {nis_p:.3}), Ljung-Box {ljung_box:.1} of {ljung_box_dof} (p {ljung_box_p:.3}): {verdict}"
    )
}

fn recording(
    arguments: &Arguments,
    configuration: &Configuration,
    in_use: GyroSet,
    sse: &str,
) -> Result<(), CommandError> {
    let sensors =
        AbsoluteData::read(arguments.fss.as_deref(), sse, configuration.sensors).map_err(CommandError::input)?;
    let attitude_start_ns = start_of_sensors_ns(&sensors).unwrap_or(configuration.start_unix_ns);
    let start_ns = arguments.start.map_or(attitude_start_ns, unix_ns);
    let options = DecoderOptions { plan: arguments.base.unwrap_or_default(), ..DecoderOptions::default() };
    let counts = read_counts(&arguments.link, options, start_ns)?;
    let fixes = AttitudeFix::from_sensors(&sensors, counts.start_ns);
    // Constant departures of the configuration are prior knowledge, as for `geu calibrate`.
    let calibrations = checkout_calibration(configuration);
    let noise = FilterNoise::from_configuration(configuration, in_use);
    let mut rows = Vec::with_capacity(if arguments.out.is_some() { counts.len() } else { 0 });
    let (mut filtered, mut smoothed) = (0.0, 0.0);
    let visit = |node: usize, own: &NodeEstimates| {
        filtered = own.filtered.boresight_sigma_arcsec().max(filtered);
        smoothed = own.smoothed.boresight_sigma_arcsec().max(smoothed);
        if arguments.out.is_some() && node > 0 {
            rows.push((own.smoothed.attitude, own.smoothed.sigma_control_arcsec()));
        }
    };
    let result = reconstruct(&counts, &calibrations, in_use, &noise, &fixes, visit).map_err(CommandError::input)?;
    for found in &counts.breaks {
        let unix_s = |node: usize| counts.start_ns as f64 * 1e-9 + counts.node_s[node.min(counts.len())];
        let (from_s, to_s) = (unix_s(found.from), unix_s(found.to));
        note(format_args!("geu: {from_s:.1}…{to_s:.1} s: {}\n", found.kind));
    }
    if result.fixes_outside > 0 {
        note(format_args!("geu: {} fixes lie outside the recording and were not used\n", result.fixes_outside));
    }
    say!("{} samples, gyros {}, {} fixes", counts.len(), names(in_use), fixes.len() - result.fixes_outside)?;
    say!("boresight, largest sigma: {filtered:.1} arcsec filtered, {smoothed:.1} smoothed")?;
    say!("{}", whiteness_text(&result.whiteness))?;
    let doubt = doubt(&result.whiteness);
    if let Some(out) = &arguments.out
        && (arguments.anyway || doubt.is_none())
    {
        let mut output = out.create()?;
        write_rows(&mut output, &counts, &rows)
            .and_then(|()| output.persist())
            .map_err(|error| out.write_error(error))?;
    }
    doubt.map_or(Ok(()), |why| not_written_without(arguments.anyway, &why, arguments.out.as_ref()))
}

/// Why an attitude is not written without `--anyway`.
fn doubt(whiteness: &Whiteness) -> Option<String> {
    let (probability, rms) = (whiteness.probability(), whiteness.rms());
    (probability < MIN_PROBABILITY).then(|| {
        format!(
            "the fixes depart from the filter's attitude by {rms:.1} times their sigmas: probability {probability:.1e}, expected \
             {MIN_PROBABILITY} or more; do configuration and fixes belong to this recording, and does each axis have its sign?"
        )
    })
}

/// A row per sample interval: the attitude at its end (control frame to inertial, the sun-referenced frame at the start of the
/// counts), sigmas about the control axes. `rows` has the last one first.
fn write_rows(
    output: &mut impl Write,
    counts: &AccumulatedCounts,
    rows: &[(UnitQuaternion<f64>, [f64; 3])],
) -> io::Result<()> {
    let mut output = BufWriter::new(output);
    writeln!(output, "t_s,q_w,q_x,q_y,q_z,sigma_x_arcsec,sigma_y_arcsec,sigma_z_arcsec")?;
    for (node_s, (attitude, [x, y, z])) in counts.node_s.iter().skip(1).zip(rows.iter().rev()) {
        let t_us = counts.start_ns / 1000 + (node_s * 1e6).round() as i64;
        let q = attitude.quaternion();
        let (seconds, part) = (t_us.div_euclid(1_000_000), t_us.rem_euclid(1_000_000));
        writeln!(output, "{seconds}.{part:06},{:.12},{:.12},{:.12},{:.12},{x:.3},{y:.3},{z:.3}", q.w, q.i, q.j, q.k)?;
    }
    output.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_in_order_of_time() {
        let mut counts = AccumulatedCounts::starting_at(1_790_000_000_000_000_000);
        [0.5, 1.0].iter().for_each(|end_s| counts.push(*end_s, &[0.0; 4], 20.0));
        let attitude = |turn: f64| UnitQuaternion::from_scaled_axis([turn, 0.0, 0.0].into());
        // The last node first, as they are visited.
        let rows = [(attitude(2.0), [4.0, 5.0, 6.0]), (attitude(0.0), [1.0, 2.0, 3.0])];
        let mut text = Vec::new();
        write_rows(&mut text, &counts, &rows).unwrap();
        let text = String::from_utf8(text).unwrap();
        let lines: Vec<&str> = text.lines().skip(1).collect();
        assert_eq!(
            lines,
            [
                "1790000000.500000,1.000000000000,0.000000000000,0.000000000000,0.000000000000,1.000,2.000,3.000",
                "1790000001.000000,0.540302305868,0.841470984808,0.000000000000,0.000000000000,4.000,5.000,6.000",
            ]
        );
    }
}
