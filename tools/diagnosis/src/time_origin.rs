//! Shift of a configuration's time origin, for a motion that starts later.

use geu_model::Configuration;
use geu_model::effect::{EffectConfiguration, Effects};
use geu_model::parameter_spec::Role;

/// Shifts every time course by −`by_s`. The temperatures stay.
pub fn shift_origin(configuration: &mut Configuration, by_s: f64) {
    move_courses(&mut configuration.unit, by_s);
    for gyro in &mut configuration.gyros {
        move_courses(&mut gyro.effects, by_s);
    }
}

fn move_courses<E: Effects>(configured: &mut EffectConfiguration<E>, by_s: f64) {
    for effect in 0..configured.constant.specs().len() {
        let numbers = configured.constant.numbers_mut(effect);
        for (index, _) in numbers.specs().iter().enumerate().filter(|(_, number)| number.role == Role::Onset) {
            *numbers.value_mut(index) -= by_s;
        }
    }
    let EffectConfiguration { constant, courses, .. } = configured;
    for course in courses {
        *constant.numbers_mut(course.effect).value_mut(course.amplitude) += course.shift_origin(by_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geu_model::time_profile::Interval;

    #[test]
    fn shifted_courses_equal_later_original_courses() {
        let overrides = [
            "gyro.GYRX.drift-step.arcsec_per_h=50",
            "gyro.GYRX.drift-step.time_s=5000",
            "gyro.GYRX.scale-factor-ramp.ppm_per_day=300",
            "gyro.GYRX.drift-periodic.amplitude_arcsec_per_h=20",
            "gyro.GYRX.drift-periodic.period_s=6180",
        ];
        let own = Configuration::reference_with(&overrides.map(str::to_owned)).expect("valid");
        let mut later = own.clone();
        shift_origin(&mut later, 4000.0);
        let at = |configuration: &Configuration, start_s: f64| {
            let interval =
                Interval { start_s, end_s: start_s + 0.5, electronics_excess_k: 3.0, electronics_rate_k_per_h: 2.0 };
            let effects = configuration.gyros[0].effects.at(&interval);
            (0..effects.specs().len()).map(|effect| effects.numbers(effect).value(0)).collect::<Vec<_>>()
        };
        for t_s in [0.0, 900.0, 1100.0, 7000.0] {
            for (one, other) in at(&later, t_s).into_iter().zip(at(&own, 4000.0 + t_s)) {
                assert!((one - other).abs() < 1e-9, "{t_s} s: {one} {other}");
            }
        }
    }
}
