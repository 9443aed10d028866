//! The configuration of a run, read from TOML (cli.md): strict, complete, and describing itself.
//!
//! What a file does not name has its neutral value: scale factor 1, no drift, no effect, electronics at 20 °C, a hold at
//! θ = 90°. The reference unit on its default scenario is `configs/reference.toml`, which is built in.

mod document;
pub mod fault;
mod identifiers;
mod schema;
mod show;

use std::collections::HashSet;

pub use document::{ConfigText, ConfigurationError, Node};
use geu_protocol::hex::read_hex;
use geu_protocol::{CanIdMap, Gyro};

use crate::attitude::{AttitudeProfile, LimitCycle, Manoeuvre, Scenario, TruthNumbers};
use crate::course::{KINDS, TimeCourse, TimeFunctionSpec};
use crate::effect::discovered::{self, Formula, Term};
use crate::effect::{
    CALIBRATION_COLUMN, DISCOVERED_COLUMN, EffectConfiguration, EffectSpec, Effects, FAULT_COLUMN, GyroEffects,
    HEAD_COLUMNS, POWER_COLUMN, SATURATION_COLUMN, SELF_TEST_COLUMN, UNIT_COLUMNS, UnitEffects, WIRING_COLUMNS,
    WiringEffects,
};
use crate::fault::catalogue::{FaultAction, Transport};
use crate::fault::expectation::Expectation;
use crate::fault::{EffectList, Fault};
use crate::number::{DefaultValue, ParameterSpec, ValueFormat, number};
use crate::package::{Axes, Calibration};
use crate::sensor::SensorNumbers;
use crate::temperature::{Electronics, ElectronicsCourse};

/// The reference unit on its default scenario.
const REFERENCE: &str = include_str!("../../../../configs/reference.toml");

/// One gyro's part of a configuration.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GyroConfiguration {
    pub calibration: Calibration,
    pub effects: EffectConfiguration<GyroEffects>,
    /// The effect whose terms are data.
    pub discovered: Vec<Term>,
    pub wiring: EffectConfiguration<WiringEffects>,
}

/// A command of a recorded run.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedCommand {
    /// Index, from 0, of the sample in which it acted.
    pub sample: u64,
    pub link: String,
    pub payload: Vec<u8>,
}

/// Which form of the link a recording has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LinkLogFormat {
    /// `link.log`, as `candump -l` writes.
    #[default]
    Can,
    Serial,
}

impl LinkLogFormat {
    /// Names in configuration and command line, in order.
    pub const NAMES: [&str; 2] = ["can", "serial"];

    pub fn named(name: &str) -> Option<LinkLogFormat> {
        [LinkLogFormat::Can, LinkLogFormat::Serial]
            .into_iter()
            .zip(LinkLogFormat::NAMES)
            .find(|(_, own)| *own == name)
            .map(|(form, _)| form)
    }

    pub fn name(self) -> &'static str {
        LinkLogFormat::NAMES[self as usize]
    }
}

/// Where a recording ended before its run, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct EndedEarly {
    pub sample: u64,
    pub reason: String,
}

/// What a recorded run had beside its configuration, so that it can be made again.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RunRecord {
    /// How long it ran; 0 where it is not said.
    pub duration_s: f64,
    pub wire: Option<LinkLogFormat>,
    /// Kinds of the links that were open: whom a fault was on.
    pub links: Vec<Transport>,
    /// Rate of the serial port that was open, where it was not the default: a fault can be of another.
    pub serial_baud: Option<u32>,
    /// Base identifier of CAN, where it was not the default.
    pub can_base: Option<u16>,
    /// The recording has no end yet: duration and commands stand in the files beside it.
    pub is_unfinished: bool,
    /// The recording ended before the run.
    pub ended_early: Option<EndedEarly>,
    /// The truth, a file or a simulator's address, as it was given; without one the scenario is flown.
    pub truth: Option<String>,
    /// Faults that were injected while it ran: its truth has one column for what effects add that are there by these
    /// alone.
    pub injected: Vec<String>,
    pub commands: Vec<RecordedCommand>,
}

impl RunRecord {
    /// Kinds of the links that a fault may be on which names none: those that were open, and the recorded one; any where
    /// that is not known.
    fn told_links(&self) -> Vec<Transport> {
        let recorded = match self.wire {
            Some(LinkLogFormat::Serial) => Transport::Pty,
            Some(LinkLogFormat::Can) | None => Transport::Can,
        };
        match &self.links[..] {
            [] => Transport::ALL.to_vec(),
            links => [links, &[recorded]].concat(),
        }
    }
}

/// A configuration that can be run: every number within its limits, the scenario possible.
#[derive(Debug, Clone, PartialEq)]
pub struct Configuration {
    pub seed: u64,
    /// Time at the start of the first sample interval, Unix time, ns.
    pub start_unix_ns: i64,
    pub unit: EffectConfiguration<UnitEffects>,
    pub electronics: ElectronicsCourse,
    /// The gyros in wire order.
    pub gyros: [GyroConfiguration; 4],
    pub sensors: SensorNumbers,
    pub scenario: Scenario,
    /// How a truth from a simulator is followed in its place.
    pub truth: TruthNumbers,
    pub faults: Vec<Fault>,
    /// What must be done about it.
    pub expectations: Vec<Expectation>,
    pub run: RunRecord,
}

const START: ParameterSpec = number(
    "start_unix_s",
    ValueFormat::Real,
    DefaultValue::Value(0.0),
    0.0,
    4e9,
    "time at the start of the first sample interval, Unix time",
);
const THETA: ParameterSpec =
    number("theta_deg", ValueFormat::Real, DefaultValue::Value(90.0), 60.0, 120.0, "solar aspect angle at the start");
const PSI: ParameterSpec = number(
    "psi_deg",
    ValueFormat::Real,
    DefaultValue::Value(0.0),
    -360.0,
    360.0,
    "angle about the sun vector at the start",
);
const DURATION: ParameterSpec =
    number("duration_s", ValueFormat::Real, DefaultValue::Value(0.0), 0.0, 1e10, "how long it ran");
const SERIAL_BAUD: ParameterSpec = number(
    "serial_baud",
    ValueFormat::Whole,
    DefaultValue::Absent,
    1.0,
    1e8,
    "rate of the serial port that was open; the default one where not named",
);
const CAN_BASE: ParameterSpec = number(
    "can_base",
    ValueFormat::Whole,
    DefaultValue::Absent,
    0.0,
    CanIdMap::MAX_BASE as f64,
    "base identifier of CAN; the default one where not named",
);
const UNFINISHED: &str = "unfinished";
const ENDED_EARLY: &str = "ended_early";

/// Table of [`TruthNumbers`].
const TRUTH: &str = "truth";
const TOP: [&str; 12] = [
    "seed",
    "start_unix_s",
    "unit",
    "temperature",
    "gyro",
    "sensors",
    "scenario",
    "manoeuvre",
    TRUTH,
    fault::FAULT,
    fault::EXPECT,
    "run",
];

impl Configuration {
    /// Reads a configuration; `name` is what errors call it. Each override is `PATH=VALUE`.
    ///
    /// # Errors
    /// The first thing wrong, with its line: not TOML, an unknown key, a number out of its limits, an impossible
    /// manoeuvre.
    pub fn parse(name: &str, text: &str, overrides: &[String]) -> Result<Configuration, ConfigurationError> {
        let configuration = Configuration::read(&ConfigText::parse(name, text)?.root())?;
        if overrides.is_empty() {
            return Ok(configuration);
        }
        let text = document::with_overrides(name, text, overrides)?;
        Configuration::read(&ConfigText::parse(&format!("{name} with --set"), &text)?.root())
    }

    /// The text of a configuration with values put in, each `PATH=VALUE`; comments and order stay.
    ///
    /// # Errors
    /// Text that is not TOML, a value that cannot be put in.
    pub fn edited(name: &str, text: &str, values: &[String]) -> Result<String, ConfigurationError> {
        document::with_overrides(name, text, values)
    }

    /// The text of a configuration with comments put behind values, each a path and the comment.
    pub fn commented(text: &str, comments: &[(String, String)]) -> String {
        document::with_comments(text, comments)
    }

    /// The reference unit on its default scenario (model.md).
    pub fn reference() -> Configuration {
        Configuration::reference_with(&[]).expect("the built-in configuration is valid")
    }

    /// The reference unit with overrides, each `PATH=VALUE`.
    ///
    /// # Errors
    /// As [`Configuration::parse`].
    pub fn reference_with(overrides: &[String]) -> Result<Configuration, ConfigurationError> {
        Configuration::parse("configs/reference.toml (built in)", REFERENCE, overrides)
    }

    /// The text of the built-in configuration, with its comments.
    pub const fn reference_text() -> &'static str {
        REFERENCE
    }

    /// The same unit without the effects that draw random numbers.
    pub fn without_noise(&self) -> Configuration {
        let mut configuration = self.clone();
        configuration.unit = configuration.unit.without_noise();
        for gyro in &mut configuration.gyros {
            gyro.effects = std::mem::take(&mut gyro.effects).without_noise();
        }
        configuration
    }

    /// Columns of a trace that it can fill, in order: the calibration, the effects that are present, self-test, power,
    /// saturation.
    pub fn columns(&self) -> Vec<usize> {
        let gyros = &self.gyros;
        let injected = &self.run.injected;
        // Both may be long.
        let live: HashSet<&String> = injected.iter().collect();
        let planned = self.faults.iter().filter(|fault| !live.contains(&fault.id));
        let mut moved: Vec<usize> = planned.filter_map(fault_column).collect();
        moved.extend((!injected.is_empty()).then_some(FAULT_COLUMN));
        let unit = (0..UnitEffects::SPECS.len()).filter(|&index| self.unit.has(index));
        let discovered = gyros.iter().any(|gyro| discovered::is_present(&gyro.discovered));
        let head = (0..GyroEffects::SPECS.len()).filter(|&index| gyros.iter().any(|gyro| gyro.effects.has(index)));
        let wiring = (0..WiringEffects::SPECS.len()).filter(|&index| gyros.iter().any(|gyro| gyro.wiring.has(index)));
        let mut columns: Vec<usize> = std::iter::once(CALIBRATION_COLUMN)
            .chain(unit.map(|index| UNIT_COLUMNS + index))
            .chain(discovered.then_some(DISCOVERED_COLUMN))
            .chain(head.map(|index| HEAD_COLUMNS + index))
            .chain(wiring.map(|index| WIRING_COLUMNS + index))
            .chain([SELF_TEST_COLUMN, POWER_COLUMN, SATURATION_COLUMN])
            .collect();
        columns.append(&mut moved);
        columns.sort_unstable();
        columns.dedup();
        columns
    }

    fn read(root: &Node) -> Result<Configuration, ConfigurationError> {
        root.only(&TOP)?;
        let unit = match root.table("unit")? {
            Some(node) => {
                known_effects(&node, &[], &[UnitEffects::SPECS])?;
                read_effects(&node, |_| true)?
            }
            None => EffectConfiguration::default(),
        };
        let mut gyros: [GyroConfiguration; 4] = Default::default();
        if let Some(node) = root.table("gyro")? {
            node.only(&Gyro::ALL.map(Gyro::name))?;
            for gyro in Gyro::ALL {
                if let Some(node) = node.table(gyro.name())? {
                    gyros[gyro as usize] = read_gyro(&node, Axes::of(gyro))?;
                }
            }
        }
        let start_unix_s = root.number(&START)?;
        let run = read_run(root)?;
        let faults = fault::read_faults(root, &[], &run.told_links(), run.injected.len())?;
        Ok(Configuration {
            seed: root.whole_number("seed")?.unwrap_or(1),
            start_unix_ns: unix_ns(start_unix_s),
            unit,
            electronics: read_electronics(root)?,
            gyros,
            sensors: read_sensors(root)?,
            scenario: read_scenario(root)?,
            truth: read_truth(root)?,
            expectations: fault::read_expectations(root, &[], &faults)?,
            faults,
            run,
        })
    }
}

/// The column of a trace that a fault fills.
fn fault_column(fault: &Fault) -> Option<usize> {
    match fault.law() {
        FaultAction::Parameter { target, .. } => Some(match target.list {
            EffectList::Unit => UNIT_COLUMNS + target.effect,
            EffectList::Head => HEAD_COLUMNS + target.effect,
            EffectList::Wiring => WIRING_COLUMNS + target.effect,
        }),
        FaultAction::Head(_) => Some(FAULT_COLUMN),
        FaultAction::Unit(_) | FaultAction::Link(_) => None,
    }
}

/// Unix time in whole microseconds, the grain of a capture's time stamps, as ns.
pub fn unix_ns(unix_s: f64) -> i64 {
    (unix_s * 1e6).round() as i64 * 1000
}

fn read_gyro(node: &Node, axes: &Axes) -> Result<GyroConfiguration, ConfigurationError> {
    let has = |name: &str| axes.has_number(name);
    let mut calibration = Calibration::default();
    if let Some(node) = node.table("calibration")? {
        node.fill(&mut calibration, has, &[])?;
    }
    known_effects(node, &["calibration", discovered::CODE], &[GyroEffects::SPECS, WiringEffects::SPECS])?;
    Ok(GyroConfiguration {
        calibration,
        effects: read_effects(node, has)?,
        discovered: read_discovered(node)?,
        wiring: read_effects(node, has)?,
    })
}

fn read_discovered(node: &Node) -> Result<Vec<Term>, ConfigurationError> {
    let terms = node.tables(discovered::CODE)?;
    if terms.len() > discovered::MOST_TERMS {
        let (path, most) = (node.path_of(discovered::CODE), discovered::MOST_TERMS);
        return Err(
            node.error(discovered::CODE, format!("expected at most {most} terms in `{path}`, got {}", terms.len()))
        );
    }
    let read = |node: &Node| {
        node.only(&["formula", discovered::COEFFICIENT.name])?;
        let formula: Result<Formula, _> = node.text("formula")?.parse();
        Ok(Term {
            formula: formula.map_err(|error| node.unexpected("formula", &error.expected))?,
            coefficient: node.number(&discovered::COEFFICIENT)?,
        })
    };
    terms.iter().map(read).collect()
}

/// The effect that a key names, and the kind of its course where it has a suffix.
fn named_effect(key: &str, specs: &[EffectSpec]) -> Option<(usize, Option<&'static TimeFunctionSpec>)> {
    let index = |code: &str| specs.iter().position(|spec| spec.code == code);
    index(key)
        .map(|effect| (effect, None))
        .or_else(|| KINDS.iter().find_map(|kind| Some((index(key.strip_suffix(kind.suffix)?)?, Some(kind)))))
}

/// Refuses keys that are neither `others` nor effects of the lists.
fn known_effects(node: &Node, others: &[&str], lists: &[&[EffectSpec]]) -> Result<(), ConfigurationError> {
    let unknown = node
        .keys()
        .into_iter()
        .find(|key| !others.contains(key) && lists.iter().all(|specs| named_effect(key, specs).is_none()));
    let Some(key) = unknown else { return Ok(()) };
    let codes = lists.iter().flat_map(|specs| specs.iter().map(|spec| spec.code));
    let valid: Vec<&str> = others.iter().copied().chain(codes).collect();
    let suffixes: Vec<&str> = KINDS.iter().map(|kind| kind.suffix).collect();
    let mut error = node.unknown(key, &valid);
    error.message += &format!("; an effect may have {} behind it", suffixes.join(", "));
    Err(error)
}

/// Reads the effects of a list: `code = { … }`, and `code-suffix = { … }` for courses.
fn read_effects<E: Effects>(
    node: &Node,
    has: impl Fn(&str) -> bool,
) -> Result<EffectConfiguration<E>, ConfigurationError> {
    let mut configured = EffectConfiguration::<E>::default();
    let specs = configured.constant.specs();
    for key in node.keys() {
        let Some((effect, kind)) = named_effect(key, specs) else { continue };
        let table = node.table(key)?.expect("the key is there");
        let Some(kind) = kind else {
            table.fill(configured.constant.numbers_mut(effect), &has, &[])?;
            continue;
        };
        let (spec, numbers) = (&specs[effect], configured.constant.numbers(effect).specs());
        let sizes: Vec<_> = (0..spec.amplitudes.len())
            .filter(|&amplitude| has(numbers[amplitude].name))
            .filter_map(|amplitude| Some((amplitude, kind.size(spec, numbers, amplitude)?)))
            .collect();
        let valid: Vec<&str> = sizes
            .iter()
            .map(|(_, size)| size.name.as_str())
            .chain(kind.shapes.iter().map(|shape| shape.name))
            .collect();
        table.only(&valid)?;
        let shapes = kind.shapes.iter().map(|shape| table.number(shape)).collect::<Result<Vec<f64>, _>>()?;
        for (amplitude, size) in &sizes {
            let value = table.value(&size.name, size.form, size.least, size.greatest)?.unwrap_or(0.0);
            if value != 0.0 {
                configured.courses.push(TimeCourse {
                    effect,
                    amplitude: *amplitude,
                    size: value,
                    law: kind.law(&shapes),
                });
            }
        }
    }
    let largest = configured.largest();
    for key in node.keys() {
        let Some((effect, None)) = named_effect(key, specs) else { continue };
        if let Some((number, expected)) = largest.consistency_error(effect) {
            return Err(node.table(key)?.expect("the key is there").unexpected(number, &expected));
        }
    }
    Ok(configured)
}

fn read_electronics(root: &Node) -> Result<ElectronicsCourse, ConfigurationError> {
    let mut course = ElectronicsCourse::default();
    let Some(node) = root.table("temperature")? else { return Ok(course) };
    node.only(&["electronics", "electronics_table"])?;
    if let Some(node) = node.table("electronics")? {
        node.fill(&mut course.numbers, |_| true, &[])?;
    }
    course.table = node.pairs("electronics_table")?;
    let ParameterSpec { least, greatest, .. } = Electronics::NUMBERS[0];
    if let Some((_, celsius)) = course.table.iter().find(|(_, celsius)| !(least..=greatest).contains(celsius)) {
        let expected = ValueFormat::Real.limits(least, greatest);
        return Err(
            node.error("electronics_table", format!("expected {expected} °C for each temperature, got {celsius}"))
        );
    }
    if !course.table.is_sorted_by(|a, b| a.0 < b.0) {
        return Err(
            node.error("electronics_table", "expected the table's times to rise from point to point".to_owned())
        );
    }
    Ok(course)
}

fn read_sensors(root: &Node) -> Result<SensorNumbers, ConfigurationError> {
    let mut sensors = SensorNumbers::default();
    let Some(node) = root.table("sensors")? else { return Ok(sensors) };
    node.only(&SensorNumbers::KEYS.map(|(key, _)| key))?;
    for (index, (key, _)) in SensorNumbers::KEYS.into_iter().enumerate() {
        if let Some(node) = node.table(key)? {
            node.fill(sensors.numbers_mut(index), |_| true, &[])?;
        }
    }
    Ok(sensors)
}

fn read_scenario(root: &Node) -> Result<Scenario, ConfigurationError> {
    let mut scenario = Scenario {
        theta_deg: THETA.default.initial(),
        psi_deg: PSI.default.initial(),
        limit_cycle: LimitCycle::default(),
        manoeuvres: Vec::new(),
    };
    if let Some(node) = root.table("scenario")? {
        node.only(&[THETA.name, PSI.name, "limit_cycle"])?;
        scenario.theta_deg = node.number(&THETA)?;
        scenario.psi_deg = node.number(&PSI)?;
        if let Some(node) = node.table("limit_cycle")? {
            node.fill(&mut scenario.limit_cycle, |_| true, &[])?;
        }
    }
    let nodes = root.tables("manoeuvre")?;
    for node in &nodes {
        let kinds: Vec<&str> = Manoeuvre::KINDS.iter().map(|kind| kind.0).collect();
        let mut manoeuvre = Manoeuvre::of_kind(node.choice("kind", &kinds)?).expect("one of the kinds");
        node.fill(manoeuvre.numbers_mut(), |_| true, &["kind"])?;
        scenario.manoeuvres.push(manoeuvre);
    }
    AttitudeProfile::new(&scenario).map_err(|impossible| {
        let message = format!("impossible manoeuvre {}: {}", impossible.index + 1, impossible.reason);
        nodes[impossible.index].error(impossible.field, message)
    })?;
    Ok(scenario)
}

fn read_truth(root: &Node) -> Result<TruthNumbers, ConfigurationError> {
    let mut truth = TruthNumbers::default();
    if let Some(node) = root.table(TRUTH)? {
        node.fill(&mut truth, |_| true, &[])?;
    }
    Ok(truth)
}

fn read_run(root: &Node) -> Result<RunRecord, ConfigurationError> {
    let mut run = RunRecord::default();
    let Some(node) = root.table("run")? else { return Ok(run) };
    node.only(&[
        DURATION.name,
        UNFINISHED,
        ENDED_EARLY,
        "wire",
        "links",
        SERIAL_BAUD.name,
        CAN_BASE.name,
        "truth",
        "injected",
        "command",
    ])?;
    run.duration_s = node.number(&DURATION)?;
    if node.keys().contains(&"wire") {
        run.wire = LinkLogFormat::named(node.choice("wire", &LinkLogFormat::NAMES)?);
    }
    run.links = node.choices("links", &Transport::NAMES)?.into_iter().filter_map(Transport::named).collect();
    run.serial_baud = Some(node.number(&SERIAL_BAUD)?).filter(|baud| !baud.is_nan()).map(|baud| baud as u32);
    run.can_base = Some(node.number(&CAN_BASE)?).filter(|base| !base.is_nan()).map(|base| base as u16);
    run.is_unfinished = node.value(UNFINISHED, ValueFormat::Flag, 0.0, 1.0)?.is_some_and(|flag| flag != 0.0);
    if let Some(node) = node.table(ENDED_EARLY)? {
        node.only(&["half_second", "reason"])?;
        run.ended_early = Some(EndedEarly { sample: read_sample(&node)?, reason: node.text("reason")?.to_owned() });
    }
    if node.keys().contains(&"truth") {
        run.truth = Some(node.text("truth")?.to_owned());
    }
    run.injected = node.texts("injected")?.into_iter().map(str::to_owned).collect();
    for node in node.tables("command")? {
        node.only(&["half_second", "link", "bytes"])?;
        let sample = read_sample(&node)?;
        let payload = read_hex(node.text("bytes")?)
            .ok_or_else(|| node.error("bytes", "expected pairs of hexadecimal digits for `bytes`".to_owned()))?;
        run.commands.push(RecordedCommand { sample, link: node.text("link")?.to_owned(), payload });
    }
    Ok(run)
}

fn read_sample(node: &Node) -> Result<u64, ConfigurationError> {
    node.whole_number("half_second")?
        .ok_or_else(|| node.error("half_second", "expected `half_second`, got none".to_owned()))
}
