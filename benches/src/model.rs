//! `geu-bench model`: speed of the model with every effect, beside the same four gyros in numpy and the gyros of gnss-ins-sim.

use std::path::Path;
use std::time::Instant;

use clap::Args;
use geu_model::effect::{Effects, GyroEffects, UnitEffects};
use geu_model::{Configuration, GyroUnit};
use geu_protocol::Gyro;
use geu_recorder::{Destination, record};

use crate::Result;
use crate::process::{python, status_mb};
use crate::rounds::{Contender, Results, Rounds, Spread};
use crate::table::Table;

/// Equal gyros in numpy, vectorised over time.
const NUMPY: &str = include_str!("model.py");
/// Another simulator's gyros: three, with fewer effects.
const GNSS_INS_SIM: &str = include_str!("model_gnss.py");
/// A sensor model of a spacecraft simulator: three gyros, with fewer effects.
const BASILISK: &str = include_str!("model_bsk.py");
/// gnss-ins-sim keeps all samples and would take minutes for a million samples; its speed does not depend on their number.
const GNSS_INS_SIM_SAMPLE_INTERVALS: u64 = 20_000;

/// The contender to which others are compared.
const EVERY: &str = "every effect, no output, one thread";
const WRITTEN: &str = "every effect, all files, two threads";
/// Thousand samples/s.
const TARGETS: [(&str, f64); 2] = [(EVERY, 1000.0), (WRITTEN, 500.0)];

/// Arguments of `geu-bench model`.
#[derive(Args)]
pub struct Arguments {
    /// Samples of each measurement
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    samples: u64,
    #[command(flatten)]
    rounds: Rounds,
    /// Leave out numpy, Basilisk and gnss-ins-sim
    #[arg(long)]
    alone: bool,
}

/// Measures and prints.
///
/// # Errors
/// The temporary directory cannot be written.
pub fn run(arguments: &Arguments) -> Result {
    let samples = arguments.samples.max(1);
    let reference = Configuration::reference();
    let all = every_effect()?;
    let directory = tempfile::tempdir()?;
    // Each run returns a speed, samples/s, for each of its rows.
    let timed = |work: &dyn Fn() -> Result<(), String>| -> Result<Vec<f64>, String> {
        let start = Instant::now();
        work()?;
        Ok(vec![samples as f64 / start.elapsed().as_secs_f64()])
    };
    let model = |configuration: &Configuration| {
        timed(&|| {
            let mut unit = GyroUnit::new(configuration);
            let counted: i64 = (0..samples).map(|_| i64::from(unit.end_sample().sample.increments[0])).sum();
            std::hint::black_box(counted);
            Ok(())
        })
    };
    let written = || {
        timed(&|| {
            let destination = Destination::new(directory.path(), true);
            record(&destination, &all, samples).map_err(|error| error.to_string())
        })
    };
    let mut contenders = vec![
        Contender::ours("reference unit, no output, one thread", || model(&reference)),
        Contender::ours(EVERY, || model(&all)),
        Contender::ours(WRITTEN, written),
    ];
    let scripts = directory.path();
    if !arguments.alone {
        let counted = samples.min(GNSS_INS_SIM_SAMPLE_INTERVALS);
        contenders.push(Contender::other("numpy", move || speeds_of(scripts, NUMPY, 1, samples)));
        contenders.push(Contender::other("Basilisk", move || speeds_of(scripts, BASILISK, 1, samples)));
        contenders.push(Contender::other("gnss-ins-sim", move || speeds_of(scripts, GNSS_INS_SIM, 2, counted)));
    }
    println!("samples/s at the 0.1 s step, {samples} samples; {}", arguments.rounds);
    let results = arguments.rounds.measure(contenders)?;
    let mut table =
        Table::new("model", &["", "thousand samples/s, median (min…max)", "target", "every effect, no output"]);
    let speeds = |runs: &[Vec<f64>], row: usize| -> Vec<f64> { runs.iter().map(|speeds| speeds[row]).collect() };
    let every = results.iter().find(|result| result.name == EVERY).and_then(|result| result.runs.as_ref().ok());
    let every = every.map(|runs| speeds(runs, 0)).unwrap_or_default();
    for Results { name, runs } in &results {
        let rows: &[&str] = match name.as_str() {
            "numpy" => &[", four gyros, every effect"],
            "Basilisk" => &[", imuSensor, three gyros"],
            "gnss-ins-sim" => &[", trajectory and sensors", ", three gyros alone"],
            _ => &[""],
        };
        let runs = match runs {
            Ok(runs) => runs,
            Err(reason) => {
                table.row([name.clone(), format!("skipped: {reason}")]);
                continue;
            }
        };
        for (row, label) in rows.iter().enumerate() {
            let per_s = speeds(runs, row);
            let speed = Spread::new(per_s.iter().map(|speed| speed * 1e-3));
            let target = TARGETS.iter().find(|(own, _)| own == name).map_or(String::new(), |(_, target)| {
                format!("{target}: {}", if speed.median >= *target { "met" } else { "missed" })
            });
            let ratio = match label.is_empty() {
                true => String::new(),
                false => format!("is {:.1} times as fast", Spread::of_ratios(&every, &per_s)),
            };
            table.row([format!("{name}{label}"), format!("{speed:.0}"), target, ratio]);
        }
    }
    println!("{table}");
    println!("memory at the end: {:.1} MB", status_mb("self", "VmHWM").unwrap_or(f64::NAN));
    Ok(())
}

/// The reference unit with every amplitude of every effect that moves counts at a tenth of its largest value at most.
fn every_effect() -> Result<Configuration> {
    let mut overrides = Vec::new();
    let mut place =
        |place: &str, specs: &[geu_model::effect::EffectSpec], effects: &dyn Fn(usize) -> Vec<(String, f64)>| {
            for (index, spec) in specs.iter().enumerate() {
                overrides
                    .extend(effects(index).iter().map(|(name, size)| format!("{place}.{}.{name}={size:?}", spec.code)));
            }
        };
    let sizes =
        |numbers: &dyn geu_model::parameter_spec::ParameterSet, amplitudes: usize, own: &dyn Fn(&str) -> bool| {
            let specs = numbers.specs().iter().take(amplitudes);
            specs.filter(|spec| own(spec.name)).map(|spec| (spec.name.to_owned(), spec.max * 1e-3)).collect::<Vec<_>>()
        };
    let (unit, head) = (UnitEffects::default(), GyroEffects::default());
    place("unit", UnitEffects::SPECS, &|index| {
        sizes(unit.numbers(index), UnitEffects::SPECS[index].amplitudes.len(), &|_| true)
    });
    for gyro in Gyro::ALL {
        let own = |name: &str| geu_model::package::Axes::of(gyro).has_number(name);
        place(&format!("gyro.{}", gyro.name()), GyroEffects::SPECS, &|index| {
            sizes(head.numbers(index), GyroEffects::SPECS[index].amplitudes.len(), &own)
        });
    }
    Ok(Configuration::reference_with(&overrides)?)
}

/// The speeds that a script prints, one for each row.
fn speeds_of(directory: &Path, script: &str, rows: usize, samples: u64) -> Result<Vec<f64>, String> {
    let text = python(directory, script, &[&samples.to_string()])?.text()?;
    let speeds: Option<Vec<f64>> = text.split_whitespace().map(|speed| speed.parse().ok()).collect();
    speeds.filter(|speeds| speeds.len() == rows).ok_or_else(|| format!("expected {rows} speeds, got {text}"))
}
