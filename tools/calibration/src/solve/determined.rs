//! Check that the manoeuvres determine every parameter.

use geu_model::units::ARCSEC_PER_DEG;
use geu_protocol::Gyro;
use nalgebra::DMatrix;

use super::{Equations, PER_GYRO, SolveError};

impl Equations<'_> {
    /// Rejects directions that the data determine worse than the knowledge before launch.
    pub(super) fn check_determined(&self) -> Result<(), SolveError> {
        let mut open = Vec::new();
        if self.observations.is_empty() {
            return Err(SolveError::Undetermined(vec!["no manoeuvre could be used".to_owned()]));
        }
        for gyro in Gyro::ALL {
            let own: Vec<usize> = (0..self.rows.len()).filter(|&row| self.rows[row].1 == gyro.index()).collect();
            if own.is_empty() {
                open.push(format!("{}: no manoeuvre has usable counts of it", gyro.name()));
                continue;
            }
            // Scaled by the knowledge before launch and by the noise: an eigenvalue below 1 is undetermined.
            let scaled = DMatrix::from_fn(own.len(), PER_GYRO, |row, index| {
                let size = self.parameters[PER_GYRO * gyro.index() + index].before_launch();
                let row = own[row];
                self.design[(row, PER_GYRO * gyro.index() + index)] * size / self.weighting[(row, row)].sqrt()
            });
            let directions = (scaled.transpose() * scaled).symmetric_eigen();
            for (index, &square) in directions.eigenvalues.iter().enumerate() {
                if square < 1.0 {
                    open.push(self.describe(gyro, directions.eigenvectors.column(index).iter().copied().collect()));
                }
            }
        }
        if open.is_empty() { Ok(()) } else { Err(SolveError::Undetermined(open)) }
    }

    /// Describes an undetermined direction.
    fn describe(&self, gyro: Gyro, direction: Vec<f64>) -> String {
        let largest_deg = |axis: usize| {
            let turned = self.observations.iter().filter(|observation| observation.counts[gyro.index()].is_some());
            turned.map(|observation| observation.rotation_control_arcsec[axis].abs()).fold(0.0, f64::max)
                / ARCSEC_PER_DEG
        };
        let parameter = |index: usize| self.parameters[PER_GYRO * gyro.index() + index];
        let mut parts: Vec<usize> = (0..PER_GYRO).filter(|&index| direction[index].abs() > 0.3).collect();
        parts.sort_by(|&a, &b| direction[b].abs().total_cmp(&direction[a].abs()));
        let axis_of = |index: usize| parameter(index).control_axis().filter(|_| index != 1);
        let names: Vec<String> = parts.iter().map(|&index| parameter(index).label()).collect();
        match (parts.as_slice(), parts.first().and_then(|&index| axis_of(index))) {
            ([_], Some(axis)) => format!(
                "{}: no manoeuvre turns about {} (at most {:.3} deg)",
                names[0],
                ["X", "Y", "Z"][axis],
                largest_deg(axis)
            ),
            ([_], None) => {
                let longest_s = self.observations.iter().map(|found| found.end_s - found.start_s).fold(0.0, f64::max);
                format!("{}: no manoeuvre is long enough (at most {longest_s:.1} s)", names[0])
            }
            _ => format!(
                "{} cannot be distinguished: {} manoeuvre{} with counts of {} {} few, or they turn about these axes only together",
                names.join(" and "),
                self.rows.iter().filter(|row| row.1 == gyro.index()).count(),
                if self.observations.len() == 1 { "" } else { "s" },
                gyro.name(),
                if self.observations.len() == 1 { "is too" } else { "are too" },
            ),
        }
    }
}
