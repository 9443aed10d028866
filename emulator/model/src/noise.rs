//! Noise streams: each a function of (run seed, gyro, effect), or of (run seed, sensor), so that switching one on never
//! moves another.

use geu_protocol::Gyro;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

/// Stands in the key where a gyro would.
const NO_GYRO: u8 = u8::MAX;

/// A stream of independent standard normal numbers.
#[derive(Debug, Clone)]
pub struct Stream(ChaCha8Rng);

impl Stream {
    /// The stream of one effect of one gyro. The algorithm is fixed: ChaCha8 keyed by seed, gyro and effect code, and
    /// the ziggurat of rand_distr with transcendental functions from libm, so every host draws the same numbers.
    pub fn new(seed: u64, gyro: Gyro, code: &str) -> Stream {
        Stream::keyed(seed, gyro as u8, code)
    }

    /// The stream of an absolute sensor, or of a part of one, by name; no gyro's stream is the same.
    pub fn of_sensor(seed: u64, name: &str) -> Stream {
        Stream::keyed(seed, NO_GYRO, name)
    }

    fn keyed(seed: u64, whose: u8, name: &str) -> Stream {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8] = whose;
        key[16..24].copy_from_slice(&fnv1a(name.as_bytes()).to_le_bytes());
        Stream(ChaCha8Rng::from_seed(key))
    }

    /// The next number.
    #[inline]
    pub fn standard_normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
}

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
            let mut stream = Stream::new(seed, gyro, code);
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
        let mut sensor = Stream::of_sensor(1, "angle-random-walk");
        let first = sensor.standard_normal();
        assert_eq!(first, Stream::of_sensor(1, "angle-random-walk").standard_normal());
        assert_ne!(first, Stream::of_sensor(2, "angle-random-walk").standard_normal());
        for gyro in Gyro::ALL {
            assert_ne!(first, Stream::new(1, gyro, "angle-random-walk").standard_normal());
        }
    }

    #[test]
    fn gyros_streams_are_those_of_every_earlier_version() {
        // Drawn before sensors had streams; another number here changes every recorded run.
        let drawn = Stream::new(1, Gyro::X, "angle-random-walk").standard_normal();
        assert_eq!(drawn, -0.598_252_488_290_425_4);
    }

    #[test]
    fn the_numbers_are_standard_normal() {
        let mut stream = Stream::new(1, Gyro::Zb, "test");
        let count = 100_000;
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..count {
            let number = stream.standard_normal();
            sum += number;
            squares += number * number;
        }
        // 5 sigma of a mean and of a variance over 100 000 draws.
        assert!((sum / count as f64).abs() < 5.0 / (count as f64).sqrt());
        assert!((squares / count as f64 - 1.0).abs() < 5.0 * (2.0 / count as f64).sqrt());
    }
}
