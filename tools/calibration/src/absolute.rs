//! Inertial rotations from the absolute sensors, the paper's way (Casteren §6): fixes of the slit star sensor at the
//! reference times, the sun sensor between them, the sun's motion integrated along the path (eqs 5–7), and the limit
//! cycle at the reference times rebuilt from the gyros laid over the sun sensor's history (figure 8).
//!
//! The path itself comes from the gyros, bent so that it goes through every fix; it only has to be good to a few
//! arcseconds, because it enters by the cosine of θ and by the sun's slow motion.

mod data;
mod overlay;
mod path;

use geu_model::sensor::SensorNumbers;
use geu_model::units::{ARCSEC_PER_RAD, RAD_PER_DEG};
use geu_protocol::Gyro;

use crate::noise::{ErrorSource, ErrorTerm, ROUNDING_VARIANCE, RandomWalks, named};
use crate::observe::{CompensatedCounts, ExcludedData, micros, outside};
use crate::solve::Observation;
use crate::sun::{Point, step_control_arcsec};
use crate::transfer::GyroSet;
use crate::window::ManoeuvreWindow;
pub use data::{AbsoluteData, Slit, StarFix};
use overlay::{CYCLE_STEPS, OVERLAY_LEAST, OVERLAY_S, Overlay};
pub use path::{GyroPath, path};
use path::{Station, interpolate, mean, stations};

/// The equations of `windows`, with rotations from the sensors, which err as `numbers` say. Each window needs a fix at
/// either end.
pub fn with_sensors(
    measured: &CompensatedCounts,
    windows: &[ManoeuvreWindow],
    sensors: &AbsoluteData,
    numbers: &SensorNumbers,
    walks: &[RandomWalks; 4],
    path: &GyroPath,
) -> (Vec<Observation>, Vec<ExcludedData>) {
    let counts = measured.counts;
    let (mut observations, mut left_out) = (Vec::new(), Vec::new());
    let stations = stations(counts, sensors);
    let start_s = counts.start_ns as f64 * 1e-9;
    let overlay = Overlay { counts, sensors, numbers, path };
    for window in windows {
        let mut leave = |why: String| {
            left_out.push(ExcludedData { name: window.name.clone(), start_s: window.start_s, gyro: None, why });
        };
        if window.start_s < start_s - 0.26 || window.end_s > start_s + counts.end_s() + 0.26 {
            leave(outside(counts, window));
            continue;
        }
        let station = |t_s: f64| stations.iter().find(|station| (station.fix.t_ns as f64 * 1e-9 - t_s).abs() < 0.26);
        let (Some(from), Some(to)) = (station(window.start_s), station(window.end_s)) else {
            let end_s = if station(window.start_s).is_none() { window.start_s } else { window.end_s };
            leave(format!("the star sensor has no fix at {end_s:.1} s"));
            continue;
        };
        if to.reading.samples - from.reading.samples < 2.0 {
            leave("it is shorter than two samples".to_owned());
            continue;
        }
        // The rotation itself rests on the gyros of the path, and the limit cycle on what is around the fixes.
        let around = |t_s: f64| counts.at(t_s.clamp(0.0, counts.end_s()));
        let path_gyros = GyroSet::WithZa.gyros().into_iter().enumerate().filter(|(_, is_used)| *is_used);
        let broken = path_gyros.into_iter().find_map(|(gyro, _)| {
            let (first, last) = (around(from.point.t_s - OVERLAY_S)?, around(to.point.t_s + OVERLAY_S)?);
            Some((gyro, counts.broken(gyro, &first, &last)?))
        });
        if let Some((gyro, broken)) = broken {
            let at_s = start_s + counts.node_s[broken.from];
            leave(format!("{}, on which its path rests: {} at {at_s:.1} s", Gyro::ALL[gyro].name(), broken.kind));
            continue;
        }
        let rolls = (overlay.limit_cycle_x_arcsec(from), overlay.limit_cycle_x_arcsec(to));
        let (Some(roll_from), Some(roll_to)) = rolls else {
            let at = if rolls.0.is_none() { from } else { to };
            leave(format!(
                "the sun sensor has fewer than {OVERLAY_LEAST} samples around {:.1} s, from which to rebuild the limit cycle",
                at.fix.t_ns as f64 * 1e-9
            ));
            continue;
        };
        let Some((own, mut disturbances)) = measured.observe(window, &from.reading, &to.reading, &mut left_out) else {
            continue;
        };
        let (rotation, of_sensors) = rotation(from, to, (roll_from, roll_to), &overlay, walks);
        disturbances.extend(of_sensors);
        observations.push(Observation {
            name: window.name.clone(),
            start_s: from.point.t_s.max(0.0),
            end_s: to.point.t_s,
            samples: to.reading.samples - from.reading.samples,
            counts: own,
            rotation_control_arcsec: rotation,
            disturbances,
        });
    }
    (observations, left_out)
}

/// Inertial rotation between two fixes, arcsec, and what disturbs it.
fn rotation(
    from: &Station,
    to: &Station,
    roll_arcsec: (f64, f64),
    overlay: &Overlay,
    walks: &[RandomWalks; 4],
) -> ([f64; 3], Vec<ErrorTerm>) {
    let Overlay { counts, numbers, path, .. } = *overlay;
    // The same slits on both sides where there are any, so that what is theirs cancels (Casteren §5).
    let in_both = |slit: &&Slit| [from, to].iter().all(|end| end.fix.slits.iter().any(|other| other.0 == slit.0));
    let any_in_both = from.fix.slits.iter().any(|slit| in_both(&slit));
    let seen =
        [from, to].map(|end| end.fix.slits.iter().filter(|slit| !any_in_both || in_both(slit)).collect::<Vec<_>>());
    let ends = seen.each_ref().map(|slits| mean(&slits.iter().map(|slit| slit.1).collect::<Vec<_>>()));
    let random_variance: f64 = seen
        .iter()
        .map(|slits| slits.iter().map(|slit| slit.2 * slit.2).sum::<f64>() / (slits.len() * slits.len()) as f64)
        .sum();
    // The ends by these slits, ψ on the path's turn. Between them the gyros' own path is bent evenly, so that no other fix
    // on the way has a part in it.
    let point = |station: &Station, angles: [f64; 2]| {
        let near = interpolate(&path.points, &station.reading);
        let mut psi = angles[1] * RAD_PER_DEG - near.psi_rad;
        psi -= (psi / std::f64::consts::TAU).round() * std::f64::consts::TAU;
        let fixed = Point { theta_rad: angles[0] * RAD_PER_DEG, psi_rad: near.psi_rad + psi, ..near };
        (interpolate(&path.unbent, &station.reading), fixed)
    };
    let ((path_start, start), (path_end, end)) = (point(from, ends[0]), point(to, ends[1]));
    // The level of θ: what slits share does not cancel in cos θ; the sun sensor tells it, as well as its steps allow.
    let slit_count = from.fix.slits.len().max(1) as f64;
    // Between the fixes the path follows GYRY, whose walks bend it: the mean of a walk's bridge, and of its integral's.
    let (walk, length_s) = (&walks[Gyro::Y as usize], end.t_s - start.t_s);
    let bridge_variance = walk.angle_arcsec_per_sqrt_s.powi(2) * length_s / 12.0
        + walk.drift_arcsec_per_s_per_sqrt_s.powi(2) * length_s.powi(3) / 120.0;
    let fix_variance = numbers.sse.slit_arcsec.powi(2) / slit_count + random_variance / 4.0 + bridge_variance;
    let cycle_variance =
        (numbers.fss.step_arcsec * CYCLE_STEPS).powi(2) + numbers.fss.noise_arcsec.powi(2) / (4.0 * OVERLAY_S);
    let (first, last) = (from.reading.samples, to.reading.samples);
    let bend = |samples: f64| {
        let share = (samples - first) / (last - first);
        let between = |from: f64, to: f64| from + (to - from) * share;
        [
            between(start.theta_rad - path_start.theta_rad, end.theta_rad - path_end.theta_rad),
            between(start.psi_rad - path_start.psi_rad, end.psi_rad - path_end.psi_rad),
        ]
    };
    let (level_arcsec, level_variance) = match overlay.level(start.t_s, end.t_s, |samples| bend(samples)[0]) {
        Some((level_arcsec, seen_variance)) => {
            let total = fix_variance + seen_variance;
            (level_arcsec * fix_variance / total, fix_variance * seen_variance / total)
        }
        None => (0.0, fix_variance),
    };
    let bent = |node: usize| {
        let (point, [theta_rad, psi_rad]) = (path.unbent[node], bend(node as f64));
        Point { t_s: counts.node_s[node], theta_rad: point.theta_rad + theta_rad, psi_rad: point.psi_rad + psi_rad }
    };
    let nodes = (first.floor() as usize + 1)..(last.ceil() as usize);
    let raised = |point: Point| Point { theta_rad: point.theta_rad + level_arcsec / ARCSEC_PER_RAD, ..point };
    let points = std::iter::once(start).chain(nodes.map(bent)).chain([end]).map(raised);
    let mut rotation = [roll_arcsec.1 - roll_arcsec.0, 0.0, 0.0];
    // Change of the rotation about X and Z with the level of θ, and the mean direction of the sun vector.
    let (mut per_level, mut sun, mut before): ([f64; 2], [f64; 3], Option<Point>) = ([0.0; 2], [0.0; 3], None);
    for point in points {
        if let Some(before) = before {
            let step = step_control_arcsec(&before, &point);
            for (sum, angle) in rotation.iter_mut().zip(step) {
                *sum += angle;
            }
            let (sin, cos) = libm::sincos((before.theta_rad + point.theta_rad) / 2.0);
            let psi = point.psi_rad - before.psi_rad;
            per_level[0] -= psi * sin;
            per_level[1] += psi * cos;
            let share = (point.t_s - before.t_s) / length_s;
            sun[0] += cos * share;
            sun[2] += sin * share;
        }
        before = Some(point);
    }
    let mut all = disturbances([from, to], &seen, sun, numbers, cycle_variance);
    all.push(ErrorTerm {
        source: ErrorSource::Level { at_us: micros(from.point.t_s) },
        variance: level_variance,
        counts: [0.0; 4],
        rotation_control_arcsec: [per_level[0], 0.0, per_level[1]],
    });
    (rotation, all)
}

/// What the fixes leave uncertain, and the limit cycle rebuilt there. An error of ψ at an end bends the path evenly, so it
/// acts by the mean direction of the sun vector on the way.
fn disturbances(
    stations: [&Station; 2],
    seen: &[Vec<&Slit>; 2],
    sun: [f64; 3],
    numbers: &SensorNumbers,
    cycle_variance: f64,
) -> Vec<ErrorTerm> {
    let mut all = Vec::new();
    let mut push = |source: ErrorSource, variance: f64, rotation_control_arcsec: [f64; 3]| {
        all.push(ErrorTerm { source, variance, counts: [0.0; 4], rotation_control_arcsec });
    };
    for ((station, slits), sign) in stations.into_iter().zip(seen).zip([-1.0, 1.0]) {
        let at_us = micros(station.point.t_s);
        for (angle, direction) in [sun, [0.0, 1.0, 0.0]].into_iter().enumerate() {
            let star = ErrorSource::Systematic { name: named("star", &station.fix.star), angle };
            push(star, numbers.sse.star_arcsec.powi(2), direction.map(|part| sign * part));
            let rotation = direction.map(|part| sign * part / slits.len() as f64);
            for (slit, _, sigma_arcsec) in slits.iter().copied() {
                let slit = named("slit", slit);
                push(ErrorSource::Sight { at_us, slit, angle }, sigma_arcsec * sigma_arcsec, rotation);
                push(ErrorSource::Systematic { name: slit, angle }, numbers.sse.slit_arcsec.powi(2), rotation);
            }
        }
        push(ErrorSource::Reference { axis: 0, at_us }, cycle_variance, [sign, 0.0, 0.0]);
        // The gyros' own rounding at the fix is in the rebuilt limit cycle and in the path: that of X stands in its counts as
        // well and cancels there; that of Z, which moves ψ, cancels between the two but for what the even bend makes of it.
        let sin = libm::sin(station.point.theta_rad);
        let of_z = [-sun[0] / sin, 0.0, 1.0 - sun[2] / sin];
        for (gyro, per_count) in [(Gyro::X, [1.0, 0.0, 0.0]), (Gyro::Za, of_z)] {
            for (index, weight) in station.reading.weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
                let source = ErrorSource::Rounding { gyro: gyro as usize, node: station.reading.first + index };
                push(source, ROUNDING_VARIANCE, per_count.map(|part| sign * weight * part));
            }
        }
    }
    all
}
