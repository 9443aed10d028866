//! The angle of a head within a row of a table that ends between nodes.
//!
//! Even growth would damp a motion: by 1 % midway between rows, with 20 rows in its period. As nodes wander through the rows, that looks
//! like a scale factor, a lag or uneven noise.

/// The angle over a row, and how it bends with the rows beside it.
#[derive(Debug, Clone, Copy)]
pub struct BentAngle {
    arcsec: f64,
    /// Half the change from the row before to the row after, and the second difference, arcsec.
    slope: f64,
    curvature: f64,
}

impl BentAngle {
    /// An angle that grows evenly.
    pub fn even(arcsec: f64) -> BentAngle {
        BentAngle { arcsec, slope: 0.0, curvature: 0.0 }
    }

    /// The angle of a row between two others of about its length; it grows evenly beside an unknown one.
    pub fn between(before: f64, arcsec: f64, after: f64) -> BentAngle {
        match (before + arcsec + after).is_finite() {
            true => BentAngle { arcsec, slope: 0.5 * (after - before), curvature: after - 2.0 * arcsec + before },
            false => BentAngle::even(arcsec),
        }
    }

    /// Angle of the first part of the row: a cubic through the accumulated angle at the ends of the three rows.
    pub fn at(&self, share: f64) -> f64 {
        let bend = share * (share - 1.0);
        self.arcsec * share + bend * (0.5 * self.slope + self.curvature * (share - 0.5) / 6.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_angle_of_third_degree_is_exact() {
        let angle = |t: f64| 2.0 - 3.0 * t + 0.7 * t * t - 0.2 * t.powi(3);
        let row = |end: f64| angle(end) - angle(end - 1.0);
        let bent = BentAngle::between(row(0.0), row(1.0), row(2.0));
        for share in [0.0, 0.1, 0.5, 0.77, 1.0] {
            assert!((bent.at(share) - (angle(share) - angle(0.0))).abs() < 1e-12, "{share}");
        }
    }

    #[test]
    fn a_row_beside_an_unknown_one_grows_evenly() {
        assert_eq!(BentAngle::between(f64::NAN, 3.0, 5.0).at(0.5), 1.5);
    }
}
