//! Noise streams: each a function of (run seed, gyro, effect), or of (run seed, sensor), so that switching one on never
//! moves another.

pub mod flicker;
mod gauss_markov;

pub use flicker::Flicker;
pub use gauss_markov::GaussMarkov;
use geu_protocol::Gyro;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::sync::LazyLock;

/// Replaces the gyro in the key.
const NO_GYRO: u8 = u8::MAX;
const FAULT: u8 = u8::MAX - 1;

/// A stream of independent standard normal numbers.
#[derive(Debug, Clone)]
pub struct NoiseStream(ChaCha8Rng);

impl NoiseStream {
    /// The stream of one effect of one gyro. The algorithm is fixed: ChaCha8 keyed by seed, gyro and effect code, and a
    /// ziggurat on the libm crate, so every host draws the same numbers. (rand_distr's calls the host's libm wherever
    /// another crate of the program switches num-traits to std.)
    pub fn new(seed: u64, gyro: Gyro, code: &str) -> NoiseStream {
        NoiseStream::keyed(seed, gyro.index() as u8, code)
    }

    /// The stream of an absolute sensor, or of a part of one, by name; no gyro's stream is the same.
    pub fn of_sensor(seed: u64, name: &str) -> NoiseStream {
        NoiseStream::keyed(seed, NO_GYRO, name)
    }

    /// The stream of one draw of a fault: by seed, the fault's identifier, what is drawn, and which time.
    pub fn of_fault(seed: u64, id: &str, what: &str, time: u64) -> NoiseStream {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8] = FAULT;
        key[9..16].copy_from_slice(&fnv1a(what.as_bytes()).to_le_bytes()[..7]);
        key[16..24].copy_from_slice(&fnv1a(id.as_bytes()).to_le_bytes());
        key[24..].copy_from_slice(&time.to_le_bytes());
        NoiseStream(ChaCha8Rng::from_seed(key))
    }

    /// The next number, evenly from 0 up to 1.
    pub fn uniform(&mut self) -> f64 {
        unit_interval(self.0.next_u64())
    }

    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    fn keyed(seed: u64, source: u8, name: &str) -> NoiseStream {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8] = source;
        key[16..24].copy_from_slice(&fnv1a(name.as_bytes()).to_le_bytes());
        NoiseStream(ChaCha8Rng::from_seed(key))
    }

    #[inline]
    pub fn standard_normal(&mut self) -> f64 {
        let layers = &*ZIGGURAT;
        loop {
            let bits = self.0.next_u64();
            let (layer, sign_and_place) = ((bits % LAYERS as u64) as usize, 2.0 * unit_interval(bits) - 1.0);
            let x = sign_and_place * layers.edge[layer];
            if sign_and_place.abs() < layers.inside[layer] || self.is_under_curve(layer, x) {
                return x;
            }
            if layer == 0 {
                let beyond = self.tail();
                return if sign_and_place < 0.0 { -beyond } else { beyond };
            }
        }
    }

    #[cold]
    fn is_under_curve(&mut self, layer: usize, x: f64) -> bool {
        let edge = &ZIGGURAT.edge;
        if layer == 0 {
            return false;
        }
        let above = |edge: f64| libm::exp(-0.5 * (edge * edge - x * x));
        let (outer, inner) = (above(edge[layer]), above(edge[layer + 1]));
        inner + unit_interval(self.0.next_u64()) * (outer - inner) < 1.0
    }

    /// A number beyond the last layer (Marsaglia's method).
    #[cold]
    fn tail(&mut self) -> f64 {
        // Of 1 minus a number below 1, so that the logarithm is finite.
        let mut logarithm = || libm::log(1.0 - unit_interval(self.0.next_u64()));
        loop {
            let (x, y) = (-logarithm() / TAIL, -logarithm());
            if 2.0 * y > x * x {
                return TAIL + x;
            }
        }
    }
}

/// The upper 53 bits as a number from 0 up to 1.
#[inline]
fn unit_interval(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Layers of equal area under the normal curve, where the last ends, and that area (J. A. Doornik, An improved ziggurat
/// method to generate normal random samples, 2005, ZIGNOR).
const LAYERS: usize = 128;
const TAIL: f64 = 3.442_619_855_899;
const AREA: f64 = 9.912_563_035_262_17e-3;

struct Ziggurat {
    /// Right edge of each layer; the last is 0.
    edge: [f64; LAYERS + 1],
    /// Share of each layer's width that lies under the curve for certain.
    inside: [f64; LAYERS],
}

static ZIGGURAT: LazyLock<Ziggurat> = LazyLock::new(|| {
    let density = |x: f64| libm::exp(-0.5 * x * x);
    let mut edge = [0.0; LAYERS + 1];
    (edge[0], edge[1]) = (AREA / density(TAIL), TAIL);
    for layer in 2..LAYERS {
        let before = edge[layer - 1];
        edge[layer] = (-2.0 * libm::log(AREA / before + density(before))).sqrt();
    }
    let inside = std::array::from_fn(|layer| edge[layer + 1] / edge[layer]);
    Ziggurat { edge, inside }
});

/// 64-bit FNV-1a, to turn a code of any length into a part of the key.
const fn fnv1a(bytes: &[u8]) -> u64 {
    let (mut hash, mut index) = (0xcbf2_9ce4_8422_2325_u64, 0);
    while index < bytes.len() {
        hash = (hash ^ bytes[index] as u64).wrapping_mul(0x0100_0000_01b3);
        index += 1;
    }
    hash
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_is_a_function_of_seed_gyro_and_effect() {
        let draw = |seed, gyro, code| {
            let mut stream = NoiseStream::new(seed, gyro, code);
            [stream.standard_normal(), stream.standard_normal()]
        };
        let first = draw(1, Gyro::X, "angle-random-walk");
        assert_eq!(first, draw(1, Gyro::X, "angle-random-walk"));
        for other in
            [(2, Gyro::X, "angle-random-walk"), (1, Gyro::Y, "angle-random-walk"), (1, Gyro::X, "drift-random-walk")]
        {
            assert_ne!(first, draw(other.0, other.1, other.2));
        }
    }

    #[test]
    fn a_sensor_has_a_stream_of_its_own() {
        let mut sensor = NoiseStream::of_sensor(1, "angle-random-walk");
        let first = sensor.standard_normal();
        assert_eq!(first, NoiseStream::of_sensor(1, "angle-random-walk").standard_normal());
        assert_ne!(first, NoiseStream::of_sensor(2, "angle-random-walk").standard_normal());
        for gyro in Gyro::ALL {
            assert_ne!(first, NoiseStream::new(1, gyro, "angle-random-walk").standard_normal());
        }
    }

    #[test]
    fn gyros_streams_are_those_of_every_earlier_version() {
        // Drawn before sensors had streams; another number here changes every recorded run.
        let drawn = NoiseStream::new(1, Gyro::X, "angle-random-walk").standard_normal();
        assert_eq!(drawn, -0.314_922_967_245_439_5);
    }

    #[test]
    fn the_numbers_are_standard_normal() {
        let mut stream = NoiseStream::new(1, Gyro::ZB, "test");
        let count = 1_000_000;
        let numbers: Vec<f64> = (0..count).map(|_| stream.standard_normal()).collect();
        let n = f64::from(count);
        let moment = |power: i32| numbers.iter().map(|x| x.powi(power)).sum::<f64>() / n;
        // 5 sigma of the first four moments: their variances are 1, 2, 15 and 96 over the count.
        for (power, expected, variance) in [(1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)] {
            assert!((moment(power) - expected).abs() < 5.0 * (variance / n).sqrt(), "{power}: {}", moment(power));
        }
        // Shares beyond 1, 2, 3 and 4 sigma, the last in the tail behind the layers, by the error function.
        for (bound, share) in [(1.0, 0.317_310_5), (2.0, 0.045_500_26), (3.0, 0.002_699_796), (4.0, 6.334_248e-5)] {
            let beyond = numbers.iter().filter(|x| x.abs() > bound).count() as f64 / n;
            assert!((beyond - share).abs() < 5.0 * (share / n).sqrt(), "{bound}: {beyond}");
        }
        let positive = numbers.iter().filter(|&&x| x > 0.0).count() as f64 / n;
        assert!((positive - 0.5).abs() < 5.0 * 0.5 / n.sqrt());
    }
}
