//! `geu calibrate`: from a recording to the calibration parameters.

use clap::Args;
use geu_calibration::absolute::AbsoluteData;
use geu_calibration::compare::MIN_PROBABILITY;
use geu_calibration::solve::Solution;
use geu_calibration::{
    AccumulatedCounts, AttitudeSource, Calibrated, Comparison, CountsReader, DeviceCountsReader, DeviceRecording,
    PreviousCalibration, calibrate, calibrate_described, report,
};
use geu_model::Configuration;
use geu_model::device::Device;
use geu_model::units::SAMPLE_INTERVAL_NS;
use geu_recording::{DecoderOptions, DeviceDecoder, InputReader, Reference, ReferenceAttitude, Sink, Stop};
use geu_report::calibration::{CalibrationPage, comparison_table, terminal_table};

use crate::calibrate_compare;
use crate::calibrate_parts;
use crate::command_error::{CommandError, note, say};
use crate::evaluation_args::EvaluationArgs;
use crate::outputs::{OutputFile, write_all};
use crate::settings::{ConfigArgs, NamedConfigArgs, number};
use crate::update::{self, Update};

/// Solves the in-orbit calibration parameters from a recording and an attitude; or, between checkouts, updates the Z gyros.
///
/// Uses the manoeuvres of a list, else the whole recording, cut where the unit rests. Pointings, scans and manoeuvres with
/// other names are used; slews, stabilisations, surveys, rasters, eclipses and holds are not.
///
/// The attitude comes from a reference, or from the sun sensor and the star sensor together.
#[derive(Args, Debug)]
#[command(override_usage = "geu calibrate [OPTIONS] --link <FILE>... (--reference <FILE> | --fss <FILE> --sse <FILE>)")]
pub struct Arguments {
    #[command(flatten)]
    unit: NamedConfigArgs,
    /// Unit of the recording: a name of `geu device list`, or a description
    #[arg(long, value_name = "NAME|FILE")]
    device: Option<String>,
    /// Recording of the link, CAN or serial, or an archive of `geu decode --format parquet`; several are one stream
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    link: Vec<String>,
    /// Reference attitude: reference.csv or a CCSDS attitude ephemeris
    #[arg(long, value_name = "FILE", required_unless_present_all = ["fss", "sse"], conflicts_with_all = ["fss", "sse"])]
    reference: Option<String>,
    /// Noise of the reference about each axis, 1 sigma [default: estimated from the data]
    #[arg(long, value_name = "ARCSEC", value_parser = number(0.0, 3600.0, " arcsec"))]
    reference_sigma: Option<f64>,
    /// History of the sun sensor, with --sse in place of --reference
    #[arg(long, value_name = "FILE", requires = "sse")]
    fss: Option<String>,
    /// Fixes of the star sensor, with --fss in place of --reference
    #[arg(long, value_name = "FILE", requires = "fss")]
    sse: Option<String>,
    #[command(flatten)]
    evaluation: EvaluationArgs,
    /// Write the configuration with the solved values, comments kept; with --compare the merged ones, if all are compatible
    #[arg(long, value_name = "CONFIG")]
    out: Option<OutputFile>,
    /// Write --out even though the parameters do not explain the data, or are not determined by them
    #[arg(long, requires = "out", conflicts_with = "update")]
    anyway: bool,
    /// Earlier calibrations of this unit, as `--json` wrote them from other recordings: compare, and merge if compatible
    #[arg(long, num_args = 1.., value_name = "FILE")]
    compare: Vec<String>,
    #[command(flatten)]
    update: Update,
}

/// Left out windows of a described unit that are printed.
const MAX_LISTED: usize = 10;

/// The attitude data of a calibration.
enum AttitudeInput {
    Reference(ReferenceAttitude),
    Sensors(AbsoluteData),
}

impl AttitudeInput {
    fn read(arguments: &Arguments, configuration: &Configuration) -> Result<AttitudeInput, CommandError> {
        match (&arguments.reference, &arguments.fss, &arguments.sse) {
            (Some(name), ..) => match Reference::read(name, &configuration.device).map_err(CommandError::input)? {
                Reference::Attitude(reference) => Ok(AttitudeInput::Reference(reference)),
                Reference::Magnitudes(_) => Err(CommandError::input(format!(
                    "{name}: expected rates, turns or attitudes, which a calibration needs, got magnitudes of the rate"
                ))),
            },
            (None, Some(fss), Some(sse)) => AbsoluteData::read(Some(fss), sse, configuration.sensors)
                .map(AttitudeInput::Sensors)
                .map_err(CommandError::input),
            _ => Err(CommandError::input("expected --reference FILE, or --fss FILE and --sse FILE")),
        }
    }

    fn start_ns(&self) -> i64 {
        match self {
            AttitudeInput::Reference(reference) => reference.start_ns,
            AttitudeInput::Sensors(sensors) => start_of_sensors_ns(sensors).unwrap_or(0),
        }
    }

    fn time_system(&self) -> Option<&str> {
        match self {
            AttitudeInput::Reference(reference) => reference.time_system.as_deref(),
            AttitudeInput::Sensors(_) => None,
        }
    }
}

/// Refuses a reference in another time system than the link's receive times, UTC: TAI, GPS and TT differ from it by
/// whole seconds.
pub fn check_time_system(system: Option<&str>, is_received: bool) -> Result<(), CommandError> {
    match system {
        Some(system) if system != "UTC" && is_received => Err(CommandError::input(format!(
            "--reference: TIME_SYSTEM: expected UTC, as the link's receive times are, got {system}: time systems are offset \
             from each other, TAI, GPS and TT from UTC by whole seconds and more; convert the ephemeris to UTC"
        ))),
        _ => Ok(()),
    }
}

/// Runs `geu calibrate`.
///
/// # Errors
/// An input cannot be read, the manoeuvres do not determine the parameters, a file cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let settings = ConfigArgs { device: arguments.device.clone(), ..ConfigArgs::from(&arguments.unit) };
    let mut configuration = settings.read_of_any()?;
    // Prescribed rates are of a run, and replace the scenario there; here the unit alone counts.
    configuration.motion.clear();
    if !configuration.device.is_iras() {
        return run_described(arguments, &settings, &configuration);
    }
    let earlier = calibrate_compare::read(&arguments.compare)?;
    let windows = arguments.evaluation.windows()?;
    if let Some(reference) = arguments.reference.as_deref().filter(|_| !arguments.update.update) {
        let calibrated = calibrate_parts::calibrate(
            (&arguments.link, &arguments.evaluation),
            &configuration,
            windows.as_deref(),
            (reference, arguments.reference_sigma),
        )?;
        return report_results(arguments, (&settings, &configuration), &calibrated, &earlier);
    }
    let input = AttitudeInput::read(arguments, &configuration)?;
    let start_ns = arguments.evaluation.start_ns(input.start_ns());
    let counts = read_counts(&arguments.link, arguments.evaluation.options()?, start_ns)?;
    arguments.evaluation.note_start(&arguments.link, counts.is_received);
    check_time_system(input.time_system(), counts.is_received)?;
    let attitude = match &input {
        AttitudeInput::Reference(reference) => {
            AttitudeSource::Reference(reference, arguments.reference_sigma.map(|sigma_arcsec| [sigma_arcsec; 3]))
        }
        AttitudeInput::Sensors(sensors) => AttitudeSource::Sensors(sensors),
    };
    if arguments.update.update {
        let results = (arguments.evaluation.json.as_ref(), arguments.out.as_ref());
        let prior = (&settings, &configuration);
        return update::run(&arguments.update, prior, &counts, windows.as_deref(), &attitude, results);
    }
    let calibrated = calibrate(&configuration, &counts, windows.as_deref(), &attitude).map_err(CommandError::input)?;
    report_results(arguments, (&settings, &configuration), &calibrated, &earlier)
}

/// Calibrates a described unit.
fn run_described(
    arguments: &Arguments,
    settings: &ConfigArgs,
    configuration: &Configuration,
) -> Result<(), CommandError> {
    let name = &configuration.device.name;
    let of_default = [
        ("--fss and --sse", arguments.fss.is_some()),
        ("--compare", !arguments.compare.is_empty()),
        ("--update", arguments.update.update),
        ("--base", arguments.evaluation.base.is_some()),
    ];
    if let Some((option, _)) = of_default.into_iter().find(|(_, is_given)| *is_given) {
        let expected = "expected the default unit, which alone has it";
        return Err(CommandError::input(format!(
            "{option}: {expected}, got {name}; calibrate {name} with --reference"
        )));
    }
    let windows = arguments.evaluation.windows()?;
    let input = AttitudeInput::read(arguments, configuration)?;
    let AttitudeInput::Reference(reference) = &input else {
        return Err(CommandError::input(format!(
            "expected --reference FILE for {name}, got sensors of the default unit"
        )));
    };
    let recording = read_device(&arguments.link, &arguments.evaluation, &configuration.device, reference)?;
    check_time_system(input.time_system(), recording.counts.is_received)?;
    let DeviceRecording { counts, defects, outliers, left_out, .. } = recording;
    let link = arguments.link.join(" ");
    note_defects(&arguments.link, defects);
    let rows = left_out.repeated + left_out.of_other_trials + left_out.after_gap;
    if rows > 0 {
        note(format_args!("geu: {rows} rows of {link} are left out: repeated, of another trial, or after a gap\n"));
    }
    let outliers: u64 = outliers.iter().sum();
    if outliers > 0 {
        note(format_args!("geu: {outliers} samples of {link} are far from their neighbours and left out\n"));
    }
    let source = (reference, arguments.reference_sigma);
    let calibrated = calibrate_described(configuration, &counts, windows.as_deref(), source)
        .map_err(|error| CommandError::input(format!("{link}: {error}")))?;
    report_results(arguments, (settings, configuration), &calibrated, &[])
}

/// Writes and prints the results.
fn report_results(
    arguments: &Arguments,
    unit: (&ConfigArgs, &Configuration),
    calibrated: &Calibrated,
    earlier: &[PreviousCalibration],
) -> Result<(), CommandError> {
    let listed = if unit.1.device.is_iras() { usize::MAX } else { MAX_LISTED };
    for left_out in calibrated.left_out.iter().take(listed) {
        note(format_args!("geu: left out: {left_out}\n"));
    }
    if calibrated.left_out.len() > listed {
        note(format_args!("geu: left out: {} more, which --json lists\n", calibrated.left_out.len() - listed));
    }
    let comparison = calibrate_compare::compare(earlier, calibrated)?;
    let doubt = doubt(unit.0, calibrated, comparison.as_ref());
    let is_written = arguments.anyway || doubt.is_none();
    write_results(arguments, unit, calibrated, (earlier, comparison.as_ref()), is_written)?;
    say!("{}", terminal_table(unit.1, calibrated))?;
    if let Some(comparison) = &comparison {
        say!("\n{}", comparison_table(earlier, comparison))?;
    }
    doubt.map_or(Ok(()), |why| not_written_without(arguments.anyway, &why, arguments.out.as_ref()))
}

/// Says why a result is doubtful, and what became of its file.
pub fn not_written_without(anyway: bool, why: &str, out: Option<&OutputFile>) -> Result<(), CommandError> {
    match out {
        Some(file) if !anyway => {
            return Err(CommandError::failed(format!("{why}; {file} is not written without --anyway")));
        }
        Some(file) => note(format_args!("geu: {why}; {file} is written anyway\n")),
        None => note(format_args!("geu: {why}\n")),
    }
    Ok(())
}

/// The solution that is written: the merged one, if all are compatible.
fn written<'a>(calibrated: &'a Calibrated, comparison: Option<&'a Comparison>) -> &'a Solution {
    let merged = comparison.filter(|comparison| comparison.is_compatible());
    merged.map_or(&calibrated.solution, |comparison| &comparison.combined)
}

/// Why a calibration is not written without `--anyway`.
fn doubt(settings: &ConfigArgs, calibrated: &Calibrated, comparison: Option<&Comparison>) -> Option<String> {
    let (probability, solution) = (calibrated.solution.probability(), written(calibrated, comparison));
    if solution.determined().is_empty() {
        return Some(
            "these data determine no calibration parameter; expected a longer recording with turns about each axis"
                .to_owned(),
        );
    }
    if probability < MIN_PROBABILITY {
        return Some(format!(
            "the calibration parameters do not explain these data: probability {probability:.1e}, expected {MIN_PROBABILITY} or more"
        ));
    }
    let overrides = report::overrides(solution.determined(), &solution.calibrations);
    let with = ConfigArgs { overrides: [&settings.overrides[..], &overrides].concat(), ..settings.clone() };
    let error = with.read_of_any().err()?.to_string();
    let first = error.lines().next().unwrap_or_default();
    let value = &first[first.find("expected").unwrap_or(0)..];
    Some(format!("no unit has the solved values: {value}; does each axis of the reference have its sign?"))
}

/// Writes the files of the results, --out if `is_written`.
fn write_results(
    arguments: &Arguments,
    (settings, configuration): (&ConfigArgs, &Configuration),
    calibrated: &Calibrated,
    (earlier, comparison): (&[PreviousCalibration], Option<&Comparison>),
    is_written: bool,
) -> Result<(), CommandError> {
    let mut outputs = Vec::new();
    if let Some(file) = &arguments.evaluation.json {
        let mut json = report::json(calibrated);
        if let Some(comparison) = comparison {
            json["comparison"] = report::comparison(earlier, comparison);
        }
        outputs.push((file, format!("{json:#}\n")));
    }
    if let Some(file) = arguments.out.as_ref().filter(|_| is_written) {
        let solution = written(calibrated, comparison);
        outputs.push((file, settings.edited(report::overrides(solution.determined(), &solution.calibrations))?));
    }
    if let Some(file) = &arguments.evaluation.html {
        let others = [
            ("reference attitude", &arguments.reference),
            ("sun sensor", &arguments.fss),
            ("star sensor", &arguments.sse),
        ];
        let provenance = settings.provenance(arguments.evaluation.inputs(&arguments.link, &others))?;
        let page = CalibrationPage { prior: configuration, calibrated, earlier, comparison, provenance };
        outputs.push((file, page.html()));
    }
    write_all(outputs)
}

/// Start of the sun sensor's data: its first sample ends the first sample interval. `None` without a sample.
pub fn start_of_sensors_ns(sensors: &AbsoluteData) -> Option<i64> {
    sensors.sun.first().map(|sample| sample.0 - SAMPLE_INTERVAL_NS)
}

/// Reads recordings as one stream into a sink.
///
/// # Errors
/// An input cannot be read.
pub fn read_recordings(names: &[String], options: DecoderOptions, sink: &mut impl Sink) -> Result<(), CommandError> {
    let mut reader = InputReader::new(options, Stop::default());
    for name in names {
        reader.read(name, sink).map_err(CommandError::input)?;
    }
    reader.finish(sink).1.map_err(CommandError::input)
}

/// Reads recordings of a described unit as one stream.
///
/// # Errors
/// An input cannot be read, or contains no sample.
pub fn read_device(
    names: &[String],
    evaluation: &EvaluationArgs,
    device: &Device,
    reference: &ReferenceAttitude,
) -> Result<DeviceRecording, CommandError> {
    let (options, start_ns) = (evaluation.options()?, evaluation.start_ns(reference.start_ns));
    let mut counts = DeviceCountsReader::new(device, reference);
    let mut reader = InputReader::with(DeviceDecoder::new(device, &options), options, Stop::default());
    for name in names {
        reader.read(name, &mut counts).map_err(CommandError::input)?;
    }
    reader.finish(&mut counts).1.map_err(CommandError::input)?;
    let trials: Vec<&str> = reference.trials.iter().map(|trial| &*trial.name).collect();
    let left_out = counts.left_out();
    if left_out.out_of_order > 0 {
        return Err(CommandError::input(format!(
            "{}: expected the trials in the order of the reference, {}, without interruption, got {} rows of a trial after a later one; sort the \
             rows by trial",
            names.join(" "),
            trials.join(", "),
            left_out.out_of_order
        )));
    }
    let missing = counts.missing_trials();
    if !missing.is_empty() {
        return Err(CommandError::input(format!(
            "{}: expected rows of each trial of the reference, got no row of {} at their times; leave these trials out of the reference",
            names.join(" "),
            missing.join(", ")
        )));
    }
    let expected = match left_out.of_other_trials {
        0 => format!("samples of {}", device.name),
        _ => format!("rows of the trials of the reference, {}, at their times", trials.join(", ")),
    };
    let none = || CommandError::input(format!("{}: expected {expected}, got none", names.join(" ")));
    let recording = counts.finish(start_ns).ok_or_else(none)?;
    evaluation.note_start(names, recording.is_timed);
    Ok(recording)
}

/// Reads recordings as one stream of counts.
///
/// # Errors
/// An input cannot be read, or contains no sample.
pub fn read_counts(
    names: &[String],
    options: DecoderOptions,
    clock_start_ns: i64,
) -> Result<AccumulatedCounts, CommandError> {
    let mut counts = CountsReader::default();
    read_recordings(names, options, &mut counts)?;
    note_defects(names, counts.defects());
    counts.finish(clock_start_ns).ok_or_else(|| no_samples(names))
}

/// Says how many defects the recordings have.
pub fn note_defects(names: &[String], defects: u64) {
    if defects > 0 {
        let input = names.join(" ");
        note(format_args!("geu: {defects} defects in {input}; `geu decode --format summary {input}` lists them\n"));
    }
}

/// The error of recordings without a sample.
pub fn no_samples(names: &[String]) -> CommandError {
    CommandError::input(format!("{}: expected samples of the unit, got none", names.join(" ")))
}
