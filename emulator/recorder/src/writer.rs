//! The recorder: writes the recorded link, commands, faults, truth, and `run.toml`.

use std::fs::File;
use std::io::Write;
use std::path::PathBuf;

use geu_model::configuration::{EndedEarly, LinkLogFormat, RunRecord};
use geu_model::fault::Fault;
use geu_model::{CompletedSample, Configuration, InjectionRecord, Trace, Truth};
use geu_protocol::capture::Timestamp;
use geu_protocol::command::hex;
use serde_json::json;

use crate::destination::Destination;
use crate::event::{PolledSample, UnitEvent};
use crate::fault_log::FaultLog;
use crate::link_model::{LinkModel, TransmitQueue, WireData};
use crate::output::{Output, RecordError};
use crate::received;
use crate::reference::ReferenceFiles;
use crate::truth::{TruthFile, TruthTable};
use crate::{links, run_toml};

/// Interface name in `link.log`.
const INTERFACE: &str = "can0";
/// Files are flushed when one has more buffered bytes.
const BUFFER: usize = 1 << 16;

/// Writes a run.
pub struct Recorder {
    directory: PathBuf,
    /// Locks the directory against other recorders.
    _lock: File,
    configuration: Configuration,
    wire: LinkLogFormat,
    /// The recorded link, and its queue.
    model: LinkModel,
    links: Vec<LinkModel>,
    queue: TransmitQueue,
    link: Output,
    faults: FaultLog,
    truth: TruthFile,
    commands: Output,
    reference: ReferenceFiles,
    /// True for a truth received during the run.
    is_received: bool,
    samples: u64,
    /// Duration of a run with a truth as columns, else 0: then the rows of the truth show it.
    planned_s: f64,
    /// Scheduled end of the last sample interval.
    end_ns: i64,
    /// The operator changed the faults since `run.toml` was written.
    is_run_outdated: bool,
}

/// Reason for the end of a recording.
pub enum End {
    /// End of the run.
    Run,
    /// The recording could not keep up; all events until then are written.
    Early(String),
    /// A file cannot be written.
    Failed(String),
}

impl Recorder {
    /// Opens the files of a run on `truth`, and removes the replaced ones. `links` are open beside the recording; the
    /// recorded link is the first with the encoding `wire`, else a default one. A `truth_table` is written in place of
    /// `truth.csv`, for a run of this number of samples without an operator.
    ///
    /// # Errors
    /// A directory that is not empty, a directory or file that cannot be written.
    pub fn create(
        destination: &Destination,
        configuration: &Configuration,
        truth: &Truth,
        wire: LinkLogFormat,
        links: &[LinkModel],
        truth_table: Option<(Box<dyn TruthTable>, u64)>,
    ) -> Result<Recorder, RecordError> {
        let links = if links.is_empty() { links::without_links(configuration) } else { links.to_vec() };
        let model = links::recorded(wire, configuration, &links);
        let is_received = matches!(truth, Truth::Stepped(_));
        let mut planned = run_at_start(configuration, wire, &model, &links, is_received);
        let (table, samples) = truth_table.unzip();
        let planned_s = configuration.device.on_board_s(samples.unwrap_or_default());
        planned.run.duration_s = planned_s;
        let (lock, mut run) = destination.claim(&planned)?;
        let directory = destination.directory();
        let link_name = match wire {
            LinkLogFormat::Can => "link.log",
            LinkLogFormat::Serial => "link.bin",
        };
        let mut recorder = Recorder {
            link: Output::create(directory, link_name)?,
            reference: ReferenceFiles::create(directory, configuration, truth)?,
            truth: TruthFile::create(directory, configuration, table)?,
            commands: Output::create(directory, run_toml::COMMANDS)?,
            is_received,
            directory: directory.to_owned(),
            _lock: lock,
            configuration: configuration.clone(),
            wire,
            faults: FaultLog::create(directory, &configuration.device, &model, &links)?,
            model,
            links,
            queue: TransmitQueue::new(configuration.device.interval_ns()),
            samples: 0,
            planned_s,
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

    /// Writes an event.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn event(&mut self, event: &UnitEvent) -> Result<(), RecordError> {
        if matches!(event, UnitEvent::Sample(..) | UnitEvent::Polled(_)) {
            self.flush_causes()?;
        }
        let frame = self.samples;
        match event {
            UnitEvent::Sample(ended, traces, injected) => self.sample(ended, traces, injected.as_deref())?,
            UnitEvent::Command { link, payload, running_end_ns, .. } => {
                self.command(link, payload, *running_end_ns)?;
            }
            UnitEvent::Polled(PolledSample { sample, reply, end_ns, acting, .. }) => {
                // The recording has one encoding; it holds the samples polled over any link.
                self.queue.put(self.model.polled(sample, reply, acting), frame.saturating_sub(1), *end_ns);
                self.write_due(*end_ns)?;
            }
            UnitEvent::Missed { .. } | UnitEvent::Happened(_) => {}
            UnitEvent::Injected(fault) => {
                self.configuration.faults.push(fault.clone());
                self.configuration.run.injected.push(fault.id.clone());
                self.is_run_outdated = true;
            }
            UnitEvent::StartedByHand { id, at_s } => {
                self.change_fault(id, |fault| _ = fault.start_at(*at_s));
            }
            UnitEvent::Cleared { id, until_s } => self.change_fault(id, |fault| fault.end_at(*until_s)),
        }
        self.faults.event(frame, event)?;
        if self.buffered() > BUFFER { self.flush() } else { Ok(()) }
    }

    fn change_fault(&mut self, id: &str, change: impl FnOnce(&mut Fault)) {
        if let Some(fault) = self.configuration.faults.iter_mut().find(|fault| fault.id == id) {
            change(fault);
        }
        self.is_run_outdated = true;
    }

    /// Writes the messages of a sample if it was sent cyclically, its truth, and the reference up to its end.
    fn sample(
        &mut self,
        ended: &CompletedSample,
        traces: &[Trace],
        injected: Option<&InjectionRecord>,
    ) -> Result<(), RecordError> {
        if !self.configuration.run.injected.is_empty() && !self.truth.has_fault_column() {
            self.flush()?;
            self.truth.add_fault_column(&self.directory)?;
        }
        let frame = self.samples;
        let sample = Some(ended).filter(|_| ended.cyclic);
        let transmissions = self.model.carry(sample, frame, injected.map_or(&[], |injected| &injected.acting));
        self.queue.put(transmissions, frame, ended.end_ns);
        self.write_due(ended.end_ns)?;
        self.samples += 1;
        let stamp = Timestamp::micros(self.configuration.start_unix_ns + ended.end_ns);
        self.truth.rows(&self.configuration.device, stamp, ended, traces)?;
        self.end_ns = ended.end_ns;
        self.reference.sample(ended.end_ns)
    }

    /// Writes the data that is due by `until_ns`.
    fn write_due(&mut self, until_ns: i64) -> Result<(), RecordError> {
        while let Some((due_ns, data)) = self.queue.next_due(until_ns) {
            let stamp = Timestamp::micros(self.configuration.start_unix_ns + due_ns);
            self.link.write(|file| {
                data.iter().try_for_each(|data| match data {
                    WireData::Bytes(bytes) => file.write_all(bytes),
                    WireData::Frame(_) => writeln!(file, "({stamp}) {INTERFACE} {data}"),
                })
            })?;
        }
        Ok(())
    }

    fn command(&mut self, link: &str, payload: &[u8], running_end_ns: i64) -> Result<(), RecordError> {
        let line = json!({
            "half_second": self.samples, "on_board_s": self.configuration.device.on_board_s(self.samples),
            "half_second_end_s": running_end_ns as f64 * 1e-9, "link": link, "bytes": hex(payload),
        });
        self.commands.write(|file| writeln!(file, "{line}"))
    }

    /// Ends the recording: flushes the files and writes `run.toml`.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn finish(self) -> Result<(), RecordError> {
        self.end(End::Run)
    }

    pub fn end(mut self, end: End) -> Result<(), RecordError> {
        let sample = self.samples;
        let ended_early = match end {
            End::Run => None,
            End::Early(reason) => Some(EndedEarly { sample, reason }),
            // The number of recorded samples follows from the files.
            End::Failed(reason) => return self.write_run(true, Some(EndedEarly { sample, reason })),
        };
        // Data that faults delay was sent at the end of the run.
        self.queue.end(self.end_ns);
        self.write_due(i64::MAX)?;
        self.reference.end()?;
        self.flush()?;
        self.truth.finish()?;
        self.write_run(false, ended_early)
    }

    /// Replaces `run.toml` by that of the run up to now.
    fn write_run(&self, is_unfinished: bool, ended_early: Option<EndedEarly>) -> Result<(), RecordError> {
        let mut configuration =
            run_at_start(&self.configuration, self.wire, &self.model, &self.links, self.is_received);
        let run = &mut configuration.run;
        run.duration_s =
            if is_unfinished { self.planned_s } else { self.configuration.device.on_board_s(self.samples) };
        (run.is_unfinished, run.ended_early) = (is_unfinished, ended_early);
        let commands = Some(&*self.commands.path).filter(|_| !is_unfinished);
        run_toml::write(&self.directory, &configuration, commands)
    }

    /// Flushes commands and changes of faults before their effects, so that a truncated recording has both or neither.
    fn flush_causes(&mut self) -> Result<(), RecordError> {
        if std::mem::take(&mut self.is_run_outdated) {
            self.write_run(true, None)?;
        }
        self.commands.flush()
    }

    /// Largest number of buffered bytes of a file.
    fn buffered(&self) -> usize {
        let outputs = [&self.link, &self.faults.file, &self.commands].map(Output::buffered);
        outputs.into_iter().fold(self.truth.buffered(), usize::max)
    }

    /// Flushes all files, `truth.csv` before the link: its rows give the number of samples of a truncated recording.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.flush_causes()?;
        self.reference.flush_received()?;
        self.truth.flush()?;
        self.faults.file.flush()?;
        self.link.flush()?;
        self.reference.flush()
    }
}

/// Configuration that repeats the run, before the first sample is recorded.
fn run_at_start(
    configuration: &Configuration,
    wire: LinkLogFormat,
    model: &LinkModel,
    links: &[LinkModel],
    is_received: bool,
) -> Configuration {
    let mut configuration = configuration.clone();
    // Without faults the open links do not matter.
    let links = if configuration.faults.is_empty() { &[][..] } else { links };
    configuration.run = RunRecord {
        duration_s: 0.0,
        wire: Some(wire),
        links: links.iter().map(|model| model.kind).collect(),
        serial_baud: links::serial_baud(links),
        can_base: links::can_base(model, links),
        is_unfinished: true,
        ended_early: None,
        injected: std::mem::take(&mut configuration.run.injected),
        // Relative to this file, so that the directory can be moved.
        truth: configuration.run.truth.take().map(|name| if is_received { received::NAME.to_owned() } else { name }),
        commands: Vec::new(),
    };
    configuration
}
