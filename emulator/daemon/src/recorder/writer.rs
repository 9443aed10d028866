//! The recorder: what the link carried, commands, faults, and the run.

use std::fs::File;
use std::io::Write;
use std::path::PathBuf;

use geu_model::configuration::{EndedEarly, LinkLogFormat, RecordedCommand, RunRecord};
use geu_model::units::on_board_s;
use geu_model::{CompletedSample, Configuration, InjectionRecord, Trace, Truth};
use geu_protocol::command::hex;

use super::destination::Destination;
use super::event::{PolledSample, UnitEvent};
use super::fault_log::FaultLog;
use super::output::{Output, RecordError, stamp};
use super::reference::ReferenceFiles;
use super::truth_csv::TruthCsv;
use super::{links, run_toml};
use crate::link_model::{LinkModel, TransmitQueue, WireData};
use crate::truth::received;

/// Interface name in `link.log`.
const INTERFACE: &str = "can0";
/// What is buffered is handed to the system when a file has so many bytes of it.
const BUFFER: usize = 1 << 16;

/// Writes a run.
pub struct Recorder {
    directory: PathBuf,
    /// Keeps others from recording into the same directory.
    _held: File,
    configuration: Configuration,
    wire: LinkLogFormat,
    /// The link that is recorded, and what waits on it.
    model: LinkModel,
    links: Vec<LinkModel>,
    queue: TransmitQueue,
    link: Output,
    faults: FaultLog,
    truth: TruthCsv,
    commands: Output,
    reference: ReferenceFiles,
    /// Whether the truth became known as time went on.
    is_received: bool,
    samples: u64,
    /// Scheduled end of the last sample interval.
    end_ns: i64,
    /// Somebody drove the faults since `run.toml` was written.
    is_run_outdated: bool,
}

/// Why a recording ends.
pub(crate) enum End {
    /// The run does.
    Run,
    /// It cannot go on, for this reason; all that was told until then is written.
    Early(String),
    /// It cannot be written, for this reason.
    Failed(String),
}

impl Recorder {
    /// Opens the files of a run on `truth`; what is replaced is removed. `links` are those that are open beside the
    /// recording; the recorded link is the first of its form, else one of the default kind.
    ///
    /// # Errors
    /// A directory that holds something, a directory or file that cannot be written.
    pub fn create(
        destination: &Destination,
        configuration: &Configuration,
        truth: &Truth,
        wire: LinkLogFormat,
        links: &[LinkModel],
    ) -> Result<Recorder, RecordError> {
        let links = if links.is_empty() { links::without_links(configuration) } else { links.to_vec() };
        let model = links::recorded(wire, configuration, &links);
        let is_received = matches!(truth, Truth::Stepped(_));
        let (held, mut run) = destination.claim(&run_at_start(configuration, wire, &model, &links, is_received))?;
        let directory = destination.directory();
        let link_name = match wire {
            LinkLogFormat::Can => "link.log",
            LinkLogFormat::Serial => "link.bin",
        };
        let mut recorder = Recorder {
            link: Output::create(directory, link_name)?,
            reference: ReferenceFiles::create(directory, configuration, truth)?,
            truth: TruthCsv::create(directory, configuration.columns())?,
            commands: Output::create(directory, run_toml::COMMANDS)?,
            is_received,
            directory: directory.to_owned(),
            _held: held,
            configuration: configuration.clone(),
            wire,
            faults: FaultLog::create(directory, &model, &links)?,
            model,
            links,
            queue: TransmitQueue::default(),
            samples: 0,
            end_ns: 0,
            is_run_outdated: false,
        };
        run.put_in_place(run_toml::NAME)?;
        recorder.flush()?;
        Ok(recorder)
    }

    /// Samples recorded.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Writes what happened.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub(crate) fn event(&mut self, event: &UnitEvent) -> Result<(), RecordError> {
        if matches!(event, UnitEvent::Sample(..) | UnitEvent::Polled(_)) {
            self.flush_causes()?;
        }
        self.take(event)?;
        if self.buffered() > BUFFER { self.flush() } else { Ok(()) }
    }

    fn take(&mut self, event: &UnitEvent) -> Result<(), RecordError> {
        match event {
            UnitEvent::Sample(ended, traces, injected) => self.sample(ended, traces, injected.as_deref()),
            UnitEvent::Command { link, payload, running_end_ns, reply, acting } => {
                self.command(link, payload, *running_end_ns)?;
                self.faults.reply(self.samples, link, payload, *reply, acting)
            }
            UnitEvent::Polled(polled) => {
                let frame = self.samples.saturating_sub(1);
                self.faults.polled(frame, polled)?;
                let PolledSample { sample, reply, end_ns, acting, .. } = polled;
                // The recording is of one form, whatever links are open: it has what was polled over any of them.
                self.queue.put(self.model.polled(sample, reply, acting), frame, *end_ns);
                self.write_due(*end_ns)
            }
            UnitEvent::Missed { frame } => self.faults.missed(*frame),
            UnitEvent::Happened(happening) => self.faults.happened(self.samples, happening),
            UnitEvent::Injected(fault) => {
                self.configuration.faults.push(fault.clone());
                self.configuration.run.injected.push(fault.id.clone());
                self.is_run_outdated = true;
                self.faults.injected(self.samples, fault)
            }
            UnitEvent::StartedByHand { id, at_s } => {
                let fault = self.configuration.faults.iter_mut().find(|fault| fault.id == *id);
                fault.into_iter().for_each(|fault| {
                    fault.start_at(*at_s);
                });
                self.is_run_outdated = true;
                self.faults.started_by_hand(self.samples, id, *at_s)
            }
            UnitEvent::Cleared { id, until_s } => {
                let fault = self.configuration.faults.iter_mut().find(|fault| fault.id == *id);
                fault.into_iter().for_each(|fault| fault.end_at(*until_s));
                self.is_run_outdated = true;
                self.faults.cleared(id, *until_s)
            }
        }
    }

    /// Its messages where it was sent cyclically, its truth, and the reference up to its end.
    fn sample(
        &mut self,
        ended: &CompletedSample,
        traces: &[Trace; 4],
        injected: Option<&InjectionRecord>,
    ) -> Result<(), RecordError> {
        if !self.configuration.run.injected.is_empty() && !self.truth.has_fault_column() {
            self.flush()?;
            self.truth.add_fault_column(&self.directory)?;
        }
        let frame = self.samples;
        let sample = Some(&ended.sample).filter(|_| ended.cyclic);
        let transmissions = self.model.carry(sample, frame, injected.map_or(&[], |injected| &injected.acting));
        self.queue.put(transmissions, frame, ended.end_ns);
        self.write_due(ended.end_ns)?;
        if let Some(injected) = injected {
            self.faults.sample(frame, ended, injected)?;
        }
        self.samples += 1;
        self.truth.rows(&stamp(self.configuration.start_unix_ns + ended.end_ns), ended, traces)?;
        self.end_ns = ended.end_ns;
        self.reference.sample(ended.end_ns)
    }

    /// Writes what left by then.
    fn write_due(&mut self, until_ns: i64) -> Result<(), RecordError> {
        while let Some((due_ns, contents)) = self.queue.take(until_ns) {
            self.write(&contents, due_ns)?;
        }
        Ok(())
    }

    fn write(&mut self, contents: &[WireData], due_ns: i64) -> Result<(), RecordError> {
        let stamp = stamp(self.configuration.start_unix_ns + due_ns);
        self.link.write(|file| {
            contents.iter().try_for_each(|content| match content {
                WireData::Bytes(bytes) => file.write_all(bytes),
                WireData::Frame(_) => writeln!(file, "({stamp}) {INTERFACE} {content}"),
            })
        })
    }

    fn command(&mut self, link: &str, payload: &[u8], running_end_ns: i64) -> Result<(), RecordError> {
        let command = RecordedCommand { sample: self.samples, link: link.to_owned(), payload: payload.to_vec() };
        let line = serde_json::json!({
            "half_second": command.sample,
            "on_board_s": on_board_s(command.sample),
            "half_second_end_s": running_end_ns as f64 * 1e-9,
            "link": command.link,
            "bytes": hex(payload),
        });
        self.commands.write(|file| writeln!(file, "{line}"))
    }

    /// Ends the recording: what is buffered is written, and `run.toml`.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn finish(self) -> Result<(), RecordError> {
        self.end(End::Run)
    }

    /// The same, for whatever reason.
    pub(crate) fn end(mut self, end: End) -> Result<(), RecordError> {
        let sample = self.samples;
        let ended_early = match end {
            End::Run => None,
            End::Early(reason) => Some(EndedEarly { sample, reason }),
            // The files tell how far it came.
            End::Failed(reason) => {
                return self.write_run(true, Some(EndedEarly { sample, reason }));
            }
        };
        // What faults still hold back left with the end.
        self.queue.end(self.end_ns);
        self.write_due(i64::MAX)?;
        self.reference.end()?;
        self.flush()?;
        self.write_run(false, ended_early)
    }

    /// Puts `run.toml` of the run so far in place.
    fn write_run(&self, is_unfinished: bool, ended_early: Option<EndedEarly>) -> Result<(), RecordError> {
        let mut configuration =
            run_at_start(&self.configuration, self.wire, &self.model, &self.links, self.is_received);
        let run = &mut configuration.run;
        run.duration_s = on_board_s(self.samples);
        (run.is_unfinished, run.ended_early) = (is_unfinished, ended_early);
        let commands = Some(&*self.commands.path).filter(|_| !is_unfinished);
        run_toml::write(&self.directory, &configuration, commands)
    }

    /// Hands to the system what was done to the unit: before what it caused, so that a recording which is cut has both or
    /// neither.
    fn flush_causes(&mut self) -> Result<(), RecordError> {
        if std::mem::take(&mut self.is_run_outdated) {
            self.write_run(true, None)?;
        }
        if self.commands.buffered() > 0 {
            self.commands.flush()?;
        }
        Ok(())
    }

    /// Bytes of the file that has most that the system does not have yet.
    fn buffered(&self) -> usize {
        [self.truth.buffered(), self.link.buffered(), self.faults.buffered(), self.commands.buffered()]
            .into_iter()
            .fold(0, usize::max)
    }

    /// Hands what is buffered to the system, `truth.csv` before what the link carried: its rows tell how far a recording
    /// that is cut has come.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.flush_causes()?;
        self.reference.flush_received()?;
        self.truth.flush()?;
        self.faults.flush()?;
        self.link.flush()?;
        self.reference.flush()
    }
}

/// What makes a run again, as long as nothing of it is recorded.
fn run_at_start(
    configuration: &Configuration,
    wire: LinkLogFormat,
    model: &LinkModel,
    links: &[LinkModel],
    is_received: bool,
) -> Configuration {
    let mut configuration = configuration.clone();
    // Without faults it does not matter which links were open.
    let links = if configuration.faults.is_empty() { &[][..] } else { links };
    configuration.run = RunRecord {
        duration_s: on_board_s(0),
        wire: Some(wire),
        links: links.iter().map(|model| model.kind).collect(),
        serial_baud: links::serial_baud(links),
        can_base: links::can_base(model, links),
        is_unfinished: true,
        ended_early: None,
        injected: std::mem::take(&mut configuration.run.injected),
        // Beside this file, wherever the directory goes.
        truth: configuration.run.truth.take().map(|name| if is_received { received::NAME.to_owned() } else { name }),
        commands: Vec::new(),
    };
    configuration
}
