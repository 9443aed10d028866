//! Compares the model with recordings of an independent implementation of the model page: an injected effect shows in the residual, and
//! with the effect configured only noise remains.

use std::fs;
use std::path::{Path, PathBuf};

use geu_calibration::{PriorCalibration, solve};
use geu_model::package::Calibration;
use geu_model::{Configuration, GyroUnit, Truth};
use geu_plant::{GYROS, Gyro, IndependentModel, PlantedEffect};
use geu_tests::comparison::{Case, Comparison, RESIDUAL_ARCSEC, Recording, largest, left};
use geu_tests::whitening::Whitening;
use geu_tests::{geu, give_way};
use nalgebra::DVector;

/// Effects of the unit are on no gyro.
const UNIT: &[Gyro] = &[];
/// Near the middle of the recording.
const ONSET: (&str, f64) = ("time_s", 5200.0);
/// Two roundings of half a count each, and the difference of step lengths, largest if a time offset reads motion before the reference
/// begins.
const ROUNDING_ARCSEC: f64 = 1.2;
/// Limit with a lag: it starts settled on a first rate that is a mean of 0.1 s or of less, and follows corners of the rate, which a
/// spline through rows of half a second rounds off.
const LAG_ARCSEC: f64 = 2.5;
const HEATER_OFF_S: f64 = 4000.0;
/// HEATER, off.
const HEATER_OFF: [u8; 2] = [7, 0];

/// Simulates, writes and reads a recording.
fn recorded(plant: &IndependentModel) -> Recording {
    let directory = tempfile::tempdir().expect("a directory");
    let [link, reference] = written(plant, directory.path());
    Recording::read(&link, &reference)
}

fn written(plant: &IndependentModel, directory: &Path) -> [PathBuf; 2] {
    give_way();
    let recording = plant.record();
    [("link.log", recording.link), ("reference.csv", recording.reference)].map(|(name, text)| {
        let path = directory.join(name);
        fs::write(&path, text).expect("written");
        path
    })
}

/// Name in the configuration.
fn overrides(injected: &PlantedEffect) -> Vec<String> {
    let PlantedEffect { code, gyros, parameters } = injected;
    let swap = code.starts_with("axis-swap");
    let places: Vec<String> = match &gyros[..] {
        [] => vec!["unit".to_owned()],
        // The configuration names a pair at the first gyro.
        [gyro, _] if swap => vec![format!("gyro.{}", gyro.name())],
        gyros => gyros.iter().map(|gyro| format!("gyro.{}", gyro.name())).collect(),
    };
    let assignment = |(name, value): &(String, f64)| match name.as_str() {
        "on" if swap => format!("with=\"{}\"", gyros[1].name()),
        "on" => "on=true".to_owned(),
        name => format!("{name}={value:?}"),
    };
    let of_place = |place| parameters.iter().map(move |parameter| format!("{place}.{code}.{}", assignment(parameter)));
    places.iter().flat_map(of_place).collect()
}

/// On all gyros.
fn head(code: &str, parameters: &[(&str, f64)]) -> Vec<PlantedEffect> {
    vec![PlantedEffect::new(code, &GYROS, parameters)]
}

fn unit(code: &str, parameters: &[(&str, f64)]) -> Vec<PlantedEffect> {
    vec![PlantedEffect::new(code, UNIT, parameters)]
}

/// Amplitudes of each gyro about both other axes, by name before and after the axis.
fn misaligned(code: &str, [before, behind]: [&str; 2], arcsec: f64, shapes: &[(&str, f64)]) -> Vec<PlantedEffect> {
    let rows: [(&[Gyro], _, _); 3] =
        [(&[Gyro::X], "y", "z"), (&[Gyro::Y], "x", "z"), (&[Gyro::Za, Gyro::Zb], "x", "y")];
    let of_row = |(gyros, one, other)| {
        let [one, other] = [one, other].map(|axis| format!("{before}{axis}_arcsec{behind}"));
        let amplitudes = [(one.as_str(), arcsec), (other.as_str(), -0.6 * arcsec)];
        PlantedEffect::new(code, gyros, &[&amplitudes, shapes].concat())
    };
    rows.map(of_row).to_vec()
}

/// Independent model with these effects; for drifts with the sensor's temperature, the sensor cools.
fn plant(seed: u64, injected: &[PlantedEffect]) -> IndependentModel {
    let cools = injected.iter().any(|injected| injected.code == "drift-sensor-temperature");
    IndependentModel { heater_off_s: cools.then_some(HEATER_OFF_S), ..IndependentModel::new(seed, injected.to_vec()) }
}

/// Asserts that our model with the injected effects differs from the independent model as little as without effects: for the same
/// scenario and noise, only the rounding of counts differs, and what else is in `limit_arcsec`.
fn assert_equivalent(plant: &IndependentModel, with: &Comparison, null: &Comparison, limit_arcsec: f64) {
    for (gyro, (with, null)) in GYROS.iter().zip(with.residuals.iter().zip(&null.residuals)) {
        let difference: Vec<f64> = with.iter().zip(null).map(|(with, null)| with - null).collect();
        let difference = largest(&difference);
        assert!(difference < limit_arcsec, "{:?} {}: {difference:.2} arcsec", plant.effects, gyro.name());
    }
}

/// Asserts for one scenario that each effect shows in the residual of its gyros, and that our model explains it.
fn assert_explained(seed: u64, cases: &[Vec<PlantedEffect>]) {
    assert_explained_within(ROUNDING_ARCSEC, seed, cases);
}

/// [`assert_explained`] with a limit of the difference between the models.
fn assert_explained_within(limit_arcsec: f64, seed: u64, cases: &[Vec<PlantedEffect>]) {
    println!("{}", Case::COLUMNS);
    let null = recorded(&plant(seed, &[])).against(&[]);
    for injected in cases {
        let plant = plant(seed, injected);
        let recording = recorded(&plant);
        let overrides: Vec<String> = injected.iter().flat_map(overrides).collect();
        let command_s = plant.heater_off_s.unwrap_or(f64::INFINITY);
        let [without, with] =
            [&[][..], &overrides].map(|overrides| recording.against_commanded(overrides, command_s, &HEATER_OFF));
        assert_equivalent(&plant, &with, &null, limit_arcsec);
        for (gyro, left) in GYROS.iter().zip(with.refitted()) {
            assert!(largest(&left) < RESIDUAL_ARCSEC, "{injected:?} {}: {:.2} left", gyro.name(), largest(&left));
        }
        let gyros = injected.iter().flat_map(|injected| &injected.gyros).map(|gyro| gyro.name().to_owned()).collect();
        let mut codes: Vec<&str> = injected.iter().map(|injected| injected.code.as_str()).collect();
        codes.dedup();
        let name = if codes.is_empty() { "nothing".to_owned() } else { codes.join(" ") };
        Case { name, gyros, without, with }.assert_chi_squared_falls_as_predicted();
    }
}

#[test]
fn drifts_are_explained() {
    assert_explained(
        2,
        &[
            vec![],
            head("drift-step", &[("arcsec_per_h", 16.0), ONSET]),
            head("drift-ramp", &[("arcsec_per_h_per_day", 420.0)]),
            head("drift-temperature", &[("arcsec_per_h_per_k", 12.0)]),
            head("drift-periodic", &[("amplitude_arcsec_per_h", 20.0), ("period_s", 5000.0), ("phase_rad", 1.0)]),
            head("drift-sensor-temperature", &[("arcsec_per_h_per_k", 1.0)]),
            head("drift-settling", &[("arcsec_per_h", 40.0), ("time_s", 0.0), ("time_constant_s", 1100.0)]),
            head("drift-pulse", &[("arcsec_per_h", 60.0), ONSET, ("duration_s", 660.0)]),
            head("drift-temperature-rate", &[("arcsec_per_h_per_k_per_h", 8.0)]),
        ],
    );
}

#[test]
fn scale_factors_are_explained() {
    assert_explained(
        3,
        &[
            head("scale-factor-step", &[("ppm", 60.0), ONSET]),
            head("scale-factor-ramp", &[("ppm_per_day", 1500.0)]),
            head("scale-factor-temperature", &[("ppm_per_k", 30.0)]),
            head("scale-factor-periodic", &[("amplitude_ppm", 80.0), ("period_s", 5000.0), ("phase_rad", 1.0)]),
            head("scale-factor-nonlinearity", &[("cubic_ppm", 3000.0)]),
            head("scale-factor-asymmetry", &[("ppm", 120.0)]),
        ],
    );
}

#[test]
fn clocks_and_links_are_explained() {
    assert_explained(
        4,
        &[
            unit("clock-frequency", &[("ppm", 14.0)]),
            unit("clock-frequency-step", &[("ppm", 80.0), ONSET]),
            unit("time-offset", &[("seconds", 0.03)]),
            unit("time-offset", &[("seconds", -0.03)]),
            unit("time-offset-periodic", &[("amplitude_seconds", 0.03), ("period_s", 777.0), ("phase_rad", 0.7)]),
            head("lost-counts", &[("counts", -15.0), ("time_s", 6000.0)]),
        ],
    );
}

#[test]
fn floats_on_their_pivots_are_explained() {
    let clearance = ("clearance_arcsec", 11.5);
    assert_explained(
        5,
        &[
            head("pivot-clearance", &[clearance]),
            head("pivot-clearance", &[clearance, ("preferred_arcsec", 3.0)]),
            head("pivot-clearance-step", &[clearance, ONSET]),
            head("pivot-clearance-temperature", &[("clearance_arcsec_per_k", 8.0)]),
            vec![
                PlantedEffect::new("pivot-clearance", &[Gyro::Zb], &[("clearance_arcsec", 9.0)]),
                PlantedEffect::new("drift-ramp", &[Gyro::X], &[("arcsec_per_h_per_day", 420.0)]),
            ],
        ],
    );
}

#[test]
fn misalignments_are_explained() {
    assert_explained(
        6,
        &[
            misaligned("misalignment-step", ["", ""], 40.0, &[ONSET]),
            misaligned("misalignment-ramp", ["", "_per_day"], 1500.0, &[]),
            misaligned("misalignment-temperature", ["", "_per_k"], 40.0, &[]),
            misaligned("misalignment-periodic", ["amplitude_", ""], 40.0, &[("period_s", 5000.0), ("phase_rad", 1.0)]),
            unit("misalignment-thermal", &[("arcsec_per_deg", 0.9), ("time_constant_s", 280.0)]),
        ],
    );
}

#[test]
fn accelerations_and_products_of_rates_are_explained() {
    assert_explained(
        7,
        &[
            head("output-axis-acceleration", &[("seconds", 0.05)]),
            head("output-axis-acceleration-ramp", &[("seconds_per_day", 0.4)]),
            head("anisoinertia", &[("seconds", 0.1)]),
        ],
    );
}

#[test]
fn quadratic_scale_factors_and_hysteresis_are_explained() {
    assert_explained(
        12,
        &[
            head("scale-factor-quadratic", &[("ppm", 400.0)]),
            head("scale-factor-quadratic-step", &[("ppm", 400.0), ONSET]),
            head("drift-temperature-hysteresis", &[("arcsec_per_h", 20.0)]),
            head("drift-temperature-hysteresis", &[("arcsec_per_h", 20.0), ("width_k", 1.0)]),
            vec![
                PlantedEffect::new("scale-factor-quadratic", &[Gyro::Y], &[("ppm", -300.0)]),
                PlantedEffect::new("drift-temperature-hysteresis", &[Gyro::X], &[("arcsec_per_h", -20.0)]),
            ],
        ],
    );
}

#[test]
fn lags_are_explained() {
    // The motion starts at 36″/s², of which a longer lag from the start would make more than the limit.
    let lag = |time_constant_s: f64| head("sensor-lag", &[("time_constant_s", time_constant_s)]);
    let step = head("sensor-lag-step", &[("time_constant_s", 4.0), ONSET]);
    assert_explained_within(LAG_ARCSEC, 16, &[lag(0.1), lag(0.5), step]);
}

/// The true calibration parameters of a plant, as overrides.
fn calibrations(plant: &IndependentModel) -> Vec<String> {
    let of_plant = plant.record().calibrations.map(model_calibration);
    GYROS.iter().zip(of_plant).flat_map(calibrated).collect()
}

#[test]
fn rates_in_a_dead_zone_are_lost_to_both() {
    // A misalignment determines which rates about Z are in the zone: here it is known.
    let known = calibrations(&plant(13, &[]));
    let null = recorded(&plant(13, &[])).against(&known);
    for (parameters, lost_arcsec) in [(&[("arcsec_per_s", 0.05)][..], 5.0), (&[("arcsec_per_s", 0.3), ONSET], 8.0)] {
        let code = if parameters.len() == 1 { "dead-zone" } else { "dead-zone-step" };
        let injected = PlantedEffect::new(code, &[Gyro::Za, Gyro::Zb], parameters);
        let plant = plant(13, std::slice::from_ref(&injected));
        let recording = recorded(&plant);
        for lost in &recording.against(&known).residuals[Gyro::Za as usize..] {
            assert!(largest(lost) > lost_arcsec, "{injected:?}: {:.2} arcsec lost", largest(lost));
        }
        let with: Vec<String> = known.iter().cloned().chain(overrides(&injected)).collect();
        assert_equivalent(&plant, &recording.against(&with), &null, ROUNDING_ARCSEC);
    }
}

#[test]
fn constant_calibration_errors_are_equivalent() {
    let null = recorded(&plant(8, &[])).against(&[]);
    for injected in [
        head("drift", &[("arcsec_per_h", 200.0)]),
        head("scale-factor", &[("ppm", 300.0)]),
        misaligned("misalignment", ["", ""], 40.0, &[]),
    ] {
        // Refitted calibration parameters absorb them; only the configured calibration shows them.
        let plant = plant(8, &injected);
        let overrides: Vec<String> = injected.iter().flat_map(overrides).collect();
        assert_equivalent(&plant, &recorded(&plant).against(&overrides), &null, ROUNDING_ARCSEC);
    }
}

/// Increments of our model on the motion of a recording.
fn modelled(recording: &Recording, overrides: &[String]) -> Vec<[i16; 4]> {
    let configuration = Configuration::reference_with(overrides).expect("valid");
    let mut unit = GyroUnit::on(&configuration, &Truth::Recorded(recording.reference.truth.clone()));
    recording.rows.iter().map(|_| unit.end_sample().sample.increments).collect()
}

/// Accumulated counts that an effect on all gyros adds, in the independent model and in ours, for each gyro and sample; and the
/// counts without it.
fn added_counts(seed: u64, injected: &PlantedEffect) -> ([[Vec<f64>; 4]; 2], Vec<[i16; 4]>) {
    let [null, recording] = [&[][..], std::slice::from_ref(injected)].map(|injected| recorded(&plant(seed, injected)));
    let increments = |recording: &Recording| recording.rows.iter().map(|row| row.sample.increments).collect();
    let counts: Vec<[i16; 4]> = increments(&null);
    let added = |with: Vec<[i16; 4]>, without: &[[i16; 4]]| {
        std::array::from_fn(|gyro| {
            let sum = |sum: &mut f64, (with, without): (&[i16; 4], &[i16; 4])| {
                *sum += f64::from(with[gyro]) - f64::from(without[gyro]);
                Some(*sum)
            };
            with.iter().zip(without).scan(0.0, sum).collect()
        })
    };
    let ours = added(modelled(&null, &overrides(injected)), &modelled(&null, &[]));
    ([added(increments(&recording), &counts), ours], counts)
}

#[test]
fn scale_factor_noise_of_both_is_proportional_to_the_rate() {
    let injected = PlantedEffect::new("scale-factor-noise", &GYROS, &[("ppm_sqrt_s", 1e5)]);
    let (models, counts) = added_counts(14, &injected);
    for (model, added) in ["plant", "ours"].iter().zip(&models) {
        for (slow, fast) in [(100.0, 300.0), (300.0, 800.0)] {
            let mut squares = Vec::new();
            for (gyro, added) in added.iter().enumerate() {
                for (counts, pair) in counts[1..].iter().zip(added.windows(2)) {
                    let angle = f64::from(counts[gyro]);
                    if (slow..fast).contains(&(angle.abs() / 0.5)) {
                        // A tenth of the rate by the root of a second.
                        squares.push((pair[1] - pair[0]).powi(2) / (0.01 * angle * angle / 0.5));
                    }
                }
            }
            let (variance, count) = (squares.iter().sum::<f64>() / squares.len() as f64, squares.len() as f64);
            println!("{model}: {variance:.4} of {count} at {slow}…{fast} arcsec/s");
            // Five deviations, and the rounding of four counts, 1/3 of 5² × 2.
            assert!(
                count > 1000.0 && (variance - 1.0).abs() < 5.0 * (2.0 / count).sqrt() + 0.007,
                "{model}: {variance}"
            );
        }
    }
}

#[test]
fn bias_instability_of_both_has_a_flat_allan_deviation() {
    let injected = PlantedEffect::new("bias-instability", &GYROS, &[("arcsec_per_h", 3600.0)]);
    let (models, _) = added_counts(15, &injected);
    for (model, added) in ["plant", "ours"].iter().zip(&models) {
        for tau_s in [10.0, 30.0, 100.0, 300.0] {
            let m = (tau_s / 0.5) as usize;
            let second = |angle: &[f64]| ((angle[2 * m] - 2.0 * angle[m] + angle[0]) / tau_s).powi(2) / 2.0;
            let of_gyro =
                |angles: &Vec<f64>| angles.windows(2 * m + 1).map(second).sum::<f64>() / (angles.len() - 2 * m) as f64;
            let deviation = (added.iter().map(of_gyro).sum::<f64>() / 4.0).sqrt();
            // Of four gyros, 1.25 for each interval and less for the ends (NIST SP 1065, table 5).
            let freedom = 4.0 * 1.25 * 10_800.0 / tau_s / (1.0 + 3.0 * tau_s / 10_800.0);
            let relative = deviation / 0.664;
            println!("{model}: {relative:.3} of the floor at {tau_s} s");
            assert!((relative - 1.0).abs() < 0.025 + 5.0 / (2.0 * freedom).sqrt(), "{model}, {tau_s} s: {relative:.3}");
        }
    }
}

#[test]
fn wiring_does_to_the_counts_of_both_what_its_code_says() {
    let increments =
        |recording: &Recording| -> Vec<[i16; 4]> { recording.rows.iter().map(|row| row.sample.increments).collect() };
    let null = recorded(&plant(9, &[]));
    type Wiring = fn(before: [i16; 4], now: [i16; 4]) -> [i16; 4];
    let cases: [(&str, &[Gyro], Wiring); 3] = [
        ("sign-inversion-step", &[Gyro::Y, Gyro::Zb], |_, [x, y, za, zb]| [x, -y, za, -zb]),
        ("axis-swap-step", &[Gyro::Y, Gyro::Za], |_, [x, y, za, zb]| [x, za, y, zb]),
        ("stuck-output-step", &[Gyro::X], |before, [_, y, za, zb]| [before[0], y, za, zb]),
    ];
    for (code, gyros, wiring) in cases {
        let injected = PlantedEffect::new(code, gyros, &[("on", 1.0), ONSET]);
        let wired = |mut counts: Vec<[i16; 4]>| {
            for index in (ONSET.1 / 0.5) as usize..counts.len() {
                counts[index] = wiring(counts[index - 1], counts[index]);
            }
            counts
        };
        let recording = recorded(&plant(9, std::slice::from_ref(&injected)));
        assert!(increments(&recording) == wired(increments(&null)), "{code}: the plant");
        assert!(modelled(&recording, &overrides(&injected)) == wired(modelled(&null, &[])), "{code}: the model");
    }
}

#[test]
fn noises_larger_than_configured_are_of_the_size_that_was_injected() {
    // A twentieth of the variance: rounding is not quite white while a gyro rests.
    let noise_like = 0.95..1.05;
    for injected in [
        PlantedEffect::new("angle-random-walk", &GYROS, &[("arcsec_per_sqrt_s", 0.3)]),
        PlantedEffect::new("drift-random-walk", &GYROS, &[("arcsec_per_s_per_sqrt_s", 2e-4)]),
    ] {
        let comparison = recorded(&plant(10, std::slice::from_ref(&injected))).against(&[]);
        let chi2_per_dof = |overrides: &[String], gyro: Gyro| {
            let configuration = Configuration::reference_with(overrides).expect("valid");
            let residual = &comparison.residuals[gyro as usize];
            let whitening = Whitening::of(&configuration.gyros[gyro as usize].effects.constant, residual.len());
            comparison.chi2(&whitening, residual) / (residual.len() - 4) as f64
        };
        for gyro in GYROS {
            let [configured, injected_] = [chi2_per_dof(&[], gyro), chi2_per_dof(&overrides(&injected), gyro)];
            println!("{} {}: chi2/dof {configured:.3}, {injected_:.3}", injected.code, gyro.name());
            assert!(configured > noise_like.end, "{} {}: {configured:.3}", injected.code, gyro.name());
            assert!(noise_like.contains(&injected_), "{} {}: {injected_:.3}", injected.code, gyro.name());
        }
    }
}

#[test]
fn what_is_outside_the_catalogue_is_seen_and_is_what_its_formula_says() {
    let injected = [
        PlantedEffect::new("rate-drift", &[Gyro::X], &[("ppm", 100.0)]),
        PlantedEffect::new("rate-product-coupling", &[Gyro::Y], &[("per_arcsec_s", 3e-6)]),
        PlantedEffect::new("count-backlash", &[Gyro::Za], &[("play_arcsec", 8.0)]),
        PlantedEffect::new("rate-squared-coupling", &[Gyro::Zb], &[("per_arcsec_s", 4e-7)]),
    ];
    let recording = recorded(&plant(11, &injected));
    let comparison = recording.against(&[]);
    let samples = comparison.regressors.nrows();
    let configuration = Configuration::reference();
    let (mut sums, mut counted, mut followed) = ([0.0; 4], 0.0, 0.0_f64);
    let mut columns = [const { Vec::new() }; 4];
    for index in 0..samples {
        let turned = |axis: usize| {
            let at = |index: usize| comparison.regressors[(index, axis)] * 206_265.0;
            at(index) - if index > 0 { at(index - 1) } else { 0.0 }
        };
        let [x, y, z] = std::array::from_fn(turned);
        // The angle that our model would count: what was measured, without what is left of it.
        counted += f64::from(recording.rows[index].sample.increments[Gyro::Za as usize]);
        let angle = counted - comparison.residuals[Gyro::Za as usize][index];
        followed = followed.clamp(angle - 4.0, angle + 4.0);
        sums = [sums[0] + z.abs(), sums[1] + x * z / 0.5, followed - angle, sums[3] + y * y / 0.5];
        for (column, sum) in columns.iter_mut().zip(sums) {
            column.push(sum);
        }
    }
    for (gyro, (column, residual)) in GYROS.iter().zip(columns.into_iter().zip(&comparison.residuals)) {
        let whitening = Whitening::of(&configuration.gyros[*gyro as usize].effects.constant, samples);
        let chi2_per_dof = comparison.chi2(&whitening, residual) / (samples - 4) as f64;
        let scale = largest(&column);
        let mut regressors = comparison.regressors.clone().insert_column(4, 0.0);
        regressors.set_column(4, &(DVector::from_vec(column) / scale));
        let left = largest(&left(residual, &regressors));
        println!("{}: chi2/dof {chi2_per_dof:.3}, then {left:.2} arcsec left", gyro.name());
        // Ten deviations of what noise leaves in 21 600 samples, 1 ± 0.0096.
        assert!(chi2_per_dof > 1.1, "{}: chi2/dof {chi2_per_dof:.3}", gyro.name());
        assert!(left < RESIDUAL_ARCSEC, "{}: {left:.2} arcsec left", gyro.name());
    }
}

#[test]
fn a_recording_is_decoded_without_defect_and_calibrated_to_the_unit_s_parameters() {
    let directory = tempfile::tempdir().expect("a directory");
    let plant = plant(1, &[]);
    let truth = plant.record().calibrations.map(model_calibration);
    let [link, reference] = written(&plant, directory.path());
    // A defect is a panic.
    let recording = Recording::read(&link, &reference);
    assert_eq!(recording.rows.len() as f64, plant.duration_s / 0.5);
    for (sequence, row) in recording.rows.iter().enumerate() {
        assert_eq!((row.sample.sequence, row.sample.gyro_flags), (sequence as u16, 0x0f));
        assert_eq!(row.sample.clock_count, 500_000 * (sequence as u64 + 1));
    }

    let json = directory.path().join("result.json");
    let output = geu()
        .arg("calibrate")
        .arg("--link")
        .arg(link)
        .arg("--reference")
        .arg(reference)
        .arg("--json")
        .arg(&json)
        .output();
    let output = output.expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json = fs::read_to_string(json).expect("written");
    let prior = PriorCalibration::parse("result.json", &json, &[]).expect("a calibration");
    let (calibrations, sigmas) = (prior.calibrations, solve::values(&prior.sigmas));
    for ((value, sigma), truth) in solve::values(&calibrations).iter().zip(sigmas).zip(solve::values(&truth)) {
        // With normal errors a parameter exceeds this once in 100 000 recordings.
        assert!((value - truth).abs() < 5.0 * sigma && sigma > 0.0, "{value} ± {sigma}, {truth}");
    }
    let overrides: Vec<String> = GYROS.iter().zip(calibrations).flat_map(calibrated).collect();
    for (gyro, residual) in GYROS.iter().zip(recording.against(&overrides).residuals) {
        assert!(largest(&residual) < RESIDUAL_ARCSEC, "{}: {:.2} counts left", gyro.name(), largest(&residual));
    }
}

fn model_calibration(of_plant: geu_plant::Calibration) -> Calibration {
    let [x_arcsec, y_arcsec, z_arcsec] = of_plant.misalignment_arcsec;
    let geu_plant::Calibration { scale_factor, drift_arcsec_per_half_s, .. } = of_plant;
    Calibration { scale_factor, drift_arcsec_per_half_s, x_arcsec, y_arcsec, z_arcsec }
}

fn calibrated((gyro, calibration): (&Gyro, Calibration)) -> Vec<String> {
    let Calibration { scale_factor, drift_arcsec_per_half_s, x_arcsec, y_arcsec, z_arcsec } = calibration;
    let mut values = vec![("scale_factor", scale_factor), ("drift_arcsec_per_half_s", drift_arcsec_per_half_s)];
    let angles = [("x_arcsec", x_arcsec), ("y_arcsec", y_arcsec), ("z_arcsec", z_arcsec)];
    // Its own axis has none.
    values.extend(angles.into_iter().filter(|(_, angle)| *angle != 0.0));
    values.iter().map(|(name, value)| format!("gyro.{}.calibration.{name}={value:?}", gyro.name())).collect()
}
