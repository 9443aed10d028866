//! Cubic spline through points.

/// Second derivatives of the cubic spline through the points, the third derivative continuous across the second and the
/// last but one point (not-a-knot), so that the ends bend as the data do.
pub fn second_derivatives(t: &[f64], y: &[f64]) -> Vec<f64> {
    let (n, inner) = (t.len(), t.len() - 2);
    let h = |i: usize| t[i + 1] - t[i];
    let slope = |i: usize| (y[i + 1] - y[i]) / h(i);
    // Inner equations h[i−1] m[i−1] + 2(h[i−1] + h[i]) m[i] + h[i] m[i+1] = 6(slope[i] − slope[i−1]), with the end values
    // m[0] = m[1] + (m[1] − m[2]) h[0]/h[1] put in, and likewise at the other end. Equation k is of m[k+1], which first holds its right
    // side.
    let (first, last) = if inner >= 2 { (h(0) / h(1), h(n - 2) / h(n - 3)) } else { (0.0, 0.0) };
    let lower = |k: usize| if k + 1 < inner { h(k) } else { h(k) - h(n - 2) * last };
    let upper = |k: usize| if k > 0 { h(k + 1) } else { h(1) - h(0) * first };
    let (mut diagonal, mut m) = (vec![0.0; inner], vec![0.0; n]);
    let mut slope_before = slope(0);
    for k in 0..inner {
        let slope_after = slope(k + 1);
        diagonal[k] = 2.0 * (h(k) + h(k + 1));
        m[k + 1] = 6.0 * (slope_after - slope_before);
        slope_before = slope_after;
        if inner >= 2 && k == 0 {
            diagonal[k] += h(0) * (1.0 + first);
        }
        if inner >= 2 && k + 1 == inner {
            diagonal[k] += h(n - 2) * (1.0 + last);
        }
        if k > 0 {
            let factor = lower(k) / diagonal[k - 1];
            diagonal[k] -= factor * upper(k - 1);
            m[k + 1] -= factor * m[k];
        }
    }
    for k in (0..inner).rev() {
        let above = if k + 1 < inner { upper(k) * m[k + 2] } else { 0.0 };
        m[k + 1] = (m[k + 1] - above) / diagonal[k];
    }
    if inner >= 2 {
        m[0] = m[1] + (m[1] - m[2]) * h(0) / h(1);
        m[n - 1] = m[n - 2] + (m[n - 2] - m[n - 3]) * h(n - 2) / h(n - 3);
    }
    m
}
