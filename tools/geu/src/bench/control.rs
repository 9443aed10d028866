//! `geu bench control`: what watching and asking cost the cadence.
//!
//! Two emulators run side by side, one with its control interface open and one without; in turn alone, and while a page,
//! eight event clients and a client that asks a thousand times a second are at the open one. Both meet the same machine and
//! the same load, so that what the interface itself costs is seen apart from what the clients take of the processor.

use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use geu_process::EmulatorProcess;
use serde_json::Value;
use ureq::http::Method;

use super::rounds::{Rounds, Spread};
use crate::control::ControlClient as Client;
use crate::failure::{CommandError, say};
use crate::settings::duration;

/// Event clients, beside the page.
const EVENT_CLIENTS: usize = 8;
/// Questions of the one client that asks.
const REQUESTS_PER_S: u64 = 1000;

/// Arguments of `geu bench control`.
#[derive(Args)]
pub struct Arguments {
    /// Length of each run, alone or with clients
    #[arg(long, value_name = "DURATION", default_value = "40s", value_parser = duration(2.0, 86_400.0))]
    duration: f64,
    #[command(flatten)]
    rounds: Rounds,
    /// Browser that opens the page without a window; without one, a ninth event client stands for it
    #[arg(long, value_name = "PROGRAM")]
    browser: Option<String>,
}

/// Measures.
///
/// # Errors
/// An emulator that does not start, a browser that is not there.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let part = Duration::from_secs_f64(arguments.duration);
    say!("alone and with clients, {} s in turn; {}", part.as_secs_f64(), arguments.rounds)?;
    let mut later_us = Vec::new();
    for round in 1..=arguments.rounds.count() {
        say!("round {round}")?;
        let alone_us = run_once(part, None)?;
        let loaded_us = run_once(part, Some(arguments.browser.as_deref()))?;
        later_us.push(loaded_us - alone_us);
    }
    say!("median lateness with clients less alone, µs: {:+.1}", Spread::of(later_us))
}

/// Runs both emulators, the open one with clients and perhaps a browser, and tells their lateness; the median of the open one, µs.
fn run_once(part: Duration, clients: Option<Option<&str>>) -> Result<f64, CommandError> {
    let (open, closed) = (Emulator::start(true)?, Emulator::start(false)?);
    let load = clients.map(|browser| Load::start(&open.address, browser)).transpose()?;
    let start = Instant::now();
    let mut last = Value::Null;
    while start.elapsed() < part {
        thread::sleep(part.saturating_sub(start.elapsed()).min(Duration::from_secs(1)));
        last = open.client().ask(Method::GET, "/api/status", None)?["lateness"].clone();
    }
    say!("  {}", if clients.is_some() { "with clients" } else { "alone" })?;
    if let Some(load) = load {
        let (asked, told) = load.end();
        let per_s = asked as f64 / part.as_secs_f64();
        say!("    {asked} requests ({per_s:.0}/s), {told} events to {EVENT_CLIENTS} clients and a page")?;
    }
    for (name, emulator) in [("control interface open", open), ("--control off", closed)] {
        say!("    {name:<24} {}", emulator.end())?;
    }
    Ok(last["p50_us"].as_f64().unwrap_or(f64::NAN))
}

/// An emulator as a process of its own.
struct Emulator {
    process: EmulatorProcess,
    address: String,
    /// Of the symlink.
    _directory: tempfile::TempDir,
}

impl Emulator {
    fn start(is_open: bool) -> Result<Emulator, CommandError> {
        let directory = tempfile::tempdir().map_err(CommandError::failed)?;
        let mut command = Command::new(std::env::current_exe().map_err(CommandError::failed)?);
        command.arg("run").arg("--pty").arg(directory.path().join("geu0"));
        command.args(["--control", if is_open { "127.0.0.1:0" } else { "off" }]);
        let mut process = EmulatorProcess::start(command).map_err(CommandError::failed)?;
        let address = if is_open { process.control_address() } else { Ok(String::new()) };
        let address = address.map_err(|_| CommandError::failed("geu run: no control interface became ready"))?;
        Ok(Emulator { process, address, _directory: directory })
    }

    fn client(&self) -> Client {
        Client::at(&self.address)
    }

    /// Asks it to end; its line on lateness.
    fn end(self) -> String {
        let _ = self.process.terminate();
        let text = self.process.wait().map(|(_, text)| text).unwrap_or_default();
        let lateness = text.lines().find_map(|line| line.strip_prefix("lateness"));
        lateness.unwrap_or("no lateness told").trim().to_owned()
    }
}

/// The clients.
struct Load {
    stop: Arc<AtomicBool>,
    asked: Arc<AtomicU64>,
    told: Arc<AtomicU64>,
    browser: Option<Child>,
    asker: thread::JoinHandle<()>,
}

impl Load {
    fn start(address: &str, browser: Option<&str>) -> Result<Load, CommandError> {
        let (stop, asked, told): (Arc<AtomicBool>, Arc<AtomicU64>, Arc<AtomicU64>) = Default::default();
        let pages = if browser.is_some() { 0 } else { 1 };
        for _ in 0..EVENT_CLIENTS + pages {
            let (events, told) = (Client::at(address).follow()?, told.clone());
            // Ends with the emulator.
            thread::spawn(move || {
                events.for_each(|_| {
                    let _ = told.fetch_add(1, Relaxed);
                })
            });
        }
        let browser = browser.map(|program| {
            Command::new(program)
                .args([
                    "--headless=new",
                    "--no-sandbox",
                    "--disable-gpu",
                    "--remote-debugging-port=0",
                    &format!("http://{address}/"),
                ])
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .map_err(|error| CommandError::input(format!("--browser {program}: {error}; expected Chromium")))
        });
        let browser = browser.transpose()?;
        let asker = thread::spawn({
            let (client, stop, asked) = (Client::at(address), stop.clone(), asked.clone());
            move || {
                let start = Instant::now();
                for count in 1.. {
                    let due = Duration::from_nanos(count * 1_000_000_000 / REQUESTS_PER_S);
                    thread::sleep(due.saturating_sub(start.elapsed()));
                    if stop.load(Relaxed) || client.ask(Method::GET, "/api/status", None).is_err() {
                        return;
                    }
                    asked.fetch_add(1, Relaxed);
                }
            }
        });
        Ok(Load { stop, asked, told, browser, asker })
    }

    /// Requests answered and events received.
    fn end(mut self) -> (u64, u64) {
        self.stop.store(true, Relaxed);
        let _ = self.asker.join();
        if let Some(browser) = &mut self.browser {
            let _ = browser.kill();
            let _ = browser.wait();
        }
        (self.asked.load(Relaxed), self.told.load(Relaxed))
    }
}
