//! An independent model of described units: the physics of the model's page, the words of the data sheets. It shares no code with the
//! model or the protocol, and does not read their descriptions.
//!
//! A motion with closed integrals is sensed by heads with errors, noises and injected effects, and sent as a unit sends it; a reference
//! of its own reports the motion.

mod campaign;
mod channel;
mod effect;
mod motion;
mod reference;
mod unit;
mod wire;

pub use campaign::{Case, Mix};
pub use channel::HeadTruth;
pub use effect::DeviceEffect;
pub use motion::DeviceMotionKind;
pub use reference::DeviceReference;
pub use unit::{DeviceUnit, Output, Wire};

use channel::{Channel, Interval};
use effect::value;
use motion::DeviceMotion;
use wire::SentSample;

use crate::noise::Noise;

/// A described unit on a motion, with errors and noises from a seed, and injected effects.
#[derive(Debug, Clone)]
pub struct DevicePlant {
    /// Unit.
    pub unit: DeviceUnit,
    /// Seed of motion, errors and noises; each draws from a stream of its own.
    pub seed: u64,
    /// Time of the bench.
    pub duration_s: f64,
    /// Start of the first sample.
    pub start_unix_s: u64,
    /// Motion.
    pub motion: DeviceMotionKind,
    /// Reference.
    pub reference: DeviceReference,
    /// Injected effects.
    pub effects: Vec<DeviceEffect>,
}

/// A recording with its truth.
#[derive(Debug, Clone)]
pub struct DeviceRecording {
    /// `link.bin`, or `link.log` of a unit on CAN.
    pub link: Vec<u8>,
    /// `reference.csv`.
    pub reference: String,
    /// Calibration of each head.
    pub heads: Vec<HeadTruth>,
    /// Sent samples: the index of each, and a number for each head in counts.
    pub samples: Vec<(u64, Vec<f64>)>,
}

impl DevicePlant {
    /// Simulates the recording; `keeps_samples` if it is to have the sent numbers.
    pub fn record(&self, keeps_samples: bool) -> DeviceRecording {
        let DevicePlant { unit, seed, effects, .. } = self;
        let motion = DeviceMotion::drawn(self.motion, unit, &mut Noise::new(*seed, 0), self.duration_s);
        let mut channels: Vec<Channel> =
            (0..unit.heads.len()).map(|head| Channel::new(unit, head, *seed, effects)).collect();
        let (mut jitter, mut loss) = (Noise::new(*seed, 1), Noise::new(*seed, 2));
        let of_unit = |code: &str, parameter: &str| value(effects, 0, code, parameter);
        let (fast, offset_s) = (of_unit("clock-frequency", "ppm") * 1e-6, of_unit("time-offset", "seconds"));
        let lost = of_unit("lost-samples", "share");
        let swapped: Vec<usize> =
            (0..unit.heads.len()).filter(|head| value(effects, *head, "axis-swap", "on") != 0.0).collect();
        let length_s = unit.interval_s / (1.0 + fast);
        let limit = unit.limit(unit.range_arcsec_s);
        let (mut link, mut samples) = (Vec::new(), Vec::new());
        let mut before = motion.at(-offset_s).1;
        // Whole samples, to the rounding of their length.
        for index in 0..(self.duration_s / length_s + 1e-6) as u64 {
            let [start_s, end_s] = [index, index + 1].map(|edge| edge as f64 * length_s);
            let after = motion.at(end_s - offset_s).1;
            let interval = Interval {
                motion: &motion,
                from_s: start_s - offset_s,
                to_s: end_s - offset_s,
                angles_arcsec: std::array::from_fn(|axis| after[axis] - before[axis]),
                end_s,
                fast,
            };
            before = after;
            let mut numbers: Vec<f64> = channels.iter_mut().map(|channel| channel.sample(unit, &interval)).collect();
            if let [one, other] = swapped[..] {
                numbers.swap(one, other);
            }
            // Receive stamps lag by 0.9 ms, with a jitter of 0.15 ms.
            let received_s = end_s + 0.9e-3 + 0.15e-3 * jitter.normal();
            if loss.uniform(0.0, 1.0) < lost {
                continue;
            }
            let saturated = numbers.iter().rev().fold(0, |bits, number| bits << 1 | u8::from(number.abs() >= limit));
            let received_unix_us = self.start_unix_s * 1_000_000 + (received_s * 1e6).round() as u64;
            let temperature_c = unit.temperature_c(end_s);
            let sent = SentSample { index, numbers: &numbers, saturated, temperature_c, received_unix_us };
            wire::append(&mut link, unit, &sent);
            if keeps_samples {
                samples.push((index, numbers));
            }
        }
        // More, for readers of truth ahead of the counts, and by a clock that is fast by 1000 ppm.
        let end_s = 1.001 * self.duration_s + 1.0;
        let reference = self.reference.write(&motion, unit, Noise::new(*seed, 3), self.start_unix_s, end_s);
        let heads = channels.into_iter().map(|channel| channel.truth).collect();
        DeviceRecording { link, reference, heads, samples }
    }
}

#[cfg(test)]
mod tests;
