//! Inertial rotations from the absolute sensors, the paper's way (Casteren §6): fixes of the slit star sensor at the
//! reference times, the sun sensor between them, the sun's motion integrated along the path (eqs 5–7), and the limit
//! cycle at the reference times rebuilt from the gyros laid over the sun sensor's history (figure 8).
//!
//! The path itself comes from the gyros, bent so that it goes through every fix; it only has to be good to a few
//! arcseconds, because it enters by the cosine of θ and by the sun's slow motion.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use geu_model::sensor::{Fss, SensorNumbers};
use geu_model::units::{ARCSEC_PER_RAD, RAD_PER_DEG};
use geu_protocol::Gyro;
use geu_recording::{CsvTable, RowReader, TableError, open_rows};

use crate::counts::{Counts, Reading};
use crate::noise::{Disturbance, ROUNDING_VARIANCE, Source, Walks, named};
use crate::observe::{LeftOut, Measured, micros, outside};
use crate::solve::Observation;
use crate::sun::{Point, follow, step_control_arcsec};
use crate::transfer::{InUse, Transfer};
use crate::window::Window;

/// A star through a slit: the slit, θ and ψ in degrees, random error of each angle in arcsec.
pub type Slit = (String, [f64; 2], f64);

/// A fix: one star through one or more slits at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct Fix {
    /// The instant, ns on the time scale of the file.
    pub t_ns: i64,
    pub star: String,
    pub slits: Vec<Slit>,
}

#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sensors {
    /// Time, ns; sun angle in the XZ plane and out of it, arcsec.
    pub sun: Vec<(i64, [f64; 2])>,
    /// Fixes in order of time.
    pub fixes: Vec<Fix>,
    pub numbers: SensorNumbers,
}

impl Sensors {
    /// Reads `fss.csv` and `sse.csv`, which may be compressed.
    ///
    /// # Errors
    /// The first line that is no row.
    pub fn read(fss: &str, sse: &str, numbers: SensorNumbers) -> Result<Sensors, TableError> {
        Sensors::of_rows((fss, open(fss)?), (sse, open(sse)?), numbers)
    }

    /// Reads `sse.csv` alone.
    ///
    /// # Errors
    /// The first line that is no row.
    pub fn read_fixes(sse: &str, numbers: SensorNumbers) -> Result<Sensors, TableError> {
        let no_sun = RowReader::new(&b"t_s,theta_arcsec,roll_arcsec\n"[..]);
        Sensors::of_rows(("no sun sensor", no_sun), (sse, open(sse)?), numbers)
    }

    /// Reads texts, each with the name that errors call it by.
    ///
    /// # Errors
    /// As [`Sensors::read`].
    pub fn parse(fss: (&str, &str), sse: (&str, &str), numbers: SensorNumbers) -> Result<Sensors, TableError> {
        let (sun, stars) = (RowReader::new(fss.1.as_bytes()), RowReader::new(sse.1.as_bytes()));
        Sensors::of_rows((fss.0, sun), (sse.0, stars), numbers)
    }

    fn of_rows(
        fss: (&str, RowReader<impl Read>),
        sse: (&str, RowReader<impl Read>),
        numbers: SensorNumbers,
    ) -> Result<Sensors, TableError> {
        let (mut sun, mut table) = (Vec::<(i64, [f64; 2])>::new(), CsvTable::new(fss.0, fss.1)?);
        let [time, theta, roll] = table.columns(["t_s", "theta_arcsec", "roll_arcsec"])?;
        while table.read()? {
            let t_ns = nanoseconds(table.number(time)?);
            if sun.last().is_some_and(|last| last.0 >= t_ns) {
                return Err(table.unexpected(time, "time to rise"));
            }
            sun.push((t_ns, [table.number(theta)?, table.number(roll)?]));
        }
        let (mut fixes, mut table) = (BTreeMap::<i64, Fix>::new(), CsvTable::new(sse.0, sse.1)?);
        let [time, theta, psi, sigma, star, slit] =
            table.columns(["t_s", "theta_deg", "psi_deg", "sigma_arcsec", "star", "slit"])?;
        while table.read()? {
            let sigma_arcsec = table.number(sigma)?;
            if sigma_arcsec <= 0.0 {
                return Err(table.unexpected(sigma, "more than 0"));
            }
            let t_ns = nanoseconds(table.number(time)?);
            let new = Fix { t_ns, star: table.text(star).to_owned(), slits: Vec::new() };
            let angles_deg = [table.number(theta)?, table.number(psi)?];
            fixes.entry(t_ns).or_insert(new).slits.push((table.text(slit).to_owned(), angles_deg, sigma_arcsec));
        }
        Ok(Sensors { sun, fixes: fixes.into_values().collect(), numbers })
    }
}

fn nanoseconds(t_s: f64) -> i64 {
    (t_s * 1e9).round() as i64
}

fn open(name: &str) -> Result<RowReader<Box<dyn Read>>, TableError> {
    open_rows(Path::new(name)).map_err(TableError::read(name, "CSV of an absolute sensor"))
}

/// A fix on the path: its time since the start of the counts, its reading of them, its attitude.
#[derive(Debug, Clone)]
struct Station<'a> {
    point: Point,
    reading: Reading,
    fix: &'a Fix,
}

/// The attitude at each node, from the gyros and through every fix.
#[derive(Debug, Clone, Default)]
pub struct GyroPath {
    /// θ and ψ at each node, through every fix.
    pub points: Vec<Point>,
    /// The same from the gyros alone, through the first fix.
    pub unbent: Vec<Point>,
    /// Inertial rotation about the control axes that the gyros tell, accumulated to each node, arcsec.
    pub turned_control_arcsec: Vec<[f64; 3]>,
}

/// Seconds on either side of a reference time over which the gyros are laid over the sun sensor.
const OVERLAY_S: f64 = 30.0;
/// Samples of the sun sensor that this needs at least.
const OVERLAY_LEAST: usize = 20;
/// What the sun sensor's steps leave of the mean of θ, in steps, where motion carries it over them: over a limit cycle of
/// 4″/s and 5 s, 3.2″ in steps of 4″, the mean of the rounded sine errs by 0.2″ (rms over where its middle lies).
const LEVEL_STEPS: f64 = 1.0 / 20.0;
/// Scatter about the path, in steps, below which θ does not move over the steps; rounding that does scatters by 1/√12.
const STILL_STEPS: f64 = 0.15;
/// What the sun sensor's steps leave of the limit cycle about X, in steps: a cycle about the sun's own plane meets as many
/// steps above as below, and their errors cancel but for a small part.
const CYCLE_STEPS: f64 = 1.0 / 80.0;

/// Lays the gyros' path through the fixes. `transfer` may be rough: what it gets wrong is bent away between fixes.
pub fn path(measured: &Measured, sensors: &Sensors, transfer: &Transfer) -> Option<GyroPath> {
    let counts = measured.counts;
    let stations = stations(counts, sensors);
    let first = stations.first()?;
    let turned = turned(measured, transfer);
    let nodes = counts.node_s.len();
    let mut points = vec![first.point; nodes];
    // Forwards from the first fix and backwards from it.
    let anchor = (first.reading.half_seconds.round() as usize).min(nodes - 1);
    points[anchor] = Point { t_s: counts.node_s[anchor], ..first.point };
    let step = |from: &Point, node_from: usize, node_to: usize| {
        let about = |axis: usize| turned[node_to][axis] - turned[node_from][axis];
        follow(from, counts.node_s[node_to], about(1), about(2))
    };
    for node in anchor + 1..nodes {
        points[node] = step(&points[node - 1], node - 1, node);
    }
    for node in (0..anchor).rev() {
        points[node] = step(&points[node + 1], node + 1, node);
    }
    let unbent = points.clone();
    // Bend it through the fixes: the difference at each, straight lines between, held before the first and after the last.
    let mut bends: Vec<(f64, [f64; 2])> = Vec::new();
    for station in &stations {
        let at = interpolate(&points, &station.reading);
        let turn = std::f64::consts::TAU;
        // Turns that gyros could miscount: none. So ψ is taken to the nearest turn, after the bend so far.
        let so_far = bends.last().map_or([0.0; 2], |last| last.1);
        let mut psi = station.point.psi_rad - at.psi_rad - so_far[1];
        psi -= (psi / turn).round() * turn;
        bends.push((station.reading.half_seconds, [station.point.theta_rad - at.theta_rad, psi + so_far[1]]));
    }
    for (node, point) in points.iter_mut().enumerate() {
        let [theta, psi] = bend(&bends, node as f64);
        point.theta_rad += theta;
        point.psi_rad += psi;
    }
    Some(GyroPath { points, unbent, turned_control_arcsec: turned })
}

fn bend(bends: &[(f64, [f64; 2])], x: f64) -> [f64; 2] {
    let after = bends.partition_point(|bend| bend.0 < x);
    match (after.checked_sub(1).map(|before| &bends[before]), bends.get(after)) {
        (Some((x0, from)), Some((x1, to))) if x1 > x0 => {
            let share = (x - x0) / (x1 - x0);
            [0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * share)
        }
        (_, Some(only)) | (Some(only), None) => only.1,
        (None, None) => [0.0; 2],
    }
}

/// Rotation about the control axes at each node by eq 3, without what effects added.
fn turned(measured: &Measured, transfer: &Transfer) -> Vec<[f64; 3]> {
    let at = |node: usize| transfer.about_control_arcsec(measured.at_node(node), node as f64);
    (0..measured.counts.node_s.len()).map(at).collect()
}

fn interpolate(points: &[Point], reading: &Reading) -> Point {
    let nodes = &points[reading.first..];
    let sum = |of: fn(&Point) -> f64| reading.weights.iter().zip(nodes).map(|(weight, point)| weight * of(point)).sum();
    Point { t_s: sum(|point| point.t_s), theta_rad: sum(|point| point.theta_rad), psi_rad: sum(|point| point.psi_rad) }
}

fn stations<'a>(counts: &Counts, sensors: &'a Sensors) -> Vec<Station<'a>> {
    sensors
        .fixes
        .iter()
        .filter_map(|fix| {
            let t_s = (fix.t_ns - counts.start_ns) as f64 * 1e-9;
            let [theta_deg, psi_deg] = mean(&fix.slits.iter().map(|slit| slit.1).collect::<Vec<_>>());
            let point = Point { t_s, theta_rad: theta_deg * RAD_PER_DEG, psi_rad: psi_deg * RAD_PER_DEG };
            // A fix at the very ends of the recording is one of its nodes.
            let reading = counts
                .at_rest(t_s.clamp(0.0, counts.end_s()))
                .filter(|_| t_s > -0.26 && t_s < counts.end_s() + 0.26)?;
            Some(Station { point, reading, fix })
        })
        .collect()
}

/// Mean of θ and ψ in degrees; ψ about the first, so that 359.9 and 0.1 are neighbours.
fn mean(slits: &[[f64; 2]]) -> [f64; 2] {
    let Some(first) = slits.first() else { return [f64::NAN; 2] };
    let count = slits.len() as f64;
    let near = |psi: f64| psi - first[1] - ((psi - first[1]) / 360.0).round() * 360.0;
    [
        slits.iter().map(|slit| slit[0]).sum::<f64>() / count,
        first[1] + slits.iter().map(|slit| near(slit[1])).sum::<f64>() / count,
    ]
}

/// The equations of `windows`, with rotations from the sensors, which err as `numbers` say. Each window needs a fix at
/// either end.
pub fn with_sensors(
    measured: &Measured,
    windows: &[Window],
    sensors: &Sensors,
    numbers: &SensorNumbers,
    walks: &[Walks; 4],
    path: &GyroPath,
) -> (Vec<Observation>, Vec<LeftOut>) {
    let counts = measured.counts;
    let (mut observations, mut left_out) = (Vec::new(), Vec::new());
    let stations = stations(counts, sensors);
    let start_s = counts.start_ns as f64 * 1e-9;
    let overlay = Overlay { counts, sensors, numbers, path };
    for window in windows {
        let mut leave = |why: String| {
            left_out.push(LeftOut { name: window.name.clone(), start_s: window.start_s, gyro: None, why });
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
        if to.reading.half_seconds - from.reading.half_seconds < 2.0 {
            leave("it is shorter than two half seconds".to_owned());
            continue;
        }
        // The rotation itself rests on the gyros of the path, and the limit cycle on what is around the fixes.
        let around = |t_s: f64| counts.at(t_s.clamp(0.0, counts.end_s()));
        let path_gyros = InUse::WithZa.gyros().into_iter().enumerate().filter(|(_, is_used)| *is_used);
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
            half_seconds: to.reading.half_seconds - from.reading.half_seconds,
            counts: own,
            rotation_control_arcsec: rotation,
            disturbances,
        });
    }
    (observations, left_out)
}

/// The gyros laid over the sun sensor's history (figure 8).
struct Overlay<'a> {
    counts: &'a Counts,
    sensors: &'a Sensors,
    numbers: &'a SensorNumbers,
    path: &'a GyroPath,
}

impl Overlay<'_> {
    /// Departure about X that the gyros tell, but for a constant, at nodes around a fix, arcsec: what they turned about X less
    /// what their path and the sun account for. The path is put through this fix alone, so that no other bends it here.
    /// With the first of these nodes.
    fn about_x_arcsec(&self, station: &Station, raised_rad: f64) -> (usize, Vec<f64>) {
        // Two nodes more than the samples need, for the four that an instant is read from.
        let (from_s, to_s) = (station.point.t_s - OVERLAY_S - 1.5, station.point.t_s + OVERLAY_S + 1.5);
        let first = self.counts.node_s.partition_point(|node_s| *node_s < from_s);
        let last = self.counts.node_s.partition_point(|node_s| *node_s <= to_s);
        let raised = |node: usize| {
            let point = self.path.unbent[node];
            Point { theta_rad: point.theta_rad + raised_rad, ..point }
        };
        let mut explained = 0.0;
        let about_x = (first..last).map(|node| {
            if node > first {
                explained += step_control_arcsec(&raised(node - 1), &raised(node))[0];
            }
            self.path.turned_control_arcsec[node][0] - explained
        });
        (first, about_x.collect())
    }

    fn samples(&self, from_s: f64, to_s: f64) -> impl Iterator<Item = (f64, &[f64; 2])> {
        let ns = |t_s: f64| self.counts.start_ns + (t_s * 1e9) as i64;
        let sun = &self.sensors.sun;
        let first = sun.partition_point(|sample| sample.0 < ns(from_s));
        let last = sun.partition_point(|sample| sample.0 <= ns(to_s));
        sun[first..last].iter().map(|(t_ns, angles)| ((t_ns - self.counts.start_ns) as f64 * 1e-9, angles))
    }

    /// Turn about X out of the attitude that θ and ψ tell, at a fix: the gyros' there, with the constant and the slope that
    /// lay them over the sun sensor around it.
    fn limit_cycle_x_arcsec(&self, station: &Station) -> Option<f64> {
        let t_s = station.point.t_s;
        let theta_at = |reading: &Reading| interpolate(&self.path.unbent, reading).theta_rad;
        let raised_rad = station.point.theta_rad - theta_at(&station.reading);
        let (first, about_x_arcsec) = self.about_x_arcsec(station, raised_rad);
        let gyros = |reading: &Reading| {
            let from = reading.first.checked_sub(first)?;
            let nodes = about_x_arcsec.get(from..from + reading.weights.len())?;
            Some(reading.weights.iter().zip(nodes).map(|(weight, value)| weight * value).sum::<f64>())
        };
        let (mut count, mut sums) = (0, [0.0; 5]);
        for (sample_s, angles) in self.samples(t_s - OVERLAY_S, t_s + OVERLAY_S) {
            let Some(reading) = self.counts.at(sample_s) else { continue };
            let Some(gyros) = gyros(&reading) else { continue };
            let theta_rad = theta_at(&reading) + raised_rad;
            // The sun leaves the XZ plane by the turn about X times sin θ.
            let difference = angles[1] / libm::sin(theta_rad) - gyros;
            let x = sample_s - t_s;
            count += 1;
            for (sum, term) in sums.iter_mut().zip([1.0, x, x * x, difference, x * difference]) {
                *sum += term;
            }
        }
        let [n, x, xx, y, xy] = sums;
        let spread = n * xx - x * x;
        if count < OVERLAY_LEAST || spread <= 0.0 {
            return None;
        }
        Some(gyros(&station.reading)? + (xx * y - x * xy) / spread)
    }

    /// Mean of what the sun sensor's θ is above that of the gyros' path, bent so at so many half seconds, between two
    /// instants, arcsec, and its variance.
    fn level(&self, from_s: f64, to_s: f64, bend_rad: impl Fn(f64) -> f64) -> Option<(f64, f64)> {
        let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for (sample_s, angles) in self.samples(from_s, to_s) {
            let Some(reading) = self.counts.at(sample_s) else { continue };
            let theta_rad = interpolate(&self.path.unbent, &reading).theta_rad + bend_rad(reading.half_seconds);
            let above = angles[0] - theta_rad * ARCSEC_PER_RAD;
            count += 1.0;
            sum += above;
            squares += above * above;
        }
        if count < OVERLAY_LEAST as f64 {
            return None;
        }
        let mean = sum / count;
        let Fss { step_arcsec, noise_arcsec } = self.numbers.fss;
        let is_still = squares / count - mean * mean < (STILL_STEPS * step_arcsec).powi(2);
        let steps = if is_still { 1.0 / 12.0 } else { LEVEL_STEPS * LEVEL_STEPS };
        Some((mean, steps * step_arcsec * step_arcsec + noise_arcsec * noise_arcsec / count))
    }
}

/// Inertial rotation between two fixes, arcsec, and what disturbs it.
fn rotation(
    from: &Station,
    to: &Station,
    roll_arcsec: (f64, f64),
    overlay: &Overlay,
    walks: &[Walks; 4],
) -> ([f64; 3], Vec<Disturbance>) {
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
    let (first, last) = (from.reading.half_seconds, to.reading.half_seconds);
    let bend = |half_seconds: f64| {
        let share = (half_seconds - first) / (last - first);
        let between = |from: f64, to: f64| from + (to - from) * share;
        [
            between(start.theta_rad - path_start.theta_rad, end.theta_rad - path_end.theta_rad),
            between(start.psi_rad - path_start.psi_rad, end.psi_rad - path_end.psi_rad),
        ]
    };
    let (level_arcsec, level_variance) = match overlay.level(start.t_s, end.t_s, |half_seconds| bend(half_seconds)[0]) {
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
    all.push(Disturbance {
        source: Source::Level { at_us: micros(from.point.t_s) },
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
) -> Vec<Disturbance> {
    let mut all = Vec::new();
    let mut push = |source: Source, variance: f64, rotation_control_arcsec: [f64; 3]| {
        all.push(Disturbance { source, variance, counts: [0.0; 4], rotation_control_arcsec });
    };
    for ((station, slits), sign) in stations.into_iter().zip(seen).zip([-1.0, 1.0]) {
        let at_us = micros(station.point.t_s);
        for (angle, direction) in [sun, [0.0, 1.0, 0.0]].into_iter().enumerate() {
            let star = Source::Systematic { name: named("star", &station.fix.star), angle };
            push(star, numbers.sse.star_arcsec.powi(2), direction.map(|part| sign * part));
            let rotation = direction.map(|part| sign * part / slits.len() as f64);
            for (slit, _, sigma_arcsec) in slits.iter().copied() {
                let slit = named("slit", slit);
                push(Source::Sight { at_us, slit, angle }, sigma_arcsec * sigma_arcsec, rotation);
                push(Source::Systematic { name: slit, angle }, numbers.sse.slit_arcsec.powi(2), rotation);
            }
        }
        push(Source::Reference { axis: 0, at_us }, cycle_variance, [sign, 0.0, 0.0]);
        // The gyros' own rounding at the fix is in the rebuilt limit cycle and in the path: that of X stands in its counts as
        // well and cancels there; that of Z, which moves ψ, cancels between the two but for what the even bend makes of it.
        let sin = libm::sin(station.point.theta_rad);
        let of_z = [-sun[0] / sin, 0.0, 1.0 - sun[2] / sin];
        for (gyro, per_count) in [(Gyro::X, [1.0, 0.0, 0.0]), (Gyro::Za, of_z)] {
            for (index, weight) in station.reading.weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
                let source = Source::Rounding { gyro: gyro as usize, node: station.reading.first + index };
                push(source, ROUNDING_VARIANCE, per_count.map(|part| sign * weight * part));
            }
        }
    }
    all
}
