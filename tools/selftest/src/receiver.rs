//! The receiver of the link: counts, flags, temperatures and the instants of reception.

use geu_protocol::command::{self, COMMANDS};
use geu_protocol::{CommandResult, Gyro, Sample};

use geu_model::attitude::{AttitudeProfile, Motion};
use geu_model::{Configuration, GyroUnit};

/// State of the receiver at the end of a sample interval.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// Instant of reception, true time since the start.
    pub t_s: f64,
    /// Accumulated counts, in the order of [`Gyro::ALL`].
    pub counts: [f64; 4],
    /// Accumulated rotation of the reference attitude about the control axes.
    pub reference_arcsec: [f64; 3],
    pub sample: Sample,
}

impl Row {
    /// Counts of `gyro` less the reference rotation about its control axis.
    pub fn residual(&self, gyro: Gyro) -> f64 {
        let axis = match gyro {
            Gyro::X => 0,
            Gyro::Y => 1,
            _ => 2,
        };
        self.counts[gyro.index()] - self.reference_arcsec[axis]
    }
}

/// Receives the samples of a unit; the commanded attitude is known.
pub struct Receiver {
    unit: GyroUnit,
    reference: Motion,
    now: Row,
}

impl Receiver {
    /// A unit that starts, and its receiver.
    pub fn new(configuration: &Configuration) -> Receiver {
        let plan = AttitudeProfile::new(&configuration.scenario)
            .expect("a configuration holds only scenarios that were tried");
        Receiver {
            unit: GyroUnit::new(configuration),
            reference: Motion::new(plan, configuration.scenario.limit_cycle),
            now: Row { t_s: 0.0, counts: [0.0; 4], reference_arcsec: [0.0; 3], sample: Sample::default() },
        }
    }

    /// Every row until `until_s` of on-board time.
    pub fn listen(&mut self, until_s: f64) -> Vec<Row> {
        self.listen_every(1, until_s)
    }

    /// Every `stride`-th row until `until_s` of on-board time.
    pub fn listen_every(&mut self, stride: u64, until_s: f64) -> Vec<Row> {
        let mut rows = Vec::new();
        while (self.unit.ended() as f64) < 2.0 * until_s {
            let ended = self.unit.end_sample();
            self.now.t_s = ended.end_ns as f64 * 1e-9;
            self.now.sample = ended.sample;
            for (counts, increment) in self.now.counts.iter_mut().zip(ended.sample.increments) {
                *counts += f64::from(increment);
            }
            if self.unit.ended().is_multiple_of(stride) {
                let turned = self.reference.advance(self.now.t_s).angle_control_arcsec;
                for (sum, angle) in self.now.reference_arcsec.iter_mut().zip(turned) {
                    *sum += angle;
                }
                rows.push(self.now);
            }
        }
        rows
    }

    /// Sends a command by its name; true if the unit answers that it is done.
    pub fn command(&mut self, name: &str, values: &[i64]) -> bool {
        COMMANDS
            .iter()
            .find(|spec| spec.name == name)
            .and_then(|spec| self.unit.command(&command::payload(spec, values)).ok())
            .is_some_and(|answer| answer.reply.outcome() == CommandResult::Done)
    }
}

/// The rows from `from_s` to `to_s`.
pub fn between(rows: &[Row], from_s: f64, to_s: f64) -> &[Row] {
    let index = |t_s: f64| rows.partition_point(|row| row.t_s < t_s);
    &rows[index(from_s)..index(to_s)]
}

/// Rates of the reference about a control axis, arcsec/s, with the index of the row at the end of each.
pub fn reference_rates(rows: &[Row], axis: usize) -> impl Iterator<Item = (usize, f64)> {
    rows.windows(2).enumerate().map(move |(index, pair)| {
        let turned_arcsec = pair[1].reference_arcsec[axis] - pair[0].reference_arcsec[axis];
        (index + 1, turned_arcsec / (pair[1].t_s - pair[0].t_s))
    })
}
