//! The unit as a state machine: half seconds, commands, modes (icd.md).
//!
//! A command acts as if it had come at the start of the half second that runs; a fault is decided at its start, and acts
//! over all of it.

mod faulted;

use std::sync::Arc;

use geu_protocol::field::{CLOCK_MODULUS, unit_flag};
use geu_protocol::{CLOCK_PER_HALF_SECOND, Command, Gyro, HalfSecond, LINK_VERSION, Outcome, Reply, command};

use crate::attitude::{Motion, Plan, Recorded, Stepped};
use crate::configuration::Configuration;
use crate::course::Interval;
use crate::effect::{
    FAULT_COLUMN, HeadEffects, POWER_COLUMN, SATURATION_COLUMN, SELF_TEST_COLUMN, Tap, Temperatures, Timing,
    UnitEffects, WiringEffects, WiringStates,
};
use crate::fault::acting::Faults;
use crate::fault::catalogue::UnitLaw;
use crate::fault::{Action, Fault, List};
use crate::package::{Package, Standing, SubStep, Trace};
use crate::temperature::{Sensor, interpolate};
use crate::units::HALF_SECOND_S;
pub use faulted::Injected;

/// Sub-steps of a half second, over which motion is resolved: 0.1 s each.
const SUB_STEPS: usize = 5;
/// A half second in femtoseconds, the grain of the unit's true time: 10⁻¹⁵ of it at most is lost in rounding.
const HALF_SECOND_FS: f64 = 0.5e15;
/// A truth may end by this share of a half second early: its stamps are rounded.
const GRAIN: f64 = 1e-6;
/// Spin-up of a gyro: 60 s.
const SPIN_UP_HALF_SECONDS: u32 = 120;

/// The answer to one COMMAND.
#[derive(Debug, Clone, Copy)]
pub struct Answer {
    /// Goes to the link (TCP: the client) that asked.
    pub reply: Reply,
    /// For a POLL that was granted: the messages that follow the reply, to the same client.
    pub polled: Option<HalfSecond>,
}

/// A half second that just ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ended {
    /// What the unit tells of it.
    pub half_second: HalfSecond,
    /// Whether it is sent on every link now (cyclic mode), or kept to be polled.
    pub cyclic: bool,
    /// Scheduled end, true time since the start of the first half second, ns.
    pub end_ns: i64,
}

/// What moves the unit.
#[derive(Debug, Clone, Default)]
pub enum Truth {
    /// The configuration's scenario.
    #[default]
    Scenario,
    /// Rows of a file; their time 0 is the start of the first half second.
    Recorded(Arc<Recorded>),
    /// Pieces that become known while the unit runs, or that did in a run before; their time 0 is the same.
    Stepped(Arc<Stepped>),
}

impl Truth {
    /// The motion from `t_s` on, true time since the start of the first half second; a scenario is at rest before that,
    /// and begins there.
    pub fn motion(&self, configuration: &Configuration, t_s: f64) -> Motion {
        match self {
            Truth::Scenario => {
                let scenario = &configuration.scenario;
                let plan = Plan::new(scenario).expect("a configuration holds only scenarios that were tried");
                Motion::starting_before(plan, scenario.limit_cycle, (-t_s).max(0.0))
            }
            Truth::Recorded(rows) => Motion::recorded(rows.clone(), t_s),
            Truth::Stepped(pieces) => Motion::stepped(pieces.clone(), t_s),
        }
    }
}

#[derive(Debug, Clone)]
enum Power {
    Off,
    /// Half seconds of spin-up left; 0 is synchronous.
    On(u32),
}

#[derive(Debug, Clone, Copy)]
struct SelfTest {
    gyros: u8,
    counts: i16,
    half_seconds_left: u8,
}

/// The counter of one gyro.
#[derive(Debug, Clone)]
struct Channel {
    power: Power,
    /// Counts so far as a real number, and rounded. The increment is the difference of the rounded.
    accumulated: f64,
    rounded: f64,
}

impl Channel {
    /// The increment: the difference of the rounded accumulated counts, so that no fraction is ever lost.
    #[inline]
    fn accumulate(&mut self, unquantised: f64) -> f64 {
        self.accumulated += unquantised;
        let before = std::mem::replace(&mut self.rounded, self.accumulated.round());
        self.rounded - before
    }
}

/// The unit.
#[derive(Debug, Clone)]
pub struct Unit {
    configuration: Arc<Configuration>,
    faults: Faults,
    /// The unit without the faults that act, as it was when the first of them came.
    clean: Option<Box<Unit>>,
    injected: Option<Arc<Injected>>,
    /// Opcodes of the commands of the running half second.
    heard: Vec<u8>,
    /// The motion that is counted, which an effect may shift, and the motion of the moment.
    motion: Motion,
    truth: Motion,
    package: Package,
    channels: [Channel; 4],
    /// Gyros that are counted; the others read nothing.
    counted: [bool; 4],
    wiring: WiringStates,
    sensor: Sensor,
    /// Sensor temperatures that were measured; where there are any they take the place of the heater.
    sensor_measured: Vec<(f64, f64)>,
    /// True time since the start, fs, at the start of the running half second and at its end.
    start_fs: i128,
    end_fs: i128,
    /// Effects of the unit over the running half second, and the time they make.
    unit: UnitEffects,
    timing: Timing,
    /// Half seconds ended.
    ended: u64,
    /// Counts lost to saturation, per gyro.
    lost_counts: [f64; 4],
    sequence: u16,
    clock_count: u64,
    polled: bool,
    self_test: Option<SelfTest>,
    last: Option<HalfSecond>,
}

impl Unit {
    /// The unit on its configuration's scenario, spun up and warm, at the start of its first half second.
    pub fn new(configuration: &Configuration) -> Unit {
        Unit::on(configuration, &Truth::Scenario)
    }

    /// The unit on another truth.
    pub fn on(configuration: &Configuration, truth: &Truth) -> Unit {
        let at = |t_s: f64| truth.motion(configuration, t_s);
        let truth = at(0.0);
        let mut unit = Unit {
            motion: truth.clone(),
            truth,
            package: Package::start(configuration.seed),
            channels: Gyro::ALL.map(|_| Channel { power: Power::On(0), accumulated: 0.0, rounded: 0.0 }),
            counted: [true; 4],
            wiring: WiringStates::default(),
            configuration: Arc::new(configuration.clone()),
            faults: Faults::new(configuration),
            clean: None,
            injected: None,
            heard: Vec::new(),
            sensor: Sensor::WARM,
            sensor_measured: Vec::new(),
            start_fs: 0,
            end_fs: 0,
            unit: UnitEffects::default(),
            timing: Timing::default(),
            ended: 0,
            lost_counts: [0.0; 4],
            sequence: u16::MAX,
            clock_count: 0,
            polled: false,
            self_test: None,
            last: None,
        };
        unit.begin();
        // The first half second counts from where its shifted time begins.
        let shift_s = unit.timing.shift_s;
        if shift_s != 0.0 {
            unit.motion = at(-shift_s);
            unit.motion.advance(-shift_s);
        }
        unit
    }

    /// How many half seconds, at most `most`, a truth tells: all their true time, the motion that an effect shifts to them,
    /// and of a recorded one the half second of true time in which the last one ends.
    pub fn half_seconds_within(configuration: &Configuration, truth: &Truth, most: u64) -> u64 {
        if matches!(truth, Truth::Scenario) {
            return most;
        }
        let moves_time =
            |fault: &Fault| matches!(fault.action, Action::Parameter { target, .. } if target.list == List::Unit);
        // A fault that moves the unit's time comes when its conditions hold: only the run itself tells.
        let is_flown = configuration.faults.iter().any(moves_time);
        let mut unit = if is_flown { Unit::on(configuration, truth) } else { Unit::new(configuration) };
        let mut commands = configuration.run.commands.iter().peekable();
        let covered = |unit: &Unit| match truth {
            Truth::Scenario => true,
            Truth::Recorded(rows) => {
                let end_s = unit.end_fs as f64 * 1e-15;
                let needed_s = (end_s / HALF_SECOND_S - GRAIN).ceil() * HALF_SECOND_S;
                needed_s.max(unit.needs_truth_s()) <= rows.end_s() + GRAIN
            }
            Truth::Stepped(pieces) => unit.needs_truth_s() <= pieces.end_s() + GRAIN,
        };
        let mut count = 0;
        while count < most && covered(&unit) {
            count += 1;
            if is_flown {
                while let Some(command) = commands.next_if(|command| command.half_second < count) {
                    let _ = unit.command(&command.payload);
                }
                unit.end_half_second();
            } else {
                unit.start_fs = unit.end_fs;
                unit.schedule_end();
            }
        }
        count
    }

    /// How far the truth must be known to end the running half second: to its end, and beyond where an effect shifts the
    /// motion forward, in the unit or in the one without faults.
    pub fn needs_truth_s(&self) -> f64 {
        let end_s = self.end_fs as f64 * 1e-15;
        let own_s = end_s.max(end_s - self.timing.shift_s);
        self.clean.as_ref().map_or(own_s, |clean| clean.needs_truth_s().max(own_s))
    }

    /// How many half seconds have ended: the index of the one that runs.
    pub fn ended(&self) -> u64 {
        self.ended
    }

    /// Scheduled end of the running half second, true time since the start of the first, ns.
    pub fn running_end_ns(&self) -> i64 {
        ((self.end_fs + 500_000) / 1_000_000) as i64
    }

    /// Counts that clipping has lost so far, in the order of [`Gyro::ALL`].
    pub fn lost_counts(&self) -> [f64; 4] {
        self.lost_counts
    }

    /// Counts so far as real numbers, in the order of [`Gyro::ALL`]: before rounding, wiring faults, self-test, power and
    /// saturation.
    pub fn accumulated_counts(&self) -> [f64; 4] {
        self.channels.each_ref().map(|channel| channel.accumulated)
    }

    /// Has the sensor at temperatures that were measured, (time since the start in s, °C) in order of time, instead of where
    /// its heater would hold it: for a model beside a recording.
    pub fn follow_sensor(&mut self, measured: Vec<(f64, f64)>) {
        self.sensor_measured = measured;
    }

    /// Counts these gyros alone; the others read nothing: for a model of which some gyros matter.
    pub fn count_only(&mut self, gyros: [bool; 4]) {
        self.counted = gyros;
    }

    /// The motion of the moment that is counted.
    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Carries out the payload of a COMMAND within the running half second.
    ///
    /// # Errors
    /// The reply that would have come, where a fault keeps the unit from hearing the command.
    pub fn command(&mut self, payload: &[u8]) -> Result<Answer, Reply> {
        let unfaulted = self.clean.as_mut().map(|clean| clean.answer(payload));
        // Each once: a client may send as many as it likes.
        let opcode = payload.first().copied().filter(|opcode| !self.heard.contains(opcode));
        self.heard.extend(opcode);
        match unfaulted {
            Some(answer) if self.faults.is_silent() => Err(answer.reply),
            _ => Ok(self.answer(payload)),
        }
    }

    fn answer(&mut self, payload: &[u8]) -> Answer {
        let opcode = payload.first().copied().unwrap_or(0);
        let answer = |outcome| Answer { reply: Reply::new(opcode, outcome, &[]), polled: None };
        let command = match command::parse(payload) {
            Ok(command) => command,
            Err(outcome) => return answer(outcome),
        };
        match command {
            Command::Ping => {
                let values = [LINK_VERSION.0, LINK_VERSION.1];
                return Answer { reply: Reply::new(opcode, Outcome::Done, &values), polled: None };
            }
            Command::SetMode { polled } => self.polled = polled,
            Command::Poll => match self.last {
                Some(last) if self.polled => return Answer { polled: Some(last), ..answer(Outcome::Done) },
                _ => return answer(Outcome::NotPossibleNow),
            },
            Command::SelfTest { gyros, counts, half_seconds } => {
                if self.self_test.is_some() {
                    return answer(Outcome::NotPossibleNow);
                }
                self.self_test = Some(SelfTest { gyros, counts, half_seconds_left: half_seconds });
            }
            Command::ResetSequence => (self.sequence, self.clock_count) = (u16::MAX, 0),
            Command::GyroPower { gyros } => {
                for (gyro, channel) in Gyro::ALL.into_iter().zip(&mut self.channels) {
                    channel.power = match (gyros & gyro.bit() != 0, &channel.power) {
                        (true, Power::Off) => Power::On(SPIN_UP_HALF_SECONDS),
                        (true, Power::On(left)) => Power::On(*left),
                        (false, _) => Power::Off,
                    };
                }
            }
            Command::Heater { on } => self.sensor.heater_on = on,
        }
        answer(Outcome::Done)
    }

    /// Ends the running half second and begins the next.
    pub fn end_half_second(&mut self) -> Ended {
        self.end::<()>().0
    }

    /// As [`Unit::end_half_second`], and tells how the counts of each gyro came about.
    pub fn end_half_second_traced(&mut self) -> (Ended, [Trace; 4]) {
        self.end()
    }

    fn end<T: Tap>(&mut self) -> (Ended, [T; 4]) {
        let (start_s, end_s) = (self.start_fs as f64 * 1e-15, self.end_fs as f64 * 1e-15);
        let temperatures = self.temperatures(0.5 * (start_s + end_s));
        let interval = Interval {
            start_s,
            end_s,
            electronics_excess_k: temperatures.electronics_c - temperatures.electronics_reference_c,
        };
        let length_s = (end_s - start_s) / SUB_STEPS as f64;
        let mut steps = [SubStep::default(); SUB_STEPS];
        let mut truths = Vec::new();
        let looks_at_truth = T::LOOKS && (self.timing.shift_s != 0.0 || self.motion.now().t_s != start_s);
        // A shift that begins now: until here, what was counted was the truth.
        if looks_at_truth && self.truth.now().t_s < start_s && self.motion.now().t_s == start_s {
            self.truth = self.motion.clone();
        }
        for (index, step) in steps.iter_mut().enumerate() {
            // The last sub-step ends with the half second, to the last bit.
            step.end_s = if index + 1 == SUB_STEPS { end_s } else { start_s + (index + 1) as f64 * length_s };
            step.counted = self.motion.advance(step.end_s - self.timing.shift_s);
            step.counted.length_s = length_s;
            if looks_at_truth {
                truths.push(self.truth.advance(step.end_s));
            }
        }
        let (gyros, faults) = (&self.configuration.gyros, &self.faults);
        let mut rooms: [Option<HeadEffects>; 4] = [None; 4];
        let mut rooms = rooms.iter_mut();
        let standing = std::array::from_fn(|index| {
            let (room, gyro) = (rooms.next().expect("one for each"), Some(Gyro::ALL[index]));
            Standing {
                is_counted: self.counted[index],
                calibration: &gyros[index].calibration,
                effects: match faults.moves(List::Head, gyro) {
                    false => gyros[index].effects.standing(&interval, room),
                    true => room.insert(faults.moved(gyros[index].effects.at(&interval), List::Head, gyro)),
                },
                discovered: &gyros[index].discovered,
            }
        });
        let wiring: [WiringEffects; 4] = std::array::from_fn(|index| {
            faults.moved(gyros[index].wiring.at(&interval), List::Wiring, Some(Gyro::ALL[index]))
        });
        let mut taps: [T; 4] = std::array::from_fn(|_| T::default());
        let unquantised = self.package.count(&standing, &self.unit, &temperatures, &steps, &truths, &mut taps);
        let mut counts: [f64; 4] = std::array::from_fn(|index| self.channels[index].accumulate(unquantised[index]));
        WiringEffects::apply(&wiring, &mut self.wiring, &mut counts, &mut taps);

        let mut half_second = HalfSecond::default();
        let mut synchronous = true;
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
                        half_second.gyro_flags |= gyro.bit();
                    } else {
                        synchronous = false;
                        *left -= 1;
                    }
                }
            }
        }
        let before = counts;
        let marks = self.faults.act_on_counts(&mut counts);
        half_second.gyro_flags &= !marks.invalid;
        let coasts = |(channel, gyro): (&Channel, Gyro)| {
            matches!(channel.power, Power::On(_)) && marks.coasting & gyro.bit() != 0
        };
        synchronous &= !self.channels.iter().zip(Gyro::ALL).any(coasts);
        for (index, gyro) in Gyro::ALL.into_iter().enumerate() {
            let counts = &mut counts[index];
            if *counts != before[index] {
                taps[index].changed(FAULT_COLUMN, *counts - before[index]);
            }
            let clipped = counts.clamp(f64::from(i16::MIN), f64::from(i16::MAX));
            if clipped != *counts {
                half_second.gyro_flags |= gyro.bit() << 4;
                self.lost_counts[index] += (*counts - clipped).abs();
                taps[index].changed(SATURATION_COLUMN, clipped - *counts);
            }
            half_second.increments[index] = clipped as i16;
        }
        self.sequence = self.sequence.wrapping_add(1);
        self.clock_count = (self.clock_count + CLOCK_PER_HALF_SECOND) % CLOCK_MODULUS;
        half_second.sequence = self.sequence;
        half_second.clock_count = self.clock_count;
        let at_end = self.temperatures(end_s);
        let heater_on = self.sensor.heater_on;
        self.sensor.heater_on &=
            !self.faults.on_unit().any(|(law, _)| matches!(law, UnitLaw::HeaterLost | UnitLaw::BrownOut));
        self.sensor.advance(end_s - start_s, at_end.electronics_c);
        self.sensor.heater_on = heater_on;
        half_second.electronics_centi_c = centi(at_end.electronics_c);
        half_second.sensor_centi_c = centi(self.sensor.temperature_c);
        half_second.unit_flags = [
            (self.sensor.in_band(), unit_flag("heater_in_band")),
            (synchronous, unit_flag("motors_synchronous")),
            (true, unit_flag("clock_locked")),
            (self.self_test.is_some(), unit_flag("self_test")),
            (self.polled, unit_flag("polled")),
        ]
        .into_iter()
        .fold(0, |flags, (set, flag)| if set { flags | flag } else { flags });
        self.self_test = self.self_test.and_then(|test| {
            let half_seconds_left = test.half_seconds_left - 1;
            (half_seconds_left > 0).then_some(SelfTest { half_seconds_left, ..test })
        });
        for (law, _) in self.faults.on_unit() {
            if let UnitLaw::FlipFlags { gyro_flags, unit_flags } = law {
                half_second.gyro_flags ^= gyro_flags;
                half_second.unit_flags ^= unit_flags;
            }
        }
        self.last = Some(half_second);
        let cyclic = !self.polled && !self.faults.is_silent();
        let ended = Ended { half_second, cyclic, end_ns: self.running_end_ns() };
        self.injected = self.compare(&ended);
        self.ended += 1;
        self.start_fs = self.end_fs;
        self.begin();
        (ended, taps)
    }

    /// Begins a half second: which faults act over it, and when it ends.
    fn begin(&mut self) {
        self.begin_faults();
        self.heard.clear();
        self.schedule_end();
        self.hold_clean();
    }

    /// Schedules the end of the half second that begins: 0.5/(1 + ε) s of true time after its start.
    fn schedule_end(&mut self) {
        let start_s = self.start_fs as f64 * 1e-15;
        let temperatures = self.temperatures(start_s + 0.5 * HALF_SECOND_S);
        let interval = Interval {
            start_s,
            end_s: start_s + HALF_SECOND_S,
            electronics_excess_k: temperatures.electronics_c - temperatures.electronics_reference_c,
        };
        self.unit = self.faults.moved(self.configuration.unit.at(&interval), List::Unit, None);
        self.timing = self.unit.timing().last().copied().unwrap_or_default();
        self.end_fs = self.start_fs + (HALF_SECOND_FS / (1.0 + self.timing.clock_error)).round() as i128;
    }

    fn temperatures(&self, t_s: f64) -> Temperatures {
        let electronics = &self.configuration.electronics;
        Temperatures {
            electronics_c: electronics.at_c(t_s),
            electronics_reference_c: electronics.numbers.reference_c,
            sensor_c: match self.sensor_measured.is_empty() {
                true => self.sensor.temperature_c,
                false => interpolate(&self.sensor_measured, t_s),
            },
        }
    }
}

fn centi(temperature_c: f64) -> i16 {
    (temperature_c * 100.0).round() as i16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::{Basis, Knot, Row};

    fn unit(overrides: &[&str]) -> Unit {
        let overrides: Vec<String> = overrides.iter().map(|text| text.to_string()).collect();
        Unit::new(&Configuration::reference_with(&overrides).expect("valid"))
    }

    fn run(unit: &mut Unit, half_seconds: usize) -> Vec<HalfSecond> {
        (0..half_seconds).map(|_| unit.end_half_second().half_second).collect()
    }

    fn outcome(unit: &mut Unit, payload: &[u8]) -> Outcome {
        unit.command(payload).expect("no fault keeps it from hearing").reply.outcome()
    }

    #[test]
    fn rounding_is_half_away_from_zero_and_never_accumulates() {
        let mut channel = unit(&[]).channels[0].clone();
        // Accumulated −1.5, −0.5, 0.5, 1.5 round to −2, −1, 1, 2.
        let increments = [-1.5, 1.0, 1.0, 1.0].map(|counts| channel.accumulate(counts));
        assert_eq!(increments, [-2.0, 1.0, 2.0, 1.0]);
    }

    #[test]
    fn a_truth_covers_what_its_clock_needs() {
        let within = |overrides: &[&str], truth: &Truth, most: u64| {
            let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
            let configuration = Configuration::reference_with(&overrides).expect("valid");
            Unit::half_seconds_within(&configuration, truth, most)
        };
        let recorded = |tenths: u32| {
            let row = |tenth| Row { t_s: f64::from(tenth) / 10.0, angle_control_arcsec: [0.0; 3], theta_psi_rad: None };
            let rows: Vec<Row> = (0..=tenths).map(row).collect();
            Truth::Recorded(Arc::new(Recorded::new(&rows).expect("good rows")))
        };
        let stepped = |t_s: f64| {
            let pieces = Stepped::default();
            pieces.append(Knot { t_s, angle_control_arcsec: [0.0; 3], basis: Basis::Told });
            Truth::Stepped(Arc::new(pieces))
        };
        assert_eq!(within(&[], &recorded(1000), 1000), 200);
        assert_eq!(within(&[], &recorded(1000), 150), 150);
        assert_eq!(within(&[], &recorded(999), 1000), 199);
        assert_eq!(within(&[], &Truth::Scenario, 1000), 1000);
        // A slow clock: its 200th half second ends 1 ms after 100 s; only a recorded truth must tell that whole half second.
        let slow = &["unit.clock-frequency.ppm=-10"];
        assert_eq!(within(slow, &recorded(1000), 1000), 199);
        assert_eq!(within(slow, &stepped(100.0), 1000), 199);
        assert_eq!(within(slow, &stepped(100.002), 1000), 200);
        assert_eq!(within(&["unit.clock-frequency.ppm=10"], &recorded(1000), 1000), 200);
        // Counts that tell the motion of 0.2 s ahead.
        let ahead = &["unit.time-offset.seconds=-0.2"];
        assert_eq!((within(ahead, &recorded(1000), 1000), within(ahead, &stepped(100.2), 1000)), (199, 200));
    }

    #[test]
    fn accumulated_counts_stay_within_half_a_count_of_the_unquantised() {
        let mut unit = unit(&[]);
        let (mut counted, mut unquantised) = ([0.0; 4], [0.0; 4]);
        for _ in 0..20_000 {
            let (ended, traces) = unit.end_half_second_traced();
            for index in 0..4 {
                counted[index] += f64::from(ended.half_second.increments[index]);
                unquantised[index] += traces[index].unquantised;
                assert!((counted[index] - unquantised[index]).abs() < 0.500_001);
            }
        }
        for (told, summed) in unit.accumulated_counts().into_iter().zip(unquantised) {
            assert!((told - summed).abs() < 1e-6, "{told} {summed}");
        }
    }

    #[test]
    fn self_test_adds_its_counts_for_its_half_seconds_and_flags_them() {
        let (mut plain, mut tested) = (unit(&[]), unit(&[]));
        assert_eq!(outcome(&mut tested, &[4, 0b0101, 0, 100, 3]), Outcome::Done);
        assert_eq!(outcome(&mut tested, &[4, 1, 0, 1, 1]), Outcome::NotPossibleNow);
        let (plain, tested) = (run(&mut plain, 5), run(&mut tested, 5));
        for index in 0..5 {
            let added: Vec<i16> =
                tested[index].increments.iter().zip(plain[index].increments).map(|(a, b)| a - b).collect();
            let (counts, flag) = if index < 3 { (100, unit_flag("self_test")) } else { (0, 0) };
            assert_eq!(added, [counts, 0, counts, 0]);
            assert_eq!(tested[index].unit_flags & unit_flag("self_test"), flag);
        }
    }

    #[test]
    fn what_commands_do_to_counts_stands_in_the_trace() {
        let mut unit = unit(&[]);
        let _ = unit.command(&[4, 1, 0, 100, 2]);
        let _ = unit.command(&[6, 0b1101]);
        for _ in 0..4 {
            let (ended, traces) = unit.end_half_second_traced();
            for (trace, count) in traces.iter().zip(ended.half_second.increments) {
                let sum: f64 = trace.true_arcsec + trace.changes.iter().sum::<f64>();
                assert!((sum - trace.unquantised).abs() < 1e-9);
                assert!((trace.unquantised - f64::from(count)).abs() <= 1.0, "{} {count}", trace.unquantised);
            }
        }
    }

    #[test]
    fn clipping_is_flagged_never_wrapped_and_the_loss_counted() {
        let largest = command::payload(&command::COMMANDS[3], &[1, 32_767, 1]);
        // A drift of 10″ per half second takes counts away, one of −10″ adds them.
        let mut below = unit(&["gyro.GYRX.calibration.drift_arcsec_per_half_s=10"]);
        let _ = below.command(&largest);
        let half_second = run(&mut below, 1)[0];
        assert!((32_750..32_767).contains(&half_second.increments[0]));
        assert_eq!((half_second.gyro_flags, below.lost_counts()[0]), (0x0F, 0.0));
        let mut above = unit(&["gyro.GYRX.calibration.drift_arcsec_per_half_s=-10"]);
        let _ = above.command(&largest);
        let half_second = run(&mut above, 1)[0];
        assert_eq!((half_second.increments[0], half_second.gyro_flags), (i16::MAX, 0x1F));
        assert!((8.0..13.0).contains(&above.lost_counts()[0]), "{:?}", above.lost_counts());
    }

    #[test]
    fn reset_restarts_sequence_and_clock_with_the_running_half_second() {
        let mut unit = unit(&[]);
        run(&mut unit, 10);
        let _ = unit.command(&[5]);
        let after = run(&mut unit, 2);
        assert_eq!((after[0].sequence, after[0].clock_count), (0, 500_000));
        assert_eq!((after[1].sequence, after[1].clock_count), (1, 1_000_000));
    }

    #[test]
    fn a_stopped_gyro_reads_nothing_and_takes_a_minute_to_spin_up() {
        let mut unit = unit(&[]);
        let _ = unit.command(&[6, 0b1110]);
        let stopped = run(&mut unit, 4);
        assert!(stopped.iter().all(|h| h.increments[0] == 0 && h.gyro_flags == 0x0E && h.unit_flags & 2 == 2));
        let _ = unit.command(&[6, 0x0F]);
        let _ = unit.command(&[6, 0x0F]);
        let spinning = run(&mut unit, 121);
        assert!(spinning[..120].iter().all(|h| h.gyro_flags == 0x0E && h.unit_flags & 2 == 0));
        assert_eq!((spinning[120].gyro_flags, spinning[120].unit_flags & 2), (0x0F, 2));
    }

    #[test]
    fn a_cold_sensor_leaves_its_band_and_comes_back() {
        let mut unit = unit(&[]);
        let _ = unit.command(&[7, 0]);
        let cooling = run(&mut unit, 240);
        assert_eq!((cooling[0].unit_flags & 1, cooling[239].unit_flags & 1), (1, 0));
        let _ = unit.command(&[7, 1]);
        assert_eq!(run(&mut unit, 12_000)[11_999].unit_flags & 1, 1);
    }

    #[test]
    fn polled_mode_keeps_the_half_second_until_it_is_asked_for() {
        let mut unit = unit(&[]);
        assert_eq!(outcome(&mut unit, &[3]), Outcome::NotPossibleNow);
        assert_eq!(outcome(&mut unit, &[2, 1]), Outcome::Done);
        assert_eq!(outcome(&mut unit, &[3]), Outcome::NotPossibleNow);
        let ended = unit.end_half_second();
        assert!(!ended.cyclic);
        assert_eq!(ended.half_second.unit_flags & 16, 16);
        for _ in 0..2 {
            assert_eq!(unit.command(&[3]).expect("heard").polled, Some(ended.half_second));
        }
        let _ = unit.command(&[2, 0]);
        assert!(unit.end_half_second().cyclic);
    }

    #[test]
    fn a_fast_clock_ends_half_seconds_early() {
        let mut unit = unit(&["unit.clock-frequency.ppm=100"]);
        for _ in 0..10_000 {
            unit.end_half_second();
        }
        // 10 000 half seconds of 0.5/(1 + 10⁻⁴) s.
        let expected_ns = 5_000e9 / 1.0001;
        assert!((unit.running_end_ns() as f64 - 0.5e9 / 1.0001 - expected_ns).abs() < 2.0);
    }
}
