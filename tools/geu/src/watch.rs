//! `geu watch`: diagnosis on a running link.

use std::slice;
use std::sync::Once;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, channel, sync_channel};
use std::thread::{self, sleep};
use std::time::Duration;

use clap::Args;
use geu_recording::{Decode, InputReader, ReferenceAttitude, Sink};
use geu_watch::{DeviceMonitor, FALSE_ALARM_INTERVAL_DAYS, Monitor, START_S, THRESHOLD, Watch};
use serde_json::Value;
use ureq::http::Method;

use crate::command_error::{CommandError, note, say};
use crate::control_client::ControlClient;
use crate::device::verify_link;
use crate::input_args::{InputArgs, note_elsewhere};
use crate::running;
use crate::settings::{ConfigArgs, NamedConfigArgs};
use crate::token::Token;

/// Number of events that wait to be posted.
const QUEUE: usize = 256;
/// Minimum interval between two posts: an emulator accepts 20 events per second.
const POST_INTERVAL: Duration = Duration::from_millis(50);
/// Time for the events that still wait at the end.
const END_TIMEOUT: Duration = Duration::from_secs(2);

/// Watches a link: which gyro changed, and of which kind the change is. Events are JSON lines, and on the bench page of the emulator.
///
/// The first half hour is estimated; changes after it are reported. With a reference each gyro is compared with the model; without, only
/// a difference of GYRZA and GYRZB is seen, which does not show which of the two changed, and no change of GYRX and GYRY.
#[derive(Args)]
pub struct Arguments {
    /// CAN interface, pty, serial device, HOST:PORT (live), recording, or `-`, as `geu decode` reads them.
    #[arg(value_name = "LINK")]
    link: String,
    #[command(flatten)]
    unit: NamedConfigArgs,
    /// Name or description of another unit than the default one (`geu device list`); it needs a reference
    #[arg(long, value_name = "NAME|FILE")]
    device: Option<String>,
    /// Reference attitude: reference.csv or a CCSDS attitude ephemeris
    #[arg(long, value_name = "FILE")]
    reference: Option<String>,
    /// Take times from the clock of the unit, not from receive times: for a reference that starts with the unit
    #[arg(long)]
    clock: bool,
    /// Control interface of the emulator that shows the events on its bench page, or off [default: of the running emulator with this link]
    #[arg(long, value_name = "ADDRESS|off")]
    control: Option<String>,
    #[command(flatten)]
    token: Token,
    #[command(flatten)]
    reading: InputArgs,
    /// Exit with 1 if there was an alarm.
    #[arg(long)]
    strict: bool,
    /// Do not print the summary to standard error.
    #[arg(long, short)]
    quiet: bool,
}

/// Runs `geu watch`.
///
/// # Errors
/// An input cannot be read, standard output cannot be written; with `--strict`, alarms.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let settings = ConfigArgs { device: arguments.device.clone(), ..ConfigArgs::from(&arguments.unit) };
    let mut configuration = settings.read_of_any()?;
    // Prescribed rates are of a run, and replace the scenario there; here the unit alone counts.
    configuration.motion.clear();
    let device = &configuration.device;
    if !device.is_iras() {
        verify_link(device)?;
        let wrong = [("--clock", arguments.clock), ("no --reference", arguments.reference.is_none())];
        if let Some((got, _)) = wrong.into_iter().find(|(_, is_wrong)| *is_wrong) {
            let name = &device.name;
            return Err(CommandError::input(format!(
                "{name}: expected --reference FILE on the time scale of the link, got {got}"
            )));
        }
    }
    let reference = arguments.reference.as_ref().map(|name| ReferenceAttitude::read(name));
    let reference = reference.transpose().map_err(CommandError::input)?;
    let control = match arguments.control.as_deref() {
        Some("off") => None,
        Some(address) => Some(address.to_owned()),
        None => running::control(Some(&arguments.link)).ok(),
    };
    let emulator = control.map(|address| ControlClient::new(&address, &arguments.token)).transpose()?;
    arguments.reading.verify(slice::from_ref(&arguments.link))?;
    if !arguments.quiet {
        let seen = match &reference {
            Some(_) => "each gyro against the model along the reference",
            None => {
                "GYRZA against GYRZB alone: not which of the two changed, and no change of GYRX, GYRY or common to both"
            }
        };
        note(format_args!(
            "geu: watches {seen}; threshold {THRESHOLD}, for one false alarm in {FALSE_ALARM_INTERVAL_DAYS} days; the first half hour is estimated\n"
        ));
        if let Some(emulator) = &emulator {
            note(format_args!("geu: posts events to {}\n", emulator.which));
        }
    }
    let publisher = emulator.map(Publisher::start);
    let stop = arguments.reading.stop_at_signals(slice::from_ref(&arguments.link))?;
    let interval_s = configuration.device.interval_s;
    match reference {
        Some(reference) if !configuration.device.is_iras() => {
            let reader = arguments.reading.device_reader(&configuration.device, stop)?;
            watch(arguments, reader, publisher, interval_s, DeviceMonitor::new(&configuration, reference))
        }
        reference => {
            let monitor = Monitor::new(&configuration, reference, arguments.clock);
            watch(arguments, arguments.reading.reader(stop)?, publisher, interval_s, monitor)
        }
    }
}

/// Watches the rows of the link, one each `interval_s`.
fn watch<D: Decode>(
    arguments: &Arguments,
    mut reader: InputReader<D>,
    publisher: Option<Publisher>,
    interval_s: f64,
    monitor: impl Watch<D::Row>,
) -> Result<(), CommandError> {
    let mut printer = Printer { monitor, publisher, samples: 0, alarms: 0, interruptions: 0, broken: None };
    let result = reader.read(&arguments.link, &mut printer);
    let (summary, ending) = reader.finish(&mut printer);
    if let Some(failure) = printer.broken.take() {
        return Err(failure);
    }
    let Printer { monitor, publisher, samples, alarms, interruptions, .. } = printer;
    publisher.into_iter().for_each(Publisher::finish);
    if !arguments.quiet {
        let defects = summary.account.defect_count();
        note(format_args!(
            "samples        {samples}\nalarms         {alarms}\ninterruptions  {interruptions}\ndefects        {defects}\n"
        ));
    }
    note_elsewhere(&summary);
    result.and(ending)?;
    arguments.reading.note_no_rows(&summary);
    if !arguments.quiet && samples > 0 && monitor.compared_s() <= START_S {
        let why = match samples as f64 * interval_s <= START_S {
            true => "the input ended within the first half hour".to_owned(),
            false => format!(
                "expected more than half an hour of the input along the reference, got {:.0} s; is it the reference of this recording?",
                monitor.compared_s()
            ),
        };
        note(format_args!("geu: no change was searched for: {why}\n"));
    }
    match alarms {
        0 if arguments.strict && samples == 0 => Err(CommandError::failed("--strict: no sample")),
        1.. if arguments.strict => Err(CommandError::failed(format!("--strict: {alarms} alarms"))),
        _ => Ok(()),
    }
}

/// Prints events as they happen.
struct Printer<M> {
    monitor: M,
    publisher: Option<Publisher>,
    samples: u64,
    alarms: u64,
    interruptions: u64,
    broken: Option<CommandError>,
}

impl<R, M: Watch<R>> Sink<R> for Printer<M> {
    fn row(&mut self, row: &R) {
        self.samples += 1;
        for event in self.monitor.push(row) {
            self.alarms += u64::from(event.event == "alarm");
            self.interruptions += u64::from(event.event == "interruption");
            let event = event.json();
            if let Err(failure) = say!("{event}") {
                self.broken.get_or_insert(failure);
            }
            self.publisher.iter().for_each(|publisher| publisher.post(event.clone()));
        }
    }

    fn is_closed(&self) -> bool {
        self.broken.is_some()
    }
}

/// Posts events to an emulator from a thread of its own: the watch does not wait for it.
struct Publisher {
    queue: SyncSender<Value>,
    ended: Receiver<()>,
}

impl Publisher {
    fn start(emulator: ControlClient) -> Publisher {
        let (queue, events) = sync_channel::<Value>(QUEUE);
        let (end, ended) = channel();
        let post = move || {
            // Dropped after the last post.
            let _end = end;
            for event in events {
                if let Err(error) = emulator.ask(Method::POST, "/api/watch", Some(&event)) {
                    note_missing(&error.to_string());
                }
                sleep(POST_INTERVAL);
            }
        };
        // Without the thread the queue is closed.
        let _ = thread::Builder::new().name("geu-post".to_owned()).spawn(post);
        Publisher { queue, ended }
    }

    fn post(&self, event: Value) {
        if self.queue.try_send(event).is_err() {
            note_missing("the emulator is too slow");
        }
    }

    /// Waits until the events are posted, for a limited time.
    fn finish(self) {
        drop(self.queue);
        if self.ended.recv_timeout(END_TIMEOUT) == Err(RecvTimeoutError::Timeout) {
            note_missing("the emulator is too slow");
        }
    }
}

/// Prints, once, that the bench page lacks events.
fn note_missing(reason: &str) {
    static NOTED: Once = Once::new();
    NOTED.call_once(|| note(format_args!("geu: the bench page lacks an event: {reason}\n")));
}
