//! Keeping time: absolute deadlines on the monotonic clock, on an ordinary thread.
//!
//! On a two-core virtual machine the median lateness of a timer of an asynchronous runtime is more than 1 ms, of an absolute sleep
//! with 1 ns of timer slack less than 0.1 ms; a final spin removes the rest.

use std::time::Duration;

use nix::errno::Errno;
use nix::sys::prctl;

use crate::host;
pub use crate::host::now_ns;

/// SCHED_FIFO priority: above ordinary work, below the kernel's own threads at 50.
const FIFO_PRIORITY: i32 = 40;

/// Sleeps until absolute deadlines, on the thread that made it.
#[derive(Debug)]
pub struct DeadlineTimer {
    spin_ns: i64,
}

impl DeadlineTimer {
    /// Sets this thread's timer slack to 1 ns. The last `spin` before each deadline is spent spinning, not sleeping.
    pub fn new(spin: Duration) -> DeadlineTimer {
        // Only kernels without timer slack refuse it.
        let _ = prctl::set_timerslack(1);
        DeadlineTimer { spin_ns: spin.as_nanos() as i64 }
    }

    /// Returns at the deadline or as soon as possible after it.
    pub fn sleep_until(&self, deadline_ns: i64) {
        let wake_ns = deadline_ns - self.spin_ns;
        host::sleep_thread_until(wake_ns);
        if self.spin_ns > 0 {
            while now_ns() < deadline_ns {
                std::hint::spin_loop();
            }
        }
    }
}

/// Parks this thread until about `deadline_ns`; an unpark returns early.
pub(crate) fn doze_until(deadline_ns: i64) {
    let left_ns = deadline_ns - now_ns();
    if left_ns > 0 {
        host::park_thread(Duration::from_nanos(left_ns as u64));
    }
}

/// Requests SCHED_FIFO for this thread.
///
/// # Errors
/// The error of the kernel if it refuses.
pub fn ask_for_realtime() -> Result<(), Errno> {
    // SAFETY: zeros are a valid sched_param, which has more fields in musl; it outlives the call. In musl sched_setscheduler only fails.
    let code = unsafe {
        let mut parameter: nix::libc::sched_param = std::mem::zeroed();
        parameter.sched_priority = FIFO_PRIORITY;
        nix::libc::pthread_setschedparam(nix::libc::pthread_self(), nix::libc::SCHED_FIFO, &raw const parameter)
    };
    if code == 0 { Ok(()) } else { Err(Errno::from_raw(code)) }
}

/// Ratio of on-board time to the wall clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Speed {
    /// On-board seconds per second of the wall clock.
    Times(f64),
    /// As fast as the model and the readers permit.
    Max,
}

impl Speed {
    /// Wall-clock duration of `on_board_ns`, ns; `None` for [`Speed::Max`].
    pub fn wall_ns(self, on_board_ns: i64) -> Option<i64> {
        match self {
            Speed::Times(1.0) => Some(on_board_ns),
            Speed::Times(factor) => Some((on_board_ns as f64 / factor) as i64),
            Speed::Max => None,
        }
    }

    /// True if samples are faster than in a real unit, so that their bytes matter more than their times.
    pub fn is_faster_than_real(self) -> bool {
        match self {
            Speed::Times(factor) => factor > 1.0,
            Speed::Max => true,
        }
    }
}

impl std::str::FromStr for Speed {
    type Err = String;

    fn from_str(text: &str) -> Result<Speed, String> {
        if text == "max" {
            return Ok(Speed::Max);
        }
        match text.parse::<f64>() {
            Ok(factor) if (0.001..=10_000.0).contains(&factor) => Ok(Speed::Times(factor)),
            _ => Err(format!("expected a factor from 0.001 to 10000, or max, got {text}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deadline_is_never_met_early() {
        for spin_us in [0, 200] {
            let timer = DeadlineTimer::new(Duration::from_micros(spin_us));
            for _ in 0..20 {
                let deadline_ns = now_ns() + 1_000_000;
                timer.sleep_until(deadline_ns);
                assert!(now_ns() >= deadline_ns);
            }
        }
    }

    #[test]
    fn speed_scales_time_and_rejects_invalid_text() {
        assert_eq!("2".parse::<Speed>().unwrap().wall_ns(500_000_000), Some(250_000_000));
        assert_eq!("1".parse::<Speed>().unwrap().wall_ns(i64::MAX), Some(i64::MAX));
        assert_eq!("max".parse::<Speed>().unwrap().wall_ns(1), None);
        for text in ["0", "-1", "nan", "inf", "fast"] {
            assert!(text.parse::<Speed>().is_err(), "{text}");
        }
    }
}
