//! Configurations, plans and expressions: what is accepted is written and read again as the same, and runs.

use std::sync::Arc;

use geu_model::configuration::fault::{plan_text, read_plan_text};
use geu_model::device::Device;
use geu_model::effect::discovered::Formula;
use geu_model::fault::catalogue::Transport;
use geu_model::fault::expression::{ConditionInputs, Expression};
use geu_model::{Configuration, GyroUnit, Simulation};
use geu_protocol::can::AssemblerEvent;
use geu_protocol::command::{self, from_hex, hex};
use geu_protocol::{Assembler, CanIdMap, Reply};
use geu_recorder::link_model::LinkModel;

use crate::device::known;

const SAMPLES: usize = 4;

/// A configuration, and overrides behind zero bytes.
pub fn configuration(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    let mut texts = text.split('\0').map(str::to_owned);
    let text = texts.next().unwrap_or_default();
    let Ok(configuration) = Configuration::parse("a.toml", &text, &texts.collect::<Vec<_>>()) else { return };
    for is_complete in [false, true] {
        let shown = configuration.to_toml(is_complete);
        let again = Configuration::parse("shown.toml", &shown, &[]).unwrap_or_else(|error| panic!("{error}\n{shown}"));
        assert_eq!(again.to_toml(false), configuration.to_toml(false));
    }
    for (sample, _) in Simulation::new(&configuration).take(SAMPLES) {
        assert!(sample.outputs.counts.iter().all(|count| count.is_finite()), "{:?}", sample.outputs);
    }
}

/// A plan of the unit that the first byte selects: its faults act on the unit and on its links.
pub fn plan(data: &[u8]) {
    let Some((first, text)) = data.split_first() else { return };
    let Ok(text) = str::from_utf8(text) else { return };
    let device = match first % 4 {
        0 => Arc::new(known("stim300").clone()),
        1 => Arc::new(known("mm5.10").clone()),
        _ => Device::iras(),
    };
    let mut configuration = Configuration::of_device(&device, &[]).expect("a unit without errors");
    if configuration.add_plan("plan.toml", text).is_err() {
        return;
    }
    let (faults, expectations) = (&configuration.faults, &configuration.expectations);
    let shown = plan_text(&device, faults, expectations);
    let mut again = Configuration::of_device(&device, &[]).expect("a unit without errors");
    again.add_plan("shown.toml", &shown).unwrap_or_else(|error| panic!("{error}\n{shown}"));
    assert_eq!(shown, plan_text(&device, &again.faults, &again.expectations));
    if expectations.is_empty() {
        assert!(read_plan_text(&device, "plan.toml", text, &[], &Transport::ALL).is_ok());
    }
    let links = Transport::ALL.map(|kind| LinkModel::of_unit(&device, kind, None, None));
    let mut unit = GyroUnit::new(&configuration);
    for frame in 0..SAMPLES as u64 {
        let sample = unit.end_sample();
        let acting = unit.faults().acting().clone();
        for link in &links {
            link.carry(Some(&sample), frame, &acting);
            link.touching(&acting);
        }
        unit.take_happened();
    }
}

/// A condition.
pub fn expression(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    let Ok(expression) = text.parse::<Expression>() else { return };
    assert_eq!(expression.to_string(), text);
    let mut now = ConditionInputs { theta_deg: 90.0, psi_deg: f64::NAN, ..ConditionInputs::default() };
    for t_s in [0.0, 12.5, 1e9] {
        now.t_s = t_s;
        expression.holds(&now);
    }
    // A condition within brackets is the same; its negation never holds beside it.
    let (inner, negated) = (format!("({text})"), format!("not ({text})"));
    if let (Ok(inner), Ok(negated)) = (inner.parse::<Expression>(), negated.parse::<Expression>()) {
        assert_eq!(inner.holds(&now), expression.holds(&now));
        assert!(!(negated.holds(&now) && expression.holds(&now)), "{text}");
        assert_eq!(inner.faults(), expression.faults());
        assert_eq!(inner.asks_about(), expression.asks_about());
    }
}

/// A term of the discovered effect.
pub fn formula(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    let Ok(formula) = text.parse::<Formula>() else { return };
    assert_eq!(formula.to_string().parse(), Ok(formula), "{text}");
    assert!(formula.value(|_| 0.5).is_finite() && !formula.unit().is_empty());
}

/// The payload of a COMMAND and of a REPLY.
pub fn command(data: &[u8]) {
    if let Some(reply) = Reply::read(data) {
        assert_eq!(Reply::new(reply.opcode(), reply.outcome(), reply.values()), reply);
        assert_eq!(reply.bytes(), data);
    }
    let parsed = command::parse(data);
    let spec = data.first().and_then(|opcode| command::COMMANDS.iter().find(|spec| spec.opcode == *opcode));
    if let (Ok(_), Some(spec)) = (parsed, spec) {
        let mut at = 1;
        let values: Vec<i64> = (spec.arguments.iter())
            .map(|argument| {
                at += argument.wire.length();
                argument.wire.read(&data[at - argument.wire.length()..at])
            })
            .collect();
        assert_eq!(command::payload(spec, &values), data);
        assert_eq!(command::from_name(spec.name, &values).as_deref(), Ok(data));
    }
    if (1..=8).contains(&data.len()) {
        assert_eq!(from_hex(&hex(data)).as_deref(), Some(data));
    }
    if let Ok(text) = str::from_utf8(data) {
        from_hex(text);
        command::is_name(text);
    }
}

/// Commands to a unit, each with its length before it; zeros end samples, which are read from CAN as they were written.
pub fn commands(mut data: &[u8]) {
    let mut unit = GyroUnit::new(&Configuration::of_device(&Device::iras(), &[]).expect("a unit without errors"));
    let (ids, mut assembler, mut sent) = (CanIdMap::default(), Assembler::default(), None);
    while let Some((length, rest)) = data.split_first() {
        let length = usize::from(length % 16).min(rest.len());
        let (payload, rest) = rest.split_at(length);
        data = rest;
        if length > 0 {
            let response = unit.command(payload).expect("no fault silences the unit");
            assert_eq!(response.reply.opcode(), payload[0]);
            assert_eq!(Reply::read(response.reply.bytes()), Some(response.reply));
            continue;
        }
        let sample = unit.end_sample().sample;
        for frame in ids.frames(&sample) {
            assembler.push(ids.role(frame.id()), (), frame.data(), &mut |event| match event {
                AssemblerEvent::Row(row) => assert_eq!(sent.replace(row.sample), None),
                AssemblerEvent::Defect(_, defect, _) => {
                    assert_eq!(defect, geu_protocol::can::CanDefect::ClockInconsistent);
                }
            });
        }
        let read = sent.take().expect("a sample");
        assert_eq!((read.increments, read.sequence), (sample.increments, sample.sequence));
    }
}
