//! `geu monitor`: the values of the bench page in a terminal.

use std::collections::VecDeque;
use std::fmt::Write;
use std::io::{IsTerminal, stdout};

use clap::Args;
use geu_protocol::Gyro;
use geu_protocol::field::UNIT_FLAGS;
use serde_json::Value;
use ureq::http::Method;

use crate::command_error::{CommandError, print};
use crate::control_client::EmulatorArgs;
use crate::inject;

/// Lines of the event log below the values.
const EVENT_LINES: usize = 8;
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
    loop {
        for event in emulator.follow()? {
            let event = event?;
            if event.name == "timeline" {
                let line = format!(
                    "{:>10.1} s  {:<12} {}",
                    event.data["t_s"].as_f64().unwrap_or_default(),
                    event.data["kind"].as_str().unwrap_or_default(),
                    event.data["text"].as_str().unwrap_or_default()
                );
                if is_screen {
                    events.truncate(EVENT_LINES - 1);
                    events.push_front(line);
                } else {
                    print(format_args!("{line}\n"))?;
                }
                continue;
            }
            if is_screen {
                let figures = figures(&event.data);
                let events: String = events.iter().map(|line| format!("{line}\n")).collect();
                print(format_args!("{HOME}{}\n{figures}\n{events}", emulator.which))?;
            } else {
                print(format_args!("{}\n", line(&event.data)))?;
            }
            left -= 1;
            if left == 0 {
                return Ok(());
            }
        }
        // The emulator disconnects a slow client, which then connects again.
        if emulator.ask(Method::GET, "/api/status", None).is_err() {
            return Err(CommandError::failed("the emulator has ended"));
        }
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_default()
}

/// A sample in one line.
fn line(sample: &Value) -> String {
    let counts: Vec<String> = Gyro::ALL
        .into_iter()
        .enumerate()
        .map(|(index, gyro)| format!("{} {:+6}", gyro.name(), sample["increments"][index].as_i64().unwrap_or(0)))
        .collect();
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
fn figures(sample: &Value) -> String {
    let value = |key: &str| number(&sample[key]);
    let mut text = String::new();
    let mode = if sample["cyclic"] == false { "polled" } else { "cyclic" };
    let _ = writeln!(
        text,
        "on-board time {:.1} s   sequence {}   clock count {}   {mode}",
        value("t_s"),
        value("sequence"),
        value("clock_count")
    );
    let _ = writeln!(
        text,
        "electronics {:.2} °C   sensor {:.2} °C   {}\n",
        value("electronics_c"),
        value("sensor_c"),
        flags(sample)
    );
    let _ = writeln!(text, "gyro     count   true arcsec   difference   accumulated   flags");
    let gyro_flags = value("gyro_flags") as u8;
    for (index, gyro) in Gyro::ALL.into_iter().enumerate() {
        let (count, truth) = (number(&sample["increments"][index]), number(&sample["true_arcsec"][index]));
        let valid = if gyro_flags & gyro.bit() == 0 { "not valid" } else { "valid" };
        let saturated = if gyro_flags & gyro.bit() << 4 == 0 { "" } else { ", saturated" };
        let _ = writeln!(
            text,
            "{:<6} {count:+7}  {truth:+12.3}  {:+11.3}  {:+12.3}   {valid}{saturated}",
            gyro.name(),
            count - truth,
            number(&sample["departure_arcsec"][index])
        );
    }
    let rates: Vec<f64> = (0..3).map(|axis| number(&sample["rate_arcsec_s"][axis])).collect();
    let _ = write!(text, "\ntrue rate  x {:+.2}  y {:+.2}  z {:+.2} arcsec/s", rates[0], rates[1], rates[2]);
    if let (Some(theta), Some(psi)) = (sample["theta_deg"].as_f64(), sample["psi_deg"].as_f64()) {
        let _ = write!(text, "   theta {theta:.3}°  psi {psi:.3}°");
    }
    let lateness = &sample["lateness"];
    let _ = writeln!(
        text,
        "\nlateness   p50 {:.0} µs  p99 {:.0} µs  max {:.0} µs   late {}  missed {}\n",
        number(&lateness["p50_us"]),
        number(&lateness["p99_us"]),
        number(&lateness["max_us"]),
        value("late"),
        value("missed")
    );
    let _ = writeln!(text, "serial     {}", sample["wire"]["serial"].as_str().unwrap_or_default());
    let can: Vec<&str> = sample["wire"]["can"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    let _ = writeln!(text, "can        {}\n", can.join("  "));
    for link in sample["links"].as_array().into_iter().flatten() {
        let _ = writeln!(
            text,
            "link       {}: {} clients, {} sent, {} dropped, {} replies",
            link["name"].as_str().unwrap_or_default(),
            link["clients"],
            link["sent"],
            link["dropped"],
            link["replies"]
        );
    }
    for fault in sample["faults"].as_array().into_iter().flatten().filter(|fault| fault["state"] != "over") {
        let _ = writeln!(text, "fault      {}", inject::line(fault));
    }
    text
}

fn flags(sample: &Value) -> String {
    let flags = number(&sample["unit_flags"]) as u8;
    let names = UNIT_FLAGS.iter().filter(|flag| flags & 1 << flag.bit != 0).map(|flag| flag.name.replace('_', " "));
    names.collect::<Vec<_>>().join(", ")
}
