//! Angles from counts along a model's path, for motion that answers the rounding of the counts.
//!
//! A count states that the angle lies within half a count of it. Along the path, which changes smoothly, each sample narrows this
//! interval; near an edge of it a sample carries much information, elsewhere none. A truncated-normal filter of the departure from the
//! path and its rate gives for each node the angle and its weight, so that their block averages do not contain the rounding: given the
//! counts before, the expected change of the estimate is 0 whatever a controller does. The path must contain all effects.

use libm::{erf, exp};

use super::{BLOCK, Block};

/// Growth of the departure's rate, arcsec/s/√s: a slow effect that the path lacks is followed.
const RATE_WALK: f64 = 1e-4;
/// 1 sigma of that rate at the start, arcsec/s.
const INITIAL_RATE: f64 = 0.01;
/// A count farther from the departure, in sigmas, contradicts the path.
const CONTRADICTION: f64 = 5.0;
/// Variance of a rounding.
const ROUNDING: f64 = 1.0 / 12.0;
/// Smallest weight, and smallest information of a sample that is used.
const MIN_WEIGHT: f64 = 1e-6;
const MIN_INFORMATION: f64 = 1e-9;

/// Dequantised angles of one gyro.
#[derive(Debug, Clone)]
pub struct DequantisedAngles {
    /// Angle at each node, counts.
    pub angles: Vec<f64>,
    /// Inverse variance of each, counts⁻².
    pub weights: Vec<f64>,
    /// Number of counts that contradict the path.
    pub contradictions: usize,
    /// Logarithm of the likelihood of the counts along the path.
    pub log_likelihood: f64,
}

/// The filter: departure from the path, its rate, and their covariance.
struct Filter {
    departure: f64,
    rate: f64,
    aa: f64,
    ad: f64,
    dd: f64,
}

/// Dequantises accumulated counts along a path; `angle_walk` is that configured.
pub fn dequantise(
    counts: &[f64],
    path: &[f64],
    blocks: &[Block],
    angle_walk: f64,
    interval_s: f64,
) -> DequantisedAngles {
    let (mut angles, mut weights, mut contradictions) = (counts.to_vec(), vec![MIN_WEIGHT; counts.len()], 0);
    let (mut filter, mut log_likelihood): (Option<Filter>, f64) = (None, 0.0);
    for node in 1..path.len().min(counts.len()) {
        let residual = counts[node] - path[node];
        let restarts = (node - 1) % BLOCK == 0 && blocks.get((node - 1) / BLOCK).is_some_and(|block| block.restarts);
        let state = match filter.as_mut().filter(|_| !restarts) {
            Some(state) => state,
            None => filter.insert(Filter::at(residual)),
        };
        state.predict(angle_walk, interval_s);
        (angles[node], weights[node]) = match state.update(residual) {
            Some(Update { angle, weight, within }) => {
                log_likelihood += within.max(f64::MIN_POSITIVE).ln();
                (path[node] + angle, weight.max(MIN_WEIGHT))
            }
            None => {
                contradictions += 1;
                log_likelihood -= CONTRADICTION.powi(2) / 2.0;
                (counts[node], 1.0 / ROUNDING)
            }
        };
    }
    DequantisedAngles { angles, weights, contradictions, log_likelihood }
}

/// A count's angle from the path with its weight, and the probability of the count.
struct Update {
    angle: f64,
    weight: f64,
    within: f64,
}

impl Filter {
    fn at(departure: f64) -> Filter {
        Filter { departure, rate: 0.0, aa: ROUNDING, ad: 0.0, dd: INITIAL_RATE * INITIAL_RATE }
    }

    fn predict(&mut self, angle_walk: f64, interval_s: f64) {
        let t = interval_s;
        let rate_walk = RATE_WALK * RATE_WALK;
        self.departure += t * self.rate;
        self.aa += 2.0 * t * self.ad + t * t * self.dd + angle_walk * angle_walk * t + rate_walk * t.powi(3) / 3.0;
        self.ad += t * self.dd + rate_walk * t * t / 2.0;
        self.dd += rate_walk * t;
    }

    /// The state by a count that is `residual` from the path; `None` if it contradicts the path, and the filter starts there.
    fn update(&mut self, residual: f64) -> Option<Update> {
        let sigma = self.aa.sqrt();
        let (low, high) = ((residual - 0.5 - self.departure) / sigma, (residual + 0.5 - self.departure) / sigma);
        if low > CONTRADICTION || high < -CONTRADICTION {
            // The rate stays.
            *self = Filter { rate: self.rate, ..Filter::at(residual) };
            return None;
        }
        // Mean and variance of the normal distribution between the edges, and the information it gains.
        let within = distribution(high) - distribution(low);
        let mean = (density(low) - density(high)) / within;
        let variance = 1.0 + (low * density(low) - high * density(high)) / within - mean * mean;
        let gain = (1.0 - variance).clamp(0.0, 1.0 - MIN_INFORMATION);
        if gain < MIN_INFORMATION {
            return Some(Update { angle: self.departure, weight: 0.0, within });
        }
        let (angle, weight) = (self.departure + sigma * mean / gain, gain / (self.aa * (1.0 - gain)));
        self.departure += sigma * mean;
        self.rate += self.ad / self.aa * sigma * mean;
        self.dd -= self.ad * self.ad * gain / self.aa;
        self.ad *= 1.0 - gain;
        self.aa *= 1.0 - gain;
        Some(Update { angle, weight, within })
    }
}

/// Standard normal density.
fn density(x: f64) -> f64 {
    exp(-0.5 * x * x) / std::f64::consts::TAU.sqrt()
}

/// Standard normal distribution.
fn distribution(x: f64) -> f64 {
    0.5 * (1.0 + erf(x * std::f64::consts::FRAC_1_SQRT_2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_angle_of_a_slow_motion_is_known_better_than_a_rounding() {
        let truth: Vec<f64> = (0..=4000).map(|node| 0.31 + 0.0371 * f64::from(node)).collect();
        let counts: Vec<f64> = truth.iter().map(|angle| angle.round()).collect();
        let path: Vec<f64> = truth.iter().map(|angle| angle - 0.31).collect();
        let blocks = vec![Block::COMPARED; 400];
        let found = dequantise(&counts, &path, &blocks, 0.01, 0.5);
        assert_eq!(found.contradictions, 0);
        for block in 100..400 {
            let nodes = crate::measured::nodes(block);
            let weight: f64 = found.weights[nodes.clone()].iter().sum();
            let error: f64 =
                nodes.map(|node| found.weights[node] * (found.angles[node] - truth[node])).sum::<f64>() / weight;
            // Five sigma.
            assert!(error * error < 25.0 / weight, "{block}: {error}, {weight}");
        }
    }
}
