//! A sample of a unit on its links: the values that its fields carry, and its frames.

use geu_protocol::field::{UNIT_FLAGS, unit_flag};
use geu_protocol::layout::{Field, Frame, FrameSet, Quantity, ValueSpec};

use super::Device;
use crate::gyro_unit::CompletedSample;

impl Device {
    /// Frames of a link of bytes or of CAN; `None` for a link that the unit does not have.
    pub fn frames(&self, is_can: bool) -> Option<&FrameSet> {
        match is_can {
            true => self.can.as_ref().map(|can| &*can.frames),
            false => self.serial.as_ref().map(|serial| &*serial.frames),
        }
    }

    /// The frames that a sample sends on a link, with their bytes.
    pub fn encode(&self, is_can: bool, sample: &CompletedSample) -> Vec<(&Frame, Vec<u8>)> {
        let Some(set) = self.frames(is_can) else { return Vec::new() };
        let values: Vec<f64> = set.values.iter().map(|value| self.value(value, set, sample)).collect();
        let due = set.due(sample.outputs.index);
        due.map(|frame| {
            let mut bytes = Vec::with_capacity(frame.length());
            frame.write(&values, &mut bytes);
            (frame, bytes)
        })
        .collect()
    }

    /// The value of a field.
    fn value(&self, value: &ValueSpec, set: &FrameSet, sample: &CompletedSample) -> f64 {
        let CompletedSample { sample, outputs, .. } = sample;
        let bit = |mask: u8, head: usize| f64::from(mask >> head & 1);
        match &value.quantity {
            Quantity::Output(head) => {
                outputs.counts[*head] * self.heads[*head].count_arcsec / self.arcsec_per_unit(value)
            }
            Quantity::Angle(head) => outputs.angles_arcsec[*head] / value.factor,
            Quantity::Valid(head) => bit(outputs.valid, *head),
            Quantity::Saturated(head) => bit(outputs.saturated, *head),
            Quantity::Sequence => {
                // A fault may put a number before the first.
                let (modulus, step) = (set.sequence.0 as i64, set.sequence.1 as i64);
                (outputs.number as i64).wrapping_mul(step).rem_euclid(modulus) as f64
            }
            Quantity::ClockCount => {
                let is_it = |field: &&Field| set.values[field.slot].quantity == Quantity::ClockCount;
                let fields = set.frames.iter().flat_map(|frame| &frame.fields);
                let bits = fields.filter(is_it).map(|field| field.place.bits).min().unwrap_or(48);
                (sample.clock_count & (u64::MAX >> (64 - bits))) as f64
            }
            Quantity::Latency => 0.0,
            Quantity::Electronics => f64::from(sample.electronics_centi_c) / 100.0,
            Quantity::Temperature(_) | Quantity::Sensor => f64::from(sample.sensor_centi_c) / 100.0,
            Quantity::Status(name) => {
                let is_known = UNIT_FLAGS.iter().any(|flag| flag.name == name);
                f64::from(u8::from(is_known && sample.unit_flags & unit_flag(name) != 0))
            }
        }
    }

    /// Reason why a unit cannot have a fault on a kind of link; the link itself may have others.
    pub fn unable(&self, fault: &str, is_can: bool) -> Option<&'static str> {
        if self.is_iras() {
            return None;
        }
        if matches!(fault, "reply-late" | "reply-missing") {
            return Some("the unit has no commands");
        }
        let Some(set) = self.frames(is_can) else { return Some("the unit has no such link") };
        match fault {
            "sequence-stuck" | "sequence-jump" if set.sequence == (1, 1) => Some("its frames have no sequence"),
            "wrong-length" if !is_can => Some("its frames have no length field that is described"),
            "wrong-identifier" if !is_can => Some("its frames have no type"),
            _ => None,
        }
    }
}
