//! Random numbers: one seed, a stream for each use.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub struct Noise(ChaCha8Rng);

impl Noise {
    pub fn new(seed: u64, stream: u64) -> Noise {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(stream);
        Noise(random)
    }

    pub fn uniform(&mut self, min: f64, max: f64) -> f64 {
        min + (max - min) * self.0.random::<f64>()
    }

    pub fn one_of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.0.random_range(0..choices.len())]
    }

    /// Mean 0, variance 1 (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * libm::log(1.0 - self.0.random::<f64>())).sqrt();
        radius * libm::cos(self.uniform(0.0, std::f64::consts::TAU))
    }
}
