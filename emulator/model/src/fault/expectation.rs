//! What the on-board computer must do about a fault, and whether it did.

use super::expression::{ConditionInputs, Expression};

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TimeWindow {
    /// At least once within this time, s.
    Within(f64),
    /// At all times for this time, s.
    Throughout(f64),
}

#[derive(Debug, Clone, PartialEq)]
pub struct Expectation {
    pub id: String,
    /// From the first start of this fault on.
    pub after: Option<String>,
    /// Not before this on-board time.
    pub at_s: f64,
    pub condition: Expression,
    pub window: TimeWindow,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ExpectationResult {
    Waiting,
    /// Its window began at this sample.
    Open(u64),
    /// It was met; on-board time at which that was certain.
    Met(f64),
    NotMet(f64),
}

#[derive(Debug, Clone, PartialEq)]
pub struct ExpectationMonitor {
    pub expectation: Expectation,
    pub verdict: ExpectationResult,
}

impl ExpectationMonitor {
    pub fn new(expectation: Expectation) -> ExpectationMonitor {
        ExpectationMonitor { expectation, verdict: ExpectationResult::Waiting }
    }

    /// Evaluates the condition at the start of a sample interval; `started` returns true for a fault that
    /// has started, `interval_s` is the length of a sample. Returns true
    /// if the result is new. The condition refers to the past sample, so it counts from the second evaluation on.
    pub fn evaluate(&mut self, now: &ConditionInputs, interval_s: f64, started: impl Fn(&str) -> bool) -> bool {
        let expectation = &self.expectation;
        match self.verdict {
            ExpectationResult::Waiting => {
                let is_open = now.t_s >= expectation.at_s && expectation.after.as_deref().is_none_or(started);
                if is_open {
                    self.verdict = ExpectationResult::Open(now.frame);
                }
                false
            }
            ExpectationResult::Open(since) => {
                let holds = expectation.condition.holds(now);
                let (TimeWindow::Within(length_s) | TimeWindow::Throughout(length_s)) = expectation.window;
                let is_over = (now.frame - since) as f64 * interval_s >= length_s;
                self.verdict = match expectation.window {
                    TimeWindow::Within(_) if holds => ExpectationResult::Met(now.t_s),
                    TimeWindow::Within(_) if is_over => ExpectationResult::NotMet(now.t_s),
                    TimeWindow::Throughout(_) if !holds => ExpectationResult::NotMet(now.t_s),
                    TimeWindow::Throughout(_) if is_over => ExpectationResult::Met(now.t_s),
                    _ => return false,
                };
                true
            }
            ExpectationResult::Met(_) | ExpectationResult::NotMet(_) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The verdict when the condition holds in these samples after the start.
    fn verdict(window: TimeWindow, holds: &[u64]) -> ExpectationResult {
        let mut watch = ExpectationMonitor::new(Expectation {
            id: "test".to_owned(),
            after: Some("fault".to_owned()),
            at_s: 0.0,
            condition: "command(PING)".parse().expect("a condition"),
            window,
        });
        for frame in 0..20 {
            let commands = if holds.contains(&frame) { vec![1] } else { vec![] };
            let now = ConditionInputs { frame, t_s: frame as f64 * 0.5, commands, ..ConditionInputs::default() };
            watch.evaluate(&now, 0.5, |id| id == "fault" && frame >= 4);
        }
        watch.verdict
    }

    #[test]
    fn what_must_come_within_a_time_is_met_when_it_comes() {
        assert_eq!(verdict(TimeWindow::Within(2.0), &[7]), ExpectationResult::Met(3.5));
        assert_eq!(verdict(TimeWindow::Within(2.0), &[8]), ExpectationResult::Met(4.0));
        assert_eq!(verdict(TimeWindow::Within(2.0), &[9]), ExpectationResult::NotMet(4.0));
        // Before the fault, and in the sample interval that ended with its start, it does not count.
        assert_eq!(verdict(TimeWindow::Within(2.0), &[3, 4]), ExpectationResult::NotMet(4.0));
    }

    #[test]
    fn what_must_hold_throughout_fails_with_the_first_exception() {
        assert_eq!(verdict(TimeWindow::Throughout(2.0), &[5, 6, 7, 8]), ExpectationResult::Met(4.0));
        assert_eq!(verdict(TimeWindow::Throughout(2.0), &[5, 6, 8]), ExpectationResult::NotMet(3.5));
    }

    #[test]
    fn what_never_began_waits() {
        let watch = ExpectationMonitor::new(Expectation {
            id: "test".to_owned(),
            after: Some("never".to_owned()),
            at_s: 0.0,
            condition: "t_s > 0".parse().expect("a condition"),
            window: TimeWindow::Within(1.0),
        });
        let mut evaluated = watch.clone();
        assert!(!evaluated.evaluate(&ConditionInputs::default(), 0.5, |_| false));
        assert_eq!(evaluated, watch);
    }
}
