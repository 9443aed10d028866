//! Figures of a unit as SVG files with one or two panels. Each figure simulates the unit with its own scenario. If the unit
//! lacks the effect of the figure, the paper's value is used, and the title states this.

use geu_chart::{Chart, MAX_COLUMNS, min_max, svg_file};
use geu_model::attitude::{AttitudeProfile, LimitCycle, Manoeuvre, Motion, Scenario};
use geu_model::effect::{Effects, columns};
use geu_model::parameter_spec::ParameterSet;
use geu_model::time_profile::{self, TimeCourse, TimeProfile};
use geu_model::units::{ORBIT_S, S_PER_DAY, SAMPLE_INTERVAL_S};
use geu_model::{Configuration, GyroUnit};
use geu_protocol::Gyro;
use geu_selftest::{BestLine, Receiver, transfer_function};

use crate::extent;

/// Style of points.
#[derive(Clone, Copy, PartialEq)]
enum Mark {
    /// Joined by lines.
    Line,
    Points,
    /// Held from point to point.
    Steps,
}

struct Series {
    name: String,
    mark: Mark,
    points: Vec<(f64, f64)>,
}

struct Panel {
    title: String,
    x: &'static str,
    y: &'static str,
    series: Vec<Series>,
    /// Levels to compare with, dashed, with a name.
    levels: Vec<(f64, String)>,
}

impl Series {
    fn new(name: impl Into<String>, mark: Mark, points: Vec<(f64, f64)>) -> Series {
        Series { name: name.into(), mark, points }
    }
}

impl Panel {
    /// A panel without levels.
    fn new(title: impl Into<String>, [x, y]: [&'static str; 2], series: Vec<Series>) -> Panel {
        Panel { title: title.into(), x, y, series, levels: Vec::new() }
    }

    /// Adds two levels with the same name.
    fn with_levels(mut self, levels: [f64; 2], name: &str) -> Panel {
        self.levels = levels.map(|level| (level, name.to_owned())).to_vec();
        self
    }
}

/// Panels from a unit.
type Figure = fn(&Configuration) -> Vec<Panel>;

/// Width and height of a panel, pixels.
const SIZE: (f64, f64) = (1000.0, 320.0);
/// Classes of the series in their order.
const CLASSES: [&str; 4] = ["first", "second", "third", "fourth"];

/// The names of the files.
pub fn names() -> impl Iterator<Item = &'static str> {
    FIGURES.iter().map(|(name, _)| *name)
}

/// Every figure of the unit: the file's name and its text.
pub fn figures(configuration: &Configuration) -> impl Iterator<Item = (&'static str, String)> {
    FIGURES.iter().map(|(name, figure)| {
        let panels = figure(configuration);
        (*name, svg_file(panels.iter().map(drawn).collect()))
    })
}

fn drawn(panel: &Panel) -> geu_chart::Panel {
    let points = || panel.series.iter().flat_map(|series| &series.points);
    let x = extent(points().map(|point| point.0), 0.01);
    let y = extent(points().map(|point| point.1).chain(panel.levels.iter().map(|level| level.0)), 0.08);
    let mut chart = Chart::new(&panel.title, SIZE, x, y, 2).with_left(76.0);
    chart.x_ticks(12);
    chart.y_ticks(8);
    chart.x_title(panel.x);
    chart.y_title(panel.y);
    let mut legend = Vec::new();
    for (level, name) in &panel.levels {
        chart.line("level", (x.0, *level), (x.1, *level));
        // Levels of one name are in the legend once.
        if legend.iter().all(|(_, before)| before != name) {
            legend.push(("level", name.clone()));
        }
    }
    for (Series { name, mark, points }, class) in panel.series.iter().zip(CLASSES) {
        match mark {
            Mark::Points => points.iter().for_each(|point| chart.dot(class, *point, name)),
            Mark::Line => chart.series(class, name, &[min_max(points, x, MAX_COLUMNS)]),
            Mark::Steps => {
                let held = points.windows(2).flat_map(|pair| [pair[0], (pair[1].0, pair[0].1)]);
                chart.series(class, name, &[held.collect()]);
            }
        }
        legend.push((class, name.clone()));
    }
    geu_chart::Panel { title: panel.title.clone(), chart, legend }
}

/// File names and figures.
const FIGURES: [(&str, Figure); 4] = [
    ("transfer-function.svg", transfer),
    ("pivot-transit.svg", pivot_transit),
    ("limit-cycle.svg", limit_cycle),
    ("two-weeks.svg", two_weeks),
];

/// Largest rate of the transfer function (Casteren §5).
const FULL_ARCSEC_S: f64 = 720.0;

/// A scenario of Y-scans from a first θ: (to θ in degrees, arcmin/s).
fn y_scans(theta_deg: f64, limit_cycle: LimitCycle, scans: &[(f64, f64)]) -> Scenario {
    let scan = |&(to_theta_deg, rate_arcmin_s): &(f64, f64)| {
        let mut manoeuvre = Manoeuvre::of_kind("y-scan").expect("a kind");
        set(manoeuvre.numbers_mut(), "to_theta_deg", to_theta_deg);
        set(manoeuvre.numbers_mut(), "rate_arcmin_s", rate_arcmin_s);
        manoeuvre
    };
    Scenario { theta_deg, psi_deg: 0.0, limit_cycle, manoeuvres: scans.iter().map(scan).collect() }
}

fn set(numbers: &mut dyn ParameterSet, name: &str, value: f64) {
    let index = numbers.specs().iter().position(|spec| spec.name == name).expect("a number of that name");
    *numbers.value_mut(index) = value;
}

/// Sets the paper's value of an effect if the gyro lacks it, and returns a note for the title.
fn ensure_effect(configuration: &mut Configuration, gyro: Gyro, code: &str, name: &str, paper: f64) -> String {
    let effects = &mut configuration.gyros[gyro.index()].effects;
    let index = effects.constant.specs().iter().position(|spec| spec.code == code).expect("an effect of that code");
    if effects.has(index) {
        return String::new();
    }
    set(effects.constant.numbers_mut(index), name, paper);
    format!(" ({code} the paper's; this unit has none)")
}

/// Sets the paper's time courses of an effect if no gyro has one, and returns a note for the title.
fn ensure_courses(configuration: &mut Configuration, code: &str, paper: &[(f64, TimeProfile)]) -> String {
    let specs = configuration.gyros[0].effects.constant.specs();
    let effect = specs.iter().position(|spec| spec.code == code).expect("an effect of that code");
    if configuration.gyros.iter().any(|gyro| gyro.effects.courses.iter().any(|course| course.effect == effect)) {
        return String::new();
    }
    for gyro in &mut configuration.gyros {
        gyro.effects.courses.extend(paper.iter().map(|&(size, profile)| TimeCourse {
            effect,
            amplitude: 0,
            size,
            profile,
        }));
    }
    format!(" (course of {code} the paper's; this unit has none)")
}

/// Figure 7: counts per sample interval against rate, and their departure from the best line.
fn transfer(configuration: &Configuration) -> Vec<Panel> {
    let mut configuration = configuration.clone();
    let note = ensure_effect(&mut configuration, Gyro::Y, "scale-factor-nonlinearity", "cubic_ppm", 800.0);
    let rates = [12.0, 10.5, 9.0, 7.5, 6.0, 4.5, 3.0, 1.5];
    let scans: Vec<_> = rates.iter().flat_map(|&rate| [(120.0, rate), (60.0, rate)]).collect();
    configuration.scenario = y_scans(60.0, LimitCycle::default(), &scans);
    let length_s: f64 = rates.iter().map(|rate| 2.0 * (216_000.0 / (60.0 * rate) + 60.0 * rate / 36.0)).sum();
    // The hold at the end is the point at rest.
    let rows = Receiver::new(&configuration).listen(length_s + 600.0);
    let counted: Vec<(f64, f64)> = transfer_function(&rows, Gyro::Y, 1)
        .into_iter()
        .map(|(rate, excess)| (rate, (rate + excess.value) * SAMPLE_INTERVAL_S))
        .collect();
    let best = BestLine::new(&counted);
    let departures: Vec<_> = counted
        .iter()
        .map(|&(rate, counts)| (rate, 100.0 * (counts - best.at(rate)) / (FULL_ARCSEC_S * SAMPLE_INTERVAL_S)))
        .collect();
    let ends = [-FULL_ARCSEC_S, FULL_ARCSEC_S].map(|rate| (rate, best.at(rate)));
    let line = format!(
        "best line: {:.5} arcsec per count, D {:+.4} arcsec per sample interval",
        SAMPLE_INTERVAL_S / best.slope,
        -best.level * SAMPLE_INTERVAL_S / best.slope
    );
    let series = vec![Series::new(line, Mark::Line, ends.to_vec()), Series::new("counted", Mark::Points, counted)];
    let rate = "rate about the input axis, arcsec/s";
    let departure = vec![Series::new("counted less best line", Mark::Points, departures)];
    vec![
        Panel::new("Transfer function of GYRY (Casteren figure 7)", [rate, "counts per sample interval"], series),
        Panel::new(format!("Departure from the best line{note}"), [rate, "departure, % of 720 arcsec/s"], departure)
            .with_levels([0.02, -0.02], "0.02 % (table 1)"),
    ]
}

/// Figure 6: the float of GYRX through a scan about its output axis and the rest after it.
fn pivot_transit(configuration: &Configuration) -> Vec<Panel> {
    let mut configuration = configuration.clone();
    let note = ensure_effect(&mut configuration, Gyro::X, "pivot-clearance", "clearance_arcsec", 14.0);
    let configured = configuration.scenario.limit_cycle;
    let column = columns().iter().position(|code| *code == "pivot-clearance").expect("an effect of that code");
    let simulate = |limit_cycle: LimitCycle| {
        let mut configuration = configuration.clone();
        configuration.scenario = y_scans(90.0, limit_cycle, &[(96.0, 12.0), (90.0, 12.0)]);
        let (mut unit, mut float_arcsec) = (GyroUnit::new(&configuration), 0.0);
        let scale_factor = configuration.gyros[Gyro::X.index()].calibration.scale_factor;
        let mut points = vec![(0.0, 0.0)];
        while unit.ended() < 5000 {
            let (ended, traces) = unit.end_sample_traced();
            float_arcsec += traces[Gyro::X.index()].changes[column] * scale_factor;
            points.push((ended.end_ns as f64 * 1e-9, float_arcsec));
        }
        points
    };
    let still = LimitCycle { rate_arcsec_s: 0.0, ..configured };
    let cycle =
        if configured.rate_arcsec_s > 0.0 { configured } else { LimitCycle { rate_arcsec_s: 4.0, ..configured } };
    let clearance_arcsec = configuration.gyros[Gyro::X.index()].effects.constant.pivot_clearance.clearance_arcsec;
    let runs = [
        ("without limit cycle".to_owned(), simulate(still)),
        (format!("limit cycle of {} arcsec/s", cycle.rate_arcsec_s), simulate(cycle)),
    ];
    let panel = |title: String, end_s: f64| {
        let series = runs.iter().map(|(name, points)| {
            let points = points.iter().copied().filter(|point| point.0 <= end_s).collect();
            Series::new(name.as_str(), Mark::Line, points)
        });
        Panel::new(title, ["time, s", "float about X, arcsec"], series.collect()).with_levels(
            [0.5 * clearance_arcsec, -0.5 * clearance_arcsec],
            &format!("stops, distance {clearance_arcsec} arcsec"),
        )
    };
    vec![
        panel(format!("Float of GYRX: 6° forth and back about Y at 12 arcmin/s, then rest{note}"), 110.0),
        panel(
            "The same with the whole rest: creep home at 0.015 arcsec/s (Casteren §3.3, figure 6)".to_owned(),
            f64::INFINITY,
        ),
    ]
}

/// Figure 8: the limit cycle as the gyros count it, over the angle itself.
fn limit_cycle(configuration: &Configuration) -> Vec<Panel> {
    let mut configuration = configuration.clone();
    let configured = configuration.scenario.limit_cycle;
    let note = if configured.rate_arcsec_s > 0.0 { "" } else { " (the paper's; this scenario has none)" };
    let limit_cycle =
        if configured.rate_arcsec_s > 0.0 { configured } else { LimitCycle { rate_arcsec_s: 5.0, ..configured } };
    configuration.scenario = y_scans(90.0, limit_cycle, &[]);
    let length_s = 6.0 * limit_cycle.period_s;
    let rows = Receiver::new(&configuration).listen(length_s);
    let plan = AttitudeProfile::new(&configuration.scenario).expect("a hold is possible");
    let (mut motion, mut turned_arcsec, step_s) = (Motion::new(plan, limit_cycle), [0.0; 3], length_s / 600.0);
    let mut truth = vec![(0.0, turned_arcsec)];
    while truth.len() <= 600 {
        let end_s = truth.len() as f64 * step_s;
        let angle_arcsec = motion.advance(end_s).angle_control_arcsec;
        turned_arcsec = std::array::from_fn(|axis| turned_arcsec[axis] + angle_arcsec[axis]);
        truth.push((end_s, turned_arcsec));
    }
    let panel = |gyro: Gyro, axis: usize, title: String| {
        let calibration = &configuration.gyros[gyro.index()].calibration;
        let corrected = |index: usize| {
            rows[index].counts[gyro.index()] * calibration.scale_factor
                + calibration.drift_arcsec_per_half_s * (index + 1) as f64
        };
        let angle = truth.iter().map(|(t_s, turned_arcsec)| (*t_s, turned_arcsec[axis])).collect();
        let counted = (0..rows.len()).map(|index| (rows[index].t_s, corrected(index))).collect();
        let series = vec![
            Series::new("true angle", Mark::Line, angle),
            Series::new(format!("{}, counts · SF + D", gyro.name()), Mark::Steps, counted),
        ];
        Panel::new(title, ["time, s", "angle, arcsec"], series)
    };
    let rate = limit_cycle.rate_arcsec_s;
    vec![
        panel(Gyro::X, 0, format!("Limit cycle of {rate} arcsec/s about X (Casteren figure 8){note}")),
        panel(Gyro::Y, 1, "About Y, a quarter of a period before".to_owned()),
    ]
}

/// Drift and scale factor over two weeks, as they depart from the calibration.
fn two_weeks(configuration: &Configuration) -> Vec<Panel> {
    let mut configuration = configuration.clone();
    configuration.scenario = y_scans(90.0, LimitCycle::default(), &[]);
    let drifts = ensure_courses(&mut configuration, "drift", &[(0.4, time_profile::from_name("-ramp").with(&[]))]);
    // 40 ppm per month, 12.5 ppm per K.
    let scales = ensure_courses(
        &mut configuration,
        "scale-factor",
        &[
            (40.0 / 30.4375, time_profile::from_name("-ramp").with(&[])),
            (12.5, time_profile::from_name("-temperature").with(&[])),
        ],
    );
    let columns = columns();
    let drift_columns: Vec<usize> = (0..columns.len()).filter(|&column| columns[column].starts_with("drift")).collect();
    let (mut unit, mut drift, mut scale) =
        (GyroUnit::new(&configuration), [(); 4].map(|()| Vec::new()), [(); 4].map(|()| Vec::new()));
    let per_h = 7200;
    for hour in 0..14 * 24 {
        let mut angle_arcsec = [0.0; 4];
        for _ in 0..per_h {
            let (_, traces) = unit.end_sample_traced();
            for (gyro, trace) in traces.iter().enumerate() {
                let counts: f64 = drift_columns.iter().map(|&column| trace.changes[column]).sum();
                angle_arcsec[gyro] -= counts * configuration.gyros[gyro].calibration.scale_factor;
            }
        }
        let day = (f64::from(hour) + 0.5) / 24.0;
        for (gyro, points) in drift.iter_mut().enumerate() {
            points.push((day, angle_arcsec[gyro]));
        }
    }
    // Means over an orbit, as the temperature swings with it.
    let (orbits, samples) = ((14.0 * S_PER_DAY / ORBIT_S) as u32, 60);
    for orbit in 0..orbits {
        let mut sum_ppm = [0.0; 4];
        for sample in 0..samples {
            let start_s = (f64::from(orbit) + f64::from(sample) / f64::from(samples)) * ORBIT_S;
            let interval = configuration.electronics.interval(start_s, start_s + SAMPLE_INTERVAL_S);
            let clock_ppm = configuration.unit.at(&interval).clock_frequency.ppm;
            for (sum_ppm, gyro) in sum_ppm.iter_mut().zip(&configuration.gyros) {
                *sum_ppm += gyro.effects.at(&interval).scale_factor.ppm - clock_ppm;
            }
        }
        let day = (f64::from(orbit) + 0.5) * ORBIT_S / S_PER_DAY;
        for (points, sum_ppm) in scale.iter_mut().zip(sum_ppm) {
            points.push((day, sum_ppm / f64::from(samples)));
        }
    }
    let series = |points: [Vec<(f64, f64)>; 4]| {
        Gyro::ALL.into_iter().zip(points).map(|(gyro, points)| Series::new(gyro.name(), Mark::Line, points)).collect()
    };
    vec![
        Panel::new(
            format!("Drift over two weeks, hourly means, less the calibration{drifts}"),
            ["time, days", "drift, arcsec/h"],
            series(drift),
        )
        .with_levels([6.0, -6.0], "6 arcsec/h (table 1)"),
        Panel::new(
            format!("Scale factor over two weeks, orbit means, less the calibration{scales}"),
            ["time, days", "scale factor, ppm"],
            series(scale),
        ),
    ]
}
