//! Signatures of amplitudes that are exactly linear, for a fit: time courses put on the signature of the constant amplitude, which is run
//! once for each motion.

use std::sync::{Arc, Mutex, PoisonError};

use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::AmplitudeSource;
use geu_model::Configuration;

use crate::courses::{Courses, Mode, Variation, put};
use crate::measured::{MeasuredData, Shifts};
use crate::normal_equations::Nuisance;
use crate::signature::reaches;
use crate::signature_bank::SHARE;

/// Signatures kept: more than a selection has at a time.
const KEPT: usize = 64;

/// Inputs of the signature of a constant amplitude: amplitude, shapes of the effect, delay of the temperature.
#[derive(Debug, PartialEq)]
struct Key {
    amplitude: AmplitudeSource,
    own_shapes: Vec<f64>,
    temperature_s: f64,
}

type Kept = (Key, Arc<Nuisance>);

/// Signatures of linear amplitudes on one motion.
#[derive(Debug, Clone, Default)]
pub struct LinearSignatures {
    /// The linear amplitudes, and how time courses act on them.
    modes: Arc<Vec<(AmplitudeSource, Mode)>>,
    kept: Arc<Mutex<Vec<Kept>>>,
}

impl LinearSignatures {
    /// For these amplitudes.
    pub fn new(modes: Vec<(AmplitudeSource, Mode)>) -> LinearSignatures {
        LinearSignatures { modes: Arc::new(modes), kept: Arc::default() }
    }

    /// For another motion.
    #[must_use]
    pub fn on_another_motion(&self) -> LinearSignatures {
        LinearSignatures { kept: Arc::default(), ..self.clone() }
    }

    /// Signature of the parameter at `index` of a hypothesis; `None` if it requires runs of its own.
    pub fn column(
        &self,
        measured: &MeasuredData,
        nominal: &Configuration,
        hypothesis: &Hypothesis,
        index: usize,
        temperature_s: f64,
    ) -> Option<Nuisance> {
        let amplitude = hypothesis.amplitude;
        let (_, mode) = *self.modes.iter().find(|(source, _)| *source == amplitude.parameter)?;
        if (1..=hypothesis.own_shapes.len()).contains(&index) {
            return None;
        }
        let constant = self.constant(measured, nominal, hypothesis, temperature_s);
        let courses = Courses::on(measured, nominal).late(temperature_s);
        let on_gyros =
            |channel: usize| constant[channel].as_ref().filter(|_| reaches(&amplitude, &hypothesis.gyros, channel));
        let with = |own: &Hypothesis| -> Nuisance {
            let variation = amplitude.kind.map_or(Variation::Constant, |kind| {
                let shapes = own.course_shapes.clone();
                Variation::Course { kind, shapes }
            });
            let values = courses.values(mode, &variation, 0..courses.blocks());
            let of_channel = |values: &Vec<f64>, course| put(values, mode, course, 0..courses.blocks());
            std::array::from_fn(|channel| Some(of_channel(on_gyros(channel)?, values.as_deref())))
        };
        let now = with(hypothesis);
        if index == 0 {
            return Some(now);
        }
        let parameter = &hypothesis.parameters()[index];
        let step = parameter.step(measured.block_s());
        let mut moved = hypothesis.clone();
        moved.set(index, parameter.value + step);
        let moved = with(&moved);
        let per_unit = hypothesis.value / step;
        Some(std::array::from_fn(|channel| {
            let values = moved[channel].as_ref()?.iter().zip(now[channel].as_ref()?);
            Some(values.map(|(moved, now)| per_unit * (moved - now)).collect())
        }))
    }

    /// Signature of the constant amplitude on all of its gyros, per unit.
    fn constant(
        &self,
        measured: &MeasuredData,
        nominal: &Configuration,
        hypothesis: &Hypothesis,
        temperature_s: f64,
    ) -> Arc<Nuisance> {
        let own_shapes = hypothesis.own_shapes.clone();
        let key = Key { amplitude: hypothesis.amplitude.parameter, own_shapes: own_shapes.clone(), temperature_s };
        let find = |kept: &[Kept]| kept.iter().find(|(own, _)| *own == key).map(|(_, known)| known.clone());
        if let Some(known) = find(&self.kept.lock().unwrap_or_else(PoisonError::into_inner)) {
            return known;
        }
        let amplitude = hypothesis.amplitude.constant();
        let size = SHARE * amplitude.size().max;
        let constant =
            Hypothesis { own_shapes, ..Hypothesis::constant(amplitude, size, amplitude.gyros(&nominal.device)) };
        let shifts = Shifts { temperature_s, ..Shifts::default() };
        let mut moved = nominal.clone();
        constant.apply(&mut moved);
        let [with, without] = [&moved, nominal].map(|configuration| measured.run(configuration, shifts));
        let found = Arc::new(measured.difference(&with, &without).map(|values| {
            let any = values.iter().any(|&value| value != 0.0);
            any.then(|| values.into_iter().map(|value| value / size).collect())
        }));
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() >= KEPT {
            kept.remove(0);
        }
        kept.push((key, found.clone()));
        found
    }
}
