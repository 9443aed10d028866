//! Recordings of a campaign: an effect with its size, head, motion and reference from a seed.

use super::DevicePlant;
use super::effect::DeviceEffect;
use super::motion::DeviceMotionKind;
use super::reference::DeviceReference;
use super::unit::{ARCSEC_PER_DEG, DeviceUnit, Wire};
use crate::noise::Noise;

/// Stream of the draws, after the plant's.
const STREAM: u64 = 80;

/// Set of effects that a campaign takes in turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mix {
    /// Twenty: four bias steps, four without an effect, two of each other.
    Effects,
    /// Wiring, link and large errors.
    Exact,
}

impl Mix {
    /// Codes in turn; empty for none.
    fn codes(self) -> &'static [&'static str] {
        match self {
            Mix::Effects => &[
                "drift-step",
                "",
                "scale-factor",
                "scale-factor-asymmetry",
                "misalignment",
                "drift-temperature",
                "clock-frequency",
                "time-offset",
                "drift-step",
                "",
                "drift-step",
                "",
                "scale-factor",
                "scale-factor-asymmetry",
                "misalignment",
                "drift-temperature",
                "clock-frequency",
                "time-offset",
                "drift-step",
                "",
            ],
            Mix::Exact => &[
                "axis-swap",
                "sign-inversion",
                "stuck-output",
                "dead-output",
                "unit-factor",
                "lost-samples",
                "clipping",
                "misalignment-large",
                "sensor-lag",
                "scale-factor-step",
            ],
        }
    }
}

/// A recording of a campaign.
#[derive(Debug, Clone)]
pub struct Case {
    /// Code of the effect, `null` without one.
    pub code: String,
    /// Unit, motion and effect.
    pub plant: DevicePlant,
}

/// Smallest and largest sizes of the effects of a unit, which a recording of this length shows clearly.
struct Sizes {
    duration_s: f64,
    rows_hz: f64,
    sigma_arcsec: f64,
    drift_step_deg_h: [f64; 2],
    scale_ppm: [f64; 2],
    asymmetry_ppm: [f64; 2],
    misalignment_arcsec: [f64; 2],
    drift_deg_h_k: [f64; 2],
    clock_ppm: [f64; 2],
}

impl Sizes {
    fn new(unit: &DeviceUnit) -> Sizes {
        match unit.wire {
            Wire::Stim300 => Sizes {
                duration_s: 1200.0,
                rows_hz: 100.0,
                sigma_arcsec: 5.0,
                drift_step_deg_h: [8.0, 25.0],
                scale_ppm: [2000.0, 5000.0],
                asymmetry_ppm: [600.0, 2000.0],
                misalignment_arcsec: [400.0, 1200.0],
                drift_deg_h_k: [2.0, 6.0],
                clock_ppm: [100.0, 400.0],
            },
            Wire::Tetrad => Sizes {
                duration_s: 2400.0,
                rows_hz: 20.0,
                sigma_arcsec: 0.5,
                drift_step_deg_h: [0.1, 0.5],
                scale_ppm: [150.0, 500.0],
                asymmetry_ppm: [100.0, 300.0],
                misalignment_arcsec: [60.0, 200.0],
                drift_deg_h_k: [0.1, 0.4],
                clock_ppm: [20.0, 100.0],
            },
            Wire::Mm510 => Sizes {
                duration_s: 1800.0,
                rows_hz: 100.0,
                sigma_arcsec: 10.0,
                drift_step_deg_h: [80.0, 300.0],
                scale_ppm: [3000.0, 8000.0],
                asymmetry_ppm: [1500.0, 4500.0],
                misalignment_arcsec: [1000.0, 3500.0],
                drift_deg_h_k: [20.0, 80.0],
                clock_ppm: [150.0, 600.0],
            },
        }
    }

    /// An effect of a code, drawn within the sizes; the heads are drawn in any case.
    fn effect(&self, code: &str, unit: &DeviceUnit, random: &mut Noise) -> Option<DeviceEffect> {
        let heads: Vec<usize> = (0..unit.heads.len()).collect();
        let head = random.one_of(&heads);
        let sign = random.one_of(&[-1.0, 1.0]);
        let time_s = self.duration_s * random.uniform(0.35, 0.65);
        let mut within = |[min, max]: [f64; 2]| random.uniform(min, max);
        let (duration_s, azimuth) = (within([60.0, 200.0]), ("azimuth_deg", within([0.0, 360.0])));
        let own: &[usize] = &[head];
        let (heads, parameters): (&[usize], Vec<(&str, f64)>) = match code {
            "drift-step" => {
                let size = sign * ARCSEC_PER_DEG * within(self.drift_step_deg_h);
                (own, vec![("arcsec_per_h", size), ("time_s", time_s)])
            }
            "scale-factor" => (own, vec![("ppm", sign * within(self.scale_ppm))]),
            "scale-factor-step" => (own, vec![("ppm", sign * within(self.scale_ppm)), ("time_s", time_s)]),
            "scale-factor-asymmetry" => (own, vec![("ppm", sign * within(self.asymmetry_ppm))]),
            "misalignment" => (own, vec![("arcsec", within(self.misalignment_arcsec)), azimuth]),
            "misalignment-large" => (own, vec![("arcsec", ARCSEC_PER_DEG * within([5.0, 20.0])), azimuth]),
            "drift-temperature" => {
                (own, vec![("arcsec_per_h_per_k", sign * ARCSEC_PER_DEG * within(self.drift_deg_h_k))])
            }
            "clock-frequency" => (&[], vec![("ppm", sign * within(self.clock_ppm))]),
            "time-offset" => (&[], vec![("seconds", within([0.02, 0.06]))]),
            "sensor-lag" => (own, vec![("time_constant_s", within([0.03, 0.08]))]),
            "stuck-output" | "dead-output" => (own, vec![("time_s", time_s), ("duration_s", duration_s)]),
            "sign-inversion" => (own, vec![("on", 1.0)]),
            "axis-swap" => (&[head, (head + 1) % unit.heads.len()], vec![("on", 1.0)]),
            // Radians in place of degrees.
            "unit-factor" => (&[], vec![("factor", 1f64.to_radians())]),
            "clipping" => (own, vec![("arcsec_s", 0.4 * unit.table_deg_s * ARCSEC_PER_DEG)]),
            "lost-samples" => (&[], vec![("share", 0.05)]),
            _ => return None,
        };
        let code = if code == "misalignment-large" { "misalignment" } else { code };
        Some(DeviceEffect::new(code, heads, &parameters).expect("a known effect"))
    }
}

impl Case {
    /// The recording of a run of a campaign. Of `motion` and `duration_s`, what is not given is drawn or the unit's own.
    pub fn drawn(
        unit: &DeviceUnit,
        mix: Mix,
        seed: u64,
        run: u64,
        motion: Option<DeviceMotionKind>,
        duration_s: Option<f64>,
    ) -> Case {
        let codes = mix.codes();
        let code = codes[run as usize % codes.len()];
        // Other errors for each unit.
        let seed = (seed * 3 + unit.wire as u64) * 1000 + run;
        let mut random = Noise::new(seed, STREAM);
        let sizes = Sizes::new(unit);
        let sizes = Sizes { duration_s: duration_s.unwrap_or(sizes.duration_s), ..sizes };
        use DeviceMotionKind::*;
        let drawn = random.one_of(&[Table, Table, Vehicle, Hand]);
        let is_clipped = code == "clipping";
        let motion = motion.unwrap_or(if is_clipped { Table } else { drawn });
        let effect = sizes.effect(code, unit, &mut random);
        let reference = Case::reference(unit, motion, random.one_of(&[true, false]));
        let plant = DevicePlant {
            unit: unit.clone(),
            seed,
            duration_s: sizes.duration_s,
            start_unix_s: 1_795_000_000,
            motion,
            reference,
            effects: effect.into_iter().collect(),
        };
        Case { code: if code.is_empty() { "null" } else { code }.to_owned(), plant }
    }

    /// Rates of a table's encoders; quaternions of other motions, of a hand at 100 Hz.
    pub fn reference(unit: &DeviceUnit, motion: DeviceMotionKind, has_sigma: bool) -> DeviceReference {
        let sizes = Sizes::new(unit);
        DeviceReference {
            is_attitude: motion != DeviceMotionKind::Table,
            rows_hz: if motion == DeviceMotionKind::Hand { 100.0 } else { sizes.rows_hz },
            sigma_arcsec: sizes.sigma_arcsec,
            has_sigma,
            gaps_s: vec![],
            has_temperature: !unit.reports_temperature(),
        }
    }
}
