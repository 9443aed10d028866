//! `geu replay`: a recording in place of the unit.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use clap::Args;
use geu_daemon::cadence::Speed;
use geu_daemon::link::LinkAddress;
use geu_daemon::replay::{self, Steps, refused};
use geu_daemon::{RunError, asked_to_end};
use geu_model::Configuration;
use geu_model::device::Device;
use geu_protocol::CanIdMap;
use geu_protocol::capture::Format;
use geu_protocol::excerpt::excerpt;
use geu_recording::{DecodeSummary, DecoderOptions, InputError, RowReader, no_rows_reason};
use geu_replay::{QUEUE, ReadResult, ReplayReport, ReplaySelection, ReplaySource};

use crate::command_error::{CommandError, note};
use crate::device::unit;
use crate::expectations;
use crate::input_args::input_format;
use crate::links::Links;
use crate::run::verify_links;
use crate::settings::{add_plan, can_base, duration, seed};

/// Sends a recording over links, as `geu run` sends the unit's samples, at the recorded times.
///
/// Over a link of the recorded format it is sent byte for byte, with its defects and, on CAN, with other traffic; over a link of
/// the other format its samples are encoded again, of the default unit alone. Commands are counted; replay sends no replies.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Recording that `geu decode` opens, or `-`; several are one stream, in order
    #[arg(required = true, value_name = "RECORDING")]
    recordings: Vec<String>,
    #[command(flatten)]
    links: Links,
    /// Speed of recorded time against the wall clock: a factor, or max for the speed of the readers [default: 1]
    #[arg(long, value_name = "X|max", allow_negative_numbers = true)]
    speed: Option<Speed>,
    /// Send a sample for each line on standard input; a number on the line sends that many
    #[arg(long, conflicts_with = "speed")]
    step: bool,
    /// Start offset from the first time stamp of the recording
    #[arg(long, value_name = "DURATION", allow_negative_numbers = true, value_parser = duration(0.0, 4e9))]
    from: Option<f64>,
    /// End offset from the first time stamp, exclusive
    #[arg(long, value_name = "DURATION", allow_negative_numbers = true, value_parser = duration(0.0, 4e9))]
    to: Option<f64>,
    /// Repeat without renumbering sequence or clock
    #[arg(long = "loop")]
    is_loop: bool,
    /// Shorten longer gaps between time stamps to this
    #[arg(long, value_name = "DURATION", default_value = "10", allow_negative_numbers = true, value_parser = duration(0.0, 4e9))]
    longest_gap: f64,
    /// Leave out other traffic and commands to the unit
    #[arg(long)]
    only: bool,
    /// Name or description of another unit than the default one (`geu device list`)
    #[arg(long, value_name = "NAME|FILE", conflicts_with = "base")]
    device: Option<String>,
    /// Base of the recorded CAN identifiers, hexadecimal [default: 1A0]
    #[arg(long, value_name = "ID", value_parser = can_base)]
    base: Option<CanIdMap>,
    /// Interface to send, if a capture has several [default: the first with frames of the unit]
    #[arg(long, value_name = "NAME")]
    interface: Option<String>,
    /// Format of the recordings [default: detected from their content]
    #[arg(long, value_name = "FORMAT", value_parser = input_format())]
    input_format: Option<&'static Format>,
    /// Plan of faults of links, and of expectations; t_s is the time of --from
    #[arg(long, value_name = "PLAN")]
    faults: Vec<PathBuf>,
    /// Seed of the faults' random numbers
    #[arg(long, allow_negative_numbers = true, value_parser = seed)]
    seed: Option<u64>,
    /// Start when a client is attached to a pty or over TCP
    #[arg(long)]
    wait: bool,
    #[command(flatten)]
    expectations: expectations::ExpectationReport,
}

fn ns(seconds: f64) -> i64 {
    (seconds * 1e9).round() as i64
}

/// Set at the end; stops the reading thread.
static STOP: AtomicBool = AtomicBool::new(false);

impl Arguments {
    /// Checks the arguments before anything is opened.
    fn check(&self) -> Result<(), CommandError> {
        let from_input = self.recordings.iter().any(|name| name == "-");
        if from_input && (self.is_loop || self.step) {
            let (flag, why) = match self.step {
                true => ("--step", "which gives the steps"),
                false => ("--loop", "which cannot be read twice"),
            };
            return Err(CommandError::input(format!(
                "{flag}: expected recordings in files, got -, standard input, {why}"
            )));
        }
        if let (Some(from), Some(to)) = (self.from, self.to)
            && from >= to
        {
            return Err(CommandError::input(format!("--to: expected more than the {from} of --from, got {to}")));
        }
        // A missing second recording is an error now, not after the first one.
        for name in self.recordings.iter().filter(|name| *name != "-") {
            readable(name)?;
        }
        Ok(())
    }

    fn plan(&self) -> Result<Configuration, CommandError> {
        let device = self.device.as_deref().map(unit).transpose()?.filter(|device| !device.is_iras());
        let plan =
            device.map_or_else(|| Ok(Configuration::reference()), |device| Configuration::of_device(&device, &[]));
        let mut plan = plan.map_err(CommandError::input)?;
        plan.seed = self.seed.unwrap_or(plan.seed);
        if !plan.device.is_iras() && !self.faults.is_empty() {
            let name = &plan.device.name;
            return Err(CommandError::input(format!(
                "--faults: expected the default unit, got {name}: its recorded data are sent unchanged; run the unit with `geu run --faults`"
            )));
        }
        for path in &self.faults {
            add_plan(&mut plan, path)?;
            if let Some(why) = refused(&plan.faults, &plan.expectations) {
                return Err(CommandError::input(format!("--faults {}: {why}", path.display())));
            }
        }
        Ok(plan)
    }

    fn selection(&self, device: &Arc<Device>, links: &[LinkAddress]) -> ReplaySelection {
        let is_can = |link: &LinkAddress| matches!(link, LinkAddress::Can(_));
        ReplaySelection {
            device: device.clone(),
            plan: self.base.unwrap_or_default(),
            interface: self.interface.clone().map(String::into_bytes),
            is_only: self.only,
            from_ns: ns(self.from.unwrap_or(0.0)),
            to_ns: self.to.map_or(i64::MAX, ns),
            longest_gap_ns: ns(self.longest_gap),
            carries: (links.iter().any(is_can), !links.iter().all(is_can)),
        }
    }

    /// The reason for which nothing can be sent.
    fn nothing_to_send(&self, report: &ReplayReport, summary: &DecodeSummary) -> CommandError {
        let reason = no_rows_reason(summary, self.base.unwrap_or_default(), self.input_format).unwrap_or_else(|| {
            let expected = match (self.from, self.to, report.elsewhere) {
                (_, _, elsewhere) if elsewhere > 0 => {
                    format!("another --interface, with {elsewhere} frames")
                }
                (Some(_), ..) => "an earlier --from".to_owned(),
                (None, Some(_), _) => "a later --to".to_owned(),
                (None, None, _) => "samples in it".to_owned(),
            };
            let (from_s, length_s) = (self.from.unwrap_or(0.0), report.length_ns as f64 * 1e-9);
            format!("nothing to be sent from {from_s} s on: the recording has {length_s:.1} s; expected {expected}")
        });
        CommandError::input(format!("{}: {reason}", self.recordings.join(", ")))
    }
}

fn readable(name: &str) -> Result<(), CommandError> {
    let path = Path::new(name);
    match fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(CommandError::input(format!(
            "{name}: no such file; expected a recording that `geu decode` opens, or -"
        ))),
        Ok(metadata) if metadata.is_file() => File::open(path)
            .map(drop)
            .map_err(|source| CommandError::input(InputError::Open { name: name.to_owned(), source })),
        Ok(metadata) if metadata.is_dir() => Err(CommandError::input(format!(
            "{name}: is a directory; expected a recording that `geu decode` opens, or -"
        ))),
        _ => Ok(()),
    }
}

/// Runs `geu replay`.
///
/// # Errors
/// The recording cannot be read, the plan cannot act on a recording, a link cannot be opened.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    arguments.check()?;
    let options = replay::ReplayOptions {
        links: arguments.links.addresses()?,
        speed: arguments.speed.unwrap_or(Speed::Times(1.0)),
        wait_for_client: arguments.wait,
        recorded_plan: arguments.base.unwrap_or_default(),
        plan: arguments.plan()?,
    };
    let device = &options.plan.device;
    verify_links(device, &options.links)?;
    let (sender, items) = sync_channel(QUEUE);
    let (begins, began) = sync_channel(1);
    let source = ReplaySource::new(arguments.selection(device, &options.links), sender, begins);
    let (names, format, is_loop) = (arguments.recordings.clone(), arguments.input_format, arguments.is_loop);
    let plan = options.recorded_plan;
    let decoder_options = DecoderOptions { plan, format, ..DecoderOptions::default() };
    let reader = thread::Builder::new()
        .name("geu-reading".to_owned())
        .spawn(move || geu_replay::read(source, &names, &decoder_options, is_loop, &STOP))
        .map_err(no_thread)?;
    let join = |reader: thread::JoinHandle<_>| reader.join().expect("reading does not panic");
    if began.recv().is_err() {
        let (report, summary, read): ReadResult = join(reader);
        read.map_err(CommandError::input)?;
        return Err(arguments.nothing_to_send(&report, &summary));
    }
    let steps = arguments.step.then(steps).transpose()?;
    let replayed = replay::replay(&options, items, steps, asked_to_end());
    STOP.store(true, Ordering::Relaxed);
    let (report, recorded, read) = join(reader);
    let summary = replayed.map_err(|error| match error {
        error @ (RunError::Link(_) | RunError::NoClientLink) => CommandError::input(error),
        error => CommandError::failed(error),
    })?;
    note(format_args!("{summary}{report}"));
    read.map_err(CommandError::input)?;
    if report.nothing_carried {
        return Err(arguments.nothing_to_send(&report, &recorded));
    }
    arguments.expectations.write(&summary.faults)
}

fn no_thread(error: io::Error) -> CommandError {
    CommandError::failed(format!(
        "cannot start: expected another thread, got: {error}; raise the limit of processes and threads (`ulimit -u`)"
    ))
}

/// Steps from standard input.
fn steps() -> Result<Steps, CommandError> {
    note(format_args!("geu: each line on standard input sends a sample, a number on it that many\n"));
    let (sender, steps): (SyncSender<u64>, Receiver<u64>) = sync_channel(QUEUE);
    // Waits for lines until the end of the process.
    let thread = thread::Builder::new().name("geu-steps".to_owned()).spawn(move || {
        for line in RowReader::new(io::stdin()).lines() {
            let line = match line {
                Ok(line) => line,
                Err(error) => return note(format_args!("geu: --step: standard input: {error}\n")),
            };
            let count = match line.trim() {
                "" => Ok(1),
                text => text.parse::<u64>(),
            };
            match count.ok().filter(|count| (1..=1_000_000_000).contains(count)) {
                Some(count) if sender.send(count).is_err() => return,
                Some(_) => {}
                None => note(format_args!(
                    "geu: --step: expected an empty line or a number of samples from 1 to 1000000000, got {:?}\n",
                    excerpt(&line)
                )),
            }
        }
    });
    thread.map_err(no_thread)?;
    Ok(steps)
}
