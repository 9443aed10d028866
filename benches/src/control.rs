//! `geu-bench control`: effect of clients of the control interface on the cadence.
//!
//! Two emulators run side by side, one with a control interface and one without, in turn alone and with clients: a page,
//! eight event clients and a client with a thousand requests a second. Both run on the same machine with the same load, so
//! that the effect of the interface is separate from the processor time of the clients.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use geu_model::units::duration_s;
use serde_json::Value;
use ureq::Agent;

use crate::Result;
use crate::process::Emulator;
use crate::rounds::{Rounds, Spread};
use crate::table::Table;

/// Event clients, beside the page.
const EVENT_CLIENTS: usize = 8;
/// Requests of the client that sends requests.
const REQUESTS_PER_S: u64 = 1000;

/// Arguments of `geu-bench control`.
#[derive(Args)]
pub struct Arguments {
    /// Length of each run, alone or with clients
    #[arg(long, value_name = "DURATION", default_value = "40s", value_parser = |text: &str| duration_s(text, 2.0, 86_400.0))]
    duration: f64,
    #[command(flatten)]
    rounds: Rounds,
    /// Browser to open the page without a window [default: a ninth event client in its place]
    #[arg(long, value_name = "PROGRAM")]
    browser: Option<String>,
}

/// Measures and prints.
///
/// # Errors
/// An emulator or the browser does not start.
pub fn run(arguments: &Arguments) -> Result {
    let part = Duration::from_secs_f64(arguments.duration);
    println!("alone and with clients, {} s in turn; {}", part.as_secs_f64(), arguments.rounds);
    let mut table = Table::new("control", &["round", "clients", "lateness, open", "lateness, `--control off`"]);
    let mut differences_us = Vec::new();
    for round in 1..=arguments.rounds.count() {
        let mut medians_us = [0.0; 2];
        for (median_us, clients) in medians_us.iter_mut().zip([None, Some(arguments.browser.as_deref())]) {
            let (reached_us, requests, lateness) = run_once(part, clients)?;
            *median_us = reached_us;
            table.row([round.to_string(), requests].into_iter().chain(lateness));
        }
        differences_us.push(medians_us[1] - medians_us[0]);
    }
    let difference = format!("{:+.1} µs", Spread::new(differences_us));
    table.row(["all".to_owned(), "median with clients minus that without".to_owned(), difference]);
    println!("{table}");
    Ok(())
}

/// Runs both emulators, the open one with clients and perhaps a browser. Returns the median of the open one, µs, what the clients did, and
/// the lateness of both.
fn run_once(part: Duration, clients: Option<Option<&str>>) -> Result<(f64, String, [String; 2])> {
    let mut open = Emulator::start(None, &["--control", "127.0.0.1:0"])?;
    let address = open.process.control_address();
    let address = address.map_err(|_| "geu run: no control interface became ready")?;
    let closed = Emulator::start(None, &["--control", "off"])?;
    let load = clients.map(|browser| Load::start(&address, browser)).transpose()?;
    let (agent, start) = (Agent::new_with_defaults(), Instant::now());
    let mut last = Value::Null;
    while start.elapsed() < part {
        thread::sleep(part.saturating_sub(start.elapsed()).min(Duration::from_secs(1)));
        last = status(&agent, &address)?["lateness"].clone();
    }
    let page = if clients.flatten().is_some() { " and a page" } else { " and one more" };
    let clients = load.map_or("none".to_owned(), |load| {
        let (asked, events) = load.end();
        format!("{:.0} requests/s, {events} events to {EVENT_CLIENTS} clients{page}", asked as f64 / part.as_secs_f64())
    });
    let lateness = [open, closed].map(|emulator| {
        let stderr = emulator.end();
        let line = stderr.lines().find_map(|line| line.strip_prefix("lateness")).unwrap_or("no lateness printed");
        line.trim().to_owned()
    });
    let median_us = last["p50_us"].as_f64().ok_or("/api/status: expected a median of the lateness, got none")?;
    Ok((median_us, clients, lateness))
}

/// State of the emulator.
fn status(agent: &Agent, address: &str) -> Result<Value, ureq::Error> {
    agent.get(format!("http://{address}/api/status")).call()?.body_mut().read_json()
}

/// The clients.
struct Load {
    stop: Arc<AtomicBool>,
    asked: Arc<AtomicU64>,
    received: Arc<AtomicU64>,
    browser: Option<Child>,
    asker: thread::JoinHandle<()>,
}

impl Load {
    fn start(address: &str, browser: Option<&str>) -> Result<Load> {
        let (stop, asked, received): (Arc<AtomicBool>, Arc<AtomicU64>, Arc<AtomicU64>) = Default::default();
        let pages = if browser.is_some() { 0 } else { 1 };
        for _ in 0..EVENT_CLIENTS + pages {
            let events = ureq::get(format!("http://{address}/api/events")).call()?.into_body().into_reader();
            let received = received.clone();
            // Ends with the emulator.
            thread::spawn(move || {
                let lines = BufReader::new(events).lines().map_while(Result::ok);
                lines.filter(|line| line.starts_with("data:")).for_each(|_| {
                    let _ = received.fetch_add(1, Relaxed);
                });
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
                .map_err(|error| format!("--browser {program}: {error}; expected Chromium"))
        });
        let browser = browser.transpose()?;
        let asker = thread::spawn({
            let (address, stop, asked) = (address.to_owned(), stop.clone(), asked.clone());
            move || {
                let (agent, start) = (Agent::new_with_defaults(), Instant::now());
                for count in 1.. {
                    let due = Duration::from_nanos(count * 1_000_000_000 / REQUESTS_PER_S);
                    thread::sleep(due.saturating_sub(start.elapsed()));
                    if stop.load(Relaxed) || status(&agent, &address).is_err() {
                        return;
                    }
                    asked.fetch_add(1, Relaxed);
                }
            }
        });
        Ok(Load { stop, asked, received, browser, asker })
    }

    /// Requests answered and events received.
    fn end(mut self) -> (u64, u64) {
        self.stop.store(true, Relaxed);
        let _ = self.asker.join();
        if let Some(browser) = &mut self.browser {
            let _ = browser.kill();
            let _ = browser.wait();
        }
        (self.asked.load(Relaxed), self.received.load(Relaxed))
    }
}
