//! `geu run`: the emulator.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use clap::Args;
use geu_daemon::cadence::Speed;
use geu_daemon::control::{ControlListener, DEFAULT_ADDRESS};
use geu_daemon::link::LinkAddress;
use geu_daemon::{Recording, RunError, RunOptions, asked_to_end};
use geu_model::configuration::{LinkLogFormat, unix_ns};
use geu_model::device::Device;
use geu_model::fault::catalogue::Transport;
use geu_model::units::duration_s;
use geu_protocol::CanIdMap;
use geu_recorder::{Destination, FILES};

use crate::command_error::{CommandError, note};
use crate::device::verify_link;
use crate::expectations;
use crate::links::Links;
use crate::output_guard::Force;
use crate::outputs::OutputDirectory;
use crate::settings::{LINK_FORMATS, LONGEST_S, RunArgs, choice, duration};
use crate::token::Token;

/// Runs the emulator: the unit on a pty, a serial port, a CAN interface or TCP, or several of them at once.
///
/// Without a link it opens a pty at $XDG_RUNTIME_DIR/geu0, else /tmp/geu0. `ready LINK` is printed for each link,
/// and `ready control http://…` for the control interface.
#[derive(Args, Debug, Default)]
pub struct Arguments {
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    links: Links,
    /// Record this run into a new or empty directory, with the files of `geu simulate`
    #[arg(long, value_name = "DIRECTORY")]
    record: Option<OutputDirectory>,
    #[command(flatten)]
    force: Force,
    /// Format of the link in the recording [default: that of the first link]
    #[arg(long, requires = "record", value_parser = choice(LINK_FORMATS))]
    wire: Option<LinkLogFormat>,
    /// Speed of on-board time against the wall clock: a factor, or max for the speed of model and readers [default: 1]
    #[arg(long, value_name = "X|max", allow_negative_numbers = true)]
    speed: Option<Speed>,
    /// On-board time to run [default: that of a truth from a file, else without end]
    #[arg(long, value_name = "DURATION", allow_negative_numbers = true, value_parser = duration(0.0, LONGEST_S))]
    duration: Option<f64>,
    /// Delay the first sample until a client is attached to a pty or over TCP
    #[arg(long)]
    wait: bool,
    /// Longest wait for a simulator of --truth, wall clock: for its first sample, and with --speed max for each
    /// sample. Then the run ends with exit code 1 [default: forever]
    #[arg(long, value_name = "DURATION|forever", allow_negative_numbers = true, value_parser = truth_wait)]
    truth_wait: Option<TruthWait>,
    /// Spin before each deadline instead of sleeping: less lateness, more CPU time
    #[arg(long, value_name = "MICROSECONDS", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=10_000))]
    spin: u32,
    /// Request real-time priority (SCHED_FIFO), and print the result
    #[arg(long)]
    realtime: bool,
    #[command(flatten)]
    expectations: expectations::ExpectationReport,
    /// Control interface and bench page [default: 127.0.0.1:8470, or the next port that is free]; beyond loopback a
    /// client must send a token: `Authorization: Bearer TOKEN`, or `?token=TOKEN`
    #[arg(long, value_name = "ADDRESS|off")]
    control: Option<String>,
    #[command(flatten)]
    token: Token,
}

/// Runs `geu run`.
///
/// # Errors
/// The configuration is not valid, a link cannot be opened, the recording cannot start or is not complete.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let mut ready = arguments.run.read()?;
    let record = arguments.record.as_ref().map(|directory| directory.claim(FILES)).transpose()?;
    if arguments.run.start.is_none() && ready.configuration.start_unix_ns == 0 {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_err(CommandError::failed)?;
        ready.configuration.start_unix_ns = unix_ns(now.as_secs_f64());
    }
    if arguments.truth_wait.is_some() && ready.live.is_none() {
        let got = ready.configuration.run.truth.as_deref().unwrap_or("scenario");
        return Err(CommandError::input(format!(
            "--truth-wait: expected a simulator as the truth, --truth udp://HOST:PORT, tcp://HOST:PORT or 42://HOST:PORT, got {got}"
        )));
    }
    let options = RunOptions {
        links: arguments.links.addresses()?,
        speed: arguments.speed.unwrap_or(Speed::Times(1.0)),
        samples: ready.samples(arguments.duration)?,
        spin: Duration::from_micros(arguments.spin.into()),
        realtime: arguments.realtime,
        wait_for_client: arguments.wait,
        live: ready.live.as_ref().map(|live| live.source.clone()),
        truth_wait: arguments.truth_wait.and_then(|TruthWait(limit)| limit),
    };
    let open: Vec<Transport> = options.links.iter().map(|link| link.kind()).collect();
    verify_links(&ready.configuration.device, &options.links)?;
    if let Some(reason) = ready.configuration.faults.iter().find_map(|fault| fault.misses(&open)) {
        return Err(CommandError::input(reason));
    }
    let listener = match arguments.control.as_deref() {
        Some("off") => None,
        address => {
            let (wanted, token) = (address.unwrap_or(DEFAULT_ADDRESS), arguments.token.read()?);
            Some(ControlListener::open(wanted, address.is_none(), token).map_err(CommandError::input)?)
        }
    };
    let recording = record.map(|directory| Recording {
        destination: Destination::new(directory, arguments.force.force),
        wire: arguments.wire,
    });
    let summary =
        geu_daemon::run(&ready.configuration, &ready.truth, &options, recording.as_ref(), listener, asked_to_end())
            .map_err(|error| match error {
                RunError::Link(error) => CommandError::input(error),
                RunError::Record(error) => CommandError::from(error),
                error @ (RunError::NoClientLink | RunError::Truth(_) | RunError::Unavailable(_)) => {
                    CommandError::input(error)
                }
                error => CommandError::failed(error),
            })?;
    note(format_args!("{summary}"));
    let truth = summary.truth_failure.map(|failure| failure.to_string());
    let recording = summary.recording.err().map(|error| error.to_string());
    truth.into_iter().chain(recording).fold(arguments.expectations.write(&summary.faults), |end, problem| {
        Err(match end {
            Ok(()) => CommandError::failed(problem),
            Err(failure) => failure.and(problem),
        })
    })
}

/// Refuses links that the unit does not have.
pub fn verify_links(device: &Device, links: &[LinkAddress]) -> Result<(), CommandError> {
    verify_link(device)?;
    if device.is_iras() {
        return Ok(());
    }
    for link in links {
        let is_can = link.kind() == Transport::Can;
        if device.frames(is_can).is_none() {
            let (name, others) = (&device.name, if is_can { "--pty, --serial or --tcp" } else { "--can" });
            let link = link.kind().name();
            return Err(CommandError::input(format!("{name}: expected a link that it has, {others}, got --{link}")));
        }
        if let (LinkAddress::Serial(address), Some(serial)) = (link, &device.serial)
            && let Some(baud) = address.baud
            && serial.line_s(baud) > device.interval_s
        {
            let (port, line_s, interval_s) = (&address.device, serial.line_s(baud), device.interval_s);
            return Err(CommandError::input(format!(
                "--serial {port}:{baud}: expected a rate at which the frames of a sample take at most its interval of {interval_s} s, got {line_s:.6} s"
            )));
        }
        if let LinkAddress::Can(address) = link
            && address.plan != CanIdMap::default()
        {
            let message =
                format!("--can {}: expected no base: the identifiers are in the description", address.interface);
            return Err(CommandError::input(message));
        }
    }
    Ok(())
}

/// Longest wait for a simulator; `None`: without limit.
#[derive(Debug, Clone, Copy)]
struct TruthWait(Option<Duration>);

fn truth_wait(text: &str) -> Result<TruthWait, String> {
    if text == "forever" {
        return Ok(TruthWait(None));
    }
    let seconds =
        duration_s(text, 0.001, 1e6).map_err(|error| error.replacen("expected ", "expected forever, or ", 1))?;
    Ok(TruthWait(Some(Duration::from_secs_f64(seconds))))
}
