//! Products of signatures, projections on the nuisances and fits.

use nalgebra::DVector;

/// A signature is not distinguishable from the nuisances if they leave less than this share of its square.
const MIN_REMAINDER: f64 = 1e-4;

/// Products of one signature with itself, with the residual and with the nuisances. Products of channels add up.
#[derive(Debug, Clone)]
pub struct Products {
    /// With itself.
    pub own: f64,
    /// With the residual.
    pub residual: f64,
    /// With each nuisance.
    pub nuisances: Vec<f64>,
}

/// A signature, or its part on one channel, projected on the nuisances.
#[derive(Debug, Clone)]
pub struct ProjectedSignature {
    pub(crate) own: f64,
    pub(crate) right: f64,
    pub(crate) part: DVector<f64>,
}

impl ProjectedSignature {
    /// Square without the projection on the nuisances; `None` if it is not distinguishable from them.
    pub(super) fn remaining_square(&self) -> Option<f64> {
        distinguishable(self.own - self.part.norm_squared(), self.own)
    }
}

/// The part that the nuisances leave of the square of a signature; `None` if it is not distinguishable from them.
pub fn distinguishable(left: f64, own: f64) -> Option<f64> {
    (left > MIN_REMAINDER * own && own > 0.0).then_some(left)
}

/// Fit of a signature to the residual.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SignatureFit {
    /// Amplitude.
    pub size: f64,
    /// 1 sigma.
    pub sigma: f64,
    /// χ² reduction.
    pub chi2: f64,
}

impl SignatureFit {
    /// Fit of a signature of which the nuisances leave the square `left`, with this product with the residual.
    pub fn new(left: f64, right: f64) -> SignatureFit {
        SignatureFit { size: right / left, sigma: left.sqrt().recip(), chi2: right * right / left }
    }
}

impl Products {
    /// Products of an empty signature.
    pub fn none(nuisances: usize) -> Products {
        Products { own: 0.0, residual: 0.0, nuisances: vec![0.0; nuisances] }
    }

    /// Adds the products of another channel.
    #[must_use]
    pub fn plus(mut self, other: &Products) -> Products {
        self.own += other.own;
        self.residual += other.residual;
        self.nuisances.iter_mut().zip(&other.nuisances).for_each(|(sum, value)| *sum += value);
        self
    }
}
