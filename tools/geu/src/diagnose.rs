//! `geu diagnose`: finds the effect that is missing in the model, and its amplitude.

use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use geu_diagnosis::outcome::{Class, DiagnosedEffect, Diagnosis};
use geu_diagnosis::{DiagnosisOptions, Thresholds, Verdict, diagnose_device, diagnose_rows, report};
use geu_model::Configuration;
use geu_protocol::capture::{RecordPosition, Timestamp};
use geu_recording::{DecoderOptions, Defect, DefectKind, ReceivedSample, Reference, Sink, read_text};
use geu_report::diagnosis::{DiagnosisPage, text};
use indicatif::ProgressBar;

use crate::calibrate::{read_device, read_recordings};
use crate::command_error::{CommandError, note, say};
use crate::diagnose_magnitudes;
use crate::evaluation_args::EvaluationArgs;
use crate::outputs::OutputFile;
use crate::settings::{ConfigArgs, NamedConfigArgs};

/// Defects of a recording that are listed; further ones are counted.
pub const MAX_DEFECTS: usize = 100_000;

/// Finds the effect that is missing in the model, adds it to the model and reports the reduction of the residual.
///
/// Exit 3 if a part of the residual is not explained by any effect of the model.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    unit: NamedConfigArgs,
    /// Unit of the recording: a name of `geu device list`, or a description
    #[arg(long, alias = "gyro-csv", value_name = "NAME|FILE")]
    device: Option<String>,
    /// Recording of the link, CAN or serial, or an archive of `geu decode --format parquet`; several are one stream
    #[arg(long, required = true, num_args = 1.., value_name = "FILE")]
    link: Vec<String>,
    /// Reference attitude: reference.csv or a CCSDS attitude ephemeris; with --device also magnitudes of the rate
    #[arg(long, value_name = "FILE")]
    reference: String,
    #[command(flatten)]
    evaluation: EvaluationArgs,
    /// Write the configuration with the found effects, its comments kept
    #[arg(long, value_name = "CONFIG")]
    out: Option<OutputFile>,
    /// Write a configuration with a scenario that, recorded anew and diagnosed by itself, separates an effect from an alternative that
    /// this recording does not exclude; for `geu run` and `geu simulate`. Without such a scenario no file is written
    #[arg(long, value_name = "CONFIG")]
    next_manoeuvre: Option<OutputFile>,
    /// Seed of the simulated recordings without effects that set the thresholds
    #[arg(long, default_value_t = 1, value_parser = crate::settings::seed)]
    seed: u64,
    /// Print the whole chain of reasoning: all alternatives, tests and places of the residual
    #[arg(long)]
    verbose: bool,
    /// Compute the thresholds again, without the cache directory
    #[arg(long)]
    no_cache: bool,
}

/// Runs `geu diagnose`.
///
/// # Errors
/// An input cannot be read, results cannot be written; exit 3 if the residual is not explained.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let settings = ConfigArgs { device: arguments.device.clone(), ..ConfigArgs::from(&arguments.unit) };
    let mut nominal = settings.read_of_any()?;
    // Prescribed rates are of a run; here the unit alone counts.
    nominal.motion.clear();
    let reference = match Reference::read(&arguments.reference, &nominal.device).map_err(CommandError::input)? {
        Reference::Attitude(reference) => reference,
        Reference::Magnitudes(rows) => {
            arguments.verify_magnitudes()?;
            let (device, json) = (&nominal.device, arguments.evaluation.json.as_ref());
            let names = (&arguments.link[..], arguments.evaluation.options()?, arguments.reference.as_str());
            return diagnose_magnitudes::run(device, names, &rows, arguments.seed, json);
        }
    };
    let windows = arguments.evaluation.windows()?;
    let bar = ProgressBar::new_spinner();
    bar.enable_steady_tick(Duration::from_millis(200));
    let cache = Cache::new(arguments.no_cache);
    let options = DiagnosisOptions {
        seed: arguments.seed,
        clock_start_ns: arguments.evaluation.start_ns(reference.start_ns),
        manoeuvres: windows.as_deref(),
        plans_manoeuvres: true,
        known: &|key| cache.get(key),
        keep: &|key, thresholds| cache.put(key, thresholds),
        progress: &|what| bar.set_message(what.to_owned()),
    };
    let diagnosis = match nominal.device.is_iras() {
        true => {
            let recording = DecodedRecording::read(&arguments.link, arguments.evaluation.options()?)?;
            arguments.evaluation.note_start(&arguments.link, recording.rows.iter().any(|row| row.is_received));
            diagnose_rows(&recording.rows, &recording.defects(), &nominal, &reference, &options)
        }
        false => {
            let recording = read_device(&arguments.link, &arguments.evaluation, &nominal.device, &reference)?;
            diagnose_device(recording, &nominal, &reference, &options)
        }
    };
    bar.finish_and_clear();
    let diagnosis = diagnosis.map_err(|error| CommandError::input(format!("{}: {error}", arguments.link.join(" "))))?;
    // The result is printed and each file is written also if another of these steps fails.
    let text = if arguments.verbose { text::whole(&diagnosis) } else { text::summary(&diagnosis) };
    let printed = say!("{}", text.trim_end());
    let json = || {
        let Some(file) = &arguments.evaluation.json else { return Ok(()) };
        file.write(format!("{:#}\n", report::json(&diagnosis)))
    };
    let html = || {
        let Some(file) = &arguments.evaluation.html else { return Ok(()) };
        let reference = ("reference attitude", &Some(arguments.reference.clone()));
        let provenance = settings.provenance(arguments.evaluation.inputs(&arguments.link, &[reference]))?;
        file.write(DiagnosisPage { diagnosis: &diagnosis, provenance }.html())
    };
    let out = || {
        let Some(file) = &arguments.out else { return Ok(()) };
        file.write(updated_configuration(file, &settings, &diagnosis, &arguments.link)?)
    };
    let next = || {
        let Some(file) = &arguments.next_manoeuvre else { return Ok(()) };
        let Some(text) = next_manoeuvre(file, &nominal, &diagnosis) else {
            note(format_args!("geu: {file}: not written: no manoeuvre separates an effect from an alternative\n"));
            return Ok(());
        };
        file.write(text)
    };
    let mut failures = [json(), html(), out(), next(), printed].into_iter().filter_map(Result::err);
    if let Some(first) = failures.next() {
        failures.for_each(|further| {
            let _ = further.report();
        });
        return Err(first);
    }
    if diagnosis.verdict == Verdict::Unexplained { Err(CommandError::unexplained()) } else { Ok(()) }
}

impl Arguments {
    /// Refuses options that have no meaning with a reference of magnitudes.
    ///
    /// # Errors
    /// There are such options.
    fn verify_magnitudes(&self) -> Result<(), CommandError> {
        let Arguments { unit, evaluation, .. } = self;
        let given = [
            ("--config", unit.config.is_some()),
            ("--set", !unit.overrides.is_empty()),
            ("--manoeuvres", evaluation.manoeuvres.is_some()),
            ("--start", evaluation.start.is_some()),
            ("--base", evaluation.base.is_some()),
            ("--html", evaluation.html.is_some()),
            ("--out", self.out.is_some()),
            ("--next-manoeuvre", self.next_manoeuvre.is_some()),
            ("--verbose", self.verbose),
        ];
        let given: Vec<&str> = given.into_iter().filter(|(_, is_given)| *is_given).map(|(name, _)| name).collect();
        match given.is_empty() {
            true => Ok(()),
            false => Err(CommandError::input(format!(
                "{}: a reference of magnitudes: expected a command without {}, got {}; these need rates, turns or attitudes",
                self.reference,
                if given.len() == 1 { "this option" } else { "these options" },
                given.join(", ")
            ))),
        }
    }
}

/// The configuration with the scenario that separates an effect from an alternative; `None` if no manoeuvre does.
fn next_manoeuvre(file: &OutputFile, nominal: &Configuration, diagnosis: &Diagnosis) -> Option<String> {
    let (entry, other, next) = diagnosis.next_manoeuvre()?;
    let (minutes, sigma) = ((next.duration_s / 60.0).ceil(), next.sigma);
    let expected = if next.is_sure() { "expected" } else { "expected, the most that a manoeuvre reaches:" };
    let other = report::alternative_name(entry, other);
    Some(format!(
        "# A new recording of this scenario ({minutes:.0} min), diagnosed by itself, separates\n\
         #     {}\n#     from {other}\n# {expected} by {sigma:.1} sigma. It is that of the unit; or, simulated:\n\
         #     geu simulate {file} --out DIRECTORY\n\
         #     geu diagnose --config {file} --link DIRECTORY/link.log --reference DIRECTORY/reference.csv\n\n{}",
        report::heading(entry),
        next.configuration(nominal).to_toml(false)
    ))
}

/// The configuration with the found effects, each with a comment on recording and accuracy.
fn updated_configuration(
    file: &OutputFile,
    settings: &ConfigArgs,
    diagnosis: &Diagnosis,
    link: &[String],
) -> Result<String, CommandError> {
    let device = &settings.read_of_any()?.device;
    let assignments = |entry: &DiagnosedEffect| entry.assignments(&diagnosis.configuration);
    // The found values may exceed the limits of the model.
    let refused = |error| CommandError::failed(format!("{file}: not written: with the found effects, {error}"));
    let (name, text) = settings.text()?;
    let values = settings.overrides.iter().cloned().chain(diagnosis.entries.iter().flat_map(assignments));
    let text = Configuration::edited(&name, &text, &values.collect::<Vec<_>>()).map_err(refused)?;
    let link = link.join(" ");
    let commented = |entry: &DiagnosedEffect| {
        let values = entry.parameters.iter().map(|number| format!("{} {}", number.name, report::with_sigma(number)));
        let what = if entry.class == Class::Recalibration { "recalibrated" } else { "found" };
        let comment = format!("{what} on {link}: {}", values.collect::<Vec<_>>().join(", "));
        let paths = assignments(entry).into_iter().filter_map(|own| Some(own.split_once('=')?.0.trim().to_owned()));
        paths.map(|path| (path, comment.clone())).collect::<Vec<_>>()
    };
    let comments: Vec<_> = diagnosis.entries.iter().flat_map(commented).collect();
    let text = Configuration::commented(&text, &comments);
    Configuration::parse_for(Some(device), &name, &text, &[]).map_err(refused)?;
    Ok(text)
}

/// Rows and defects of a recording.
#[derive(Default)]
struct DecodedRecording {
    /// Samples.
    rows: Vec<ReceivedSample>,
    defects: Vec<KeptDefect>,
    /// Defects that are not listed.
    further: u64,
}

/// A defect without its bytes: input, place, kind, time, samples lost.
type KeptDefect = (String, RecordPosition, DefectKind, Option<Timestamp>, u64);

impl Sink for DecodedRecording {
    fn row(&mut self, row: &ReceivedSample) {
        self.rows.push(*row);
    }

    fn defect(&mut self, defect: &Defect) {
        if self.defects.len() < MAX_DEFECTS {
            self.defects.push((defect.input.to_owned(), defect.place, defect.kind, defect.time, defect.lost));
        } else {
            self.further += 1;
        }
    }
}

impl DecodedRecording {
    /// Reads recordings as one stream.
    ///
    /// # Errors
    /// An input cannot be read.
    fn read(names: &[String], options: DecoderOptions) -> Result<DecodedRecording, CommandError> {
        let mut recording = DecodedRecording::default();
        read_recordings(names, options, &mut recording)?;
        if recording.further > 0 {
            let further = recording.further;
            note(format_args!(
                "geu: {MAX_DEFECTS} defects are listed, {further} more are not; `geu decode` lists all\n"
            ));
        }
        Ok(recording)
    }

    /// The defects, without their bytes.
    fn defects<'a>(&'a self) -> Vec<Defect<'a>> {
        let defect = |(input, place, kind, time, lost): &'a KeptDefect| Defect {
            input,
            place: *place,
            kind: *kind,
            bytes: &[],
            time: *time,
            lost: *lost,
        };
        self.defects.iter().map(defect).collect()
    }
}

/// Thresholds in the user's cache directory; read and write failures are ignored.
struct Cache {
    directory: Option<PathBuf>,
}

impl Cache {
    fn new(is_off: bool) -> Cache {
        let variable = |name: &str| std::env::var_os(name).filter(|path| !path.is_empty()).map(PathBuf::from);
        let home = || variable("HOME").map(|home| home.join(".cache"));
        let directory = variable("XDG_CACHE_HOME").filter(|path| path.is_absolute()).or_else(home);
        Cache { directory: directory.filter(|_| !is_off).map(|directory| directory.join("geu").join("thresholds")) }
    }

    fn get(&self, key: u64) -> Option<Thresholds> {
        let text = read_text(&self.directory.as_ref()?.join(format!("{key:016x}.json"))).ok()?;
        serde_json::from_str(&text).ok()
    }

    fn put(&self, key: u64, thresholds: &Thresholds) {
        let Some(directory) = &self.directory else { return };
        let path = directory.join(format!("{key:016x}.json"));
        let kept = fs::create_dir_all(directory)
            .and_then(|()| geu_files::write_whole(&path, serde_json::json!(thresholds).to_string()));
        if let Err(error) = kept {
            note(format_args!("geu: {}: thresholds cannot be stored: {error}\n", directory.display()));
        }
    }
}
