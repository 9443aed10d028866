//! Defects of a CSV of gyros.

use super::RateSample;

/// Rows within which the mirror image of a step of time is searched.
const GLITCH_ROWS: usize = 600;

#[derive(Debug, Clone, PartialEq)]
pub struct GyroCsvDefect {
    /// Line, from 1.
    pub line: u64,
    pub kind: GyroCsvDefectKind,
}

/// Kind of a defect; [`std::fmt::Display`] writes expected and got.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GyroCsvDefectKind {
    /// A field that is no number; the row is no sample.
    #[error("{column}: expected a number, got {got:?}")]
    NotANumber { column: String, got: String },
    /// A row with more or fewer fields than the header; no sample.
    #[error("expected {expected} fields, got {got}")]
    Fields { expected: usize, got: usize },
    #[error("expected the next row at the interval, got a gap of {length_s} s")]
    Gap {
        /// Since the row before.
        length_s: f64,
    },
    /// The stamp of the row before, again.
    #[error("expected a new time, got the one before again")]
    Repeat,
    #[error("expected time to rise, got {by_s} s back")]
    Backwards { by_s: f64 },
    /// The stamps of this row and of those after it have an offset.
    #[error("expected time to go on, got {rows} rows stamped {offset_s:+} s beside it")]
    Glitch { rows: usize, offset_s: f64 },
}

impl GyroCsvDefectKind {
    pub fn name(&self) -> &'static str {
        match self {
            GyroCsvDefectKind::NotANumber { .. } => "not-a-number",
            GyroCsvDefectKind::Fields { .. } => "fields",
            GyroCsvDefectKind::Gap { .. } => "gap",
            GyroCsvDefectKind::Repeat => "repeated-stamp",
            GyroCsvDefectKind::Backwards { .. } => "time-backwards",
            GyroCsvDefectKind::Glitch { .. } => "time-glitch",
        }
    }
}

/// Steps of time that differ from the interval by more than half of it. `rows`: row numbers of the samples, refused rows
/// included.
pub fn time_defects(samples: &[RateSample], rows: &[u64], interval_s: f64) -> Vec<GyroCsvDefect> {
    // Each step, and its deviation from the interval.
    let stamps = samples.windows(2).map(|pair| pair[1].t_s - pair[0].t_s);
    let steps: Vec<(f64, f64)> = stamps
        .zip(rows.windows(2))
        .map(|(step_s, rows)| (step_s, step_s - interval_s * (rows[1] - rows[0]) as f64))
        .collect();
    let small = |time_s: f64| time_s.abs() <= 0.5 * interval_s;
    let mut returned = vec![false; steps.len()];
    let mut defects = Vec::new();
    for (index, &(step_s, beside_s)) in steps.iter().enumerate() {
        if returned[index] || small(beside_s) {
            continue;
        }
        // A later step with the opposite deviation.
        let back = (index + 1..steps.len()).take(GLITCH_ROWS).find(|&later| {
            let (back_s, back_beside_s) = steps[later];
            !returned[later] && !small(step_s) && !small(back_s) && small(beside_s + back_beside_s)
        });
        let kind = match back {
            Some(later) => {
                returned[later] = true;
                GyroCsvDefectKind::Glitch { rows: later - index, offset_s: beside_s }
            }
            None if small(step_s) => GyroCsvDefectKind::Repeat,
            None if step_s < 0.0 => GyroCsvDefectKind::Backwards { by_s: -step_s },
            // Rows that were refused took no time.
            None if beside_s < 0.0 => continue,
            None => GyroCsvDefectKind::Gap { length_s: step_s },
        };
        defects.push(GyroCsvDefect { line: samples[index + 1].line, kind });
    }
    defects
}
