//! The unit: four gyros that sense the motion and count it.

use Quantity::*;

use crate::injected::{PlantedEffect, Quantities, Quantity, Term};
use crate::motion::{Motion, State};
use crate::noise::Noise;
use crate::product::{Product, Surroundings};
use crate::{Calibration, GYROS, Gyro, IndependentModel, SAMPLE_INTERVAL_S, STEPS};

const PPM: f64 = 1e-6;
const ARCSEC_PER_RAD: f64 = 648_000.0 / std::f64::consts::PI;
const HOUR_S: f64 = 3600.0;

/// Below this about the output axis a float creeps (Casteren §3.3).
const CREEP_BELOW_ARCSEC_S: f64 = 1.5;
const CREEP_ARCSEC_S: f64 = 0.015;
/// Share of ω_out, above it.
const FLOAT_SPEED: f64 = 0.01;
const THERMAL_TIME_S: f64 = 300.0;
const REFERENCE_C: f64 = 20.0;
const SENSOR_C: f64 = 70.0;
const SENSOR_TIME_S: f64 = 1200.0;
const ORBIT_S: f64 = 6180.0;
/// Full scale of the quadratic and the cubic term.
const FULL_SCALE_ARCSEC_S: f64 = 720.0;
/// Play of the hysteresis, K.
const HYSTERESIS_WIDTH_K: f64 = 0.2;
/// Processes of the flicker: two a decade from 1 s to 10⁵ s, and a half beyond.
const FLICKER_PROCESSES: usize = 12;
/// Rates within a step that a dead zone is applied to.
const ZONE_POINTS: usize = 16;

/// The reference unit: SF, D and misalignments about X, Y and Z.
pub const REFERENCE_UNIT: [(f64, f64, [f64; 3]); 4] = [
    (1.00120, 0.2100, [0.0, 45.0, -30.0]),
    (0.99870, -0.1350, [20.0, 0.0, 62.0]),
    (1.00050, 0.0820, [-38.0, 15.0, 0.0]),
    (0.99920, -0.3050, [27.0, -51.0, 0.0]),
];
const ANGLE_RANDOM_WALK: f64 = 0.01;
const DRIFT_RANDOM_WALK: f64 = 8e-6;

/// Errors of a two-week-old calibration, 1σ.
const SCALE_FACTOR_SIGMA: f64 = 6.0 * PPM;
const DRIFT_SIGMA_ARCSEC_S: f64 = 1.2 / HOUR_S;
const MISALIGNMENT_SIGMA_ARCSEC: f64 = 1.5;

/// A sample's end.
pub struct Sample {
    /// True time.
    pub length_s: f64,
    pub counts: [i16; 4],
    /// A bit for each gyro.
    pub saturated: u8,
    pub electronics_c: f64,
    pub sensor_c: f64,
}

pub struct Unit {
    pub calibrations: [Calibration; 4],
    terms: Vec<Term>,
    /// End of the motion in the counts so far.
    reported_s: Option<f64>,
    /// Rates of the step before, once there is motion.
    rates: Option<[f64; 3]>,
    channels: [Channel; 4],
    /// Angle of the package about Y, once there is motion.
    thermal_arcsec: Option<f64>,
    /// Swing and phase.
    electronics: (f64, f64),
    heater_off_s: f64,
    sensor_c: f64,
}

/// Deviation and correlation time of each process of a flicker of 1: their spectra add up to 1/(πf), one-sided.
fn flicker() -> impl Iterator<Item = (f64, f64)> {
    let sigma = (10f64.ln() / 2.0 / std::f64::consts::PI).sqrt();
    (0..FLICKER_PROCESSES).map(move |index| (sigma, libm::pow(10.0, index as f64 / 2.0 - 0.25)))
}

/// State of one gyro.
struct Channel {
    products: Vec<Product>,
    noise: Noise,
    /// Not yet sensed.
    white_arcsec: f64,
    drift_walk_arcsec_s: f64,
    /// Noise of effects that the reference unit does not have.
    further_noise: Noise,
    /// Relative, over this sample interval.
    scale_factor_error: f64,
    flicker: [f64; FLICKER_PROCESSES],
    /// The sensed rate, once it lags.
    lagging_arcsec_s: Option<f64>,
    rate_before_zone: Option<f64>,
    /// Electronics temperature in the middle of the play.
    play_c: Option<f64>,
    /// The float's angle, once it rests.
    float_arcsec: Option<f64>,
    output_rate: Option<f64>,
    /// Counts, with the fraction; and as they follow it.
    accumulated: f64,
    followed: f64,
    rounded: f64,
    last: i64,
    lost: bool,
}

impl Unit {
    pub fn new(model: &IndependentModel) -> Unit {
        let mut random = Noise::new(model.seed, 2);
        let calibrations = REFERENCE_UNIT.map(|(scale_factor, drift, misalignment)| Calibration {
            scale_factor: scale_factor * (1.0 + SCALE_FACTOR_SIGMA * random.normal()),
            drift_arcsec_per_half_s: drift + SAMPLE_INTERVAL_S * DRIFT_SIGMA_ARCSEC_S * random.normal(),
            misalignment_arcsec: misalignment.map(|angle| match angle {
                0.0 => 0.0,
                angle => angle + MISALIGNMENT_SIGMA_ARCSEC * random.normal(),
            }),
        });
        let mut terms: Vec<Term> = model.effects.iter().flat_map(PlantedEffect::terms).collect();
        // An injected noise replaces the unit's own.
        for (code, parameter, value) in [
            ("angle-random-walk", "arcsec_per_sqrt_s", ANGLE_RANDOM_WALK),
            ("drift-random-walk", "arcsec_per_s_per_sqrt_s", DRIFT_RANDOM_WALK),
        ] {
            let injected: Vec<&PlantedEffect> = model.effects.iter().filter(|effect| effect.code == code).collect();
            for gyro in GYROS {
                if !injected.iter().any(|effect| effect.gyros.is_empty() || effect.gyros.contains(&gyro)) {
                    terms.extend(PlantedEffect::new(code, &[gyro], &[(parameter, value)]).terms());
                }
            }
        }
        Unit {
            calibrations,
            terms,
            reported_s: None,
            rates: None,
            channels: GYROS.map(|gyro| Channel {
                products: model.effects.iter().filter_map(|effect| effect.product(gyro)).collect(),
                noise: Noise::new(model.seed, 3 + gyro as u64),
                white_arcsec: 0.0,
                drift_walk_arcsec_s: 0.0,
                further_noise: Noise::new(model.seed, 7 + gyro as u64),
                scale_factor_error: 0.0,
                flicker: [0.0; FLICKER_PROCESSES],
                lagging_arcsec_s: None,
                rate_before_zone: None,
                play_c: None,
                float_arcsec: None,
                output_rate: None,
                accumulated: 0.0,
                followed: 0.0,
                rounded: 0.0,
                last: 0,
                lost: false,
            }),
            thermal_arcsec: None,
            electronics: (random.uniform(1.0, 2.5), random.uniform(0.0, std::f64::consts::TAU)),
            heater_off_s: model.heater_off_s.unwrap_or(f64::INFINITY),
            sensor_c: SENSOR_C,
        }
    }

    /// Counts through the sample that starts at `start_s`.
    pub fn sample(&mut self, motion: &Motion, start_s: f64) -> Sample {
        let at_start = self.quantities(start_s);
        let of_unit = at_start[0];
        let fast = of_unit.get(ClockFrequency) * PPM;
        let length_s = SAMPLE_INTERVAL_S / (1.0 + fast);
        let step_s = length_s / STEPS as f64;
        // Counts at t report the motion of t − offset: a longer or shorter interval of it while the offset changes.
        let end_s = start_s + length_s;
        let to_s = end_s - self.quantities(end_s)[0].get(TimeOffset);
        let from_s = self.reported_s.replace(to_s).unwrap_or(start_s - of_unit.get(TimeOffset));
        let moved_s = (to_s - from_s) / STEPS as f64;
        for (channel, own) in self.channels.iter_mut().zip(&at_start) {
            channel.walk(own, length_s);
            channel.walk_further(own, length_s, start_s == 0.0);
        }
        for step in 0..STEPS {
            let t = start_s + (step as f64 + 0.5) * step_s;
            let quantities = self.quantities(t);
            let electronics_c = self.electronics_c(t);
            let state = motion.at(from_s + (step as f64 + 0.5) * moved_s);
            let before = self.rates.replace(state.rates).unwrap_or(state.rates);
            let surroundings = Surroundings {
                accelerations: std::array::from_fn(|axis| (state.rates[axis] - before[axis]) / moved_s),
                electronics_k: electronics_c - REFERENCE_C,
                state: &state,
                t,
            };
            let (thermal, thermal_turn) = self.thermal(&quantities[0], &state, moved_s);
            for gyro in GYROS {
                let turning = if gyro == Gyro::Y { thermal_turn } else { 0.0 };
                let mut row = self.calibrations[gyro as usize].misalignment_arcsec;
                let own = &quantities[gyro as usize];
                for (element, part) in row.iter_mut().zip([MisalignmentX, MisalignmentY, MisalignmentZ]) {
                    *element += own.get(part);
                }
                match gyro {
                    Gyro::X => row[2] -= thermal,
                    Gyro::Y => {}
                    Gyro::Za | Gyro::Zb => row[0] += thermal,
                }
                let calibration = self.calibrations[gyro as usize];
                let channel = &mut self.channels[gyro as usize];
                let drift = calibration.drift_arcsec_per_half_s / SAMPLE_INTERVAL_S
                    + own.get(Drift) / HOUR_S
                    + own.get(DriftSensorTemperature) / HOUR_S * (self.sensor_c - SENSOR_C)
                    + own.get(Hysteresis) / HOUR_S * channel.direction(own, electronics_c)
                    + own.get(BiasInstability) / HOUR_S * channel.flicker.iter().sum::<f64>();
                let added: f64 = channel.products.iter().map(|product| product.rate(&surroundings)).sum();
                let (sensed, input) = channel.sense(gyro, row, own, &state.rates, moved_s);
                // Casteren §3.2: per on-board sample interval, in all.
                let drift = drift * SAMPLE_INTERVAL_S * (1.0 - 2.0 * fast) / length_s
                    + channel.drift_walk_arcsec_s
                    + own.get(RateDrift) * PPM * state.rates[2].abs();
                let mut scale_factor = calibration.scale_factor * (1.0 + own.get(ScaleFactor) * PPM) * (1.0 - fast);
                if input > 0.0 {
                    scale_factor *= 1.0 + own.get(Asymmetry) * PPM;
                }
                channel.accumulated += (sensed + turning + (added - drift) * step_s) / scale_factor;
            }
        }
        let electronics_c = self.electronics_c(end_s);
        if start_s >= self.heater_off_s {
            self.sensor_c += (electronics_c - self.sensor_c) * (1.0 - libm::exp(-SAMPLE_INTERVAL_S / SENSOR_TIME_S));
        }
        let (counts, saturated) = self.count(end_s);
        Sample { length_s, counts, saturated, electronics_c, sensor_c: self.sensor_c }
    }

    fn electronics_c(&self, t: f64) -> f64 {
        let (swing, phase) = self.electronics;
        REFERENCE_C + swing * libm::sin(std::f64::consts::TAU * t / ORBIT_S + phase)
    }

    fn electronics_k_per_h(&self, t: f64) -> f64 {
        let (swing, phase) = self.electronics;
        let frequency = std::f64::consts::TAU / ORBIT_S;
        HOUR_S * swing * frequency * libm::cos(frequency * t + phase)
    }

    fn quantities(&self, t: f64) -> [Quantities; 4] {
        let mut quantities = [Quantities::ABSENT; 4];
        let (electronics_k, electronics_k_per_h) = (self.electronics_c(t) - REFERENCE_C, self.electronics_k_per_h(t));
        for term in &self.terms {
            quantities[term.gyro as usize].add(term.quantity, term.at(t, electronics_k, electronics_k_per_h));
        }
        quantities
    }

    /// The package's turn about Y, arcsec, and how far it turned in this step.
    fn thermal(&mut self, of_unit: &Quantities, state: &State, step_s: f64) -> (f64, f64) {
        let settled = of_unit.get(MisalignmentThermal) * state.sun_deg.map_or(0.0, |(theta_deg, _)| theta_deg - 90.0);
        let time_s = Some(of_unit.get(ThermalTime)).filter(|time_s| *time_s > 0.0).unwrap_or(THERMAL_TIME_S);
        let before = self.thermal_arcsec.unwrap_or(settled);
        let turned = (settled - before) * (1.0 - libm::exp(-step_s / time_s));
        self.thermal_arcsec = Some(before + turned);
        (before + turned, turned)
    }

    /// Rounds once, then applies link and wiring faults.
    fn count(&mut self, end_s: f64) -> ([i16; 4], u8) {
        let quantities = self.quantities(end_s - SAMPLE_INTERVAL_S / 2.0);
        let mut increments =
            GYROS.map(|gyro| self.channels[gyro as usize].increment(&quantities[gyro as usize], end_s));
        let swapped: Vec<usize> = (0..4).filter(|gyro| quantities[*gyro].get(AxisSwap) != 0.0).collect();
        if let [one, other] = swapped[..] {
            increments.swap(one, other);
        }
        let mut saturated = 0;
        for (gyro, channel) in self.channels.iter_mut().enumerate() {
            if quantities[gyro].get(StuckOutput) != 0.0 {
                increments[gyro] = channel.last;
            }
            channel.last = increments[gyro];
            saturated |= u8::from(i16::try_from(increments[gyro]).is_err()) << gyro;
        }
        (increments.map(|count| count.clamp(i16::MIN.into(), i16::MAX.into()) as i16), saturated)
    }
}

/// Mean of a rate over a step without its part in a dead zone; it changes evenly about its mean. Whole steps in or out of the zone would
/// make a random walk of the limit cycle, which passes the limits of a zone thousands of times an hour.
fn outside_zone(zone: f64, mean: f64, change: f64) -> f64 {
    if zone == 0.0 {
        return mean;
    }
    let rates = (0..ZONE_POINTS).map(|point| mean + change * ((point as f64 + 0.5) / ZONE_POINTS as f64 - 0.5));
    rates.filter(|rate| rate.abs() >= zone).sum::<f64>() / ZONE_POINTS as f64
}

impl Channel {
    /// The noises of a sample: the deviation of their increments grows with the root of time.
    fn walk(&mut self, own: &Quantities, length_s: f64) {
        let root = length_s.sqrt();
        self.white_arcsec = own.get(AngleRandomWalk) * root * self.noise.normal();
        if own.get(CorrelationTime) > 0.0 {
            self.drift_walk_arcsec_s *= libm::exp(-length_s / own.get(CorrelationTime));
        }
        self.drift_walk_arcsec_s += own.get(DriftRandomWalk) * root * self.noise.normal();
    }

    /// The noises of a sample that the reference unit does not have; the flicker starts in its stationary state.
    fn walk_further(&mut self, own: &Quantities, length_s: f64, is_first: bool) {
        self.scale_factor_error = own.get(ScaleFactorNoise) * PPM / length_s.sqrt() * self.further_noise.normal();
        for (process, (sigma, time_s)) in self.flicker.iter_mut().zip(flicker()) {
            let kept = if is_first { 0.0 } else { libm::exp(-length_s / time_s) };
            *process = kept * *process + sigma * (1.0 - kept * kept).sqrt() * self.further_noise.normal();
        }
    }

    /// Position in the play, from −1 at its cold end to 1 at the warm one, to which a rising temperature pushes.
    fn direction(&mut self, own: &Quantities, electronics_c: f64) -> f64 {
        let half = 0.5 * Some(own.get(HysteresisWidth)).filter(|width| *width > 0.0).unwrap_or(HYSTERESIS_WIDTH_K);
        let middle = self.play_c.unwrap_or(electronics_c).clamp(electronics_c - half, electronics_c + half);
        self.play_c = Some(middle);
        (electronics_c - middle) / half
    }

    /// The sensed rate about the input axis: it lags, and is 0 in the dead zone.
    fn sensed_rate(&mut self, own: &Quantities, input: f64, step_s: f64) -> f64 {
        // From y' = (ω − y)/T: the sensed angle is the angle less T times what y gains.
        let before = self.lagging_arcsec_s.unwrap_or(input);
        let lag_s = own.get(SensorLag);
        let after = if lag_s > 0.0 { input + (before - input) * libm::exp(-step_s / lag_s) } else { input };
        self.lagging_arcsec_s = Some(after);
        let lagged = if lag_s > 0.0 { input - lag_s * (after - before) / step_s } else { input };
        let change = lagged - self.rate_before_zone.replace(lagged).unwrap_or(lagged);
        outside_zone(own.get(DeadZone), lagged, change)
    }

    /// The angle sensed in a step, and the rate about the input axis.
    fn sense(&mut self, gyro: Gyro, row: [f64; 3], own: &Quantities, rates: &[f64; 3], step_s: f64) -> (f64, f64) {
        let [x, y, z] = *rates;
        // Casteren §2, figure 5
        let (about_own, output, spin) = match gyro {
            Gyro::X => (x, y, z),
            Gyro::Y => (y, x, -z),
            Gyro::Za => (z, y, -x),
            Gyro::Zb => (z, x, y),
        };
        let off_axis: f64 = row.iter().zip(rates).map(|(element, rate)| element / ARCSEC_PER_RAD * rate).sum();
        let input = about_own + off_axis;
        let share = input / FULL_SCALE_ARCSEC_S;
        let rate = self.sensed_rate(own, input, step_s)
            - own.get(Nonlinearity) * PPM * FULL_SCALE_ARCSEC_S * share.powi(3)
            - own.get(Quadratic) * PPM * FULL_SCALE_ARCSEC_S * share.powi(2)
            + self.scale_factor_error * input.abs()
            + own.get(Anisoinertia) * input * spin / ARCSEC_PER_RAD
            + own.get(RateSquared) * y * y
            + own.get(RateProduct) * x * z;
        let accelerated = output - self.output_rate.replace(output).unwrap_or(output);
        let sensed = rate * step_s
            + own.get(OutputAxisAcceleration) * accelerated
            + self.float(own, output, step_s)
            + std::mem::take(&mut self.white_arcsec);
        (sensed, input)
    }

    /// Motion of the float across its pivots (Casteren §3.3).
    fn float(&mut self, own: &Quantities, output: f64, step_s: f64) -> f64 {
        let stop = own.get(PivotClearance).max(0.0) / 2.0;
        let preferred = own.get(PivotPreferred).clamp(-stop, stop);
        let before = self.float_arcsec.unwrap_or(preferred);
        let creep = CREEP_ARCSEC_S * step_s.abs();
        let moved = if output.abs() >= CREEP_BELOW_ARCSEC_S {
            FLOAT_SPEED * output * step_s
        } else {
            (preferred - before).clamp(-creep, creep)
        };
        let after = (before + moved).clamp(-stop, stop);
        self.float_arcsec = Some(after);
        after - before
    }

    /// Counts since the last one.
    fn increment(&mut self, own: &Quantities, end_s: f64) -> i64 {
        if end_s >= own.get(LostCountsTime) && !std::mem::replace(&mut self.lost, true) {
            self.accumulated += own.get(LostCounts);
        }
        let play = own.get(Backlash) / 2.0;
        self.followed = self.followed.clamp(self.accumulated - play, self.accumulated + play);
        // f64::round: half away from zero
        let rounded = self.followed.round();
        let increment = (rounded - std::mem::replace(&mut self.rounded, rounded)) as i64;
        if own.get(SignInversion) != 0.0 { -increment } else { increment }
    }
}
