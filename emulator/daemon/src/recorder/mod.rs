//! A run on disk: what the link carried, the truth behind it, and what makes the same bytes again (cli.md, `simulate`).
//!
//! `geu simulate` writes it as fast as the model runs; `geu run --record` writes the same files beside the live links.
//! Times are scheduled ends, never the wall clock.

mod destination;
mod event;
mod links;
mod output;
mod run_toml;
mod truth_csv;

use std::collections::VecDeque;
use std::fs::File;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use geu_model::attitude::{Leg, Motion, Stepped};
use geu_model::configuration::{EndedEarly, RecordedCommand, RunRecord, WireForm};
use geu_model::sensor::{StarSensor, SunSensor};
use geu_model::units::{HALF_SECOND_NS, RAD_PER_DEG, on_board_s};
use geu_model::{Configuration, Ended, Injected, Trace, Truth};
use geu_protocol::command::hex;

use crate::fault_log::FaultLog;
use crate::link_model::{LinkModel, TransmitQueue, WireData};
use crate::truth::received;
use truth_csv::TruthCsv;

pub use destination::{Destination, FILES};
pub(crate) use event::UnitEvent;
pub use links::misses;
pub(crate) use links::{form_beside, recorded};
pub(crate) use output::Output;
pub use output::RecordError;
pub use run_toml::{UnfinishedError, complete};

/// Interface name in `link.log`.
const INTERFACE: &str = "can0";
/// Spacing of `reference.csv`, true time, ns.
const REFERENCE_NS: i64 = HALF_SECOND_NS;

/// What is buffered is handed to the system when a file has so many bytes of it.
const BUFFER: usize = 1 << 16;

/// Keeps a truth that becomes known as time goes on.
struct Received {
    output: Output,
    truth: Arc<Stepped>,
    /// Knots written; the start is not.
    written: u64,
}

/// Writes a run.
pub struct Recorder {
    directory: PathBuf,
    /// Keeps others from recording into the same directory.
    _held: File,
    configuration: Configuration,
    wire: WireForm,
    /// The link that is recorded, and what waits on it.
    model: LinkModel,
    links: Vec<LinkModel>,
    queue: TransmitQueue,
    link: Output,
    faults: FaultLog,
    reference: Output,
    truth: TruthCsv,
    manoeuvres: Output,
    commands: Output,
    fss: Output,
    sse: Output,
    /// Of a truth that became known as time went on.
    received: Option<Received>,
    /// Walks the truth in true half seconds, beside the unit's own.
    motion: Motion,
    sun_sensor: SunSensor,
    star_sensor: StarSensor,
    reference_rows: i64,
    /// Legs that began and are not written yet, in order.
    legs: VecDeque<Leg>,
    half_seconds: u64,
    /// Scheduled end of the last half second.
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
        wire: WireForm,
        links: &[LinkModel],
    ) -> Result<Recorder, RecordError> {
        let links = if links.is_empty() { links::without_links(configuration) } else { links.to_vec() };
        let model = recorded(wire, configuration, &links);
        let is_received = matches!(truth, Truth::Stepped(_));
        let held = destination.claim(&run_at_start(configuration, wire, &model, &links, is_received))?;
        let directory = destination.directory();
        let received = match truth {
            Truth::Stepped(truth) => {
                let output = Output::create(directory, received::NAME)?;
                Some(Received { output, truth: truth.clone(), written: 1 })
            }
            Truth::Scenario | Truth::Recorded(_) => None,
        };
        let link_name = match wire {
            WireForm::Can => "link.log",
            WireForm::Serial => "link.bin",
        };
        let scenario = &configuration.scenario;
        let mut recorder = Recorder {
            link: Output::create(directory, link_name)?,
            reference: Output::create(directory, "reference.csv")?,
            truth: TruthCsv::create(directory, configuration.columns())?,
            manoeuvres: Output::create(directory, "manoeuvres.csv")?,
            commands: Output::create(directory, run_toml::COMMANDS)?,
            fss: Output::create(directory, "fss.csv")?,
            sse: Output::create(directory, "sse.csv")?,
            received,
            directory: directory.to_owned(),
            _held: held,
            configuration: configuration.clone(),
            wire,
            faults: FaultLog::create(directory, &model, &links)?,
            model,
            links,
            queue: TransmitQueue::default(),
            motion: truth.motion(configuration, 0.0),
            sun_sensor: SunSensor::new(configuration.sensors.fss, configuration.seed),
            star_sensor: StarSensor::new(configuration.sensors.sse, configuration.seed, scenario.limit_cycle),
            reference_rows: 0,
            legs: VecDeque::new(),
            half_seconds: 0,
            end_ns: 0,
            is_run_outdated: false,
        };
        run_toml::put_in_place(directory)?;
        recorder.headers()?;
        recorder.flush()?;
        Ok(recorder)
    }

    /// Half seconds recorded.
    pub fn half_seconds(&self) -> u64 {
        self.half_seconds
    }

    fn headers(&mut self) -> Result<(), RecordError> {
        // Whether a simulator tells the sun is known with its first sample.
        if self.received.is_none() {
            self.truth_headers()?;
        }
        self.manoeuvres.write(|file| writeln!(file, "manoeuvre,start_s,end_s"))?;
        self.fss.write(|file| writeln!(file, "t_s,theta_arcsec,roll_arcsec"))?;
        self.sse.write(|file| writeln!(file, "t_s,star,slit,theta_deg,psi_deg,sigma_arcsec"))?;
        Ok(())
    }

    /// Those of the files that have the sun where it is known.
    fn truth_headers(&mut self) -> Result<(), RecordError> {
        let rates = "rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s";
        let tells_sun = self.motion.untold().is_empty();
        let angles = if tells_sun { ",theta_deg,psi_deg" } else { "" };
        self.reference.write(|file| writeln!(file, "t_s,{rates}{angles}"))?;
        let Some(received) = &mut self.received else { return Ok(()) };
        received.output.write(|file| received::write_header(file, tells_sun))
    }

    /// Writes what happened.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub(crate) fn event(&mut self, event: &UnitEvent) -> Result<(), RecordError> {
        if matches!(event, UnitEvent::HalfSecond(..) | UnitEvent::Polled { .. }) {
            self.flush_causes()?;
        }
        self.take(event)?;
        if self.buffered() > BUFFER { self.flush() } else { Ok(()) }
    }

    fn take(&mut self, event: &UnitEvent) -> Result<(), RecordError> {
        match event {
            UnitEvent::HalfSecond(ended, traces, injected) => self.half_second(ended, traces, injected.as_deref()),
            UnitEvent::Command { link, payload, running_end_ns, reply, acting } => {
                self.command(link, payload, *running_end_ns)?;
                self.faults.reply(self.half_seconds, link, payload, *reply, acting)
            }
            UnitEvent::Polled { link, half_second, reply, end_ns, injected, acting } => {
                let frame = self.half_seconds.saturating_sub(1);
                self.faults.polled(frame, link, half_second, reply, injected.as_deref(), acting)?;
                // The recording is of one form, whatever links are open: it has what was polled over any of them.
                self.queue.put(self.model.polled(half_second, reply, acting), frame, *end_ns);
                self.write_due(*end_ns)
            }
            UnitEvent::Missed { frame } => self.faults.missed(*frame),
            UnitEvent::Happened(happening) => self.faults.happened(self.half_seconds, happening),
            UnitEvent::Injected(fault) => {
                self.configuration.faults.push(fault.clone());
                self.configuration.run.injected.push(fault.id.clone());
                self.is_run_outdated = true;
                self.faults.injected(self.half_seconds, fault)
            }
            UnitEvent::StartedByHand { id, at_s } => {
                let fault = self.configuration.faults.iter_mut().find(|fault| fault.id == *id);
                fault.into_iter().for_each(|fault| {
                    fault.start_at(*at_s);
                });
                self.is_run_outdated = true;
                self.faults.started_by_hand(self.half_seconds, id, *at_s)
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
    fn half_second(
        &mut self,
        ended: &Ended,
        traces: &[Trace; 4],
        injected: Option<&Injected>,
    ) -> Result<(), RecordError> {
        if !self.configuration.run.injected.is_empty() && !self.truth.has_fault_column() {
            self.flush()?;
            self.truth.add_fault_column(&self.directory)?;
        }
        let frame = self.half_seconds;
        let half_second = Some(&ended.half_second).filter(|_| ended.cyclic);
        let transmissions = self.model.carry(half_second, frame, injected.map_or(&[], |injected| &injected.acting));
        self.queue.put(transmissions, frame, ended.end_ns);
        self.write_due(ended.end_ns)?;
        if let Some(injected) = injected {
            self.faults.half_second(frame, ended, injected)?;
        }
        self.half_seconds += 1;
        self.truth.rows(&stamp(self.configuration.start_unix_ns + ended.end_ns), ended, traces)?;
        if self.received.is_some() {
            if self.half_seconds == 1 {
                self.truth_headers()?;
            }
            self.received_rows()?;
            // One half second behind: what is beyond the end of this one may not be known yet.
            self.reference_rows_within(self.end_ns)?;
        }
        while self.received.is_none() && self.reference_rows * REFERENCE_NS < ended.end_ns {
            self.reference_row()?;
        }
        self.end_ns = ended.end_ns;
        while self.legs.front().is_some_and(|leg| ns(leg.end_s) <= ended.end_ns) {
            let leg = self.legs.pop_front().expect("the front is there");
            self.manoeuvre(&leg)?;
        }
        Ok(())
    }

    /// The knots that became known.
    fn received_rows(&mut self) -> Result<(), RecordError> {
        let Some(Received { output, truth, written }) = &mut self.received else { return Ok(()) };
        let knots = truth.knots_from(*written);
        *written += knots.len() as u64;
        output.write(|file| knots.iter().try_for_each(|knot| received::write_row(file, knot)))
    }

    /// The rows of the reference that end by then.
    fn reference_rows_within(&mut self, end_ns: i64) -> Result<(), RecordError> {
        while (self.reference_rows + 1) * REFERENCE_NS <= end_ns {
            self.reference_row()?;
        }
        Ok(())
    }

    /// A leg as far as it was flown by now; nothing of one that was not.
    fn manoeuvre(&mut self, leg: &Leg) -> Result<(), RecordError> {
        let [start, end] =
            [leg.start_s, leg.end_s].map(|t_s| stamp(self.configuration.start_unix_ns + ns(t_s).min(self.end_ns)));
        if start == end {
            return Ok(());
        }
        self.manoeuvres.write(|file| writeln!(file, "{},{start},{end}", leg.name))
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

    fn reference_row(&mut self) -> Result<(), RecordError> {
        self.reference_rows += 1;
        let end_ns = self.reference_rows * REFERENCE_NS;
        let step = self.motion.advance(end_ns as f64 * 1e-9);
        let start_unix_ns = self.configuration.start_unix_ns;
        let knows_sun = self.motion.knows_sun();
        let end = stamp(start_unix_ns + end_ns);
        self.reference.write(|file| {
            let [x, y, z] = step.angle_control_arcsec.map(|angle| angle / step.length_s);
            write!(file, "{end},{x:.9},{y:.9},{z:.9}")?;
            if knows_sun {
                let [theta_deg, psi_deg] = [step.end.theta_rad, step.end.psi_rad].map(|rad| rad / RAD_PER_DEG);
                write!(file, ",{theta_deg:.9},{:.9}", psi_deg.rem_euclid(360.0))?;
            }
            writeln!(file)
        })?;
        for leg in self.motion.take_legs() {
            self.sun_sensor.flown(&leg);
            self.star_sensor.flown(&leg);
            self.legs.push_back(leg);
        }
        if let Some(sun) = self.sun_sensor.see(&self.motion) {
            self.fss.write(|file| writeln!(file, "{end},{:.3},{:.3}", sun.theta_arcsec, sun.roll_arcsec))?;
        }
        while let Some(fixes) = self.star_sensor.fixes_until(end_ns as f64 * 1e-9) {
            for fix in fixes {
                let stamp = stamp(start_unix_ns + ns(fix.t_s));
                self.sse.write(|file| {
                    write!(file, "{stamp},{},{},", fix.star, fix.slit)?;
                    writeln!(file, "{:.9},{:.9},{}", fix.theta_deg, fix.psi_deg, fix.sigma_arcsec)
                })?;
            }
        }
        Ok(())
    }

    fn command(&mut self, link: &str, payload: &[u8], running_end_ns: i64) -> Result<(), RecordError> {
        let command =
            RecordedCommand { half_second: self.half_seconds, link: link.to_owned(), payload: payload.to_vec() };
        let line = serde_json::json!({
            "half_second": command.half_second,
            "on_board_s": on_board_s(command.half_second),
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
        let half_second = self.half_seconds;
        let ended_early = match end {
            End::Run => None,
            End::Early(reason) => Some(EndedEarly { half_second, reason }),
            // The files tell how far it came.
            End::Failed(reason) => {
                return self.write_run(true, Some(EndedEarly { half_second, reason }));
            }
        };
        // What faults still hold back left with the end.
        self.queue.end(self.end_ns);
        self.write_due(i64::MAX)?;
        if self.received.is_some() {
            if self.half_seconds == 0 {
                self.truth_headers()?;
            }
            self.received_rows()?;
            self.reference_rows_within(self.end_ns)?;
        }
        for leg in std::mem::take(&mut self.legs) {
            self.manoeuvre(&leg)?;
        }
        self.flush()?;
        self.write_run(false, ended_early)
    }

    /// Puts `run.toml` of the run so far in place.
    fn write_run(&self, is_unfinished: bool, ended_early: Option<EndedEarly>) -> Result<(), RecordError> {
        let is_received = self.received.is_some();
        let mut configuration = run_at_start(&self.configuration, self.wire, &self.model, &self.links, is_received);
        let run = &mut configuration.run;
        run.duration_s = on_board_s(self.half_seconds);
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
        self.received.as_mut().map_or(Ok(()), |received| received.output.flush())?;
        self.truth.flush()?;
        self.faults.flush()?;
        for output in [&mut self.link, &mut self.reference, &mut self.manoeuvres, &mut self.fss, &mut self.sse] {
            output.flush()?;
        }
        Ok(())
    }
}

/// What makes a run again, as long as nothing of it is recorded.
fn run_at_start(
    configuration: &Configuration,
    wire: WireForm,
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

/// A time in s as ns; one without end is the last there is.
fn ns(t_s: f64) -> i64 {
    (t_s * 1e9).round() as i64
}

/// A time in ns as seconds with six decimals, the grain of a capture.
fn stamp(ns: i64) -> String {
    let micros = (ns + 500) / 1000;
    format!("{}.{:06}", micros / 1_000_000, micros % 1_000_000)
}
