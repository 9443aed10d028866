//! The independent reference of a described unit: mean rates or quaternions, with noise and gaps.

use std::fmt::Write;

use super::motion::DeviceMotion;
use super::unit::DeviceUnit;
use crate::noise::Noise;
use crate::reference::{RAD_PER_ARCSEC, product, rotation};

/// Longest step of the attitude's integral: half of it twice, with the turn of the axis in between to third order.
const STEP_S: f64 = 0.005;

/// Format and error of a reference.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceReference {
    /// Quaternions in place of rates.
    pub is_attitude: bool,
    /// Rows a second.
    pub rows_hz: f64,
    /// White noise of each row's attitude about each axis.
    pub sigma_arcsec: f64,
    /// States the noise in a column; quaternions only.
    pub has_sigma: bool,
    /// Times without rows, start and end.
    pub gaps_s: Vec<[f64; 2]>,
    /// Adds the temperature as a column `sensor_c`.
    pub has_temperature: bool,
}

impl DeviceReference {
    /// Rows from the start up to `end_s`.
    pub fn write(
        &self,
        motion: &DeviceMotion,
        unit: &DeviceUnit,
        mut noise: Noise,
        start_unix_s: u64,
        end_s: f64,
    ) -> String {
        let mut text = self.header();
        let rows = (end_s * self.rows_hz).ceil() as u64;
        let (mut attitude, mut before, mut before_s) = ([1.0, 0.0, 0.0, 0.0], [0.0; 3], 0.0);
        for row in 0..=rows {
            let t = row as f64 / self.rows_hz;
            if row > 0 && self.is_attitude {
                attitude = advanced(attitude, motion, t - 1.0 / self.rows_hz, t);
            }
            let error = [0; 3].map(|_| self.sigma_arcsec * noise.normal());
            let is_in_gap = self.gaps_s.iter().any(|[from_s, to_s]| (*from_s..*to_s).contains(&t));
            if is_in_gap && row > 0 {
                continue;
            }
            let (_, angles) = motion.at(t);
            let angles: [f64; 3] = std::array::from_fn(|axis| angles[axis] + error[axis]);
            let t_s = start_unix_s as f64 + t;
            if self.is_attitude {
                let [w, x, y, z] = product(attitude, rotation(error.map(|error| error * RAD_PER_ARCSEC)));
                let _ = write!(text, "{t_s:.4},{w:.12},{x:.12},{y:.12},{z:.12}");
            } else if row > 0 {
                let [x, y, z]: [f64; 3] = std::array::from_fn(|axis| (angles[axis] - before[axis]) / (t - before_s));
                let _ = write!(text, "{t_s:.4},{x:.6},{y:.6},{z:.6}");
            }
            (before, before_s) = (angles, t);
            if row == 0 && !self.is_attitude {
                continue;
            }
            if self.has_sigma && self.is_attitude {
                let _ = write!(text, ",{:.4}", self.sigma_arcsec);
            }
            if self.has_temperature {
                let _ = write!(text, ",{:.2}", unit.temperature_c(t));
            }
            text.push('\n');
        }
        text
    }

    fn header(&self) -> String {
        let motion =
            if self.is_attitude { "q_w,q_x,q_y,q_z" } else { "rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s" };
        let sigma = if self.has_sigma && self.is_attitude { ",sigma_arcsec" } else { "" };
        let temperature = if self.has_temperature { ",sensor_c" } else { "" };
        format!("t_s,{motion}{sigma}{temperature}\n")
    }
}

/// The attitude after an interval: of each step both halves, and two thirds of their cross product.
fn advanced(mut attitude: [f64; 4], motion: &DeviceMotion, from_s: f64, to_s: f64) -> [f64; 4] {
    let steps = ((to_s - from_s) / STEP_S).ceil();
    let step_s = (to_s - from_s) / steps;
    let mut before = motion.at(from_s).1;
    for step in 0..steps as u32 {
        let start_s = from_s + f64::from(step) * step_s;
        let [middle, after] = [0.5, 1.0].map(|share| motion.at(start_s + share * step_s).1);
        let turn = |from: [f64; 3], to: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|axis| (to[axis] - from[axis]) * RAD_PER_ARCSEC)
        };
        let (a, b) = (turn(before, middle), turn(middle, after));
        let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        let vector = std::array::from_fn(|axis| a[axis] + b[axis] + 2.0 / 3.0 * cross[axis]);
        attitude = product(attitude, rotation(vector));
        before = after;
    }
    attitude
}
