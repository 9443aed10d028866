//! The kinds of manoeuvres (Casteren §5) as a scenario is configured of them.

use super::LimitCycle;
use crate::parameter_spec::{ParameterSet, numbers};
use crate::units::ORBIT_S;

/// Orbital speed about the sun vector: 360° per orbit.
const ORBITAL_ARCMIN_S: f64 = 360.0 * 60.0 / ORBIT_S;

numbers! {
    /// θ and ψ constant; sun-referenced, so not inertial (Casteren §5.1).
    pub struct Pointing {
        /// Length.
        duration_s: 600.0, 0.5..=1e9, "s";
    }
}
numbers! {
    /// Scans at the present θ, so that thermal rest and the pivots' preferred position are reached (Casteren §5.1).
    pub struct Stabilise {
        /// Turns about the sun vector.
        orbits: 1.0, 0.1..=1000.0, "";
        /// Speed about the sun vector; 360° per orbit.
        rate_arcmin_s: (ORBITAL_ARCMIN_S), 0.01..=12.0, "arcmin/s";
        /// Acceleration limit.
        acceleration_arcsec_s2: 36.0, 0.1..=1000.0, "arcsec/s²";
    }
}
numbers! {
    /// A turn about the sun vector: at θ = 90° a Z-axis scan (Casteren §5.2), at θ = 60° an X-axis scan (§5.4).
    pub struct SunScan {
        /// Angle about the sun vector.
        angle_deg: 360.0, -36000.0..=36000.0, "°";
        /// Speed about the sun vector; 360° per orbit.
        rate_arcmin_s: (ORBITAL_ARCMIN_S), 0.01..=12.0, "arcmin/s";
        /// Acceleration limit.
        acceleration_arcsec_s2: 36.0, 0.1..=1000.0, "arcsec/s²";
    }
}
numbers! {
    /// A turn about Y: ψ constant, θ to its new value (Casteren §5.3).
    pub struct YScan {
        /// θ at the end.
        to_theta_deg: required, 60.0..=120.0, "°";
        /// Speed.
        rate_arcmin_s: 12.0, 0.01..=12.0, "arcmin/s";
        /// Acceleration limit.
        acceleration_arcsec_s2: 36.0, 0.1..=1000.0, "arcsec/s²";
    }
}
numbers! {
    /// To another attitude, θ and ψ together: the longer way at the rate given, the shorter in the same time.
    pub struct Slew {
        /// θ at the end; unchanged when not given.
        to_theta_deg: absent, 60.0..=120.0, "°";
        /// ψ at the end, by the shorter way; unchanged when not given.
        to_psi_deg: absent, -360.0..=360.0, "°";
        /// Change of ψ, in place of to_psi_deg.
        by_psi_deg: absent, -36000.0..=36000.0, "°";
        /// Speed.
        rate_arcmin_s: 12.0, 0.01..=12.0, "arcmin/s";
        /// Acceleration limit.
        acceleration_arcsec_s2: 36.0, 0.1..=1000.0, "arcsec/s²";
    }
}
numbers! {
    /// Survey scans about the sun vector at constant θ, with a slew in θ after each; θ steps to and fro within limits.
    pub struct Survey {
        /// How many; 0 for ever.
        scans: 0.0, 0.0..=1e6, "";
        /// Angle about the sun vector of one scan.
        angle_deg: 30.0, 1.0..=36000.0, "°";
        /// Rate about Z, ψ' sin θ (3.85 arcmin/s).
        rate_z_arcmin_s: 3.85, 0.01..=10.0, "arcmin/s";
        /// Change of θ after each scan.
        theta_step_deg: 7.5, 0.0..=60.0, "°";
        /// Least θ.
        theta_least_deg: 60.0, 60.0..=120.0, "°";
        /// Greatest θ.
        theta_greatest_deg: 120.0, 60.0..=120.0, "°";
        /// Speed of the slews.
        slew_rate_arcmin_s: 12.0, 0.01..=12.0, "arcmin/s";
        /// Acceleration limit.
        acceleration_arcsec_s2: 36.0, 0.1..=1000.0, "arcsec/s²";
    }
}
numbers! {
    /// Scans to and fro about the sun vector, θ one step further after each.
    pub struct Raster {
        /// How many scans.
        lines: 8.0, 1.0..=10000.0, "";
        /// Angle about the sun vector of one scan.
        angle_deg: 1.0, 0.001..=360.0, "°";
        /// Rate about Z, ψ' sin θ.
        rate_z_arcmin_s: 0.5, 0.001..=10.0, "arcmin/s";
        /// Change of θ after each scan.
        theta_step_arcmin: 5.0, -3600.0..=3600.0, "arcmin";
        /// Speed of the steps.
        step_rate_arcmin_s: 0.5, 0.001..=12.0, "arcmin/s";
        /// Acceleration limit.
        acceleration_arcsec_s2: 36.0, 0.1..=1000.0, "arcsec/s²";
    }
}

numbers! {
    /// The earth's shadow: the sun sensor is blind, and observation continues with the gyros alone (Casteren §1), in which
    /// the X and Y gyros matter (§5). One scan about the sun vector, at rest at both ends, with θ held; the default rate
    /// about Z is that of a survey, with which the X input rate at θ = 60° is the paper's ±2.22 arcmin/s. The paper gives
    /// no length: 20 minutes is the longest shadow of a sun-synchronous twilight orbit, less than an orbit in any case.
    pub struct Eclipse {
        /// Length, ramps included.
        duration_s: 1200.0, 0.5..=6180.0, "s";
        /// Rate about Z, ψ' sin θ; 0 holds the attitude.
        rate_z_arcmin_s: 3.85, -10.0..=10.0, "arcmin/s";
        /// Acceleration limit.
        acceleration_arcsec_s2: 36.0, 0.1..=1000.0, "arcsec/s²";
    }
}

macro_rules! manoeuvres {
    ($($kind:literal $variant:ident($type:ident), $title:literal;)*) => {
        /// One entry of a scenario.
        #[derive(Debug, Clone, PartialEq)]
        pub enum Manoeuvre { $(#[doc = $title] $variant($type)),* }

        impl Manoeuvre {
            /// Kinds as the configuration names them, with what each is.
            pub const KINDS: &[(&str, &str)] = &[$(($kind, $title)),*];

            /// The manoeuvre of that kind with its defaults.
            pub fn of_kind(kind: &str) -> Option<Manoeuvre> {
                match kind { $($kind => Some(Manoeuvre::$variant($type::default())),)* _ => None }
            }

            /// Name of its kind in the configuration.
            pub fn kind(&self) -> &'static str {
                match self { $(Manoeuvre::$variant(_) => $kind),* }
            }

            pub fn numbers(&self) -> &dyn ParameterSet {
                match self { $(Manoeuvre::$variant(numbers) => numbers),* }
            }

            pub fn numbers_mut(&mut self) -> &mut dyn ParameterSet {
                match self { $(Manoeuvre::$variant(numbers) => numbers),* }
            }
        }
    };
}

manoeuvres! {
    "pointing" Pointing(Pointing), "theta and psi constant";
    "z-scan" ZScan(SunScan), "a turn about the sun vector at theta = 90 deg";
    "y-scan" YScan(YScan), "a turn about Y, psi constant";
    "x-scan" XScan(SunScan), "a turn about the sun vector away from theta = 90 deg, which turns about X too";
    "survey" Survey(Survey), "survey scans about the sun vector with slews between";
    "slew" Slew(Slew), "to another attitude";
    "raster" Raster(Raster), "scans to and fro, theta one step further after each";
    "eclipse" Eclipse(Eclipse), "the earth's shadow: the sun sensor is blind, scanning or holding goes on by gyros";
    "stabilise" Stabilise(Stabilise), "one orbit's scan at the present theta";
}

#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// θ at the start.
    pub theta_deg: f64,
    /// ψ at the start.
    pub psi_deg: f64,
    pub limit_cycle: LimitCycle,
    /// One after the other; a hold without end follows the last.
    pub manoeuvres: Vec<Manoeuvre>,
}
