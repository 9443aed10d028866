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

/// Score of the best candidate in each null recording of this number of samples: with the thresholds, and without the addition to the grid.
fn scores(nominal: &Configuration, samples: usize) -> [Vec<f64>; 2] {
    let measured = measured_of(nominal, samples);
    let case = DiagnosisCase::new(&measured, nominal);
    let noise = configured_noise(&case);
    let start = case.start(noise);
    let normal = case.fit(&mut start.clone());
    let bank = SignatureBank::new(&measured, nominal);
    let path = case.run(&start);
    let whole = thresholds(&case, &bank, &path, &normal, &noise, SEEDS[0]);
    let of_grid = Thresholds { between_chi2: [0.0; HypothesisFamily::COUNT], ..whole.clone() };
    let of_run = |run: usize, thresholds: &Thresholds| {
        let residual = draw(&case, &path, &noise, SEEDS[1] + run as u64);
        let own = NormalEquations::new(case.whitenings(&noise), &residual, &case.nuisances, &case.a_priori(&[]));
        let found = search(&bank, &own, &start, Some(thresholds));
        found.first().map_or(f64::NEG_INFINITY, |best| score(&bank, Some(thresholds), &best.spot))
    };
    [&whole, &of_grid].map(|thresholds| (0..COUNT).into_par_iter().map(|run| of_run(run, thresholds)).collect())
}

#[test]
#[ignore = "a quarter of an hour in a release"]
fn false_alarms_of_the_whole_search_are_as_rare_as_stated() {
    let mut walking = Configuration::reference();
    for gyro in &mut walking.gyros {
        let effects = &mut gyro.effects.constant;
        effects.drift_random_walk.arcsec_per_s_per_sqrt_s = 1e-3;
        effects.angle_random_walk.arcsec_per_sqrt_s = 0.5;
    }
    let default = Configuration::reference();
    let [hours, day] = [21_600, 172_800];
    let cases = [
        ("3 h", &default, hours),
        ("3 h, large walks", &walking, hours),
        ("24 h", &default, day),
        ("24 h, large walks", &walking, day),
    ];
    let mut failed = Vec::new();
    for (name, nominal, samples) in cases {
        for (scores, thresholds) in scores(nominal, samples).iter().zip(["", ", thresholds of the grid"]) {
            let (at, scale) = gumbel(scores).expect("different scores");
            let beyond = quantile(scores, FALSE_ALARM_RATE).expect("different scores");
            // Both these recordings and the RUNS of the thresholds are few.
            let sigma = scale * (QUANTILE_VARIANCE * (1.0 / COUNT as f64 + 1.0 / RUNS as f64)).sqrt();
            let recordings = 1.0 / (1.0 - (-(at / scale).exp()).exp());
            println!("{name}{thresholds}: one in {recordings:.0}; {beyond:.1} ± {sigma:.1} too low");
            if thresholds.is_empty() && beyond.abs() > THREE_SIGMAS * sigma {
                failed.push(name);
            }
        }
    }
    assert!(failed.is_empty(), "other false alarm rates: {failed:?}");
}
