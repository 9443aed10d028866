//! What the on-board computer must do about a fault, and whether it did.

use super::expression::{Expression, Moment};
use crate::units::HALF_SECOND_S;

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Window {
    /// At least once within so long.
    Within(f64),
    /// All the time for so long.
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
    pub window: Window,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Verdict {
    Waiting,
    /// Its window began at this half second.
    Open(u64),
    /// It was met; on-board time at which that was certain.
    Met(f64),
    NotMet(f64),
}

#[derive(Debug, Clone, PartialEq)]
pub struct Watch {
    pub expectation: Expectation,
    pub verdict: Verdict,
}

impl Watch {
    pub fn new(expectation: Expectation) -> Watch {
        Watch { expectation, verdict: Verdict::Waiting }
    }

    /// Looks at the start of a half second, where `started` tells whether a fault has ever started; whether the verdict
    /// is new. The condition speaks of what has ended, so it counts from the second look on.
    pub fn look(&mut self, now: &Moment, started: impl Fn(&str) -> bool) -> bool {
        let expectation = &self.expectation;
        match self.verdict {
            Verdict::Waiting => {
                let is_open = now.t_s >= expectation.at_s && expectation.after.as_deref().is_none_or(started);
                if is_open {
                    self.verdict = Verdict::Open(now.frame);
                }
                false
            }
            Verdict::Open(since) => {
                let holds = expectation.condition.holds(now);
                let (Window::Within(length_s) | Window::Throughout(length_s)) = expectation.window;
                let is_over = (now.frame - since) as f64 * HALF_SECOND_S >= length_s;
                self.verdict = match expectation.window {
                    Window::Within(_) if holds => Verdict::Met(now.t_s),
                    Window::Within(_) if is_over => Verdict::NotMet(now.t_s),
                    Window::Throughout(_) if !holds => Verdict::NotMet(now.t_s),
                    Window::Throughout(_) if is_over => Verdict::Met(now.t_s),
                    _ => return false,
                };
                true
            }
            Verdict::Met(_) | Verdict::NotMet(_) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The verdict when the condition holds in these half seconds after the start.
    fn verdict(window: Window, holds: &[u64]) -> Verdict {
        let mut watch = Watch::new(Expectation {
            id: "test".to_owned(),
            after: Some("fault".to_owned()),
            at_s: 0.0,
            condition: "command(PING)".parse().expect("a condition"),
            window,
        });
        for frame in 0..20 {
            let commands = if holds.contains(&frame) { vec![1] } else { vec![] };
            let now = Moment { frame, t_s: frame as f64 * 0.5, commands, ..Moment::default() };
            watch.look(&now, |id| id == "fault" && frame >= 4);
        }
        watch.verdict
    }

    #[test]
    fn what_must_come_within_a_time_is_met_when_it_comes() {
        assert_eq!(verdict(Window::Within(2.0), &[7]), Verdict::Met(3.5));
        assert_eq!(verdict(Window::Within(2.0), &[8]), Verdict::Met(4.0));
        assert_eq!(verdict(Window::Within(2.0), &[9]), Verdict::NotMet(4.0));
        // Before the fault, and in the half second that ended with its start, it does not count.
        assert_eq!(verdict(Window::Within(2.0), &[3, 4]), Verdict::NotMet(4.0));
    }

    #[test]
    fn what_must_hold_throughout_fails_with_the_first_exception() {
        assert_eq!(verdict(Window::Throughout(2.0), &[5, 6, 7, 8]), Verdict::Met(4.0));
        assert_eq!(verdict(Window::Throughout(2.0), &[5, 6, 8]), Verdict::NotMet(3.5));
    }

    #[test]
    fn what_never_began_waits() {
        let watch = Watch::new(Expectation {
            id: "test".to_owned(),
            after: Some("never".to_owned()),
            at_s: 0.0,
            condition: "t_s > 0".parse().expect("a condition"),
            window: Window::Within(1.0),
        });
        let mut looked = watch.clone();
        assert!(!looked.look(&Moment::default(), |_| false));
        assert_eq!(looked, watch);
    }
}
