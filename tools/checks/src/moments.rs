//! Median; sums of two series and of their products.

/// Median, the upper of the two middle values; 0 without values.
pub fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Sums over pairs of values.
#[derive(Debug, Default)]
pub struct Moments {
    pub count: f64,
    pub x: f64,
    pub y: f64,
    pub xx: f64,
    pub xy: f64,
    pub yy: f64,
}

impl Moments {
    /// Moments of sums over `summed` pairs each, without the remainder.
    pub fn of_sums(pairs: impl Iterator<Item = (f64, f64)>, summed: usize) -> Moments {
        let (mut moments, mut sums) = (Moments::default(), (0, 0.0, 0.0));
        for (x, y) in pairs {
            sums = (sums.0 + 1, sums.1 + x, sums.2 + y);
            if sums.0 == summed {
                moments.add(sums.1, sums.2);
                sums = (0, 0.0, 0.0);
            }
        }
        moments
    }

    /// Correlation; 0 if a series does not change.
    pub fn correlation(&self) -> f64 {
        let Moments { count, x, y, xx, xy, yy } = self;
        let variances = (count * xx - x * x) * (count * yy - y * y);
        if variances > 0.0 { (count * xy - x * y) / variances.sqrt() } else { 0.0 }
    }

    /// Adds a pair.
    pub fn add(&mut self, x: f64, y: f64) {
        self.count += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
    }
}
