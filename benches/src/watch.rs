//! `geu-bench watch`: false alarms of `geu watch` on healthy units, and the delay of its alarms by fault.
//!
//! A fault is a step of twelve times the sigma that the same step, within the three hours of the blind trial, has there.

use clap::{Args, Subcommand, value_parser};
use geu_blind::{Origin, SURVEY_S, TrialMotion, on_threads, simulate};
use geu_hypothesis::Hypothesis;
use geu_model::Configuration;
use geu_protocol::Gyro;
use geu_watch::{Event, Monitor, THRESHOLD, Watch};

use crate::Result;

/// Strength of the faults, sigmas.
const STRENGTH: f64 = 12.0;
/// Onsets of the step that is sized, as a share of those hours; the one at which it shows best counts.
const SHARES: [f64; 3] = [0.08, 0.5, 0.8];
/// Steps: code of the fault, code that names it, and its amplitude.
const FAULTS: [(&str, &str, &str); 3] = [
    ("drift-step", "drift", "arcsec_per_h"),
    ("pivot-clearance-step", "pivot-clearance", "clearance_arcsec"),
    ("scale-factor-step", "scale-factor", "ppm"),
];
/// Length of a run with a fault, its first onset, and the time by which that of the next run is later, s: not a divisor of any manoeuvre.
const LENGTH_S: f64 = 43_200.0;
const ONSET_S: f64 = 9_000.0;
const LATER_S: f64 = 1_237.0;

/// Arguments of `geu-bench watch`.
#[derive(Args)]
pub struct Arguments {
    #[command(subcommand)]
    of: Of,
}

#[derive(Subcommand)]
enum Of {
    /// Alarms on healthy units
    Healthy(Runs),
    /// Delay by fault and gyro
    Faults(Runs),
}

#[derive(Args)]
struct Runs {
    /// Random seed of the first run
    #[arg(long, value_name = "N", value_parser = value_parser!(u64).range(..1 << 40))]
    seed: u64,
    /// Runs: days of a healthy unit, or of each fault on each gyro
    #[arg(long, value_name = "N", default_value_t = 4)]
    runs: usize,
    /// Only this fault
    #[arg(long, value_name = "CODE")]
    only: Option<String>,
    /// The redundant pair alone, without reference
    #[arg(long)]
    pair: bool,
    /// Print the events
    #[arg(long)]
    events: bool,
    /// Assignments of the configuration, of the unit and of its model
    #[arg(long = "set", value_name = "PATH=VALUE")]
    overrides: Vec<String>,
    /// Assignments of the configuration, of the unit alone
    #[arg(long, value_name = "PATH=VALUE")]
    unit: Vec<String>,
}

impl Runs {
    fn configuration(&self, more: &[String]) -> Result<Configuration> {
        Ok(Configuration::reference_with(&[&self.overrides, more].concat())?)
    }

    /// The largest statistic without an alarm, and the events.
    fn watch(&self, seed: u64, length_s: f64, more: &[String]) -> Result<(f64, Vec<Event>)> {
        let own = [self.unit.as_slice(), more, &[format!("seed={seed}")]].concat();
        let recording = simulate(&self.configuration(&own)?, length_s);
        let reference = (!self.pair).then(|| recording.reference.clone());
        let mut monitor = Monitor::new(&self.configuration(&[])?, reference, false);
        let events: Vec<Event> = recording.rows.iter().flat_map(|row| monitor.push(row)).collect();
        if self.events {
            events.iter().for_each(|event| println!("{}", event.json()));
        }
        Ok((monitor.largest(), events))
    }
}

/// Runs the benchmark.
///
/// # Errors
/// A configuration is not valid.
pub fn run(arguments: &Arguments) -> Result {
    match &arguments.of {
        Of::Healthy(runs) => healthy(runs),
        Of::Faults(runs) => faults(runs),
    }
}

fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

fn healthy(runs: &Runs) -> Result {
    let days = on_threads(threads(), runs.runs, &|day| {
        runs.watch(runs.seed + day as u64, 86_400.0, &[]).map_err(|error| error.to_string())
    });
    let (mut largest, mut alarms) = (Vec::new(), 0);
    for day in days {
        let (statistic, events) = day?;
        largest.push(statistic);
        alarms += events.iter().filter(|event| event.event == "alarm").count();
    }
    largest.sort_by(|a, b| b.total_cmp(a));
    let largest: Vec<String> = largest.iter().map(|statistic| format!("{statistic:.1}")).collect();
    println!("days {}, alarms {alarms}, threshold {THRESHOLD}, largest by day {}", runs.runs, largest.join(" "));
    Ok(())
}

fn faults(runs: &Runs) -> Result {
    let motion = TrialMotion::new(runs.configuration(&[])?, SURVEY_S)?;
    println!("| fault | gyro | size | alarms | after, min | named | after, min | otherwise |");
    println!("|---|---|---|---|---|---|---|---|");
    let is_asked = |code: &str| runs.only.as_ref().is_none_or(|only| only == code);
    for (code, name, amplitude) in FAULTS.into_iter().filter(|(code, ..)| is_asked(code)) {
        for gyro in Gyro::ALL {
            let gyros = geu_protocol::Gyros::ALL.only(gyro.index());
            let sized = SHARES.iter().filter_map(|share| {
                let value = |number: &str| match number {
                    "time_s" => Some(share * SURVEY_S),
                    number => (number == amplitude).then_some(0.0),
                };
                let step = Hypothesis::from_numbers(code, None, gyros, value)?;
                Some(motion.scaled(step, Origin::Catalogue, 1.0, STRENGTH)?.hypothesis.value)
            });
            let size = sized.min_by(f64::total_cmp).ok_or("a fault of that size")?;
            let results = on_threads(threads(), runs.runs, &|run| {
                let onset_s = ONSET_S + LATER_S * run as f64;
                let path = format!("gyro.{}.{code}", gyro.name());
                let more = [format!("{path}.{amplitude}={size}"), format!("{path}.time_s={onset_s}")];
                let watched = runs.watch(runs.seed + run as u64, LENGTH_S, &more).map_err(|error| error.to_string());
                watched.map(|(_, events)| Outcome::new(&events, onset_s, gyro, name))
            });
            let outcomes = results.into_iter().collect::<Result<Vec<Outcome>, String>>()?;
            print(code, gyro, size, &outcomes);
        }
    }
    Ok(())
}

/// Events of a run with a fault.
#[derive(Debug, Default)]
struct Outcome {
    /// Delays of alarm and name, s.
    alarm_s: Option<f64>,
    name_s: Option<f64>,
    /// Wrong gyros, names, alarms before the onset and second ones.
    others: Vec<String>,
}

impl Outcome {
    fn new(events: &[Event], onset_s: f64, gyro: Gyro, name: &str) -> Outcome {
        let mut outcome = Outcome::default();
        for event in events.iter().filter(|event| ["alarm", "named"].contains(&event.event)) {
            let delay_s = event.t_s - onset_s;
            let is_own = event.gyros[gyro.index()] && delay_s >= 0.0;
            match event.event {
                "alarm" if is_own && outcome.alarm_s.is_none() => outcome.alarm_s = Some(delay_s),
                "named" if is_own && event.code == name => outcome.name_s = outcome.name_s.or(Some(delay_s)),
                _ => outcome.others.push(format!("{} {} {:.0}", event.event, event.code, delay_s / 60.0)),
            }
        }
        outcome
    }
}

fn print(code: &str, gyro: Gyro, size: f64, outcomes: &[Outcome]) {
    let delays = |of: &dyn Fn(&Outcome) -> Option<f64>| {
        let mut delays: Vec<f64> = outcomes.iter().filter_map(of).map(|delay_s| delay_s / 60.0).collect();
        delays.sort_by(f64::total_cmp);
        let [first, middle, last] = [0, delays.len() / 2, delays.len().saturating_sub(1)]
            .map(|index| delays.get(index).map_or("–".to_owned(), |delay| format!("{delay:.0}")));
        format!("{} of {} | {first} … {middle} … {last}", delays.len(), outcomes.len())
    };
    let (alarms, names) = (delays(&|outcome| outcome.alarm_s), delays(&|outcome| outcome.name_s));
    let others: Vec<String> = outcomes.iter().flat_map(|outcome| outcome.others.clone()).collect();
    println!("| `{code}` | {} | {size:.3} | {alarms} | {names} | {} |", gyro.name(), others.join(", "));
}
