//! Courses of a cache, of a steady temperature, and of long recordings.

use super::*;

#[test]
fn cached_courses_equal_computed_courses() {
    let excess_k: Vec<f64> = (0..500).map(|block| (block as f64 * 0.01).sin()).collect();
    let none = Courses::at(excess_k, 5.0);
    let own = none.clone().with_grid();
    let late = own.late(150.0);
    for mode in [Mode::Rate, Mode::Level] {
        let (mut cached, mut followers) = (0, 0);
        for variation in (0..COURSES.len()).flat_map(|kind| none.variations(kind, mode)) {
            let blocks = variation.first_block(5.0).max(30)..500;
            let values = none.values(mode, &variation, blocks.clone());
            let kept = own.values(mode, &variation, blocks.clone());
            assert_eq!(kept, values, "{variation:?}");
            assert_eq!(matches!(kept, Some(Cow::Borrowed(_))), variation.is_of_time(), "{variation:?}");
            cached += usize::from(variation.is_of_time());
            if let (Some(decay), Some(values)) = (variation.decay(5.0), &values) {
                let after_onset = &values[(variation.first_block(5.0) + 2).saturating_sub(blocks.start)..];
                assert!(after_onset.windows(2).all(|pair| (pair[1] - decay * pair[0]).abs() < 1e-12), "{variation:?}");
            }
            // Only the courses that follow the temperature depend on its delay.
            if late.values(mode, &variation, blocks) != values {
                assert_eq!(late.values(mode, &variation, 30..200), none.values(mode, &variation, 60..230));
                followers += 1;
            }
        }
        assert!(cached > 100 && followers == 2, "{cached} {followers}");
    }
}

#[test]
fn a_steady_temperature_has_no_course() {
    let courses = |excess_k: fn(usize) -> f64| {
        let all = Courses::at((0..500).map(excess_k).collect(), 5.0);
        let of_kind = |kind| all.variations(kind, Mode::Rate);
        (0..COURSES.len()).flat_map(of_kind).filter(|variation| !variation.is_of_time()).count()
    };
    assert_eq!(courses(|_| 50.0), 0);
    assert_eq!(courses(|_| 0.0), 0);
    // A step.
    assert_eq!(courses(|block| 50.0 + (block / 250) as f64), 2);
    assert_eq!(courses(|block| 50.0 + 4e-5 * (block * block) as f64), 2);
    // A constant rate of change.
    assert_eq!(courses(|block| 50.0 + 0.01 * block as f64), 1);
}

#[test]
fn the_memory_of_the_noise_separates_onsets_in_long_recordings() {
    let courses = |blocks: usize, memory_s: f64| Courses { memory_s, ..Courses::at(vec![0.0; blocks], 10.0) };
    let of = |courses: Courses, name: &str| {
        courses.independent_courses(COURSES.iter().position(|own| own.name == name).expect("a course"))
    };
    let [hours, day] = [1080, 8640];
    assert_eq!(of(courses(hours, 300.0), "-pulse"), 1.0);
    // Onsets every 1350 s, and as many ends.
    assert_eq!(of(courses(day, 300.0), "-pulse"), 4.5 * 4.5);
    assert_eq!(of(courses(day, 300.0), "-settling"), 9.0);
    assert_eq!(of(courses(day, 300.0), "-ramp"), 1.0);
    // An onset within a block is not resolved.
    assert_eq!(of(courses(day, 0.1), "-settling"), 270.0);
    assert_eq!(of(courses(day, f64::INFINITY), "-settling"), 1.0);
}
