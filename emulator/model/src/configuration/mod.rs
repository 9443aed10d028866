//! The configuration of a run, read from TOML: strict, complete, and describing itself.
//!
//! What a file does not name has its neutral value: scale factor 1, no drift, no effect, electronics at 20 °C, a hold at
//! θ = 90°. The reference unit on its default scenario is `configs/reference.toml`, which is built in.

mod document;
mod edit;
mod effects;
pub mod fault;
mod identifiers;
mod plan;
mod run;
mod scenario;
mod schema;
mod tree;
mod unit;

use std::collections::HashSet;
use std::sync::Arc;

pub use document::{ConfigText, ConfigurationError, Node};
pub use run::{EndedEarly, LinkLogFormat, RecordedCommand, RunRecord};
use tree::{PSI, THETA};

use crate::attitude::{LimitCycle, RateSegment, Scenario, TruthNumbers};
use crate::device::Device;
use crate::effect::discovered::{self, Term};
use crate::effect::{
    CALIBRATION_COLUMN, DISCOVERED_COLUMN, EffectConfiguration, FAULT_COLUMN, GyroEffects, HEAD_COLUMNS, POWER_COLUMN,
    SATURATION_COLUMN, SELF_TEST_COLUMN, UNIT_COLUMNS, UnitEffects, WIRING_COLUMNS, WiringEffects,
};
use crate::fault::catalogue::FaultAction;
use crate::fault::expectation::Expectation;
use crate::fault::{EffectList, Fault};
use crate::package::Calibration;
use crate::sensor::SensorNumbers;
use crate::temperature::ElectronicsCourse;

/// The reference unit on its default scenario.
const REFERENCE: &str = include_str!("../../../../configs/reference.toml");

/// One gyro's part of a configuration.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GyroConfiguration {
    pub calibration: Calibration,
    pub effects: EffectConfiguration<GyroEffects>,
    /// Terms of the discovered effect.
    pub discovered: Vec<Term>,
    pub wiring: EffectConfiguration<WiringEffects>,
}

/// A configuration that can be run: every number within its limits, the scenario possible.
#[derive(Debug, Clone, PartialEq)]
pub struct Configuration {
    /// The unit.
    pub device: Arc<Device>,
    pub seed: u64,
    /// Time at the start of the first sample interval, Unix time, ns.
    pub start_unix_ns: i64,
    pub unit: EffectConfiguration<UnitEffects>,
    pub electronics: ElectronicsCourse,
    /// The gyros, as the unit has them.
    pub gyros: Vec<GyroConfiguration>,
    pub sensors: SensorNumbers,
    pub scenario: Scenario,
    /// Prescribed rates, which replace the scenario.
    pub motion: Vec<RateSegment>,
    /// Parameters of an external truth, which replaces the scenario.
    pub truth: TruthNumbers,
    pub faults: Vec<Fault>,
    pub expectations: Vec<Expectation>,
    pub run: RunRecord,
}

impl Configuration {
    /// Reads a configuration; `name` is what errors call it. Each override is `PATH=VALUE`.
    ///
    /// # Errors
    /// The first thing wrong, with its line: not TOML, an unknown key, a number out of its limits, an impossible
    /// manoeuvre.
    pub fn parse(name: &str, text: &str, overrides: &[String]) -> Result<Configuration, ConfigurationError> {
        Configuration::parse_for(None, name, text, overrides)
    }

    /// Reads a configuration of this unit, if there is one, else of the unit that it names.
    ///
    /// # Errors
    /// A text that [`Configuration::parse`] refuses; a configuration of another unit.
    pub fn parse_for(
        device: Option<&Arc<Device>>,
        name: &str,
        text: &str,
        overrides: &[String],
    ) -> Result<Configuration, ConfigurationError> {
        let configuration = Configuration::read(ConfigText::parse(name, text)?, device)?;
        if overrides.is_empty() {
            return Ok(configuration);
        }
        let text = Configuration::edited(name, text, overrides)?;
        Configuration::read(ConfigText::parse(&format!("{name} with --set"), &text)?, device)
    }

    /// A unit without errors, at rest, with overrides, each `PATH=VALUE`.
    ///
    /// # Errors
    /// An override that is not valid.
    pub fn of_device(device: &Arc<Device>, overrides: &[String]) -> Result<Configuration, ConfigurationError> {
        Configuration::parse_for(Some(device), &format!("configuration of {}", device.name), "", overrides)
    }

    /// The reference unit on its default scenario.
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

    /// True if prescribed rates move the unit; a described unit without manoeuvres rests.
    pub fn is_of_rates(&self) -> bool {
        !self.motion.is_empty() || !self.device.is_iras() && self.scenario.manoeuvres.is_empty()
    }

    /// Calibrations of the default unit.
    pub fn calibrations(&self) -> [Calibration; 4] {
        std::array::from_fn(|gyro| self.gyros[gyro].calibration)
    }

    /// Removes the effects that draw random numbers.
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

    /// The configuration as TOML that reads back the same. `complete` adds what is absent as comments: every effect with
    /// its default, limits and source, and every kind of manoeuvre.
    pub fn to_toml(&self, complete: bool) -> String {
        let mut text = String::new();
        tree::show(&self.clone().tree(), "", complete, &mut text);
        text
    }

    /// The JSON schema (2020-12) of configurations of a unit.
    pub fn schema(device: Arc<Device>) -> serde_json::Value {
        let known = device.known_name().map(|name| format!(":{name}")).unwrap_or_default();
        let mut schema = tree::schema(&Configuration::neutral(device).tree());
        schema["$schema"] = "https://json-schema.org/draft/2020-12/schema".into();
        schema["$id"] = format!("urn:geu:configuration:{}{known}", env!("CARGO_PKG_VERSION")).into();
        schema["title"] = "GEU configuration".into();
        schema
    }

    /// The configuration of an empty file.
    fn neutral(device: Arc<Device>) -> Configuration {
        let widening = device.widening();
        let mut gyro = GyroConfiguration::default();
        (gyro.effects.widening, gyro.wiring.widening) = (widening, widening);
        Configuration {
            gyros: vec![gyro; device.heads.len()],
            device,
            seed: 1,
            start_unix_ns: 0,
            unit: EffectConfiguration { widening, ..EffectConfiguration::default() },
            electronics: ElectronicsCourse::default(),
            sensors: SensorNumbers::default(),
            scenario: Scenario {
                theta_deg: THETA.default.initial(),
                psi_deg: PSI.default.initial(),
                limit_cycle: LimitCycle::default(),
                manoeuvres: Vec::new(),
            },
            motion: Vec::new(),
            truth: TruthNumbers::default(),
            faults: Vec::new(),
            expectations: Vec::new(),
            run: RunRecord::default(),
        }
    }

    fn read(text: ConfigText, device: Option<&Arc<Device>>) -> Result<Configuration, ConfigurationError> {
        let device = unit::read(&text.root(), device)?;
        let text = text.about(&device);
        let root = &text.root();
        let mut configuration = Configuration::neutral(device);
        tree::read(&mut configuration.tree(), root)?;
        scenario::verify(root, &configuration.scenario)?;
        if !configuration.motion.is_empty() && !configuration.scenario.manoeuvres.is_empty() {
            return Err(root.error("motion", "expected either [[motion]] or [[manoeuvre]], got both".to_owned()));
        }
        let run = &configuration.run;
        configuration.faults = fault::read_faults(root, &[], &run.fault_links(), run.injected.len())?;
        configuration.expectations = fault::read_expectations(root, &[], &configuration.faults)?;
        Ok(configuration)
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
