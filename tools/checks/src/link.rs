//! Checks of single rows: sequence, flags, limits of the counts, temperatures.

use geu_protocol::Gyro;
use geu_protocol::continuity::SequenceStep;
use geu_protocol::field::unit_flag;
use geu_recording::ReceivedSample;

use super::findings::{FindingCollector, FindingKind, same};
use super::timeline::SampleTimes;

/// A kind of note without a value.
const fn kind(name: &'static str, what: &'static str) -> FindingKind {
    FindingKind { name, what, unit: "" }
}

/// Smallest temperature jump within a sample interval; a heater that warms by 50 K with 20 min changes it by 0.02 K.
const TEMPERATURE_JUMP_CENTI_K: i32 = 100;
/// The heater's band, with margins for rounding and the time of the flag.
const BAND_CENTI_C: std::ops::RangeInclusive<i16> = 6890..=7110;

/// Notes the defects of each row; counts at a limit of 16 bits get the saturation flag.
pub fn check(rows: &mut [ReceivedSample], timeline: &SampleTimes, findings: &mut FindingCollector) {
    let mut before: Option<ReceivedSample> = None;
    for (index, row) in rows.iter_mut().enumerate() {
        let (note, count) = match timeline.steps[index] {
            SequenceStep::First | SequenceStep::Next => (None, 0),
            SequenceStep::Repeat => {
                let kind = match before.is_some_and(|before| same(&before, row)) {
                    true => kind("repeat", "samples came again"),
                    false => kind("repeat-differs", "samples came again with the same sequence and other contents"),
                };
                findings.note(kind, None, index, 1, 0.0);
                continue;
            }
            SequenceStep::Gap(missing) => (Some(kind("gap", "samples are missing")), missing),
            SequenceStep::Reset => (Some(kind("reset", "times sequence and clock restarted")), 1),
            SequenceStep::Jump => (Some(kind("sequence-jump", "times sequence and clock jumped")), 1),
        };
        note.into_iter().for_each(|kind| findings.note(kind, None, index, count, 0.0));
        flags(row).into_iter().for_each(|(gyro, kind)| findings.note(kind, gyro, index, 1, 0.0));
        if let Some(before) = before.filter(|_| timeline.steps[index] == SequenceStep::Next) {
            temperatures(&before, row, index, findings);
        }
        before = Some(*row);
        saturation(row, index, findings);
    }
}

/// The kinds of note of a row's flags.
fn flags(row: &ReceivedSample) -> Vec<(Option<Gyro>, FindingKind)> {
    let sample = &row.sample;
    let is_set = |flag: u8| sample.unit_flags & flag != 0;
    let invalid = |gyro: Gyro| (Some(gyro), kind("invalid", "samples are marked as no measurement"));
    let invalid_gyros = Gyro::ALL.into_iter().filter(|gyro| sample.gyro_flags & gyro.bit() == 0);
    let mut notes: Vec<_> = invalid_gyros.map(invalid).collect();
    let mut note = |is_noted: bool, name, what| notes.extend(is_noted.then_some((None, kind(name, what))));
    let is_self_test = is_set(const { unit_flag("self_test") });
    note(is_self_test, "self-test", "samples have the pattern of the self-test in them");
    let is_asynchronous = !is_set(const { unit_flag("motors_synchronous") });
    let all_valid = sample.gyro_flags & 0x0F == 0x0F;
    let contradiction = "samples have a motor not synchronous and yet all gyros valid";
    note(is_asynchronous && all_valid, "synchronous-flag", contradiction);
    note(is_asynchronous && !all_valid, "not-synchronous", "samples have a spin motor that is not synchronous");
    note(!is_set(const { unit_flag("clock_locked") }), "clock-unlocked", "samples have the clock not locked");
    let (in_band, is_cold) =
        (is_set(const { unit_flag("heater_in_band") }), !BAND_CENTI_C.contains(&sample.sensor_centi_c));
    note(!in_band, "heater", "samples have the sensor heater out of 70 ± 1 °C");
    let contradiction = "samples have a sensor temperature that the heater's flag denies";
    note(in_band && row.has_clock && is_cold, "heater-flag", contradiction);
    notes
}

fn temperatures(before: &ReceivedSample, row: &ReceivedSample, index: usize, findings: &mut FindingCollector) {
    let (was, is) = (&before.sample, &row.sample);
    let mut compare = |name, what, was: i16, is: i16| {
        let change = i32::from(is) - i32::from(was);
        if change.abs() > TEMPERATURE_JUMP_CENTI_K {
            findings.note(FindingKind { name, what, unit: "K" }, None, index, 1, f64::from(change) * 0.01);
        }
    };
    let what = "jumps of the electronics temperature";
    compare("electronics-temperature-jump", what, was.electronics_centi_c, is.electronics_centi_c);
    if before.has_clock && row.has_clock {
        let what = "jumps of the sensor temperature";
        compare("sensor-temperature-jump", what, was.sensor_centi_c, is.sensor_centi_c);
    }
}

fn saturation(row: &mut ReceivedSample, index: usize, findings: &mut FindingCollector) {
    for gyro in Gyro::ALL {
        let at_limit = matches!(row.sample.increments[gyro.index()], i16::MIN | i16::MAX);
        let flag = gyro.bit() << 4;
        let (name, what) = match (row.sample.gyro_flags & flag != 0, at_limit) {
            (false, false) => continue,
            (true, true) => ("saturated", "samples are marked as clipped"),
            (true, false) => ("saturated-inside", "samples are marked as clipped within 16 bits"),
            (false, true) => ("clipped", "samples have a limit of 16 bits and are not marked as clipped"),
        };
        row.sample.gyro_flags |= flag;
        findings.note(kind(name, what), Some(gyro), index, 1, 0.0);
    }
}
