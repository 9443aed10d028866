//! `geu bench model`: how fast the model runs, with every effect on, beside the same four gyros in numpy and those of
//! gnss-ins-sim.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use clap::Args;
use geu_daemon::record::{Destination, Recorder};
use geu_daemon::simulate::simulate;
use geu_model::configuration::WireForm;
use geu_model::effect::{Effects, HeadEffects, UnitEffects};
use geu_model::{Configuration, Truth, Unit};
use geu_protocol::Gyro;

use crate::failure::{Failure, say};

/// The same gyros, vectorised over time: what a Python user would write.
const NUMPY: &str = include_str!("model.py");
/// Another simulator's gyros: three, with fewer effects.
const GNSS_INS_SIM: &str = include_str!("model_gnss.py");
/// It keeps all samples and would take minutes for a million half seconds; its speed does not depend on their number.
const GNSS_INS_SIM_HALF_SECONDS: u64 = 20_000;

/// Arguments of `geu bench model`.
#[derive(Args)]
pub struct Arguments {
    /// Half seconds of each measurement
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    half_seconds: u64,
    /// Runs of each of our own measurements; the fastest counts
    #[arg(long, value_name = "N", default_value_t = 3)]
    runs: u32,
    /// Leave out numpy and gnss-ins-sim
    #[arg(long)]
    alone: bool,
}

/// Measures and prints.
///
/// # Errors
/// A temporary directory that cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let half_seconds = arguments.half_seconds.max(1);
    let reference = Configuration::reference();
    let all = every_effect()?;
    say!("{half_seconds} half seconds at the 0.1 s step, four gyros; fastest of {} runs", arguments.runs)?;
    let fastest = |measure: &mut dyn FnMut() -> Result<(), Failure>| -> Result<f64, Failure> {
        let mut best_s = f64::INFINITY;
        for _ in 0..arguments.runs.max(1) {
            let start = Instant::now();
            measure()?;
            best_s = best_s.min(start.elapsed().as_secs_f64());
        }
        Ok(half_seconds as f64 / best_s)
    };
    let show = |name: &str, per_s: f64, target: &str| say!("{name:<44} {per_s:>12.0} half seconds/s   {target}");
    let model = |configuration: &Configuration| {
        fastest(&mut || {
            let mut unit = Unit::new(configuration);
            let counted: i64 =
                (0..half_seconds).map(|_| i64::from(unit.end_half_second().half_second.increments[0])).sum();
            std::hint::black_box(counted);
            Ok(())
        })
    };
    let plain = model(&reference)?;
    let every = model(&all)?;
    show("reference unit, no output, one thread", plain, "")?;
    show("every effect, no output, one thread", every, "target 500 000, goal 1 000 000")?;
    let directory = tempfile::tempdir().map_err(Failure::failed)?;
    let written = fastest(&mut || {
        let mut recorder =
            Recorder::create(&Destination::new(directory.path(), true), &all, &Truth::Scenario, WireForm::Can, &[])
                .map_err(Failure::failed)?;
        simulate(&all, &Truth::Scenario, half_seconds, &mut recorder, |_| true).map_err(Failure::failed)?;
        recorder.finish().map_err(Failure::failed)
    })?;
    show("every effect, all files, two threads", written, "target 150 000")?;
    say!("memory at the end: {:.1} MB", memory_mb())?;
    if !arguments.alone {
        let counted = half_seconds.min(GNSS_INS_SIM_HALF_SECONDS);
        for (name, script, half_seconds, rows) in [
            ("numpy", NUMPY, half_seconds, &["every effect, no output"][..]),
            ("gnss-ins-sim", GNSS_INS_SIM, counted, &["trajectory and sensors", "three gyros alone"]),
        ] {
            match python(script, half_seconds, directory.path()) {
                Ok(speeds) => {
                    for (row, per_s) in rows.iter().zip(speeds) {
                        show(&format!("{name}, {row}"), per_s, &format!("ours {:.1} times", every / per_s))?;
                    }
                }
                Err(reason) => say!("{name} skipped: {reason}")?,
            }
        }
    }
    Ok(())
}

/// The reference unit with every amplitude of every effect that moves counts at a tenth of its largest value at most.
fn every_effect() -> Result<Configuration, Failure> {
    let mut overrides = Vec::new();
    let mut place =
        |place: &str, specs: &[geu_model::effect::EffectSpec], effects: &dyn Fn(usize) -> Vec<(String, f64)>| {
            for (index, spec) in specs.iter().enumerate() {
                overrides
                    .extend(effects(index).iter().map(|(name, size)| format!("{place}.{}.{name}={size:?}", spec.code)));
            }
        };
    let sizes = |numbers: &dyn geu_model::number::Numbers, amplitudes: usize, own: &dyn Fn(&str) -> bool| {
        let specs = numbers.specs().iter().take(amplitudes);
        specs.filter(|spec| own(spec.name)).map(|spec| (spec.name.to_owned(), spec.greatest * 1e-3)).collect::<Vec<_>>()
    };
    let (unit, head) = (UnitEffects::default(), HeadEffects::default());
    place("unit", UnitEffects::SPECS, &|index| {
        sizes(unit.numbers(index), UnitEffects::SPECS[index].amplitudes.len(), &|_| true)
    });
    for gyro in Gyro::ALL {
        let own = |name: &str| geu_model::package::Axes::of(gyro).has_number(name);
        place(&format!("gyro.{}", gyro.name()), HeadEffects::SPECS, &|index| {
            sizes(head.numbers(index), HeadEffects::SPECS[index].amplitudes.len(), &own)
        });
    }
    Configuration::reference_with(&overrides).map_err(Failure::failed)
}

fn memory_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    peak.and_then(|line| line.trim().trim_end_matches(" kB").parse::<f64>().ok()).unwrap_or(f64::NAN) / 1024.0
}

/// The numbers that a script prints.
fn python(script: &str, half_seconds: u64, directory: &Path) -> Result<Vec<f64>, String> {
    let file = directory.join("bench.py");
    std::fs::write(&file, script).map_err(|error| error.to_string())?;
    let output = Command::new("python3").arg(&file).arg(half_seconds.to_string()).output();
    let output = output.map_err(|error| format!("python3: {error}"))?;
    let speeds: Option<Vec<f64>> =
        String::from_utf8_lossy(&output.stdout).split_whitespace().map(|speed| speed.parse().ok()).collect();
    speeds
        .filter(|speeds| output.status.success() && !speeds.is_empty())
        .ok_or_else(|| String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or("no output").to_owned())
}
