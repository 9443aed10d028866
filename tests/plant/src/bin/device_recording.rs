//! Makes a recording of a described unit with injected effects, with a reference and the truth.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Parser, ValueEnum};
use geu_plant::{Case, DeviceEffect, DeviceMotionKind, DevicePlant, DeviceRecording, DeviceUnit, Mix, Wire};

#[derive(Clone, Copy, ValueEnum)]
enum MixName {
    /// Twenty: four bias steps, four without an effect, two of each other.
    Effects,
    /// Wiring, link and large errors.
    Exact,
}

/// Writes link.bin or link.log, reference.csv and truth.json of a described unit.
#[derive(Parser)]
struct Arguments {
    /// stim300, tetrad or mm5.10
    #[arg(long)]
    device: String,
    /// Seed of errors, noises and draws
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Run of the campaign, which draws effect, motion and reference
    #[arg(long, default_value_t = 0)]
    run: u64,
    /// Effects of the campaign
    #[arg(long, default_value = "effects")]
    mix: MixName,
    /// Effect in place of the drawn one, `CODE@HEAD,HEAD:NAME=VALUE,NAME=VALUE`, without heads for all; several make a combination, `null` has none
    #[arg(long, value_name = "EFFECT")]
    effect: Vec<String>,
    /// table, vehicle or hand [default: drawn]
    #[arg(long)]
    motion: Option<String>,
    /// Length in s [default: that of a campaign]
    #[arg(long)]
    duration: Option<f64>,
    /// Rows of the reference a second [default: that of a campaign]
    #[arg(long)]
    rows_hz: Option<f64>,
    /// White noise of each row's attitude, arcsec [default: that of a campaign]
    #[arg(long)]
    sigma: Option<f64>,
    /// Gap of the reference, s from its start
    #[arg(long, value_name = "START,END")]
    gap: Vec<String>,
    /// Directory
    #[arg(long)]
    out: PathBuf,
}

fn effect(unit: &DeviceUnit, text: &str) -> Result<DeviceEffect, String> {
    let (place, parameters) = text.split_once(':').unwrap_or((text, ""));
    let (code, heads) = place.split_once('@').unwrap_or((place, ""));
    let head = |name: &str| unit.head(name).ok_or_else(|| format!("{text}: {} has no head {name}", unit.name));
    let heads: Vec<usize> = heads.split(',').filter(|name| !name.is_empty()).map(head).collect::<Result<_, _>>()?;
    let parameter = |text: &'_ str| {
        let (name, value) = text.split_once('=').ok_or_else(|| format!("{text}: expected NAME=VALUE"))?;
        Ok((name.to_owned(), value.parse().map_err(|_| format!("{text}: expected a number"))?))
    };
    let parameters = parameters.split(',').filter(|text| !text.is_empty()).map(parameter);
    let parameters: Vec<(String, f64)> = parameters.collect::<Result<_, String>>()?;
    let parameters: Vec<(&str, f64)> = parameters.iter().map(|(name, value)| (name.as_str(), *value)).collect();
    DeviceEffect::new(code, &heads, &parameters)
}

fn plant(arguments: &Arguments) -> Result<(String, DevicePlant), String> {
    let unit = DeviceUnit::all().into_iter().find(|unit| unit.name == arguments.device);
    let unit = unit.ok_or_else(|| format!("{}: expected stim300, tetrad or mm5.10", arguments.device))?;
    let mix = match arguments.mix {
        MixName::Effects => Mix::Effects,
        MixName::Exact => Mix::Exact,
    };
    let motion = match &arguments.motion {
        None => None,
        Some(name) => {
            let motion = DeviceMotionKind::ALL.into_iter().find(|kind| kind.name() == name);
            Some(motion.ok_or_else(|| format!("{name}: expected table, vehicle or hand"))?)
        }
    };
    let Case { mut code, mut plant } =
        Case::drawn(&unit, mix, arguments.seed, arguments.run, motion, arguments.duration);
    if !arguments.effect.is_empty() {
        let own = arguments.effect.iter().filter(|text| *text != "null");
        plant.effects = own.map(|text| effect(&unit, text)).collect::<Result<_, _>>()?;
        let codes: Vec<&str> = plant.effects.iter().map(|effect| effect.code.as_str()).collect();
        code = if codes.is_empty() { "null".to_owned() } else { codes.join(" ") };
    }
    let reference = &mut plant.reference;
    reference.rows_hz = arguments.rows_hz.unwrap_or(reference.rows_hz);
    reference.sigma_arcsec = arguments.sigma.unwrap_or(reference.sigma_arcsec);
    for text in &arguments.gap {
        let edges: Vec<f64> = text.split(',').filter_map(|text| text.parse().ok()).collect();
        reference.gaps_s.push(edges.try_into().map_err(|_| format!("{text}: expected START,END"))?);
    }
    Ok((code, plant))
}

fn truth(code: &str, plant: &DevicePlant, recording: &DeviceRecording) -> String {
    let DevicePlant { unit, reference, .. } = plant;
    let link = link_name(unit);
    let mut text = format!("{{\"device\": \"{}\", \"code\": \"{code}\", \"link\": \"{link}\",\n", unit.name);
    let _ = writeln!(text, " \"motion\": \"{}\", \"duration_s\": {},", plant.motion.name(), plant.duration_s);
    let kind = if reference.is_attitude { "quaternions" } else { "rates" };
    let _ = writeln!(text, " \"reference\": \"{kind}\", \"sigma_arcsec\": {},", reference.sigma_arcsec);
    let effects: Vec<String> = plant.effects.iter().map(|effect| of_effect(unit, effect)).collect();
    let _ = writeln!(text, " \"effects\": [{}],", effects.join(", "));
    let heads = unit.heads.iter().zip(&recording.heads).map(|((name, _), head)| {
        let [x, y, z] = head.input;
        format!(
            "{{\"name\": \"{name}\", \"scale_factor_ppm\": {}, \"drift_arcsec_per_h\": {}, \"input\": [{x}, {y}, {z}]}}",
            head.scale_factor_ppm, head.drift_arcsec_h
        )
    });
    let _ = writeln!(text, " \"heads\": [\n  {}]}}", heads.collect::<Vec<_>>().join(",\n  "));
    text
}

fn of_effect(unit: &DeviceUnit, effect: &DeviceEffect) -> String {
    let all: Vec<usize> = (0..unit.heads.len()).collect();
    let heads = if effect.heads.is_empty() { &all } else { &effect.heads };
    let heads: Vec<String> = heads.iter().map(|head| format!("\"{}\"", unit.heads[*head].0)).collect();
    let parameters: Vec<String> =
        effect.parameters.iter().map(|(name, value)| format!("\"{name}\": {value}")).collect();
    format!(
        "{{\"code\": \"{}\", \"heads\": [{}], \"parameters\": {{{}}}}}",
        effect.code,
        heads.join(", "),
        parameters.join(", ")
    )
}

fn link_name(unit: &DeviceUnit) -> &'static str {
    if unit.wire == Wire::Mm510 { "link.log" } else { "link.bin" }
}

fn written(out: &Path, name: &str, bytes: &[u8]) -> Result<(), String> {
    fs::write(out.join(name), bytes).map_err(|error| format!("{}: {error}", out.join(name).display()))
}

fn run() -> Result<(), String> {
    let arguments = Arguments::parse();
    let (code, plant) = plant(&arguments)?;
    let recording = plant.record(false);
    fs::create_dir_all(&arguments.out).map_err(|error| format!("{}: {error}", arguments.out.display()))?;
    written(&arguments.out, link_name(&plant.unit), &recording.link)?;
    written(&arguments.out, "reference.csv", recording.reference.as_bytes())?;
    written(&arguments.out, "truth.json", truth(&code, &plant, &recording).as_bytes())
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(2)
        }
    }
}
