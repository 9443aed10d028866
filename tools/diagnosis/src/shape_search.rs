//! Optimisation of shape parameters from their grid, by steps along each in turn.

use geu_model::parameter_spec::Role;
use geu_model::time_profile::COURSES;

use crate::courses::shortest_s;
use crate::measured::BLOCK_S;
use crate::signature_bank::Variation;

/// Number of halvings of the steps.
const HALVINGS: usize = 5;
/// First step of an onset, as a share of the recording: about that of the grid.
const ONSET_SHARE: f64 = 1.0 / 96.0;
/// First step of a period, as a share of the period.
const PERIOD_SHARE: f64 = 0.08;
/// First step of a time constant, as a share of it.
const TIME_CONSTANT_SHARE: f64 = 0.3;
/// First step of a phase.
const PHASE_RAD: f64 = 0.3;

/// Local maximum of `of` near a variation, and its value. A variation without shape parameters stays; of an immediate effect the blocks
/// beside its own are tried, which the grid leaves out.
pub fn maximise(start: Variation, duration_s: f64, of: &dyn Fn(&Variation) -> f64) -> (Variation, f64) {
    let value = of(&start);
    if let Variation::Onset { block } = start {
        let near = [block.checked_sub(1), Some(block + 1).filter(|block| *block as f64 * BLOCK_S < duration_s)];
        let near = near.into_iter().flatten().map(|block| Variation::Onset { block });
        let tried = near.map(|variation| (of(&variation), variation));
        let (value, best) = tried.fold((value, start), |best, own| if own.0 > best.0 { own } else { best });
        return (best, value);
    }
    let Variation::Course { kind, mut shapes } = start else { return (start, value) };
    let mut best = value;
    let mut steps: Vec<f64> = COURSES[kind]
        .shapes
        .iter()
        .zip(&shapes)
        .map(|(number, value)| match number.role {
            // The start of the recording is an onset of its own.
            Role::Onset if *value == 0.0 => 0.0,
            Role::Onset | Role::Duration => duration_s * ONSET_SHARE,
            Role::TimeConstant => TIME_CONSTANT_SHARE * value,
            Role::Phase => PHASE_RAD,
            _ => PERIOD_SHARE * value,
        })
        .collect();
    let mut halved = 0;
    while halved < HALVINGS && !shapes.is_empty() {
        let mut is_higher = false;
        for index in 0..shapes.len() {
            for step in [steps[index], -steps[index]].into_iter().filter(|step| *step != 0.0) {
                let mut tried = shapes.clone();
                tried[index] += step;
                let number = &COURSES[kind].shapes[index];
                // Less than half of a period is not distinguishable from a ramp.
                let max = match number.role {
                    Role::Onset | Role::Duration | Role::TimeConstant => duration_s,
                    Role::Phase => f64::INFINITY,
                    _ => 2.01 * duration_s,
                };
                let min = shortest_s(number.role).unwrap_or(number.min);
                let is_inside = (min..=number.max).contains(&tried[index]) && tried[index] < max;
                let value = if is_inside { of(&Variation::Course { kind, shapes: tried.clone() }) } else { f64::NAN };
                if value > best {
                    (best, shapes, is_higher) = (value, tried, true);
                    break;
                }
            }
        }
        if !is_higher {
            steps.iter_mut().for_each(|step| *step *= 0.5);
            halved += 1;
        }
    }
    (Variation::Course { kind, shapes }, best)
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
            maximise(Variation::Course { kind, shapes: vec![5400.0, 0.0] }, 10_800.0, &of)
        else {
            panic!("a course stays one");
        };
        assert!(value > -1e-3, "{shapes:?}");
    }

    #[test]
    fn the_blocks_beside_an_onset_are_tried() {
        let of = |variation: &Variation| match variation {
            Variation::Onset { block } => -(*block as f64 - 1.0).abs(),
            _ => f64::NAN,
        };
        for (start, expected) in [(0, 1), (2, 1), (1, 1), (5, 4)] {
            assert_eq!(maximise(Variation::Onset { block: start }, 100.0, &of).0, Variation::Onset { block: expected });
        }
        // Neither before the start nor after the end.
        let later = |variation: &Variation| -of(variation);
        assert_eq!(maximise(Variation::Onset { block: 19 }, 100.0, &later).0, Variation::Onset { block: 19 });
        assert_eq!(maximise(Variation::Onset { block: 0 }, 100.0, &later).0, Variation::Onset { block: 0 });
    }
}
