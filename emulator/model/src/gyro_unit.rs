//! The unit as a state machine: samples, commands, modes (protocol/ICD.md).
//!
//! A command acts as if it had come at the start of the sample interval that runs; a fault is decided at its start, and acts
//! over all of it.

mod command;
mod following;
mod injection;
mod outputs;
mod sample;
#[cfg(test)]
mod tests;
mod truth;

use std::sync::Arc;

use geu_protocol::Sample;
use geu_protocol::field::CLOCK_MODULUS;

use crate::attitude::{Motion, MotionStep};
use crate::configuration::Configuration;
use crate::device::{Device, MAX_HEADS, Output};
use crate::effect::{GyroEffects, Probe, SampleTiming, Temperatures, UnitEffects, WiringStates};
use crate::fault::EffectList;
use crate::fault::catalogue::UnitFault;
use crate::fault::engine::FaultEngine;
use crate::package::{Package, ResolvedGyro, SubStep, Trace};
use crate::temperature::Sensor;
use crate::time_profile::Interval;
pub use command::CommandResponse;
pub use following::{FollowedSamples, FollowingGyro, MeasuredTemperatures, SomeSamples, SubSteps};
pub use injection::InjectionRecord;
pub use sample::{CompletedSample, Outputs};
pub use truth::Truth;

/// Longest sub-step of a sample, over which motion is resolved.
const SUB_STEP_S: f64 = 0.1;
/// Femtoseconds of a second, the grain of the unit's true time: 10⁻¹⁵ of a sample at most is lost in rounding.
const FS: f64 = 1e15;
/// Spin-up of a gyro.
const SPIN_UP_S: f64 = 60.0;

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

/// Rounding of counts to an output.
#[derive(Debug, Clone, Copy)]
enum Rounding {
    /// The difference of the rounded accumulated counts, so that no fraction is ever lost.
    Accumulated,
    /// Each sample by itself.
    Each,
    None,
}

impl Channel {
    #[inline]
    fn accumulate(&mut self, unquantised: f64, rounding: Rounding) -> f64 {
        let before = self.accumulated;
        self.accumulated += unquantised;
        match rounding {
            Rounding::Accumulated => self.accumulated.round() - before.round(),
            Rounding::Each => unquantised.round(),
            Rounding::None => unquantised,
        }
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
    channels: Vec<Channel>,
    /// Motion over the sub-steps of a sample.
    steps: Vec<SubStep>,
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
    lost_counts: Vec<f64>,
    angles_arcsec: [f64; MAX_HEADS],
    sequence: u64,
    clock_count: u64,
    polled: bool,
    self_test: Option<SelfTest>,
    last: Option<CompletedSample>,
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
        let (device, heads) = (&configuration.device, configuration.device.heads.len());
        let mut unit = GyroUnit {
            motion: truth.clone(),
            truth,
            package: Package::start(configuration.seed, device.gyros()),
            channels: vec![Channel { power: Power::On(0), accumulated: 0.0 }; heads],
            steps: vec![SubStep::default(); (device.interval_s / SUB_STEP_S - 1e-9).ceil().max(1.0) as usize],
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
            lost_counts: vec![0.0; heads],
            angles_arcsec: [0.0; MAX_HEADS],
            sequence: u64::MAX,
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

    /// The description of the unit.
    pub fn device(&self) -> &Arc<Device> {
        &self.configuration.device
    }

    /// Number of ended samples: the index of the running one.
    pub fn ended(&self) -> u64 {
        self.ended
    }

    /// Scheduled end of the running sample interval, true time since the start of the first, ns.
    pub fn running_end_ns(&self) -> i64 {
        ((self.end_fs + 500_000) / 1_000_000) as i64
    }

    /// Counts that clipping has lost, by head.
    pub fn lost_counts(&self) -> &[f64] {
        &self.lost_counts
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
    pub fn end_sample_traced(&mut self) -> (CompletedSample, Vec<Trace>) {
        self.end()
    }

    fn end<T: Probe>(&mut self) -> (CompletedSample, Vec<T>) {
        let (start_s, end_s) = (self.start_fs as f64 * 1e-15, self.end_fs as f64 * 1e-15);
        let device = self.configuration.device.clone();
        let mut taps: Vec<T> = device.heads.iter().map(|_| T::default()).collect();
        let temperatures = self.temperatures(0.5 * (start_s + end_s));
        let interval = temperatures.interval(start_s, end_s);
        let mut steps = std::mem::take(&mut self.steps);
        let truths = self.advance::<T>(start_s, end_s, &mut steps);
        let unquantised = self.count(&temperatures, &interval, &steps, &truths, &mut taps);
        self.steps = steps;
        let (mut sample, mut outputs) = (Sample::default(), Outputs::default());
        let counts = &mut outputs.counts[..device.heads.len()];
        for ((counts, channel), (head, unquantised)) in
            counts.iter_mut().zip(&mut self.channels).zip(device.heads.iter().zip(unquantised))
        {
            let rounding = match (head.is_rounded, device.output) {
                (false, _) => Rounding::None,
                (true, Output::Rate) => Rounding::Each,
                (true, Output::Increment) => Rounding::Accumulated,
            };
            *counts = channel.accumulate(unquantised, rounding);
        }
        let mut rounded = [0.0; MAX_HEADS];
        rounded[..counts.len()].copy_from_slice(counts);
        self.apply_wiring(&interval, counts, &mut taps);
        let mut is_synchronous = self.apply_power(counts, &mut outputs.valid, &mut taps);
        is_synchronous &= self.apply_faults(&device, &mut outputs, &mut taps);
        // What changes the counts after their rounding changes the angles too.
        if let Some(samples) = device.angle_samples {
            let begins = self.ended % samples == 1 % samples;
            for (index, head) in device.heads.iter().enumerate() {
                let counts = unquantised[index] + (outputs.counts[index] - rounded[index]);
                let before = if begins { 0.0 } else { self.angles_arcsec[index] };
                self.angles_arcsec[index] = before + counts * head.count_arcsec;
            }
        }
        outputs.angles_arcsec = self.angles_arcsec;
        self.sequence = self.sequence.wrapping_add(1);
        // Of a whole number of cycles in a sample no fraction is lost.
        let cycles = |samples: u64| (samples as f64 * (device.interval_s * device.clock_hz)).round() as u64;
        self.clock_count = (self.clock_count + cycles(self.ended + 1) - cycles(self.ended)) % CLOCK_MODULUS;
        (outputs.index, outputs.number) = (self.ended, self.sequence);
        sample.sequence = self.sequence as u16;
        sample.clock_count = self.clock_count;
        self.report_status(start_s, end_s, is_synchronous, &mut sample);
        for (law, _) in self.faults.on_unit() {
            if let UnitFault::FlipFlags { gyro_flags, unit_flags } = law {
                let heads = u8::MAX >> (MAX_HEADS - device.heads.len());
                match device.is_iras() {
                    true => {
                        (outputs.valid, outputs.saturated) =
                            (outputs.valid ^ gyro_flags & 0xF, outputs.saturated ^ gyro_flags >> 4)
                    }
                    false => outputs.valid ^= gyro_flags & heads,
                }
                sample.unit_flags ^= unit_flags;
            }
        }
        sample.gyro_flags = outputs.valid & 0xF | outputs.saturated << 4;
        sample.increments.iter_mut().zip(outputs.counts).for_each(|(increment, counts)| *increment = counts as i16);
        let cyclic = !self.polled && !self.faults.is_silent();
        let ended = CompletedSample { sample, outputs, cyclic, end_ns: self.running_end_ns() };
        self.last = Some(ended);
        self.injected = self.compare(&ended);
        self.begin_next();
        (ended, taps)
    }

    /// Begins the next sample.
    fn begin_next(&mut self) {
        self.ended += 1;
        self.start_fs = self.end_fs;
        self.begin();
    }

    /// Motion of the sub-steps of a sample: as counted, and the truth if a probe records it and it differs.
    fn advance<T: Probe>(&mut self, start_s: f64, end_s: f64, steps: &mut [SubStep]) -> Vec<MotionStep> {
        let count = steps.len();
        let length_s = (end_s - start_s) / count as f64;
        let mut truths = Vec::new();
        let records_truth = T::LOOKS && (self.timing.shift_s != 0.0 || self.motion.now().t_s != start_s);
        // At the start of a shift the counted motion so far is the truth.
        if records_truth && self.truth.now().t_s < start_s && self.motion.now().t_s == start_s {
            self.truth = self.motion.clone();
        }
        for (index, step) in steps.iter_mut().enumerate() {
            // The last sub-step ends with the sample, to the last bit.
            step.end_s = if index + 1 == count { end_s } else { start_s + (index + 1) as f64 * length_s };
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
        taps: &mut [T],
    ) -> [f64; MAX_HEADS] {
        let (gyros, faults, device) = (&self.configuration.gyros, &self.faults, &self.configuration.device);
        let mut storage: [Option<GyroEffects>; MAX_HEADS] = [None; MAX_HEADS];
        let mut storage = storage.iter_mut();
        let heads = device.heads.len();
        // The places after the last head repeat it, and are not used.
        let resolved: [ResolvedGyro; MAX_HEADS] = std::array::from_fn(|place| {
            let (storage, index) = (storage.next().expect("one for each"), place.min(heads - 1));
            let head = &device.heads[index];
            let gyro = Some(head.gyro);
            ResolvedGyro {
                head,
                calibration: &gyros[index].calibration,
                effects: match faults.moves(EffectList::Head, gyro) {
                    _ if place >= heads => &gyros[index].effects.constant,
                    false => gyros[index].effects.resolve(interval, storage),
                    true => storage.insert(faults.moved(gyros[index].effects.at(interval), EffectList::Head, gyro)),
                },
                discovered: &gyros[index].discovered,
            }
        });
        self.package.count(&resolved[..heads], &self.unit, temperatures, steps, truths, taps)
    }

    /// Begins a sample: which faults act over it, and when it ends.
    fn begin(&mut self) {
        self.begin_faults();
        self.heard.clear();
        self.schedule_end();
        self.hold_clean();
    }

    /// Schedules the end of the sample interval that begins: 1/(1 + ε) of its nominal length after its start, true time.
    fn schedule_end(&mut self) {
        let effects = unit_effects(&self.configuration, self.start_fs as f64 * 1e-15, |t_s| self.temperatures(t_s));
        self.unit = self.faults.moved(effects, EffectList::Unit, None);
        self.timing = self.unit.shared_timing();
        self.end_fs = self.start_fs
            + (self.configuration.device.interval_s * FS / (1.0 + self.timing.clock_error)).round() as i128;
    }

    /// Sample intervals of a spin-up.
    fn spin_up_samples(&self) -> u32 {
        (SPIN_UP_S / self.configuration.device.interval_s).ceil() as u32
    }

    fn temperatures(&self, t_s: f64) -> Temperatures {
        match &self.measured {
            Some(measured) => measured.at(t_s),
            None => Temperatures::from_course(&self.configuration.electronics, t_s, self.sensor.temperature_c),
        }
    }
}

/// Effects of the unit over the sample interval that begins then, true time since the start of the first.
fn unit_effects(
    configuration: &Configuration,
    start_s: f64,
    temperatures: impl Fn(f64) -> Temperatures,
) -> UnitEffects {
    let (unit, interval_s) = (&configuration.unit, configuration.device.interval_s);
    if unit.courses.is_empty() {
        return unit.constant;
    }
    unit.at(&temperatures(start_s + 0.5 * interval_s).interval(start_s, start_s + interval_s))
}
