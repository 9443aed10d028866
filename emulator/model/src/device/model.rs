//! What the model takes from a unit: interval, limits, gyros.

use super::DEFAULT_DEVICE;
use geu_protocol::layout::{Field, Quantity, ValueSpec};
use geu_protocol::{Gyro, Gyros};

use super::{Device, Head, Output};
use crate::parameter_spec::Widening;
use crate::units::{ARCSEC_PER_RAD, AngleUnit, FULL_SCALE_ARCSEC_S};

/// Smallest limit of relative errors of described units, ppm; that of the projections of an input axis is 45°.
const DESCRIBED_PPM: f64 = 1e5;

impl Device {
    /// True for the default unit, with commands and links of its own: it alone has no description.
    pub fn is_iras(&self) -> bool {
        self.description.text.is_empty()
    }

    /// Name of the unit as `--device` has it, or of the file of its description, without `.toml`.
    pub fn unit_name(&self) -> &str {
        if self.is_iras() {
            return DEFAULT_DEVICE;
        }
        let name = self.description.name.rsplit('/').next().unwrap_or_default();
        self.known_name().unwrap_or(name.strip_suffix(".toml").unwrap_or(name))
    }

    /// True for a value that is a count of samples or of the clock, and whole on every link.
    pub fn is_count(&self, slot: usize) -> bool {
        let is_count = matches!(self.values()[slot].quantity, Quantity::Sequence | Quantity::ClockCount);
        let sets = [false, true].into_iter().filter_map(|is_can| self.frames(is_can));
        let mut fields =
            sets.flat_map(|set| &set.frames).flat_map(|frame| &frame.fields).filter(|own| own.slot == slot);
        is_count && self.table.is_none() && fields.all(Field::is_whole)
    }

    /// True unless the samples of the unit come in a table alone.
    pub fn has_link(&self) -> bool {
        self.is_iras() || self.serial.is_some() || self.can.is_some()
    }

    /// Nominal interval of samples, ns.
    pub fn interval_ns(&self) -> i64 {
        (self.interval_s * 1e9).round() as i64
    }

    /// Interval of a reference attitude, ns: that of the samples, or a multiple of it of 10 ms or more.
    pub fn reference_interval_ns(&self) -> i64 {
        // Of the exact interval, so that rows stay at the ends of samples.
        let interval_ns = self.interval_s * 1e9;
        (interval_ns * (10_000_000.0 / interval_ns - 1e-9).ceil().max(1.0)).round() as i64
    }

    /// On-board time at which a sample begins, since the start of the first, s.
    pub fn on_board_s(&self, sample: u64) -> f64 {
        sample as f64 * self.interval_s
    }

    /// Smallest and largest output of a head, counts; 16 bits for the default unit.
    pub fn limits(&self, head: &Head) -> (f64, f64) {
        if self.is_iras() {
            return (f64::from(i16::MIN), f64::from(i16::MAX));
        }
        let most = head.rounded(self.range_arcsec_s * self.interval_s / head.count_arcsec);
        (-most, most)
    }

    /// Limits of rates grow with the range of the unit; relative errors may be as large as of MEMS gyros.
    pub fn widening(&self) -> Widening {
        match self.is_iras() {
            true => Widening::default(),
            false => Widening {
                rate_factor: (self.range_arcsec_s / FULL_SCALE_ARCSEC_S).max(1.0),
                ppm: DESCRIBED_PPM,
                misalignment_arcsec: ARCSEC_PER_RAD,
            },
        }
    }

    /// Angle of an output over the nominal interval in the unit of its field, arcsec.
    pub fn arcsec_per_unit(&self, value: &ValueSpec) -> f64 {
        match self.output {
            Output::Increment => value.factor,
            Output::Rate => value.factor * self.interval_s,
        }
    }

    /// Unit of the angle in the output of the first head.
    pub fn angle_unit(&self) -> AngleUnit {
        let output = self.values().iter().find(|value| value.quantity == Quantity::Output(0));
        let unit = output.and_then(|value| value.name.strip_prefix(self.heads[0].gyro.name()));
        AngleUnit::from_name(unit.and_then(|unit| unit.split('_').nth(1)).unwrap_or_default())
    }

    /// Samples from one frame with an angle to the next; `None` without such frames.
    ///
    /// # Errors
    /// It is not the same in all frames with angles: the message.
    pub(super) fn samples_of_angles(&self) -> Result<Option<u64>, String> {
        let links = [false, true].into_iter().filter_map(|is_can| self.frames(is_can));
        let sent = links.flat_map(|set| &set.frames).filter(|frame| frame.instead_of.is_none() || frame.every > 1);
        let is_angle = |field: &Field| matches!(self.values()[field.slot].quantity, Quantity::Angle(_));
        let mut every = sent.filter(|frame| frame.fields.iter().any(is_angle)).map(|frame| frame.every);
        let Some(first) = every.next() else { return Ok(None) };
        match every.find(|other| *other != first) {
            None => Ok(Some(first.into())),
            Some(other) => Err(format!("expected angles of as many samples in all frames, got {first} and {other}")),
        }
    }

    /// The unit with another interval of samples, of which one count is an arcsec: for a model of angles between nodes.
    #[must_use]
    pub fn at_nodes(&self, interval_s: f64) -> Device {
        let mut device = Device { interval_s, output: Output::Increment, ..self.clone() };
        device.heads.iter_mut().for_each(|head| head.count_arcsec = 1.0);
        device
    }

    /// True if its messages contain a temperature.
    pub fn sends_temperature(&self) -> bool {
        let is_temperature = |quantity: &Quantity| {
            matches!(quantity, Quantity::Electronics | Quantity::Sensor | Quantity::Temperature(_))
        };
        self.values().iter().any(|value| is_temperature(&value.quantity))
    }

    /// The gyros.
    pub fn gyros(&self) -> impl Iterator<Item = Gyro> {
        self.heads.iter().map(|head| head.gyro)
    }

    /// All gyros.
    pub fn all_gyros(&self) -> Gyros {
        Gyros::of_unit(&self.gyros().collect::<Vec<_>>())
    }

    /// The gyro of that name.
    pub fn gyro(&self, name: &str) -> Option<Gyro> {
        self.gyros().find(|gyro| gyro.name() == name)
    }
}
