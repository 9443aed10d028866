//! `geu faults`: the catalogue of faults.

use std::io::Write;

use clap::{Args, Subcommand};
use geu_model::configuration::fault::{ExpectationNumbers, FAULT_TEXTS, FaultNumbers};
use geu_model::device::Device;
use geu_model::fault::catalogue::{CATALOGUE, FaultSpec, Scope, Transport};
use geu_model::fault::{EffectList, ParameterRef, expression};
use geu_model::parameter_spec::{DefaultValue, ParameterSpec, ValueFormat};
use geu_model::time_profile::FAULT_PROFILES;
use geu_protocol::Gyro;
use geu_protocol::suggestion::did_you_mean;

use crate::command_error::CommandError;
use crate::device::{DEFAULT_DEVICE, unit};

/// Lists the catalogue of faults.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    List(List),
}

/// Prints every fault with its parameters, and the keys of a plan.
#[derive(Args, Debug)]
struct List {
    /// Print, for each link fault, whether this transport supports it
    #[arg(long, value_parser = link_kind)]
    link: Option<Transport>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Name or description of the unit
    #[arg(long, value_name = "NAME|FILE", default_value = DEFAULT_DEVICE)]
    device: String,
}

fn link_kind(text: &str) -> Result<Transport, String> {
    Transport::from_name(text).ok_or_else(|| {
        let hint = did_you_mean(text, Transport::NAMES);
        format!("{hint}expected one of {}, got {text}", Transport::NAMES.join(", "))
    })
}

/// Runs `geu faults`.
///
/// # Errors
/// Standard output cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let Command::List(list) = &arguments.command;
    let device = unit(&list.device)?;
    let text = if list.json { format!("{:#}\n", geu_daemon::catalogue(&device)) } else { text(&device, list.link) };
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(CommandError::failed(error)),
        _ => Ok(()),
    }
}

fn number(device: &Device, spec: &ParameterSpec) -> String {
    let default = match spec.default {
        DefaultValue::Value(value) => format!("; default {}", spec.written(value)),
        DefaultValue::Required => "; required".to_owned(),
        DefaultValue::Absent => String::new(),
    };
    let limits = match spec.form {
        ValueFormat::Gyro => ValueFormat::limits_of(&device.gyros().map(Gyro::name).collect::<Vec<_>>()),
        _ => spec.limits(),
    };
    format!("{}: {} ({limits}{default})", spec.name, spec.meaning)
}

fn text(device: &Device, link: Option<Transport>) -> String {
    let mut lines = vec!["A fault of a plan, [[fault]], changes a parameter or has a name.".to_owned()];
    if link.is_none() {
        lines.push("\nParameters (parameter = \"effect.number\", course = { … }):".to_owned());
        for target in ParameterRef::all() {
            let (min, max) = target.limits_of(device);
            let limits = target.number().form.limits(min, max);
            let gyros = target.gyros(device);
            let scope_name = match gyros.len() {
                _ if target.list == EffectList::Unit => "the unit".to_owned(),
                0 => continue,
                count if count == device.heads.len() => "any gyro".to_owned(),
                _ => gyros.iter().map(|gyro| gyro.name()).collect::<Vec<_>>().join(", "),
            };
            let verb = if target.is_switch() { "sets" } else { "adds" };
            lines.push(format!("  {:<50} {scope_name}; {verb} {limits}", target.name()));
        }
        lines.push("\nCourses of a parameter:".to_owned());
        for kind in FAULT_PROFILES {
            lines.push(format!("  {:<10} {}", kind.name, kind.meaning));
            lines.extend(kind.shapes.iter().map(|spec| format!("    {}", number(device, spec))));
        }
    }
    for scope in [Scope::Gyro, Scope::Unit, Scope::Link] {
        if link.is_some() && scope != Scope::Link {
            continue;
        }
        let scope_name = match scope {
            Scope::Gyro => format!("a gyro (gyro = \"{}\")", device.heads[0].gyro.name()),
            Scope::Unit => "the unit".to_owned(),
            Scope::Link => {
                format!("links (link = \"{}\"; without it, of all)", link.map_or("pty|serial|can|tcp", Transport::name))
            }
        };
        lines.push(format!("\nFaults of {scope_name}:"));
        for spec in CATALOGUE.iter().filter(|spec| spec.scope == scope) {
            lines.push(format!("  {:<18} {}", spec.code, spec.meaning));
            lines.extend(spec.numbers.iter().map(|spec| format!("    {}", number(device, spec))));
            if let Some(for_s) = spec.for_s {
                lines.push(format!("    for_s: {for_s:?} where not named"));
            }
            lines.extend(refusals(device, spec, link));
        }
    }
    if link.is_none() {
        lines.push("\nWhen and how long, of every fault:".to_owned());
        lines.extend(FAULT_TEXTS.iter().map(|(key, meaning)| format!("  {key}: {meaning}")));
        lines.extend(FaultNumbers::NUMBERS.iter().map(|spec| format!("  {}", number(device, spec))));
        lines.push("  seed: of what it draws; the run's where not named".to_owned());
        lines.push("\nConditions join comparisons (< <= > >= == !=, + - * / %) by and, or, not:".to_owned());
        lines.extend(expression::vocabulary().iter().map(|(name, meaning)| {
            let name = name.replace(Gyro::X.name(), device.heads[0].gyro.name());
            format!("  {name:<20} {meaning}")
        }));
        lines.push("\nExpectations, [[expect]]: id, after (a fault), condition, and".to_owned());
        lines.extend(ExpectationNumbers::NUMBERS.iter().map(|spec| format!("  {}", number(device, spec))));
    }
    lines.join("\n") + "\n"
}

/// The transports that do not support a fault, with the reasons.
fn refusals(device: &Device, spec: &FaultSpec, link: Option<Transport>) -> Vec<String> {
    let asked = Transport::ALL.into_iter().filter(|kind| link.is_none_or(|link| link == *kind));
    let of_unit =
        |kind: Transport| device.unable(spec.code, kind == Transport::Can).filter(|_| spec.scope == Scope::Link);
    let reason = |kind: Transport| Some((kind, spec.unable_on(kind).or_else(|| of_unit(kind))?));
    asked.filter_map(reason).map(|(kind, reason)| format!("    not on {}: {reason}", kind.name())).collect()
}
