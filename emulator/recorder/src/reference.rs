//! The motion of a recording, in true time: reference attitude, manoeuvres, sensor fixes, and the received truth.

use std::collections::VecDeque;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use geu_model::attitude::{Leg, StreamedAttitude};
use geu_model::simulation::ReferenceSource;
use geu_model::units::RAD_PER_DEG;
use geu_model::{Configuration, Truth};
use geu_protocol::capture::Timestamp;

use crate::output::{Output, RecordError};
use crate::received;

/// `received.csv`, for a truth received during the run.
struct Received {
    output: Output,
    truth: Arc<StreamedAttitude>,
    /// Number of knots written, with the start, which is not in the file.
    written: u64,
}

pub(crate) struct ReferenceFiles {
    reference: Output,
    manoeuvres: Output,
    fss: Output,
    sse: Output,
    received: Option<Received>,
    start_unix_ns: i64,
    /// Evaluated at true sample intervals.
    source: ReferenceSource,
    rows: i64,
    /// Spacing of `reference.csv`, true time, ns.
    interval_ns: i64,
    /// Legs that have begun and are not written yet, in order.
    legs: VecDeque<Leg>,
    /// True once the headers that depend on the sun are written.
    has_truth_headers: bool,
    /// Scheduled end of the last sample, ns.
    end_ns: i64,
}

impl ReferenceFiles {
    /// Creates the files with the headers that are known.
    pub fn create(
        directory: &Path,
        configuration: &Configuration,
        truth: &Truth,
    ) -> Result<ReferenceFiles, RecordError> {
        let create = |name| Output::create(directory, name);
        let received = match truth {
            Truth::Stepped(truth) => {
                Some(Received { output: create(received::NAME)?, truth: truth.clone(), written: 1 })
            }
            Truth::Scenario | Truth::Recorded(_) => None,
        };
        let mut files = ReferenceFiles {
            reference: create("reference.csv")?,
            manoeuvres: create("manoeuvres.csv")?,
            fss: create("fss.csv")?,
            sse: create("sse.csv")?,
            received,
            start_unix_ns: configuration.start_unix_ns,
            source: ReferenceSource::new(configuration, truth),
            rows: 0,
            interval_ns: configuration.device.reference_interval_ns(),
            legs: VecDeque::new(),
            has_truth_headers: false,
            end_ns: 0,
        };
        // The first sample of a simulator shows if it reports the sun.
        if files.received.is_none() {
            files.truth_headers()?;
        }
        files.manoeuvres.write(|file| writeln!(file, "manoeuvre,start_s,end_s"))?;
        files.fss.write(|file| writeln!(file, "t_s,theta_arcsec,roll_arcsec"))?;
        files.sse.write(|file| writeln!(file, "t_s,star,slit,theta_deg,psi_deg,sigma_arcsec"))?;
        Ok(files)
    }

    /// Writes, once, the headers of the files that contain the sun if it is known.
    fn truth_headers(&mut self) -> Result<(), RecordError> {
        if std::mem::replace(&mut self.has_truth_headers, true) {
            return Ok(());
        }
        let rates = "rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s";
        let has_sun = self.source.motion().unavailable().is_empty();
        let angles = if has_sun { ",theta_deg,psi_deg" } else { "" };
        self.reference.write(|file| writeln!(file, "t_s,{rates}{angles}"))?;
        let Some(received) = &mut self.received else { return Ok(()) };
        received.output.write(|file| received::write_header(file, has_sun))
    }

    /// Writes the rows up to the end of a sample.
    pub fn sample(&mut self, end_ns: i64) -> Result<(), RecordError> {
        if self.received.is_some() {
            // One sample late: the truth after the end of this one may not be known yet.
            self.received_rows()?;
        }
        while self.received.is_none() && self.rows * self.interval_ns < end_ns {
            self.row()?;
        }
        self.end_ns = end_ns;
        while self.legs.front().is_some_and(|leg| ns(leg.end_s) <= end_ns) {
            let leg = self.legs.pop_front().expect("not empty");
            self.manoeuvre(&leg)?;
        }
        Ok(())
    }

    /// Writes the remaining rows at the end of the run.
    pub fn end(&mut self) -> Result<(), RecordError> {
        if self.received.is_some() {
            self.received_rows()?;
        }
        for leg in std::mem::take(&mut self.legs) {
            self.manoeuvre(&leg)?;
        }
        Ok(())
    }

    /// Writes the knots that became known, and the rows of the reference up to the end of the last sample.
    fn received_rows(&mut self) -> Result<(), RecordError> {
        self.truth_headers()?;
        let Some(Received { output, truth, written }) = &mut self.received else { return Ok(()) };
        let knots = truth.knots_from(*written);
        *written += knots.len() as u64;
        output.write(|file| knots.iter().try_for_each(|knot| received::write_row(file, knot)))?;
        while (self.rows + 1) * self.interval_ns <= self.end_ns {
            self.row()?;
        }
        Ok(())
    }

    /// Writes the part of a leg that is executed by now, if any.
    fn manoeuvre(&mut self, leg: &Leg) -> Result<(), RecordError> {
        let [start, end] =
            [leg.start_s, leg.end_s].map(|t_s| Timestamp::micros(self.start_unix_ns + ns(t_s).min(self.end_ns)));
        if start == end {
            return Ok(());
        }
        self.manoeuvres.write(|file| writeln!(file, "{},{start},{end}", leg.name))
    }

    fn row(&mut self) -> Result<(), RecordError> {
        self.rows += 1;
        let end_ns = self.rows * self.interval_ns;
        let sample = self.source.advance(end_ns as f64 * 1e-9);
        let end = Timestamp::micros(self.start_unix_ns + end_ns);
        self.reference.write(|file| {
            let [x, y, z] = sample.step.angle_control_arcsec.map(|angle| angle / sample.step.length_s);
            write!(file, "{end},{x:.9},{y:.9},{z:.9}")?;
            if let Some((theta_rad, psi_rad)) = sample.theta_psi_rad {
                let [theta_deg, psi_deg] = [theta_rad, psi_rad].map(|rad| rad / RAD_PER_DEG);
                write!(file, ",{theta_deg:.9},{:.9}", psi_deg.rem_euclid(360.0))?;
            }
            writeln!(file)
        })?;
        self.legs.extend(sample.legs);
        if let Some(sun) = sample.sun {
            self.fss.write(|file| writeln!(file, "{end},{:.3},{:.3}", sun.theta_arcsec, sun.roll_arcsec))?;
        }
        for fix in sample.fixes.into_iter().flatten() {
            let stamp = Timestamp::micros(self.start_unix_ns + ns(fix.t_s));
            self.sse.write(|file| {
                write!(file, "{stamp},{},{},", fix.star, fix.slit)?;
                writeln!(file, "{:.9},{:.9},{}", fix.theta_deg, fix.psi_deg, fix.sigma_arcsec)
            })?;
        }
        Ok(())
    }

    /// Flushes the received truth.
    pub fn flush_received(&mut self) -> Result<(), RecordError> {
        self.received.as_mut().map_or(Ok(()), |received| received.output.flush())
    }

    /// Flushes the other files.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        [&mut self.reference, &mut self.manoeuvres, &mut self.fss, &mut self.sse]
            .into_iter()
            .try_for_each(Output::flush)
    }
}

/// Converts s to ns, and saturates.
fn ns(t_s: f64) -> i64 {
    (t_s * 1e9).round() as i64
}
