//! `geu monitor`: the values of the bench page in a terminal.

use std::collections::VecDeque;
use std::io::{IsTerminal, stdout};
use std::thread::sleep;
use std::time::Duration;

use clap::Args;
use geu_protocol::field::UNIT_FLAGS;
use geu_protocol::{Gyro, map, template};
use serde_json::Value;
use ureq::http::Method;

use crate::command_error::{CommandError, print};
use crate::control_client::EmulatorArgs;
use crate::inject;

/// Lines of the event log below the values.
const EVENT_LINES: usize = 8;
/// Pause before another connection.
const RECONNECT_PAUSE: Duration = Duration::from_millis(100);
/// Moves the cursor home and erases the screen below.
const HOME: &str = "\x1b[H\x1b[J";

/// Shows the values of the bench page of a running emulator in the terminal.
///
/// A terminal shows the latest values; a pipe gets a line for each sample and each event.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    emulator: EmulatorArgs,
    /// End after this number of samples
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
    /// Print lines on a terminal too
    #[arg(long)]
    lines: bool,
}

/// Runs `geu monitor`.
///
/// # Errors
/// No emulator is found; standard output cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let emulator = arguments.emulator.find()?;
    let is_screen = stdout().is_terminal() && !arguments.lines;
    let mut events: VecDeque<String> = VecDeque::new();
    let mut left = arguments.count.unwrap_or(u64::MAX);
    let mut gyros: Option<Vec<String>> = None;
    loop {
        for event in emulator.follow()? {
            let event = event?;
            if matches!(&*event.name, "timeline" | "watch") {
                let (data, text) = (&event.data, |key: &str| event.data[key].as_str().unwrap_or_default().to_owned());
                let (kind, text) = match (&*event.name, text("event"), text("code")) {
                    ("watch", watch, code) => ("watch".to_owned(), format!("{watch} {code} {}", data["gyros"])),
                    _ => (text("kind"), text("text")),
                };
                let line = format!("{:>10.1} s  {kind:<12} {text}", number(&data["t_s"]));
                if is_screen {
                    events.truncate(EVENT_LINES - 1);
                    events.push_front(line);
                } else {
                    print(format_args!("{line}\n"))?;
                }
                continue;
            }
            let gyros = gyros.get_or_insert_with(|| emulator.gyros());
            if is_screen {
                let figures = figures(gyros, &event.data);
                let events: String = events.iter().map(|line| format!("{line}\n")).collect();
                print(format_args!("{HOME}{}\n{figures}\n{events}", emulator.which))?;
            } else {
                print(format_args!("{}\n", line(gyros, &event.data)))?;
            }
            left -= 1;
            if left == 0 {
                return Ok(());
            }
        }
        // The emulator disconnects a slow client, which then connects again.
        sleep(RECONNECT_PAUSE);
        if emulator.ask(Method::GET, "/api/status", None).is_err() {
            return Err(CommandError::failed("the emulator has ended"));
        }
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_default()
}

/// An output: counts of the default unit, else an angle in arcsec.
fn angle(output: &Value) -> String {
    output.as_i64().map_or_else(|| format!("{:+10.3}", number(output)), |counts| format!("{counts:+6}"))
}

/// A sample in one line.
fn line(gyros: &[String], sample: &Value) -> String {
    let outputs = gyros.iter().zip(sample["increments"].as_array().into_iter().flatten());
    let counts: Vec<String> = outputs.map(|(gyro, output)| format!("{gyro} {}", angle(output))).collect();
    let faults = sample["faults"].as_array().into_iter().flatten();
    let active: Vec<&str> =
        faults.filter(|fault| fault["state"] == "active").filter_map(|fault| fault["id"].as_str()).collect();
    format!(
        "{:>10.1} s  seq {:5}  {}  {:.2} / {:.2} °C  late p50 {:.0} µs  {}",
        number(&sample["t_s"]),
        number(&sample["sequence"]),
        counts.join("  "),
        number(&sample["electronics_c"]),
        number(&sample["sensor_c"]),
        number(&sample["lateness"]["p50_us"]),
        active.join(" ")
    )
    .trim_end()
    .to_owned()
}

/// A sample on a screen.
fn figures(gyros: &[String], sample: &Value) -> String {
    let value = |key: &str| number(&sample[key]);
    let texts = |list: &Value| -> Vec<String> {
        list.as_array().into_iter().flatten().filter_map(Value::as_str).map(str::to_owned).collect()
    };
    let gyro_flags = value("gyro_flags") as u8;
    // A described unit has its flags of saturation in its frames alone.
    let has_saturation = *gyros == Gyro::NAMES;
    let gyros = gyros.iter().enumerate().map(|(index, gyro)| {
        let (count, truth) = (number(&sample["increments"][index]), number(&sample["true_arcsec"][index]));
        let (difference, departure) = (count - truth, number(&sample["departure_arcsec"][index]));
        let output = angle(&sample["increments"][index]);
        let row = format!("{gyro:<6} {output:>7}  {truth:+12.3}  {difference:+11.3}  {departure:+12.3}");
        let is_saturated = has_saturation && gyro_flags >> index & 0x10 != 0;
        map! { row: row, is_valid: gyro_flags >> index & 1 != 0, is_saturated: is_saturated }
    });
    let links = sample["links"].as_array().into_iter().flatten().map(|link| {
        let count = |key: &str| link[key].to_string();
        map! { name: link["name"].as_str(), clients: count("clients"), sent: count("sent"), dropped: count("dropped"),
        replies: count("replies") }
    });
    let faults = sample["faults"].as_array().into_iter().flatten().filter(|fault| fault["state"] != "over");
    let lateness = |key: &str| number(&sample["lateness"][key]);
    let values = map! {
        t_s: value("t_s"),
        sequence: value("sequence"),
        clock_count: value("clock_count"),
        is_polled: sample["cyclic"] == false,
        electronics_c: value("electronics_c"),
        sensor_c: value("sensor_c"),
        flags: flags(sample),
        gyros: gyros.collect::<template::Value>(),
        rate: [0, 1, 2].map(|axis| number(&sample["rate_arcsec_s"][axis])),
        has_sun: sample["theta_deg"].is_number() && sample["psi_deg"].is_number(),
        theta_deg: value("theta_deg"),
        psi_deg: value("psi_deg"),
        late_us: ["p50_us", "p99_us", "max_us"].map(lateness),
        late: value("late"),
        missed: value("missed"),
        serial: sample["wire"]["serial"].as_str(),
        can: texts(&sample["wire"]["can"]).join("  "),
        links: links.collect::<template::Value>(),
        faults: faults.map(inject::line).collect::<template::Value>(),
    };
    template::filled(&template::engine(), include_str!("monitor.txt"), &values)
}

fn flags(sample: &Value) -> String {
    let flags = number(&sample["unit_flags"]) as u8;
    let names = UNIT_FLAGS.iter().filter(|flag| flags & 1 << flag.bit != 0).map(|flag| flag.name.replace('_', " "));
    names.collect::<Vec<_>>().join(", ")
}
