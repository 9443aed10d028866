//! Described units: geometry, words, and errors at the sizes of their data sheets (docs/devices).

/// Arcsec of a degree.
pub const ARCSEC_PER_DEG: f64 = 3600.0;
/// Arcsec of a milliradian.
const ARCSEC_PER_MRAD: f64 = 206.264_806;

/// Number that a unit sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Output {
    /// Change of the rounded angle.
    Increment,
    /// Mean rate of the sample.
    Rate,
}

/// Encoding of the link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// Datagram 94 of a STIM300.
    Stim300,
    /// Frame of the skewed tetrad.
    Tetrad,
    /// CAN messages TX1 and TX2, as `candump -l` writes them.
    Mm510,
}

/// A unit with its errors, 1 sigma.
#[derive(Debug, Clone)]
pub struct DeviceUnit {
    /// Name of the description.
    pub name: &'static str,
    /// Name and input axis of each head; the axis need not have length 1.
    pub heads: Vec<(&'static str, [f64; 3])>,
    /// Sample interval by the unit's clock.
    pub interval_s: f64,
    /// Rate or increment.
    pub output: Output,
    /// Size of a count, arcsec or arcsec/s; 0 for numbers that are not rounded.
    pub count: f64,
    /// Clipped beyond it.
    pub range_arcsec_s: f64,
    /// Encoding.
    pub wire: Wire,
    /// Scale-factor error.
    pub scale_factor_ppm: f64,
    /// Bias after switch-on.
    pub bias_arcsec_h: f64,
    /// About each of two axes.
    pub misalignment_arcsec: f64,
    /// White rate noise.
    pub angle_random_walk_arcsec_sqrt_s: f64,
    /// Flicker of the bias: its Allan deviation is 0.664 of this.
    pub bias_instability_arcsec_h: f64,
    /// Random walk of the bias.
    pub rate_random_walk_arcsec_s_sqrt_s: f64,
    /// Temperature at the start; effects of temperature are 0 at it.
    pub start_c: f64,
    /// Rise after switch-on with its time constant, and amplitude and period of the surroundings.
    pub temperature: [f64; 4],
    /// Largest rate of a table.
    pub table_deg_s: f64,
    /// Largest rate of a vehicle.
    pub slew_deg_s: f64,
    /// Largest rate of a hand.
    pub hand_deg_s: f64,
}

impl DeviceUnit {
    /// Every unit.
    pub fn all() -> [DeviceUnit; 3] {
        [DeviceUnit::stim300(), DeviceUnit::tetrad(), DeviceUnit::mm510()]
    }

    /// Three MEMS gyros at 2000 Hz: 0.15 deg/√h and 0.3 deg/h of the data sheet.
    pub fn stim300() -> DeviceUnit {
        DeviceUnit {
            name: "stim300",
            heads: vec![("X", [1.0, 0.0, 0.0]), ("Y", [0.0, 1.0, 0.0]), ("Z", [0.0, 0.0, 1.0])],
            interval_s: 0.0005,
            output: Output::Rate,
            count: ARCSEC_PER_DEG / 16384.0,
            range_arcsec_s: 400.0 * ARCSEC_PER_DEG,
            wire: Wire::Stim300,
            scale_factor_ppm: 500.0,
            bias_arcsec_h: 60.0 * ARCSEC_PER_DEG,
            misalignment_arcsec: 0.5 * ARCSEC_PER_MRAD,
            angle_random_walk_arcsec_sqrt_s: 0.15 * ARCSEC_PER_DEG / 60.0,
            bias_instability_arcsec_h: 0.3 * ARCSEC_PER_DEG,
            rate_random_walk_arcsec_s_sqrt_s: 0.0,
            start_c: 25.0,
            temperature: [12.0, 400.0, 1.5, 700.0],
            table_deg_s: 150.0,
            slew_deg_s: 25.0,
            hand_deg_s: 60.0,
        }
    }

    /// Four fibre-optic gyros at 100 Hz: 0.005 deg/√h.
    pub fn tetrad() -> DeviceUnit {
        DeviceUnit {
            name: "tetrad",
            heads: vec![
                ("A", [1.0, 1.0, 1.0]),
                ("B", [1.0, -1.0, -1.0]),
                ("C", [-1.0, 1.0, -1.0]),
                ("D", [-1.0, -1.0, 1.0]),
            ],
            interval_s: 0.01,
            output: Output::Increment,
            count: 0.01,
            range_arcsec_s: 10.0 * ARCSEC_PER_DEG,
            wire: Wire::Tetrad,
            scale_factor_ppm: 30.0,
            bias_arcsec_h: 0.3 * ARCSEC_PER_DEG,
            misalignment_arcsec: 10.0,
            angle_random_walk_arcsec_sqrt_s: 0.005 * ARCSEC_PER_DEG / 60.0,
            bias_instability_arcsec_h: 0.003 * ARCSEC_PER_DEG,
            rate_random_walk_arcsec_s_sqrt_s: 1e-5,
            start_c: 20.0,
            temperature: [4.0, 1200.0, 1.0, 1500.0],
            table_deg_s: 6.0,
            slew_deg_s: 1.0,
            hand_deg_s: 3.0,
        }
    }

    /// A yaw and a roll rate at 100 Hz. Its data sheet gives neither noise nor bias: 0.2 deg/s rms is taken.
    pub fn mm510() -> DeviceUnit {
        DeviceUnit {
            name: "mm5.10",
            heads: vec![("Z", [0.0, 0.0, 1.0]), ("X", [1.0, 0.0, 0.0])],
            interval_s: 0.01,
            output: Output::Rate,
            count: 0.005 * ARCSEC_PER_DEG,
            range_arcsec_s: 160.0 * ARCSEC_PER_DEG,
            wire: Wire::Mm510,
            scale_factor_ppm: 500.0,
            bias_arcsec_h: 100.0 * ARCSEC_PER_DEG,
            misalignment_arcsec: 0.5 * ARCSEC_PER_MRAD,
            // White at 100 Hz: rms × √0.01 s.
            angle_random_walk_arcsec_sqrt_s: 0.2 * ARCSEC_PER_DEG * 0.1,
            bias_instability_arcsec_h: 5.0 * ARCSEC_PER_DEG,
            rate_random_walk_arcsec_s_sqrt_s: 0.0,
            start_c: 25.0,
            temperature: [10.0, 500.0, 1.5, 900.0],
            table_deg_s: 100.0,
            slew_deg_s: 25.0,
            hand_deg_s: 60.0,
        }
    }

    /// Temperature of the gyros.
    pub fn temperature_c(&self, t: f64) -> f64 {
        let [rise_k, time_s, swing_k, period_s] = self.temperature;
        let swing = swing_k * libm::sin(std::f64::consts::TAU * t / period_s);
        self.start_c + rise_k * (1.0 - libm::exp(-t.max(0.0) / time_s)) + swing
    }

    /// True if the link carries a temperature.
    pub fn reports_temperature(&self) -> bool {
        self.wire != Wire::Mm510
    }

    /// Largest number of a rate.
    pub(super) fn limit(&self, rate_arcsec_s: f64) -> f64 {
        let own = match self.output {
            Output::Increment => rate_arcsec_s * self.interval_s,
            Output::Rate => rate_arcsec_s,
        };
        if self.count == 0.0 { own } else { (own / self.count).floor() }
    }

    /// Index of a head.
    pub fn head(&self, name: &str) -> Option<usize> {
        self.heads.iter().position(|(own, _)| *own == name)
    }
}
