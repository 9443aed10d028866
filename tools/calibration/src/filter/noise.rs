//! The filter's noise model of the gyros, each number with its source.

use geu_model::Configuration;
use geu_model::effect::{Effects, GyroEffects};
use geu_model::units::SAMPLE_INTERVAL_S;

use crate::effects::CLEARANCE_SIGMA_ARCSEC;
use crate::transfer::GyroSet;

/// Noise of the gyros and uncertainty at the start, 1 sigma.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilterNoise {
    /// White rate noise. 0.01, implied by table 1.
    pub angle_random_walk_arcsec_per_sqrt_s: f64,
    /// Walk of the drift. 8·10⁻⁶: 3.6″/h over 30 min, taken as 3 sigma of the change (Casteren §3.1, table 1).
    pub drift_random_walk_arcsec_per_s_per_sqrt_s: f64,
    /// Walk of the scale factor. 0.157: 0.002 % over 30 min (Casteren §3.2, table 1), taken as 3 sigma of the change as the
    /// drift's is, for the paper states both as bounds; 20 ppm / 3 / √1800 s. It carries the ageing of 0.004 % a month
    /// too, which is 1.3 ppm in a day where the walk reaches 46.
    pub scale_factor_random_walk_ppm_per_sqrt_s: f64,
    /// Clearance of each float, in wire order, whose motion is first subtracted from the counts, an option of the
    /// paper (Casteren §3.3: "it may be corrected for at reconstruction"); 0 subtracts nothing. At most 14″.
    pub clearance_arcsec: [f64; 4],
    /// Angle of each gyro that is off without accumulating, beside the rounding, white from fix to fix: half of
    /// [`CLEARANCE_SIGMA_ARCSEC`], for a stop is half a clearance from the middle. For a float that is not subtracted, its clearance over √12.
    pub bounded_arcsec: f64,
    /// Rounding of the accumulated angle: one count, of which 1/√12 is the sigma (Casteren §2). 0 for counts before rounding.
    pub count_arcsec: f64,
    /// Rate that a sample without counts may have had beside the mean of those before: half of a slew's 720″/s
    /// (Casteren §5.3).
    pub lost_rate_arcsec_s: f64,
    /// Attitude at the start about X, Y and Z of the control frame. X: not measured; the limit cycle amplitude is below 5″
    /// (Casteren §6). Y, Z: so large that the first fix determines them.
    pub start_attitude_control_arcsec: [f64; 3],
    /// Drift at the start: 6″/h after a fortnight (Casteren §3.1).
    pub start_drift_arcsec_per_h: f64,
    /// Scale factor at the start: 20 ppm, as good as the checkout makes it; half of a month's ageing (Casteren table 1).
    pub start_scale_factor_ppm: f64,
    /// Misalignments, which are constant: 3″, the result of a Y-scan of 60° with pivots known to 3″ (Casteren §5.3).
    pub start_misalignment_arcsec: f64,
    /// Systematic errors of the star sensor, of θ and of ψ: 3″ for a slit, 2.1″ for the mean of two.
    pub systematic_arcsec: f64,
    /// Settled turn of the package for each degree of θ: 0 to start with, uncertain by twice the "tens of arcsec" over the
    /// 60° of a Y-scan (Casteren §3.4, §5.3).
    pub thermal_arcsec_per_deg: f64,
    /// Lag of that turn: as long as a Y-scan (Casteren §5.3).
    pub thermal_time_constant_s: f64,
}

impl FilterNoise {
    /// The paper's gyros.
    pub const PAPER: FilterNoise = FilterNoise {
        angle_random_walk_arcsec_per_sqrt_s: 0.01,
        drift_random_walk_arcsec_per_s_per_sqrt_s: 8e-6,
        scale_factor_random_walk_ppm_per_sqrt_s: 0.157,
        clearance_arcsec: [14.0; 4],
        bounded_arcsec: 0.5 * CLEARANCE_SIGMA_ARCSEC,
        count_arcsec: 1.0,
        lost_rate_arcsec_s: 360.0,
        start_attitude_control_arcsec: [5.0, 60.0, 60.0],
        start_drift_arcsec_per_h: 6.0,
        start_scale_factor_ppm: 20.0,
        start_misalignment_arcsec: 3.0,
        systematic_arcsec: 2.12,
        thermal_arcsec_per_deg: 1.0,
        thermal_time_constant_s: 300.0,
    };

    /// The gyros of a configuration: [`FilterNoise::PAPER`] with the walks, the clearance, the thermal lag and the star sensor's
    /// slits as configured, the largest among the gyros in use. The scale factor walks only where an effect moves it, and
    /// the package turns only where it is said to.
    pub fn from_configuration(configuration: &Configuration, in_use: GyroSet) -> FilterNoise {
        let used = || configuration.gyros.iter().zip(in_use.gyros()).filter(|(_, used)| *used).map(|(gyro, _)| gyro);
        let largest = |number: &dyn Fn(&GyroEffects) -> f64| {
            used().map(|gyro| number(&gyro.effects.constant)).fold(0.0, f64::max)
        };
        let moves_scale_factor = used().any(|gyro| {
            let course =
                |code: &str| gyro.effects.courses.iter().any(|course| GyroEffects::SPECS[course.effect].code == code);
            let constant = &gyro.effects.constant;
            course("scale-factor")
                || constant.scale_factor_nonlinearity.cubic_ppm != 0.0
                || constant.scale_factor_asymmetry.ppm != 0.0
        });
        let thermal = configuration.unit.constant.misalignment_thermal;
        let turns = (0..configuration.unit.constant.specs().len()).any(|index| {
            configuration.unit.constant.specs()[index].code == "misalignment-thermal" && configuration.unit.has(index)
        });
        let when = |is: bool, number: f64| if is { number } else { 0.0 };
        FilterNoise {
            angle_random_walk_arcsec_per_sqrt_s: largest(&|own| own.angle_random_walk.arcsec_per_sqrt_s),
            drift_random_walk_arcsec_per_s_per_sqrt_s: largest(&|own| own.drift_random_walk.arcsec_per_s_per_sqrt_s),
            scale_factor_random_walk_ppm_per_sqrt_s: when(
                moves_scale_factor,
                FilterNoise::PAPER.scale_factor_random_walk_ppm_per_sqrt_s,
            ),
            clearance_arcsec: std::array::from_fn(|gyro| {
                configuration.gyros[gyro].effects.constant.pivot_clearance.clearance_arcsec
            }),
            bounded_arcsec: when(
                largest(&|own| own.pivot_clearance.clearance_arcsec) > 0.0,
                FilterNoise::PAPER.bounded_arcsec,
            ),
            systematic_arcsec: configuration.sensors.sse.slit_arcsec / 2f64.sqrt(),
            thermal_arcsec_per_deg: when(turns, FilterNoise::PAPER.thermal_arcsec_per_deg),
            thermal_time_constant_s: thermal.time_constant_s,
            ..FilterNoise::PAPER
        }
    }

    pub(super) fn start_drift_arcsec_per_half_s(&self) -> f64 {
        self.start_drift_arcsec_per_h / 3600.0 * SAMPLE_INTERVAL_S
    }

    /// Variance of the bounded errors: clearance and rounding.
    pub(super) fn bounded_variance_arcsec2(&self) -> f64 {
        self.bounded_arcsec.powi(2) + self.count_arcsec.powi(2) / 12.0
    }
}
