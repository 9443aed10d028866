//! `geu calibrate`: from a recording to the sixteen parameters.

use clap::Args;
use geu_calibration::absolute::AbsoluteData;
use geu_calibration::compare::LEAST_PROBABILITY;
use geu_calibration::solve::Solution;
use geu_calibration::{AccumulatedCounts, AttitudeSource, CountsReader, calibrate, report, window};
use geu_model::Configuration;
use geu_model::configuration::unix_ns;
use geu_model::units::SAMPLE_INTERVAL_NS;
use geu_protocol::CanIdMap;
use geu_recording::{DecoderOptions, InputReader, ReferenceAttitude, Stop};
use geu_report::calibration::{CalibrationPage, comparison_table, terminal_table};

use crate::calibrate_compare;
use crate::failure::{CommandError, note, say};
use crate::outputs::{OutputFile, write_all};
use crate::settings::{ConfigArgs, NamedSettings};
use crate::update::{self, Results, Update};

/// Solves the sixteen in-orbit parameters from a recording and what tells its attitude; or, between checkouts, updates the Z gyros.
///
/// With the manoeuvres of a list; without one everything, cut where the unit rests. Pointings, scans and manoeuvres with
/// names of your own are used; slews, stabilisations, surveys, rasters, eclipses and holds are not.
///
/// The attitude comes from a reference, or from the sun sensor and the star sensor together.
#[derive(Args, Debug)]
#[command(override_usage = "geu calibrate [OPTIONS] --link <FILE>... (--reference <FILE> | --fss <FILE> --sse <FILE>)")]
pub struct Arguments {
    #[command(flatten)]
    unit: NamedSettings,
    /// Recording of the link, CAN or serial; several are one stream
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    link: Vec<String>,
    /// Manoeuvres: CSV with manoeuvre,start_s,end_s
    #[arg(long, value_name = "FILE")]
    manoeuvres: Option<String>,
    /// Reference attitude: reference.csv or a CCSDS attitude ephemeris
    #[arg(long, value_name = "FILE", required_unless_present_all = ["fss", "sse"], conflicts_with_all = ["fss", "sse"])]
    reference: Option<String>,
    /// Noise of the reference about each axis, 1 sigma [default: estimated from the data]
    #[arg(long, value_name = "ARCSEC", value_parser = sigma)]
    reference_sigma: Option<f64>,
    /// History of the sun sensor, with --sse in place of --reference
    #[arg(long, value_name = "FILE", requires = "sse")]
    fss: Option<String>,
    /// Fixes of the star sensor, with --fss in place of --reference
    #[arg(long, value_name = "FILE", requires = "fss")]
    sse: Option<String>,
    /// Time at which the unit's clock was 0, for recordings without receive times [default: start of the attitude data]
    #[arg(long, value_name = "UNIX_SECONDS", allow_negative_numbers = true, value_parser = crate::settings::start)]
    start: Option<f64>,
    /// Base of the CAN identifiers, hexadecimal
    #[arg(long, value_name = "ID", value_parser = crate::settings::can_base)]
    base: Option<CanIdMap>,
    /// Write the result as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<OutputFile>,
    /// Write the configuration with the solved values, comments kept; with --compare the merged ones, if all are compatible
    #[arg(long, value_name = "CONFIG")]
    out: Option<OutputFile>,
    /// Write --out even though the parameters do not explain the data
    #[arg(long, requires = "out", conflicts_with = "update")]
    anyway: bool,
    /// Write the result as a page with plots, which needs no other file
    #[arg(long, value_name = "FILE")]
    html: Option<OutputFile>,
    /// Earlier calibrations of this unit, as `--json` wrote them from other recordings: compare, and merge if compatible
    #[arg(long, num_args = 1.., value_name = "FILE")]
    compare: Vec<String>,
    #[command(flatten)]
    update: Update,
}

fn sigma(text: &str) -> Result<f64, String> {
    let sigma = text.parse().ok().filter(|sigma| (0.0..=3600.0).contains(sigma));
    sigma.ok_or_else(|| format!("expected 0…3600 arcsec, got {text}"))
}

/// Carries it out.
///
/// # Errors
/// Input that cannot be read, manoeuvres that do not determine the parameters, files that cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let settings = ConfigArgs::from(&arguments.unit);
    let configuration = settings.read()?;
    let earlier = calibrate_compare::read(&arguments.compare)?;
    let windows = arguments.manoeuvres.as_deref().map(window::read).transpose().map_err(CommandError::input)?;
    let reference =
        arguments.reference.as_deref().map(ReferenceAttitude::read).transpose().map_err(CommandError::input)?;
    let sensors = match (&arguments.fss, &arguments.sse) {
        (Some(fss), Some(sse)) => {
            Some(AbsoluteData::read(fss, sse, configuration.sensors).map_err(CommandError::input)?)
        }
        _ => None,
    };
    let attitude_start_ns = match (&reference, &sensors) {
        (Some(reference), _) => reference.start_ns,
        (None, Some(sensors)) => start_of_sensors_ns(sensors).unwrap_or(0),
        (None, None) => 0,
    };
    let start_ns = arguments.start.map_or(attitude_start_ns, unix_ns);
    let counts = read_counts(&arguments.link, arguments.base, start_ns)?;
    refuse_other_time(reference.as_ref(), &counts)?;
    let attitude = match (&reference, &sensors) {
        (Some(reference), _) => AttitudeSource::Reference(reference, arguments.reference_sigma),
        (None, Some(sensors)) => AttitudeSource::Sensors(sensors),
        (None, None) => return Err(CommandError::input("expected --reference FILE, or --fss FILE and --sse FILE")),
    };
    if arguments.update.update {
        let results = Results { json: arguments.json.as_ref(), out: arguments.out.as_ref() };
        let believed = (&settings, &configuration);
        return update::run(&arguments.update, believed, &counts, windows.as_deref(), &attitude, &results);
    }
    let calibrated = calibrate(&configuration, &counts, windows.as_deref(), &attitude).map_err(CommandError::input)?;
    for left_out in &calibrated.left_out {
        note(format_args!("geu: left out: {left_out}\n"));
    }
    let comparison = calibrate_compare::compare(&earlier, &calibrated)?;
    let mut outputs = Vec::new();
    if let Some(file) = &arguments.json {
        let mut json = report::json(&calibrated);
        if let Some(comparison) = &comparison {
            json["comparison"] = report::comparison(&earlier, comparison);
        }
        outputs.push((file, format!("{json:#}\n")));
    }
    let is_explained = calibrated.solution.probability() >= LEAST_PROBABILITY;
    if let Some(file) = arguments.out.as_ref().filter(|_| is_explained || arguments.anyway) {
        let merged = comparison.as_ref().filter(|comparison| comparison.is_compatible());
        let solution = merged.map_or(&calibrated.solution, |comparison| &comparison.combined);
        outputs.push((file, with_solution(&settings, solution)?));
    }
    if let Some(file) = &arguments.html {
        let page = CalibrationPage {
            believed: &configuration,
            calibrated: &calibrated,
            earlier: &earlier,
            comparison: comparison.as_ref(),
            provenance: settings.provenance(arguments.inputs())?,
        };
        outputs.push((file, page.html()));
    }
    write_all(outputs)?;
    say!("{}", terminal_table(&configuration, &calibrated))?;
    if let Some(comparison) = &comparison {
        say!("\n{}", comparison_table(&earlier, comparison))?;
    }
    if is_explained {
        return Ok(());
    }
    let why = format!(
        "the sixteen parameters do not explain these data: probability {:.1e}, at least {LEAST_PROBABILITY} expected",
        calibrated.solution.probability()
    );
    match &arguments.out {
        Some(file) if arguments.anyway => {
            note(format_args!("geu: {why}; {file} is written all the same\n"));
            Ok(())
        }
        Some(file) => Err(CommandError::failed(format!("{why}; {file} is not written without --anyway"))),
        None => {
            note(format_args!("geu: {why}\n"));
            Ok(())
        }
    }
}

/// Refuses a reference whose times are not those of the link: the ends of its samples were received in UTC, and TAI,
/// GPS or TT are whole seconds off it.
fn refuse_other_time(reference: Option<&ReferenceAttitude>, counts: &AccumulatedCounts) -> Result<(), CommandError> {
    match reference.and_then(|reference| reference.time_system.as_deref()) {
        Some(system) if system != "UTC" && counts.is_received => Err(CommandError::input(format!(
            "--reference: TIME_SYSTEM: expected UTC, as the link's receive times are, got {system}: time systems are offset \
             from each other, TAI, GPS and TT from UTC by whole seconds and more; convert the ephemeris to UTC"
        ))),
        _ => Ok(()),
    }
}

impl Arguments {
    /// What was read beside the configuration, and what it is.
    fn inputs(&self) -> Vec<(&'static str, String)> {
        let links = self.link.iter().map(|name| ("recording", name.clone()));
        let others = [
            ("manoeuvres", &self.manoeuvres),
            ("reference attitude", &self.reference),
            ("sun sensor", &self.fss),
            ("star sensor", &self.sse),
        ];
        links.chain(others.into_iter().filter_map(|(what, name)| Some((what, name.clone()?)))).collect()
    }
}

/// Start of what the sun sensor saw: its first sample ends the first sample. Nothing without a sample.
pub fn start_of_sensors_ns(sensors: &AbsoluteData) -> Option<i64> {
    sensors.sun.first().map(|sample| sample.0 - SAMPLE_INTERVAL_NS)
}

/// Reads recordings as one stream of counts.
///
/// # Errors
/// Input that cannot be read, or that holds no sample.
pub fn read_counts(
    names: &[String],
    plan: Option<CanIdMap>,
    clock_start_ns: i64,
) -> Result<AccumulatedCounts, CommandError> {
    let options = DecoderOptions { plan: plan.unwrap_or_default(), ..DecoderOptions::default() };
    let (mut reader, mut counts) = (InputReader::new(options, Stop::default()), CountsReader::default());
    for name in names {
        reader.read(name, &mut counts).map_err(CommandError::input)?;
    }
    reader.finish(&mut counts).1.map_err(CommandError::input)?;
    if counts.defects() > 0 {
        let (count, input) = (counts.defects(), names.join(" "));
        note(format_args!("geu: {count} defects in {input}; `geu decode --format summary {input}` lists them\n"));
    }
    let none = || CommandError::input(format!("{}: expected samples of the unit, got none", names.join(" ")));
    counts.finish(clock_start_ns).ok_or_else(none)
}

/// The configuration with the solved values in it.
fn with_solution(settings: &ConfigArgs, solution: &Solution) -> Result<String, CommandError> {
    let (name, text) = settings.text()?;
    let mut values = settings.overrides.clone();
    values.extend(report::overrides(&solution.calibrations));
    Configuration::edited(&name, &text, &values).map_err(CommandError::input)
}
