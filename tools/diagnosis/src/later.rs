//! A configuration as it stands some time after its start, for a flight whose own time begins there.

use geu_model::Configuration;
use geu_model::course::TimeFunction;
use geu_model::effect::{EffectConfiguration, Effects};
use geu_model::number::Role;
use geu_model::units::S_PER_DAY;

/// Moves every course so that what the configuration does from `by_s` on is done from 0 on. The temperatures are not moved.
pub fn shift_origin(configuration: &mut Configuration, by_s: f64) {
    move_courses(&mut configuration.unit, by_s);
    for gyro in &mut configuration.gyros {
        move_courses(&mut gyro.effects, by_s);
    }
}

fn move_courses<E: Effects>(configured: &mut EffectConfiguration<E>, by_s: f64) {
    for effect in 0..configured.constant.specs().len() {
        let amplitudes = configured.constant.specs()[effect].amplitudes.len();
        let numbers = configured.constant.numbers_mut(effect);
        for index in (amplitudes..numbers.specs().len())
            .filter(|&index| numbers.specs()[index].role == Role::Onset)
            .collect::<Vec<_>>()
        {
            *numbers.value_mut(index) -= by_s;
        }
    }
    let EffectConfiguration { constant, courses } = configured;
    for course in courses {
        match &mut course.law {
            TimeFunction::Step { time_s } => *time_s -= by_s,
            // It goes on from what it has grown to.
            TimeFunction::Ramp => {
                *constant.numbers_mut(course.effect).value_mut(course.amplitude) += course.size * by_s / S_PER_DAY;
            }
            TimeFunction::Temperature => {}
            TimeFunction::Periodic { period_s, phase_rad } => *phase_rad += std::f64::consts::TAU * by_s / *period_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geu_model::course::Interval;

    #[test]
    fn every_course_goes_on_where_it_was() {
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
            let interval = Interval { start_s, end_s: start_s + 0.5, electronics_excess_k: 3.0 };
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
