//! `geu run`: the emulator.

use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use clap::Args;
use geu_daemon::cadence::Speed;
use geu_daemon::control::{DEFAULT_ADDRESS, Door};
use geu_daemon::record::Destination;
use geu_daemon::{Recording, RunError, Settings, asked_to_end};
use geu_model::configuration::{WireForm, unix_ns};
use geu_model::fault::catalogue::LinkKind;

use crate::expectations;
use crate::failure::{Failure, note};
use crate::links::Links;
use crate::overwriting::refuse_recording_over;
use crate::settings::{RunSettings, Wire, half_seconds};

/// Runs the emulator: the unit on a pty, a serial port, a CAN interface or TCP, or several of them at once.
///
/// Without a link it stands on a pty at $XDG_RUNTIME_DIR/geu0, else /tmp/geu0. `ready LINK` is printed for each.
#[derive(Args, Debug, Default)]
pub struct Arguments {
    #[command(flatten)]
    run: RunSettings,
    #[command(flatten)]
    links: Links,
    /// Writes there what `geu simulate` writes, for this run; a directory that is new or empty
    #[arg(long, value_name = "DIRECTORY")]
    record: Option<PathBuf>,
    /// Replaces a recording in that directory; files that no recording has stay
    #[arg(long, requires = "record")]
    force: bool,
    /// Form of the link in the recording [default: that of the link given first]
    #[arg(long, requires = "record")]
    wire: Option<Wire>,
    /// On-board time against the wall clock: a factor, or max for as fast as model and readers go [default: 1]
    #[arg(long, value_name = "X|max", allow_negative_numbers = true)]
    speed: Option<Speed>,
    /// Ends after so much on-board time; on a truth from a file it ends with the truth
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
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
    /// Control interface and bench page [default: 127.0.0.1:8470, or the next port that is free]
    #[arg(long, value_name = "ADDRESS|off")]
    control: Option<String>,
    /// Whom the control interface lets in beyond loopback: `Authorization: Bearer TOKEN`, or `?token=TOKEN`
    #[arg(long, value_name = "TOKEN", env = "GEU_CONTROL_TOKEN", hide_env_values = true)]
    control_token: Option<String>,
}

/// Carries it out.
///
/// # Errors
/// A configuration that cannot be run, a link that cannot be opened, a recording that cannot begin or is not complete.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    arguments.expectations.check()?;
    let mut ready = arguments.run.read()?;
    if let Some(directory) = &arguments.record {
        let inputs: Vec<&str> = ready.inputs.iter().map(String::as_str).collect();
        refuse_recording_over("--record", directory, &inputs)?;
    }
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
    let (control, token) = (arguments.control.as_deref(), arguments.control_token.clone());
    let door = match control {
        Some("off") => None,
        address => {
            let door = Door::open(address.unwrap_or(DEFAULT_ADDRESS), address.is_none(), token);
            Some(door.map_err(Failure::input)?)
        }
    };
    let recording = arguments.record.as_ref().map(|directory| Recording {
        destination: Destination::new(directory, arguments.force),
        wire: arguments.wire.map(WireForm::from),
    });
    let summary =
        geu_daemon::run(&ready.configuration, &ready.truth, &settings, recording.as_ref(), door, asked_to_end())
            .map_err(|error| match error {
                RunError::Link(error) => Failure::input(error),
                error @ (RunError::NobodyToWaitFor | RunError::Truth(_) | RunError::Record(_)) => Failure::input(error),
                error => Failure::failed(error),
            })?;
    note(format_args!("{summary}"));
    let told = arguments.expectations.tell(&summary.faults);
    summary.recording.map_err(Failure::failed)?;
    told
}
