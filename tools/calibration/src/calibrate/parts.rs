//! Calibration of a recording with a reference attitude, part by part: of a part only its observations stay in memory.

use geu_model::Configuration;
use geu_model::package::Calibration;
use geu_model::sensor::SensorNumbers;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_recording::ReferenceAttitude;

use super::{CalibrateError, Calibrated, MAX_WINDOWS, check_list, check_number, solve_observations, with_slews};
use crate::counts::AccumulatedCounts;
use crate::evaluation::{AttitudeSource, Evaluation, Observed};
use crate::noise::{ErrorSource, RandomWalks};
use crate::observe::{ExcludedData, outside, reference_sigma_arcsec};
use crate::solve::Observation;
use crate::window::{ManoeuvreWindow, cut_at_rests};

/// Observations without a list, at most: they are solved together, and their number is then the same for weeks as for days.
const MAX_JOINED: usize = 200;
/// Half a sample interval, s: the next node is nearer behind it.
const HALF_S: f64 = 0.5 * SAMPLE_INTERVAL_S;

/// The observations of a recording in parts that follow each other: the last node of one is the first of the next.
pub struct CalibrationParts<'a> {
    configuration: &'a Configuration,
    /// Manoeuvres that are still to observe; `None` without a list.
    windows: Option<&'a [ManoeuvreWindow]>,
    /// Stated noise of the reference about each axis, arcsec.
    stated_sigma_arcsec: Option<[f64; 3]>,
    /// Sums of the variances of the reference, as estimated from each part, by samples, and the number of these samples.
    variances: ([f64; 3], f64),
    observations: Vec<Observation>,
    left_out: Vec<ExcludedData>,
    /// Number of windows that the recording was cut into.
    windows_cut: usize,
    /// `None` before the first part.
    recording: Option<Recording>,
}

/// The parts up to now.
struct Recording {
    start_ns: i64,
    nodes: usize,
    end_s: f64,
    runs_back_s: Option<f64>,
    prior: Vec<Calibration>,
    walks: Vec<RandomWalks>,
}

impl<'a> CalibrationParts<'a> {
    /// A calibration before its first part; see [`super::calibrate`].
    ///
    /// # Errors
    /// A list without calibration manoeuvres, or with too many.
    pub fn new(
        configuration: &'a Configuration,
        windows: Option<&'a [ManoeuvreWindow]>,
        stated_sigma_arcsec: Option<[f64; 3]>,
    ) -> Result<CalibrationParts<'a>, CalibrateError> {
        check_list(windows)?;
        check_number(windows.map_or(0, |all| all.iter().filter(|window| !window.is_precaution()).count()))?;
        Ok(CalibrationParts {
            configuration,
            windows,
            stated_sigma_arcsec,
            variances: Default::default(),
            observations: Vec::new(),
            left_out: Vec::new(),
            windows_cut: 0,
            recording: None,
        })
    }

    /// True if no manoeuvre is under way at an instant, s on the time scale of the list, so that a part may end there.
    pub fn may_end_at(&self, t_s: f64) -> bool {
        let windows = self.windows.unwrap_or_default();
        let is_within = |(index, window): (usize, &ManoeuvreWindow)| {
            let slew = windows.get(index + 1).filter(|next| next.is_slew_after(window));
            let end_s = slew.map_or(window.end_s, |slew| slew.end_s);
            !window.is_precaution() && t_s > window.start_s + HALF_S && t_s < end_s - HALF_S
        };
        !windows.iter().take_while(|window| window.start_s < t_s).enumerate().any(is_within)
    }

    /// Observes a part.
    ///
    /// # Errors
    /// [`CalibrateError`].
    pub fn add(&mut self, counts: &AccumulatedCounts, reference: &ReferenceAttitude) -> Result<(), CalibrateError> {
        if let Some(before) = &mut self.recording {
            if counts.start_s() <= before.end_s - SAMPLE_INTERVAL_S {
                before.runs_back_s.get_or_insert(before.end_s);
            }
            // The end of a recording may be too short for a window.
            if before.runs_back_s.is_some() || counts.len() < 4 {
                return Ok(());
            }
        }
        // The noise is known once all parts are.
        let attitude = AttitudeSource::Reference(reference, Some([1.0; 3]));
        let evaluation = Evaluation::new(self.configuration, counts, &attitude)?;
        let counts = &*evaluation.counts;
        let end_s = counts.start_s() + counts.end_s();
        let taken = |own: &[ManoeuvreWindow]| own.partition_point(|own| own.start_s < end_s - HALF_S);
        let windows = self.windows.as_mut().map(|all| {
            let (own, later) = all.split_at(taken(all));
            *all = later;
            own
        });
        let (offset_s, windows_cut) = (counts.offset_s(reference), &mut self.windows_cut);
        let Observed { mut observations, left_out, .. } =
            evaluation.observe(&evaluation.prior, &SensorNumbers::default(), None, |measured, transfer, _| {
                let Some(windows) = windows else {
                    let ends_s = [reference.truth.start_s(), reference.truth.end_s()].map(|t_s| t_s - offset_s);
                    let windows = cut_at_rests(counts, transfer, ends_s, *windows_cut);
                    *windows_cut += windows.len();
                    return Ok(windows);
                };
                Ok(with_slews(measured, windows, transfer))
            })?;
        if self.stated_sigma_arcsec.is_none()
            && let Some(sigma_arcsec) = reference_sigma_arcsec(counts, reference, &evaluation.prior)
        {
            let (sums, samples) = &mut self.variances;
            sums.iter_mut().zip(sigma_arcsec).for_each(|(sum, sigma)| *sum += counts.len() as f64 * sigma * sigma);
            *samples += counts.len() as f64;
        }
        let before = self.recording.get_or_insert_with(|| Recording {
            start_ns: counts.start_ns,
            nodes: 0,
            end_s,
            runs_back_s: None,
            prior: evaluation.prior.clone(),
            walks: evaluation.walks.clone(),
        });
        let later_s = counts.start_ns.saturating_sub(before.start_ns) as f64 * 1e-9;
        observations.iter_mut().for_each(|own| own.move_later(later_s, before.nodes));
        before.nodes += counts.len();
        (before.end_s, before.runs_back_s) = (end_s, counts.runs_back_s);
        self.observations.append(&mut observations);
        self.left_out.extend(left_out);
        if windows.is_none() {
            join(&mut self.observations, MAX_JOINED);
        }
        Ok(())
    }

    /// Solves the parameters from the observations.
    ///
    /// # Errors
    /// [`CalibrateError`]: the cause, and the data that were not used.
    pub fn finish(mut self) -> Result<Calibrated, CalibrateError> {
        let Some(Recording { start_ns, end_s, runs_back_s, prior, walks, .. }) = self.recording.take() else {
            return Err(CalibrateError::TooShort(0));
        };
        let start_s = start_ns as f64 * 1e-9;
        for window in self.windows.unwrap_or_default().iter().filter(|window| !window.is_precaution()) {
            self.left_out.push(window.excluded(None, outside([start_s, end_s], window)));
        }
        self.leave_out_shortest(start_s);
        let (sums, samples) = self.variances;
        let estimated = || sums.map(|sum| (sum / samples.max(1.0)).sqrt());
        let reference_sigma_arcsec = self.stated_sigma_arcsec.unwrap_or_else(estimated);
        self.observations.iter_mut().for_each(|own| own.set_reference_sigma(reference_sigma_arcsec));
        let data = (self.observations, self.left_out);
        let calibrated = solve_observations(data, &walks, &prior, (start_s, runs_back_s))?;
        Ok(Calibrated { reference_sigma_arcsec, ..calibrated })
    }

    /// Leaves out the shortest observations if breaks separate too many, so that the others can be solved together.
    fn leave_out_shortest(&mut self, start_s: f64) {
        while self.observations.len() > MAX_WINDOWS {
            let lengths = self.observations.iter().enumerate().map(|(index, own)| (index, own.samples));
            let shortest = lengths.min_by(|(_, a), (_, b)| a.total_cmp(b)).map_or(0, |(index, _)| index);
            let Observation { name, start_s: later_s, .. } = self.observations.remove(shortest);
            let why = format!("it is shorter than {MAX_WINDOWS} others, which can be solved together");
            self.left_out.push(ExcludedData { name, start_s: start_s + later_s, gyro: None, why });
        }
    }
}

impl Observation {
    /// Moves an observation of a part to its place in the recording.
    fn move_later(&mut self, later_s: f64, nodes: usize) {
        self.start_s += later_s;
        self.end_s += later_s;
        for term in &mut self.disturbances {
            if let ErrorSource::Rounding { node, .. } | ErrorSource::Reference { node, .. } = &mut term.source {
                *node += nodes;
            }
        }
    }

    /// Sets the noise of the reference about each axis, arcsec.
    fn set_reference_sigma(&mut self, sigma_arcsec: [f64; 3]) {
        for term in &mut self.disturbances {
            if let ErrorSource::Reference { axis, .. } = term.source {
                term.variance = sigma_arcsec[axis] * sigma_arcsec[axis];
            }
        }
        self.disturbances.retain(|term| term.variance > 0.0);
    }

    /// Adds the observation that follows. What an error adds to the end of one it takes from the start of the other.
    fn join(&mut self, later: Observation) {
        let number = later.name.rsplit([' ', '…']).next().unwrap_or_default();
        self.name = format!("{}…{number}", self.name.split('…').next().unwrap_or_default());
        self.end_s = later.end_s;
        self.samples += later.samples;
        for (own, later) in self.counts.iter_mut().zip(later.counts) {
            *own = own.zip(later).map(|(own, later)| own + later);
        }
        let add = |own: &mut [f64], later: &[f64]| own.iter_mut().zip(later).for_each(|(own, later)| *own += later);
        add(&mut self.rotation_control_arcsec, &later.rotation_control_arcsec);
        for term in later.disturbances {
            match self.disturbances.iter_mut().find(|own| own.source == term.source) {
                Some(own) => {
                    add(&mut own.counts, &term.counts);
                    add(&mut own.rotation_control_arcsec, &term.rotation_control_arcsec);
                }
                None => self.disturbances.push(term),
            }
        }
        let is_error = |value: &f64| *value != 0.0;
        self.disturbances
            .retain(|own| own.counts.iter().any(is_error) || own.rotation_control_arcsec.iter().any(is_error));
    }
}

/// Joins neighbours that follow each other without a break, down to a number of observations.
fn join(observations: &mut Vec<Observation>, most: usize) {
    while observations.len() > most {
        let is_joint = |pair: &[Observation]| {
            let [one, other] = [0, 1].map(|own| pair[own].counts.iter().map(Option::is_some));
            (pair[1].start_s - pair[0].end_s).abs() < HALF_S && one.eq(other)
        };
        let pairs = observations.windows(2).enumerate().filter(|(_, pair)| is_joint(pair));
        let cheapest =
            pairs.map(|(index, pair)| (index, information_lost(pair))).min_by(|(_, a), (_, b)| a.total_cmp(b));
        let Some((index, _)) = cheapest else { return };
        let later = observations.remove(index + 1);
        observations[index].join(later);
    }
}

/// Loss of two equations that become one: their information on scale factors, drifts and misalignments is the spread of the mean rates, here about the
/// mean of both, weighed by the lengths.
fn information_lost(pair: &[Observation]) -> f64 {
    let [one, other] = [0, 1].map(|own| pair[own].samples);
    let rate = |own: usize, axis: usize| pair[own].rotation_control_arcsec[axis] / pair[own].samples;
    one * other / (one + other) * (0..3).map(|axis| (rate(0, axis) - rate(1, axis)).powi(2)).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    use geu_model::attitude::{AttitudeRow, RecordedAttitude};

    use crate::observe::{CompensatedCounts, with_reference};

    /// Samples with counts that grow, and a reference that turns ever faster.
    fn recording() -> (AccumulatedCounts, ReferenceAttitude) {
        let mut counts = AccumulatedCounts::starting_at(0);
        let mut rows = Vec::new();
        for sample in 0..=400u16 {
            let (t_s, turn) = (f64::from(sample) * SAMPLE_INTERVAL_S, f64::from(sample));
            if sample > 0 {
                counts.push(t_s, &[turn, -2.0, 0.5 * turn, 1.0], 20.0);
            }
            let angle_control_arcsec = [turn, 0.25 * turn, -3.0];
            rows.push(AttitudeRow { t_s, angle_control_arcsec, theta_psi_rad: None });
        }
        (counts, ReferenceAttitude::of_truth(0, RecordedAttitude::new(rows).expect("a truth")))
    }

    #[test]
    fn joined_observations_are_that_of_the_whole_window() {
        let (counts, reference) = recording();
        let measured = CompensatedCounts { counts: &counts, effects: None };
        let observe = |ends_s: &[f64]| {
            let window = |pair: &[f64]| ManoeuvreWindow::new("scan", pair[0], pair[1]);
            let windows: Vec<_> = ends_s.windows(2).map(window).collect();
            with_reference(&measured, &windows, &reference, [0.5, 1.0, 2.0]).0
        };
        let (mut joined, whole) = (observe(&[10.0, 60.0, 90.0, 190.0]), observe(&[10.0, 190.0]));
        assert_eq!(joined.len(), 3);
        join(&mut joined, 1);
        let sorted = |own: &Observation| {
            let mut disturbances = own.disturbances.clone();
            disturbances.sort_by_key(|term| term.source);
            disturbances
        };
        assert_eq!(sorted(&joined[0]), sorted(&whole[0]));
        let numbers = |own: &Observation| {
            let counts = own.counts.iter().copied().flatten();
            let rotation = own.rotation_control_arcsec;
            [own.start_s, own.end_s, own.samples].into_iter().chain(counts).chain(rotation).collect::<Vec<_>>()
        };
        for (own, of_whole) in numbers(&joined[0]).into_iter().zip(numbers(&whole[0])) {
            assert!((own - of_whole).abs() < 1e-6, "{own} in place of {of_whole}");
        }
    }

    #[test]
    fn neighbours_of_one_rate_are_joined_first_and_none_across_a_break() {
        let observation = |start_s: f64, rate: f64, has_counts: bool| Observation {
            name: format!("{start_s}"),
            start_s,
            end_s: start_s + 60.0,
            samples: 120.0,
            counts: vec![has_counts.then_some(1.0)],
            rotation_control_arcsec: [120.0 * rate, 0.0, 0.0],
            timing_control_arcsec: Default::default(),
            disturbances: Vec::new(),
        };
        let rates = [0.0, 0.1, 80.0, 80.2, 1.0, 1.0];
        let of_rates = || (0u8..).zip(rates).map(|(index, rate)| observation(60.0 * f64::from(index), rate, true));
        let mut observations: Vec<_> = of_rates().collect();
        join(&mut observations, 3);
        assert_eq!(observations.iter().map(|own| own.start_s).collect::<Vec<_>>(), [0.0, 120.0, 240.0]);
        // Neither across time that is missing nor between different gyros.
        let mut observations: Vec<_> = of_rates().collect();
        observations.iter_mut().skip(1).for_each(|own| (own.start_s, own.end_s) = (own.start_s + 5.0, own.end_s + 5.0));
        observations[3].counts = vec![None];
        join(&mut observations, 1);
        assert_eq!(observations.iter().map(|own| own.start_s).collect::<Vec<_>>(), [0.0, 65.0, 185.0, 245.0]);
    }

    #[test]
    fn what_comes_behind_a_time_that_runs_backward_is_left_out() {
        let (unit, (counts, reference)) = (Configuration::reference(), recording());
        let mut parts = CalibrationParts::new(&unit, None, Some([0.0; 3])).expect("no list");
        for later_s in [0, 200, 399, 600] {
            let own = AccumulatedCounts { start_ns: later_s * 1_000_000_000, ..counts.clone() };
            let reference = ReferenceAttitude { start_ns: own.start_ns, ..reference.clone() };
            parts.add(&own, &reference).expect("a part");
        }
        let recording = parts.recording.as_ref().expect("parts");
        assert_eq!((recording.nodes, recording.end_s, recording.runs_back_s), (800, 400.0, Some(400.0)));
        let CalibrateError::Unsolvable { left_out, .. } = parts.finish().expect_err("no motion") else {
            panic!("expected parameters that are not determined")
        };
        assert!(
            left_out.iter().any(|own| own.start_s == 400.0 && own.why == "times run backward there"),
            "{left_out:?}"
        );
    }

    #[test]
    fn a_part_ends_between_manoeuvres() {
        let unit = Configuration::reference();
        let list =
            [("pointing", 0.0, 100.0), ("y-scan", 100.0, 200.0), ("slew", 200.0, 230.0), ("survey", 230.0, 300.0)];
        let list = list.map(|(name, start_s, end_s)| ManoeuvreWindow::new(name, start_s, end_s));
        let parts = CalibrationParts::new(&unit, Some(&list), None).expect("manoeuvres");
        let ends: Vec<_> = (0..=700).map(|half| f64::from(half) * 0.5).filter(|t_s| parts.may_end_at(*t_s)).collect();
        // From the end of the slew on there are but precautions.
        let after = (460..=700).map(|half| f64::from(half) * 0.5);
        assert_eq!(ends, [0.0, 100.0].into_iter().chain(after).collect::<Vec<_>>());
        assert!(CalibrationParts::new(&unit, None, None).expect("no list").may_end_at(7.0));
    }
}
