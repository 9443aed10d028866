//! `geu simulate`: the model without links, as fast as possible.

use std::path::Path;
use std::sync::atomic::Ordering::Relaxed;

use clap::Args;
use geu_archive::{FileFormat, TruthColumns};
use geu_files::interruption::stop_flag;
use geu_model::attitude::{AttitudeProfile, length_s};
use geu_model::configuration::LinkLogFormat;
use geu_model::device::Device;
use geu_model::{Configuration, Truth};
use geu_recorder::{Destination, FILES, Recorder, misses, simulate, wire_beside};
use geu_report::figures;
use indicatif::{ProgressBar, ProgressStyle};

use crate::command_error::{CommandError, note};
use crate::device::verify_link;
use crate::expectations;
use crate::output_guard::Force;
use crate::outputs::{OutputDirectory, create_directory, write};
use crate::settings::{LINK_FORMATS, LONGEST_S, LiveTruth, RunArgs, choice, duration};

/// Runs the model without links, as fast as possible, and writes the files of a recorded run.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    run: RunArgs,
    /// Directory to write into, new or empty
    #[arg(long, value_name = "DIRECTORY", required_unless_present = "svg")]
    out: Option<OutputDirectory>,
    /// Directory to draw the unit's figures into: transfer function, pivot transit, limit cycle, two weeks
    #[arg(long, value_name = "DIRECTORY")]
    svg: Option<OutputDirectory>,
    #[command(flatten)]
    force: Force,
    /// On-board time to run; without it the recorded duration, or the length of scenario or truth
    #[arg(long, value_name = "DURATION", allow_negative_numbers = true, value_parser = duration(0.0, LONGEST_S))]
    duration: Option<f64>,
    /// Format of the link [default: the recorded format, else can]
    #[arg(long, value_parser = choice(LINK_FORMATS))]
    wire: Option<LinkLogFormat>,
    /// Format of the truth [default: csv]
    #[arg(long, requires = "out", value_parser = choice(TRUTH_FORMATS))]
    format: Option<TruthFormat>,
    #[command(flatten)]
    expectations: expectations::ExpectationReport,
}

#[derive(Debug, Clone, Copy)]
enum TruthFormat {
    Csv,
    Columns(FileFormat),
}

const TRUTH_FORMATS: &[(&str, TruthFormat, &str)] = &[
    ("csv", TruthFormat::Csv, "truth.csv"),
    ("parquet", TruthFormat::Columns(FileFormat::Parquet), "truth.parquet"),
    ("arrow", TruthFormat::Columns(FileFormat::Arrow), "truth.arrow, an Arrow IPC file (Feather 2)"),
];

/// Runs `geu simulate`.
///
/// # Errors
/// The configuration is not valid, the truth does not cover the run, neither scenario nor options set an end, a file
/// cannot be written, an expectation was not met, or SIGINT or SIGTERM came before the end.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let svg = arguments.svg.as_ref().map(|svg| svg.prepare(arguments.force, figures::names())).transpose()?;
    let ready = arguments.run.read()?;
    if let Some(LiveTruth { address, .. }) = &ready.live {
        return Err(CommandError::input(format!(
            "--truth {address}: expected a file or scenario, got a simulator, which needs geu run"
        )));
    }
    let configuration = &ready.configuration;
    if arguments.svg.is_some() && !configuration.device.is_iras() {
        let name = &configuration.device.name;
        return Err(CommandError::input(format!(
            "--svg: expected the default unit, which the figures show, got {name}"
        )));
    }
    let out = match &arguments.out {
        Some(out) => {
            let out = out.claim(FILES)?;
            let destination = Destination::new(out, arguments.force.force);
            destination.check()?;
            Some((out, destination))
        }
        None => None,
    };
    // The figures come after the recording, so that both may be in one directory.
    let draw_figures = || svg.map_or(Ok(()), |directory| draw(directory, configuration));
    let Some((out, destination)) = out else { return draw_figures() };
    let recorded_s = Some(configuration.run.duration_s).filter(|&duration_s| duration_s > 0.0);
    let scenario_s = || match ready.truth {
        Truth::Scenario if !configuration.motion.is_empty() => Some(length_s(&configuration.motion)),
        Truth::Scenario => AttitudeProfile::length_s(&configuration.scenario),
        Truth::Recorded(_) | Truth::Stepped(_) => None,
    };
    let duration_s = arguments.duration.or(recorded_s).or_else(scenario_s);
    let count = ready.samples(duration_s)?.ok_or_else(|| {
        CommandError::input("the scenario has no end: expected --duration DURATION, such as 90, 10m or 2h")
    })?;
    let wire = wire_beside(arguments.wire.or(configuration.run.wire), &[], &configuration.device);
    verify_wire(&configuration.device, wire)?;
    if let Some(reason) = misses(configuration, wire) {
        return Err(CommandError::input(format!("{reason}; name its `link`, or record another --wire")));
    }
    let truth_table = match arguments.format {
        Some(TruthFormat::Columns(format)) => {
            Some((Box::new(TruthColumns::new(out, format, configuration)) as Box<_>, count))
        }
        Some(TruthFormat::Csv) | None => None,
    };
    let mut recorder = Recorder::create(&destination, configuration, &ready.truth, wire, &[], truth_table)?;
    let stop = stop_flag().map_err(|error| CommandError::failed(format!("signals cannot be watched: {error}")))?;
    let style = ProgressStyle::with_template("{bar:40} {percent:>3} %  {elapsed} elapsed, {eta} left");
    let bar = ProgressBar::new(count).with_style(style.expect("a template"));
    let faults = simulate(configuration, &ready.truth, count, &mut recorder, |done| {
        bar.set_position(done);
        !stop.load(Relaxed)
    })
    .map_err(CommandError::failed)?;
    bar.finish_and_clear();
    let samples = recorder.samples();
    recorder.finish().map_err(CommandError::failed)?;
    let (recorded_s, asked_s, out) =
        (configuration.device.on_board_s(samples), configuration.device.on_board_s(count), out.display());
    if samples < count {
        return Err(CommandError::failed(format!(
            "interrupted after {recorded_s} s of {asked_s} s: {out} is a complete recording of these"
        )));
    }
    note(format_args!("geu: wrote {recorded_s} s into {out}\n"));
    draw_figures()?;
    arguments.expectations.write(&faults)
}

/// Refuses a format of the link that the unit does not have.
fn verify_wire(device: &Device, wire: LinkLogFormat) -> Result<(), CommandError> {
    verify_link(device)?;
    match device.is_iras() || device.frames(wire == LinkLogFormat::Can).is_some() {
        true => Ok(()),
        false => Err(CommandError::input(format!("--wire {}: {} has no such link", wire.name(), device.name))),
    }
}

/// Writes every figure of the unit into a directory, which is created if necessary.
fn draw(directory: &Path, configuration: &Configuration) -> Result<(), CommandError> {
    create_directory(directory)?;
    for (name, text) in figures::figures(configuration) {
        let path = directory.join(name);
        write(&path, text)?;
        note(format_args!("{}\n", path.display()));
    }
    Ok(())
}
