//! What holds for every effect of the lists, each amplitude, every course and all gyros.

use geu_model::configuration::Configuration;
use geu_model::effect::{EffectConfiguration, Effects, GyroEffects, HEAD_COLUMNS, UnitEffects, WiringEffects};
use geu_model::package::Axes;
use geu_model::parameter_spec::{ParameterSpec, Role, ValueFormat};
use geu_model::time_profile::{COURSES, Size, TimeCourse};
use geu_model::{GyroUnit, Trace};
use geu_protocol::Gyro;

/// A unit that rests, turns about every axis and swings between; its heater is off, so that the sensor cools.
const MOVING: &str = r#"
scenario.limit_cycle = { rate_arcsec_s = 4.0, period_s = 5.0, phase_y_rad = 1.57 }
temperature.electronics = { mean_c = 21.0, amplitude_k = 1.0, period_s = 200.0 }
manoeuvre = [
    { kind = "pointing", duration_s = 20 },
    { kind = "y-scan", to_theta_deg = 70 },
    { kind = "x-scan", angle_deg = 6 },
]
[gyro]
GYRX.calibration = { scale_factor = 1.0012, drift_arcsec_per_half_s = 0.21, y_arcsec = 45.0, z_arcsec = -30.0 }
GYRY.calibration = { scale_factor = 0.9987, drift_arcsec_per_half_s = -0.135, x_arcsec = 20.0, z_arcsec = 62.0 }
GYRZA.calibration = { scale_factor = 1.0005, drift_arcsec_per_half_s = 0.082, x_arcsec = -38.0, y_arcsec = 15.0 }
GYRZB.calibration = { scale_factor = 0.9992, drift_arcsec_per_half_s = -0.305, x_arcsec = 27.0, y_arcsec = -51.0 }
"#;
const SAMPLE_INTERVALS: usize = 480;

fn moving() -> Configuration {
    Configuration::parse("moving", MOVING, &[]).unwrap_or_else(|error| panic!("{error}"))
}

fn traces(configuration: &Configuration) -> impl Iterator<Item = Vec<Trace>> {
    let mut unit = GyroUnit::new(configuration);
    let _ = unit.command(&[7, 0]);
    (0..SAMPLE_INTERVALS).map(move |_| unit.end_sample_traced().1)
}

/// One amplitude of a list, constant or as a course of [`COURSES`].
#[derive(Clone, Copy)]
struct Moved {
    effect: usize,
    amplitude: usize,
    kind: Option<usize>,
}

/// All amplitudes of a list, and every course that each can have.
fn all<E: Effects>() -> Vec<Moved> {
    let list = E::default();
    let mut all = Vec::new();
    for (effect, spec) in list.specs().iter().enumerate() {
        for kind in std::iter::once(None).chain((0..COURSES.len()).map(Some)) {
            for amplitude in 0..spec.amplitudes.len() {
                let numbers = list.numbers(effect).specs();
                if kind.is_none_or(|kind| COURSES[kind].size(spec, numbers, amplitude).is_some()) {
                    all.push(Moved { effect, amplitude, kind });
                }
            }
        }
    }
    all
}

impl Moved {
    fn code<E: Effects>(self) -> String {
        E::default().specs()[self.effect].code.to_owned() + self.kind.map_or("", |kind| COURSES[kind].name)
    }

    /// Adds this share of the largest value there is.
    fn add<E: Effects>(self, configured: &mut EffectConfiguration<E>, share: f64) {
        let Moved { effect, amplitude, kind } = self;
        let (spec, numbers) = (&configured.constant.specs()[effect], configured.constant.numbers(effect).specs());
        let sized = |max: f64| if numbers[amplitude].form == ValueFormat::Real { max * share } else { share.ceil() };
        match kind.map(|kind| COURSES[kind]) {
            None => *configured.constant.numbers_mut(effect).value_mut(amplitude) += sized(numbers[amplitude].max),
            Some(kind) => {
                let size = sized(kind.size(spec, numbers, amplitude).expect("a course there is").max);
                // A temperature that swings within minutes changes by a hundred K/h.
                let size = if kind.name == "-temperature-rate" { size / 100.0 } else { size };
                // Times off the ends of sub-steps: a clock that runs wrong by parts of a million moves none across.
                let shape = |number: &ParameterSpec| match number.role {
                    Role::Onset => 17.27,
                    Role::Phase => 0.2,
                    _ => 41.3,
                };
                let shapes: Vec<f64> = kind.shapes.iter().map(shape).collect();
                configured.courses.push(TimeCourse { effect, amplitude, size, profile: kind.with(&shapes) });
            }
        }
    }

    /// As [`Moved::add`], at all gyros with the amplitude.
    fn add_to_gyros(self, configuration: &mut Configuration, share: f64) {
        let name = GyroEffects::default().numbers(self.effect).specs()[self.amplitude].name;
        for gyro in Gyro::ALL.into_iter().filter(|gyro| Axes::of(*gyro).has_number(name)) {
            self.add(&mut configuration.gyros[gyro.index()].effects, share);
        }
    }
}

/// Every amplitude and course of every list with this share of its largest value, shapes away from their defaults.
fn with_everything(mut configuration: Configuration, share: f64) -> Configuration {
    fn shapes<E: Effects>(configured: &mut EffectConfiguration<E>) {
        for effect in 0..configured.constant.specs().len() {
            let amplitudes = configured.constant.specs()[effect].amplitudes.len();
            let numbers = configured.constant.numbers_mut(effect);
            for (index, spec) in numbers.specs().iter().enumerate().skip(amplitudes) {
                *numbers.value_mut(index) = spec.min + 0.7 * (spec.max.min(1e3) - spec.min);
            }
        }
    }
    shapes(&mut configuration.unit);
    all::<UnitEffects>().iter().for_each(|moved| moved.add(&mut configuration.unit, share));
    all::<GyroEffects>().iter().for_each(|moved| moved.add_to_gyros(&mut configuration, share));
    for gyro in &mut configuration.gyros {
        shapes(&mut gyro.effects);
        all::<WiringEffects>().iter().for_each(|moved| moved.add(&mut gyro.wiring, share));
    }
    configuration
}

#[test]
fn an_amplitude_of_zero_changes_no_bit() {
    let zeros = with_everything(moving(), 0.0);
    assert_ne!(zeros, moving());
    for (row, (plain, zeros)) in traces(&moving()).zip(traces(&zeros)).enumerate() {
        for gyro in 0..4 {
            let bits = [&plain, &zeros].map(|traces| traces[gyro].unquantised.to_bits());
            assert_eq!(bits[0], bits[1], "gyro {gyro}, row {row}");
        }
    }
}

#[test]
fn every_effect_with_every_course_reads_back() {
    let everything = with_everything(moving(), 0.5);
    for complete in [false, true] {
        let text = everything.to_toml(complete);
        let read = Configuration::parse("shown", &text, &[]).unwrap_or_else(|error| panic!("{error}\n{text}"));
        assert_eq!(read, everything, "{text}");
    }
}

/// The tables of a list that a configuration may have: each one's key, and its numbers with their limits.
fn tables<E: Effects>(has: impl Fn(&str) -> bool) -> Vec<(String, Vec<Size>)> {
    let list = E::default();
    let limits = |n: &ParameterSpec| Size { name: n.name.to_owned(), form: n.form, min: n.min, max: n.max };
    let mut tables = Vec::new();
    for (effect, spec) in list.specs().iter().enumerate() {
        let numbers = list.numbers(effect).specs();
        tables.push((spec.code.to_owned(), numbers.iter().filter(|n| has(n.name)).map(limits).collect()));
        for kind in COURSES {
            let sizes = (0..spec.amplitudes.len()).filter(|&amplitude| has(numbers[amplitude].name));
            let sizes: Vec<Size> = sizes.filter_map(|amplitude| kind.size(spec, numbers, amplitude)).collect();
            if !sizes.is_empty() {
                let shapes = kind.shapes.iter().map(limits);
                tables.push((format!("{}{}", spec.code, kind.name), sizes.into_iter().chain(shapes).collect()));
            }
        }
    }
    tables
}

#[test]
fn every_number_is_refused_beyond_its_limits_and_taken_at_them() {
    let mut places = vec![("unit".to_owned(), tables::<UnitEffects>(|_| true))];
    for gyro in Gyro::ALL {
        let place = format!("gyro.{}", gyro.name());
        places.push((place.clone(), tables::<GyroEffects>(|name| Axes::of(gyro).has_number(name))));
        places.push((place, tables::<WiringEffects>(|_| true)));
    }
    let parse = |text: &str| Configuration::parse("limits", text, &[]);
    for (place, tables) in places {
        for (key, numbers) in tables {
            for Size { name: tested, form, min, max } in &numbers {
                // Beside it the others at their largest, where every one is good.
                let table = |value: &str| {
                    let written = |Size { name, form, max, .. }: &Size| {
                        // A number of a gyro: this unit has four.
                        let other = form.written(if *form == ValueFormat::Gyro { max.min(4.0) } else { *max });
                        format!("{name} = {}", if name == tested { value } else { &other })
                    };
                    let numbers: Vec<String> = numbers.iter().map(written).collect();
                    format!("[{place}]\n{key} = {{ {} }}", numbers.join(", "))
                };
                let (good, bad) = match form {
                    ValueFormat::Real => {
                        let grain = |bound: f64| bound.abs().max(1.0) * 1e-9;
                        let beyond = [min - grain(*min), max + grain(*max)];
                        // Nothing is beyond a limit that is infinite.
                        let beyond = beyond.into_iter().filter(|value| value.is_finite()).map(|v| form.written(v));
                        (vec![form.written(*min), form.written(*max)], beyond.chain(["nan".to_owned()]).collect())
                    }
                    ValueFormat::Flag => (vec!["true".to_owned()], vec!["1".to_owned()]),
                    ValueFormat::Gyro => (vec!["\"GYRY\"".to_owned()], vec!["\"GYRQ\"".to_owned(), "1".to_owned()]),
                    ValueFormat::Whole | ValueFormat::Choice(_) => unreachable!("no effect has one"),
                };
                for value in good {
                    assert!(parse(&table(&value)).is_ok(), "{}", parse(&table(&value)).expect_err("not good"));
                }
                for value in bad {
                    let message = parse(&table(&value)).expect_err(&table(&value)).to_string();
                    assert!(message.contains(&format!("{place}.{key}.{tested}")), "{message}");
                }
            }
        }
    }
}

/// Effects that draw from a stream.
const NOISES: [&str; 4] = ["angle-random-walk", "drift-random-walk", "scale-factor-noise", "bias-instability"];
/// The noise that is proportional to the rate about the input axis, and the effects that change this rate or its time.
const RATE_NOISE: &str = "scale-factor-noise";
const CHANGE_RATE: [&str; 3] = ["misalignment", "misalignment-thermal", "time-offset"];

#[test]
fn switching_an_effect_on_moves_no_noise_of_another() {
    let noises: Vec<Moved> =
        all::<GyroEffects>().into_iter().filter(|moved| NOISES.contains(&&*moved.code::<GyroEffects>())).collect();
    assert_eq!(noises.len(), NOISES.len());
    let added = |mut configuration: Configuration, moved: &[Moved]| {
        moved.iter().for_each(|moved| moved.add_to_gyros(&mut configuration, 1e-3));
        configuration
    };
    // A contribution is a difference of counts, which other effects round otherwise, and a clock wrong by 1 ppm changes
    // it; another draw would differ by 10⁻³ or more.
    let assert_same = |plain: &Configuration, changed: &Configuration, noises: &[Moved], moved: [String; 2]| {
        let [constant, what] = moved;
        let is_same_rate =
            |noise: &Moved| noise.code::<GyroEffects>() != RATE_NOISE || !CHANGE_RATE.contains(&&*constant);
        let noises: Vec<Moved> = noises.iter().copied().filter(is_same_rate).collect();
        for (plain, changed) in traces(plain).zip(traces(changed)) {
            for (noise, gyro) in noises.iter().flat_map(|noise| (0..4).map(move |gyro| (noise, gyro))) {
                let [a, b] = [&plain, &changed].map(|traces| traces[gyro].changes[HEAD_COLUMNS + noise.effect]);
                assert!((a - b).abs() <= 1e-6, "{what} moves gyro {gyro}'s: {a} {b}");
            }
        }
    };
    fn codes<E: Effects>(moved: Moved) -> [String; 2] {
        [Moved { kind: None, ..moved }, moved].map(Moved::code::<E>)
    }
    for moved in all::<GyroEffects>() {
        let others: Vec<Moved> = noises.iter().copied().filter(|noise| noise.effect != moved.effect).collect();
        let plain = added(moving(), &others);
        assert_same(&plain, &added(plain.clone(), &[moved]), &others, codes::<GyroEffects>(moved));
    }
    for moved in all::<UnitEffects>() {
        let plain = added(moving(), &noises);
        let mut changed = plain.clone();
        moved.add(&mut changed.unit, 1e-3);
        assert_same(&plain, &changed, &noises, codes::<UnitEffects>(moved));
    }
}

#[test]
fn no_gyro_feels_what_is_switched_on_at_another() {
    let noisy = |mut configuration: Configuration| {
        for gyro in &mut configuration.gyros {
            gyro.effects.constant.angle_random_walk.arcsec_per_sqrt_s = 0.01;
            gyro.effects.constant.drift_random_walk.arcsec_per_s_per_sqrt_s = 8e-6;
        }
        configuration
    };
    let plain = noisy(moving());
    let everything = with_everything(moving(), 0.1);
    for gyro in 0..4 {
        let mut changed = plain.clone();
        changed.gyros[gyro].effects = everything.gyros[gyro].effects.clone();
        for (plain, changed) in traces(&plain).zip(traces(&changed)) {
            for other in (0..4).filter(|other| *other != gyro) {
                assert_eq!(plain[other], changed[other], "gyro {gyro} moves gyro {other}");
            }
        }
    }
}

/// The effects that are not linear in their amplitude, the distance of the stops and the width of the zone: a float that does
/// not reach them, or a rate that is not in it, does not feel it.
const NOT_LINEAR: [&str; 2] = ["pivot-clearance", "dead-zone"];
/// Two effects whose product has a kink: near rest the misalignment determines the sign of the rate, and so whether the asymmetry
/// acts at all. Halving both leaves anything from nothing to half of it.
const KINKED: [&str; 2] = ["misalignment", "scale-factor-asymmetry"];

/// The effect that is an exponential of its amplitude: of the length of a sub-step, two of it add up to no product of both.
const LAG: &str = "sensor-lag";

/// The whole of two small effects, and half of both.
const PARTS: [f64; 2] = [1.0, 0.5];

/// Together two small effects do what each does alone, and beyond that something of second order: halving both makes a
/// quarter of it.
#[test]
fn small_effects_add_up_to_second_order() {
    // Faults of the wiring have no size that could be small.
    let heads = all::<GyroEffects>().into_iter().map(|moved| (false, moved));
    let units = all::<UnitEffects>().into_iter().map(|moved| (true, moved));
    let code =
        |(unit, moved): (bool, Moved)| if unit { moved.code::<UnitEffects>() } else { moved.code::<GyroEffects>() };
    let constant = |(unit, moved): (bool, Moved)| code((unit, Moved { kind: None, ..moved }));
    let linear: Vec<(bool, Moved)> =
        heads.chain(units).filter(|moved| !NOT_LINEAR.contains(&&*constant(*moved))).collect();
    // A hundredth of what is accepted; of a ramp, which is per day, all in these four minutes. A lag of a tenth of a second is not
    // small for a limit cycle of 5 s, and a square contains that of a misalignment's rate.
    let accumulated = |moved: &[(bool, Moved)], part: f64| {
        let mut configuration = moving();
        for (unit, moved) in moved {
            let is_ramp = moved.kind.is_some_and(|kind| COURSES[kind].name == "-ramp");
            let is_tenth = [LAG, "scale-factor-quadratic"].contains(&&*constant((*unit, *moved)));
            let share = part * if is_ramp { 1.0 } else { 0.01 } * if is_tenth { 0.1 } else { 1.0 };
            if *unit {
                moved.add(&mut configuration.unit, share);
            } else {
                moved.add_to_gyros(&mut configuration, share);
            }
        }
        let mut angles: [Vec<f64>; 4] = Default::default();
        for traces in traces(&configuration) {
            for (angles, trace) in angles.iter_mut().zip(traces) {
                angles.push(angles.last().unwrap_or(&0.0) + trace.unquantised);
            }
        }
        angles
    };
    let plain = accumulated(&[], 0.0);
    let alone: Vec<[[Vec<f64>; 4]; 2]> =
        linear.iter().map(|moved| PARTS.map(|part| accumulated(&[*moved], part))).collect();
    let mut seen = 0;
    for (a, first) in linear.iter().enumerate().filter(|(_, (_, moved))| moved.kind.is_none()) {
        for (b, second) in linear.iter().enumerate() {
            let codes = [constant(*first), constant(*second)];
            // Two constants are tried once. A noise draws only while its amplitude is not 0: beside its own course it is
            // another noise.
            let tried = second.1.kind.is_none() && b <= a;
            let another_noise = codes[0] == codes[1] && NOISES.contains(&&*codes[0]);
            let kinked = codes[0] != codes[1] && codes.iter().all(|code| KINKED.contains(&&**code));
            let one_lag = codes.iter().all(|code| code == LAG);
            if tried || another_noise || kinked || one_lag {
                continue;
            }
            let both = PARTS.map(|part| accumulated(&[*first, *second], part));
            for gyro in Gyro::ALL.map(|gyro| gyro.index()) {
                let [whole, half]: [Vec<f64>; 2] = [0, 1].map(|part| {
                    let [both, first, second] = [&both, &alone[a], &alone[b]].map(|runs| &runs[part][gyro]);
                    (0..SAMPLE_INTERVALS).map(|row| both[row] - first[row] - second[row] + plain[gyro][row]).collect()
                });
                let largest = |values: &[f64]| values.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
                let difference: Vec<f64> = whole.iter().zip(half).map(|(whole, half)| 4.0 * half - whole).collect();
                let (whole, difference) = (largest(&whole), largest(&difference));
                // The next order is some percent of it; adding up 10⁵ counts costs 10⁻⁹ or so.
                let (first, second) = (code(*first), code(*second));
                assert!(
                    difference <= 0.05 * whole + 1e-7,
                    "{first} and {second}, gyro {gyro}: {whole:e}, {difference:e}"
                );
                seen += usize::from(whole > 1e-6);
            }
        }
    }
    // Most pairs have a product that stands out of the rounding; the law would hold for none at all.
    assert!(seen > 1000, "{seen}");
}
