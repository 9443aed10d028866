//! Optimisation of shape parameters from their grid, by steps along each in turn.

use geu_model::parameter_spec::{ParameterSpec, Role};
use geu_model::time_profile::COURSES;

use crate::courses::shortest_s;
use crate::signature_bank::Variation;

/// Number of halvings of the steps.
const HALVINGS: usize = 5;
/// First step of an onset, as a share of the recording: about that of the grid.
const ONSET_SHARE: f64 = 1.0 / 96.0;
/// Durations and time constants tried from there: halves of the recording, of that, and so on.
pub const LENGTHS: i32 = 5;
/// First step of a period, as a share of the period.
const PERIOD_SHARE: f64 = 0.08;
/// First step of a time constant, as a share of it.
const TIME_CONSTANT_SHARE: f64 = 0.3;
/// First step of a phase.
const PHASE_RAD: f64 = 0.3;

/// Local maximum of `of` near a variation in a recording of this duration and blocks of that length, and its value. A variation without shape parameters stays; of an immediate effect the blocks
/// beside its own are tried, which the grid leaves out. Courses that begin or end at each of `onsets_s` are further starts. The maximum may
/// be narrower than the grid.
pub fn maximise(
    start: Variation,
    [duration_s, block_s]: [f64; 2],
    is_narrow: bool,
    onsets_s: &[f64],
    of: &dyn Fn(&Variation) -> f64,
) -> (Variation, f64) {
    let value = of(&start);
    if let Variation::Onset { block } = start {
        let near = [block.checked_sub(1), Some(block + 1).filter(|block| *block as f64 * block_s < duration_s)];
        let near = near.into_iter().flatten().map(|block| Variation::Onset { block });
        let tried = near.map(|variation| (of(&variation), variation));
        let (value, best) = tried.fold((value, start), |best, own| if own.0 > best.0 { own } else { best });
        return (best, value);
    }
    let Variation::Course { kind, shapes } = start else { return (start, value) };
    let course = Course { kind, duration_s, block_s, is_narrow, of };
    let from_onsets: Vec<Valued> =
        onsets_s.iter().filter_map(|own| course.at_likeliest_length(&shapes, *own)).collect();
    let starts = std::iter::once((value, shapes)).chain(from_onsets);
    let best = starts.map(|start| course.ascend(start)).reduce(|best, own| if own.0 > best.0 { own } else { best });
    let (value, shapes) = best.expect("the start itself");
    (Variation::Course { kind, shapes }, value)
}

/// A time course, the length of the recording, and what is maximised.
struct Course<'a> {
    kind: usize,
    duration_s: f64,
    block_s: f64,
    is_narrow: bool,
    of: &'a dyn Fn(&Variation) -> f64,
}

/// Shape parameters and the value there.
type Valued = (f64, Vec<f64>);

impl Course<'_> {
    fn place(&self, role: Role) -> Option<usize> {
        COURSES[self.kind].shapes.iter().position(|number| number.role == role)
    }

    fn valued(&self, shapes: Vec<f64>) -> Valued {
        ((self.of)(&Variation::Course { kind: self.kind, shapes: shapes.clone() }), shapes)
    }

    /// The best course that begins or ends then, with the other shapes of `start`; `None` if it has no onset.
    fn at_likeliest_length(&self, start: &[f64], begin_s: f64) -> Option<Valued> {
        let onset = self.place(Role::Onset)?;
        let length = self.place(Role::Duration).or_else(|| self.place(Role::TimeConstant));
        let Some(length) = length else { return Some(self.valued(vec![begin_s])) };
        let of_length = |length_s: f64| {
            let at = move |onset_s: f64| {
                let mut shapes = start.to_vec();
                (shapes[onset], shapes[length]) = (onset_s, length_s);
                shapes
            };
            let ends = self.place(Role::Duration).map(|_| begin_s - length_s).filter(|onset_s| *onset_s > 0.0);
            std::iter::once(begin_s).chain(ends).map(at).collect::<Vec<_>>()
        };
        let lengths_s = (1..=LENGTHS).map(|halvings| self.duration_s * 0.5_f64.powi(halvings));
        let tried = lengths_s.flat_map(of_length).map(|shapes| self.valued(shapes));
        tried.reduce(|best, own| if own.0 > best.0 { own } else { best })
    }

    /// First steps: each shape alone; where the maximum is narrow, also an onset with its end held.
    fn directions(&self, shapes: &[f64]) -> Vec<Vec<(usize, f64)>> {
        let onset_s = self.duration_s * ONSET_SHARE;
        let step = |(number, value): (&ParameterSpec, &f64)| match number.role {
            // The start of the recording is an onset of its own.
            Role::Onset if *value == 0.0 => 0.0,
            Role::Onset | Role::Duration => onset_s,
            Role::TimeConstant => TIME_CONSTANT_SHARE * value,
            Role::Phase => PHASE_RAD,
            _ => PERIOD_SHARE * value,
        };
        let numbers = COURSES[self.kind].shapes.iter().zip(shapes);
        let alone = numbers.enumerate().map(|(index, number)| vec![(index, step(number))]);
        let ends = self.place(Role::Onset).zip(self.place(Role::Duration));
        let ends = ends.filter(|&(onset, _)| self.is_narrow && shapes[onset] != 0.0);
        alone.chain(ends.map(|(onset, duration)| vec![(onset, onset_s), (duration, -onset_s)])).collect()
    }

    fn is_possible(&self, shapes: &[f64]) -> bool {
        COURSES[self.kind].shapes.iter().zip(shapes).all(|(number, value)| {
            // Less than half of a period is not distinguishable from a ramp.
            let max = match number.role {
                Role::Onset | Role::Duration | Role::TimeConstant => self.duration_s,
                Role::Phase => f64::INFINITY,
                _ => 2.01 * self.duration_s,
            };
            let min = shortest_s(number.role, self.block_s).unwrap_or(number.min);
            (min..=number.max).contains(value) && *value < max
        })
    }

    /// Local maximum.
    fn ascend(&self, start: Valued) -> Valued {
        let directions = self.directions(&start.1);
        let (mut best, mut halved, mut length) = (start, 0, 1.0);
        while halved < HALVINGS {
            let mut is_higher = false;
            for direction in &directions {
                for length in [length, -length] {
                    let mut tried = best.1.clone();
                    direction.iter().for_each(|(index, step)| tried[*index] += length * step);
                    if tried == best.1 || !self.is_possible(&tried) {
                        continue;
                    }
                    let tried = self.valued(tried);
                    if tried.0 > best.0 {
                        (best, is_higher) = (tried, true);
                        break;
                    }
                }
            }
            if !is_higher {
                length *= 0.5;
                halved += 1;
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maximum_between_grid_points_is_found() {
        let kind = COURSES
            .iter()
            .position(|kind| kind.shapes.iter().any(|shape| shape.role == Role::Phase))
            .expect("a periodic course");
        let of = |variation: &Variation| match variation {
            Variation::Course { shapes, .. } => -((shapes[0] - 5130.0) / 800.0).powi(2) - (shapes[1] - 0.7).powi(2),
            _ => f64::NAN,
        };
        let (Variation::Course { shapes, .. }, value) =
            maximise(Variation::Course { kind, shapes: vec![5400.0, 0.0] }, [10_800.0, 5.0], false, &[], &of)
        else {
            panic!("a course stays one");
        };
        assert!(value > -1e-3, "{shapes:?}");
    }

    #[test]
    fn a_pulse_narrower_than_the_grid_is_found_from_its_end() {
        let mut courses = COURSES.iter();
        let kind = courses.position(|kind| kind.shapes.iter().any(|shape| shape.role == Role::Duration));
        let kind = kind.expect("a pulse");
        let duration_s = 10_800.0;
        // Cones of 15 s around an onset at 3210 s and a duration of 1350 s, an eighth of the recording.
        let near = |value: f64, centre: f64| (1.0 - (value - centre).abs() / 15.0).max(0.0);
        let of = |variation: &Variation| match variation {
            Variation::Course { shapes, .. } => {
                near(shapes[0], 3210.0) * shapes.get(1).map_or(1.0, |length_s| near(*length_s, 1350.0))
            }
            _ => f64::NAN,
        };
        let start = || Variation::Course { kind, shapes: vec![3600.0, 2700.0] };
        assert_eq!(maximise(start(), [duration_s, 5.0], false, &[], &of).1, 0.0);
        assert!(maximise(start(), [duration_s, 5.0], true, &[4560.0], &of).1 > 0.9);
    }

    #[test]
    fn what_settles_is_found_from_a_further_onset() {
        let kind = COURSES.iter().position(|kind| kind.shapes.iter().any(|shape| shape.role == Role::TimeConstant));
        let kind = kind.expect("a course that settles");
        // A low hill at the start, and a higher one at another onset.
        let of = |variation: &Variation| match variation {
            Variation::Course { shapes, .. } => {
                let hill = |onset_s: f64, constant_s: f64| {
                    ((shapes[0] - onset_s) / 200.0).powi(2) + ((shapes[1] - constant_s) / 500.0).powi(2)
                };
                (-hill(3450.0, 4800.0)).exp().max(2.0 * (-hill(5200.0, 1230.0)).exp())
            }
            _ => f64::NAN,
        };
        let start = || Variation::Course { kind, shapes: vec![3450.0, 5400.0] };
        assert!(maximise(start(), [10_800.0, 5.0], false, &[], &of).1 < 1.1);
        assert!(maximise(start(), [10_800.0, 5.0], false, &[5190.0], &of).1 > 1.9);
    }

    #[test]
    fn the_blocks_beside_an_onset_are_tried() {
        let of = |variation: &Variation| match variation {
            Variation::Onset { block } => -(*block as f64 - 1.0).abs(),
            _ => f64::NAN,
        };
        for (start, expected) in [(0, 1), (2, 1), (1, 1), (5, 4)] {
            assert_eq!(
                maximise(Variation::Onset { block: start }, [100.0, 5.0], true, &[], &of).0,
                Variation::Onset { block: expected }
            );
        }
        // Neither before the start nor after the end.
        let later = |variation: &Variation| -of(variation);
        assert_eq!(
            maximise(Variation::Onset { block: 19 }, [100.0, 5.0], true, &[], &later).0,
            Variation::Onset { block: 19 }
        );
        assert_eq!(
            maximise(Variation::Onset { block: 0 }, [100.0, 5.0], true, &[], &later).0,
            Variation::Onset { block: 0 }
        );
    }
}
