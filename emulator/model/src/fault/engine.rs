//! The faults of a run, sample by sample: those that are active, and the action of those of gyros and unit.

use std::sync::Arc;

use geu_protocol::Gyro;

use super::catalogue::{FaultAction, GyroFault, LinkFault, SpikeLaw, UnitFault};
use super::expectation::{ExpectationMonitor, ExpectationResult};
use super::expression::ConditionInputs;
use super::{EffectList, Fault, FaultRng, ParameterRef};
use crate::configuration::Configuration;
use crate::device::Device;
use crate::effect::Effects;
use crate::gyro_unit::CompletedSample;
use crate::parameter_spec::Widening;
use crate::time_profile::Interval;

/// A fault over one sample interval.
#[derive(Debug, Clone, PartialEq)]
pub struct ActiveFault {
    pub fault: Arc<Fault>,
    pub law: FaultAction,
    /// Samples since it started.
    pub elapsed: u64,
    pub frame: u64,
    /// 1; less while a parameter returns.
    pub share: f64,
    /// The last sample before it started.
    pub before: Option<CompletedSample>,
    pub seed: u64,
    /// Nominal length of a sample interval, s.
    pub interval_s: f64,
}

impl ActiveFault {
    /// Its random numbers.
    pub fn draw(&self) -> FaultRng<'_> {
        FaultRng::new(self.seed, &self.fault.id)
    }

    /// True if the unit neither sends nor receives because of it.
    pub fn silences_unit(&self) -> bool {
        matches!(self.law, FaultAction::Unit(UnitFault::Reset | UnitFault::BrownOut | UnitFault::BootDelay))
    }

    /// Its action on links.
    pub fn on_link(&self) -> Option<LinkFault> {
        match self.law {
            FaultAction::Link(law) => Some(law),
            _ => None,
        }
    }
}

/// An event of a fault or an expectation.
#[derive(Debug, Clone, PartialEq)]
pub enum FaultEvent {
    Started(Arc<Fault>),
    /// The fault ended, after this number of samples.
    Ended(Arc<Fault>, u64),
    Decided(ExpectationMonitor),
}

/// A fault of the plan, and how it stands.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultStatus {
    pub fault: Arc<Fault>,
    pub law: FaultAction,
    pub started: u64,
    running: Option<Running>,
    pub is_cleared: bool,
}

#[derive(Debug, Clone, PartialEq)]
struct Running {
    start: u64,
    end: Option<u64>,
    /// While a parameter returns: since when.
    releasing: Option<u64>,
    before: Option<CompletedSample>,
    /// Remainder of a scaled count.
    carried: f64,
}

impl FaultStatus {
    /// First sample in which it acts; `None` if it is inactive.
    pub fn since(&self) -> Option<u64> {
        self.running.as_ref().map(|running| running.start)
    }

    /// The sample with which it ends, where that is known.
    pub fn end(&self) -> Option<u64> {
        self.running.as_ref().and_then(|running| running.end)
    }

    pub fn awaits_operator(&self) -> bool {
        self.fault.by_hand && !self.is_over()
    }

    /// True if it never acts from this on-board time on.
    pub fn is_over_by(&self, now_s: f64) -> bool {
        self.is_over() || self.running.is_none() && self.fault.until_s <= now_s
    }

    /// True if it never acts again at any time.
    pub fn is_over(&self) -> bool {
        self.running.is_none() && (self.is_cleared || self.started >= self.fault.times)
    }
}

#[derive(Debug, Clone, Default)]
pub struct FaultEngine {
    seed: u64,
    /// Nominal length of a sample interval, s.
    pub interval_s: f64,
    widening: Widening,
    /// In the order of the plan, then as they were injected.
    pub planned: Vec<FaultStatus>,
    pub watches: Vec<ExpectationMonitor>,
    acting: Arc<Vec<ActiveFault>>,
    happened: Vec<FaultEvent>,
}

/// Flags that faults of gyros override.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct FlagOverrides {
    /// Gyros that are not valid, as bits.
    pub invalid: u8,
    pub coasting: u8,
}

impl FaultEngine {
    pub fn new(configuration: &Configuration) -> FaultEngine {
        let mut faults = FaultEngine {
            seed: configuration.seed,
            interval_s: configuration.device.interval_s,
            widening: configuration.device.widening(),
            ..FaultEngine::default()
        };
        configuration.faults.iter().for_each(|fault| faults.add(fault.clone()));
        faults.watches = configuration.expectations.iter().cloned().map(ExpectationMonitor::new).collect();
        faults
    }

    pub fn add(&mut self, fault: Fault) {
        let law = fault.law();
        self.planned.push(FaultStatus { fault: Arc::new(fault), law, started: 0, running: None, is_cleared: false });
    }

    /// Starts an operator-triggered fault at this on-board time or at its own, if later. Returns that time; `None` for an
    /// unknown fault, or if its end has passed.
    pub fn start(&mut self, id: &str, at_s: f64) -> Option<f64> {
        let planned = self.planned.iter_mut().find(|planned| planned.fault.id == id && planned.awaits_operator())?;
        let mut fault = Fault::clone(&planned.fault);
        let is_in_time = fault.start_at(at_s);
        planned.fault = Arc::new(fault);
        is_in_time.then_some(planned.fault.at_s)
    }

    /// Ends a fault from the next sample on. Returns false for an unknown or ended fault.
    pub fn clear(&mut self, id: &str, until_s: f64) -> bool {
        let found = self.planned.iter_mut().find(|planned| planned.fault.id == id && !planned.is_over());
        let Some(planned) = found else { return false };
        let mut fault = Fault::clone(&planned.fault);
        fault.end_at(until_s);
        planned.fault = Arc::new(fault);
        planned.is_cleared = true;
        true
    }

    /// True if there are neither faults nor expectations.
    pub fn is_empty(&self) -> bool {
        self.planned.is_empty() && self.watches.is_empty()
    }

    /// Faults that act over the running sample interval.
    pub fn acting(&self) -> &Arc<Vec<ActiveFault>> {
        &self.acting
    }

    /// True if an active fault changes the unit's outputs.
    pub fn touch_unit(&self) -> bool {
        self.acting.iter().any(|acting| acting.on_link().is_none())
    }

    /// Events since the last call.
    pub fn take_happened(&mut self) -> Vec<FaultEvent> {
        std::mem::take(&mut self.happened)
    }

    /// Determines the active faults of the next sample interval and returns the actions that ended. `last` is the sample before.
    pub fn begin(
        &mut self,
        now: &mut ConditionInputs,
        last: Option<CompletedSample>,
    ) -> Vec<(FaultAction, Option<Gyro>)> {
        now.active = self.acting.iter().map(|acting| acting.fault.id.clone()).collect();
        let mut over = Vec::new();
        let mut all = Vec::new();
        for planned in &mut self.planned {
            if let Some(ended) = planned.end_if_due(now, self.interval_s) {
                over.push((planned.law, planned.fault.gyro));
                self.happened.push(FaultEvent::Ended(planned.fault.clone(), ended));
            }
            if planned.is_triggered(now, planned.fault.seed.unwrap_or(self.seed)) {
                planned.started += 1;
                let end = planned.fault.samples(self.interval_s).map(|length| now.frame + length);
                planned.running = Some(Running { start: now.frame, end, releasing: None, before: last, carried: 0.0 });
                self.happened.push(FaultEvent::Started(planned.fault.clone()));
            }
            let seed = planned.fault.seed.unwrap_or(self.seed);
            all.extend(planned.acting(now.frame, seed, self.interval_s));
        }
        self.acting = Arc::new(all);
        let planned = &self.planned;
        let started = |id: &str| planned.iter().any(|planned| planned.fault.id == id && planned.started > 0);
        for watch in &mut self.watches {
            if watch.evaluate(now, self.interval_s, started) {
                self.happened.push(FaultEvent::Decided(watch.clone()));
            }
        }
        over
    }

    pub fn verdicts(&self) -> impl Iterator<Item = (&str, ExpectationResult)> {
        self.watches.iter().map(|watch| (watch.expectation.id.as_str(), watch.verdict))
    }

    /// True if a fault changes a parameter of this list and gyro.
    pub fn moves(&self, list: EffectList, gyro: Option<Gyro>) -> bool {
        self.offsets(list, gyro).next().is_some()
    }

    /// Adds to the effects what the faults add over the running sample interval; limits stay what they are. What is on or off,
    /// or names a gyro, is set; the last fault counts. What was without limit is what the fault adds.
    pub fn moved<E: Effects>(&self, mut effects: E, list: EffectList, gyro: Option<Gyro>) -> E {
        for (target, value) in self.offsets(list, gyro) {
            let numbers = effects.numbers_mut(target.effect);
            let spec = &numbers.specs()[target.number];
            let (min, max) = self.widening.limits(spec, spec.min, spec.max);
            let number = numbers.value_mut(target.number);
            let before = if target.is_switch() || !number.is_finite() { 0.0 } else { *number };
            *number = (before + value).clamp(min, max);
        }
        effects
    }

    fn offsets(&self, list: EffectList, gyro: Option<Gyro>) -> impl Iterator<Item = (ParameterRef, f64)> {
        let own = self.acting.iter().filter(move |acting| acting.fault.gyro == gyro);
        own.filter_map(move |acting| match acting.law {
            FaultAction::Parameter { target, size, course } if target.list == list => {
                let start = acting.frame - acting.elapsed;
                let start_s = acting.elapsed as f64 * acting.interval_s;
                let end_s = start_s + acting.interval_s;
                let interval = Interval { start_s, end_s, electronics_excess_k: 0.0, electronics_rate_k_per_h: 0.0 };
                let normal = |sample| acting.draw().at("course", start + sample).standard_normal();
                Some((target, size * acting.share * course.factor(&interval, &normal)))
            }
            _ => None,
        })
    }

    /// Laws on the unit that act over the running sample interval, and since how many.
    pub fn on_unit(&self) -> impl Iterator<Item = (UnitFault, u64)> {
        self.acting.iter().filter_map(|acting| match acting.law {
            FaultAction::Unit(law) => Some((law, acting.elapsed)),
            _ => None,
        })
    }

    /// True if the unit neither sends nor receives.
    pub fn is_silent(&self) -> bool {
        self.acting.iter().any(ActiveFault::silences_unit)
    }

    /// Lets the faults of heads act on the counts of the sample that ends.
    pub fn act_on_counts(&mut self, device: &Device, counts: &mut [f64]) -> FlagOverrides {
        let mut marks = FlagOverrides::default();
        let heads = self.acting.iter().filter_map(|acting| match acting.law {
            FaultAction::Head(law) => Some((law, acting, acting.fault.gyro?)),
            _ => None,
        });
        for (law, acting, gyro) in heads {
            let (count, head) = (&mut counts[gyro.index()], &device.heads[gyro.index()]);
            let (low, high) = device.limits(head);
            let draw = || acting.draw().at("count", acting.frame);
            match law {
                GyroFault::Dead => {
                    *count = 0.0;
                    marks.invalid |= gyro.bit();
                }
                GyroFault::StuckCount { counts } => *count = counts,
                GyroFault::WrongLsb { factor } => {
                    let planned = self.planned.iter_mut().find(|planned| planned.fault.id == acting.fault.id);
                    let Some(running) = planned.and_then(|planned| planned.running.as_mut()) else { continue };
                    running.carried += *count * factor;
                    let rounded = head.rounded(running.carried);
                    running.carried -= rounded;
                    *count = rounded;
                }
                GyroFault::Spike { counts, law } => {
                    let share = match law {
                        SpikeLaw::Constant => 1.0,
                        SpikeLaw::Alternating => [1.0, -1.0][(acting.elapsed % 2) as usize],
                        SpikeLaw::Uniform => 2.0 * draw().uniform() - 1.0,
                        SpikeLaw::Normal => draw().standard_normal(),
                    };
                    *count += head.rounded(counts * share);
                }
                GyroFault::Garbage if device.is_iras() => *count = f64::from(draw().bits() as u16 as i16),
                GyroFault::Garbage => *count = head.rounded(low + (high - low) * draw().uniform()),
                GyroFault::Saturated { is_negative } => {
                    // One beyond what fits, so that clipping flags it.
                    *count = if is_negative { low - 1.0 } else { high + 1.0 };
                }
                GyroFault::SpinDown { coast_s } => {
                    let elapsed_s = acting.elapsed as f64 * acting.interval_s;
                    *count = head.rounded(*count * libm::exp(-elapsed_s / coast_s));
                    marks.invalid |= gyro.bit();
                    marks.coasting |= gyro.bit();
                }
            }
        }
        marks
    }
}

impl FaultStatus {
    fn is_triggered(&self, now: &ConditionInputs, seed: u64) -> bool {
        let fault = &self.fault;
        self.running.is_none()
            && !fault.by_hand
            && self.started < fault.times
            && (fault.at_s..fault.until_s).contains(&now.t_s)
            && fault.when.as_ref().is_none_or(|when| when.holds(now))
            && (fault.probability >= 1.0
                || FaultRng::new(seed, &fault.id).at("trigger", now.frame).uniform() < fault.probability)
    }

    /// Ends it when its time has come: how many samples it acted. A parameter returns first.
    fn end_if_due(&mut self, now: &ConditionInputs, interval_s: f64) -> Option<u64> {
        let fault = &self.fault;
        let running = self.running.as_mut()?;
        let is_due = running.end.is_some_and(|end| now.frame >= end)
            || now.t_s >= fault.until_s
            || fault.end_when.as_ref().is_some_and(|condition| condition.holds(now));
        if fault.release_s > 0.0 {
            if is_due && running.releasing.is_none() {
                running.releasing = Some(now.frame);
            }
            let released = running.releasing.map(|since| (now.frame - since) as f64 * interval_s);
            if released.is_none_or(|released_s| released_s < fault.release_s) {
                return None;
            }
        } else if !is_due {
            return None;
        }
        let ended = now.frame - running.start;
        self.running = None;
        Some(ended)
    }

    fn acting(&self, frame: u64, seed: u64, interval_s: f64) -> Option<ActiveFault> {
        let running = self.running.as_ref()?;
        let middle_s = |since| ((frame - since) as f64 + 0.5) * interval_s;
        let released = running.releasing.map_or(0.0, |since| middle_s(since) / self.fault.release_s);
        Some(ActiveFault {
            fault: self.fault.clone(),
            law: self.law,
            elapsed: frame - running.start,
            frame,
            share: (1.0 - released).max(0.0),
            before: running.before,
            seed,
            interval_s,
        })
    }
}
