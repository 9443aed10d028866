//! From samples to residuals, and what their channels report.
//!
//! With a reference the model runs sample by sample along it, and each gyro is a channel: its counts minus the modelled counts. Without,
//! the parity of GYRZA and GYRZB is the only channel.

use geu_calibration::counts::{BreakKind, unusable};
use geu_calibration::{GyroSet, PriorCalibration, Transfer};
use geu_model::Configuration;
use geu_model::device::MAX_HEADS;
use geu_model::package::Axes;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::continuity::{Continuity, MAX_MISSING, SequenceStep};
use geu_protocol::{Gyro, Gyros};
use geu_recording::{ReceivedSample, ReferenceAttitude};

use crate::channel::{Channel, THRESHOLD};
use crate::described::{DescribedHeads, Heads, default_counts, noises};
use crate::event::{Event, Watch};
use crate::filter::{CLEARANCES, CLEARANCES_ARCSEC, Noise, Step, walks_of_pair};
use crate::reference_model::Model;

/// Samples without an interruption after which the next one is reported.
const QUIET_SAMPLES: u64 = 120;
/// Gyros of the redundant pair.
const PAIR: usize = 0b1100;
/// Half a count each way: one rounding, and two in the difference of the pair.
const HALF: f64 = 0.5;

/// Accumulated values at the end of a sample.
#[derive(Debug, Clone, Copy, Default)]
struct Node {
    /// Measured minus modelled counts, or parity, of each channel.
    residual: [f64; MAX_HEADS],
    /// Change of the counts with wider pivots, per arcsec.
    pivot: [[f64; CLEARANCES]; MAX_HEADS],
    turned_control_arcsec: [f64; 3],
}

/// Watches the samples of a link.
#[derive(Debug)]
pub struct Monitor {
    model: Option<Model>,
    reference: Option<ReferenceAttitude>,
    configuration: Configuration,
    gyros: Gyros,
    /// Interval between nodes, s.
    interval_s: f64,
    transfer: Heads,
    channels: Vec<Channel>,
    continuity: Continuity,
    uses_clock: bool,
    last_ns: Option<i64>,
    /// Samples since the start, missing ones too.
    node: u64,
    start_s: f64,
    counts: [f64; MAX_HEADS],
    /// The end of the sample before.
    last: Node,
    /// Samples since then, and whether counts of a gyro were lost.
    passed: u64,
    is_new: [bool; MAX_HEADS],
    /// Node of the last interruption.
    interrupted: Option<u64>,
    has_ended: bool,
    /// Nodes along the reference, or all without one.
    compared: u64,
    events: Vec<Event>,
}

impl Monitor {
    /// A monitor before the first sample. `uses_clock`: times come from the clock of the unit, not from receive times.
    pub fn new(configuration: &Configuration, reference: Option<ReferenceAttitude>, uses_clock: bool) -> Monitor {
        let prior = PriorCalibration::from(configuration);
        let channels = match &reference {
            Some(_) => {
                let noise = |gyro: usize| Noise { walks: prior.walks[gyro], white: 0.0, half: HALF };
                (0..4).map(|gyro| Channel::new(noise(gyro), gyro.min(2))).collect()
            }
            None => {
                vec![Channel::new(Noise { walks: walks_of_pair(&prior.walks), white: 0.0, half: 2.0 * HALF }, 2)]
            }
        };
        let heads = Heads::Default(Transfer::new(&prior.calibrations, GyroSet::WithZa));
        Monitor { uses_clock, ..Monitor::from_parts(configuration, reference, heads, channels) }
    }

    fn from_parts(
        configuration: &Configuration,
        reference: Option<ReferenceAttitude>,
        transfer: Heads,
        channels: Vec<Channel>,
    ) -> Monitor {
        Monitor {
            model: None,
            reference,
            configuration: configuration.clone(),
            gyros: configuration.device.all_gyros(),
            interval_s: configuration.device.interval_s,
            transfer,
            channels,
            continuity: Continuity::default(),
            uses_clock: false,
            last_ns: None,
            node: 0,
            start_s: 0.0,
            counts: [0.0; MAX_HEADS],
            last: Node::default(),
            passed: 0,
            is_new: [true; MAX_HEADS],
            interrupted: None,
            has_ended: false,
            compared: 0,
            events: Vec::new(),
        }
    }

    /// A monitor of nodes of a described unit, each of `samples`, along a reference.
    pub(crate) fn described(configuration: &Configuration, reference: ReferenceAttitude, samples: u64) -> Monitor {
        let device = configuration.device.at_nodes(configuration.device.interval_s * samples as f64);
        let heads = Heads::Described(DescribedHeads::new(configuration, samples));
        let channels = noises(configuration).into_iter().map(Channel::of_unknown_noise).collect();
        let configuration = Configuration { device: device.into(), ..configuration.clone() };
        Monitor::from_parts(&configuration, Some(reference), heads, channels)
    }

    /// The largest statistic of any channel without an alarm.
    pub fn largest(&self) -> f64 {
        self.channels.iter().map(|channel| channel.largest).fold(0.0, f64::max)
    }

    /// The events since the last call.
    pub(crate) fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    pub(crate) fn start(&mut self, start_ns: i64) {
        self.start_s = start_ns as f64 * 1e-9;
        self.model = self.reference.take().map(|reference| {
            let since_s = reference.start_ns.saturating_sub(start_ns) as f64 * 1e-9;
            let truth = std::sync::Arc::unwrap_or_clone(reference.truth);
            Model::new(&self.configuration, truth.starting_at(since_s))
        });
    }

    fn t_s(&self) -> f64 {
        self.start_s + self.node as f64 * self.interval_s
    }

    fn report(&mut self, event: &'static str, code: &'static str, gyros: Gyros, statistic: f64, threshold: f64) {
        let t_s = self.t_s();
        self.events.push(Event { t_s, event, code, gyros, statistic, threshold });
    }

    /// Reports an interruption, unless one was shortly before.
    pub(crate) fn interrupt(&mut self, kind: BreakKind, gyros: Gyros, samples: u64) {
        let code = match kind {
            BreakKind::Gap(_) | BreakKind::Interpolated(_) => "lost-samples",
            BreakKind::Jump | BreakKind::TimeJump => "jump",
            BreakKind::Reset => "restart",
            BreakKind::Invalid | BreakKind::Outlier | BreakKind::Constant | BreakKind::Unknown => "invalid-count",
            BreakKind::Saturated => "saturated-count",
            BreakKind::SelfTest => "self-test",
        };
        if self.interrupted.is_none_or(|before| self.node - before > QUIET_SAMPLES) {
            self.report("interruption", code, gyros, samples as f64, 0.0);
        }
        self.interrupted = Some(self.node);
    }

    /// Goes past missing samples.
    pub(crate) fn skip(&mut self, samples: u64) {
        if let Some(model) = &mut self.model {
            model.end_samples(samples);
        }
        self.node += samples;
        self.passed += samples;
        self.is_new = [true; MAX_HEADS];
    }

    /// Adds the counts of a node; `broken` gyros have no valid ones.
    pub(crate) fn add(&mut self, counts: &[f64], broken: Gyros) {
        if let Some(model) = &mut self.model {
            model.end_samples(1);
        }
        self.node += 1;
        self.passed += 1;
        for (sum, &count) in self.counts.iter_mut().zip(counts) {
            *sum += count;
        }
        let is_covered = self.is_covered();
        self.compared += u64::from(is_covered);
        let end_s = self.node as f64 * self.interval_s;
        let is_at_row = self.model.as_mut().is_none_or(|model| model.is_at_row(end_s));
        let node = self.read();
        let turned: [f64; 3] =
            std::array::from_fn(|axis| node.turned_control_arcsec[axis] - self.last.turned_control_arcsec[axis]);
        let samples = self.passed as f64;
        let counted = self.transfer.about_control_arcsec(counts, samples).unwrap_or(turned);
        (self.last, self.passed) = (node, 0);
        let is_pair = self.model.is_none();
        for index in 0..self.channels.len() {
            let is_broken = !is_covered || if is_pair { broken[2] || broken[3] } else { broken[index] };
            let own = match &self.transfer {
                Heads::Described(heads) => heads.axes[index][0],
                Heads::Default(_) if is_pair => [0.0, 0.0, 1.0],
                Heads::Default(_) => Axes::of(Gyro::ALL[index]).input_control,
            };
            let about: f64 = (0..3).map(|axis| own[axis] * turned[axis]).sum();
            let step = Step {
                residual: (!is_broken && is_at_row).then_some(node.residual[index]),
                samples: samples * (self.interval_s / SAMPLE_INTERVAL_S),
                is_new: self.is_new[index],
                turned: self.transfer.in_channel(index, turned),
                counted: self.transfer.in_channel(index, counted),
                pivot: node.pivot[index],
                rate: about / (samples * self.interval_s),
            };
            self.is_new[index] = is_broken || self.is_new[index] && !is_at_row;
            if let Some(change) = self.channels[index].push(&step) {
                let gyros = if is_pair { self.gyros.with_mask(PAIR) } else { self.gyros.only(index) };
                self.report(change.event, change.code, gyros, change.statistic, THRESHOLD);
            }
            if let (Some(model), Some(clearance)) = (&mut self.model, self.channels[index].clearance_arcsec(&step)) {
                model.widen(index, clearance);
            }
        }
    }

    /// The values at the end of the sample.
    fn read(&mut self) -> Node {
        let samples = self.node as f64;
        let Some(model) = &mut self.model else {
            let Heads::Default(transfer) = &self.transfer else { return Node::default() };
            let counts = default_counts(&self.counts);
            let parity = transfer.redundancy_arcsec(counts, samples);
            let turned_control_arcsec = transfer.about_control_arcsec(counts, samples);
            return Node { residual: [parity; MAX_HEADS], turned_control_arcsec, ..Node::default() };
        };
        let modelled: Vec<f64> = model.unit.accumulated_counts().collect();
        let wider: Vec<Vec<f64>> = model.wider.iter().map(|unit| unit.accumulated_counts().collect()).collect();
        let pivot = |gyro: usize, index: usize| match (
            wider.get(index).and_then(|wider| wider.get(gyro)),
            modelled.get(gyro),
        ) {
            (Some(wider), Some(modelled)) => (wider - modelled) / CLEARANCES_ARCSEC[index],
            _ => 0.0,
        };
        let (turned_control_arcsec, _) = model.truth.at(samples * self.interval_s, &mut model.near);
        Node {
            residual: std::array::from_fn(|gyro| {
                modelled.get(gyro).map_or(0.0, |modelled| self.counts[gyro] - modelled)
            }),
            pivot: std::array::from_fn(|gyro| std::array::from_fn(|index| pivot(gyro, index))),
            turned_control_arcsec,
        }
    }

    /// True if the motion of the sample is known.
    fn is_covered(&mut self) -> bool {
        let Some(model) = &mut self.model else { return true };
        let end_s = self.node as f64 * self.interval_s;
        let (is_covered, is_over) = (model.covers(end_s), end_s > model.truth.end_s() + self.interval_s);
        if is_over && !self.has_ended {
            self.has_ended = true;
            self.report("reference-end", "reference", self.gyros, 0.0, 0.0);
        }
        is_covered
    }
}

impl Watch<ReceivedSample> for Monitor {
    fn push(&mut self, row: &ReceivedSample) -> Vec<Event> {
        let sample = row.sample;
        let step = self.continuity.step(sample.sequence, row.has_clock.then_some(sample.clock_count));
        let clock_ns = row.has_clock.then(|| (sample.clock_count as i64).saturating_mul(1_000));
        let now_ns = if self.uses_clock { clock_ns } else { row.time.map(|time| time.t_ns).or(clock_ns) };
        let passed =
            now_ns.zip(self.last_ns).map(|(now, before)| now.saturating_sub(before) as f64 * 1e-9 / SAMPLE_INTERVAL_S);
        let passed = passed.map_or(0, |samples| (samples.round() as u64).saturating_sub(1));
        self.last_ns = now_ns.or(self.last_ns);
        let missing = match step {
            SequenceStep::Repeat => return Vec::new(),
            SequenceStep::First => {
                self.start(now_ns.unwrap_or_default().saturating_sub((SAMPLE_INTERVAL_S * 1e9) as i64));
                None
            }
            SequenceStep::Next => None,
            SequenceStep::Gap(missing) => Some((BreakKind::Gap(missing), missing)),
            SequenceStep::Reset if passed == 0 => None,
            SequenceStep::Reset => Some((BreakKind::Reset, passed)),
            SequenceStep::Jump => Some((BreakKind::Jump, passed)),
        };
        if let Some((kind, samples)) = missing {
            self.skip(samples.min(MAX_MISSING));
            self.interrupt(kind, self.gyros, samples);
        }
        let mut broken = self.gyros.with_mask(0);
        for (kind, gyros) in unusable(&sample).into_iter().filter(|(_, gyros)| gyros.contains(&true)) {
            let gyros = self.gyros.filter(|gyro| gyros[gyro]);
            broken = broken.and(gyros);
            self.interrupt(kind, gyros, 1);
        }
        self.add(&sample.increments.map(f64::from), broken);
        self.take_events()
    }

    fn compared_s(&self) -> f64 {
        self.compared as f64 * self.interval_s
    }
}

#[cfg(test)]
mod tests {
    use geu_model::attitude::{AttitudeRow, RecordedAttitude};
    use geu_model::{GyroUnit, Truth};
    use geu_protocol::Sample;
    use geu_protocol::capture::Timestamp;

    use super::*;

    /// Events of ten hours of a unit with these values, which turns about all axes as its reference does; sample 60 000 is lost.
    fn watch(overrides: &[&str]) -> Vec<Event> {
        let overrides: Vec<String> = overrides.iter().map(|&text| text.to_owned()).collect();
        let row = |node: usize| AttitudeRow {
            t_s: node as f64 * SAMPLE_INTERVAL_S,
            angle_control_arcsec: [1.3, 0.9, 1.7].map(|rate| rate * 20.0 * (node as f64 / (400.0 * rate)).sin()),
            theta_psi_rad: Some((1.5, 0.0)),
        };
        let truth = RecordedAttitude::new((0..=72_000).map(row).collect()).expect("a truth");
        let reference = ReferenceAttitude::of_truth(0, truth.clone());
        let unit = Configuration::reference_with(&overrides).expect("a unit");
        let mut unit = GyroUnit::on(&unit, &Truth::Recorded(truth.into()));
        let mut monitor = Monitor::new(&Configuration::reference(), Some(reference), true);
        let row = |sample| ReceivedSample { time: None, is_received: false, sample, has_clock: true };
        let rows = (0..72_000).map(|_| row(unit.end_sample().sample)).enumerate();
        let rows: Vec<_> = rows.filter(|(index, _)| *index != 60_000).collect();
        rows.iter().flat_map(|(_, row)| monitor.push(row)).collect()
    }

    #[test]
    fn a_healthy_unit_has_no_alarm_and_a_lost_sample_is_one_interruption() {
        let events = watch(&["seed=7"]);
        let codes: Vec<_> = events.iter().map(|event| (event.event, event.code, event.statistic)).collect();
        assert_eq!(codes, [("interruption", "lost-samples", 1.0)]);
    }

    #[test]
    fn a_drift_step_is_one_alarm_on_its_gyro_and_gets_its_name() {
        let step = ["gyro.GYRY.drift-step.arcsec_per_h=60", "gyro.GYRY.drift-step.time_s=10000"];
        let events: Vec<_> = watch(&step).into_iter().filter(|event| event.event != "interruption").collect();
        assert!(events.iter().all(|event| event.gyros == Gyros::ALL.only(1)), "{events:?}");
        assert_eq!(events.iter().filter(|event| event.event == "alarm").count(), 1, "{events:?}");
        assert!((10_000.0..10_300.0).contains(&events[0].t_s), "{events:?}");
        let said: Vec<_> = events.iter().map(|event| (event.event, event.code)).collect();
        assert_eq!(said, [("alarm", "unknown"), ("named", "drift")]);
    }

    #[test]
    fn a_wider_pivot_of_any_gyro_has_one_alarm_and_its_name() {
        for (gyro, clearance) in [("GYRX", 8), ("GYRY", 3), ("GYRZB", 1)] {
            let path = format!("gyro.{gyro}.pivot-clearance-step");
            let step = [format!("{path}.clearance_arcsec={clearance}"), format!("{path}.time_s=10000")];
            let events = watch(&step.each_ref().map(String::as_str));
            let said: Vec<_> = events.iter().map(|event| (event.event, event.code)).collect();
            let expected = [("alarm", "unknown"), ("named", "pivot-clearance"), ("interruption", "lost-samples")];
            assert_eq!(said, expected, "{gyro}: {events:?}");
        }
    }

    #[test]
    fn any_times_and_numbers_of_samples_are_taken() {
        let mut random = 1_u64;
        let mut next = move || {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            random >> 16
        };
        let mut monitor = Monitor::new(&Configuration::reference(), None, false);
        for _ in 0..20_000 {
            let sample = Sample {
                sequence: next() as u16,
                increments: std::array::from_fn(|_| next() as i16),
                clock_count: next(),
                gyro_flags: if next().is_multiple_of(4) { next() as u8 } else { 0 },
                unit_flags: next() as u8,
                ..Sample::default()
            };
            let time = Some(Timestamp { t_ns: (next() << 16) as i64, digits: 6 });
            for event in monitor.push(&ReceivedSample { time, is_received: true, sample, has_clock: true }) {
                assert!(event.statistic.is_finite(), "{event:?}");
            }
        }
    }
}
