//! Motion without the rounding of counts, and a noisy difference without its noise: each as smooth as the data allow.
//!
//! What is left of either noise is part of the motion, and the signature of an effect that depends on small rates contains it: a dead
//! zone would withhold the noise, and explain it. At rest and at steady rates the smoothing therefore reaches far.

use crate::significance::THREE_SIGMAS;
use nalgebra::Vector3;

/// Weights of a cubic through seven nodes (Savitzky and Golay): half of the rounding's variance stays, and 94 % of a limit cycle of 5 s.
const CUBIC: [f64; 7] = [-2.0 / 21.0, 3.0 / 21.0, 6.0 / 21.0, 7.0 / 21.0, 6.0 / 21.0, 3.0 / 21.0, -2.0 / 21.0];
/// Largest departure of counts from a steady rate: half a count of rounding, and 0.2″ of random walk and of the line's own error.
const STEADY_ARCSEC: f64 = 0.7;
/// Shortest steady rate, nodes: beyond three periods of a limit cycle.
const STEADY_NODES: usize = 32;
/// Nodes over which the cubic passes into the line.
const TRANSITION: usize = 8;
/// Reaches of the lines to either side, blocks, of the default unit 30 s to 8 min. A scale factor that is off turns a difference at the start of a slew, so that the shortest
/// follows it; noise of 3″ each second leaves a rate of 0.02″/s of that, and 0.0003″/s of the longest.
pub const REACHES: &[f64] = &[6.0, 12.0, 24.0, 48.0, 96.0];
/// Reaches beside gyros that are not calibrated yet: a drift or a scale factor that is off turns the difference with every turn of the unit.
pub const SHORT_REACHES: &[f64] = &[0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];
/// Minimum number of points to either side.
pub const REACH_ROWS: usize = 4;

/// Accumulated angles from counts, without their rounding: a line where the rate is steady, a local cubic elsewhere.
pub fn without_rounding(angles: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mut smooth: Vec<Vector3<f64>> = (0..angles.len()).map(|node| cubic(angles, node)).collect();
    for axis in 0..3 {
        let values: Vec<f64> = angles.iter().map(|angle| angle[axis]).collect();
        for (from, line) in steady(&values) {
            let last = line.len() - 1;
            for (place, value) in line.into_iter().enumerate() {
                let share = (place.min(last - place) as f64 / TRANSITION as f64).min(1.0);
                let own = &mut smooth[from + place][axis];
                *own += share * (value - *own);
            }
        }
    }
    smooth
}

/// The angle at a node by the cubic through its neighbours; at the ends as it is.
fn cubic(angles: &[Vector3<f64>], node: usize) -> Vector3<f64> {
    let reach = CUBIC.len() / 2;
    let own = angles[node];
    let Some(near) = node.checked_sub(reach).and_then(|from| angles.get(from..=node + reach)) else { return own };
    // Relative to the node, where the sum loses no digits.
    own + near.iter().zip(CUBIC).map(|(angle, weight)| (angle - own) * weight).sum::<Vector3<f64>>()
}

/// First node and values of the lines that accumulated counts do not depart from, the longest from each start.
fn steady(values: &[f64]) -> Vec<(usize, Vec<f64>)> {
    let mut found = Vec::new();
    let mut from = 0;
    while from + STEADY_NODES <= values.len() {
        let line = |count: usize| values.get(from..from + count).and_then(line_within);
        let Some(mut best) = line(STEADY_NODES) else {
            from += 1;
            continue;
        };
        // Twice as long as long as that is a line, then the longest between.
        let mut beyond = 2 * best.len();
        while let Some(longer) = line(beyond) {
            best = longer;
            beyond *= 2;
        }
        while beyond - best.len() > 1 {
            let middle = (best.len() + beyond) / 2;
            match line(middle) {
                Some(longer) => best = longer,
                None => beyond = middle,
            }
        }
        from += best.len();
        found.push((from - best.len(), best));
    }
    found
}

/// The straight line through values, if none departs from it by more than rounding.
fn line_within(values: &[f64]) -> Option<Vec<f64>> {
    let middle = 0.5 * (values.len() - 1) as f64;
    let at = |place: usize| place as f64 - middle;
    let mean = values.iter().map(|value| value - values[0]).sum::<f64>() / values.len() as f64;
    let turned: f64 = values.iter().enumerate().map(|(place, value)| at(place) * (value - values[0])).sum();
    let spread: f64 = (0..values.len()).map(|place| at(place) * at(place)).sum();
    let line: Vec<f64> = (0..values.len()).map(|place| values[0] + mean + turned / spread * at(place)).collect();
    let is_within = values.iter().zip(&line).all(|(value, line)| (value - line).abs() <= STEADY_ARCSEC);
    is_within.then_some(line)
}

/// A noisy value.
pub struct Point {
    /// Time, s.
    pub t_s: f64,
    /// The value.
    pub value: Vector3<f64>,
    /// Inverse variance, relative.
    pub weight: f64,
}

/// Sums over points from the first on, for lines through any neighbours.
pub struct LineSums {
    block_s: f64,
    reaches: &'static [f64],
    t_s: Vec<f64>,
    middle_s: f64,
    /// Weight; weight × time; weight × time².
    moments: Vec<[f64; 3]>,
    /// Weight × value; weight × time × value.
    products: Vec<[Vector3<f64>; 2]>,
}

impl LineSums {
    /// Sums of points in order of time, for lines with these reaches, in blocks of this length.
    pub fn new(points: impl Iterator<Item = Point> + Clone, block_s: f64, reaches: &'static [f64]) -> LineSums {
        let t_s: Vec<f64> = points.clone().map(|point| point.t_s).collect();
        let middle_s = t_s.first().zip(t_s.last()).map_or(0.0, |(first, last)| 0.5 * (first + last));
        let (mut moments, mut products) = (vec![[0.0; 3]], vec![[Vector3::zeros(); 2]]);
        let (mut moment, mut product) = (moments[0], products[0]);
        for Point { t_s, value, weight } in points {
            let t = t_s - middle_s;
            moment.iter_mut().zip([weight, weight * t, weight * t * t]).for_each(|(sum, own)| *sum += own);
            product.iter_mut().zip([value * weight, value * (weight * t)]).for_each(|(sum, own)| *sum += own);
            moments.push(moment);
            products.push(product);
        }
        LineSums { block_s, reaches, t_s, middle_s, moments, products }
    }

    /// The value at a time, of which `sigma` is that of a point of weight 1: by the longest line that departs from no shorter one by more
    /// than its noise, or by the shortest line without a sigma.
    pub fn smooth(&self, at_s: f64, sigma: Option<Vector3<f64>>) -> Vector3<f64> {
        let mut lines: Vec<(Vector3<f64>, f64)> = Vec::new();
        for reach in &self.reaches[..if sigma.is_some() { self.reaches.len() } else { 1 }] {
            let line = self.line(at_s, reach * self.block_s);
            let is_off = |(shorter, variance): &(Vector3<f64>, f64)| {
                let limit = sigma.unwrap_or_default() * (THREE_SIGMAS * variance.sqrt());
                (line.0 - shorter).iter().zip(&limit).any(|(departure, limit)| departure.abs() > *limit)
            };
            if lines.iter().any(is_off) {
                break;
            }
            lines.push(line);
        }
        lines.last().map_or_else(Vector3::zeros, |line| line.0)
    }

    /// The line through the neighbours of a time: its value, and the variance of that if a point of weight 1 has 1.
    fn line(&self, at_s: f64, reach_s: f64) -> (Vector3<f64>, f64) {
        let place = self.t_s.partition_point(|t_s| *t_s < at_s);
        let from = self.t_s.partition_point(|t_s| *t_s < at_s - reach_s).min(place.saturating_sub(REACH_ROWS));
        let to = self.t_s.partition_point(|t_s| *t_s <= at_s + reach_s).max(place + 1 + REACH_ROWS).min(self.t_s.len());
        let [count, turn, spread] = [0, 1, 2].map(|moment| self.moments[to][moment] - self.moments[from][moment]);
        let [value, product] = [0, 1].map(|product| self.products[to][product] - self.products[from][product]);
        let at = at_s - self.middle_s;
        // About the mean time.
        let mean = turn / count;
        let (about, slope) = (spread - turn * mean, product - value * mean);
        match about > 0.0 {
            true => (value / count + slope * ((at - mean) / about), 1.0 / count + (at - mean) * (at - mean) / about),
            false => (value / count.max(f64::MIN_POSITIVE), 1.0 / count),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rates of the smoothed angles of a motion of 600 s, rounded.
    fn rates(angle: impl Fn(f64) -> f64) -> Vec<f64> {
        let rounded = |node: i32| Vector3::repeat(angle(0.5 * f64::from(node)).round());
        let angles: Vec<Vector3<f64>> = (0..1200).map(rounded).collect();
        without_rounding(&angles).windows(2).map(|pair| 2.0 * (pair[1][0] - pair[0][0])).collect()
    }

    #[test]
    fn a_steady_rate_has_no_rounding() {
        for rate in [0.0, 0.0411, 231.3] {
            let found = rates(|t_s| rate * t_s);
            assert!(found[50..1150].iter().all(|found| (found - rate).abs() < 2e-3), "{rate}");
        }
    }

    #[test]
    fn a_limit_cycle_and_the_start_of_a_slew_remain() {
        let cycle = |t_s: f64| 4.0 / 1.25 * (1.25 * t_s).sin();
        let found = rates(cycle);
        for (node, found) in found.iter().enumerate().skip(10).take(1170) {
            let rate = 4.0 * (1.25 * (0.5 * node as f64 + 0.25)).cos();
            assert!((found - rate).abs() < 0.9, "{node}: {found} {rate}");
        }
        let slew = |t_s: f64| if t_s < 300.0 { 0.0 } else { 18.0 * (t_s - 300.0).min(20.0).powi(2) };
        let found = rates(slew);
        assert!(found[620..636].iter().enumerate().all(|(place, found)| {
            let rate = 36.0 * (0.5 * (620 + place) as f64 + 0.25 - 300.0);
            (found - rate).abs() < 0.9
        }));
        assert!(found[..590].iter().all(|found| found.abs() < 1e-9));
    }

    #[test]
    fn lines_reach_far_where_the_difference_is_straight_and_follow_its_corners() {
        // Alternating noise of 3, a corner of 0.1 per s at 1500 s.
        let noise = |number: i32| if number % 2 == 0 { 3.0 } else { -3.0 };
        let value = |t_s: f64| 0.1 * (t_s - 1500.0).max(0.0);
        let points = (0..3000).map(|number| {
            let t_s = f64::from(number);
            Point { t_s, value: Vector3::repeat(value(t_s) + noise(number)), weight: 1.0 }
        });
        let sums = LineSums::new(points, 5.0, REACHES);
        let error = |t_s: f64| (sums.smooth(t_s, Some(Vector3::repeat(3.0)))[0] - value(t_s)).abs();
        assert!(error(700.0) < 0.01 && error(1499.5) < 1.8, "{} {}", error(700.0), error(1499.5));
        assert!(error(1600.0) < 0.4, "{}", error(1600.0));
    }
}
