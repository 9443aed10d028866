//! Rows of the trials of a reference, which become one truth.

use std::io::Read;

use geu_model::attitude::{AttitudeRow, GAP_SPACINGS, RecordedAttitude, median_spacing_s};
use geu_model::units::RAD_PER_DEG;
use nalgebra::{Quaternion, UnitQuaternion};

use super::columns::{Columns, MotionKind, time_ns};
use super::rate_jumps::rate_jumps;
use super::{BETWEEN_TRIALS_S, Gaps, ReferenceAttitude, Trial, turn_arcsec};
use crate::csv_table::{CsvTable, TableError};

/// Time between rows, s, that is none: times are rounded.
const TOUCHING_S: f64 = 1e-6;
/// Largest sigma, half a turn: an attitude that is less certain states nothing.
const MAX_SIGMA_ARCSEC: f64 = 648_000.0;

/// A trial as it is read: rows with their lines, sigmas and starts, where there are any.
#[derive(Default)]
pub struct TrialRows {
    pub name: String,
    base_ns: Option<i64>,
    attitude: Option<UnitQuaternion<f64>>,
    pub rows: Vec<AttitudeRow>,
    lines: Vec<u64>,
    sigma_arcsec: Vec<[f64; 3]>,
    celsius: [Vec<(f64, f64)>; 2],
    acceleration_m_s2: Vec<(f64, [f64; 3])>,
    starts_s: Vec<f64>,
    /// Rows before which the turn is not known.
    unknown: Vec<usize>,
    /// Rows at the end of which the rate jumps.
    jumps: Vec<usize>,
}

impl TrialRows {
    /// A trial before its first row.
    pub fn new(name: &str) -> TrialRows {
        TrialRows { name: name.to_owned(), ..TrialRows::default() }
    }

    /// Time of a row, ns.
    pub fn t_ns(&self, row: &AttitudeRow) -> i64 {
        self.base_ns.unwrap_or(0).saturating_add((row.t_s * 1e9).round() as i64)
    }

    /// A copy without the rows before this one.
    pub fn without_first(&self, first: usize) -> TrialRows {
        fn later<T: Copy>(all: &[T], first: usize) -> Vec<T> {
            all.get(first..).unwrap_or_default().to_vec()
        }
        let from_s = self.rows.get(first).map_or(f64::INFINITY, |row| row.t_s);
        TrialRows {
            name: self.name.clone(),
            base_ns: self.base_ns,
            attitude: self.attitude,
            rows: later(&self.rows, first),
            lines: later(&self.lines, first),
            sigma_arcsec: later(&self.sigma_arcsec, first),
            celsius: self.celsius.each_ref().map(|own| later(own, own.partition_point(|known| known.0 < from_s))),
            acceleration_m_s2: later(
                &self.acceleration_m_s2,
                self.acceleration_m_s2.partition_point(|known| known.0 < from_s),
            ),
            starts_s: later(&self.starts_s, first),
            ..TrialRows::default()
        }
    }

    /// Adds a row, unless it is a dropout, which `skips` allows of rates too.
    pub fn push(&mut self, columns: &Columns, table: &CsvTable<impl Read>, skips: bool) -> Result<(), TableError> {
        let number = |column: usize| table.number(column);
        // Seconds since the first row, so that no digit of a Unix time is lost.
        let t_ns = time_ns(table, columns.time)?;
        let base_ns = *self.base_ns.get_or_insert(t_ns);
        let since_s = |t_ns: i64| t_ns.saturating_sub(base_ns) as f64 * 1e-9;
        let (t_s, is_attitude) = (since_s(t_ns), columns.kind == MotionKind::Attitude);
        if (is_attitude || skips) && columns.motion.iter().any(|&place| table.is_missing(place)) {
            return Ok(());
        }
        let mut parts = [0.0; 4];
        for (part, &place) in parts.iter_mut().zip(&columns.motion) {
            *part = number(place)? * columns.size;
        }
        let [w, x, y, z] = parts;
        for (celsius, &column) in self.celsius.iter_mut().zip(&columns.celsius) {
            if let Some(column) = column.filter(|&column| !table.is_missing(column)) {
                celsius.push((t_s, number(column)?));
            }
        }
        if let Some((places, size)) = columns.acceleration.filter(|own| !own.0.iter().any(|&at| table.is_missing(at))) {
            let [along_x, along_y, along_z] = places.map(number);
            self.acceleration_m_s2.push((t_s, [along_x? * size, along_y? * size, along_z? * size]));
        }
        let mut angle_control_arcsec = [w, x, y];
        if is_attitude {
            let now = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6);
            let now = now.ok_or_else(|| table.unexpected(columns.motion[0], "a unit quaternion"))?;
            angle_control_arcsec = turn_arcsec(&self.attitude.replace(now).unwrap_or(now), &now);
        }
        let theta_psi_rad = match columns.theta_psi {
            Some([theta, psi]) => Some((number(theta)? * RAD_PER_DEG, number(psi)? * RAD_PER_DEG)),
            None => None,
        };
        if let Some(([x, y, z], size)) = columns.sigma {
            let most = MAX_SIGMA_ARCSEC / size;
            let sigma = |column: usize| match number(column)? {
                sigma if (0.0..=most).contains(&sigma) => Ok(sigma * size),
                _ => Err(table.unexpected(column, &format!("a sigma from 0 to {most}"))),
            };
            self.sigma_arcsec.push([sigma(x)?, sigma(y)?, sigma(z)?]);
        }
        if let Some(start) = columns.start {
            let start_s = Some(since_s(time_ns(table, start)?)).filter(|start_s| *start_s < t_s);
            self.starts_s.push(start_s.ok_or_else(|| table.unexpected(start.0, "a start before the end"))?);
        }
        self.rows.push(AttitudeRow { t_s, angle_control_arcsec, theta_psi_rad });
        self.lines.push(table.line());
        Ok(())
    }

    /// Adds a point at the start of each row that does not begin where the row before ends.
    fn divide(&mut self, is_rate: bool, allows_gaps: bool) {
        let spacing_s = median_spacing_s(self.rows.iter().map(|row| row.t_s)).unwrap_or_default();
        // The rows before which a point comes, with its time.
        let mut starts: Vec<(usize, f64)> = Vec::new();
        let mut before_s: Option<f64> = None;
        for (place, row) in self.rows.iter_mut().enumerate() {
            // Without a start a row begins where the row before ends, after a gap at the median spacing.
            let is_next = |before_s: &f64| !allows_gaps || row.t_s - before_s <= GAP_SPACINGS * spacing_s;
            let usual_s = before_s.filter(is_next).unwrap_or(row.t_s - spacing_s);
            let start_s = self.starts_s.get(place).copied().unwrap_or(usual_s);
            // A start before the end of the row before is refused with the times of the truth.
            let from_s = before_s.filter(|before_s| (start_s - before_s).abs() <= TOUCHING_S).unwrap_or_else(|| {
                self.unknown.extend(before_s.map(|_| place + starts.len()));
                starts.push((place, start_s));
                start_s
            });
            if is_rate {
                let length_s = row.t_s - from_s;
                row.angle_control_arcsec = row.angle_control_arcsec.map(|part| part * length_s);
                if let Some(sigma) = self.sigma_arcsec.get_mut(place) {
                    *sigma = sigma.map(|part| part * length_s);
                }
            }
            before_s = Some(row.t_s);
        }
        self.starts_s = Vec::new();
        let places = || starts.iter().map(|own| own.0);
        insert(&mut self.lines, places(), |_, line| line);
        insert(&mut self.sigma_arcsec, places(), |_, _| [0.0; 3]);
        insert(&mut self.rows, places(), |number, row| AttitudeRow {
            t_s: starts[number].1,
            angle_control_arcsec: [0.0; 3],
            ..row
        });
    }

    /// The trial with a point at each jump of the rate, where two splines meet.
    fn divided_at_jumps(self) -> TrialRows {
        let mut jumps = rate_jumps(&self.rows, &self.unknown).into_iter().peekable();
        if jumps.peek().is_none() {
            return self;
        }
        let (rows, lines, sigmas, unknown) = (self.rows, self.lines, self.sigma_arcsec, self.unknown);
        let mut points =
            TrialRows { rows: Vec::new(), lines: Vec::new(), sigma_arcsec: Vec::new(), unknown: Vec::new(), ..self };
        for (place, (row, line)) in rows.iter().zip(lines).enumerate() {
            points.unknown.extend(unknown.binary_search(&place).ok().map(|_| points.rows.len()));
            let sigma = sigmas.get(place).copied();
            let share = jumps.next_if(|jump| jump.row == place).map(|jump| jump.share);
            let before = share.filter(|share| *share < 1.0).map(|share| {
                let [two_before_s, before_s] = [rows[place - 2].t_s, rows[place - 1].t_s];
                let first_s = share * (row.t_s - before_s);
                let turn = rows[place - 1].angle_control_arcsec.map(|part| part * first_s / (before_s - two_before_s));
                points.rows.push(AttitudeRow { t_s: before_s + first_s, angle_control_arcsec: turn, ..*row });
                points.lines.push(line);
                points.sigma_arcsec.extend(sigma.map(|sigma| sigma.map(|part| part * share.sqrt())));
                (turn, share)
            });
            points.jumps.extend(share.map(|share| if share < 1.0 { points.rows.len() - 1 } else { points.rows.len() }));
            let (turn, share) = before.unwrap_or_default();
            let angle_control_arcsec = std::array::from_fn(|axis| row.angle_control_arcsec[axis] - turn[axis]);
            points.rows.push(AttitudeRow { angle_control_arcsec, ..*row });
            points.lines.push(line);
            points.sigma_arcsec.extend(sigma.map(|sigma| sigma.map(|part| part * (1.0 - share).sqrt())));
        }
        points
    }

    /// The truth of the trials, one after the other.
    pub fn finish(
        trials: Vec<TrialRows>,
        file: &str,
        columns: &Columns,
        gaps: Gaps,
    ) -> Result<ReferenceAttitude, TableError> {
        let is_attitude = columns.kind == MotionKind::Attitude;
        let (allows_all, has_own_times) = match gaps {
            Gaps::All { has_own_times } => (true, has_own_times),
            Gaps::Refused | Gaps::OfAttitudes => (false, false),
        };
        let points = |mut own: TrialRows| {
            if is_attitude {
                return own;
            }
            own.divide(columns.kind == MotionKind::Rate, allows_all);
            if allows_all { own.divided_at_jumps() } else { own }
        };
        let (all, mut trials) = TrialRows::joined(trials.into_iter().map(points).collect(), has_own_times);
        let truth = match all.unknown.is_empty() && all.jumps.is_empty() && (is_attitude || columns.start.is_none()) {
            true => RecordedAttitude::with_gaps(all.rows),
            false => RecordedAttitude::with_unknown_turns(all.rows, all.unknown, &all.jumps, is_attitude),
        };
        let is_accepted = allows_all || is_attitude && gaps == Gaps::OfAttitudes;
        let truth = truth.and_then(|truth| if is_accepted { Ok(truth) } else { truth.without_gaps() });
        let start_s = truth.as_ref().map_or(0.0, RecordedAttitude::start_s);
        let (mut celsius, mut acceleration_m_s2) = (all.celsius, all.acceleration_m_s2);
        acceleration_m_s2.iter_mut().for_each(|(t_s, _)| *t_s -= start_s);
        celsius.iter_mut().flatten().for_each(|(t_s, _)| *t_s -= start_s);
        trials.iter_mut().for_each(|own| (own.from_s, own.to_s) = (own.from_s - start_s, own.to_s - start_s));
        trials.retain(|_| columns.trial.is_some());
        let reference = ReferenceAttitude::from_turns(file, all.base_ns.unwrap_or(0), &all.lines, None, truth)?;
        let [sigma_arcsec, turn_sigma_arcsec] =
            if is_attitude { [all.sigma_arcsec, Vec::new()] } else { [Vec::new(), all.sigma_arcsec] };
        Ok(ReferenceAttitude {
            is_attitude,
            sigma_arcsec,
            turn_sigma_arcsec,
            celsius,
            acceleration_m_s2,
            trials,
            ..reference
        })
    }

    /// The rows of all trials, of which each begins at an unknown attitude. Trials with times of their own follow one another.
    fn joined(mut trials: Vec<TrialRows>, has_own_times: bool) -> (TrialRows, Vec<Trial>) {
        trials.retain(|own| !own.rows.is_empty());
        let start_ns = |own: &TrialRows| own.base_ns.unwrap_or(0).saturating_add((own.rows[0].t_s * 1e9) as i64);
        if !has_own_times {
            trials.sort_by_key(start_ns);
        }
        let (mut all, mut places) = (TrialRows::default(), Vec::new());
        for mut own in trials {
            let all_ns = *all.base_ns.get_or_insert(own.base_ns.unwrap_or(0));
            let next_ns =
                all.rows.last().map(|last| all_ns.saturating_add(((last.t_s + BETWEEN_TRIALS_S) * 1e9) as i64));
            let moved_ns =
                next_ns.filter(|_| has_own_times).map_or(0, |next_ns| next_ns.saturating_sub(start_ns(&own)));
            let since_ns = own.base_ns.unwrap_or(0).saturating_add(moved_ns).saturating_sub(all_ns);
            let later_s = since_ns as f64 * 1e-9;
            own.rows.iter_mut().for_each(|row| row.t_s += later_s);
            own.celsius.iter_mut().flatten().for_each(|(t_s, _)| *t_s += later_s);
            own.acceleration_m_s2.iter_mut().for_each(|(t_s, _)| *t_s += later_s);
            // A first row of rates begins where the trial before ends, but for the rounding of times.
            if let Some(last) = all.rows.last().filter(|last| (own.rows[0].t_s - last.t_s).abs() <= TOUCHING_S) {
                own.rows[0].t_s = last.t_s + TOUCHING_S;
            }
            let [from_s, to_s] = [own.rows[0].t_s, own.rows[own.rows.len() - 1].t_s];
            places.push(Trial { name: std::mem::take(&mut own.name), from_s, to_s, moved_ns });
            let before = all.rows.len();
            if before == 0 {
                all = TrialRows { base_ns: all.base_ns, ..own };
                continue;
            }
            all.unknown.extend(std::iter::once(before).chain(own.unknown.iter().map(|row| row + before)));
            all.jumps.extend(own.jumps.iter().map(|row| row + before));
            all.rows.append(&mut own.rows);
            all.lines.append(&mut own.lines);
            all.sigma_arcsec.append(&mut own.sigma_arcsec);
            all.acceleration_m_s2.append(&mut own.acceleration_m_s2);
            all.celsius.iter_mut().zip(&mut own.celsius).for_each(|(all, own)| all.append(own));
        }
        (all, places)
    }
}

/// Inserts a value before each of these rising places, made of its number and the value at the place.
fn insert<T: Copy>(
    all: &mut Vec<T>,
    places: impl DoubleEndedIterator<Item = usize> + ExactSizeIterator,
    new: impl Fn(usize, T) -> T,
) {
    let (mut end, mut number) = (all.len(), places.len());
    let Some(&last) = all.last() else { return };
    all.resize(end + number, last);
    for place in places.rev() {
        // What is behind the place moves by the values inserted up to there.
        all.copy_within(place..end, place + number);
        number -= 1;
        all[place + number] = new(number, all[place + number + 1]);
        end = place;
    }
}
