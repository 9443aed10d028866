//! The unit as a state machine: samples, commands, modes (protocol/ICD.md).
//!
//! A command acts as if it had come at the start of the sample interval that runs; a fault is decided at its start, and acts
//! over all of it.

mod command;
mod following;
mod injection;
#[cfg(test)]
mod tests;
mod truth;

use std::sync::Arc;

use geu_protocol::field::{CLOCK_MODULUS, unit_flag};
use geu_protocol::{CLOCK_PER_SAMPLE, Gyro, Sample};

use crate::attitude::{Motion, MotionStep};
use crate::configuration::Configuration;
use crate::effect::{
    FAULT_COLUMN, GyroEffects, POWER_COLUMN, Probe, SATURATION_COLUMN, SELF_TEST_COLUMN, SampleTiming, Temperatures,
    UnitEffects, WiringEffects, WiringStates,
};
use crate::fault::EffectList;
use crate::fault::catalogue::UnitFault;
use crate::fault::engine::FaultEngine;
use crate::package::{ComputedParts, Package, ResolvedGyro, SubStep, Trace};
use crate::temperature::Sensor;
use crate::time_profile::Interval;
use crate::units::SAMPLE_INTERVAL_S;
pub use command::CommandResponse;
pub use following::MeasuredTemperatures;
pub use injection::InjectionRecord;
pub use truth::Truth;

/// Sub-steps of a sample, over which motion is resolved: 0.1 s each.
const SUB_STEPS: usize = 5;
/// A sample in femtoseconds, the grain of the unit's true time: 10⁻¹⁵ of it at most is lost in rounding.
const SAMPLE_INTERVAL_FS: f64 = 0.5e15;
/// Spin-up of a gyro: 60 s.
const SPIN_UP_SAMPLE_INTERVALS: u32 = 120;

/// A sample that just ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CompletedSample {
    pub sample: Sample,
    /// True if it is sent on every link now (cyclic mode), false if it is kept for a poll.
    pub cyclic: bool,
    /// Scheduled end, true time since the start of the first sample interval, ns.
    pub end_ns: i64,
}

#[derive(Debug, Clone)]
enum Power {
    Off,
    /// Samples of spin-up left; 0 is synchronous.
    On(u32),
}

#[derive(Debug, Clone, Copy)]
struct SelfTest {
    gyros: u8,
    counts: i16,
    samples_left: u8,
}

#[derive(Debug, Clone)]
struct Channel {
    power: Power,
    /// Accumulated counts as a real number.
    accumulated: f64,
}

impl Channel {
    /// The increment: the difference of the rounded accumulated counts, so that no fraction is ever lost.
    #[inline]
    fn accumulate(&mut self, unquantised: f64) -> f64 {
        let before = self.accumulated.round();
        self.accumulated += unquantised;
        self.accumulated.round() - before
    }
}

#[derive(Debug, Clone)]
pub struct GyroUnit {
    configuration: Arc<Configuration>,
    faults: FaultEngine,
    /// The unit without the faults that act, as it was when the first of them came.
    clean: Option<Box<GyroUnit>>,
    injected: Option<Arc<InjectionRecord>>,
    /// Opcodes of the commands of the running sample interval.
    heard: Vec<u8>,
    /// The motion that is counted, which an effect may shift, and the motion of the moment.
    motion: Motion,
    truth: Motion,
    package: Package,
    channels: [Channel; 4],
    /// Parts of each gyro that are computed.
    computed: [ComputedParts; 4],
    wiring: WiringStates,
    sensor: Sensor,
    /// Temperatures that were measured, in place of those configured and of the heater's.
    measured: Option<Arc<MeasuredTemperatures>>,
    /// True time since the start, fs, at the start of the running sample interval and at its end.
    start_fs: i128,
    end_fs: i128,
    /// Effects of the unit over the running sample interval, and the time they make.
    unit: UnitEffects,
    timing: SampleTiming,
    ended: u64,
    /// Counts lost to saturation, per gyro.
    lost_counts: [f64; 4],
    sequence: u16,
    clock_count: u64,
    polled: bool,
    self_test: Option<SelfTest>,
    last: Option<Sample>,
}

impl GyroUnit {
    /// The unit on its configuration's scenario, spun up and warm, at the start of its first sample interval.
    pub fn new(configuration: &Configuration) -> GyroUnit {
        GyroUnit::on(configuration, &Truth::Scenario)
    }

    pub fn on(configuration: &Configuration, truth: &Truth) -> GyroUnit {
        GyroUnit::at_start(configuration, truth, None)
    }

    fn at_start(configuration: &Configuration, truth: &Truth, measured: Option<Arc<MeasuredTemperatures>>) -> GyroUnit {
        let at = |t_s: f64| truth.motion(configuration, t_s);
        let truth = at(0.0);
        let mut unit = GyroUnit {
            motion: truth.clone(),
            truth,
            package: Package::start(configuration.seed),
            channels: Gyro::ALL.map(|_| Channel { power: Power::On(0), accumulated: 0.0 }),
            computed: [ComputedParts::ALL; 4],
            wiring: WiringStates::default(),
            configuration: Arc::new(configuration.clone()),
            faults: FaultEngine::new(configuration),
            clean: None,
            injected: None,
            heard: Vec::new(),
            sensor: Sensor::WARM,
            measured,
            start_fs: 0,
            end_fs: 0,
            unit: UnitEffects::default(),
            timing: SampleTiming::default(),
            ended: 0,
            lost_counts: [0.0; 4],
            sequence: u16::MAX,
            clock_count: 0,
            polled: false,
            self_test: None,
            last: None,
        };
        unit.begin();
        // The first sample counts from where its shifted time begins.
        let shift_s = unit.timing.shift_s;
        if shift_s != 0.0 {
            unit.motion = at(-shift_s);
            unit.motion.advance(-shift_s);
        }
        unit
    }

    /// Number of ended samples: the index of the running one.
    pub fn ended(&self) -> u64 {
        self.ended
    }

    /// Scheduled end of the running sample interval, true time since the start of the first, ns.
    pub fn running_end_ns(&self) -> i64 {
        ((self.end_fs + 500_000) / 1_000_000) as i64
    }

    /// Counts that clipping has lost, in the order of [`Gyro::ALL`].
    pub fn lost_counts(&self) -> [f64; 4] {
        self.lost_counts
    }

    /// The motion of the moment that is counted.
    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Ends the running sample interval and begins the next.
    pub fn end_sample(&mut self) -> CompletedSample {
        self.end::<()>().0
    }

    /// As [`GyroUnit::end_sample`], with the contributions to the counts of each gyro.
    pub fn end_sample_traced(&mut self) -> (CompletedSample, [Trace; 4]) {
        self.end()
    }

    fn end<T: Probe>(&mut self) -> (CompletedSample, [T; 4]) {
        let (start_s, end_s) = (self.start_fs as f64 * 1e-15, self.end_fs as f64 * 1e-15);
        let mut taps: [T; 4] = std::array::from_fn(|_| T::default());
        let temperatures = self.temperatures(0.5 * (start_s + end_s));
        let interval = temperatures.interval(start_s, end_s);
        let mut steps = [SubStep::default(); SUB_STEPS];
        let truths = self.advance::<T>(start_s, end_s, &mut steps);
        let unquantised = self.count(&temperatures, &interval, &steps, &truths, &mut taps);
        let mut counts: [f64; 4] = std::array::from_fn(|index| self.channels[index].accumulate(unquantised[index]));
        self.apply_wiring(&interval, &mut counts, &mut taps);
        let mut sample = Sample::default();
        let mut is_synchronous = self.apply_power(&mut counts, &mut sample, &mut taps);
        let before = counts;
        let overrides = self.faults.act_on_counts(&mut counts);
        sample.gyro_flags &= !overrides.invalid;
        let coasts = |(channel, gyro): (&Channel, Gyro)| {
            matches!(channel.power, Power::On(_)) && overrides.coasting & gyro.bit() != 0
        };
        is_synchronous &= !self.channels.iter().zip(Gyro::ALL).any(coasts);
        for (index, gyro) in Gyro::ALL.into_iter().enumerate() {
            let counts = &mut counts[index];
            if *counts != before[index] {
                taps[index].changed(FAULT_COLUMN, *counts - before[index]);
            }
            let clipped = counts.clamp(f64::from(i16::MIN), f64::from(i16::MAX));
            if clipped != *counts {
                sample.gyro_flags |= gyro.bit() << 4;
                self.lost_counts[index] += (*counts - clipped).abs();
                taps[index].changed(SATURATION_COLUMN, clipped - *counts);
            }
            sample.increments[index] = clipped as i16;
        }
        self.sequence = self.sequence.wrapping_add(1);
        self.clock_count = (self.clock_count + CLOCK_PER_SAMPLE) % CLOCK_MODULUS;
        sample.sequence = self.sequence;
        sample.clock_count = self.clock_count;
        self.report_status(start_s, end_s, is_synchronous, &mut sample);
        self.last = Some(sample);
        let cyclic = !self.polled && !self.faults.is_silent();
        let ended = CompletedSample { sample, cyclic, end_ns: self.running_end_ns() };
        self.injected = self.compare(&ended);
        self.ended += 1;
        self.start_fs = self.end_fs;
        self.begin();
        (ended, taps)
    }

    /// Motion of the sub-steps of a sample: as counted, and the truth if a probe records it and it differs.
    fn advance<T: Probe>(&mut self, start_s: f64, end_s: f64, steps: &mut [SubStep; SUB_STEPS]) -> Vec<MotionStep> {
        let length_s = (end_s - start_s) / SUB_STEPS as f64;
        let mut truths = Vec::new();
        let records_truth = T::LOOKS && (self.timing.shift_s != 0.0 || self.motion.now().t_s != start_s);
        // At the start of a shift the counted motion so far is the truth.
        if records_truth && self.truth.now().t_s < start_s && self.motion.now().t_s == start_s {
            self.truth = self.motion.clone();
        }
        for (index, step) in steps.iter_mut().enumerate() {
            // The last sub-step ends with the sample, to the last bit.
            step.end_s = if index + 1 == SUB_STEPS { end_s } else { start_s + (index + 1) as f64 * length_s };
            step.counted = self.motion.advance(step.end_s - self.timing.shift_s);
            step.counted.length_s = length_s;
            if records_truth {
                truths.push(self.truth.advance(step.end_s));
            }
        }
        truths
    }

    /// Counts of a sample, as real numbers.
    fn count<T: Probe>(
        &mut self,
        temperatures: &Temperatures,
        interval: &Interval,
        steps: &[SubStep],
        truths: &[MotionStep],
        taps: &mut [T; 4],
    ) -> [f64; 4] {
        let (gyros, faults) = (&self.configuration.gyros, &self.faults);
        let mut storage: [Option<GyroEffects>; 4] = [None; 4];
        let mut storage = storage.iter_mut();
        let resolved = std::array::from_fn(|index| {
            let (storage, gyro) = (storage.next().expect("one for each"), Some(Gyro::ALL[index]));
            ResolvedGyro {
                computed: self.computed[index],
                calibration: &gyros[index].calibration,
                effects: match faults.moves(EffectList::Head, gyro) {
                    false if !self.computed[index].is_counted => &gyros[index].effects.constant,
                    false => gyros[index].effects.resolve(interval, storage),
                    true => storage.insert(faults.moved(gyros[index].effects.at(interval), EffectList::Head, gyro)),
                },
                discovered: &gyros[index].discovered,
            }
        });
        self.package.count(&resolved, &self.unit, temperatures, steps, truths, taps)
    }

    /// Applies wiring faults to the counts of a sample.
    fn apply_wiring<T: Probe>(&mut self, interval: &Interval, counts: &mut [f64; 4], taps: &mut [T; 4]) {
        let wiring: [WiringEffects; 4] = std::array::from_fn(|index| {
            let configured = self.configuration.gyros[index].wiring.at(interval);
            self.faults.moved(configured, EffectList::Wiring, Some(Gyro::ALL[index]))
        });
        WiringEffects::apply(&wiring, &mut self.wiring, counts, taps);
    }

    /// Applies power, self-test and spin-up to counts and validity flags. Returns true if all powered motors are synchronous.
    fn apply_power<T: Probe>(&mut self, counts: &mut [f64; 4], sample: &mut Sample, taps: &mut [T; 4]) -> bool {
        let mut is_synchronous = true;
        for (index, gyro) in Gyro::ALL.into_iter().enumerate() {
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
                        sample.gyro_flags |= gyro.bit();
                    } else {
                        is_synchronous = false;
                        *left -= 1;
                    }
                }
            }
        }
        is_synchronous
    }

    /// Temperatures and unit flags at the end of the sample; a running self-test is one sample shorter.
    fn report_status(&mut self, start_s: f64, end_s: f64, is_synchronous: bool, sample: &mut Sample) {
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
        for (law, _) in self.faults.on_unit() {
            if let UnitFault::FlipFlags { gyro_flags, unit_flags } = law {
                sample.gyro_flags ^= gyro_flags;
                sample.unit_flags ^= unit_flags;
            }
        }
    }

    /// Begins a sample: which faults act over it, and when it ends.
    fn begin(&mut self) {
        self.begin_faults();
        self.heard.clear();
        self.schedule_end();
        self.hold_clean();
    }

    /// Schedules the end of the sample interval that begins: 0.5/(1 + ε) s of true time after its start.
    fn schedule_end(&mut self) {
        let configured = &self.configuration.unit;
        let at_start = || {
            let start_s = self.start_fs as f64 * 1e-15;
            let temperatures = self.temperatures(start_s + 0.5 * SAMPLE_INTERVAL_S);
            configured.at(&temperatures.interval(start_s, start_s + SAMPLE_INTERVAL_S))
        };
        let effects = if configured.courses.is_empty() { configured.constant } else { at_start() };
        self.unit = self.faults.moved(effects, EffectList::Unit, None);
        self.timing = self.unit.timing().last().copied().unwrap_or_default();
        self.end_fs = self.start_fs + (SAMPLE_INTERVAL_FS / (1.0 + self.timing.clock_error)).round() as i128;
    }

    fn temperatures(&self, t_s: f64) -> Temperatures {
        match &self.measured {
            Some(measured) => measured.at(t_s),
            None => Temperatures::from_course(&self.configuration.electronics, t_s, self.sensor.temperature_c),
        }
    }
}

fn centi(temperature_c: f64) -> i16 {
    (temperature_c * 100.0).round() as i16
}
