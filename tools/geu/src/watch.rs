//! `geu watch`: diagnosis on a running link.

use std::slice;

use clap::Args;
use geu_recording::{Defect, ReceivedSample, ReferenceAttitude, Sink};
use geu_watch::{FALSE_ALARM_INTERVAL_DAYS, Monitor, THRESHOLD};

use crate::command_error::{CommandError, note, say};
use crate::decode::{InputArgs, note_elsewhere};
use crate::settings::{ConfigArgs, NamedConfigArgs};

/// Watches a link: which gyro changed, and of which kind the change is. Events are JSON lines.
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
    /// Reference attitude: reference.csv or a CCSDS attitude ephemeris
    #[arg(long, value_name = "FILE")]
    reference: Option<String>,
    /// Take times from the clock of the unit, not from receive times: for a reference that starts with the unit
    #[arg(long)]
    clock: bool,
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
    let configuration = ConfigArgs::from(&arguments.unit).read()?;
    let reference = arguments.reference.as_ref().map(|name| ReferenceAttitude::read(name));
    let reference = reference.transpose().map_err(CommandError::input)?;
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
    }
    let monitor = Monitor::new(&configuration, reference, arguments.clock);
    let mut printer = Printer { monitor, samples: 0, alarms: 0, interruptions: 0, broken: None };
    let mut reader = arguments.reading.reader(slice::from_ref(&arguments.link))?;
    let result = reader.read(&arguments.link, &mut printer);
    let (summary, ending) = reader.finish(&mut printer);
    if let Some(failure) = printer.broken.take() {
        return Err(failure);
    }
    let Printer { samples, alarms, interruptions, .. } = printer;
    if !arguments.quiet {
        let defects = summary.account.defect_count();
        note(format_args!(
            "samples        {samples}\nalarms         {alarms}\ninterruptions  {interruptions}\ndefects        {defects}\n"
        ));
    }
    note_elsewhere(&summary);
    result.and(ending)?;
    arguments.reading.note_no_rows(&summary);
    match arguments.strict && alarms > 0 {
        true => Err(CommandError::failed(format!("--strict: {alarms} alarms"))),
        false => Ok(()),
    }
}

/// Prints events as they happen.
struct Printer {
    monitor: Monitor,
    samples: u64,
    alarms: u64,
    interruptions: u64,
    broken: Option<CommandError>,
}

impl Sink for Printer {
    fn row(&mut self, row: &ReceivedSample) {
        self.samples += 1;
        for event in self.monitor.push(row) {
            self.alarms += u64::from(event.event == "alarm");
            self.interruptions += u64::from(event.event == "interruption");
            if let Err(failure) = say!("{}", event.json()) {
                self.broken.get_or_insert(failure);
            }
        }
    }

    fn defect(&mut self, _defect: &Defect) {
        // Lost samples are an interruption; the summary counts the defects.
    }

    fn is_closed(&self) -> bool {
        self.broken.is_some()
    }
}
