//! Cubic spline through points.

/// Second derivatives of the cubic spline through the points, the third derivative continuous across the second and the
/// last but one point (not-a-knot), so that the ends bend as the data do.
pub fn second_derivatives(t: &[f64], y: &[f64]) -> Vec<f64> {
    let n = t.len();
    let h: Vec<f64> = t.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let slope: Vec<f64> = (0..n - 1).map(|i| (y[i + 1] - y[i]) / h[i]).collect();
    // Inner equations h[i−1] m[i−1] + 2(h[i−1] + h[i]) m[i] + h[i] m[i+1] = 6(slope[i] − slope[i−1]), with the end values
    // m[0] = m[1] + (m[1] − m[2]) h[0]/h[1] put in, and likewise at the other end.
    let inner = n - 2;
    let (mut lower, mut upper) = (h[..inner].to_vec(), h[1..].to_vec());
    let mut diagonal: Vec<f64> = h.windows(2).map(|pair| 2.0 * (pair[0] + pair[1])).collect();
    let mut right: Vec<f64> = slope.windows(2).map(|pair| 6.0 * (pair[1] - pair[0])).collect();
    if inner >= 2 {
        let first = h[0] / h[1];
        diagonal[0] += h[0] * (1.0 + first);
        upper[0] -= h[0] * first;
        let last = h[n - 2] / h[n - 3];
        diagonal[inner - 1] += h[n - 2] * (1.0 + last);
        lower[inner - 1] -= h[n - 2] * last;
    }
    for k in 1..inner {
        let factor = lower[k] / diagonal[k - 1];
        diagonal[k] -= factor * upper[k - 1];
        right[k] -= factor * right[k - 1];
    }
    let mut m = vec![0.0; n];
    for k in (0..inner).rev() {
        let above = if k + 1 < inner { upper[k] * m[k + 2] } else { 0.0 };
        m[k + 1] = (right[k] - above) / diagonal[k];
    }
    if inner >= 2 {
        m[0] = m[1] + (m[1] - m[2]) * h[0] / h[1];
        m[n - 1] = m[n - 2] + (m[n - 2] - m[n - 3]) * h[n - 2] / h[n - 3];
    }
    m
}
