//! Stated sigmas of the rows of a reference beside the scatter found.

use geu_checks::{Finding, median};
use nalgebra::Vector3;

/// Sigma of the gyros' attitude by the rounding of counts: a row that is exact differs from it by this.
const ROUNDING_ARCSEC: f64 = 0.4;
/// Ratio of found and stated sigma, either way, from which they disagree: weights by the stated one alone would be wrong by four. Motion
/// and missing effects change the scatter found by less.
const DISAGREEMENT: f64 = 2.0;

/// Stated sigmas of the rows of a reference, and the scatter found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceSigma {
    /// Median of the stated ones about each axis.
    stated_arcsec: Vector3<f64>,
    /// Found over stated, both with the rounding of the counts.
    ratio: Vector3<f64>,
}

impl ReferenceSigma {
    /// Compares the stated sigmas with the scatter found as a multiple of these.
    pub(super) fn new(sigma_arcsec: &[[f64; 3]], ratio: Vector3<f64>) -> ReferenceSigma {
        let of_axis = |axis: usize| median(&mut sigma_arcsec.iter().map(|row| row[axis]).collect::<Vec<_>>());
        ReferenceSigma { stated_arcsec: Vector3::from_fn(|axis, _| of_axis(axis)), ratio }
    }

    /// The finding of stated sigmas that the scatter contradicts.
    pub fn finding(&self) -> Option<Finding> {
        let three = |values: &Vector3<f64>| format!("{:.1}, {:.1}, {:.1} arcsec", values[0], values[1], values[2]);
        let found_arcsec = self.ratio.component_mul(&with_rounding(self.stated_arcsec));
        let is_off = |ratio: &f64| !(1.0 / DISAGREEMENT..=DISAGREEMENT).contains(ratio);
        self.ratio.iter().any(is_off).then(|| Finding {
            kind: "reference-sigma".to_owned(),
            place: "the whole recording".to_owned(),
            text: format!(
                "sigma of a row of the reference about X, Y, Z, medians: stated {}, found {} by the scatter against the gyros; used: the stated sigmas times found over stated",
                three(&self.stated_arcsec),
                three(&found_arcsec)
            ),
        })
    }
}

/// Sigma of the difference of a row from the gyros' attitude.
pub(super) fn with_rounding(sigma_arcsec: Vector3<f64>) -> Vector3<f64> {
    sigma_arcsec.map(|sigma| sigma.hypot(ROUNDING_ARCSEC))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigmas_off_by_more_than_two_are_a_finding() {
        let stated = [[1.0; 3], [3.0; 3], [30.0; 3]];
        let finding = |ratio: [f64; 3]| ReferenceSigma::new(&stated, ratio.into()).finding();
        assert!(finding([1.0, 1.9, 0.55]).is_none());
        let text = finding([1.0, 5.0, 1.0]).expect("a finding").text;
        assert!(text.contains("stated 3.0, 3.0, 3.0 arcsec, found 3.0, 15.1, 3.0 arcsec"), "{text}");
        assert!(finding([0.2, 1.0, 1.0]).is_some());
        // An exact row differs from the gyros by their rounding.
        assert!(ReferenceSigma::new(&[[0.0; 3]], Vector3::repeat(0.45 / ROUNDING_ARCSEC)).finding().is_none());
    }
}
