//! A run on disk: what the link carried, the truth behind it, and what makes the same bytes again (cli.md, `simulate`).
//!
//! `geu simulate` writes it as fast as the model runs; `geu run --record` writes the same files beside the live links.
//! Times are scheduled ends, never the wall clock.

mod late_column;
mod output;

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use geu_model::attitude::{Leg, Motion, Stepped};
use geu_model::configuration::{RecordedCommand, RunRecord, WireForm};
use geu_model::effect::{FAULT_COLUMN, columns};
use geu_model::fault::Fault;
use geu_model::fault::acting::{Acting, Happening};
use geu_model::fault::catalogue::LinkKind;
use geu_model::sensor::{StarSensor, SunSensor};
use geu_model::units::{HALF_SECOND_NS, RAD_PER_DEG, on_board_s};
use geu_model::{Configuration, Ended, Injected, Trace, Truth};
use geu_protocol::command::hex;
use geu_protocol::serial::DEFAULT_BAUD;
use geu_protocol::{CanPlan, Gyro, HalfSecond, Reply};

use crate::carriage::{Carrier, Content, Form, Outbox};
use crate::fault_log::FaultLog;
use crate::truth::received;
use late_column::LateColumn;

pub(crate) use output::Output;
pub use output::RecordError;

/// Interface name in `link.log`.
const INTERFACE: &str = "can0";
/// Spacing of `reference.csv`, true time, ns.
const REFERENCE_NS: i64 = HALF_SECOND_NS;

/// What happened in the unit, told in the order in which it happened on board.
#[derive(Clone)]
pub(crate) enum Event {
    /// A half second ended, and what faults did to it.
    HalfSecond(Ended, Box<[Trace; 4]>, Option<Arc<Injected>>),
    /// A command came over a link within the half second that runs; its scheduled end, what the unit answers (an
    /// error: what it would, did a fault not keep it from hearing), and the faults that act.
    Command {
        link: String,
        payload: Vec<u8>,
        running_end_ns: i64,
        reply: Result<Reply, Reply>,
        acting: Arc<Vec<Acting>>,
    },
    /// The half second that ended last was sent because it was polled over a link, stamped with its scheduled end: what
    /// faults did to it, and those that act as it is sent.
    Polled {
        link: String,
        half_second: HalfSecond,
        reply: Reply,
        end_ns: i64,
        injected: Option<Arc<Injected>>,
        acting: Arc<Vec<Acting>>,
    },
    /// A half second came too late to be sent live: the process was held up.
    Missed { frame: u64 },
    /// Something became of a fault or an expectation, with the end of the last half second.
    Happened(Happening),
    /// A fault was injected while the unit ran.
    Injected(Fault),
    /// A fault that waited for a hand was started, with this on-board time.
    StartedByHand { id: String, at_s: f64 },
    /// A fault was taken away, from this on-board time on.
    Cleared { id: String, until_s: f64 },
}

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
    carrier: Carrier,
    links: Vec<LinkKind>,
    serial_baud: Option<u32>,
    outbox: Outbox,
    link: Output,
    faults: FaultLog,
    reference: Output,
    truth: Output,
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
    /// Columns of a trace that `truth.csv` has.
    truth_columns: Vec<usize>,
    /// One of them that stands beside it until the end.
    late: Option<LateColumn>,
}

impl Recorder {
    /// Opens the files of a run on `truth` in `directory`, which is made if it is not there. `links` are those that are
    /// open beside the recording; the recorded link is the first of its form, else one of the default kind.
    ///
    /// # Errors
    /// A directory or file that cannot be written.
    pub fn create(
        directory: &Path,
        configuration: &Configuration,
        truth: &Truth,
        wire: WireForm,
        links: &[Carrier],
    ) -> Result<Recorder, RecordError> {
        let links = if links.is_empty() { without_links(configuration) } else { links.to_vec() };
        let carrier = recorded(wire, &links);
        fs::create_dir_all(directory).map_err(|source| RecordError { path: directory.to_owned(), source })?;
        let held = hold(directory)?;
        let (link_name, other) = match wire {
            WireForm::Can => ("link.log", "link.bin"),
            WireForm::Serial => ("link.bin", "link.log"),
        };
        // What an earlier run left, as a link in the other form, would not belong to this one.
        for left in [other].into_iter().chain(late_column::LEFT) {
            match fs::remove_file(directory.join(left)) {
                Err(source) if source.kind() != io::ErrorKind::NotFound => {
                    return Err(RecordError { path: directory.join(left), source });
                }
                _ => {}
            }
        }
        let received = match truth {
            Truth::Stepped(truth) => {
                let output = Output::create(directory, received::NAME)?;
                Some(Received { output, truth: truth.clone(), written: 1 })
            }
            Truth::Scenario | Truth::Recorded(_) => None,
        };
        let scenario = &configuration.scenario;
        let mut recorder = Recorder {
            link: Output::create(directory, link_name)?,
            reference: Output::create(directory, "reference.csv")?,
            truth: Output::create(directory, "truth.csv")?,
            manoeuvres: Output::create(directory, "manoeuvres.csv")?,
            commands: Output::create(directory, "commands.jsonl")?,
            fss: Output::create(directory, "fss.csv")?,
            sse: Output::create(directory, "sse.csv")?,
            received,
            directory: directory.to_owned(),
            _held: held,
            configuration: configuration.clone(),
            wire,
            faults: FaultLog::create(directory, &carrier, &links)?,
            carrier,
            links: links.iter().map(|carrier| carrier.kind).collect(),
            serial_baud: serial_baud(&links),
            outbox: Outbox::default(),
            motion: truth.motion(configuration, 0.0),
            sun_sensor: SunSensor::new(configuration.sensors.fss, configuration.seed),
            star_sensor: StarSensor::new(configuration.sensors.sse, configuration.seed, scenario.limit_cycle),
            reference_rows: 0,
            legs: VecDeque::new(),
            half_seconds: 0,
            end_ns: 0,
            truth_columns: configuration.columns(),
            late: None,
        };
        recorder.headers()?;
        // A process that is killed leaves a run all the same.
        let mut run = recorder.run_file()?;
        run.write(|file| file.flush())?;
        recorder.flush()?;
        Ok(recorder)
    }

    /// Kind of the link that is recorded.
    pub(crate) fn link(&self) -> LinkKind {
        self.carrier.kind
    }

    fn headers(&mut self) -> Result<(), RecordError> {
        // Whether a simulator tells the sun is known with its first sample.
        if self.received.is_none() {
            self.truth_headers()?;
        }
        self.manoeuvres.write(|file| writeln!(file, "manoeuvre,start_s,end_s"))?;
        self.fss.write(|file| writeln!(file, "t_s,theta_arcsec,roll_arcsec"))?;
        self.sse.write(|file| writeln!(file, "t_s,star,slit,theta_deg,psi_deg,sigma_arcsec"))?;
        let (codes, truth_columns) = (columns(), &self.truth_columns);
        self.truth.write(|file| {
            write!(file, "t_s,sequence,gyro,true_arcsec")?;
            truth_columns.iter().try_for_each(|&column| write!(file, ",{}_counts", codes[column]))?;
            writeln!(file, ",unquantised,count")
        })
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
    pub(crate) fn event(&mut self, event: &Event) -> Result<(), RecordError> {
        match event {
            Event::HalfSecond(ended, traces, injected) => self.half_second(ended, traces, injected.as_deref()),
            Event::Command { link, payload, running_end_ns, reply, acting } => {
                self.command(link, payload, *running_end_ns)?;
                self.faults.reply(self.half_seconds, link, payload, *reply, acting)
            }
            Event::Polled { link, half_second, reply, end_ns, injected, acting } => {
                let frame = self.half_seconds.saturating_sub(1);
                self.faults.polled(frame, link, half_second, reply, injected.as_deref(), acting)?;
                // The recording is of one form, whatever links are open: it has what was polled over any of them.
                self.outbox.put(&self.carrier.polled(half_second, reply, acting), frame, *end_ns);
                self.write_due(*end_ns)
            }
            Event::Missed { frame } => self.faults.missed(*frame),
            Event::Happened(happening) => self.faults.happened(self.half_seconds, happening),
            Event::Injected(fault) => {
                self.configuration.faults.push(fault.clone());
                self.configuration.run.injected.push(fault.id.clone());
                self.begin_late_column()?;
                self.faults.injected(self.half_seconds, fault)
            }
            Event::StartedByHand { id, at_s } => {
                let fault = self.configuration.faults.iter_mut().find(|fault| fault.id == *id);
                fault.into_iter().for_each(|fault| {
                    fault.start_at(*at_s);
                });
                self.faults.started_by_hand(self.half_seconds, id, *at_s)
            }
            Event::Cleared { id, until_s } => {
                let fault = self.configuration.faults.iter_mut().find(|fault| fault.id == *id);
                fault.into_iter().for_each(|fault| fault.end_at(*until_s));
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
        let frame = self.half_seconds;
        let half_second = Some(&ended.half_second).filter(|_| ended.cyclic);
        let pieces = self.carrier.carry(half_second, frame, injected.map_or(&[], |injected| &injected.acting));
        self.outbox.put(&pieces, frame, ended.end_ns);
        self.write_due(ended.end_ns)?;
        if let Some(injected) = injected {
            self.faults.half_second(frame, ended, injected)?;
        }
        self.half_seconds += 1;
        self.truth_rows(ended, traces)?;
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
        while let Some((due_ns, contents)) = self.outbox.take(until_ns) {
            self.write(&contents, due_ns)?;
        }
        Ok(())
    }

    fn write(&mut self, contents: &[Content], due_ns: i64) -> Result<(), RecordError> {
        let stamp = stamp(self.configuration.start_unix_ns + due_ns);
        self.link.write(|file| {
            contents.iter().try_for_each(|content| match content {
                Content::Bytes(bytes) => file.write_all(bytes),
                Content::Frame(_) => writeln!(file, "({stamp}) {INTERFACE} {content}"),
            })
        })
    }

    fn truth_rows(&mut self, ended: &Ended, traces: &[Trace; 4]) -> Result<(), RecordError> {
        let half_second = &ended.half_second;
        let row_start = format!("{},{},", stamp(self.configuration.start_unix_ns + ended.end_ns), half_second.sequence);
        let (truth_columns, is_beside) = (&self.truth_columns, self.late.is_some());
        let by_faults = |trace: &Trace| trace.changes[FAULT_COLUMN] + unforeseen(trace, truth_columns);
        // The shortest digits that read back the same, so that the columns add up; many times a row, so not by `write!`.
        let (mut digits, mut whole) = (zmij::Buffer::new(), itoa::Buffer::new());
        self.truth.write(|file| {
            for (gyro, trace) in Gyro::ALL.into_iter().zip(traces) {
                file.write_all(row_start.as_bytes())?;
                file.write_all(gyro.name().as_bytes())?;
                let here = truth_columns.iter().filter(|&&column| column != FAULT_COLUMN || !is_beside);
                let changes = here.map(|&column| match column {
                    FAULT_COLUMN => by_faults(trace),
                    column => trace.changes[column],
                });
                for number in std::iter::once(trace.true_arcsec).chain(changes).chain([trace.unquantised]) {
                    file.write_all(b",")?;
                    file.write_all(digits.format(number).as_bytes())?;
                }
                file.write_all(b",")?;
                file.write_all(whole.format(half_second.increments[gyro as usize]).as_bytes())?;
                file.write_all(b"\n")?;
            }
            Ok(())
        })?;
        let Some(late) = &mut self.late else { return Ok(()) };
        traces.iter().try_for_each(|trace| late.add(by_faults(trace)))
    }

    /// Begins the column of what live faults change, where there is none yet.
    fn begin_late_column(&mut self) -> Result<(), RecordError> {
        let Err(place) = self.truth_columns.binary_search(&FAULT_COLUMN) else { return Ok(()) };
        self.truth_columns.insert(place, FAULT_COLUMN);
        let rows = self.half_seconds * Gyro::ALL.len() as u64;
        self.late = Some(LateColumn::begin(&self.directory, place, rows)?);
        Ok(())
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
    pub fn finish(mut self) -> Result<(), RecordError> {
        // What faults still hold back left with the end.
        self.outbox.end(self.end_ns);
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
        let mut run = self.run_file()?;
        // From the file, so that a run of any length needs no memory for its commands.
        let commands = File::open(&self.commands.path)
            .map_err(|source| RecordError { path: self.commands.path.clone(), source })?;
        for line in BufReader::new(commands).lines() {
            run.write(|file| {
                let command: serde_json::Value = serde_json::from_str(&line?)?;
                let (half_second, link, bytes) = (&command["half_second"], &command["link"], &command["bytes"]);
                writeln!(file, "\n[[run.command]]\nhalf_second = {half_second}\nlink = {link}\nbytes = {bytes}")
            })?;
        }
        run.write(|file| file.flush())?;
        // Last: of a long run it takes its time.
        let Some(late) = self.late else { return Ok(()) };
        late.put_into(&self.directory, &self.truth.path, &format!("{}_counts", columns()[FAULT_COLUMN]))
    }

    /// `run.toml` of the run so far.
    fn run_file(&self) -> Result<Output, RecordError> {
        let mut configuration = self.configuration.clone();
        let has_faults = !configuration.faults.is_empty();
        configuration.run = RunRecord {
            duration_s: on_board_s(self.half_seconds),
            wire: Some(self.wire),
            // Without faults it does not matter.
            links: if has_faults { self.links.clone() } else { Vec::new() },
            serial_baud: self.serial_baud.filter(|_| has_faults),
            injected: std::mem::take(&mut configuration.run.injected),
            // Beside this file, wherever the directory goes.
            truth: configuration.run.truth.take().map(|name| match self.received {
                Some(_) => received::NAME.to_owned(),
                None => name,
            }),
            commands: Vec::new(),
        };
        let mut run = Output::create(&self.directory, "run.toml")?;
        run.write(|file| {
            writeln!(file, "# A recorded run: `geu simulate run.toml --out DIRECTORY` writes the same bytes again.")?;
            file.write_all(configuration.to_toml(false).as_bytes())
        })?;
        Ok(run)
    }

    /// Hands what is buffered to the system.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        for output in [
            &mut self.link,
            &mut self.reference,
            &mut self.truth,
            &mut self.manoeuvres,
            &mut self.commands,
            &mut self.fss,
            &mut self.sse,
        ] {
            output.write(|file| file.flush())?;
        }
        self.late.as_mut().map_or(Ok(()), LateColumn::flush)?;
        self.faults.flush()?;
        self.received.as_mut().map_or(Ok(()), |received| received.output.write(|file| file.flush()))
    }
}

/// What columns changed that the file does not have: those of effects that are there by a fault alone.
fn unforeseen(trace: &Trace, columns: &[usize]) -> f64 {
    let others = trace.changes.iter().enumerate().filter(|(column, _)| columns.binary_search(column).is_err());
    others.map(|(_, change)| change).sum()
}

/// Holds the directory of a recording, by its `run.toml`, for as long as the file lives.
fn hold(directory: &Path) -> Result<File, RecordError> {
    let path = directory.join("run.toml");
    let file = File::options().create(true).truncate(false).write(true).open(&path);
    let held = file.and_then(|file| file.try_lock().map(|()| file).map_err(io::Error::from));
    held.map_err(|source| RecordError { path, source })
}

/// The link that a recording of this form is of: the first such one that is open, else one of the default kind.
fn recorded(wire: WireForm, links: &[Carrier]) -> Carrier {
    let is_can = |carrier: &&Carrier| matches!(carrier.form, Form::Can(_));
    match wire {
        WireForm::Can => Carrier::can(CanPlan::default()),
        WireForm::Serial => {
            let open = links.iter().find(|carrier| !is_can(carrier));
            open.cloned().unwrap_or(Carrier::serial(LinkKind::Pty))
        }
    }
}

/// The links of a run that has none: those of the run that is made again, else those that its faults name, each as its
/// kind has them by default; a serial port at its rate.
fn without_links(configuration: &Configuration) -> Vec<Carrier> {
    let run = &configuration.run;
    let mut kinds = run.links.clone();
    if kinds.is_empty() {
        kinds.extend(configuration.faults.iter().filter_map(|fault| fault.link));
        kinds.sort_unstable();
        kinds.dedup();
    }
    let carrier = |kind| match (kind, run.serial_baud) {
        (LinkKind::Can, _) => Carrier::can(CanPlan::default()),
        (LinkKind::Serial, Some(baud)) => Carrier { kind, form: Form::Serial { baud } },
        (kind, _) => Carrier::serial(kind),
    };
    kinds.into_iter().map(carrier).collect()
}

/// Why a fault of a run without open links would be seen on none of the links that its recording tells; nothing where
/// all are.
pub fn misses(configuration: &Configuration, wire: WireForm) -> Option<String> {
    let links = without_links(configuration);
    let mut told: Vec<LinkKind> = links.iter().map(|carrier| carrier.kind).collect();
    told.push(recorded(wire, &links).kind);
    told.sort_unstable();
    told.dedup();
    configuration.faults.iter().find_map(|fault| fault.misses(&told))
}

/// The rate of a serial port among the links, where it is not the default.
fn serial_baud(links: &[Carrier]) -> Option<u32> {
    links.iter().find_map(|carrier| match carrier.form {
        Form::Serial { baud } if carrier.kind == LinkKind::Serial && baud != DEFAULT_BAUD => Some(baud),
        _ => None,
    })
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
