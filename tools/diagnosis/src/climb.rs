//! From the grid on which shapes are looked for to the shape that suits best, by steps up along each in turn.

use geu_model::course::KINDS;
use geu_model::number::Role;

use crate::bank::Variation;

/// Times that steps are halved.
const HALVINGS: usize = 5;
/// First step of an onset, as a share of the recording: about that of the grid.
const ONSET_SHARE: f64 = 1.0 / 96.0;
/// First step of a period, as a share of the period.
const PERIOD_SHARE: f64 = 0.08;
/// First step of a phase.
const PHASE_RAD: f64 = 0.3;

/// The variation near by for which `of` is greatest, and that value. What has no shape stays.
pub fn maximise(start: Variation, duration_s: f64, of: &dyn Fn(&Variation) -> f64) -> (Variation, f64) {
    let value = of(&start);
    let Variation::Course { kind, mut shapes } = start else { return (start, value) };
    let mut best = value;
    let mut steps: Vec<f64> = KINDS[kind]
        .shapes
        .iter()
        .zip(&shapes)
        .map(|(number, value)| match number.role {
            Role::Onset => duration_s * ONSET_SHARE,
            Role::Phase => PHASE_RAD,
            _ => PERIOD_SHARE * value,
        })
        .collect();
    let mut halved = 0;
    while halved < HALVINGS && !shapes.is_empty() {
        let mut is_higher = false;
        for index in 0..shapes.len() {
            for step in [steps[index], -steps[index]] {
                let mut tried = shapes.clone();
                tried[index] += step;
                let number = &KINDS[kind].shapes[index];
                let is_inside = (number.least..=number.greatest).contains(&tried[index])
                    && tried[index] < most(number.role, duration_s);
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

/// The greatest that is looked for: an onset within the recording; a period of which half a turn is, since less of it cannot be told
/// from a ramp.
fn most(role: Role, duration_s: f64) -> f64 {
    match role {
        Role::Onset => duration_s,
        Role::Phase => f64::INFINITY,
        _ => 2.01 * duration_s,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_top_of_a_hill_is_found_between_the_points_of_the_grid() {
        let kind = KINDS.iter().position(|kind| kind.shapes.len() == 2).expect("a periodic course");
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
}
