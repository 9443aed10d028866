//! Inertial rotations from the absolute sensors, by the paper's method (Casteren §6): fixes of the slit star sensor at the
//! reference times, the sun sensor between them, the sun's motion integrated along the path (eqs 5–7), and the limit
//! cycle at the reference times rebuilt from the gyros laid over the sun sensor's history (figure 8).
//!
//! The path itself comes from the gyros, bent through every fix. A few arcseconds suffice, because it enters by the cosine
//! of θ and by the sun's slow motion.

mod data;
mod overlay;
mod path;

use geu_model::sensor::SensorNumbers;
use geu_model::units::{ARCSEC_PER_RAD, RAD_PER_DEG};
use geu_protocol::Gyro;

use crate::noise::{ErrorSource, ErrorTerm, ROUNDING_VARIANCE, RandomWalks, source_id};
use crate::observe::{CompensatedCounts, ExcludedData, TOO_SHORT, micros, observe_each, outside};
use crate::solve::Observation;
use crate::sun::{Point, step_control_arcsec};
use crate::transfer::GyroSet;
use crate::window::ManoeuvreWindow;
pub use data::{AbsoluteData, Slit, StarFix};
use overlay::{CYCLE_STEPS, MIN_OVERLAY_SAMPLES, OVERLAY_S, Overlay};
pub use path::{GyroPath, path};
use path::{Station, interpolate, mean, stations};

/// Observations of `windows` with rotations from the sensors, whose errors are `numbers`. Each window needs a fix at
/// either end.
pub fn with_sensors(
    measured: &CompensatedCounts,
    windows: &[ManoeuvreWindow],
    sensors: &AbsoluteData,
    numbers: &SensorNumbers,
    walks: &[RandomWalks],
    path: &GyroPath,
) -> (Vec<Observation>, Vec<ExcludedData>) {
    let counts = measured.counts;
    let stations = stations(counts, sensors);
    let overlay = Overlay { counts, sensors, numbers, path };
    observe_each(windows, |window, left_out| {
        if window.start_s < counts.start_s() - 0.26 || window.end_s > counts.start_s() + counts.end_s() + 0.26 {
            return Err(outside([counts.start_s(), counts.start_s() + counts.end_s()], window));
        }
        let station = |t_s: f64| {
            let found = stations.iter().find(|station| (station.fix.t_ns as f64 * 1e-9 - t_s).abs() < 0.26);
            found.ok_or_else(|| format!("the star sensor has no fix at {t_s:.1} s"))
        };
        let (from, to) = (station(window.start_s)?, station(window.end_s)?);
        if to.reading.samples - from.reading.samples < 2.0 {
            return Err(TOO_SHORT.to_owned());
        }
        // The rotation itself rests on the gyros of the path, and the limit cycle on the samples around the fixes.
        let around = |t_s: f64| counts.at(t_s.clamp(0.0, counts.end_s()));
        let broken =
            Gyro::ALL.into_iter().zip(GyroSet::WithZa.gyros()).filter(|(_, is_used)| *is_used).find_map(|(gyro, _)| {
                let (first, last) = (around(from.point.t_s - OVERLAY_S)?, around(to.point.t_s + OVERLAY_S)?);
                Some((gyro, counts.broken(gyro.index(), &first, &last)?))
            });
        if let Some((gyro, broken)) = broken {
            return Err(format!("{}, on which its path rests: {}", gyro.name(), counts.describe(broken)));
        }
        let roll = |station: &Station| {
            overlay.limit_cycle_x_arcsec(station).ok_or_else(|| {
                let at_s = station.fix.t_ns as f64 * 1e-9;
                format!(
                    "the sun sensor has fewer than {MIN_OVERLAY_SAMPLES} samples around {at_s:.1} s, from which to \
                     rebuild the limit cycle"
                )
            })
        };
        let roll_arcsec = (roll(from)?, roll(to)?);
        let ends_s = [from.point.t_s.max(0.0), to.point.t_s];
        let mut observation = measured.observe(window, [&from.reading, &to.reading], ends_s, left_out)?;
        let (rotation, of_sensors) = rotation(from, to, roll_arcsec, &overlay, walks);
        observation.rotation_control_arcsec = rotation;
        observation.disturbances.extend(of_sensors);
        Ok(observation)
    })
}

/// Inertial rotation between two fixes, arcsec, and its errors.
fn rotation(
    from: &Station,
    to: &Station,
    roll_arcsec: (f64, f64),
    overlay: &Overlay,
    walks: &[RandomWalks],
) -> ([f64; 3], Vec<ErrorTerm>) {
    let Overlay { counts, numbers, path, .. } = *overlay;
    // The same slits on both sides if possible, so that their own errors cancel (Casteren §5).
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
    // contributes.
    let point = |station: &Station, angles: [f64; 2]| {
        let near = interpolate(&path.points, &station.reading);
        let mut psi = angles[1] * RAD_PER_DEG - near.psi_rad;
        psi -= (psi / std::f64::consts::TAU).round() * std::f64::consts::TAU;
        let fixed = Point { theta_rad: angles[0] * RAD_PER_DEG, psi_rad: near.psi_rad + psi, ..near };
        (interpolate(&path.unbent, &station.reading), fixed)
    };
    let ((path_start, start), (path_end, end)) = (point(from, ends[0]), point(to, ends[1]));
    // The level of θ: the common error of the slits does not cancel in cos θ; the sun sensor measures it within its steps.
    let slit_count = from.fix.slits.len().max(1) as f64;
    // Between the fixes the path follows GYRY, whose walks bend it: the mean of a walk's bridge, and of its integral's.
    let (walk, length_s) = (&walks[Gyro::Y.index()], end.t_s - start.t_s);
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
    let source = ErrorSource::Level { at_us: micros(from.point.t_s) };
    all.push(ErrorTerm::of_rotation(source, level_variance, [per_level[0], 0.0, per_level[1]]));
    (rotation, all)
}

/// Errors of the fixes and of the limit cycle rebuilt there. An error of ψ at an end bends the path evenly, so it acts by
/// the mean direction of the sun vector on the way.
fn disturbances(
    stations: [&Station; 2],
    seen: &[Vec<&Slit>; 2],
    sun: [f64; 3],
    numbers: &SensorNumbers,
    cycle_variance: f64,
) -> Vec<ErrorTerm> {
    let mut all = Vec::new();
    let mut push = |source, variance, rotation| all.push(ErrorTerm::of_rotation(source, variance, rotation));
    for ((station, slits), sign) in stations.into_iter().zip(seen).zip([-1.0, 1.0]) {
        let at_us = micros(station.point.t_s);
        for (angle, direction) in [sun, [0.0, 1.0, 0.0]].into_iter().enumerate() {
            let star = ErrorSource::Systematic { name: source_id("star", &station.fix.star), angle };
            push(star, numbers.sse.star_arcsec.powi(2), direction.map(|part| sign * part));
            let rotation = direction.map(|part| sign * part / slits.len() as f64);
            for (slit, _, sigma_arcsec) in slits.iter().copied() {
                let slit = source_id("slit", slit);
                push(ErrorSource::SlitCrossing { at_us, slit, angle }, sigma_arcsec * sigma_arcsec, rotation);
                push(ErrorSource::Systematic { name: slit, angle }, numbers.sse.slit_arcsec.powi(2), rotation);
            }
        }
        push(ErrorSource::LimitCycle { axis: 0, at_us }, cycle_variance, [sign, 0.0, 0.0]);
        // The gyros' own rounding at the fix is in the rebuilt limit cycle and in the path. That of X is in its counts as well
        // and cancels there; that of Z, which moves ψ, cancels between the two except for the even bend.
        let sin = libm::sin(station.point.theta_rad);
        let of_z = [-sun[0] / sin, 0.0, 1.0 - sun[2] / sin];
        for (gyro, per_count) in [(Gyro::X, [1.0, 0.0, 0.0]), (Gyro::ZA, of_z)] {
            for (node, weight) in station.reading.nodes() {
                let source = ErrorSource::Rounding { gyro: gyro.index(), node };
                push(source, ROUNDING_VARIANCE, per_count.map(|part| sign * weight * part));
            }
        }
    }
    all
}
