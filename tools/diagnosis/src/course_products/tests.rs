//! Kept products against courses that are whitened one by one.

use std::collections::BTreeMap;

use geu_model::Configuration;
use geu_model::time_profile::COURSES;
use geu_protocol::Gyros;

use crate::courses::Mode;
use crate::diagnosis_case::DiagnosisCase;
use crate::measured::CHANNELS;
use crate::null_products::tests::{configured_noise, measured};
use crate::signature::reaches;
use crate::signature_bank::{SignatureBank, Variation};
use crate::spots::Spot;
use crate::sweep::{Swept, sweep};
use crate::whitening::NoiseModel;

#[test]
fn a_sweep_fits_every_course_as_one_that_is_whitened_alone() {
    let nominal = Configuration::reference();
    let measured = measured(&nominal);
    let case = DiagnosisCase::new(&measured, &nominal);
    let configured = configured_noise(&case);
    let bank = SignatureBank::new(&measured, &nominal);
    // With and without the tails of a filter.
    for flicker in [0.0, 0.5] {
        let normal = case.normal(&mut case.start(configured.map(|own| NoiseModel { flicker, ..own })));
        let mut compared: BTreeMap<(bool, &str), usize> = BTreeMap::new();
        for (index, base) in bank.bases.iter().enumerate().filter(|(_, base)| base.is_linear) {
            let push = |variation: &Variation, swept: &Swept<()>| {
                let Some(kind) = variation.kind() else { return };
                // A pulse omits channels on which its two steps cancel but for rounding.
                if (0..CHANNELS).any(|channel| swept.reached()[channel] != base.reaches(channel)) {
                    return;
                }
                let Some(expected) = Spot::fit(&bank, &normal, index, variation.clone(), Gyros::ALL) else { return };
                let Some(found) = swept.gain(|channel| reaches(&base.amplitude, &Gyros::ALL, channel)) else { return };
                let (off, sigma) = ((found.size - expected.gain.size).abs(), expected.gain.sigma);
                assert!(off < 1e-6 * sigma, "{:?} {variation:?}: {found:?} {:?}", base.amplitude, expected.gain);
                assert!((found.sigma / sigma - 1.0).abs() < 1e-6, "{:?} {variation:?}", base.amplitude);
                *compared.entry((base.mode == Mode::Level, COURSES[kind].name)).or_default() += 1;
            };
            sweep(&bank, &normal, base, [true; CHANNELS], |_, _, _| (), push);
        }
        for name in ["-step", "-pulse", "-settling", "-periodic"] {
            for is_level in [false, true] {
                let count = compared.get(&(is_level, name)).copied().unwrap_or(0);
                assert!(count > 100, "{name}, level {is_level}: {compared:?}");
            }
        }
    }
}
