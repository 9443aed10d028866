//! Faults of a plan on the unit: what they do, when, and that the same plan gives the same bytes.

use std::sync::Arc;

use geu_model::attitude::{Knot, SampleQuality, StreamedAttitude};
use geu_model::configuration::fault::{MAX_RUN_FAULTS, fault_text, plan_text, read_fault_text};
use geu_model::device::Device;
use geu_model::fault::catalogue::{CATALOGUE, Scope, Transport};
use geu_model::fault::engine::FaultEvent;
use geu_model::fault::expectation::ExpectationResult;
use geu_model::fault::{ParameterRef, expression};
use geu_model::parameter_spec::{DefaultValue, ValueFormat};
use geu_model::time_profile::FAULT_PROFILES;
use geu_model::{Configuration, GyroUnit, Truth};
use geu_protocol::{Gyro, Sample};

fn with_plan(plan: &str) -> Configuration {
    let mut configuration = Configuration::reference();
    configuration.add_plan("plan", plan).unwrap_or_else(|error| panic!("{error}"));
    configuration
}

fn run(configuration: &Configuration, samples: usize) -> Vec<Sample> {
    let mut unit = GyroUnit::new(configuration);
    (0..samples).map(|_| unit.end_sample().sample).collect()
}

fn refused(plan: &str) -> String {
    Configuration::reference().add_plan("plan", plan).expect_err(plan).to_string()
}

#[test]
fn a_drift_step_adds_its_drift_for_its_time_and_no_longer() {
    let plan = "[[fault]]\nat_s = 10.0\ngyro = \"GYRX\"\nparameter = \"drift.arcsec_per_h\"\ncourse = { step = -72000.0 }\nfor_s = 5.0";
    let error = refused(plan);
    assert!(error.contains("course.step") && error.contains("plan:5"), "{error}");
    let plan = plan.replace("72000", "900");
    let (faulty, plain) = (run(&with_plan(&plan), 100), run(&Configuration::reference(), 100));
    assert_eq!(faulty[..20], plain[..20]);
    let counted = |rows: &[Sample]| rows.iter().map(|row| i64::from(row.increments[0])).sum::<i64>();
    // A drift is sensed and not counted: 900 arcsec/h for 5 s are 1.25 arcsec.
    let gained = counted(&faulty) - counted(&plain);
    assert!((1..=2).contains(&gained), "{gained}");
    assert_eq!(faulty[0].increments[1..], plain[0].increments[1..]);
}

#[test]
fn the_unfaulted_sample_is_recorded_beside_the_sent_one() {
    let configuration =
        with_plan("[[fault]]\nat_s = 3.0\ngyro = \"GYRY\"\nfault = \"stuck-count\"\ncounts = 77\nfor_s = 2.0");
    let plain = run(&Configuration::reference(), 20);
    let mut unit = GyroUnit::new(&configuration);
    for (index, plain) in plain.iter().enumerate() {
        let ended = unit.end_sample();
        let acts = (6..10).contains(&index);
        assert_eq!(ended.sample.increments[1] == 77, acts, "{index}");
        let injected = unit.injected();
        assert_eq!(injected.is_some(), acts, "{index}");
        assert!(
            injected.is_none_or(
                |injected| injected.clean.sample == *plain && injected.acting[0].elapsed == index as u64 - 6
            )
        );
        let happened: Vec<String> = unit
            .take_happened()
            .iter()
            .map(|what| match what {
                FaultEvent::Started(fault) => format!("start {}", fault.id),
                FaultEvent::Ended(fault, count) => format!("end {} {count}", fault.id),
                FaultEvent::Decided(_) => unreachable!("nothing is expected"),
            })
            .collect();
        // Decided when the sample begins: right after the one before has ended.
        let expected: &[&str] = match index {
            5 => &["start fault-1"],
            9 => &["end fault-1 4"],
            _ => &[],
        };
        assert_eq!(happened, expected, "{index}");
    }
}

#[test]
fn every_parameter_and_every_course_can_be_injected_and_written_back() {
    for target in ParameterRef::all() {
        for kind in FAULT_PROFILES.iter().filter(|kind| !target.is_switch() || kind.name == "step") {
            let (_, max) = target.limits();
            let gyro = target
                .gyros(&Device::iras())
                .last()
                .map_or(String::new(), |gyro| format!("gyro = \"{}\"\n", gyro.name()));
            let numbers: String =
                kind.shapes.iter().map(|number| format!(", {} = {:?}", number.name, number.min.max(1.0))).collect();
            let size = match target.number().form {
                ValueFormat::Gyro => 2.0,
                ValueFormat::Flag => 1.0,
                _ => max,
            };
            let release = if target.is_switch() { "" } else { "release_s = 1.5\n" };
            let plan = format!(
                "[[fault]]\nid = \"a\"\n{gyro}{release}parameter = \"{}\"\ncourse = {{ {} = {}{numbers} }}\nwhen = \"frame % 3 == 1\"\nend_when = \"active(a)\"\ntimes = 4\nuntil_s = 90.0\nprobability = 0.5\nseed = 9",
                target.name(),
                kind.name,
                target.number().written(size),
            );
            let configuration = with_plan(&plan);
            let again = Configuration::parse("again", &configuration.to_toml(false), &[])
                .unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(again, configuration);
            assert_eq!(run(&again, 40), run(&configuration, 40), "{plan}");
            let again = with_plan(&format!("[[fault]]\n{}", fault_text(&Device::iras(), &configuration.faults[0])));
            assert_eq!(again.faults, configuration.faults);
        }
    }
}

#[test]
fn every_fault_of_gyro_and_unit_changes_the_output_and_ends() {
    for spec in CATALOGUE.iter().filter(|spec| spec.scope != Scope::Link) {
        let numbers: String = spec
            .numbers
            .iter()
            .map(|number| {
                let value = match (number.form, number.default) {
                    (_, DefaultValue::Value(value)) if value != 0.0 => value,
                    (ValueFormat::Gyro, _) => 3.0,
                    (ValueFormat::Choice(_) | ValueFormat::Flag, _) => 0.0,
                    _ => number.max.min(100.0),
                };
                format!("{} = {}\n", number.name, number.written(value))
            })
            .collect();
        let gyro = if spec.scope == Scope::Gyro { "gyro = \"GYRY\"\n" } else { "" };
        let plan = format!("[[fault]]\nfault = \"{}\"\n{gyro}{numbers}at_s = 2.0\nfor_s = 100.0\n", spec.code);
        let configuration = with_plan(&plan);
        let mut unit = GyroUnit::new(&configuration);
        let (mut differ, mut acted) = (0, 0);
        for _ in 0..1000 {
            let ended = unit.end_sample();
            if let Some(injected) = unit.injected() {
                acted += 1;
                differ += u32::from(injected.clean != ended);
            }
        }
        assert!(differ > 0 && acted == 200, "{}: {differ} of {acted}", spec.code);
        assert_eq!(run(&configuration, 1000), run(&configuration, 1000), "{}", spec.code);
    }
}

#[test]
fn a_reset_silences_the_unit_and_restarts_sequence_and_clock() {
    let mut unit = GyroUnit::new(&with_plan("[[fault]]\nat_s = 5.0\nfault = \"reset\"\nfor_s = 1.5"));
    unit.command(&[2, 1]).expect("heard");
    for index in 0..20 {
        assert_eq!(unit.command(&[1]).is_ok(), !(10..13).contains(&index), "{index}");
        let ended = unit.end_sample();
        assert_eq!(ended.cyclic, index >= 13, "{index}");
        if index >= 13 {
            assert_eq!(
                (ended.sample.sequence, ended.sample.clock_count),
                (index - 13, (u64::from(index) - 12) * 500_000)
            );
        }
    }
}

#[test]
fn triggers_start_a_fault_when_all_of_them_hold() {
    let starts = |keys: &str| {
        let configuration = with_plan(&format!("[[fault]]\ngyro = \"GYRX\"\nfault = \"dead\"\nfor_s = 0.5\n{keys}"));
        run(&configuration, 200)
            .iter()
            .enumerate()
            .filter(|(_, row)| row.gyro_flags & 1 == 0)
            .map(|(index, _)| index)
            .collect::<Vec<_>>()
    };
    assert_eq!(starts("times = 1000\nwhen = \"frame == 7 or sequence == 9\""), [7, 9]);
    assert_eq!(starts("times = 1000\nat_s = 98.0"), [196, 197, 198, 199]);
    assert_eq!(starts("times = 1000\nuntil_s = 1.0"), [0, 1]);
    assert_eq!(starts("times = 1000\nby_hand = true"), [0; 0]);
    assert_eq!(starts("times = 2\n").len(), 2);
    let starts_at_random = starts("times = 1000\nprobability = 0.25");
    assert!((25..=75).contains(&starts_at_random.len()), "{}", starts_at_random.len());
    assert_eq!(starts_at_random, starts("times = 1000\nprobability = 0.25"));
    assert_ne!(starts_at_random, starts("times = 1000\nprobability = 0.25\nseed = 2"));
}

#[test]
fn a_command_triggers_with_the_next_sample() {
    let mut unit =
        GyroUnit::new(&with_plan("[[fault]]\ngyro = \"GYRX\"\nfault = \"dead\"\nwhen = \"command(SELF_TEST)\""));
    unit.end_sample();
    let _ = unit.command(&[4, 1, 0, 5, 3]);
    assert!(unit.end_sample().sample.gyro_flags & 1 == 1);
    assert!(unit.end_sample().sample.gyro_flags & 1 == 0);
}

#[test]
fn a_parameter_returns_over_its_release() {
    let plan = "[[fault]]\nat_s = 0.0\ngyro = \"GYRX\"\nparameter = \"scale-factor.ppm\"\ncourse = { step = 10000.0 }\nfor_s = 1.0\nrelease_s = 2.0";
    let mut unit = GyroUnit::new(&with_plan(plan));
    let shares: Vec<f64> = (0..8)
        .filter_map(|_| {
            unit.end_sample();
            unit.injected().map(|injected| injected.acting[0].share)
        })
        .collect();
    assert_eq!(shares, [1.0, 1.0, 0.875, 0.625, 0.375, 0.125]);
}

#[test]
fn a_run_with_live_injections_is_the_run_of_the_plan_that_they_make() {
    let mut unit =
        GyroUnit::new(&with_plan("[[fault]]\nat_s = 1.0\ngyro = \"GYRZA\"\nfault = \"garbage\"\nfor_s = 20.0"));
    let live = with_plan(
        "[[fault]]\nid = \"live\"\ngyro = \"GYRX\"\nfault = \"garbage\"\nwhen = \"frame % 4 == 0\"\nfor_s = 1.0\ntimes = 100",
    );
    let (mut rows, mut plan) = (Vec::new(), String::new());
    for index in 0..100 {
        if index == 30 {
            let added = unit.inject(live.faults[0].clone());
            assert_eq!(added.at_s, 15.5);
        }
        if index == 60 {
            assert_eq!(unit.clear("live"), Some(30.5));
            assert_eq!(unit.clear("unknown"), None);
        }
        rows.push(unit.end_sample().sample);
    }
    for planned in &unit.faults().planned {
        plan += &format!("[[fault]]\n{}", fault_text(&Device::iras(), &planned.fault));
    }
    assert_eq!(run(&with_plan(&plan), 100), rows);
}

#[test]
fn effects_beyond_the_paper_are_injected_live_and_by_a_plan() {
    // In a scan about Y, after 10 s for 30 s.
    let scan = ["manoeuvre=[{kind='pointing', duration_s=5}, {kind='y-scan', to_theta_deg=120}]".to_owned()];
    let scan = Configuration::reference_with(&scan).unwrap_or_else(|error| panic!("{error}"));
    let plain = run(&scan, 200);
    for (parameter, size) in [
        ("scale-factor-quadratic.ppm", 5000.0),
        ("dead-zone.arcsec_per_s", 1000.0),
        ("sensor-lag.time_constant_s", 5.0),
        ("scale-factor-noise.ppm_sqrt_s", 10_000.0),
        ("bias-instability.arcsec_per_h", 3600.0),
        ("drift-temperature-hysteresis.arcsec_per_h", 3600.0),
    ] {
        let text =
            format!("id = \"live\"\ngyro = \"GYRY\"\nparameter = \"{parameter}\"\ncourse = {{ step = {size:?} }}");
        let mut unit = GyroUnit::new(&scan);
        let mut rows = Vec::new();
        for index in 0..200 {
            match index {
                19 => assert_eq!(
                    unit.inject(read_fault_text(&Device::iras(), "live", &text, &[], &Transport::ALL).expect("valid"))
                        .at_s,
                    10.0
                ),
                79 => assert_eq!(unit.clear("live"), Some(40.0)),
                _ => {}
            }
            rows.push(unit.end_sample().sample);
        }
        let mut planned = scan.clone();
        let plan = format!("[[fault]]\n{text}\nat_s = 10.0\nfor_s = 30.0");
        planned.add_plan("plan", &plan).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(run(&planned, 200), rows, "{parameter}");
        let counted =
            |rows: &[Sample], gyro: usize| rows.iter().map(|row| i64::from(row.increments[gyro])).sum::<i64>();
        for (from, to, acts) in [(0, 20, false), (20, 80, true), (80, 200, false)] {
            let [changed, others] = [1, 3].map(|gyro| counted(&rows[from..to], gyro) - counted(&plain[from..to], gyro));
            // Afterwards nothing but the fraction of a count is left of it.
            assert!(others == 0 && (changed.abs() > 1) == acts, "{parameter}, {from}: {changed}");
        }
    }
}

#[test]
fn what_is_cleared_or_started_before_its_time_is_the_run_of_a_plan_too() {
    let plan = "[[fault]]\nid = \"later\"\ngyro = \"GYRX\"\nfault = \"dead\"\nat_s = 10.0\n\
                [[fault]]\nid = \"hand\"\ngyro = \"GYRY\"\nfault = \"dead\"\nat_s = 10.0\nby_hand = true\nfor_s = 1.0\n\
                [[fault]]\nid = \"past\"\ngyro = \"GYRZA\"\nfault = \"dead\"\nuntil_s = 1.0\nby_hand = true";
    let mut unit = GyroUnit::new(&with_plan(plan));
    let live = read_fault_text(&Device::iras(), "live", "id = \"at-once\"\nfault = \"reset\"", &[], &Transport::ALL)
        .expect("valid");
    let mut rows = Vec::new();
    for index in 0..60 {
        if index == 4 {
            assert_eq!(unit.inject(live.clone()).at_s, 2.5);
            assert_eq!((unit.clear("at-once"), unit.clear("later")), (Some(2.5), Some(2.5)));
            assert_eq!((unit.start("hand"), unit.start("past"), unit.start("later")), (Some(10.0), None, None));
        }
        rows.push(unit.end_sample().sample);
    }
    let faults: Vec<_> = unit.faults().planned.iter().map(|planned| (*planned.fault).clone()).collect();
    assert_eq!(run(&with_plan(&plan_text(&Device::iras(), &faults, &[])), 60), rows);
    let dead: Vec<usize> = (0..60).filter(|&index| rows[index].gyro_flags != 0x0F).collect();
    assert_eq!(dead, [20, 21]);
}

#[test]
fn what_names_a_gyro_or_is_on_or_off_is_set() {
    let scan = "manoeuvre=[{ kind = \"y-scan\", to_theta_deg = 100.0 }]".to_owned();
    let swapped = |gyros: &[&str], configured: &str| {
        let overrides = [scan.clone(), configured.to_owned()];
        let mut configuration = Configuration::reference_with(&overrides).expect("valid");
        let fault = |with: &&str| format!("[[fault]]\ngyro = \"GYRX\"\nfault = \"axis-swap\"\nwith = \"{with}\"\n");
        configuration.add_plan("plan", &gyros.iter().map(fault).collect::<String>()).expect("valid");
        run(&configuration, 100)
    };
    let none = "gyro.GYRX.scale-factor.ppm=0";
    assert_eq!(swapped(&["GYRY", "GYRZA"], none), swapped(&["GYRZA"], none), "the last counts");
    assert_eq!(swapped(&["GYRZA"], "gyro.GYRX.axis-swap.with=\"GYRY\""), swapped(&["GYRZA"], none));
    assert_ne!(swapped(&["GYRZA"], none), swapped(&["GYRZB"], none));
    // Without a limit there is nothing to add to.
    let walk =
        "[[fault]]\ngyro = \"GYRX\"\nparameter = \"drift-random-walk.correlation_time_s\"\ncourse = { step = 5.0 }";
    let moved = with_plan(walk);
    assert_ne!(run(&moved, 20_000), run(&Configuration::reference(), 20_000));
}

#[test]
fn a_unit_without_power_cools_and_a_gyro_that_is_off_does_not_coast() {
    let mut unit = GyroUnit::new(&with_plan("[[fault]]\nfault = \"brown-out\"\nfor_s = 600.0"));
    let last = (0..1200).map(|_| unit.end_sample().sample).last().expect("some");
    assert!(last.sensor_centi_c < 6_900, "{}", last.sensor_centi_c);
    let mut unit = GyroUnit::new(&with_plan("[[fault]]\nfault = \"spin-down\"\ngyro = \"GYRX\"\nat_s = 1.0"));
    let _ = unit.command(&[6, 0b1110]);
    let flags: Vec<u8> = (0..4).map(|_| unit.end_sample().sample.unit_flags & 2).collect();
    assert_eq!(flags, [2; 4], "GYRX is not powered");
}

#[test]
fn a_clock_fault_on_an_external_truth_needs_the_received_knots_only() {
    let received = |end_s: f64| {
        let knots = StreamedAttitude::default();
        for index in 0..=(end_s * 10.0).round() as u32 {
            let t_s = f64::from(index) / 10.0;
            let angle = 40.0 * t_s + 30.0 * (0.3 * t_s).sin();
            knots.append(Knot { t_s, angle_control_arcsec: [angle; 3], basis: SampleQuality::Received, sun: None });
        }
        Truth::Stepped(Arc::new(knots))
    };
    for (plan, count) in [
        ("at_s = 1.0\nparameter = \"clock-frequency.ppm\"\ncourse = { step = 1000.0 }", 240),
        ("for_s = 1.0\nparameter = \"clock-frequency.ppm\"\ncourse = { step = -1000.0 }", 239),
        ("at_s = 1.0\nfor_s = 3.0\nparameter = \"time-offset.seconds\"\ncourse = { step = -0.3 }", 240),
    ] {
        let configuration = with_plan(&format!("[[fault]]\n{plan}"));
        let truth = received(120.0);
        assert_eq!(GyroUnit::samples_within(&configuration, &truth, 240), count, "{plan}");
        // With a longer truth the unfaulted sample is the same: it does not depend on missing knots.
        let (mut unit, mut beside) =
            (GyroUnit::on(&configuration, &truth), GyroUnit::on(&configuration, &received(200.0)));
        for index in 0..count {
            assert!(unit.needs_truth_s() <= 120.0 + 1e-6, "{plan} {index}");
            assert_eq!(unit.end_sample(), beside.end_sample());
            assert_eq!(unit.injected(), beside.injected(), "{plan} {index}");
        }
    }
}

#[test]
fn expectations_are_decided_by_what_the_computer_does() {
    let plan = "[[fault]]\nid = \"stop\"\nat_s = 2.0\ngyro = \"GYRX\"\nfault = \"dead\"\n\
                [[expect]]\nid = \"reacts\"\nafter = \"stop\"\ncondition = \"command(GYRO_POWER)\"\nwithin_s = 2.0\n\
                [[expect]]\nid = \"leaves the rest alone\"\nafter = \"stop\"\ncondition = \"valid(GYRY)\"\nthroughout_s = 5.0";
    assert!(refused(plan).contains("letters, digits"));
    let plan = plan.replace("leaves the rest alone", "rest");
    for (is_good, expected) in [(true, ExpectationResult::Met(3.5)), (false, ExpectationResult::NotMet(4.0))] {
        let mut unit = GyroUnit::new(&with_plan(&plan));
        for index in 0..20 {
            if is_good && index == 6 {
                let _ = unit.command(&[6, 0b1110]);
            }
            unit.end_sample();
        }
        let verdicts: Vec<_> = unit.faults().verdicts().collect();
        assert_eq!(verdicts, [("reacts", expected), ("rest", ExpectationResult::Met(7.0))]);
    }
}

#[test]
fn an_error_of_a_plan_states_its_place_and_the_valid_names() {
    for (plan, expected) in [
        ("[[fault]]\nat_s = 1.0", "either `parameter`"),
        ("[[fault]]\nparameter = \"pivot.clearance\"\ngyro = \"GYRX\"", "pivot-clearance.clearance_arcsec"),
        (
            "[[fault]]\nparameter = \"drift.arcsec_per_h\"\ngyro = \"GYRQ\"\ncourse = { step = 1.0 }",
            "one of GYRX, GYRY, GYRZA, GYRZB",
        ),
        ("[[fault]]\nparameter = \"drift.arcsec_per_h\"\ncourse = { step = 1.0 }", "one of GYRX, GYRY, GYRZA, GYRZB"),
        (
            "[[fault]]\nparameter = \"clock-frequency.ppm\"\ngyro = \"GYRX\"\ncourse = { step = 1.0 }",
            "the whole unit's",
        ),
        (
            "[[fault]]\nparameter = \"misalignment.x_arcsec\"\ngyro = \"GYRX\"\ncourse = { step = 1.0 }",
            "one of GYRY, GYRZA, GYRZB",
        ),
        ("[[fault]]\nparameter = \"drift.arcsec_per_h\"\ngyro = \"GYRX\"", "expected `course`"),
        (
            "[[fault]]\nparameter = \"drift.arcsec_per_h\"\ngyro = \"GYRX\"\ncourse = { leap = 1.0 }",
            "step, ramp, settling, pulse, sine, random",
        ),
        ("[[fault]]\nparameter = \"drift.arcsec_per_h\"\ngyro = \"GYRX\"\ncourse = { ramp = 1.0 }", "over_s"),
        (
            "[[fault]]\nparameter = \"sign-inversion.on\"\ngyro = \"GYRX\"\ncourse = { sine = 1.0, period_s = 9.0 }",
            "one of step for",
        ),
        ("[[fault]]\nfault = \"explode\"", "dead, stuck-count"),
        (
            "[[fault]]\nfault = \"drift\"\ngyro = \"GYRX\"",
            "drift is an effect: expected one of its numbers as parameter, drift.arcsec_per_h",
        ),
        ("[[fault]]\nfault = \"stuck-count\"\ngyro = \"GYRX\"", "counts"),
        ("[[fault]]\nfault = \"stuck-count\"\ngyro = \"GYRX\"\ncounts = 40000", "-32768…32767"),
        ("[[fault]]\nfault = \"stuck-count\"\ngyro = \"GYRX\"\ncounts = 1.5", "a whole number"),
        (
            "[[fault]]\nfault = \"spike\"\ngyro = \"GYRX\"\ncounts = 5\nlaw = \"wild\"",
            "constant, alternating, uniform, normal",
        ),
        ("[[fault]]\nfault = \"dead\"\ngyro = \"GYRX\"\nrelease_s = 2.0", "a fault of a parameter that is a quantity"),
        (
            "[[fault]]\nparameter = \"stuck-output.on\"\ngyro = \"GYRX\"\ncourse = { step = true }\nrelease_s = 2.0",
            "a quantity",
        ),
        (
            "[[fault]]\nparameter = \"scale-factor.ppm\"\ngyro = \"GYRX\"\ncourse = { sine = 0.0, period_s = 9.0 }",
            "nothing changes",
        ),
        ("[[fault]]\nfault = \"axis-swap\"\ngyro = \"GYRX\"\nwith = \"GYRX\"", "its own gyro"),
        ("[[fault]]\nfault = \"wrong-lsb\"\ngyro = \"GYRX\"\nfactor = 1.0", "another than 1"),
        ("[[fault]]\nfault = \"delay\"\ndelay_s = 0.0", "0.001…60"),
        ("[[fault]]\nfault = \"sequence-jump\"\nby = 0", "another than 0"),
        ("[[fault]]\nfault = \"flip-flags\"", "at least one bit"),
        ("[[fault]]\nfault = \"dead\"\ngyro = \"GYRX\"\nlink = \"pty\"", "unknown key `link`"),
        ("[[fault]]\nfault = \"parity-error\"\nlink = \"pty\"", "a disturbance box"),
        ("[[fault]]\nfault = \"bus-off\"", "CAN disturbance generator"),
        ("[[fault]]\nfault = \"baud-mismatch\"\nlink = \"tcp\"\nbaud = 9600.0", "TCP has no baud rate"),
        ("[[fault]]\nfault = \"drop\"\nlink = \"usb\"", "pty, serial, can, tcp"),
        ("[[fault]]\nfault = \"drop\"\nwhen = \"rate_q > 1\"", "rate_y"),
        ("[[fault]]\nfault = \"drop\"\nwhen = \"active(x)\"", "the identifier of a fault"),
        ("[[fault]]\nid = \"a\"\nfault = \"drop\"\n[[fault]]\nid = \"a\"\nfault = \"drop\"", "plan:5"),
        ("[[expect]]\ncondition = \"t_s > 1\"", "either `within_s`"),
        ("[[expect]]\ncondition = \"t_s > 1\"\nwithin_s = 1.0\nafter = \"x\"", "there is none"),
        ("seed = 4", "expected one of: fault, expect"),
    ] {
        let error = refused(plan);
        assert!(error.contains(expected), "{plan}\n{error}");
    }
    assert!(expression::vocabulary().len() > 10 && Gyro::ALL.len() == 4);
}

#[test]
fn an_identifier_that_is_made_up_is_none_that_the_plan_gives() {
    let drop = "[[fault]]\nfault = \"drop\"\n";
    let configuration = with_plan(&format!("{drop}{drop}id = \"fault-1\"\n{drop}"));
    let ids: Vec<&str> = configuration.faults.iter().map(|fault| fault.id.as_str()).collect();
    assert_eq!(ids, ["fault-2", "fault-1", "fault-3"]);
}

#[test]
fn a_refused_plan_leaves_nothing_behind() {
    let mut configuration = Configuration::reference();
    let plan = "[[fault]]\nfault = \"drop\"\n[[fault]]\nfault = \"explode\"";
    configuration.add_plan("plan", plan).expect_err("one is unknown");
    assert_eq!(configuration, Configuration::reference());
}

#[test]
fn what_a_plan_refuses_is_refused_live() {
    let (others, one) = (with_plan("[[fault]]\nid = \"there\"\nfault = \"drop\"").faults, "fault = \"drop\"\n");
    for key in ["when", "end_when"] {
        let asking = |id: &str| format!("{one}id = \"own\"\n{key} = 'active(\"{id}\")'");
        for id in ["there", "own"] {
            read_fault_text(&Device::iras(), "fault", &asking(id), &others, &Transport::ALL).expect("both exist");
        }
        let error = read_fault_text(&Device::iras(), "fault", &asking("unknown"), &others, &Transport::ALL)
            .expect_err("there is none")
            .to_string();
        assert!(error.contains("unknown") && error.contains("there, own"), "{error}");
    }
    let many = vec![others[0].clone(); MAX_RUN_FAULTS];
    let error =
        read_fault_text(&Device::iras(), "fault", one, &many, &Transport::ALL).expect_err("one too many").to_string();
    assert!(error.contains("at most 10000 faults"), "{error}");
}

#[test]
fn what_was_taken_away_cannot_be_started_by_hand() {
    let mut unit = GyroUnit::new(&with_plan(
        "[[fault]]\nid = \"one\"\nfault = \"drop\"\nby_hand = true\n[[fault]]\nid = \"other\"\nfault = \"drop\"\nby_hand = true",
    ));
    unit.end_sample();
    assert_eq!(unit.clear("one"), Some(1.0));
    assert_eq!((unit.start("one"), unit.start("other"), unit.start("other")), (None, Some(1.0), None));
}

#[test]
fn a_shift_of_time_that_comes_and_goes_leaves_the_truth_alone() {
    let scan = "manoeuvre=[{ kind = \"y-scan\", to_theta_deg = 100.0 }]".to_owned();
    let plain = Configuration::reference_with(&[scan]).expect("valid");
    let mut shifted = plain.clone();
    let plan = "[[fault]]\nat_s = 5.0\nparameter = \"time-offset.seconds\"\ncourse = { step = 0.2 }\nfor_s = 5.0";
    shifted.add_plan("plan", plan).expect("valid");
    let (mut plain, mut shifted) = (GyroUnit::new(&plain), GyroUnit::new(&shifted));
    let mut differ = 0;
    for index in 0..60 {
        let ((_, truths), (_, traces)) = (plain.end_sample_traced(), shifted.end_sample_traced());
        for (truth, trace) in truths.iter().zip(&traces) {
            assert!((truth.true_arcsec - trace.true_arcsec).abs() < 1e-6, "{index}");
            let sum: f64 = trace.true_arcsec + trace.changes.iter().sum::<f64>();
            assert!((sum - trace.unquantised).abs() < 1e-6, "{index}");
            differ += u32::from((truth.unquantised - trace.unquantised).abs() > 1.0);
        }
    }
    assert!(differ > 0);
    let counted = |unit: &GyroUnit| unit.accumulated_counts().collect::<Vec<f64>>();
    for (plain, shifted) in counted(&plain).into_iter().zip(counted(&shifted)) {
        assert!((plain - shifted).abs() < 0.01, "{plain} {shifted}");
    }
}

#[test]
fn the_rate_of_a_recorded_serial_port_is_kept() {
    let text = "seed = 1\n[run]\nduration_s = 1.0\nlinks = [\"serial\"]\nserial_baud = 9600\n";
    let configuration = Configuration::parse("run.toml", text, &[]).expect("valid");
    assert_eq!(configuration.run.serial_baud, Some(9600));
    let again = Configuration::parse("run.toml", &configuration.to_toml(false), &[]).expect("as it was written");
    assert_eq!(again.run, configuration.run);
}

#[test]
fn a_number_is_held_to_what_the_links_can_that_a_fault_is_on() {
    let read =
        |text: &str, links: &[Transport]| read_fault_text(&Device::iras(), "fault", text, &[], links).map(|_| ());
    for (number, most, is_of_can) in [
        ("wrong-length\"\nlength", 8, true),
        ("truncate\"\nbytes", 8, true),
        ("split\"\nbyte", 2, true),
        ("wrong-identifier\"\nidentifier", 255, false),
    ] {
        let (narrow, wide) =
            if is_of_can { (Transport::Can, Transport::Pty) } else { (Transport::Tcp, Transport::Can) };
        let text = |value: u32, link: &str| format!("fault = \"{number} = {value}\n{link}");
        let link = |kind: Transport| format!("link = {:?}", kind.name());
        read(&text(most, ""), &Transport::ALL).expect("what every link can");
        read(&text(most + 1, ""), &[wide]).expect("the open link supports it");
        read(&text(most + 1, &link(wide)), &Transport::ALL).expect("the named link supports it");
        for refused in [read(&text(most + 1, ""), &Transport::ALL), read(&text(most + 1, &link(narrow)), &[wide])] {
            let error = refused.expect_err("too much").to_string();
            assert!(error.contains(&format!("at most {most} ")) && error.contains("another `link`"), "{error}");
        }
    }
}
