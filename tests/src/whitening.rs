//! Whitening of an accumulated angle: what is left after it is white, of variance 1, where the residual is only noise.
//!
//! The noise of an accumulated count is three things: rounding, which is white on the angle itself because a count is a
//! difference of a rounded angle; the angle's random walk; and the walk of the drift rate. A Kalman filter of the two
//! walks predicts each angle from those before it; the innovation over its own deviation is white. The filter is linear
//! and knows no data, so it is the same for a residual and for everything that is fitted to it.

use geu_model::effect::GyroEffects;

/// Variance of a rounded number, even between two whole ones.
const ROUNDING: f64 = 1.0 / 12.0;
const SAMPLE_INTERVAL_S: f64 = 0.5;

/// For each sample the gains on angle and drift rate, and the deviation of the innovation.
pub struct Whitening(Vec<([f64; 2], f64)>);

impl Whitening {
    /// The filter for `rows` samples of the noise that `effects` configure.
    pub fn of(effects: &GyroEffects, rows: usize) -> Whitening {
        let angle = effects.angle_random_walk.arcsec_per_sqrt_s.powi(2);
        let drift = effects.drift_random_walk.arcsec_per_s_per_sqrt_s.powi(2);
        let t = SAMPLE_INTERVAL_S;
        // At the start the angle is known but for the rounding before the first row. The drift of then is not noise: it
        // is a calibration parameter.
        let (mut aa, mut ad, mut dd) = (ROUNDING, 0.0, 0.0);
        let step = |_| {
            aa += 2.0 * ad * t + dd * t * t + angle * t + drift * t.powi(3) / 3.0;
            ad += dd * t + drift * t * t / 2.0;
            dd += drift * t;
            let innovation = aa + ROUNDING;
            let gains = [aa / innovation, ad / innovation];
            dd -= gains[1] * ad;
            ad -= gains[0] * ad;
            aa -= gains[0] * aa;
            (gains, innovation.sqrt())
        };
        Whitening((0..rows).map(step).collect())
    }

    /// The innovations of an accumulated angle, each over its deviation.
    pub fn apply(&self, accumulated: &[f64]) -> Vec<f64> {
        let (mut angle, mut drift) = (0.0, 0.0);
        let innovations = self.0.iter().zip(accumulated).map(|((gains, deviation), measured)| {
            angle += drift * SAMPLE_INTERVAL_S;
            let innovation = measured - angle;
            angle += gains[0] * innovation;
            drift += gains[1] * innovation;
            innovation / deviation
        });
        innovations.collect()
    }
}
