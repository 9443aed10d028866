//! Rules that every stated entry meets, whatever search and selection did.

use crate::outcome::{Class, DiagnosedEffect};
use geu_checks::Finding;
use geu_protocol::Gyros;

/// Entries that are not stated, each with the reason.
pub type Refused = Vec<(DiagnosedEffect, &'static str)>;

/// Gap between model and measurement.
#[derive(Debug, Clone, Copy)]
pub struct SquaredGap {
    /// Squared gap of all gyros, counts² times samples.
    pub squares: f64,
    /// χ² of the whitened residual over its degrees of freedom, by the noise as configured.
    pub reduced_chi2: f64,
}

const LARGER_GAP: &str = "it makes the gap larger";
/// Growth of the squared gap by one entry that refuses it whatever χ² does, as a share of the gap as configured, if noise does not cause it:
/// the residual of a true effect with a well-determined amplitude grows by its own error only.
const LARGER: f64 = 0.1;
/// Squared gap with all entries, as a multiple of the one as configured, above which noise does not excuse the entry with the largest growth.
const TWICE_AS_WIDE: f64 = 4.0;
/// Growth of the squared gap, as a share, that is none: an effect of the times hardly moves the angles.
const EQUAL: f64 = 0.01;

/// Removes the entries that may not be stated: one below its own threshold, a changed calibration of a gyro left unexplained, and one
/// that makes the gap larger beside all others, by [`LARGER`] and more than `by_noise` from those without it to all, by [`EQUAL`] with χ²,
/// or the most, by [`LARGER`] or more, where the gap with all of them is [`TWICE_AS_WIDE`].
///
/// The gyros of a refused effect are unexplained.
pub fn refuse(
    entries: &mut Vec<DiagnosedEffect>,
    unexplained: &mut Gyros,
    gap: impl Fn(&[&DiagnosedEffect]) -> SquaredGap,
    by_noise: impl Fn(&[&DiagnosedEffect], &[&DiagnosedEffect]) -> f64,
) -> Refused {
    let mut refused = Refused::new();
    while let Some((index, reason)) = first_refused(entries, unexplained, &gap, &by_noise) {
        let entry = entries.remove(index);
        if entry.class == Class::MissingEffect {
            *unexplained = unexplained.and(entry.gyros);
        }
        refused.push((entry, reason));
    }
    refused
}

fn first_refused(
    entries: &[DiagnosedEffect],
    unexplained: &Gyros,
    gap: &impl Fn(&[&DiagnosedEffect]) -> SquaredGap,
    by_noise: &impl Fn(&[&DiagnosedEffect], &[&DiagnosedEffect]) -> f64,
) -> Option<(usize, &'static str)> {
    let of = |reason, is_refused: &dyn Fn(&DiagnosedEffect) -> bool| {
        entries.iter().position(is_refused).map(|index| (index, reason))
    };
    let is_of_unexplained =
        |entry: &DiagnosedEffect| entry.class == Class::Recalibration && entry.gyros.is_within(unexplained);
    of("its fall of chi2 is below its own threshold", &DiagnosedEffect::is_below_threshold)
        .or_else(|| of("what moves the calibration of an unexplained gyro is not known", &is_of_unexplained))
        .or_else(|| {
            let all: Vec<&DiagnosedEffect> = entries.iter().collect();
            let (with, configured) = (gap(&all), gap(&[]));
            let others = |entry: &DiagnosedEffect| -> Vec<&DiagnosedEffect> {
                entries.iter().filter(|other| !std::ptr::eq(*other, entry)).collect()
            };
            let is_larger_by_a_tenth = |growth: f64| growth > LARGER * configured.squares;
            let is_twice = with.squares > TWICE_AS_WIDE * configured.squares;
            let judged = entries.iter().enumerate().filter(|own| is_twice && own.1.chi2.is_some());
            let most = judged.map(|(index, own)| (index, with.squares - gap(&others(own)).squares));
            let most = most.max_by(|one, other| one.1.total_cmp(&other.1)).filter(|own| is_larger_by_a_tenth(own.1));
            if let Some((index, _)) = most {
                return Some((index, LARGER_GAP));
            }
            // The corrections of an exact check are in the data already.
            let is_harmful = |entry: &DiagnosedEffect| {
                let without = gap(&others(entry));
                let growth = with.squares - without.squares;
                let is_larger = growth > EQUAL * without.squares && without.reduced_chi2 < with.reduced_chi2;
                let is_much_larger = || is_larger_by_a_tenth(growth) && growth > by_noise(&others(entry), &all);
                entry.chi2.is_some() && (is_larger || is_much_larger())
            };
            of(LARGER_GAP, &is_harmful)
        })
}

/// The finding of a refused entry.
pub fn finding((entry, reason): &(DiagnosedEffect, &'static str)) -> Finding {
    Finding {
        kind: "not-stated".to_owned(),
        place: entry.gyros.names().join(", "),
        text: format!("{} is not stated: {reason}", super::effect_name(entry)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outcome::Chi2Fall;

    fn entry(code: &str, gyro: usize, class: Class, fall: f64) -> DiagnosedEffect {
        let chi2 = Some(Chi2Fall { fall, threshold: 16.0 });
        DiagnosedEffect {
            code: code.to_owned(),
            gyros: Gyros::ALL.only(gyro),
            class,
            chi2,
            ..DiagnosedEffect::default()
        }
    }

    /// Codes of the stated entries, unexplained gyros and reasons, if the gap grows with each entry `harmful`.
    fn refused(mut entries: Vec<DiagnosedEffect>, mut unexplained: Gyros) -> (Vec<String>, Gyros, Vec<String>) {
        let gap = |entries: &[&DiagnosedEffect]| {
            let harm = entries.iter().filter(|entry| entry.code == "harmful").count() as f64;
            SquaredGap { squares: 10.0 + harm, reduced_chi2: 1.0 + harm }
        };
        let refused = refuse(&mut entries, &mut unexplained, gap, |_, _| 0.0);
        let codes = entries.into_iter().map(|entry| entry.code).collect();
        (codes, unexplained, refused.iter().map(|own| finding(own).text).collect())
    }

    #[test]
    fn an_effect_below_its_threshold_leaves_its_gyro_and_calibration_unexplained() {
        let entries = vec![
            entry("drift-step", 0, Class::MissingEffect, 15.9),
            entry("lost-counts", 1, Class::MissingEffect, 17.0),
            entry("scale-factor", 0, Class::Recalibration, 100.0),
            entry("misalignment", 1, Class::Recalibration, 100.0),
        ];
        let (codes, unexplained, reasons) = refused(entries, Gyros::default());
        assert_eq!(
            (&codes[..], unexplained),
            (&["lost-counts".to_owned(), "misalignment".to_owned()][..], Gyros::ALL.only(0))
        );
        assert_eq!(reasons[0], "drift-step is not stated: its fall of chi2 is below its own threshold");
        assert!(reasons[1].starts_with("scale-factor is not stated: what moves the calibration"), "{reasons:?}");
    }

    #[test]
    fn an_entry_that_makes_the_gap_larger_is_not_stated() {
        let entries =
            || vec![entry("harmful", 2, Class::MissingEffect, 50.0), entry("drift", 1, Class::MissingEffect, 50.0)];
        let (codes, unexplained, reasons) = refused(entries(), Gyros::default());
        assert_eq!((&codes[..], unexplained), (&["drift".to_owned()][..], Gyros::ALL.only(2)));
        assert_eq!(reasons, ["harmful is not stated: it makes the gap larger"]);
        // A calibration that is not stated leaves nothing unexplained.
        let (codes, unexplained, _) = refused(vec![entry("harmful", 2, Class::Recalibration, 50.0)], Gyros::default());
        assert!(codes.is_empty() && unexplained == Gyros::default());
    }

    #[test]
    fn noise_excuses_a_gap_that_is_larger_but_not_one_twice_as_wide() {
        for (squares, stated) in [(39.0, 1), (41.0, 0)] {
            let mut entries = vec![entry("harmful", 2, Class::MissingEffect, 50.0)];
            let gap = |entries: &[&DiagnosedEffect]| SquaredGap {
                squares: if entries.is_empty() { 10.0 } else { squares },
                reduced_chi2: 1.0 - entries.len() as f64 / 10.0,
            };
            refuse(&mut entries, &mut Gyros::default(), gap, |_, _| f64::INFINITY);
            assert_eq!(entries.len(), stated);
        }
        // An entry excused by noise stays beside another that makes the gap twice as wide, in either order.
        for codes in [["small", "large"], ["large", "small"]] {
            let mut entries: Vec<DiagnosedEffect> =
                codes.iter().map(|code| entry(code, 2, Class::MissingEffect, 50.0)).collect();
            let gap = |entries: &[&DiagnosedEffect]| {
                let of = |entry: &&DiagnosedEffect| if entry.code == "large" { 40.0 } else { 2.0 };
                SquaredGap { squares: 10.0 + entries.iter().map(of).sum::<f64>(), reduced_chi2: 1.0 }
            };
            refuse(&mut entries, &mut Gyros::default(), gap, |_, _| 5.0);
            assert_eq!(entries.iter().map(|entry| &entry.code).collect::<Vec<_>>(), ["small"]);
        }
    }

    #[test]
    fn an_effect_that_an_exact_check_found_stays() {
        let found = DiagnosedEffect { chi2: None, ..entry("harmful", 0, Class::MissingEffect, 0.0) };
        assert_eq!(refused(vec![found], Gyros::default()).0, ["harmful"]);
    }
}
