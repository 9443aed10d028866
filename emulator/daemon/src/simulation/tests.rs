//! The seeds of the test run.
#![cfg(test)]

use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::thread;

use super::chaos::{self, Outcome, RUNS};

/// Seeds of each test run; `GEU_SEEDS=FIRST..LAST` chooses others.
const SEEDS: Range<u64> = 0..50;

/// Number of failing seeds after which the others are left out.
const ENOUGH: usize = 1;

fn seeds() -> Range<u64> {
    let Ok(text) = std::env::var("GEU_SEEDS") else { return SEEDS };
    let numbers = text.split_once("..").map(|(first, last)| (first.parse(), last.parse()));
    let Some((Ok(first), Ok(last))) = numbers else { panic!("GEU_SEEDS: expected FIRST..LAST, got {text}") };
    first..last
}

#[test]
fn no_seed_breaks_the_unit() {
    let (seeds, outcomes, failures) = (seeds(), Mutex::<Vec<Outcome>>::default(), Mutex::<Vec<String>>::default());
    let next = AtomicU64::new(seeds.start);
    let threads = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(seed) = Some(next.fetch_add(1, Relaxed)).filter(|seed| seeds.contains(seed)) {
                    if failures.lock().expect("no panic while locked").len() >= ENOUGH {
                        return;
                    }
                    match chaos::run(seed) {
                        Ok(outcome) => outcomes.lock().expect("no panic while locked").push(outcome),
                        Err(failure) => {
                            failures.lock().expect("no panic while locked").push(format!("seed {seed}: {failure}"))
                        }
                    }
                }
            });
        }
    });
    let (outcomes, failures) = (outcomes.into_inner().expect("no panic"), failures.into_inner().expect("no panic"));
    for (interval_ns, _) in RUNS {
        let of_interval: Vec<&Outcome> = outcomes.iter().filter(|own| own.interval_ns == interval_ns).collect();
        let sum = |of: fn(&Outcome) -> u64| of_interval.iter().map(|own| of(own)).sum::<u64>();
        let (samples, received) = (sum(|outcome| outcome.samples), sum(|outcome| outcome.received));
        let (replies, connections) = (sum(|outcome| outcome.replies), sum(|outcome| outcome.connections));
        println!(
            "{} seeds of {} ms: {samples} samples, {received} received, {replies} replies, {connections} connections",
            of_interval.len(),
            interval_ns / 1_000_000
        );
        let many = failures.is_empty() && outcomes.len() >= 50;
        assert!(!many || received > samples / 2 && replies > of_interval.len() as u64, "clients take part");
    }
    let sum = |of: fn(&Outcome) -> u64| outcomes.iter().map(of).sum::<u64>();
    let take_part = sum(|outcome| outcome.replies) > sum(|outcome| outcome.samples);
    assert!(take_part || !failures.is_empty() || outcomes.len() < 50, "clients take part");
    assert!(failures.is_empty(), "{} seeds fail:\n{}", failures.len(), failures.join("\n"));
}

#[test]
fn a_seed_repeats_its_run() {
    for seed in 0..5 {
        assert_eq!(chaos::run(seed), chaos::run(seed), "seed {seed}");
    }
}
