//! What acts on the counts of a sample after they are rounded: wiring, power, faults, range; and its status.

use geu_protocol::Sample;
use geu_protocol::field::unit_flag;

use super::{Channel, GyroUnit, Outputs, Power, SelfTest};
use crate::device::{Device, Head, MAX_HEADS};
use crate::effect::{FAULT_COLUMN, POWER_COLUMN, Probe, SATURATION_COLUMN, SELF_TEST_COLUMN, WiringEffects};
use crate::fault::EffectList;
use crate::fault::catalogue::UnitFault;
use crate::time_profile::Interval;

impl GyroUnit {
    /// Applies wiring faults to the counts of a sample.
    pub(super) fn apply_wiring<T: Probe>(&mut self, interval: &Interval, counts: &mut [f64], taps: &mut [T]) {
        let mut wiring = [WiringEffects::default(); MAX_HEADS];
        for ((wiring, own), head) in
            wiring.iter_mut().zip(&self.configuration.gyros).zip(&self.configuration.device.heads)
        {
            *wiring = self.faults.moved(own.wiring.at(interval), EffectList::Wiring, Some(head.gyro));
        }
        WiringEffects::apply(&wiring[..counts.len()], &mut self.wiring, counts, taps);
    }

    /// Applies power, self-test and spin-up to counts and validity flags. Returns true if all powered motors are synchronous.
    pub(super) fn apply_power<T: Probe>(&mut self, counts: &mut [f64], valid: &mut u8, taps: &mut [T]) -> bool {
        let mut is_synchronous = true;
        for (index, gyro) in self.configuration.device.gyros().enumerate() {
            let counts = &mut counts[index];
            match &mut self.channels[index].power {
                Power::Off => {
                    taps[index].changed(POWER_COLUMN, -*counts);
                    *counts = 0.0;
                }
                Power::On(left) => {
                    if let Some(test) = self.self_test.filter(|test| test.gyros & gyro.bit() != 0) {
                        *counts += f64::from(test.counts);
                        taps[index].changed(SELF_TEST_COLUMN, f64::from(test.counts));
                    }
                    if *left == 0 {
                        *valid |= gyro.bit();
                    } else {
                        is_synchronous = false;
                        *left -= 1;
                    }
                }
            }
        }
        is_synchronous
    }

    /// Applies faults of heads to the outputs of a sample, and clips them. Returns false if a motor coasts.
    pub(super) fn apply_faults<T: Probe>(&mut self, device: &Device, outputs: &mut Outputs, taps: &mut [T]) -> bool {
        let before = outputs.counts;
        let counts = &mut outputs.counts[..device.heads.len()];
        let overrides = self.faults.act_on_counts(device, counts);
        outputs.valid &= !overrides.invalid;
        for (index, head) in device.heads.iter().enumerate() {
            let counts = &mut counts[index];
            if *counts != before[index] {
                taps[index].changed(FAULT_COLUMN, *counts - before[index]);
            }
            let (low, high) = device.limits(head);
            let clipped = counts.clamp(low, high);
            if clipped != *counts {
                outputs.saturated |= head.gyro.bit();
                self.lost_counts[index] += (*counts - clipped).abs();
                taps[index].changed(SATURATION_COLUMN, clipped - *counts);
            }
            *counts = clipped;
        }
        let is_on = |channel: &Channel| matches!(channel.power, Power::On(_));
        let coasts = |head: &Head| overrides.coasting & head.gyro.bit() != 0;
        !self.channels.iter().zip(&device.heads).any(|(channel, head)| is_on(channel) && coasts(head))
    }

    /// Temperatures and unit flags at the end of the sample; a running self-test is one sample shorter.
    pub(super) fn report_status(&mut self, start_s: f64, end_s: f64, is_synchronous: bool, sample: &mut Sample) {
        let at_end = self.temperatures(end_s);
        let heater_on = self.sensor.heater_on;
        self.sensor.heater_on &=
            !self.faults.on_unit().any(|(law, _)| matches!(law, UnitFault::HeaterLost | UnitFault::BrownOut));
        self.sensor.advance(end_s - start_s, at_end.electronics_c);
        self.sensor.heater_on = heater_on;
        sample.electronics_centi_c = centi(at_end.electronics_c);
        sample.sensor_centi_c = centi(self.sensor.temperature_c);
        sample.unit_flags = [
            (self.sensor.in_band(), unit_flag("heater_in_band")),
            (is_synchronous, unit_flag("motors_synchronous")),
            (true, unit_flag("clock_locked")),
            (self.self_test.is_some(), unit_flag("self_test")),
            (self.polled, unit_flag("polled")),
        ]
        .into_iter()
        .fold(0, |flags, (set, flag)| if set { flags | flag } else { flags });
        self.self_test = self.self_test.and_then(|test| {
            let samples_left = test.samples_left - 1;
            (samples_left > 0).then_some(SelfTest { samples_left, ..test })
        });
    }
}

fn centi(temperature_c: f64) -> i16 {
    (temperature_c * 100.0).round() as i16
}
