//! Misalignment, lasting and thermal (Casteren §3.4, §5.3).

use geu_protocol::Gyro;

use super::Expected::Value;
use super::estimate::{LineFit, level, settling};
use super::receiver::between;
use super::{Estimate, Experiment, Receiver, claim};
use geu_model::units::ARCSEC_PER_RAD;

pub const EXPERIMENTS: &[Experiment] = &[
    Experiment {
        name: "misalignment in a Z-scan",
        noise: false,
        configuration: "
            manoeuvre = [{ kind = \"z-scan\" }]
            gyro.GYRX.misalignment.z_arcsec = 60
        ",
        claims: &[claim("misalignment of an arcminute: GXz", "§3.4", Value(60.0, 0.0), "″")],
        measure: |receiver| vec![misalignment(receiver, 6180.0, Gyro::X, 2)],
    },
    Experiment {
        name: "misalignment in a Y-scan",
        noise: false,
        configuration: "
            scenario = { theta_deg = 60, limit_cycle = { rate_arcsec_s = 4 } }
            manoeuvre = [{ kind = \"y-scan\", to_theta_deg = 120 }]
            gyro.GYRX.misalignment.y_arcsec = 60
        ",
        claims: &[claim("misalignment of an arcminute: GXy", "§3.4", Value(60.0, 0.0), "″")],
        measure: |receiver| vec![misalignment(receiver, 320.0, Gyro::X, 1)],
    },
    Experiment {
        name: "misalignment in an X-scan",
        noise: false,
        configuration: "
            scenario.theta_deg = 60
            manoeuvre = [{ kind = \"x-scan\" }]
            gyro.GYRY.misalignment.x_arcsec = 60
        ",
        claims: &[claim("misalignment of an arcminute: GYx", "§3.4", Value(60.0, 0.0), "″")],
        measure: |receiver| vec![misalignment(receiver, 6180.0, Gyro::Y, 0)],
    },
    Experiment {
        name: "thermal misalignment",
        noise: false,
        // Half an arcsec per degree is 30″ over the scan, which GYRY senses; the scan takes 5 min.
        configuration: "
            scenario = { theta_deg = 60, psi_deg = 90, limit_cycle = { rate_arcsec_s = 4 } }
            manoeuvre = [{ kind = \"y-scan\", to_theta_deg = 120 }]
            unit.misalignment-thermal.arcsec_per_deg = 0.5
        ",
        claims: &[
            claim("thermal turn over a Y-scan: tens of arcsec", "§3.4, model", Value(30.0, 0.0), "″"),
            claim("its lag: the scan's duration", "§5.3", Value(300.0, 0.0), "s"),
        ],
        measure: |receiver| {
            let rows = receiver.listen(4800.0);
            let settled = level(between(&rows, 3320.0, 4800.0).iter().map(|row| row.residual(Gyro::Y)));
            let after: Vec<_> =
                between(&rows, 320.0, 4800.0).iter().map(|row| (row.t_s - 320.0, row.residual(Gyro::Y))).collect();
            vec![settled, settling(&after, 200.0)[2]]
        },
    },
];

/// The part of a control axis on a gyro's input axis.
fn misalignment(receiver: &mut Receiver, until_s: f64, gyro: Gyro, axis: usize) -> Estimate {
    let rows = receiver.listen(until_s);
    LineFit::new(rows.iter().map(|row| (row.reference_arcsec[axis], row.residual(gyro)))).slope.times(ARCSEC_PER_RAD)
}
