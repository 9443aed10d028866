//! Samples of a described unit as nodes of about half a second, and what a monitor knows of its heads.

use geu_calibration::Transfer;
use geu_calibration::counts::{BreakKind, HeadAngles, HeadReader};
use geu_calibration::noise::{ROUNDING_VARIANCE, RandomWalks};
use geu_calibration::track::rotation_of_heads;
use geu_calibration::transfer::sensing_matrix;
use geu_model::Configuration;
use geu_model::device::{MAX_HEADS, Output};
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::Gyros;
use geu_protocol::continuity::MAX_MISSING;
use geu_recording::{DeviceSample, ReferenceAttitude};
use nalgebra::{DVector, Matrix3xX};

use crate::event::{Event, Watch};
use crate::filter::Noise;
use crate::monitor::Monitor;

/// Half the width of the interval of an angle that is not rounded, arcsec.
const MIN_HALF: f64 = 1e-6;

/// From counts to rotations.
#[derive(Debug)]
pub enum Heads {
    Default(Transfer),
    Described(DescribedHeads),
}

/// Heads of a described unit.
#[derive(Debug)]
pub struct DescribedHeads {
    /// Axes of each channel: the input axis of its head, and two perpendicular to it.
    pub axes: Vec<[[f64; 3]; 3]>,
    /// Scale factor and drift, arcsec per node.
    calibrations: Vec<(f64, f64)>,
    /// Rotation about the control axes, if the heads determine it.
    rotation: Option<Matrix3xX<f64>>,
}

impl DescribedHeads {
    /// Heads of a unit with nodes of `samples`.
    pub fn new(configuration: &Configuration, samples: u64) -> DescribedHeads {
        let device = &configuration.device;
        let half_s = device.interval_s * samples as f64 / SAMPLE_INTERVAL_S;
        let own = configuration.gyros.iter().map(|gyro| &gyro.calibration);
        let axes = |head: &geu_model::device::Head| {
            let [a, b] = head.across();
            [head.axes.input_control, a, b]
        };
        DescribedHeads {
            axes: device.heads.iter().map(axes).collect(),
            calibrations: own.map(|own| (own.scale_factor, own.drift_arcsec_per_half_s * half_s)).collect(),
            rotation: rotation_of_heads(&sensing_matrix(configuration), device.all_gyros()),
        }
    }
}

/// Counts of the default unit.
pub fn default_counts(counts: &[f64]) -> [f64; 4] {
    std::array::from_fn(|gyro| counts[gyro])
}

impl Heads {
    /// Rotation about the control axes by the counts of a node that ends after `samples`; `None` if the heads do not determine it.
    pub fn about_control_arcsec(&self, counts: &[f64], samples: f64) -> Option<[f64; 3]> {
        match self {
            Heads::Default(transfer) => Some(transfer.about_control_arcsec(default_counts(counts), samples)),
            Heads::Described(heads) => {
                let own = counts.iter().zip(&heads.calibrations);
                let angles = own.map(|(count, (scale_factor, drift))| count * scale_factor + drift * samples);
                let angles = DVector::from_iterator(counts.len(), angles);
                heads.rotation.as_ref().map(|rotation| (rotation * angles).into())
            }
        }
    }

    /// A rotation about the axes of a channel.
    pub fn in_channel(&self, channel: usize, turned: [f64; 3]) -> [f64; 3] {
        let Heads::Described(heads) = self else { return turned };
        heads.axes[channel].map(|axis| axis.iter().zip(turned).map(|(axis, turned)| axis * turned).sum())
    }
}

/// Noise of each head: configured walks and rounding. The rounding of rates adds up as a walk, that of increments does not.
pub fn noises(configuration: &Configuration) -> Vec<Noise> {
    let device = &configuration.device;
    let own = device.heads.iter().zip(&configuration.gyros);
    own.map(|(head, gyro)| {
        let (mut walks, count) = (RandomWalks::from(gyro), if head.is_rounded { head.count_arcsec } else { 0.0 });
        let is_rate = device.output == Output::Rate;
        let rounding = if is_rate { count * (ROUNDING_VARIANCE / device.interval_s).sqrt() } else { 0.0 };
        walks.angle_arcsec_per_sqrt_s = walks.angle_arcsec_per_sqrt_s.hypot(rounding);
        Noise { walks, white: 0.0, half: if is_rate { MIN_HALF } else { (0.5 * count).max(MIN_HALF) } }
    })
    .collect()
}

/// Watches the samples of a described unit along a reference.
#[derive(Debug)]
pub struct DeviceMonitor {
    monitor: Monitor,
    reader: HeadReader,
    all: Gyros,
    interval_s: f64,
    /// Samples of a node.
    samples: u64,
    /// Number of the present node, its angles, gyros without them, and the samples that came.
    node: u64,
    arcsec: [f64; MAX_HEADS],
    broken: Gyros,
    filled: u64,
    is_begun: bool,
}

impl DeviceMonitor {
    /// A monitor before the first sample.
    pub fn new(configuration: &Configuration, reference: ReferenceAttitude) -> DeviceMonitor {
        let device = &configuration.device;
        let samples = (SAMPLE_INTERVAL_S / device.interval_s).round().max(1.0) as u64;
        let all = device.all_gyros();
        DeviceMonitor {
            monitor: Monitor::described(configuration, reference, samples),
            reader: HeadReader::new(device),
            all,
            interval_s: device.interval_s,
            samples,
            node: 0,
            arcsec: [0.0; MAX_HEADS],
            broken: all.with_mask(0),
            filled: 0,
            is_begun: false,
        }
    }

    /// Ends the present node.
    fn end_node(&mut self) {
        let broken = if self.filled < self.samples { self.all } else { self.broken };
        self.monitor.add(&self.arcsec[..self.all.heads()], broken);
        (self.arcsec, self.broken, self.filled) = ([0.0; MAX_HEADS], self.all.with_mask(0), 0);
        self.node += 1;
    }
}

impl Watch<DeviceSample> for DeviceMonitor {
    fn push(&mut self, row: &DeviceSample) -> Vec<Event> {
        let is_own = !self.reader.is_of_other_trial(row);
        let Some((from, to)) = self.reader.place(row).filter(|_| is_own) else { return Vec::new() };
        if !std::mem::replace(&mut self.is_begun, true) {
            // Without receive times the number counts from the start.
            let start_ns = |time: i64| time.saturating_sub((self.interval_s * 1e9) as i64);
            self.monitor.start(row.time.map_or(0, |time| start_ns(time.t_ns)));
        }
        let missing = ((from - self.reader.end).round() as u64).min(MAX_MISSING);
        if missing > 0 {
            self.monitor.interrupt(BreakKind::Gap(missing), self.all, missing);
        }
        self.reader.end = to;
        let node = from as u64 / self.samples;
        if node > self.node && self.filled > 0 {
            self.end_node();
        }
        if node > self.node {
            self.monitor.skip((node - self.node).min(MAX_MISSING));
        }
        self.node = node;
        let HeadAngles { arcsec, invalid, saturated } = self.reader.angles(row);
        for (kind, gyros) in [(BreakKind::Invalid, invalid), (BreakKind::Saturated, saturated)] {
            if !gyros.is_empty() {
                self.broken = self.broken.and(gyros);
                self.monitor.interrupt(kind, gyros, 1);
            }
        }
        let measured = self.all.without(invalid).without(saturated);
        for (gyro, (sum, arcsec)) in self.arcsec.iter_mut().zip(&arcsec).enumerate() {
            *sum += if measured[gyro] { *arcsec } else { 0.0 };
        }
        self.filled += 1;
        if (to as u64).is_multiple_of(self.samples) {
            self.end_node();
        }
        self.monitor.take_events()
    }

    fn compared_s(&self) -> f64 {
        self.monitor.compared_s()
    }
}

#[cfg(test)]
mod tests {
    use geu_model::attitude::{AttitudeRow, RecordedAttitude};
    use geu_model::device::Device;
    use geu_protocol::capture::Timestamp;

    use super::*;

    #[test]
    fn any_times_numbers_and_values_are_taken() {
        let device = std::sync::Arc::new(Device::from_name("kvh-1750").expect("a known unit"));
        let row = |index: u32| AttitudeRow {
            t_s: f64::from(index),
            angle_control_arcsec: [f64::from(index); 3],
            theta_psi_rad: None,
        };
        let truth = RecordedAttitude::new((0..5000).map(row).collect()).expect("a truth");
        let reference = ReferenceAttitude::of_truth(0, truth);
        let configuration = Configuration::of_device(&device, &[]).expect("a configuration");
        let mut monitor = DeviceMonitor::new(&configuration, reference);
        let (mut random, mut number) = (1_u64, 0_u64);
        for _ in 0..40_000 {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let draw = (random >> 33) as usize;
            number = number.saturating_add([1, 1, 1, 1, 500, 0, 1 << 20, u64::MAX / 3][draw % 8]);
            let values = [0.0, 1e-5, f64::NAN, f64::INFINITY, -1e300, 1.0];
            let values =
                (0..device.values().len()).map(|slot| values[(draw >> 3).wrapping_add(slot * draw) % 6]).collect();
            let time = draw.is_multiple_of(5).then_some(Timestamp { t_ns: (random << 7) as i64, digits: 6 });
            for event in monitor.push(&DeviceSample { time, number, values, ..DeviceSample::default() }) {
                assert!(event.statistic.is_finite() && event.t_s.is_finite(), "{event:?}");
            }
        }
    }
}
