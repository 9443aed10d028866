//! What the rows tell of themselves: sequence, flags, ends of the range, temperatures.

use geu_protocol::Gyro;
use geu_protocol::continuity::SequenceStep;
use geu_protocol::field::unit_flag;
use geu_recording::ReceivedSample;

use super::timeline::SampleTimes;
use super::told::{FindingCollector, FindingKind, same};

const fn kind(name: &'static str, what: &'static str) -> FindingKind {
    FindingKind { name, what, unit: "" }
}

const GAP: FindingKind = kind("gap", "samples are missing");
const REPEAT: FindingKind = kind("repeat", "samples came again");
const REPEAT_DIFFERS: FindingKind =
    kind("repeat-differs", "samples came again with the same sequence and other contents");
const RESET: FindingKind = kind("reset", "times sequence and clock restarted");
const SEQUENCE_JUMP: FindingKind = kind("sequence-jump", "times sequence and clock jumped");
const INVALID: FindingKind = kind("invalid", "samples are marked as no measurement");
const SATURATED: FindingKind = kind("saturated", "samples are marked as clipped");
const CLIPPED: FindingKind = kind("clipped", "samples stand at an end of 16 bits and are not marked as clipped");
const SATURATED_INSIDE: FindingKind =
    kind("saturated-inside", "samples are marked as clipped and stand inside 16 bits");
const SELF_TEST: FindingKind = kind("self-test", "samples have the pattern of the self-test in them");
const NOT_SYNCHRONOUS: FindingKind = kind("not-synchronous", "samples have a spin motor that is not synchronous");
const SYNCHRONOUS_FLAG: FindingKind =
    kind("synchronous-flag", "samples have a motor not synchronous and yet all gyros valid");
const HEATER: FindingKind = kind("heater", "samples have the sensor heater out of 70 ± 1 °C");
const HEATER_FLAG: FindingKind = kind("heater-flag", "samples have a sensor temperature that the heater's flag denies");
const CLOCK_UNLOCKED: FindingKind = kind("clock-unlocked", "samples have the clock not locked");
const SENSOR_JUMP: FindingKind =
    FindingKind { name: "sensor-temperature-jump", what: "jumps of the sensor temperature", unit: "K" };
const ELECTRONICS_JUMP: FindingKind =
    FindingKind { name: "electronics-temperature-jump", what: "jumps of the electronics temperature", unit: "K" };

/// More than this within a sample interval is no temperature: a heater that warms by 50 K with 20 min does 0.02 K.
const TEMPERATURE_JUMP_CENTI_K: i32 = 100;
/// The heater's band, and what rounding and the moment of the flag may add.
const BAND_CENTI_C: std::ops::RangeInclusive<i16> = 6890..=7110;

/// Notes what is there; counts at an end of their range get the flag that says so.
pub fn check(rows: &mut [ReceivedSample], timeline: &SampleTimes, told: &mut FindingCollector) {
    let mut before: Option<ReceivedSample> = None;
    for (index, row) in rows.iter_mut().enumerate() {
        match timeline.steps[index] {
            SequenceStep::First | SequenceStep::Next => {}
            SequenceStep::Repeat => {
                let kind = if before.is_some_and(|before| same(&before, row)) { REPEAT } else { REPEAT_DIFFERS };
                told.note(kind, None, index, 1, 0.0);
                continue;
            }
            SequenceStep::Gap(missing) => told.note(GAP, None, index, missing, 0.0),
            SequenceStep::Reset => told.note(RESET, None, index, 1, 0.0),
            SequenceStep::Jump => told.note(SEQUENCE_JUMP, None, index, 1, 0.0),
        }
        flags(row, index, told);
        if let Some(before) = before
            && timeline.steps[index] == SequenceStep::Next
        {
            temperatures(&before, row, index, told);
        }
        before = Some(*row);
        saturation(row, index, told);
    }
}

fn flags(row: &ReceivedSample, index: usize, told: &mut FindingCollector) {
    let sample = &row.sample;
    let is_set = |name: u8| sample.unit_flags & name != 0;
    for gyro in Gyro::ALL {
        if sample.gyro_flags & gyro.bit() == 0 {
            told.note(INVALID, Some(gyro), index, 1, 0.0);
        }
    }
    if is_set(const { unit_flag("self_test") }) {
        told.note(SELF_TEST, None, index, 1, 0.0);
    }
    if !is_set(const { unit_flag("motors_synchronous") }) {
        let all_valid = sample.gyro_flags & 0x0F == 0x0F;
        told.note(if all_valid { SYNCHRONOUS_FLAG } else { NOT_SYNCHRONOUS }, None, index, 1, 0.0);
    }
    if !is_set(const { unit_flag("clock_locked") }) {
        told.note(CLOCK_UNLOCKED, None, index, 1, 0.0);
    }
    if !is_set(const { unit_flag("heater_in_band") }) {
        told.note(HEATER, None, index, 1, 0.0);
    } else if row.has_clock && !BAND_CENTI_C.contains(&sample.sensor_centi_c) {
        told.note(HEATER_FLAG, None, index, 1, 0.0);
    }
}

fn temperatures(before: &ReceivedSample, row: &ReceivedSample, index: usize, told: &mut FindingCollector) {
    let (was, is) = (&before.sample, &row.sample);
    let mut compare = |kind, was: i16, is: i16| {
        let change = i32::from(is) - i32::from(was);
        if change.abs() > TEMPERATURE_JUMP_CENTI_K {
            told.note(kind, None, index, 1, f64::from(change) * 0.01);
        }
    };
    compare(ELECTRONICS_JUMP, was.electronics_centi_c, is.electronics_centi_c);
    if before.has_clock && row.has_clock {
        compare(SENSOR_JUMP, was.sensor_centi_c, is.sensor_centi_c);
    }
}

fn saturation(row: &mut ReceivedSample, index: usize, told: &mut FindingCollector) {
    for gyro in Gyro::ALL {
        let at_end = matches!(row.sample.increments[gyro as usize], i16::MIN | i16::MAX);
        let flag = gyro.bit() << 4;
        let kind = match (row.sample.gyro_flags & flag != 0, at_end) {
            (false, false) => continue,
            (true, true) => SATURATED,
            (true, false) => SATURATED_INSIDE,
            (false, true) => CLIPPED,
        };
        row.sample.gyro_flags |= flag;
        told.note(kind, Some(gyro), index, 1, 0.0);
    }
}
