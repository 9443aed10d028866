//! Minima of functions of one variable.

/// Lowest value of a parabola through three values at equal distances, if it is near them; else the lowest value.
pub fn lowest(below: f64, middle: f64, above: f64) -> f64 {
    let (slope, bend) = (0.5 * (above - below), above - 2.0 * middle + below);
    let lowest = below.min(middle).min(above);
    let is_near = bend > 0.0 && (slope / bend).abs() < 3.0;
    if is_near { lowest.min(middle - 0.5 * slope * slope / bend) } else { lowest }
}

/// Position of the minimum of a function, by a grid and golden-section search.
pub fn minimise(from: f64, to: f64, of: impl Fn(f64) -> f64) -> f64 {
    const GRID: usize = 8;
    let at = |index: usize| from + (to - from) * index as f64 / GRID as f64;
    let values: Vec<f64> = (0..=GRID).map(|index| of(at(index))).collect();
    let best = (0..=GRID).min_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap_or(0);
    let (mut low, mut high) = (at(best.saturating_sub(1)), at((best + 1).min(GRID)));
    let ratio = 0.618_033_988_749_894_9;
    let (mut left, mut right) = (high - ratio * (high - low), low + ratio * (high - low));
    let (mut at_left, mut at_right) = (of(left), of(right));
    while high - low > 0.01 {
        if at_left < at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - ratio * (high - low);
            at_left = of(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + ratio * (high - low);
            at_right = of(right);
        }
    }
    0.5 * (low + high)
}
