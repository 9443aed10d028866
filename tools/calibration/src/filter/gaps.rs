//! Lost samples, filled in.

use std::borrow::Cow;

use crate::counts::{AccumulatedCounts, BreakKind, Discontinuity};
use crate::transfer::GyroSet;

/// Number of samples whose mean replaces a lost one: two periods of the limit cycle (Casteren §3.3).
const MEAN_OVER: usize = 20;

/// The counts with lost samples filled in, and for each sample and gyro in use the number of successive lost samples up to
/// it; 0 if it is present. Empty if none is lost.
pub(super) fn fill_gaps(counts: &AccumulatedCounts, in_use: GyroSet) -> (Cow<'_, AccumulatedCounts>, Vec<[u32; 4]>) {
    let used = in_use.gyros();
    let is_lost = |found: &&Discontinuity| {
        found.kind != BreakKind::TimeJump
            && found.from < found.to.min(counts.len())
            && (0..4).any(|gyro| used[gyro] && found.gyros[gyro])
    };
    let mut breaks = counts.breaks.iter().filter(is_lost).peekable();
    if breaks.peek().is_none() {
        return (Cow::Borrowed(counts), Vec::new());
    }
    let mut lost = vec![[0; 4]; counts.len()];
    for found in breaks {
        let last = found.to.min(lost.len());
        for sample in &mut lost[found.from.min(last)..last] {
            for gyro in 0..4 {
                sample[gyro] |= u32::from(used[gyro] && found.gyros[gyro]);
            }
        }
    }
    let mut filled = counts.clone();
    for gyro in 0..4 {
        // As many as there are until there are enough.
        let (mut recent, mut seen, mut on_end) = ([0.0; MEAN_OVER], 0, 0);
        for (sample, lost) in lost.iter_mut().enumerate() {
            let kept = seen.min(MEAN_OVER);
            on_end = if lost[gyro] == 0 { 0 } else { on_end + 1 };
            lost[gyro] = on_end;
            let increment = if on_end > 0 {
                recent[..kept].iter().sum::<f64>() / kept.max(1) as f64
            } else {
                let increment = counts.accumulated[gyro][sample + 1] - counts.accumulated[gyro][sample];
                recent[seen % MEAN_OVER] = increment;
                seen += 1;
                increment
            };
            filled.accumulated[gyro][sample + 1] = filled.accumulated[gyro][sample] + increment;
        }
    }
    (Cow::Owned(filled), lost)
}
