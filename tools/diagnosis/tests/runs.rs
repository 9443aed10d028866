//! Model runs assembled from earlier ones, or continued linearly from them.

use geu_diagnosis::measured::{CHANNELS, ModelRun, Shifts};
use geu_diagnosis::whitening::NoiseModel;
use geu_diagnosis::{DiagnosisCase, MeasuredData};
use geu_hypothesis::CalibrationParameter;
use geu_model::Configuration;

use crate::recorded::{manoeuvre, recorded};

fn bits(run: &ModelRun) -> Vec<u64> {
    run.iter().flat_map(|channel| channel.iter()).map(|value| value.to_bits()).collect()
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
    // Several at once follow the motion together.
    let at_once = || asked.iter().zip(&seen).filter(|((_, shifts), _)| *shifts == Shifts::default());
    let configurations: Vec<Configuration> = at_once().map(|((configuration, _), _)| configuration.clone()).collect();
    let runs = measured.clone().run_all(&configurations, Shifts::default());
    assert_eq!(
        runs.iter().map(bits).collect::<Vec<_>>(),
        at_once().map(|(_, alone)| alone.clone()).collect::<Vec<_>>()
    );
    // The later runs replaced the first in the cache: it runs again.
    let last = seen.pop();
    assert_eq!(seen.first(), last.as_ref());
    seen.sort_unstable();
    seen.dedup();
    assert_eq!(seen.len(), asked.len() - 1, "the runs differ");
}

#[test]
fn the_model_is_linear_between_the_points_of_the_grid() {
    let mut nominal = Configuration::reference();
    (nominal.scenario.theta_deg, nominal.scenario.psi_deg) = (90.0, 0.0);
    let rest = manoeuvre("pointing", &[("duration_s", 300.0)]);
    let turn = manoeuvre("z-scan", &[("angle_deg", 360.0)]);
    let measured = recorded(&nominal, &[rest.clone(), turn, rest], None);
    let mut case = DiagnosisCase::new(&measured, &nominal);
    let noise = NoiseModel { white: 0.01, angle_walk: 0.02, rate_walk: 2e-5, scale_walk: 0.0, flicker: 0.0 };
    let mut state = case.start([noise; CHANNELS]);
    let mut add = |of_kind: [f64; 3], lag_s: f64| {
        for (value, parameter) in state.calibration.iter_mut().zip(CalibrationParameter::all(&nominal.device)) {
            *value += parameter.of_kind(of_kind);
        }
        state.shifts.lag_s += lag_s;
        state.clone()
    };
    case.set_origin(&add([2e-3, 0.1, -150.0], 0.02));
    // Nearly half a step of each.
    let mut state = add([14e-6, 0.9e-3, -14.0], 4.9e-3);
    let (residuals, exact) = (case.linearised(&mut state).0, case.residual(&state));
    let differences =
        residuals.iter().zip(&exact).flat_map(|(own, exact)| own.iter().zip(exact).map(|(a, b)| (a - b).abs()));
    let largest = differences.fold(0.0, f64::max);
    assert!(largest < 0.003, "{largest} arcsec");
}
