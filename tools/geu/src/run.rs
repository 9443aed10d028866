//! `geu run`: the emulator.

use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use clap::Args;
use geu_daemon::cadence::Speed;
use geu_daemon::control::{DEFAULT_ADDRESS, Door};
use geu_daemon::link::LinkAddress;
use geu_daemon::record::Recorder;
use geu_daemon::{RunError, Settings, asked_to_end};
use geu_model::configuration::unix_ns;
use geu_model::fault::catalogue::LinkKind;

use crate::expectations;
use crate::failure::{Failure, note};
use crate::links::Links;
use crate::settings::{LONGEST_S, RunSettings, Wire, half_seconds};
use crate::token::Token;

/// Runs the emulator: the unit on a pty, a serial port, a CAN interface or TCP, or several of them at once.
///
/// Without a link it stands on a pty at $XDG_RUNTIME_DIR/geu0, else /tmp/geu0. `ready LINK` is printed for each,
/// and `ready control http://…` for the control interface.
#[derive(Args, Debug, Default)]
pub struct Arguments {
    #[command(flatten)]
    run: RunSettings,
    #[command(flatten)]
    links: Links,
    /// Writes there what `geu simulate` writes, for this run
    #[arg(long, value_name = "DIRECTORY")]
    record: Option<PathBuf>,
    /// Form of the link in the recording [default: the configuration's, else can]
    #[arg(long, requires = "record")]
    wire: Option<Wire>,
    /// On-board time against the wall clock: a factor, or max for as fast as model and readers go [default: 1]
    #[arg(long, value_name = "X|max", allow_negative_numbers = true)]
    speed: Option<Speed>,
    /// Ends after so much on-board time; on a truth from a file it ends with the truth
    #[arg(long, value_name = "DURATION", allow_negative_numbers = true, value_parser = crate::settings::duration(0.0, LONGEST_S))]
    duration: Option<f64>,
    /// Holds the first half second back until a client is attached to a pty or over TCP
    #[arg(long)]
    wait: bool,
    /// Spins before each deadline instead of sleeping: less late, for CPU time
    #[arg(long, value_name = "MICROSECONDS", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=10_000))]
    spin: u32,
    /// Asks for real-time priority (SCHED_FIFO), and says whether it was granted
    #[arg(long)]
    realtime: bool,
    #[command(flatten)]
    expectations: expectations::Report,
    /// Control interface and bench page [default: 127.0.0.1:8470, or the next port that is free]; beyond loopback it lets in
    /// who shows a token: `Authorization: Bearer TOKEN`, or `?token=TOKEN`
    #[arg(long, value_name = "ADDRESS|off")]
    control: Option<String>,
    #[command(flatten)]
    token: Token,
}

/// Carries it out.
///
/// # Errors
/// A configuration that cannot be run, a link that cannot be opened, a recording that cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    arguments.expectations.check()?;
    let mut ready = arguments.run.read()?;
    if arguments.run.start.is_none() && ready.configuration.start_unix_ns == 0 {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_err(Failure::failed)?;
        ready.configuration.start_unix_ns = unix_ns(now.as_secs_f64());
    }
    let settings = Settings {
        links: arguments.links.addresses(),
        speed: arguments.speed.unwrap_or(Speed::Times(1.0)),
        half_seconds: ready.half_seconds(arguments.duration.map(half_seconds).transpose()?)?,
        spin: Duration::from_micros(arguments.spin.into()),
        realtime: arguments.realtime,
        wait_for_client: arguments.wait,
        live: ready.live.as_ref().map(|live| live.source.clone()),
    };
    let open: Vec<LinkKind> = settings.links.iter().map(|link| link.carrier().kind).collect();
    if let Some(reason) = ready.configuration.faults.iter().find_map(|fault| fault.misses(&open)) {
        return Err(Failure::input(reason));
    }
    let door = match arguments.control.as_deref() {
        Some("off") => None,
        address => {
            let door = Door::open(address.unwrap_or(DEFAULT_ADDRESS), address.is_none(), arguments.token.read()?);
            Some(door.map_err(Failure::input)?)
        }
    };
    let wire = Wire::form(arguments.wire, &ready.configuration);
    let recorder = match &arguments.record {
        Some(directory) => {
            let carriers: Vec<_> = settings.links.iter().map(LinkAddress::carrier).collect();
            let recorder = Recorder::create(directory, &ready.configuration, &ready.truth, wire, &carriers);
            Some(recorder?)
        }
        None => None,
    };
    let summary = geu_daemon::run(&ready.configuration, &ready.truth, &settings, recorder, door, asked_to_end())
        .map_err(|error| match error {
            RunError::Link(error) => Failure::input(error),
            error @ (RunError::NobodyToWaitFor | RunError::Truth(_)) => Failure::input(error),
            error => Failure::failed(error),
        })?;
    note(format_args!("{summary}"));
    arguments.expectations.tell(&summary.faults)
}
