//! A configuration written as TOML: complete and commented, or just what it holds.

use std::fmt::Write;

use geu_protocol::Gyro;

use super::{
    CAN_BASE, Configuration, DURATION, ENDED_EARLY, EndedEarly, PSI, RunRecord, SERIAL_BAUD, START, THETA, TRUTH,
    UNFINISHED, fault,
};
use crate::attitude::{Manoeuvre, TruthNumbers};
use crate::course::TimeFunctionSpec;
use crate::effect::discovered::{self, Regressor, Term};
use crate::effect::{EffectConfiguration, Effects};
use crate::number::{DefaultValue, ParameterSet, ParameterSpec, ValueFormat};
use crate::package::Axes;
use crate::sensor::SensorNumbers;

impl Configuration {
    /// The configuration as TOML that reads back the same. `complete` adds what is not there as comments: every effect
    /// with its default, limits and source, and every kind of manoeuvre.
    pub fn to_toml(&self, complete: bool) -> String {
        let mut text = String::new();
        line(&mut text, format_args!("seed = {}", self.seed));
        // From integers: a product of floats is off by a microsecond late in the range.
        let start_us = self.start_unix_ns / 1000;
        let start_unix_s = format!("{}.{:06}", start_us / 1_000_000, start_us % 1_000_000);
        line(&mut text, format_args!("{} = {start_unix_s}{}", START.name, comment(complete, START.meaning)));

        line(&mut text, format_args!("\n[scenario]"));
        for (number, value) in [(&THETA, self.scenario.theta_deg), (&PSI, self.scenario.psi_deg)] {
            let meaning = format!("{} ({})", number.meaning, number.limits());
            line(&mut text, format_args!("{} = {value:?}{}", number.name, comment(complete, &meaning)));
        }
        numbers(
            &mut text,
            complete,
            "",
            "limit_cycle",
            "limit cycle about X and Y",
            &self.scenario.limit_cycle,
            |_| true,
        );
        if complete {
            kinds_of_manoeuvres(&mut text);
        }
        for manoeuvre in &self.scenario.manoeuvres {
            line(&mut text, format_args!("\n[[manoeuvre]]\nkind = {:?}", manoeuvre.kind()));
            for (number, value) in named(manoeuvre.numbers()) {
                line(&mut text, format_args!("{} = {value:?}", number.name));
            }
        }
        if complete || self.truth != TruthNumbers::default() {
            line(&mut text, format_args!("\n[{TRUTH}]"));
            if complete {
                line(
                    &mut text,
                    format_args!("# a truth that a simulator reports while the unit runs (geu run --truth)"),
                );
                describe(&mut text, &self.truth, |_| true);
            }
            for (number, value) in named(&self.truth) {
                line(&mut text, format_args!("{} = {}", number.name, number.written(value)));
            }
        }

        line(&mut text, format_args!("\n[temperature]"));
        numbers(&mut text, complete, "", "electronics", "electronics temperature", &self.electronics.numbers, |_| true);
        if !self.electronics.table.is_empty() {
            let points: Vec<String> =
                self.electronics.table.iter().map(|(time_s, celsius)| format!("[{time_s:?}, {celsius:?}]")).collect();
            line(&mut text, format_args!("electronics_table = [{}]", points.join(", ")));
        } else if complete {
            line(
                &mut text,
                format_args!(
                    "# electronics_table = [[0.0, 20.0], [3600.0, 21.5]]  # time_s, degC; takes the mean's place"
                ),
            );
        }

        line(&mut text, format_args!("\n[unit]"));
        effects(&mut text, complete, &self.unit, |_| true);
        for (gyro, configured) in Gyro::ALL.into_iter().zip(&self.gyros) {
            let has = |name: &str| Axes::of(gyro).has_number(name);
            line(&mut text, format_args!("\n[gyro.{}]", gyro.name()));
            numbers(
                &mut text,
                complete,
                "",
                "calibration",
                "the unit's own parameters, and the believed ones",
                &configured.calibration,
                has,
            );
            discovered(&mut text, complete, &configured.discovered);
            effects(&mut text, complete, &configured.effects, has);
            effects(&mut text, complete, &configured.wiring, has);
        }
        line(&mut text, format_args!("\n[sensors]"));
        for (index, (key, title)) in SensorNumbers::KEYS.into_iter().enumerate() {
            numbers(&mut text, complete, "", key, title, self.sensors.numbers(index), |_| true);
        }
        if complete {
            kinds_of_faults(&mut text);
        }
        text += &fault::plan_text(&self.faults, &self.expectations);
        self.show_run(&mut text);
        text
    }

    fn show_run(&self, text: &mut String) {
        if self.run == RunRecord::default() {
            return;
        }
        line(text, format_args!("\n[run]\n{} = {:?}", DURATION.name, self.run.duration_s));
        if self.run.is_unfinished {
            line(text, format_args!("{UNFINISHED} = true"));
        }
        if let Some(EndedEarly { sample, reason }) = &self.run.ended_early {
            let reason = quoted(reason);
            line(text, format_args!("{ENDED_EARLY} = {{ half_second = {sample}, reason = {reason} }}"));
        }
        if let Some(wire) = self.run.wire {
            line(text, format_args!("wire = {:?}", wire.name()));
        }
        if !self.run.links.is_empty() {
            let names: Vec<&str> = self.run.links.iter().map(|link| link.name()).collect();
            line(text, format_args!("links = {names:?}"));
        }
        if let Some(baud) = self.run.serial_baud {
            line(text, format_args!("{} = {baud}", SERIAL_BAUD.name));
        }
        if let Some(base) = self.run.can_base {
            line(text, format_args!("{} = {base:#X}", CAN_BASE.name));
        }
        if let Some(truth) = &self.run.truth {
            line(text, format_args!("truth = {}", quoted(truth)));
        }
        if !self.run.injected.is_empty() {
            line(text, format_args!("injected = {:?}", self.run.injected));
        }
        for command in &self.run.commands {
            let bytes = geu_protocol::command::hex(&command.payload);
            line(
                text,
                format_args!(
                    "\n[[run.command]]\nhalf_second = {}\nlink = {:?}\nbytes = {bytes:?}",
                    command.sample, command.link
                ),
            );
        }
    }
}

/// A text as TOML has it.
pub(super) fn quoted(text: &str) -> String {
    toml_edit::Value::from(text).to_string()
}

fn line(text: &mut String, content: std::fmt::Arguments) {
    text.write_fmt(content).expect("a string takes everything");
    text.push('\n');
}

fn comment(complete: bool, meaning: &str) -> String {
    if complete { format!("  # {}", meaning.trim()) } else { String::new() }
}

/// The numbers that have a value.
fn named(numbers: &dyn ParameterSet) -> impl Iterator<Item = (&'static ParameterSpec, f64)> {
    let values: Vec<_> = numbers.specs().iter().enumerate().map(|(index, spec)| (spec, numbers.value(index))).collect();
    values.into_iter().filter(|(_, value)| !value.is_nan())
}

fn inline(numbers: &dyn ParameterSet, has: impl Fn(&str) -> bool) -> String {
    let pairs: Vec<String> = named(numbers)
        // A gyro that is not named has no name to write.
        .filter(|(number, value)| has(number.name) && (number.form != ValueFormat::Gyro || *value != 0.0))
        .map(|(number, value)| format!("{} = {}", number.name, number.written(value)))
        .collect();
    format!("{{ {} }}", pairs.join(", "))
}

/// Lines that say what each number is.
fn describe(text: &mut String, numbers: &dyn ParameterSet, has: impl Fn(&str) -> bool) {
    for spec in numbers.specs().iter().filter(|spec| has(spec.name)) {
        line(text, format_args!("#   {}: {} ({})", spec.name, spec.meaning.trim(), spec.limits()));
    }
}

fn numbers(
    text: &mut String,
    complete: bool,
    prefix: &str,
    key: &str,
    title: &str,
    numbers: &dyn ParameterSet,
    has: impl Fn(&str) -> bool,
) {
    if complete {
        line(text, format_args!("# {title}"));
        describe(text, numbers, &has);
    }
    line(text, format_args!("{prefix}{key} = {}", inline(numbers, has)));
}

fn effects<E: Effects>(
    text: &mut String,
    complete: bool,
    configured: &EffectConfiguration<E>,
    has: impl Fn(&str) -> bool,
) {
    for (index, spec) in configured.constant.specs().iter().enumerate() {
        let present = configured.constant.numbers(index);
        let absent = E::default();
        let same = inline(present, &has) == inline(absent.numbers(index), &has);
        if complete {
            let title = format!("{}; paper: {} ({})", spec.title, spec.paper, spec.source);
            numbers(text, true, if same { "# " } else { "" }, spec.code, &title, present, &has);
        } else if !same {
            numbers(text, false, "", spec.code, spec.title, present, &has);
        }
        courses(text, configured, index);
    }
}

/// The effect whose terms are data.
fn discovered(text: &mut String, complete: bool, terms: &[Term]) {
    let code = discovered::CODE;
    let coefficient = discovered::COEFFICIENT;
    if complete {
        line(text, format_args!("# {}; at most {} terms", discovered::TITLE, discovered::MOST_TERMS));
        line(text, format_args!("#   formula: {}:", discovered::FORMULA_MEANING));
        for regressor in Regressor::ALL {
            let (name, meaning, unit) = (regressor.name(), regressor.meaning(), regressor.unit());
            line(text, format_args!("#     {name}: {meaning} ({unit})"));
        }
        line(text, format_args!("#   {}: {} ({})", coefficient.name, coefficient.meaning, coefficient.limits()));
    }
    let term = |Term { formula, coefficient: value }: &Term| {
        format!("{{ formula = \"{formula}\", {} = {value:?} }}", coefficient.name)
    };
    match terms {
        [] if complete => line(text, format_args!("# {code} = []")),
        [] => {}
        terms => line(text, format_args!("{code} = [{}]", terms.iter().map(term).collect::<Vec<_>>().join(", "))),
    }
}

/// Courses of one effect: those of one law share a key.
fn courses<E: Effects>(text: &mut String, configured: &EffectConfiguration<E>, effect: usize) {
    let spec = &configured.constant.specs()[effect];
    let own: Vec<_> = configured.courses.iter().filter(|course| course.effect == effect).collect();
    let mut written = Vec::new();
    for course in &own {
        if written.contains(&course.law) {
            continue;
        }
        written.push(course.law);
        let (kind, shapes) = TimeFunctionSpec::of(&course.law);
        let specs = configured.constant.numbers(effect).specs();
        let sizes = own
            .iter()
            .filter(|other| other.law == course.law)
            .filter_map(|other| Some((kind.size(spec, specs, other.amplitude)?, other.size)))
            .map(|(size, value)| format!("{} = {}", size.name, size.form.written(value)));
        let shapes = kind.shapes.iter().zip(shapes).map(|(shape, value)| format!("{} = {value:?}", shape.name));
        let pairs: Vec<String> = sizes.chain(shapes).collect();
        line(text, format_args!("{}{} = {{ {} }}", spec.code, kind.suffix, pairs.join(", ")));
    }
}

fn kinds_of_manoeuvres(text: &mut String) {
    line(
        text,
        format_args!(
            "\n# Manoeuvres, one after the other; a hold without end follows the last. Kinds and their numbers:"
        ),
    );
    for (kind, title) in Manoeuvre::KINDS {
        let manoeuvre = Manoeuvre::of_kind(kind).expect("one of the kinds");
        line(text, format_args!("# {kind}: {title}"));
        for spec in manoeuvre.numbers().specs() {
            let default = match spec.default {
                DefaultValue::Value(value) => format!("default {value:?}"),
                DefaultValue::Required => "required".to_owned(),
                DefaultValue::Absent => "optional".to_owned(),
            };
            line(text, format_args!("#   {}: {} ({}; {default})", spec.name, spec.meaning.trim(), spec.limits()));
        }
    }
}

fn kinds_of_faults(text: &mut String) {
    let example =
        "at_s = 100.0, gyro = \"GYRX\", parameter = \"pivot-clearance.clearance_arcsec\", course = { step = 11.5 }";
    line(text, format_args!("\n# Faults; `geu faults list` shows all of them. Keys of each:"));
    for (key, meaning) in fault::FAULT_TEXTS {
        line(text, format_args!("#   {key}: {meaning}"));
    }
    for number in fault::FAULT_NUMBERS {
        line(text, format_args!("#   {}: {} ({})", number.name, number.meaning, number.limits()));
    }
    line(text, format_args!("# fault = [{{ {example}, for_s = 600.0 }}]"));
}
