//! `[[fault]]` and `[[expect]]`: in a configuration, in a plan of their own, in what is injected live.

use std::sync::Arc;

use geu_protocol::Gyro;

use super::Configuration;
use super::document::{ConfigText, ConfigurationError, Node, Read};
use super::identifiers::{FaultIds, Identifiers};
pub use super::plan::{fault_text, plan_text};
use crate::device::Device;
use crate::fault::catalogue::{CATALOGUE, FaultSpec, Scope, Transport};
use crate::fault::expectation::{Expectation, TimeWindow};
use crate::fault::expression::Expression;
use crate::fault::{EffectList, Fault, FaultKind, ParameterRef};
use crate::parameter_spec::numbers;
use crate::time_profile::{FAULT_PROFILES, TimeProfile};

/// Maximum number of faults, of expectations of a plan, and of armed or active faults of a run.
pub const MAX_FAULTS: usize = 1000;
/// Maximum number of faults of a run, including ended injected ones: all are in its `run.toml`, and are evaluated in every
/// sample.
pub const MAX_RUN_FAULTS: usize = 10_000;
const LATEST_S: f64 = 1e10;

/// Key of a list of faults.
pub(super) const FAULT: &str = "fault";
/// Key of a list of expectations.
pub(super) const EXPECT: &str = "expect";

numbers! {
    /// The numbers that every fault has.
    pub struct FaultNumbers {
        /// not before this on-board time
        at_s: 0.0, 0.0..=LATEST_S, "s";
        /// chance to start in a sample interval in which the rest would let it
        probability: 1.0, 1e-9..=1.0, "";
        /// waits to be started by somebody at the bench
        by_hand: 0.0, 0.0..=1.0, "", Flag;
        /// how long it acts, a sample interval or more; without end where not named
        for_s: absent, 1e-5..=LATEST_S, "s";
        /// ends then at the latest, a parameter returns from then on; starts no more
        until_s: absent, 0.0..=LATEST_S, "s";
        /// a parameter returns over so long at the end
        release_s: 0.0, 0.0..=1e6, "s";
        /// how often it may start
        times: 1.0, 1.0..=1e9, "", Whole;
    }
}

numbers! {
    /// The numbers that an expectation has.
    pub struct ExpectationNumbers {
        /// not before this on-board time
        at_s: 0.0, 0.0..=LATEST_S, "s";
        /// must hold at least once within so long
        within_s: absent, 1e-5..=LATEST_S, "s";
        /// must hold all the time for so long
        throughout_s: absent, 1e-5..=LATEST_S, "s";
    }
}

/// The texts that every fault has, and what they mean.
pub const FAULT_TEXTS: [(&str, &str); 3] = [
    ("id", "its own in the plan; made up where not named"),
    ("when", "a condition before which it does not start"),
    ("end_when", "a condition that ends it"),
];

impl Configuration {
    /// Adds the faults and expectations of a plan, a text with `[[fault]]` and `[[expect]]` and nothing else.
    ///
    /// # Errors
    /// The first thing wrong, with its line; nothing is added then.
    pub fn add_plan(&mut self, name: &str, text: &str) -> Result<(), ConfigurationError> {
        let source = ConfigText::parse(name, text)?.about(&self.device);
        let root = source.root();
        root.only(&[FAULT, EXPECT])?;
        let faults = read_faults(&root, &self.faults, &Transport::ALL, self.run.injected.len())?;
        let all = [&self.faults[..], &faults].concat();
        self.expectations.extend(read_expectations(&root, &self.expectations, &all)?);
        self.faults = all;
        Ok(())
    }
}

/// Reads one fault from a text of its keys alone, for a run of a unit that has `others` and these links.
///
/// # Errors
/// The first thing wrong, with its line.
pub fn read_fault_text(
    device: &Arc<Device>,
    name: &str,
    text: &str,
    others: &[Fault],
    links: &[Transport],
) -> Read<Fault> {
    let source = ConfigText::parse(name, text)?.about(device);
    let root = source.root();
    // What a plan refuses is refused here too: a recording of the run is read as a plan.
    few_enough(&root, others.len() + 1, others.len())?;
    let fault = read_fault(&root, &mut Identifiers::new(FAULT, ids(others), &[]), links)?;
    known_in(&root, &fault, &FaultIds::new(ids(others).chain([fault.id.as_str()])))?;
    Ok(fault)
}

/// Reads the faults of a plan, a text with `[[fault]]` and nothing else, for a run of a unit that has `others` and these links.
///
/// # Errors
/// The first thing wrong, with its line; expectations, which a run has from its start.
pub fn read_plan_text(
    device: &Arc<Device>,
    name: &str,
    text: &str,
    others: &[Fault],
    links: &[Transport],
) -> Read<Vec<Fault>> {
    let source = ConfigText::parse(name, text)?.about(device);
    let root = source.root();
    root.only(&[FAULT, EXPECT])?;
    if let Some(node) = root.tables(EXPECT)?.first() {
        let message = "expected faults alone: expectations stand in the plan of `geu run --faults`".to_owned();
        return Err(node.error("id", message));
    }
    read_faults(&root, others, links, others.len())
}

/// Reads `[[fault]]`; `before` are the existing faults, `links` the transports for a fault without a link. `injected` of
/// them were injected during the run, one after another; the others may wait at once.
pub(super) fn read_faults(root: &Node, before: &[Fault], links: &[Transport], injected: usize) -> Read<Vec<Fault>> {
    let nodes = root.tables(FAULT)?;
    few_enough(root, before.len() + nodes.len(), injected)?;
    let mut identifiers = Identifiers::new(FAULT, ids(before), &nodes);
    let faults = nodes.iter().map(|node| read_fault(node, &mut identifiers, links)).collect::<Read<Vec<Fault>>>()?;
    let known = FaultIds::new(ids(before).chain(ids(&faults)));
    nodes.iter().zip(&faults).try_for_each(|(node, fault)| known_in(node, fault, &known))?;
    Ok(faults)
}

/// Refuses more faults than a run may have, or than may wait at once; before they are read, which takes a while.
fn few_enough(root: &Node, count: usize, injected: usize) -> Read<()> {
    let planned = count.saturating_sub(injected);
    if planned > MAX_FAULTS {
        return Err(root.error(FAULT, format!("expected at most {MAX_FAULTS} faults, got {planned}")));
    }
    if count <= MAX_RUN_FAULTS {
        return Ok(());
    }
    let message =
        format!("expected at most {MAX_RUN_FAULTS} faults in a run, over or not, got {count}; begin another run");
    Err(root.error(FAULT, message))
}

fn ids(faults: &[Fault]) -> impl Iterator<Item = &str> {
    faults.iter().map(|fault| fault.id.as_str())
}

/// Rejects conditions of a fault that refer to an unknown one.
fn known_in(node: &Node, fault: &Fault, known: &FaultIds) -> Read<()> {
    for (key, condition) in [("when", &fault.when), ("end_when", &fault.end_when)] {
        known.check(node, key, condition.iter().flat_map(Expression::faults))?;
    }
    Ok(())
}

fn read_fault(node: &Node, identifiers: &mut Identifiers, links: &[Transport]) -> Read<Fault> {
    let keys = node.keys();
    let has = |key: &str| keys.contains(&key);
    let numbers = FaultNumbers::NUMBERS.iter().map(|number| number.name);
    let common: Vec<&str> = FAULT_TEXTS.iter().map(|(key, _)| *key).chain(numbers).chain(["seed"]).collect();
    if has("parameter") == has("fault") {
        let message = "expected either `parameter` (a number of an effect) or `fault` (one that has a name)".to_owned();
        return Err(node.error(if has("fault") { "fault" } else { "parameter" }, message));
    }
    let (action, gyro, link) = if has("parameter") {
        node.only(&[&["parameter", "course", "gyro"][..], &common].concat())?;
        let target = read_target(node)?;
        let (size, course) = read_course(node, &target)?;
        (
            FaultKind::Parameter { target, size, course },
            read_gyro(node, target.list == EffectList::Unit, &target.gyros(node.device()), &target.name())?,
            None,
        )
    } else {
        let spec = read_spec(node)?;
        let own: &[&str] = match spec.scope {
            Scope::Gyro => &["fault", "gyro"],
            Scope::Unit => &["fault"],
            Scope::Link => &["fault", "link"],
        };
        let numbers: Vec<&str> = spec.numbers.iter().map(|number| number.name).collect();
        node.only(&[own, &numbers, &common].concat())?;
        let values = spec.numbers.iter().map(|number| node.number(number)).collect::<Read<Vec<f64>>>()?;
        let gyro = if spec.scope == Scope::Gyro {
            read_gyro(node, false, &node.device().gyros().collect::<Vec<_>>(), spec.code)?
        } else {
            None
        };
        let link = if spec.scope == Scope::Link { read_link(node, spec)? } else { None };
        verify_unit(node, spec, link)?;
        // A fault that no link supports is rejected with its link.
        let has = |kind: &Transport| node.device().is_iras() || node.device().frames(*kind == Transport::Can).is_some();
        let own: Vec<Transport> = links.iter().copied().filter(has).collect();
        let links = link.as_ref().map_or(&own[..], std::slice::from_ref);
        if let Some((number, expected)) = spec.neutral(&values, gyro).or_else(|| spec.misfit(&values, links)) {
            return Err(node.unexpected(number, &expected));
        }
        (FaultKind::Named { spec, values }, gyro, link)
    };
    let condition = |key: &str| -> Read<Option<Expression>> {
        if !has(key) {
            return Ok(None);
        }
        Expression::about(node.text(key)?, node.device()).map(Some).map_err(|expected| node.unexpected(key, &expected))
    };
    let FaultNumbers { at_s, probability, by_hand, for_s, until_s, release_s, times } = node.numbers()?;
    long_enough(node, "for_s", for_s)?;
    if until_s <= at_s {
        return Err(node.unexpected("until_s", &format!("a time after at_s, which is {at_s},")));
    }
    let can_return = matches!(&action, FaultKind::Parameter { target, .. } if !target.is_switch());
    if release_s > 0.0 && !can_return {
        let expected = "a fault of a parameter that is a quantity, which can return gradually,";
        return Err(node.unexpected("release_s", expected));
    }
    Ok(Fault {
        id: identifiers.read(node)?,
        action,
        gyro,
        link,
        at_s,
        when: condition("when")?,
        probability,
        by_hand: by_hand != 0.0,
        for_s: Some(for_s).filter(|for_s| !for_s.is_nan()),
        end_when: condition("end_when")?,
        until_s: if until_s.is_nan() { f64::INFINITY } else { until_s },
        release_s,
        times: times as u64,
        seed: node.whole_number("seed")?,
    })
}

fn read_target(node: &Node) -> Read<ParameterRef> {
    let name = node.text("parameter")?;
    ParameterRef::from_name(name).ok_or_else(|| {
        let names: Vec<String> = ParameterRef::all().iter().map(ParameterRef::name).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        node.none_of("parameter", &names)
    })
}

fn read_spec(node: &Node) -> Read<&'static FaultSpec> {
    let codes: Vec<&str> = CATALOGUE.iter().map(|spec| spec.code).collect();
    // The name of an effect: what can be moved are its numbers.
    let given = node.text("fault")?;
    let of_effect = |name: &String| name.split_once('.').is_some_and(|(effect, _)| effect == given);
    let numbers: Vec<String> = ParameterRef::all().iter().map(ParameterRef::name).filter(of_effect).collect();
    if !codes.contains(&given) && !numbers.is_empty() {
        let message = format!("{given} is an effect: expected one of its numbers as parameter, {}", numbers.join(", "));
        return Err(node.error("fault", message));
    }
    Ok(FaultSpec::from_name(node.choice("fault", &codes)?).expect("a listed code"))
}

fn read_gyro(node: &Node, is_of_unit: bool, valid: &[Gyro], what: &str) -> Read<Option<Gyro>> {
    if is_of_unit {
        return match node.keys().contains(&"gyro") {
            false => Ok(None),
            true => Err(node.unexpected("gyro", &format!("no gyro for {what}, which is the whole unit's,"))),
        };
    }
    if valid.is_empty() {
        return Err(node.unexpected(
            "parameter",
            &format!("a parameter that this unit has: {what} needs a gyro with an output axis;"),
        ));
    }
    let names: Vec<&str> = valid.iter().map(|gyro| gyro.name()).collect();
    Ok(node.device().gyro(node.choice("gyro", &names)?))
}

fn read_link(node: &Node, spec: &FaultSpec) -> Read<Option<Transport>> {
    let reasons = |kind: Transport| spec.unable_on(kind).map(|reason| format!("{} cannot: {reason}", kind.name()));
    if !node.keys().contains(&"link") {
        if spec.links().is_empty() {
            let all: Vec<String> = Transport::ALL.into_iter().filter_map(reasons).collect();
            return Err(node.unexpected("fault", &format!("a fault that a link can have; {}", all.join("; "))));
        }
        return Ok(None);
    }
    let kind = Transport::from_name(node.choice("link", &Transport::NAMES)?).expect("a listed name");
    match reasons(kind) {
        None => Ok(Some(kind)),
        Some(reason) => Err(node.unexpected("link", &format!("a link that can have {}; {reason};", spec.code))),
    }
}

/// Refuses a time that is shorter than a sample of the unit; NaN is none.
fn long_enough(node: &Node, key: &str, time_s: f64) -> Read<()> {
    let interval_s = node.device().interval_s;
    match time_s < interval_s {
        true => Err(node.unexpected(key, &format!("a sample interval, {interval_s} s, or more"))),
        false => Ok(()),
    }
}

/// Refuses a fault of links that no link of the unit can have.
fn verify_unit(node: &Node, spec: &FaultSpec, link: Option<Transport>) -> Read<()> {
    let kinds = link.map_or_else(|| spec.links(), |link| vec![link]);
    let reasons = kinds.iter().map(|kind| node.device().unable(spec.code, *kind == Transport::Can));
    let reasons: Option<Vec<&str>> = reasons.collect();
    match reasons.as_ref().filter(|_| spec.scope == Scope::Link).and_then(|reasons| reasons.first()) {
        Some(reason) => {
            let key = if link.is_some() { "link" } else { "fault" };
            Err(node.unexpected(key, &format!("what this unit can have: {reason};")))
        }
        None => Ok(()),
    }
}

fn read_course(node: &Node, target: &ParameterRef) -> Read<(f64, TimeProfile)> {
    let kinds: Vec<&str> =
        FAULT_PROFILES.iter().map(|kind| kind.name).filter(|name| !target.is_switch() || *name == "step").collect();
    let course = node.table("course")?.ok_or_else(|| {
        node.error(
            "parameter",
            format!(
                "expected `course` with one of {}, such as {{ step = 1.0 }} in a plan, step=1.0 for geu inject; got none",
                kinds.join(", ")
            ),
        )
    })?;
    let kind = FAULT_PROFILES.iter().find(|kind| kinds.contains(&kind.name) && course.keys().contains(&kind.name));
    let Some(kind) = kind else {
        return Err(node.unexpected("course", &format!("a course with one of {}", kinds.join(", "))));
    };
    let numbers: Vec<&str> = kind.shapes.iter().map(|number| number.name).collect();
    course.only(&[&[kind.name][..], &numbers].concat())?;
    let (min, max) = target.limits_of(node.device());
    let size = course.value(kind.name, target.number().form, min, max)?.expect("a key of the table");
    if size == 0.0 && !target.is_switch() {
        return Err(course.unexpected(kind.name, "a number other than 0, with which nothing changes,"));
    }
    let numbers = kind.shapes.iter().map(|number| course.number(number)).collect::<Read<Vec<f64>>>()?;
    Ok((size, kind.with(&numbers)))
}

/// Reads `[[expect]]` of a run with these faults.
pub(super) fn read_expectations(root: &Node, before: &[Expectation], faults: &[Fault]) -> Read<Vec<Expectation>> {
    let nodes = root.tables(EXPECT)?;
    let count = before.len() + nodes.len();
    if count > MAX_FAULTS {
        return Err(root.error(EXPECT, format!("expected at most {MAX_FAULTS} expectations, got {count}")));
    }
    let known = FaultIds::new(ids(faults));
    let mut identifiers = Identifiers::new(EXPECT, before.iter().map(|expectation| expectation.id.as_str()), &nodes);
    let mut read = Vec::new();
    for node in &nodes {
        let numbers: Vec<&str> = ExpectationNumbers::NUMBERS.iter().map(|number| number.name).collect();
        node.only(&[&["id", "after", "condition"][..], &numbers].concat())?;
        let condition = Expression::about(node.text("condition")?, node.device())
            .map_err(|expected| node.unexpected("condition", &expected))?;
        known.check(node, "condition", condition.faults())?;
        let after = if node.keys().contains(&"after") { Some(node.text("after")?) } else { None };
        known.check(node, "after", after)?;
        let ExpectationNumbers { at_s, within_s, throughout_s } = node.numbers()?;
        long_enough(node, "within_s", within_s)?;
        long_enough(node, "throughout_s", throughout_s)?;
        let window = match (within_s.is_nan(), throughout_s.is_nan()) {
            (false, true) => TimeWindow::Within(within_s),
            (true, false) => TimeWindow::Throughout(throughout_s),
            _ => {
                let message =
                    "expected either `within_s` (must hold at least once) or `throughout_s` (must hold all the time)";
                return Err(node.error("condition", message.to_owned()));
            }
        };
        let id = identifiers.read(node)?;
        read.push(Expectation { id, after: after.map(str::to_owned), at_s, condition, window });
    }
    Ok(read)
}
