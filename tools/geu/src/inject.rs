//! `geu inject`: starts, clears and lists faults of a running emulator.

use std::path::{Path, PathBuf};

use clap::Args;
use geu_model::fault::catalogue::Transport;
use geu_model::time_profile::FAULT_PROFILES;
use geu_protocol::suggestion::did_you_mean;
use serde_json::{Map, Value, json};
use ureq::http::Method;

use crate::command_error::{CommandError, say};
use crate::control_client::{ControlClient, EmulatorArgs};
use crate::settings::read_text;

/// Injects a fault into a running emulator.
///
/// geu inject pivot-clearance.clearance_arcsec GYRX step=11.5 for_s=600
/// geu inject stuck-count GYRY counts=120
/// geu inject bit-flip pty bits=2 when="frame % 10 == 0" for_s=0.5 times=100
#[derive(Args, Debug)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// A parameter (effect.number) or the name of a fault, as `geu faults list` shows them
    #[arg(required_unless_present_any = ["plan", "clear", "start", "list"])]
    what: Option<String>,
    /// Gyro or transport, and KEY=VALUE: a course (step=11.5, ramp=5 over_s=60), numbers, when, for_s
    #[arg(value_name = "GYRO|LINK|KEY=VALUE", allow_negative_numbers = true)]
    keys: Vec<String>,
    /// Inject every fault of a plan, all or none
    #[arg(long, conflicts_with = "what")]
    plan: Option<PathBuf>,
    /// Clear a fault by its identifier, or `all`
    #[arg(long, value_name = "ID", conflicts_with_all = ["what", "plan"])]
    clear: Option<String>,
    /// Start an operator-triggered fault of the plan
    #[arg(long, value_name = "ID", conflicts_with_all = ["what", "plan", "clear"])]
    start: Option<String>,
    /// List the faults
    #[arg(long)]
    list: bool,
    #[command(flatten)]
    emulator: EmulatorArgs,
}

/// Content of the file of `--plan`.
const EXPECTED_PLAN: &str = "a plan with [[fault]]";

/// Runs `geu inject`.
///
/// # Errors
/// No emulator is found, or it refuses the request.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    // The plan is read first: its error does not depend on a running emulator.
    let plan = arguments.plan.as_deref().map(plan).transpose()?;
    let emulator = &arguments.emulator.find()?;
    if let Some(id) = &arguments.clear {
        let path = if id == "all" { "/api/faults".to_owned() } else { format!("/api/faults/{id}") };
        let answer = emulator.ask(Method::DELETE, &path, None)?;
        let cleared = match (&answer["cleared"], &answer["id"]) {
            (Value::Array(ids), _) => ids.iter().filter_map(Value::as_str).collect::<Vec<_>>().join(" "),
            (_, Value::String(id)) => id.clone(),
            _ => return Err(emulator.foreign(&answer)),
        };
        say!("cleared {}", if cleared.is_empty() { "nothing: no fault is active or armed" } else { &cleared })?;
    } else if let Some(id) = &arguments.start {
        print_started(emulator, &emulator.ask(Method::POST, "/api/faults", Some(&json!({ "start": id })))?)?;
    } else if let Some(plan) = &plan {
        let added = emulator.ask(Method::POST, "/api/faults", Some(plan))?;
        let added = added.as_array().ok_or_else(|| emulator.foreign(&added))?;
        if added.is_empty() {
            let name = plan["name"].as_str().unwrap_or_default();
            return Err(CommandError::input(format!("{name}: expected {EXPECTED_PLAN}, got none")));
        }
        added.iter().try_for_each(|fault| print_started(emulator, fault))?;
    } else if let Some(what) = &arguments.what {
        let fault = fault(what, &arguments.keys, || emulator.gyros())?;
        print_started(emulator, &emulator.ask(Method::POST, "/api/faults", Some(&fault))?)?;
    }
    if arguments.list { list(emulator) } else { Ok(()) }
}

fn print_started(emulator: &ControlClient, answer: &Value) -> Result<(), CommandError> {
    let id = answer["id"].as_str().ok_or_else(|| emulator.foreign(answer))?;
    say!("{id} from {} s", answer["at_s"])
}

/// Builds the request of a fault.
fn fault(what: &str, keys: &[String], gyros: impl Fn() -> Vec<String>) -> Result<Value, CommandError> {
    let is_parameter = what.contains('.');
    let (mut fault, mut course) = (Map::new(), Map::new());
    fault.insert(if is_parameter { "parameter" } else { "fault" }.to_owned(), json!(what));
    let is_of_course = |key: &str| {
        FAULT_PROFILES.iter().any(|kind| kind.name == key || kind.shapes.iter().any(|number| number.name == key))
    };
    for given in keys {
        let (key, value) = match given.split_once('=') {
            Some((key, value)) => (key, read(value)),
            None if Transport::from_name(given).is_some() => ("link", json!(given)),
            None if gyros().contains(given) => ("gyro", json!(given)),
            None => {
                let names = gyros();
                let hint = did_you_mean(given, names.iter().map(String::as_str).chain(Transport::NAMES));
                let (gyros, links) = (names.join(", "), Transport::NAMES.join(", "));
                return Err(CommandError::input(format!(
                    "{given}: {hint}expected a gyro ({gyros}), a transport ({links}), or KEY=VALUE"
                )));
            }
        };
        let object = if is_parameter && is_of_course(key) { &mut course } else { &mut fault };
        if object.insert(key.to_owned(), value).is_some() {
            return Err(CommandError::input(format!("{given}: expected `{key}` once")));
        }
    }
    if !course.is_empty() {
        fault.insert("course".to_owned(), Value::Object(course));
    }
    Ok(Value::Object(fault))
}

/// Parses a number, true or false; other values are texts.
fn read(text: &str) -> Value {
    match serde_json::from_str(text) {
        Ok(value @ (Value::Number(_) | Value::Bool(_))) => value,
        _ => json!(text),
    }
}

/// Reads a plan for the control interface.
fn plan(path: &Path) -> Result<Value, CommandError> {
    let plan = read_text(path, EXPECTED_PLAN)?;
    Ok(json!({ "plan": plan, "name": path.display().to_string() }))
}

fn list(emulator: &ControlClient) -> Result<(), CommandError> {
    let faults = emulator.ask(Method::GET, "/api/faults", None)?;
    faults.as_array().ok_or_else(|| emulator.foreign(&faults))?.iter().try_for_each(|fault| say!("{}", line(fault)))
}

/// A fault in one line.
pub fn line(fault: &Value) -> String {
    let text = |key: &str| fault[key].as_str().unwrap_or_default().to_owned();
    let mut line = format!("{:<8} {:<20} {}", text("state"), text("id"), text("what"));
    for key in ["gyro", "link"] {
        if let Some(name) = fault[key].as_str() {
            line += &format!(" on {name}");
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
