//! Summary of all inputs.

use std::fmt::{self, Display, Formatter};

use geu_protocol::capture::Timestamp;

use crate::account::DecodeAccount;
use crate::cadence::IntervalStatistics;
use crate::clock_fit::ClockFit;
use crate::others::Others;

/// Account and statistics of everything decoded. [`Display`] writes it: a name, then values, on each line.
#[derive(Debug, Default)]
pub struct DecodeSummary {
    /// Names and formats of the inputs.
    pub inputs: Vec<(String, String)>,
    /// Interface of the rows of CAN, several with commas.
    pub interface: Option<String>,
    /// Frames of the unit on other interfaces.
    pub elsewhere: Vec<(String, u64)>,
    pub account: DecodeAccount,
    /// Identifiers, until the first row.
    pub others: Others,
    pub rows: u64,
    pub serial_frames: u64,
    /// Time of the first and the last row.
    pub span: Option<(Timestamp, Timestamp)>,
    pub lost: u64,
    /// The first gaps: place, time, samples missing.
    pub gaps: Vec<(String, Option<Timestamp>, u64)>,
    pub repeats: u64,
    pub resets: u64,
    /// Rows without clock count and sensor temperature.
    pub without_clock: u64,
    /// Name of each head, and the rows in which it is not valid, and saturated.
    pub heads: Vec<(String, u64, u64)>,
    /// Name of the unit, if a description was given.
    pub device: Option<String>,
    /// Frames of a described unit that were read, by their names.
    pub frames: Vec<(String, u64)>,
    pub polled: u64,
    /// Frames that recorder or socket lost.
    pub dropped: u64,
    pub cadence: IntervalStatistics,
    /// The longest interval between rows, gaps included, ns, and its end.
    pub largest: Option<(i64, String)>,
    /// The unit's clock.
    pub clock: ClockFit,
    pub is_timed: bool,
}

impl Display for DecodeSummary {
    fn fmt(&self, out: &mut Formatter) -> fmt::Result {
        for (name, kind) in &self.inputs {
            line(out, "input", format_args!("{name} {kind}"))?;
        }
        if let Some(device) = &self.device {
            line(out, "device", device)?;
        }
        line(out, "rows", self.rows)?;
        if let Some((first, last)) = self.span {
            line(out, "span_s", format_args!("{first} to {last}"))?;
        }
        if let Some(interface) = self.interface.as_ref().filter(|name| !name.is_empty()) {
            line(out, "interface", interface)?;
        }
        for (name, frames) in &self.elsewhere {
            line(out, "interface-not-used", format_args!("{name} {frames} frames of the unit"))?;
        }
        self.write_account(out)?;
        self.write_sequence(out)?;
        self.write_times(out)
    }
}

fn line(out: &mut Formatter, name: &str, value: impl Display) -> fmt::Result {
    writeln!(out, "{name:<24} {value}")
}

impl DecodeSummary {
    /// Notes an interface with rows in use; each input may have its own.
    pub(crate) fn use_interface(&mut self, name: &str) {
        match &mut self.interface {
            Some(names) if names.split(", ").any(|known| known == name) => {}
            Some(names) => *names = format!("{names}, {name}"),
            None => self.interface = Some(name.to_owned()),
        }
    }

    /// Notes frames of the unit on an interface that is not used.
    pub(crate) fn leave_out(&mut self, name: &str, frames: u64) {
        match self.elsewhere.iter_mut().find(|(known, _)| known == name) {
            _ if frames == 0 => {}
            Some((_, count)) => *count += frames,
            None => self.elsewhere.push((name.to_owned(), frames)),
        }
    }

    fn write_account(&self, out: &mut Formatter) -> fmt::Result {
        let account = &self.account;
        let (records, bytes) = account.missing();
        if account.records > 0 {
            line(out, "records", account.records)?;
            for (name, count) in account.record_counts() {
                line(out, &format!("records-{name}"), count)?;
            }
        }
        if account.bytes > 0 {
            line(out, "bytes", account.bytes)?;
            for (name, count) in account.byte_counts() {
                line(out, &format!("bytes-{name}"), count)?;
            }
        }
        line(
            out,
            "account",
            if account.adds_up() {
                "accounts for all".to_owned()
            } else {
                format!("DOES NOT ADD UP: {records} records and {bytes} bytes unexplained")
            },
        )?;
        for (name, count) in &self.frames {
            line(out, &format!("frames-{name}"), count)?;
        }
        line(out, "defects", account.defect_count())?;
        for (kind, count) in &account.defects {
            line(out, &format!("defect-{}", kind.name()), count)?;
        }
        if self.dropped > 0 {
            line(out, "frames-dropped", format_args!("{} by recorder or socket", self.dropped))?;
        }
        Ok(())
    }

    fn write_sequence(&self, out: &mut Formatter) -> fmt::Result {
        line(out, if self.device.is_some() { "samples-lost" } else { "half-seconds-lost" }, self.lost)?;
        for (place, time, lost) in &self.gaps {
            let time = time.map_or(String::new(), |time| format!(" t_s {time}"));
            line(out, "gap", format_args!("{lost} before {place}{time}"))?;
        }
        line(out, "repeats", self.repeats)?;
        if self.device.is_none() {
            line(out, "resets", self.resets)?;
            line(out, "polled", self.polled)?;
            line(out, "without-clock", self.without_clock)?;
        }
        let counts = |count: fn(&(String, u64, u64)) -> u64| {
            self.heads.iter().map(|head| format!("{} {}", head.0, count(head))).collect::<Vec<_>>().join(" ")
        };
        if self.heads.is_empty() {
            return Ok(());
        }
        line(out, "not-valid", counts(|head| head.1))?;
        line(out, "saturated", counts(|head| head.2))
    }

    fn write_times(&self, out: &mut Formatter) -> fmt::Result {
        if self.rows == 0 {
            return Ok(());
        }
        if !self.is_timed {
            let why = "not measurable: the recording holds no receive times";
            line(out, "interval_s", why)?;
            return if self.device.is_some() { Ok(()) } else { line(out, "clock_ppm", why) };
        }
        if self.cadence.count() > 0 {
            let median = self.cadence.median_s().map_or("1 or more".to_owned(), |median| format!("{median:.6}"));
            line(
                out,
                "interval_s",
                format_args!(
                    "min {:.6} median {median} max {:.6} sigma {:.6} n {}",
                    self.cadence.min_s(),
                    self.cadence.max_s(),
                    self.cadence.sigma_s(),
                    self.cadence.count()
                ),
            )?;
        }
        if let Some((interval_ns, place)) = &self.largest {
            line(out, "interval-largest_s", format_args!("{:.6} before {place}", *interval_ns as f64 * 1e-9))?;
        }
        match self.clock.rate() {
            _ if self.device.is_some() => Ok(()),
            Some(rate) => line(
                out,
                "clock_ppm",
                format_args!(
                    "{:+.4} sigma {:.4} n {} segments {} residual_us {:.1} correlation {:.2}",
                    rate.clock_ppm,
                    rate.sigma_ppm,
                    rate.points,
                    rate.segments,
                    rate.residual_s * 1e6,
                    rate.correlation
                ),
            ),
            None => line(out, "clock_ppm", "not measurable: fewer than three timed rows with a clock count"),
        }
    }
}
