//! Rates against an independent rate: errors put in are found, errors not there are not, what is alike is said to be.

use geu_diagnosis::rates::{Diagnosis, Gyro, Parameter, Reference, Verdict, Windows, diagnose};
use geu_model::noise::NoiseStream;

/// Ten windows in each of eight groups, spinning about directions that differ, or about one.
fn windows(directions: &[[f64; 3]], errors: &[(Parameter, f64)], correlation: f64, seed: u64) -> Windows {
    let gyros = ["X", "Y", "Z"].iter().enumerate().map(|(axis, name)| Gyro { name: name.to_string(), axis });
    let groups = 8;
    let mut windows = Windows::new(gyros.collect(), (0..groups).map(|group| group.to_string()).collect());
    let mut stream = NoiseStream::of_sensor(seed, "windows");
    for group in 0..groups {
        let direction = directions[group % directions.len()];
        let speed = 3600.0 * (20.0 + 5.0 * group as f64);
        let mut noise = stream.standard_normal();
        for _ in 0..10 {
            let wander = 0.02 * speed * stream.standard_normal();
            let mut spin = direction.map(|part| part * speed);
            spin[0] += wander;
            let magnitude = spin.iter().map(|rate| rate * rate).sum::<f64>().sqrt();
            let mut told = spin;
            for (parameter, value) in errors {
                match *parameter {
                    Parameter::Scale => told.iter_mut().for_each(|rate| *rate *= 1.0 + value),
                    Parameter::OwnScale(gyro) => told[gyro] *= 1.0 + value,
                    Parameter::Bias(_) => {}
                }
            }
            for (parameter, value) in errors {
                if let Parameter::Bias(gyro) = *parameter {
                    told[gyro] += value;
                }
            }
            let reference = Reference::Magnitude(magnitude + 30.0 * noise);
            windows.push(group, &told, reference).expect("a window");
            noise = correlation * noise + (1.0 - correlation * correlation).sqrt() * stream.standard_normal();
        }
    }
    windows
}

const APART: [[f64; 3]; 4] = [[0.9, 0.3, -0.3], [-0.2, 0.9, 0.4], [0.1, -0.3, 0.94], [-0.7, -0.7, -0.1]];
const ALONG_Y: [[f64; 3]; 1] = [[-0.18, -0.98, -0.03]];

fn value(found: &Diagnosis, parameter: Parameter) -> Option<(f64, f64)> {
    let error = found.errors.iter().find(|error| error.parameter == parameter)?;
    Some((error.value, error.sigma))
}

#[test]
fn errors_put_in_come_out_with_sigmas_that_hold() {
    errors_come_out(120);
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn errors_put_in_come_out_with_sigmas_that_hold_in_five_hundred_draws() {
    errors_come_out(500);
}

fn errors_come_out(draws: u64) {
    let errors = [(Parameter::Bias(0), 1500.0), (Parameter::Scale, -0.004)];
    let (mut named, mut covered, mut told) = (0u64, 0, 0);
    for seed in 0..draws {
        let found = diagnose(&windows(&APART, &errors, 0.5, seed), seed).expect("a diagnosis");
        let values: Vec<_> = errors.iter().filter_map(|(parameter, _)| value(&found, *parameter)).collect();
        if found.errors.len() != 2 || values.len() != 2 {
            continue;
        }
        named += 1;
        for ((value, sigma), (_, truth)) in values.into_iter().zip(&errors) {
            told += 1;
            covered += usize::from((value - truth).abs() < sigma);
            // Of a thousand one is farther off once in 1700 sets of seeds.
            assert!((value - truth).abs() < 5.0 * sigma, "seed {seed}: {value} ± {sigma}, put in {truth}");
        }
    }
    // A third name by chance in one of a hundred, and as many again twice for an error that is missed. 0.683 are within one sigma, with
    // a deviation of 0.030 in 120 draws of two: two and a half of these.
    let share = covered as f64 / told as f64;
    assert!(named >= draws * 97 / 100, "{named} of {draws} named");
    assert!((0.60..=0.76).contains(&share), "{share} within one sigma");
}

#[test]
#[ignore = "a minute; .ci/run has it"]
fn noise_alone_is_given_no_name() {
    let mut wrong = 0;
    for directions in [&APART[..], &ALONG_Y] {
        for seed in 0..150 {
            let found = diagnose(&windows(directions, &[], 0.6, seed), seed).expect("a diagnosis");
            wrong += usize::from(found.verdict != Verdict::Consistent);
        }
    }
    // One in a hundred is asked; 6 of 300 are exceeded once in thirty.
    assert!(wrong <= 6, "{wrong} of 300");
}

#[test]
fn what_is_alike_is_said_to_be() {
    // About one direction, a small bias is hardly told from that of another axis.
    let found = diagnose(&windows(&ALONG_Y, &[(Parameter::Bias(1), 60.0)], 0.5, 1), 1).expect("a diagnosis");
    assert_eq!((found.verdict, found.errors.len()), (Verdict::Explained, 1));
    let error = &found.errors[0];
    let biases = [0, 1, 2].map(Parameter::Bias);
    assert!(biases.contains(&error.parameter), "{error:?}");
    let alike: Vec<_> = error.rivals.iter().filter(|rival| rival.is_alike()).collect();
    assert!(alike.iter().any(|rival| biases.contains(&rival.parameter) && rival.cosine.abs() > 0.95), "{error:?}");
    // A spin about another axis brings the cosine of two biases down.
    let apart = found.apart.expect("signatures");
    assert!(apart.cosines[(0, 1)] > 0.95, "{}", apart.cosines);
    let about_x = apart.manoeuvres.iter().find(|own| own.spin_arcsec_s[0] > 0.0).expect("a spin about X");
    assert!(about_x.cosines[(0, 1)] < 0.5, "{}", about_x.cosines);
}

#[test]
fn one_gyro_beside_a_vector_is_found_out_in_one_recording() {
    let gyros = vec![Gyro { name: "GZ".to_owned(), axis: 2 }];
    let mut windows = Windows::new(gyros, vec!["all".to_owned()]);
    let mut stream = NoiseStream::of_sensor(3, "windows");
    for index in 0..90 {
        let rate = 400.0 * (f64::from(index) * 0.3).sin();
        let told = 1.01 * rate + 7.0 + 0.5 * stream.standard_normal();
        windows.push(0, &[told], Reference::Vector([3.0, -2.0, rate])).expect("a window");
    }
    let found = diagnose(&windows, 1).expect("a diagnosis");
    assert_eq!((found.verdict, found.groups.len(), found.errors.len()), (Verdict::Explained, 3, 2));
    for (parameter, truth) in [(Parameter::Bias(0), 7.0), (Parameter::Scale, 0.01)] {
        let (value, sigma) = value(&found, parameter).expect("found");
        assert!((value - truth).abs() < 3.0 * sigma, "{parameter:?}: {value} ± {sigma}");
    }
}

#[test]
fn what_does_not_suffice_is_refused() {
    let gyro = |name: &str, axis| Gyro { name: name.to_owned(), axis };
    let mut two = Windows::new(vec![gyro("X", 0), gyro("Y", 1)], vec!["day".to_owned()]);
    two.push(0, &[1.0, 2.0], Reference::Magnitude(3.0)).expect("a window");
    let told = diagnose(&two, 1).expect_err("no gyro about Z").to_string();
    assert!(told.contains("one gyro about each of X, Y and Z, got X about X, Y about Y"), "{told}");
    assert!(two.push(0, &[f64::NAN, 2.0], Reference::Magnitude(3.0)).is_err());
    assert!(two.push(0, &[1.0, 2.0], Reference::Vector([0.0; 3])).is_err());
    assert!(two.push(1, &[1.0, 2.0], Reference::Magnitude(3.0)).is_err());
    let three = Windows::new(vec![gyro("X", 0), gyro("Y", 1), gyro("Z", 2)], vec!["day".to_owned()]);
    assert!(diagnose(&three, 1).expect_err("no window").to_string().contains("windows"));
    // A unit that rests tells nothing of scale, and of biases only that there are none.
    let mut rest = three.clone();
    for _ in 0..60 {
        rest.push(0, &[0.0; 3], Reference::Magnitude(0.0)).expect("a window");
    }
    assert_eq!(diagnose(&rest, 1).expect("a diagnosis").verdict, Verdict::Consistent);
}
