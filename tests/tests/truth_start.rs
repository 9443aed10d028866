//! The dead time between a simulator's time and the unit's data, at a pace of its own: what the configuration says, no more.

use std::io::Read;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use geu_tests::simulator::{PATIENCE, Simulated, about_x};

/// From the first sample to the first byte of the first sample.
fn first_after(delay_s: &str) -> Duration {
    let set = format!("truth.start_delay_s={delay_s}");
    let simulated = Simulated::start(&["--wait", "--set", &set, "--duration", "1"]);
    let mut link = TcpStream::connect(&simulated.link).expect("a link");
    link.set_read_timeout(Some(PATIENCE)).expect("a socket");
    // The unit no longer waits for its client when the sample arrives.
    std::thread::sleep(Duration::from_millis(300));
    let start = Instant::now();
    simulated.send(&(about_x(0.0, 0.0) + &about_x(5.0, 0.0)));
    link.read_exact(&mut [0; 28]).expect("a sample");
    let after = start.elapsed();
    assert_eq!(simulated.end().0, Some(0));
    after
}

#[test]
fn the_first_sample_ends_its_length_and_the_start_delay_after_the_first_sample() {
    // Never before, and not much after: the second on top is for a loaded machine.
    for (delay_s, expected_s) in [("0", 0.5), ("2.0", 2.5)] {
        let took_s = first_after(delay_s).as_secs_f64();
        assert!((expected_s - 0.001..expected_s + 1.0).contains(&took_s), "delay {delay_s} s: {took_s} s");
    }
}
