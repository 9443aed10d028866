//! The angle of each head from the samples of a described unit, and the place of each sample.

use std::ops::Range;

use geu_model::device::{Device, Head, Output};
use geu_protocol::Gyros;
use geu_protocol::layout::{Quantity, ValueSpec};
use geu_recording::DeviceSample;

use super::BreakKind;

/// Relative difference of a clipped sample from the range of the description. A larger sample was not clipped there: it is in another unit.
const SAME: f64 = 1e-6;
/// Distance of rows, in nominal intervals, from which samples are missing between them.
pub(super) const MISSING: f64 = 0.5;

/// Angles of the heads of a described unit, from its samples in order.
#[derive(Debug, Clone)]
pub struct HeadReader {
    gyros: Gyros,
    /// Slot of each head's output, and its angle over the nominal interval, arcsec per unit.
    heads: Vec<(usize, f64)>,
    /// Slots that state the validity of a head: slot, head, the value that excludes it, and the reason.
    flags: Vec<(usize, usize, f64, BreakKind)>,
    /// Size of a clipped sample of each head, arcsec.
    clipped_arcsec: Vec<Range<f64>>,
    is_rate: bool,
    pub is_table: bool,
    pub interval_s: f64,
    /// Start of the first sample interval, ns, and number of the first sample.
    first: Option<(Option<i64>, u64)>,
    /// End of the last sample, in nominal samples since that start.
    pub end: f64,
    group: String,
}

/// Angles of one sample.
pub struct HeadAngles {
    /// Angle of each head, arcsec; `NaN` if missing.
    pub arcsec: Vec<f64>,
    pub invalid: Gyros,
    pub saturated: Gyros,
}

/// Slots of the values of a unit that are wanted.
pub(super) fn slots(device: &Device, wanted: &dyn Fn(&Quantity) -> bool) -> Vec<usize> {
    let all = device.values().iter().enumerate();
    all.filter(|(_, value)| wanted(&value.quantity)).map(|(slot, _)| slot).collect()
}

impl HeadReader {
    pub fn new(device: &Device) -> HeadReader {
        let head = |head: usize| {
            let slot = slots(device, &|quantity| *quantity == Quantity::Output(head))[0];
            (slot, device.arcsec_per_unit(&device.values()[slot]))
        };
        let flag = |(slot, value): (usize, &ValueSpec)| match value.quantity {
            Quantity::Valid(head) => Some((slot, head, 0.0, BreakKind::Invalid)),
            Quantity::Saturated(head) => Some((slot, head, 1.0, BreakKind::Saturated)),
            _ => None,
        };
        let gyros = device.all_gyros();
        let range_arcsec = device.range_arcsec_s * device.interval_s;
        // Clipped to a whole count.
        let clipped_arcsec = |head: &Head| {
            let off_arcsec = SAME * range_arcsec + if head.is_rounded { 0.5 * head.count_arcsec } else { 0.0 };
            range_arcsec - off_arcsec..range_arcsec + off_arcsec
        };
        HeadReader {
            gyros,
            heads: (0..gyros.heads()).map(head).collect(),
            flags: device.values().iter().enumerate().filter_map(flag).collect(),
            clipped_arcsec: device.heads.iter().map(clipped_arcsec).collect(),
            is_rate: device.output == Output::Rate,
            is_table: device.table.is_some() && device.serial.is_none() && device.can.is_none(),
            interval_s: device.interval_s,
            first: None,
            end: 0.0,
            group: String::new(),
        }
    }

    /// True for a row of another trial than the first: a trial has times of its own; one recording is one trial.
    pub fn is_of_other_trial(&mut self, row: &DeviceSample) -> bool {
        if self.first.is_none() {
            row.group.clone_into(&mut self.group);
        }
        row.group != self.group
    }

    /// Start of the first sample: that of the table, else by its number after `zero_ns`; `None` without a sample.
    pub fn start_ns(&self, zero_ns: i64) -> Option<i64> {
        let (start_ns, number) = self.first?;
        let before_ns = (number as f64 * self.interval_s * 1e9).round() as i64;
        if self.is_table { start_ns } else { Some(zero_ns.saturating_add(before_ns)) }
    }

    /// Start and end of a row, in nominal samples since the start of the first; `None` for a repeated row.
    pub fn place(&mut self, row: &DeviceSample) -> Option<(f64, f64)> {
        let interval_ns = self.interval_s * 1e9;
        let end_ns = row.time.map(|time| time.t_ns);
        let row_start_ns =
            row.start.map(|time| time.t_ns).or(end_ns.map(|end_ns| end_ns.saturating_sub(interval_ns as i64)));
        let (start_ns, number) = *self.first.get_or_insert((row_start_ns, row.number));
        let (from, to) = match (self.is_table, start_ns, end_ns, row_start_ns) {
            (true, Some(start_ns), Some(end_ns), Some(row_start_ns)) => {
                let [from, to] = [row_start_ns, end_ns].map(|t_ns| t_ns.saturating_sub(start_ns) as f64 / interval_ns);
                let is_beside = row.start.is_none() && from - self.end < MISSING;
                (if is_beside { self.end } else { from.max(self.end) }, to)
            }
            _ => {
                let from = row.number.saturating_sub(number) as f64;
                (from, from + 1.0)
            }
        };
        (to > self.end).then_some((from, to))
    }

    /// Length of the row after a row of a table, in nominal samples; `None` if it is farther off than the next one.
    pub fn length_after(&self, row: &DeviceSample, after: &DeviceSample) -> Option<f64> {
        let (end, after_end) = row.time.zip(after.time).filter(|_| row.group == after.group)?;
        let length = after_end.t_ns.saturating_sub(end.t_ns) as f64 * 1e-9 / self.interval_s;
        ((length - 1.0).abs() < MISSING).then_some(length)
    }

    /// Angle of each head over the nominal interval of rates, or over the row of increments, arcsec; `NaN` if missing.
    pub fn arcsec(&self, row: &DeviceSample) -> Vec<f64> {
        let finite = |arcsec: f64| if arcsec.is_finite() { arcsec } else { f64::NAN };
        self.heads.iter().map(|&(slot, arcsec)| finite(row.values[slot] * arcsec)).collect()
    }

    /// Length over which a rate lasts in a row of this length, in nominal samples; an increment is that of its row.
    pub fn rate_length(&self, length: f64) -> f64 {
        if self.is_rate && self.is_table { length } else { 1.0 }
    }

    /// The angles of a row.
    pub fn angles(&self, row: &DeviceSample) -> HeadAngles {
        let all = self.gyros;
        let arcsec = self.arcsec(row);
        let flagged = |kind: BreakKind| {
            let own = self.flags.iter().filter(|own| own.3 == kind && row.values[own.0] == own.2);
            own.fold(all.with_mask(0), |gyros, own| gyros.and(all.only(own.1)))
        };
        HeadAngles {
            invalid: flagged(BreakKind::Invalid).and(all.filter(|gyro| arcsec[gyro].is_nan())),
            saturated: flagged(BreakKind::Saturated)
                .and(all.filter(|gyro| self.clipped_arcsec[gyro].contains(&arcsec[gyro].abs()))),
            arcsec,
        }
    }
}
