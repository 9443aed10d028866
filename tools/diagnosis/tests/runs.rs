//! Model runs assembled from earlier ones.

use geu_diagnosis::MeasuredData;
use geu_diagnosis::measured::{Series, Shifts};
use geu_model::Configuration;

use crate::recorded::{manoeuvre, recorded};

fn bits(series: &Series) -> Vec<u64> {
    series.iter().flatten().map(|value| value.to_bits()).collect()
}

#[test]
fn assembled_run_equals_a_run_alone() {
    let motion = [manoeuvre("pointing", &[("duration_s", 300.0)]), manoeuvre("z-scan", &[("angle_deg", 200.0)])];
    let measured: MeasuredData = recorded(&Configuration::reference(), &motion, None);
    let with = |assignments: &[&str]| {
        let assignments: Vec<String> = assignments.iter().map(|&assignment| assignment.to_owned()).collect();
        Configuration::reference_with(&assignments).expect("valid")
    };
    let late = Shifts { lag_s: 0.03, temperature_s: 0.0 };
    let asked = [
        (with(&[]), Shifts::default()),
        (with(&["gyro.GYRX.pivot-clearance.clearance_arcsec=11.5"]), Shifts::default()),
        (
            with(&["gyro.GYRY.drift-ramp.arcsec_per_h_per_day=400", "gyro.GYRZB.drift-ramp.arcsec_per_h_per_day=800"]),
            Shifts::default(),
        ),
        (
            with(&["gyro.GYRX.pivot-clearance.clearance_arcsec=11.5", "gyro.GYRY.drift-ramp.arcsec_per_h_per_day=400"]),
            Shifts::default(),
        ),
        (with(&["gyro.GYRX.drift-temperature.arcsec_per_h_per_k=12"]), Shifts::default()),
        (with(&["gyro.GYRX.drift-temperature.arcsec_per_h_per_k=12"]), Shifts { lag_s: 0.0, temperature_s: 300.0 }),
        // An effect of the unit changes every gyro.
        (with(&["unit.clock-frequency.ppm=14.0"]), Shifts::default()),
        (with(&[]), late),
        (with(&["gyro.GYRX.pivot-clearance.clearance_arcsec=11.5"]), Shifts { temperature_s: 300.0, ..late }),
        (with(&[]), Shifts::default()),
    ];
    let mut seen = Vec::new();
    for (configuration, shifts) in &asked {
        // A copy has no earlier runs.
        let alone = bits(&measured.clone().run(configuration, *shifts));
        assert_eq!(bits(&measured.run(configuration, *shifts)), alone);
        assert_eq!(bits(&measured.run(configuration, *shifts)), alone, "asked again");
        seen.push(alone);
    }
    // The later runs replaced the first in the cache: it runs again.
    let last = seen.pop();
    assert_eq!(seen.first(), last.as_ref());
    seen.sort_unstable();
    seen.dedup();
    assert_eq!(seen.len(), asked.len() - 1, "the runs differ");
}
