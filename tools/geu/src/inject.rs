//! `geu inject`: moves a fault into a running emulator, takes it out again, lists what is there.

use std::path::{Path, PathBuf};

use clap::Args;
use geu_model::fault::catalogue::Transport;
use geu_model::fault::shape;
use geu_protocol::Gyro;
use geu_protocol::suggestion::did_you_mean;
use serde_json::{Map, Value, json};
use ureq::http::Method;

use crate::control::{Choice, ControlClient};
use crate::failure::{CommandError, say};

/// Moves a fault into a running emulator.
///
/// geu inject pivot-clearance.clearance_arcsec GYRX step=11.5 for_s=600
/// geu inject stuck-count GYRY counts=120
/// geu inject bit-flip pty bits=2 when="frame % 10 == 0" for_s=0.5 times=100
#[derive(Args, Debug)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// A parameter (effect.number) or a fault by its name, as `geu faults list` shows them
    #[arg(required_unless_present_any = ["plan", "clear", "start", "list"])]
    what: Option<String>,
    /// The gyro or the kind of link that it is on, and KEY=VALUE: a course (step=11.5, ramp=5 over_s=60), numbers, when, for_s
    #[arg(value_name = "GYRO|LINK|KEY=VALUE", allow_negative_numbers = true)]
    keys: Vec<String>,
    /// Every fault of a plan, all or none
    #[arg(long, conflicts_with = "what")]
    plan: Option<PathBuf>,
    /// Takes a fault out, by its identifier, or `all`
    #[arg(long, value_name = "ID", conflicts_with_all = ["what", "plan"])]
    clear: Option<String>,
    /// Starts a fault of the plan that waits for a hand
    #[arg(long, value_name = "ID", conflicts_with_all = ["what", "plan", "clear"])]
    start: Option<String>,
    /// Shows the faults that are there
    #[arg(long)]
    list: bool,
    #[command(flatten)]
    emulator: Choice,
}

/// Carries it out.
///
/// # Errors
/// No emulator, or what it refuses and why.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    // A plan that cannot be read is told whether or not an emulator runs.
    let plan = arguments.plan.as_deref().map(plan).transpose()?;
    let emulator = &arguments.emulator.find()?;
    if let Some(id) = &arguments.clear {
        let path = if id == "all" { "/api/faults".to_owned() } else { format!("/api/faults/{id}") };
        let answer = emulator.ask(Method::DELETE, &path, None)?;
        let cleared = match &answer["cleared"] {
            Value::Array(ids) => ids.iter().filter_map(Value::as_str).collect::<Vec<_>>().join(" "),
            _ => id.clone(),
        };
        say!("cleared {}", if cleared.is_empty() { "nothing: there is no fault" } else { &cleared })?;
    } else if let Some(id) = &arguments.start {
        tell(&emulator.ask(Method::POST, "/api/faults", Some(&json!({ "start": id })))?)?;
    } else if let Some(plan) = &plan {
        let added = emulator.ask(Method::POST, "/api/faults", Some(plan))?;
        added.as_array().into_iter().flatten().try_for_each(tell)?;
    } else if let Some(what) = &arguments.what {
        tell(&emulator.ask(Method::POST, "/api/faults", Some(&fault(what, &arguments.keys)?))?)?;
    }
    if arguments.list { list(emulator) } else { Ok(()) }
}

fn tell(answer: &Value) -> Result<(), CommandError> {
    say!("{} from {} s", answer["id"].as_str().unwrap_or_default(), answer["at_s"])
}

/// A fault as the control interface takes it.
fn fault(what: &str, keys: &[String]) -> Result<Value, CommandError> {
    let is_parameter = what.contains('.');
    let (mut fault, mut course) = (Map::new(), Map::new());
    fault.insert(if is_parameter { "parameter" } else { "fault" }.to_owned(), json!(what));
    let is_of_course = |key: &str| {
        shape::KINDS.iter().any(|kind| kind.name == key || kind.numbers.iter().any(|number| number.name == key))
    };
    for given in keys {
        let (key, value) = match given.split_once('=') {
            Some((key, value)) => (key, read(value)),
            None if Transport::named(given).is_some() => ("link", json!(given)),
            None if Gyro::named(given).is_some() => ("gyro", json!(given)),
            None => {
                let (gyros, links) = (Gyro::ALL.map(Gyro::name).join(", "), Transport::NAMES.join(", "));
                let hint = did_you_mean(given, Gyro::ALL.map(Gyro::name).into_iter().chain(Transport::NAMES));
                return Err(CommandError::input(format!(
                    "{given}: {hint}expected a gyro ({gyros}), a kind of link ({links}), or KEY=VALUE"
                )));
            }
        };
        let room = if is_parameter && is_of_course(key) { &mut course } else { &mut fault };
        if room.insert(key.to_owned(), value).is_some() {
            return Err(CommandError::input(format!("{given}: expected `{key}` once")));
        }
    }
    if !course.is_empty() {
        fault.insert("course".to_owned(), Value::Object(course));
    }
    Ok(Value::Object(fault))
}

/// A number, true or false; else a text.
fn read(text: &str) -> Value {
    match serde_json::from_str(text) {
        Ok(value @ (Value::Number(_) | Value::Bool(_))) => value,
        _ => json!(text),
    }
}

/// A plan as the control interface takes it.
fn plan(path: &Path) -> Result<Value, CommandError> {
    let name = path.display().to_string();
    let plan = geu_recording::read_text(path).map_err(|error| {
        CommandError::input(format!("{name}: cannot be read: {error}; expected a plan with [[fault]]"))
    })?;
    Ok(json!({ "plan": plan, "name": name }))
}

fn list(emulator: &ControlClient) -> Result<(), CommandError> {
    let faults = emulator.ask(Method::GET, "/api/faults", None)?;
    for fault in faults.as_array().into_iter().flatten() {
        say!("{}", line(fault))?;
    }
    Ok(())
}

/// A fault in one line, as the monitor shows it too.
pub fn line(fault: &Value) -> String {
    let text = |key: &str| fault[key].as_str().unwrap_or_default().to_owned();
    let mut line = format!("{:<8} {:<20} {}", text("state"), text("id"), text("what"));
    for whom in ["gyro", "link"] {
        if let Some(whom) = fault[whom].as_str() {
            line += &format!(" on {whom}");
        }
    }
    match (fault["since_s"].as_f64(), fault["ends_s"].as_f64()) {
        (Some(since_s), Some(ends_s)) => line += &format!(", {since_s} s to {ends_s} s"),
        (Some(since_s), None) => line += &format!(", since {since_s} s"),
        (None, _) if text("state") == "armed" => line += &format!(", waits for {}", text("trigger")),
        (None, _) => {}
    }
    line
}
