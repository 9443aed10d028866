//! Alarms of one channel: a gyro against the reference, or the pair GYRZA and GYRZB.

use geu_calibration::noise::ROUNDING_VARIANCE;
use geu_model::units::SAMPLE_INTERVAL_S;

use crate::bank::{Bank, LOOK_SAMPLES, OLDEST_SAMPLES};
use crate::filter::{Filter, Noise, Step};
use crate::kind::{Kinds, Tape};

/// The stated mean time between false alarms of all channels, days.
pub const FALSE_ALARM_INTERVAL_DAYS: f64 = 30.0;
/// Chi-square of one degree of freedom above which a change is an alarm: exceeded at random once in the 12 million looks of that time,
/// four channels with six kinds each five seconds, at onsets of three ages: older and newer ones give much the same.
pub const THRESHOLD: f64 = 31.0;
/// Samples at the start in which states and noise are estimated.
const START_SAMPLES: u64 = 3600;
/// Length of this start, s.
pub const START_S: f64 = START_SAMPLES as f64 * SAMPLE_INTERVAL_S;
/// Samples between two looks at the kinds, a minute, or this share of the time since the alarm.
const NAMING_SAMPLES: u64 = 120;
const NAMING_SHARE: u64 = 16;
/// Minimum number of samples between an alarm and its name: ten minutes, in which other motions may show more.
const MIN_NAMING_SAMPLES: u64 = 1200;
/// Trials of the noise: the smallest variance of a residual, its trials and the trials of the angle walk, and the ratio of neighbours: up to
/// 14″ and 32 times the walk that is configured.
const MIN_WHITE: f64 = 1e-4;
const WHITES: i32 = 22;
const WALKS: i32 = 6;
const RATIO: f64 = 2.0;
/// Trials for a unit of unknown noise: up to 4000″/√s, and nearer walks after that.
const UNKNOWN: (i32, i32, f64) = (11, 12, 4.0);
const NEARER: [f64; 11] = [0.5, 0.7, 1.4, 2.0, 0.84, 1.19, 0.92, 1.09, 0.96, 1.04, 1.0];
/// Shares of the variance that are tried with each of these walks, for a walk looks like a variance over short times.
const SHARES: [f64; 4] = [1.0, 0.5, 0.2, 0.0];
/// Minimum angle walk, arcsec/√s, and drift walk, arcsec/s/√s: 0.3″ in a day and 1″/h in a day, below which no model is right.
const MIN_ANGLE_WALK: f64 = 1e-3;
const MIN_DRIFT_WALK: f64 = 1e-6;

/// A change of the alarm by a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    pub event: &'static str,
    pub code: &'static str,
    pub statistic: f64,
}

/// The alarms of one channel.
#[derive(Debug, Clone)]
pub struct Channel {
    filter: Filter,
    bank: Bank,
    tape: Tape,
    kinds: Kinds,
    /// The sample of an alarm that has no name yet, and that of the next look at its kinds.
    alarm: Option<(u64, u64)>,
    /// The sample of the last name: a gyro with another alarm soon after it is not as the kinds are, and gets no other name.
    named: Option<u64>,
    /// The sample until which a float that the model was given finds its place: no alarm before.
    settled: u64,
    /// True if the errors of the reference exceed the rounding.
    is_noisy: bool,
    /// True if a pivot clearance was named.
    has_clearance: bool,
    /// Trials of the noise: of the variance and of the walk, and the ratio of neighbours.
    trials: (i32, i32, f64),
    /// The largest statistic without an alarm.
    pub largest: f64,
}

impl Channel {
    /// A channel with its input axis along this control axis.
    pub fn new(mut noise: Noise, axis: usize) -> Channel {
        let walks = &mut noise.walks;
        walks.angle_arcsec_per_sqrt_s = walks.angle_arcsec_per_sqrt_s.max(MIN_ANGLE_WALK);
        walks.drift_arcsec_per_s_per_sqrt_s = walks.drift_arcsec_per_s_per_sqrt_s.max(MIN_DRIFT_WALK);
        noise.white = MIN_WHITE;
        let (bank, tape) = Default::default();
        Channel {
            filter: Filter::new(noise),
            bank,
            tape,
            kinds: Kinds::new(axis),
            alarm: None,
            named: None,
            settled: 0,
            is_noisy: false,
            has_clearance: false,
            trials: (WHITES, WALKS, RATIO),
            largest: 0.0,
        }
    }

    /// A channel along its first axis, of a unit that may be noisier than configured.
    pub fn of_unknown_noise(noise: Noise) -> Channel {
        Channel { trials: UNKNOWN, ..Channel::new(noise, 0) }
    }

    /// Adds a sample.
    pub fn push(&mut self, step: &Step) -> Option<Change> {
        let now = self.tape.end();
        let step = &if self.is_noisy { step.of_noisy_reference() } else { *step };
        self.tape.push(*step);
        if now < START_SAMPLES {
            if now + 1 == START_SAMPLES {
                self.start();
            }
            return None;
        }
        self.bank.begin(now, &self.filter);
        let update = self.filter.push(step);
        self.bank.push(step, update.as_ref());
        if now < self.settled {
            self.bank = Bank::default();
            return None;
        }
        let look = |samples: u64| now.is_multiple_of(samples);
        match self.alarm {
            None if look(LOOK_SAMPLES) => {
                let statistic = self.bank.largest();
                self.largest = self.largest.max(statistic);
                (statistic > THRESHOLD).then(|| {
                    self.alarm = Some((now, now + MIN_NAMING_SAMPLES));
                    Change { event: "alarm", code: "unknown", statistic }
                })
            }
            Some((alarm, next)) if now >= next => {
                self.alarm = Some((alarm, now + NAMING_SAMPLES.max((now - alarm) / NAMING_SHARE)));
                let statistic = self.bank.largest();
                let (code, filter) = self.kinds.compare(&self.tape, &self.bank, THRESHOLD)?;
                let is_again = self.named.is_some_and(|named| alarm < named + OLDEST_SAMPLES);
                let code = if is_again { "unknown" } else { code };
                if code == "unknown" && now < alarm + OLDEST_SAMPLES {
                    return None;
                }
                self.named = Some(now);
                if code == "pivot-clearance" {
                    (self.has_clearance, self.settled) = (true, now + START_SAMPLES);
                }
                (self.alarm, self.filter, self.bank) = (None, filter, Bank::default());
                self.kinds.clear();
                Some(Change { event: "named", code, statistic })
            }
            _ => None,
        }
    }

    /// The pivot clearance, arcsec, that the model has to have beyond its own after this step, if a clearance was named: by steps, for
    /// signatures of clearances are not proportional to them.
    pub fn clearance_arcsec(&mut self, step: &Step) -> Option<f64> {
        if !self.has_clearance || self.alarm.is_some() || !self.tape.end().is_multiple_of(NAMING_SAMPLES) {
            return None;
        }
        let clearance = self.filter.missing_clearance()?;
        self.filter.hand_over(clearance, step);
        (self.bank, self.settled) = (Bank::default(), self.tape.end() + START_SAMPLES);
        Some(clearance)
    }

    /// Ends the start with the likeliest noise.
    fn start(&mut self) {
        let (mut best, mut noisy) = (None::<Filter>, self.tape.clone());
        noisy.map(Step::of_noisy_reference);
        let (whites, walks, ratio) = self.trials;
        let nearer = if ratio > RATIO { &NEARER[..] } else { &[] };
        for index in 0..whites * walks + (nearer.len() * SHARES.len()) as i32 {
            let mut noise = self.filter.noise;
            noise.walks.angle_arcsec_per_sqrt_s *= ratio.powi(index / whites);
            noise.white = MIN_WHITE * ratio.powi(index % whites);
            if let (Ok(trial), Some(best)) = (usize::try_from(index - whites * walks), &best) {
                noise = best.noise;
                noise.walks.angle_arcsec_per_sqrt_s *= nearer[trial / SHARES.len()];
                noise.white = (noise.white * SHARES[trial % SHARES.len()]).max(MIN_WHITE);
            }
            // The noise of a gyro would look like a signature in its own counts.
            let is_noisy = noise.white > ROUNDING_VARIANCE && nearer.is_empty();
            let tape = if is_noisy { &noisy } else { &self.tape };
            let filter = tape.run(Filter::new(noise), 0, |_, _| ());
            // One number more is worth one unit.
            if best.as_ref().is_none_or(|best| filter.log_likelihood > best.log_likelihood + 1.0) {
                best = Some(filter);
            }
        }
        self.filter = best.unwrap_or_else(|| self.filter.clone());
        let Noise { white, walks, .. } = self.filter.noise;
        let walked = walks.angle_arcsec_per_sqrt_s.powi(2) * SAMPLE_INTERVAL_S;
        self.is_noisy = white > ROUNDING_VARIANCE && (nearer.is_empty() || white > walked);
        if self.is_noisy {
            self.tape = noisy;
        }
    }
}
