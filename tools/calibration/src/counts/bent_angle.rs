//! The angle of a head within a row of a table that ends between nodes.
//!
//! Even growth would damp a motion: by 1 % midway between rows, with 20 rows in its period. As nodes wander through the rows, that looks
//! like a scale factor, a lag or uneven noise.

/// The angle over a row, and how it bends with the rows beside it.
#[derive(Debug, Clone, Copy)]
pub struct BentAngle {
    arcsec: f64,
    /// Second and third divided difference of the accumulated angle at the ends of the three rows; the unit of time is this row.
    second: f64,
    third: f64,
    /// Length of the row before, in lengths of this row.
    before: f64,
}

/// A row beside another one: its length in lengths of that one, and its angle, arcsec.
#[derive(Debug, Clone, Copy)]
pub struct BesideRow {
    pub length: f64,
    pub arcsec: f64,
}

impl BentAngle {
    /// An angle that grows evenly.
    pub fn even(arcsec: f64) -> BentAngle {
        BentAngle { arcsec, second: 0.0, third: 0.0, before: 1.0 }
    }

    /// The angle of a row between two others; it grows evenly beside an unknown angle.
    pub fn between(before: BesideRow, arcsec: f64, after: BesideRow) -> BentAngle {
        let [rate_before, rate_after] = [before, after].map(|row| row.arcsec / row.length);
        let second = (arcsec - rate_before) / (1.0 + before.length);
        let second_after = (rate_after - arcsec) / (1.0 + after.length);
        let third = (second_after - second) / (1.0 + before.length + after.length);
        match third.is_finite() {
            true => BentAngle { arcsec, second, third, before: before.length },
            false => BentAngle::even(arcsec),
        }
    }

    /// Angle of the first part of the row: Newton's cubic through the accumulated angle at the ends of the three rows.
    pub fn at(&self, share: f64) -> f64 {
        self.arcsec * share + share * (share - 1.0) * (self.second + self.third * (share + self.before))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_angle_of_third_degree_is_exact_in_rows_of_any_length() {
        let angle = |t: f64| 2.0 - 3.0 * t + 0.7 * t * t - 0.2 * t.powi(3);
        for [before, after] in [[1.0, 1.0], [0.6, 1.4]] {
            let [from, to] = [-before, 1.0 + after];
            let before = BesideRow { length: before, arcsec: angle(0.0) - angle(from) };
            let after = BesideRow { length: after, arcsec: angle(to) - angle(1.0) };
            let bent = BentAngle::between(before, angle(1.0) - angle(0.0), after);
            for share in [0.0, 0.1, 0.5, 0.77, 1.0] {
                assert!((bent.at(share) - (angle(share) - angle(0.0))).abs() < 1e-12, "{share}");
            }
        }
    }

    #[test]
    fn a_row_beside_an_unknown_one_grows_evenly() {
        let row = |arcsec: f64| BesideRow { length: 1.0, arcsec };
        assert_eq!(BentAngle::between(row(f64::NAN), 3.0, row(5.0)).at(0.5), 1.5);
    }
}
