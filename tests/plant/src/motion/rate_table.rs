//! A rate table: constant rates about one or two axes in turn, with rests between.

use crate::noise::Noise;

const ACCELERATION_ARCSEC_S2: f64 = 36.0;
const RATES_ARCSEC_S: [f64; 5] = [60.0, 120.0, 231.0, 360.0, 720.0];

/// Constant rates with a ramp at either end.
struct Leg {
    start_s: f64,
    duration_s: f64,
    rates_arcsec_s: [f64; 3],
}

pub struct RateTable {
    legs: Vec<Leg>,
}

impl RateTable {
    /// Each axis both ways, each rate about an axis drawn at random, and turns about two axes.
    pub fn drawn(random: &mut Noise, duration_s: f64) -> RateTable {
        let mut legs = Vec::new();
        let mut end_s = random.uniform(200.0, 400.0);
        let mut turn = 0;
        while end_s < duration_s {
            let mut rates_arcsec_s = [0.0; 3];
            // The axes in turn at first, then any.
            let axis = if turn < 6 { turn / 2 } else { random.one_of(&[0, 1, 2]) };
            let sign = if turn % 2 == 0 { 1.0 } else { -1.0 };
            rates_arcsec_s[axis] = sign * random.one_of(&RATES_ARCSEC_S);
            if turn >= 6 && random.one_of(&[true, false, false]) {
                rates_arcsec_s[(axis + 1) % 3] = random.one_of(&[-1.0, 1.0]) * random.one_of(&RATES_ARCSEC_S[..3]);
            }
            let duration_s = random.uniform(150.0, 400.0);
            legs.push(Leg { start_s: end_s, duration_s, rates_arcsec_s });
            end_s += duration_s + random.uniform(60.0, 300.0);
            turn += 1;
        }
        RateTable { legs }
    }

    pub fn at(&self, t: f64) -> [f64; 3] {
        let Some(leg) = self.legs[..self.legs.partition_point(|leg| leg.start_s <= t)].last() else { return [0.0; 3] };
        let (since_s, left_s) = (t - leg.start_s, leg.start_s + leg.duration_s - t);
        leg.rates_arcsec_s.map(|rate| {
            let reached = ACCELERATION_ARCSEC_S2 * since_s.min(left_s).max(0.0);
            rate.clamp(-reached, reached)
        })
    }
}
