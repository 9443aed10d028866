//! The better sensor: mean rates over samples of true time, or a star tracker's quaternions.

use std::f64::consts::PI;
use std::fmt::Write;

use crate::motion::Motion;
use crate::noise::Noise;
use crate::{SAMPLE_INTERVAL_S, STEP_S, STEPS};

pub(crate) const RAD_PER_ARCSEC: f64 = PI / 648_000.0;

/// Format and error of the reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ReferenceKind {
    /// Exact mean rates over samples, with θ and ψ where there is a sun.
    Rates,
    /// Quaternions, control frame to inertial.
    Quaternions {
        /// Steps of 25 ms between them.
        steps: usize,
        /// White noise about each axis.
        sigma_arcsec: f64,
    },
    /// Quaternions with a column that states the noise of each; a third of them has ten times the noise.
    UnevenQuaternions {
        /// Steps of 25 ms between them.
        steps: usize,
        /// White noise about each axis of the other two thirds.
        sigma_arcsec: f64,
        /// Rows of more noise beside each other.
        rows: usize,
        /// Stated over true noise.
        stated: f64,
    },
}

/// Noise of the noisy third over that of the other rows.
const UNEVEN: f64 = 10.0;

/// A reference that starts at `start_unix_s` and covers the motion up to `end_s`.
pub fn reference(kind: ReferenceKind, motion: &Motion, noise: Noise, start_unix_s: u64, end_s: f64) -> String {
    match kind {
        ReferenceKind::Rates => rates(motion, start_unix_s, end_s),
        ReferenceKind::Quaternions { steps, sigma_arcsec } => {
            quaternions(motion, noise, start_unix_s, end_s, steps, |_| sigma_arcsec, None)
        }
        ReferenceKind::UnevenQuaternions { steps, sigma_arcsec, rows, stated } => {
            let sigma = |row: usize| if row / rows % 3 == 1 { UNEVEN * sigma_arcsec } else { sigma_arcsec };
            quaternions(motion, noise, start_unix_s, end_s, steps, sigma, Some(stated))
        }
    }
}

/// Mean rates over samples of true time, θ and ψ at their ends.
fn rates(motion: &Motion, start_unix_s: u64, end_s: f64) -> String {
    let sun = if motion.at(0.0).sun_deg.is_some() { ",theta_deg,psi_deg" } else { "" };
    let mut text = format!("t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s{sun}\n");
    for row in 0..(end_s / SAMPLE_INTERVAL_S).ceil() as usize {
        let start_s = row as f64 * SAMPLE_INTERVAL_S;
        let mut sums = [0.0; 3];
        for step in 0..STEPS {
            let rates = motion.at(start_s + (step as f64 + 0.5) * STEP_S).rates;
            sums = std::array::from_fn(|axis| sums[axis] + rates[axis]);
        }
        let [x, y, z] = sums.map(|sum| sum / STEPS as f64);
        let t_s = start_unix_s as f64 + start_s + SAMPLE_INTERVAL_S;
        let _ = write!(text, "{t_s:.4},{x:.6},{y:.6},{z:.6}");
        if let Some((theta_deg, psi_deg)) = motion.at(start_s + SAMPLE_INTERVAL_S).sun_deg {
            let _ = write!(text, ",{theta_deg:.6},{psi_deg:.6}");
        }
        text.push('\n');
    }
    text
}

/// Integrates the attitude, and writes it each `steps` with a small turn about the control axes, of a sigma by its row; `stated` over true
/// sigma, if there is a column of it.
fn quaternions(
    motion: &Motion,
    mut noise: Noise,
    start_unix_s: u64,
    end_s: f64,
    steps: usize,
    sigma_arcsec: impl Fn(usize) -> f64,
    stated: Option<f64>,
) -> String {
    let mut text = format!("t_s,q_w,q_x,q_y,q_z{}\n", if stated.is_some() { ",sigma_arcsec" } else { "" });
    let mut attitude = [1.0, 0.0, 0.0, 0.0];
    for step in 0..=(end_s / STEP_S).ceil() as usize {
        if step % steps == 0 {
            let sigma_arcsec = sigma_arcsec(step / steps);
            let error = [0; 3].map(|_| sigma_arcsec * noise.normal() * RAD_PER_ARCSEC);
            let [w, x, y, z] = product(attitude, rotation(error));
            let t_s = start_unix_s as f64 + step as f64 * STEP_S;
            let _ = write!(text, "{t_s:.4},{w:.10},{x:.10},{y:.10},{z:.10}");
            if let Some(stated) = stated {
                let _ = write!(text, ",{:.3}", stated * sigma_arcsec);
            }
            text.push('\n');
        }
        let rates = motion.at((step as f64 + 0.5) * STEP_S).rates;
        attitude = product(attitude, rotation(rates.map(|rate| rate * STEP_S * RAD_PER_ARCSEC)));
    }
    text
}

/// The quaternion of a rotation vector, rad.
pub(crate) fn rotation(vector: [f64; 3]) -> [f64; 4] {
    let angle = vector.iter().map(|part| part * part).sum::<f64>().sqrt();
    let (sin, cos) = libm::sincos(angle / 2.0);
    let scale = if angle > 0.0 { sin / angle } else { 0.5 };
    [cos, vector[0] * scale, vector[1] * scale, vector[2] * scale]
}

/// Hamilton's product.
pub(crate) fn product([a, b, c, d]: [f64; 4], [e, f, g, h]: [f64; 4]) -> [f64; 4] {
    [
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    ]
}
