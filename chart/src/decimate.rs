/// Reduces more than two points per column to the smallest and the largest value of each column, in their order.
///
/// `range` is that of the first coordinate, by which the points must be sorted. A chart with `columns` pixels does not
/// change by this.
pub fn min_max(points: &[(f64, f64)], range: (f64, f64), columns: usize) -> Vec<(f64, f64)> {
    if points.len() <= 2 * columns {
        return points.to_vec();
    }
    let column = |point: &(f64, f64)| ((point.0 - range.0) / (range.1 - range.0) * columns as f64).floor();
    let mut kept = Vec::with_capacity(2 * columns);
    for within in points.chunk_by(|one, other| column(one) == column(other)) {
        let by_value = |one: &&(f64, f64), other: &&(f64, f64)| one.1.total_cmp(&other.1);
        let (Some(&min), Some(&max)) = (within.iter().min_by(by_value), within.iter().max_by(by_value)) else {
            continue;
        };
        let (first, second) = if min.0 <= max.0 { (min, max) } else { (max, min) };
        kept.push(first);
        if first != second {
            kept.push(second);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_keeps_the_extremes_of_every_column() {
        let points: Vec<(f64, f64)> = (0..172_800).map(|n| (f64::from(n) * 0.5, f64::from(n * 7919 % 1009))).collect();
        let columns = 800;
        let kept = min_max(&points, (0.0, 86_400.0), columns);
        assert!(kept.len() <= 2 * columns && kept.is_sorted_by(|one, other| one.0 <= other.0));
        for column in 0..columns {
            let within = |points: &[(f64, f64)]| {
                let own = points.iter().filter(|point| (point.0 / 108.0) as usize == column).map(|point| point.1);
                own.fold((f64::MAX, f64::MIN), |(min, max), value| (min.min(value), max.max(value)))
            };
            assert_eq!(within(&kept), within(&points), "column {column}");
        }
    }

    #[test]
    fn few_points_stay_as_they_are() {
        let points = [(0.0, 1.0), (0.1, 3.0), (0.2, 2.0)];
        assert_eq!(min_max(&points, (0.0, 1.0), 2), points);
        assert_eq!(min_max(&points, (0.0, 1.0), 1), [(0.0, 1.0), (0.1, 3.0)]);
        assert!(min_max(&[], (0.0, 1.0), 1).is_empty());
    }
}
