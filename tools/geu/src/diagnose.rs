//! `geu diagnose`: where model and measurement part, which effect is missing, how large it is.

use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use geu_calibration::window;
use geu_diagnosis::outcome::{Class, DiagnosedEffect, Diagnosis};
use geu_diagnosis::{DiagnosisOptions as Diagnosing, Thresholds, Verdict, diagnose_rows, report};
use geu_model::Configuration;
use geu_model::configuration::unix_ns;
use geu_protocol::CanIdMap;
use geu_protocol::capture::{RecordPosition, Timestamp};
use geu_recording::{
    DecoderOptions, Defect, DefectKind, InputReader, ReceivedSample, ReferenceAttitude, Sink, Stop, read_text,
};
use geu_report::diagnosis::DiagnosisPage;
use indicatif::ProgressBar;

use crate::diagnose_rates::{self, RatesArguments};
use crate::failure::{CommandError, note, say};
use crate::outputs::OutputFile;
use crate::settings::{ConfigArgs, NamedSettings};

/// Defects of a recording that are listed; a broken one has millions, and how many more there are is told.
const MOST_DEFECTS: usize = 100_000;

/// Finds where model and measurement part, names the missing effect, adds it to the model and shows the gap shrink.
///
/// Exit 3 where something is left that no effect of the model explains.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    unit: NamedSettings,
    /// Recording of the link, CAN or serial; several are one stream
    #[arg(long, required_unless_present = "gyro_csv", num_args = 1.., value_name = "FILE")]
    link: Vec<String>,
    /// Reference attitude: reference.csv or a CCSDS attitude ephemeris
    #[arg(long, value_name = "FILE")]
    reference: String,
    /// Take plain CSV of any gyros instead, as this file describes it: columns, units, interval, reference (configs/suchai3.toml is
    /// one); --reference is then a CSV with t_s and rate_arcsec_s or rate_x_arcsec_s…, or the table that the description tells
    #[arg(long, value_name = "DESCRIPTION", conflicts_with_all = ["config", "overrides", "manoeuvres", "start", "base", "html", "out"])]
    gyro_csv: Option<PathBuf>,
    /// Manoeuvres that residuals are told by, CSV with the columns manoeuvre,start_s,end_s [default: cut where the motion changes]
    #[arg(long, value_name = "FILE")]
    manoeuvres: Option<String>,
    /// Time at which the unit's clock was 0, for recordings without receive times [default: start of the reference]
    #[arg(long, value_name = "UNIX_SECONDS", allow_negative_numbers = true, value_parser = crate::settings::start)]
    start: Option<f64>,
    /// Base of the CAN identifiers, hexadecimal
    #[arg(long, value_name = "ID", value_parser = crate::settings::can_base)]
    base: Option<CanIdMap>,
    /// Write the result as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<OutputFile>,
    /// Write the result as a page with plots, which needs no other file
    #[arg(long, value_name = "FILE")]
    html: Option<OutputFile>,
    /// Write the configuration with what was found, its comments kept
    #[arg(long, value_name = "CONFIG")]
    out: Option<OutputFile>,
    /// Seed of the recordings with nothing hidden that set the thresholds
    #[arg(long, default_value_t = 1, value_parser = crate::settings::seed)]
    seed: u64,
    /// Set the thresholds anew, without those kept in the cache directory
    #[arg(long)]
    no_cache: bool,
}

/// Runs the command.
///
/// # Errors
/// Input that cannot be read, results that cannot be written; exit 3 where something is left unexplained.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    if let Some(gyro_csv) = &arguments.gyro_csv {
        return diagnose_rates::run(&RatesArguments {
            gyro_csv,
            link: &arguments.link,
            reference: &arguments.reference,
            seed: arguments.seed,
            json: arguments.json.as_ref(),
        });
    }
    let settings = ConfigArgs::from(&arguments.unit);
    let believed = settings.read()?;
    let reference = ReferenceAttitude::read(&arguments.reference).map_err(CommandError::input)?;
    let recording = DecodedRecording::read(&arguments.link, arguments.base)?;
    let windows = arguments.manoeuvres.as_deref().map(window::read).transpose().map_err(CommandError::input)?;
    let bar = ProgressBar::new_spinner();
    bar.enable_steady_tick(Duration::from_millis(200));
    let cache = Cache::new(arguments.no_cache);
    let diagnosing = Diagnosing {
        seed: arguments.seed,
        clock_start_ns: arguments.start.map_or(reference.start_ns, unix_ns),
        manoeuvres: windows.as_deref(),
        known: &|key| cache.get(key),
        keep: &|key, thresholds| cache.put(key, thresholds),
        progress: &|what| bar.set_message(what.to_owned()),
    };
    let diagnosis = diagnose_rows(&recording.rows, &recording.defects(), &believed, &reference, &diagnosing);
    bar.finish_and_clear();
    let diagnosis = diagnosis.map_err(|error| CommandError::input(format!("{}: {error}", arguments.link.join(" "))))?;
    // What was found is told whatever becomes of the files, and each of these whatever becomes of the others.
    let said = say!("{}", report::text(&diagnosis).trim_end());
    let json =
        || arguments.json.as_ref().map_or(Ok(()), |file| file.write(format!("{:#}\n", report::json(&diagnosis))));
    let html = || {
        let Some(file) = &arguments.html else { return Ok(()) };
        let page = DiagnosisPage { diagnosis: &diagnosis, provenance: settings.provenance(arguments.inputs())? };
        file.write(page.html())
    };
    let out = || {
        let Some(file) = &arguments.out else { return Ok(()) };
        file.write(written(file, &settings, &diagnosis, &arguments.link)?)
    };
    let mut failures = [json(), html(), out(), said].into_iter().filter_map(Result::err);
    if let Some(first) = failures.next() {
        failures.for_each(|further| {
            let _ = further.report();
        });
        return Err(first);
    }
    if diagnosis.verdict == Verdict::Unexplained { Err(CommandError::unexplained()) } else { Ok(()) }
}

impl Arguments {
    /// What is read, what it is and its name.
    fn inputs(&self) -> Vec<(&'static str, String)> {
        let links = self.link.iter().map(|name| ("recording", name.clone()));
        let reference = ("reference attitude", self.reference.clone());
        let manoeuvres = self.manoeuvres.iter().map(|name| ("manoeuvres", name.clone()));
        links.chain([reference]).chain(manoeuvres).collect()
    }
}

/// The configuration with all that was found, each with a comment that says where and how well.
fn written(
    file: &OutputFile,
    settings: &ConfigArgs,
    diagnosis: &Diagnosis,
    link: &[String],
) -> Result<String, CommandError> {
    let assignments = |entry: &DiagnosedEffect| entry.assignments(&diagnosis.configuration);
    let (name, text) = settings.text()?;
    let mut values = settings.overrides.clone();
    values.extend(diagnosis.entries.iter().flat_map(assignments));
    let link = link.join(" ");
    let commented = |entry: &DiagnosedEffect| {
        let told = entry.parameters.iter().map(|number| format!("{} {}", number.name, report::with_sigma(number)));
        let what = if entry.class == Class::Recalibration { "recalibrated" } else { "found" };
        let comment = format!("{what} on {link}: {}", told.collect::<Vec<_>>().join(", "));
        let paths = assignments(entry).into_iter().filter_map(|own| Some(own.split_once('=')?.0.trim().to_owned()));
        paths.map(|path| (path, comment.clone())).collect::<Vec<_>>()
    };
    let comments: Vec<_> = diagnosis.entries.iter().flat_map(commented).collect();
    // What was found may lie beyond what the model is good for.
    let refused = |error| CommandError::failed(format!("{file}: not written: with what was found, {error}"));
    let text = Configuration::edited(&name, &text, &values).map_err(refused)?;
    let text = Configuration::commented(&text, &comments);
    // What is written is what others read.
    Configuration::parse(&name, &text, &[]).map_err(refused)?;
    Ok(text)
}

/// Rows and defects of a recording.
#[derive(Default)]
pub struct DecodedRecording {
    /// Samples.
    pub rows: Vec<ReceivedSample>,
    found: Vec<Found>,
    beyond: u64,
}

/// A defect without its bytes: input, place, kind, time, samples lost.
type Found = (String, RecordPosition, DefectKind, Option<Timestamp>, u64);

impl Sink for DecodedRecording {
    fn row(&mut self, row: &ReceivedSample) {
        self.rows.push(*row);
    }

    fn defect(&mut self, defect: &Defect) {
        if self.found.len() < MOST_DEFECTS {
            self.found.push((defect.input.to_owned(), defect.place, defect.kind, defect.time, defect.lost));
        } else {
            self.beyond += 1;
        }
    }
}

impl DecodedRecording {
    /// Reads recordings as one stream.
    ///
    /// # Errors
    /// Input that cannot be read.
    pub fn read(names: &[String], plan: Option<CanIdMap>) -> Result<DecodedRecording, CommandError> {
        let options = DecoderOptions { plan: plan.unwrap_or_default(), ..DecoderOptions::default() };
        let (mut reader, mut recording) = (InputReader::new(options, Stop::default()), DecodedRecording::default());
        for name in names {
            reader.read(name, &mut recording).map_err(CommandError::input)?;
        }
        reader.finish(&mut recording).1.map_err(CommandError::input)?;
        if recording.beyond > 0 {
            let beyond = recording.beyond;
            note(format_args!("geu: {MOST_DEFECTS} defects are listed, {beyond} more are not; `geu decode` has all\n"));
        }
        Ok(recording)
    }

    /// Its defects, without their bytes.
    pub fn defects<'a>(&'a self) -> Vec<Defect<'a>> {
        let of = |(input, place, kind, time, lost): &'a Found| Defect {
            input,
            place: *place,
            kind: *kind,
            bytes: &[],
            time: *time,
            lost: *lost,
        };
        self.found.iter().map(of).collect()
    }
}

/// Thresholds in the user's cache directory; a cache that cannot be read or written is none.
struct Cache {
    directory: Option<PathBuf>,
}

impl Cache {
    fn new(is_off: bool) -> Cache {
        let of = |name: &str| std::env::var_os(name).filter(|path| !path.is_empty()).map(PathBuf::from);
        let home = || of("HOME").map(|home| home.join(".cache"));
        let directory = of("XDG_CACHE_HOME").filter(|path| path.is_absolute()).or_else(home);
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
            note(format_args!("geu: {}: thresholds cannot be kept: {error}\n", directory.display()));
        }
    }
}
