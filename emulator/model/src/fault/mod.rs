//! Faults: deviations that a plan or an operator injects into a running unit.
//!
//! A fault changes a parameter of an effect ([`crate::time_profile`]), or is a named fault ([`catalogue`]): of a gyro, of the
//! unit, of a link. It waits for its trigger (a time, an [`expression`], a probability, an operator), acts, and ends;
//! [`engine`] is that clockwork. All is decided at the start of a sample interval, on on-board time, and what is drawn depends
//! on seed, identifier and sample alone: the same plan gives the same bytes.

pub mod catalogue;
pub mod engine;
pub mod expectation;
pub mod expression;

use std::sync::LazyLock;

use geu_protocol::Gyro;

use crate::device::{Device, Head};
use crate::effect::{EffectSpec, Effects, GyroEffects, UnitEffects, WiringEffects};
use crate::noise::NoiseStream;
use crate::parameter_spec::{ParameterSpec, ValueFormat};
use crate::time_profile::{TimeProfile, step_limits};
use catalogue::{FaultAction, FaultSpec, Scope, Transport};
use expectation::Expectation;
use expression::Expression;

/// Limit of an addition to an unlimited number: it must be finite.
const UNLIMITED: f64 = 1e10;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EffectList {
    /// [`UnitEffects`].
    Unit,
    /// [`GyroEffects`].
    Head,
    /// [`WiringEffects`].
    Wiring,
}

/// An effect, its numbers, and whether it is a noise, withholds small motions and needs an output axis.
type Facts = (&'static EffectSpec, &'static [ParameterSpec], [bool; 3]);

/// A number of an effect, which a fault can move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ParameterRef {
    pub list: EffectList,
    /// Index of the effect in its list.
    pub effect: usize,
    /// Index of the number among the effect's.
    pub number: usize,
}

impl ParameterRef {
    pub fn all() -> Vec<ParameterRef> {
        fn from_list<E: Effects>(list: EffectList) -> impl Iterator<Item = ParameterRef> {
            let effects = E::default();
            let counts: Vec<usize> =
                (0..effects.specs().len()).map(|effect| effects.numbers(effect).specs().len()).collect();
            let targets = move |(effect, count)| (0..count).map(move |number| ParameterRef { list, effect, number });
            counts.into_iter().enumerate().flat_map(targets)
        }
        from_list::<UnitEffects>(EffectList::Unit)
            .chain(from_list::<GyroEffects>(EffectList::Head))
            .chain(from_list::<WiringEffects>(EffectList::Wiring))
            .collect()
    }

    /// The number that is called `effect.number`.
    pub fn from_name(name: &str) -> Option<ParameterRef> {
        ParameterRef::all().into_iter().find(|target| target.name() == name)
    }

    pub fn name(&self) -> String {
        format!("{}.{}", self.effect().code, self.number().name)
    }

    pub fn effect(&self) -> &'static EffectSpec {
        self.facts().0
    }

    /// The numbers of its effect.
    pub fn numbers(&self) -> &'static [ParameterSpec] {
        self.facts().1
    }

    /// True if its effect draws random numbers.
    pub fn is_noise(&self) -> bool {
        self.facts().2[0]
    }

    /// True if its effect withholds small motions.
    pub fn filters_motion(&self) -> bool {
        self.facts().2[1]
    }

    /// True if its effect acts on a gyro with an output axis alone.
    pub fn needs_output_axis(&self) -> bool {
        self.facts().2[2]
    }

    /// From a table: [`Effects`] requires values of all effects of a list, which takes longer.
    fn facts(&self) -> Facts {
        fn of_list<E: Effects>() -> Vec<Facts> {
            let all = E::default();
            let facts = |effect: usize| {
                (
                    &all.specs()[effect],
                    all.numbers(effect).specs(),
                    [all.is_noise(effect), all.filters_motion(effect), all.needs_output_axis(effect)],
                )
            };
            (0..all.specs().len()).map(facts).collect()
        }
        static ALL: LazyLock<[Vec<Facts>; 3]> =
            LazyLock::new(|| [of_list::<UnitEffects>(), of_list::<GyroEffects>(), of_list::<WiringEffects>()]);
        ALL[self.list as usize][self.effect]
    }

    pub fn number(&self) -> &'static ParameterSpec {
        &self.numbers()[self.number]
    }

    /// Limits of what a fault may add: from any value to any other that the model is good for, as a step in the
    /// configuration has them.
    pub fn limits(&self) -> (f64, f64) {
        let (min, max) = step_limits(self.number());
        (min.max(-UNLIMITED), max.min(UNLIMITED))
    }

    /// Limits of that for a unit.
    pub fn limits_of(&self, device: &Device) -> (f64, f64) {
        let (min, max) = self.limits();
        device.widening().limits(self.number(), min, max)
    }

    /// Gyros of a unit that have it; empty for a parameter of the unit.
    pub fn gyros(&self, device: &Device) -> Vec<Gyro> {
        let has = |head: &&Head| {
            head.axes.has_number(self.number().name) && (!self.needs_output_axis() || head.axes.output().is_some())
        };
        match self.list {
            EffectList::Unit => Vec::new(),
            _ => device.heads.iter().filter(has).map(|head| head.gyro).collect(),
        }
    }

    /// True for a flag or a gyro's name, which only steps can change.
    pub fn is_switch(&self) -> bool {
        self.number().form != ValueFormat::Real
    }
}

#[derive(Debug, Clone, PartialEq)]
pub enum FaultKind {
    Parameter { target: ParameterRef, size: f64, course: TimeProfile },
    Named { spec: &'static FaultSpec, values: Vec<f64> },
}

impl FaultKind {
    pub fn name(&self) -> String {
        match self {
            FaultKind::Parameter { target, .. } => target.name(),
            FaultKind::Named { spec, .. } => spec.code.to_owned(),
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    pub id: String,
    pub action: FaultKind,
    /// The gyro that it is on.
    pub gyro: Option<Gyro>,
    /// The kind of links that it is on; all where nothing is said.
    pub link: Option<Transport>,
    /// Not before this on-board time.
    pub at_s: f64,
    /// Nor before this holds.
    pub when: Option<Expression>,
    /// Probability of a start in each sample interval that allows it.
    pub probability: f64,
    /// Waits for an operator.
    pub by_hand: bool,
    /// Duration; `None` for no end or the default of a named fault.
    pub for_s: Option<f64>,
    /// Or until this holds.
    pub end_when: Option<Expression>,
    /// And never from this on-board time on.
    pub until_s: f64,
    /// Time over which a parameter returns.
    pub release_s: f64,
    pub times: u64,
    /// Seed of its random numbers; `None` for that of the run.
    pub seed: Option<u64>,
}

impl Fault {
    /// Maximum duration in samples of this length, at least one.
    pub fn samples(&self, interval_s: f64) -> Option<u64> {
        let own = match &self.action {
            FaultKind::Named { spec, .. } => spec.for_s,
            FaultKind::Parameter { .. } => None,
        };
        // Half a sample or more counts as one.
        self.for_s.or(own).map(|for_s| ((for_s / interval_s).round() as u64).max(1))
    }

    /// A hand starts it at this on-board time, or when its own time has come. False where that never comes.
    pub fn start_at(&mut self, at_s: f64) -> bool {
        let at_s = self.at_s.max(at_s);
        let is_in_time = at_s < self.until_s;
        if is_in_time {
            (self.by_hand, self.at_s) = (false, at_s);
        }
        is_in_time
    }

    /// Ends it at this on-board time. A fault that could not have started by then waits for an operator that never comes:
    /// a plan with this fault acts in the same way.
    pub fn end_at(&mut self, until_s: f64) {
        if until_s > self.at_s {
            self.until_s = self.until_s.min(until_s);
        } else {
            self.by_hand = true;
        }
    }

    /// Reason that it can have no effect on these links; `None` if it can, or acts on no link.
    pub fn misses(&self, open: &[Transport]) -> Option<String> {
        let FaultKind::Named { spec, .. } = &self.action else { return None };
        let own = self.link.map_or_else(|| spec.links(), |link| vec![link]);
        if spec.scope != Scope::Link || own.iter().any(|kind| open.contains(kind)) {
            return None;
        }
        let names = |kinds: &[Transport]| kinds.iter().map(|kind| kind.name()).collect::<Vec<_>>().join(", ");
        let (id, code, own, open) = (&self.id, spec.code, names(&own), names(open));
        Some(format!("{id}: expected a link that is open ({open}) for {code}, got {own}"))
    }

    pub fn law(&self) -> FaultAction {
        match &self.action {
            FaultKind::Named { spec, values } => spec.law(values),
            FaultKind::Parameter { target, size, course } => {
                FaultAction::Parameter { target: *target, size: *size, course: *course }
            }
        }
    }

    pub fn trigger(&self) -> String {
        let mut parts = Vec::new();
        if self.by_hand {
            parts.push("by hand".to_owned());
        }
        if self.at_s > 0.0 || self.when.is_none() {
            parts.push(format!("t_s >= {:?}", self.at_s));
        }
        parts.extend(self.when.as_ref().map(Expression::to_string));
        if self.probability < 1.0 {
            parts.push(format!("probability {:?}", self.probability));
        }
        parts.join(", ")
    }
}

/// The message for the first condition that can never hold because `source` lacks a variable or function that it uses.
/// `unavailable` are the names that it lacks.
pub fn unsatisfiable_condition(
    faults: &[Fault],
    expectations: &[Expectation],
    source: &str,
    unavailable: &[&'static str],
) -> Option<String> {
    let of_faults = faults.iter().flat_map(|fault| {
        let conditions = [("when", &fault.when), ("end_when", &fault.end_when)];
        conditions.map(|(key, condition)| (&fault.id, key, condition.as_ref()))
    });
    let expected = expectations.iter().map(|one| (&one.id, "condition", Some(&one.condition)));
    of_faults.chain(expected).find_map(|(id, key, condition)| {
        let name = condition?.asks_about().into_iter().find(|name| unavailable.contains(name))?;
        let unavailable = unavailable.join(", ");
        Some(format!("{id}, {key}: {name} is not available from {source}; expected a condition without {unavailable}"))
    })
}

/// Source of the random numbers of one fault.
#[derive(Debug, Clone, Copy)]
pub struct FaultRng<'a> {
    seed: u64,
    id: &'a str,
}

impl<'a> FaultRng<'a> {
    pub fn new(seed: u64, id: &'a str) -> FaultRng<'a> {
        FaultRng { seed, id }
    }

    /// A stream for one purpose at one time.
    pub fn at(&self, what: &str, time: u64) -> NoiseStream {
        NoiseStream::of_fault(self.seed, self.id, what, time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_of_every_effect_can_be_named() {
        let all = ParameterRef::all();
        assert!(all.len() > 20);
        for target in &all {
            assert_eq!(ParameterRef::from_name(&target.name()), Some(*target));
        }
        assert_eq!(
            ParameterRef::from_name("pivot-clearance.clearance_arcsec").expect("there").gyros(&Device::iras()),
            Gyro::ALL
        );
        assert_eq!(
            ParameterRef::from_name("misalignment.x_arcsec").expect("there").gyros(&Device::iras()),
            [Gyro::Y, Gyro::ZA, Gyro::ZB]
        );
        assert!(ParameterRef::from_name("clock-frequency.ppm").expect("there").gyros(&Device::iras()).is_empty());
    }

    #[test]
    fn the_parameters_of_named_faults_are_there() {
        for spec in catalogue::CATALOGUE.iter().filter(|spec| spec.scope != catalogue::Scope::Link) {
            let values: Vec<f64> = spec.numbers.iter().map(|number| number.max).collect();
            if let catalogue::FaultAction::Parameter { target, size, .. } = spec.law(&values) {
                let (min, max) = target.limits();
                assert!((min..=max).contains(&size), "{}", spec.code);
            }
        }
    }
}
