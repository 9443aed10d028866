//! Temperatures without the steps of their transmission.

/// Resolution of a transmitted temperature, K.
const RESOLUTION_K: f64 = 0.01;

/// Temperatures at the nodes, straight between the middles of equal readings: the true value passes through a reading about there, and
/// turns about there where the readings do. Jumps by more than the resolution remain.
pub fn between_readings(celsius: &[f64]) -> Vec<f64> {
    let mut knots: Vec<(f64, f64)> = Vec::new();
    let mut node = 0;
    for run in celsius.chunk_by(|one, other| one == other) {
        let (first, last) = (node, node + run.len() - 1);
        node += run.len();
        let is_step =
            |neighbour: Option<&f64>| neighbour.is_some_and(|other| (other - run[0]).abs() < 1.5 * RESOLUTION_K);
        let follows = first > 0 && is_step(celsius.get(first - 1));
        let continues = is_step(celsius.get(node));
        match (follows, continues) {
            (true, true) => knots.push((0.5 * (first + last) as f64, run[0])),
            _ => knots.extend([(first as f64, run[0]), (last as f64, run[0])]),
        }
    }
    let mut next = 0;
    let value = |node: usize| {
        let at = node as f64;
        while next < knots.len() && knots[next].0 < at {
            next += 1;
        }
        match (next.checked_sub(1).map(|before| knots[before]), knots.get(next)) {
            (Some((from, one)), Some(&(to, other))) => one + (other - one) * (at - from) / (to - from),
            (Some((_, one)), None) => one,
            (None, _) => celsius[node],
        }
    };
    (0..celsius.len()).map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swing_is_smooth_and_turns_where_it_turned() {
        let truth: Vec<f64> = (0..12_000).map(|node| 20.0 + 2.0 * (node as f64 / 1400.0).sin()).collect();
        let read: Vec<f64> = truth.iter().map(|celsius| (celsius / RESOLUTION_K).round() * RESOLUTION_K).collect();
        let found = between_readings(&read);
        let error = |values: &[f64]| -> f64 {
            let steps = values.windows(2).zip(truth.windows(2));
            steps.map(|(own, real)| (own[1] - own[0] - real[1] + real[0]).powi(2)).sum()
        };
        assert!(error(&found) < 0.05 * error(&read), "{} {}", error(&found), error(&read));
        assert!(found.iter().zip(&truth).all(|(own, real)| (own - real).abs() < RESOLUTION_K));
    }

    #[test]
    fn jumps_and_constant_readings_remain() {
        let read = [vec![20.0; 50], vec![23.0; 50]].concat();
        assert_eq!(between_readings(&read), read);
        assert_eq!(between_readings(&[21.0]), [21.0]);
        assert!(between_readings(&[]).is_empty());
    }
}
