//! Recordings of a motion, without counts.

use std::sync::Arc;

use geu_calibration::AccumulatedCounts;
use geu_diagnosis::MeasuredData;
use geu_model::Configuration;
use geu_model::attitude::{AttitudeProfile, AttitudeRow, Manoeuvre, Motion, RecordedAttitude, Scenario};
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_recording::ReferenceAttitude;

/// A manoeuvre of a kind with these numbers.
pub fn manoeuvre(kind: &str, numbers: &[(&str, f64)]) -> Manoeuvre {
    let mut manoeuvre = Manoeuvre::of_kind(kind).expect("a kind");
    for (name, value) in numbers {
        let index = manoeuvre.numbers().specs().iter().position(|number| number.name == *name).expect("a number");
        *manoeuvre.numbers_mut().value_mut(index) = *value;
    }
    manoeuvre
}

/// A recording of these manoeuvres with all counts 0. If the last manoeuvre has no end, `after_s` is its duration.
pub fn recorded(nominal: &Configuration, manoeuvres: &[Manoeuvre], after_s: Option<f64>) -> MeasuredData {
    let scenario = Scenario { manoeuvres: manoeuvres.to_vec(), ..nominal.scenario.clone() };
    let with_end = match after_s {
        Some(_) => &manoeuvres[..manoeuvres.len() - 1],
        None => manoeuvres,
    };
    let with_end = Scenario { manoeuvres: with_end.to_vec(), ..scenario.clone() };
    let duration_s = AttitudeProfile::length_s(&with_end).expect("an end") + after_s.unwrap_or(0.0);
    let count = (duration_s / SAMPLE_INTERVAL_S).ceil() as usize;
    let mut motion = Motion::new(AttitudeProfile::new(&scenario).expect("possible"), scenario.limit_cycle);
    let row = |node: usize| {
        let step = motion.advance(node as f64 * SAMPLE_INTERVAL_S);
        let (theta_rad, psi_rad) = (step.end.theta_rad, step.end.psi_rad);
        AttitudeRow {
            t_s: step.end.t_s,
            angle_control_arcsec: step.angle_control_arcsec,
            theta_psi_rad: Some((theta_rad, psi_rad)),
        }
    };
    let rows: Vec<AttitudeRow> = (0..=count + 4).map(row).collect();
    let truth = Arc::new(RecordedAttitude::new(rows).expect("a truth"));
    let mut counts = AccumulatedCounts::starting_at(0);
    for node in 1..=count {
        let electronics_c = 20.0 + 4.0 * (node as f64 * SAMPLE_INTERVAL_S * std::f64::consts::TAU / 6180.0).sin();
        counts.push(node as f64 * SAMPLE_INTERVAL_S, &[0.0; 4], electronics_c);
    }
    MeasuredData::new(counts, &ReferenceAttitude::of_truth(0, truth), &Configuration::reference()).expect("long enough")
}
