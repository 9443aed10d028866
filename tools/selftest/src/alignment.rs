//! Misalignment, lasting and thermal (Casteren §3.4, §5.3).

use geu_protocol::Gyro;

use super::estimate::{LineFit, level, settling};
use super::receiver::between;
use super::{Estimate, Measurement, Receiver};
use geu_model::units::ARCSEC_PER_RAD;

pub const MEASUREMENTS: &[Measurement] = &[
    ("misalignment in a Z-scan", |receiver| vec![misalignment(receiver, 6180.0, Gyro::X, 2)]),
    ("misalignment in a Y-scan", |receiver| vec![misalignment(receiver, 320.0, Gyro::X, 1)]),
    ("misalignment in an X-scan", |receiver| vec![misalignment(receiver, 6180.0, Gyro::Y, 0)]),
    ("thermal misalignment", |receiver| {
        let rows = receiver.listen(4800.0);
        let settled = level(between(&rows, 3320.0, 4800.0).iter().map(|row| row.residual(Gyro::Y)));
        let after: Vec<_> =
            between(&rows, 320.0, 4800.0).iter().map(|row| (row.t_s - 320.0, row.residual(Gyro::Y))).collect();
        vec![settled, settling(&after, 200.0)[2]]
    }),
];

/// The part of a control axis on a gyro's input axis.
fn misalignment(receiver: &mut Receiver, until_s: f64, gyro: Gyro, axis: usize) -> Estimate {
    let rows = receiver.listen(until_s);
    LineFit::new(rows.iter().map(|row| (row.reference_arcsec[axis], row.residual(gyro)))).slope.times(ARCSEC_PER_RAD)
}
