//! False alarms of the whole search, on other null recordings than the thresholds use.

use super::*;

use geu_model::Configuration;

use crate::null_products::tests::{configured_noise, measured_of};
use crate::search::{score, search};

/// Null recordings of a case.
const COUNT: usize = 256;
/// Seed of the thresholds, and of the first other null recording.
const SEEDS: [u64; 2] = [1, 3_000_000];
/// Variance of the quantile mean + 5.41 scale of a Gumbel distribution from the moments of a number of values, times that number, in squares
/// of the scale: 1.645 + 5.41² × 1.1 + 2 × 5.41 × 0.731, of mean, scale and both (skewness 1.14, kurtosis 5.4).
const QUANTILE_VARIANCE: f64 = 41.8;

/// Score of the best candidate in each null recording of this number of samples.
fn scores(nominal: &Configuration, samples: usize) -> Vec<f64> {
    let measured = measured_of(nominal, samples);
    let case = DiagnosisCase::new(&measured, nominal);
    let noise = configured_noise(&case);
    let start = case.start(noise);
    let normal = case.fit(&mut start.clone());
    let bank = SignatureBank::new(&measured, nominal);
    let path = case.run(&start);
    let thresholds = thresholds(&case, &bank, &path, &normal, &noise, SEEDS[0]);
    let of_run = |run: usize| {
        let residual = draw(&case, &path, &noise, SEEDS[1] + run as u64);
        let own = NormalEquations::new(case.whitenings(&noise), &residual, &case.nuisances, &case.a_priori(&[]));
        let found = search(&bank, &own, &start, Some(&thresholds));
        found.first().map_or(f64::NEG_INFINITY, |best| score(&bank, Some(&thresholds), &best.spot))
    };
    (0..COUNT).map(of_run).collect()
}

#[test]
#[ignore = "two minutes in a release"]
fn the_whole_search_has_the_stated_false_alarm_rate() {
    let mut walking = Configuration::reference();
    for gyro in &mut walking.gyros {
        let effects = &mut gyro.effects.constant;
        effects.drift_random_walk.arcsec_per_s_per_sqrt_s = 1e-3;
        effects.angle_random_walk.arcsec_per_sqrt_s = 0.5;
    }
    let default = Configuration::reference();
    let cases = [("3 h", &default, 21_600), ("3 h, large walks", &walking, 21_600), ("24 h", &default, 172_800)];
    let failed: Vec<&str> = cases
        .into_iter()
        .filter(|(name, nominal, samples)| {
            let scores = scores(nominal, *samples);
            let (at, scale) = gumbel(&scores).expect("different scores");
            let beyond = quantile(&scores, FALSE_ALARM_RATE).expect("different scores");
            let sigma = scale * (QUANTILE_VARIANCE / COUNT as f64).sqrt();
            let false_alarms = 1.0 - (-(at / scale).exp()).exp();
            println!(
                "{name}: one false alarm in {:.0}; threshold {beyond:.1} ± {sigma:.1} too low",
                1.0 / false_alarms
            );
            beyond > THREE_SIGMAS * sigma
        })
        .map(|(name, ..)| name)
        .collect();
    assert!(failed.is_empty(), "too many false alarms: {failed:?}");
}
