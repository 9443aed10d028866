//! `geu calibrate --update`: scale factor and drift of the Z gyros between checkouts.

use std::fmt::Write;
use std::path::PathBuf;

use clap::Args;
use geu_calibration::compare::LEAST_PROBABILITY;
use geu_calibration::solve::{Parameter, values};
use geu_calibration::upkeep::{
    BEYOND_SIGMAS, Change, DRIFT_PER_FORTNIGHT, FORTNIGHT_S, GYROS, PARAMETERS, SCALE_FACTOR_PER_FORTNIGHT,
    SCALE_FACTOR_PER_HALF_HOUR, summary,
};
use geu_calibration::window::Window;
use geu_calibration::{Attitude, Believed, Counts, Known, Upkeep, report, update};
use geu_model::Configuration;
use geu_model::units::S_PER_DAY;

use crate::failure::{Failure, note, say};
use crate::outputs::{OutputFile, write_all};
use crate::settings::Settings;

/// What an update takes beside a calibration.
#[derive(Args, Debug)]
pub struct Update {
    /// Refine scale factor and drift of the Z gyros by survey scans, and say when a redetermination is due
    #[arg(long, conflicts_with_all = ["html", "compare"])]
    pub update: bool,
    /// With --update: when the believed values were determined [default: what --known tells, else a fortnight before]
    #[arg(long, value_name = "UNIX_SECONDS", allow_negative_numbers = true, requires = "update", value_parser = crate::settings::start)]
    calibrated: Option<f64>,
    /// With --update: JSON of the calibration or update that gave the believed values, for their sigmas
    #[arg(long, value_name = "FILE", requires = "update")]
    known: Option<PathBuf>,
}

/// Where results go.
pub struct Results<'a> {
    /// JSON.
    pub json: Option<&'a OutputFile>,
    /// Configuration.
    pub out: Option<&'a OutputFile>,
}

/// Carries it out.
///
/// # Errors
/// A recording without suitable scans, files that cannot be read or written.
pub fn run(
    arguments: &Update,
    (settings, configuration): (&Settings, &Configuration),
    counts: &Counts,
    legs: Option<&[Window]>,
    attitude: &Attitude,
    results: &Results,
) -> Result<(), Failure> {
    let known = known(arguments, counts)?;
    let upkeep = update(configuration, &known, counts, legs, attitude).map_err(Failure::input)?;
    for line in summary(&upkeep.left_out) {
        note(format_args!("geu: left out: {line}\n"));
    }
    let mut outputs: Vec<_> = results.json.map(|file| (file, format!("{:#}\n", upkeep.json()))).into_iter().collect();
    if let Some(file) = results.out {
        let (name, text) = settings.text()?;
        let mut values = settings.overrides.clone();
        values.extend(report::overrides_of(PARAMETERS, &upkeep.calibrations));
        outputs.push((file, Configuration::edited(&name, &text, &values).map_err(Failure::input)?));
    }
    write_all(outputs)?;
    say!("{}", table(&upkeep))
}

/// How well the believed values are known, and since when; what is assumed is said.
fn known(arguments: &Update, counts: &Counts) -> Result<Known, Failure> {
    let start_s = counts.start_ns as f64 * 1e-9;
    let mut known = Known::by_checkout(start_s - FORTNIGHT_S);
    let mut at_s = arguments.calibrated;
    if let Some(path) = &arguments.known {
        let name = path.display();
        let text = geu_recording::read_text(path).map_err(|error| {
            Failure::input(format!(
                "{name}: cannot be read: {error}; expected JSON as `geu calibrate --json` writes it"
            ))
        })?;
        let told = Believed::parse(&name.to_string(), &text, &[]).map_err(Failure::input)?;
        known.sigmas = values(&told.sigmas);
        if let Some((parameter, _)) = Parameter::all().zip(known.sigmas).find(|(_, sigma)| *sigma <= 0.0) {
            return Err(Failure::input(format!(
                "{name}: {}: expected a sigma, as `geu calibrate --json` writes one, got none",
                parameter.words()
            )));
        }
        let json = serde_json::from_str::<serde_json::Value>(&text).ok();
        at_s = at_s.or_else(|| json?.get("time_s")?.as_f64());
    } else {
        note(format_args!(
            "geu: taken as known at the calibration: scale factors to {:.0} ppm, drifts to {:.0} arcsec/h, misalignments \
             to {:.0} arcsec, as a checkout gives them; --known FILE tells better\n",
            Known::BY_CHECKOUT[0] * 1e6,
            Known::BY_CHECKOUT[1] * 7200.0,
            Known::BY_CHECKOUT[2]
        ));
    }
    match at_s {
        Some(at_s) => known.at_s = at_s,
        None => note(format_args!(
            "geu: the calibration is taken as a fortnight older than the recording, at {:.0} s; --calibrated UNIX_SECONDS \
             tells better\n",
            known.at_s
        )),
    }
    Ok(known)
}

/// A value's unit and digits: scale factors relative with changes in ppm, drifts in arcsec/h.
fn told(change: &Change) -> (String, f64, &'static str) {
    match change.parameter.index {
        0 => (format!("{:>12.7} {:>12.7}", change.old, change.new), 1e6, "ppm"),
        _ => (format!("{:>12.6} {:>12.6}", change.old, change.new), 7200.0, "arcsec/h"),
    }
}

/// The result for a terminal.
fn table(upkeep: &Upkeep) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{:<20} {:>12} {:>12} {:>10} {:>10} {:>8} {:>8}  {:<9} {:>8} {:>10}  verdict",
        "parameter", "old", "new", "old sigma", "new sigma", "change", "allowed", "unit", "change/σ", "surprise/σ"
    );
    for change in &upkeep.changes {
        let (values, size, unit) = told(change);
        let verdict = if change.is_beyond_stability() {
            "more than stability allows"
        } else if !change.is_told() {
            "the scans tell little of it"
        } else if change.is_significant() {
            "changed"
        } else {
            "the same within 3 sigma"
        };
        let _ = writeln!(
            text,
            "{:<20} {values} {:>10.3} {:>10.3} {:>+8.3} {:>8.3}  {unit:<9} {:>+8.1} {:>+10.1}  {verdict}",
            change.parameter.words(),
            change.old_sigma * size,
            change.new_sigma * size,
            change.change() * size,
            change.allowed * size,
            change.change() / change.new_sigma,
            change.beyond_stability(),
        );
    }
    let _ = writeln!(
        text,
        "old sigma: the calibration's, aged by the stability figures and the configured walk; values of drifts in arcsec per half \
         second, new at the end of the scans; surprise: the change over what those sigmas explain"
    );
    used(&mut text, upkeep);
    let _ = writeln!(
        text,
        "χ² {:.1} of {} equations, probability {:.2}; electronics over the scans {:+.1} K from the calibration's",
        upkeep.chi2,
        upkeep.degrees_of_freedom,
        upkeep.probability(),
        upkeep.electronics_above_k
    );
    for (index, gyro) in GYROS.iter().enumerate() {
        let rho = upkeep.correlation[(2 * index, 2 * index + 1)];
        let [scale_factor, drift] = [0, 1].map(|of| &upkeep.changes[2 * index + of]);
        debug_assert!([scale_factor, drift].iter().all(|change| change.parameter.gyro == *gyro));
        if !drift.is_told() {
            let _ = writeln!(
                text,
                "{}: the scans do not tell drift and scale factor apart (correlation {rho:+.2}); the drift is held near what \
                 was known. Rests of {:.0} s or more would part them",
                gyro.name(),
                geu_calibration::upkeep::SHORTEST_S
            );
        }
    }
    due(&mut text, upkeep);
    if upkeep.probability() < LEAST_PROBABILITY && !upkeep.needs_checkout() {
        let _ = writeln!(
            text,
            "the scans contradict each other or what was known; the unit has an effect that the configuration has not, or counts or fixes are wrong"
        );
    }
    text.truncate(text.trim_end().len());
    text
}

/// Which stretches were used.
fn used(text: &mut String, upkeep: &Upkeep) {
    let of = |is_scan: bool| {
        let own: Vec<_> = upkeep.used.iter().filter(|used| used.is_scan() == is_scan).collect();
        let length_s: f64 = own.iter().map(|used| used.end_s - used.start_s).sum();
        let rates = own.iter().map(|used| used.rate_z_arcsec_s);
        let (least, most) = (rates.clone().fold(f64::INFINITY, f64::min), rates.fold(f64::NEG_INFINITY, f64::max));
        (own.len(), length_s, least, most)
    };
    let (scans, length_s, least, most) = of(true);
    let _ = write!(
        text,
        "used: {scans} scan{} of {:.2} h in all at {least:.1}…{most:.1} arcsec/s about Z",
        if scans == 1 { "" } else { "s" },
        length_s / 3600.0
    );
    let (rests, length_s, least, most) = of(false);
    let _ = match rests {
        0 => writeln!(text, "; no rest or slower stretch"),
        _ => {
            writeln!(
                text,
                "; {rests} slower stretch{} of {:.2} h at {least:.1}…{most:.1} arcsec/s",
                if rests == 1 { "" } else { "es" },
                length_s / 3600.0
            )
        }
    };
}

/// When a redetermination is due, a line for each of the paper's figures.
fn due(text: &mut String, upkeep: &Upkeep) {
    let in_days = |due_in_s: f64| match due_in_s {
        due_in_s if due_in_s > 0.0 => {
            format!("in {:.1} d, {}", due_in_s / S_PER_DAY, utc(upkeep.at_s + due_in_s))
        }
        _ => "now, more scans are needed".to_owned(),
    };
    let _ = writeln!(text, "\nredetermination due, counted from the end of the scans, {}:", utc(upkeep.at_s));
    let words = [
        format!("long-term scale factor (0.004 %/month, {:.1} ppm in a fortnight)", SCALE_FACTOR_PER_FORTNIGHT * 1e6),
        format!("drift ({:.0} arcsec/h in a fortnight)", DRIFT_PER_FORTNIGHT * 7200.0),
    ];
    for (kind, what) in words.iter().enumerate() {
        let own = upkeep.changes.iter().filter(|change| change.parameter.index == kind).map(|change| {
            let (_, size, unit) = told(change);
            let (gyro, sigma) = (change.parameter.gyro.name(), change.new_sigma * size);
            format!("{gyro}, known to {sigma:.1} {unit}, {}", in_days(change.due_in_s))
        });
        let _ = writeln!(text, "  {what}: {}", own.collect::<Vec<_>>().join("; "));
    }
    let short = GYROS.iter().zip(&upkeep.short_term).filter(|(_, short)| short.pairs > 0).map(|(gyro, short)| {
        let verdict = if short.is_exceeded() { "exceeded" } else { "kept" };
        let (rms, expected_rms) = (short.rms * 1e6, short.expected_rms * 1e6);
        format!(
            "{} {verdict}, {rms:.1} ppm rms between successive scans, noise explains {expected_rms:.1}",
            gyro.name()
        )
    });
    let short = short.collect::<Vec<_>>().join("; ");
    if !short.is_empty() {
        let allowed = SCALE_FACTOR_PER_HALF_HOUR * 1e6;
        let _ = writeln!(text, "  short-term scale factor (0.002 %, {allowed:.0} ppm, per 30 min): {short}");
    }
    let _ = writeln!(text, "  next update (once every two weeks, Casteren §3.2): {}", in_days(upkeep.due_in_s()));
    for change in upkeep.changes.iter().filter(|change| change.is_beyond_stability()) {
        let (_, size, unit) = told(change);
        let _ = writeln!(
            text,
            "a full checkout is due now: {} changed by {:+.1} {unit}, {:.1} sigma of what stability explains ({:.1} allowed \
             since the calibration); more than {BEYOND_SIGMAS:.0} is another gyro than was calibrated",
            change.parameter.words(),
            change.change() * size,
            change.beyond_stability().abs(),
            change.allowed * size
        );
    }
    for (gyro, short) in GYROS.iter().zip(&upkeep.short_term).filter(|(_, short)| short.is_exceeded()) {
        let _ = writeln!(
            text,
            "a full checkout is due now: {} does not hold its scale factor from scan to scan, {:.1} ppm beyond noise",
            gyro.name(),
            short.excess() * 1e6
        );
    }
}

/// A time as a date, years beginning in March so that the leap day is the last.
fn utc(unix_s: f64) -> String {
    let minutes = (unix_s / 60.0).round() as i64;
    let (days, minute) = (minutes.div_euclid(1440), minutes.rem_euclid(1440));
    let day = days + 719_468;
    let (era, day) = (day.div_euclid(146_097), day.rem_euclid(146_097));
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let (date, month) = (day - (153 * month + 2) / 5 + 1, if month < 10 { month + 3 } else { month - 9 });
    let year = era * 400 + year + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{date:02} {:02}:{:02} UTC", minute / 60, minute % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_date() {
        // `date -u -d @… "+%F %R"`.
        let dates = [
            (0.0, "1970-01-01 00:00 UTC"),
            (951_782_400.0, "2000-02-29 00:00 UTC"),
            (1_800_000_000.0, "2027-01-15 08:00 UTC"),
            (-60.0, "1969-12-31 23:59 UTC"),
        ];
        for (unix_s, expected) in dates {
            assert_eq!(utc(unix_s), expected);
        }
    }
}
