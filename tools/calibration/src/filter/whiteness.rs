//! Test of innovations: standard normal and independent if the filter's model is right.

use super::Innovation;

const LAGS: usize = 10;
/// A verdict of "not white" is wrong once in a hundred, both tests together.
const LEVEL: f64 = 0.01;

/// Two tests of the innovations: their size by χ², their independence by Ljung and Box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Whiteness {
    /// Sum of the squared normalised innovations.
    pub nis: f64,
    /// Degrees of freedom: the number of innovations.
    pub nis_dof: usize,
    /// Two-sided probability; 1 without innovations.
    pub nis_p: f64,
    /// Ljung and Box's Q, each component of the fixes a series of its own, added up.
    pub ljung_box: f64,
    pub ljung_box_dof: usize,
    /// Probability of a Q as large; 1 with too few innovations for a lag.
    pub ljung_box_p: f64,
}

impl Whiteness {
    /// Tests innovations in order of time.
    pub fn from_innovations(innovations: &[Innovation]) -> Whiteness {
        let nis: f64 = innovations.iter().map(|innovation| innovation.normalised.powi(2)).sum();
        let nis_dof = innovations.len();
        let above = chi2_survival(nis, nis_dof);
        let (mut ljung_box, mut ljung_box_dof) = (0.0, 0);
        let components = innovations.iter().map(|innovation| innovation.component + 1).max().unwrap_or(0);
        for component in 0..components {
            let series: Vec<f64> = innovations
                .iter()
                .filter(|innovation| innovation.component == component)
                .map(|innovation| innovation.normalised)
                .collect();
            let lags = LAGS.min(series.len() / 5);
            ljung_box += ljung_box_q(&series, lags);
            ljung_box_dof += lags;
        }
        let nis_p = if nis_dof == 0 { 1.0 } else { 2.0 * above.min(1.0 - above) };
        Whiteness {
            nis,
            nis_dof,
            nis_p,
            ljung_box,
            ljung_box_dof,
            ljung_box_p: chi2_survival(ljung_box, ljung_box_dof),
        }
    }

    /// Probability of a sum of squares as large as that of these innovations, if the filter's sigmas are right; a small one says that
    /// the attitude errs by more than its sigmas.
    pub fn probability(&self) -> f64 {
        chi2_survival(self.nis, self.nis_dof)
    }

    /// Root mean square of the normalised innovations; 0 without innovations.
    pub fn rms(&self) -> f64 {
        (self.nis / self.nis_dof.max(1) as f64).sqrt()
    }

    /// True if neither test rejects, at 1 % for both together.
    pub fn is_white(&self) -> bool {
        self.nis_p.min(self.ljung_box_p) >= 0.5 * LEVEL
    }
}

/// Q = n(n + 2) Σ r²/(n − lag). The mean is known to be 0, so it is not taken off: a constant error shows.
fn ljung_box_q(series: &[f64], lags: usize) -> f64 {
    let n = series.len() as f64;
    let power: f64 = series.iter().map(|value| value * value).sum();
    let correlation = |lag: usize| series.iter().zip(&series[lag..]).map(|(a, b)| a * b).sum::<f64>() / power;
    (1..=lags).map(|lag| n * (n + 2.0) * correlation(lag).powi(2) / (n - lag as f64)).sum()
}

/// Probability that χ² with `dof` degrees of freedom is `value` or more, by Wilson and Hilferty's cube root (1931): within
/// 0.003 for 2 degrees and more; 1 for none.
pub fn chi2_survival(value: f64, dof: usize) -> f64 {
    if dof == 0 {
        return 1.0;
    }
    let spread = 2.0 / (9.0 * dof as f64);
    let z = (libm::cbrt(value / dof as f64) - (1.0 - spread)) / spread.sqrt();
    0.5 * libm::erfc(z / std::f64::consts::SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geu_model::noise::NoiseStream;

    fn innovations(values: impl Iterator<Item = f64>) -> Vec<Innovation> {
        values.enumerate().map(|(index, normalised)| Innovation { component: index % 2, normalised }).collect()
    }

    #[test]
    fn chances_of_chi_squared_are_those_of_the_tables() {
        // 5 % and 1 % points, Abramowitz and Stegun table 26.8.
        for (value, dof, probability) in
            [(5.991, 2, 0.05), (9.210, 2, 0.01), (18.307, 10, 0.05), (23.209, 10, 0.01), (135.807, 100, 0.01)]
        {
            assert!((chi2_survival(value, dof) - probability).abs() < 0.003, "{value} of {dof}");
        }
    }

    #[test]
    fn white_numbers_pass_and_coloured_or_large_ones_do_not() {
        let mut refused = 0;
        for seed in 0..200 {
            let mut stream = NoiseStream::of_sensor(seed, "whiteness");
            let white: Vec<f64> = (0..96).map(|_| stream.standard_normal()).collect();
            refused += u32::from(!Whiteness::from_innovations(&innovations(white.iter().copied())).is_white());
            assert!(
                !Whiteness::from_innovations(&innovations(white.iter().map(|value| 1.6 * value))).is_white(),
                "{seed}"
            );
            assert!(
                !Whiteness::from_innovations(&innovations(white.iter().map(|value| value + 1.0))).is_white(),
                "{seed}"
            );
        }
        // 1 % of 200 is 2; Q's upper tail is a little heavier than χ²'s at 48 values a series.
        assert!(refused <= 8, "{refused}");
    }

    #[test]
    fn few_or_no_innovations_are_no_reason_to_refuse() {
        assert!(Whiteness::from_innovations(&[]).is_white());
        assert!(Whiteness::from_innovations(&innovations([0.3, -0.8].into_iter())).is_white());
    }
}
