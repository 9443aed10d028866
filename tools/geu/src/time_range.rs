//! Options of a range of times.

use clap::Args;
use geu_recording::archive::{TimeRange, instant_ns};

use crate::command_error::CommandError;

/// Rows that are read from an archive of `geu decode --format parquet`.
#[derive(Args, Debug, Clone, Copy, Default)]
pub struct RangeArgs {
    /// Time of the first rows of an archive, UTC as 2026-11-27T10:00:00Z or seconds since 1970
    #[arg(long, value_name = "TIME", allow_negative_numbers = true, value_parser = instant)]
    from: Option<i64>,
    /// Time before which the rows of an archive end, in the same form
    #[arg(long, value_name = "TIME", allow_negative_numbers = true, value_parser = instant)]
    to: Option<i64>,
}

impl RangeArgs {
    /// The range; `None` without these options.
    ///
    /// # Errors
    /// It ends before it begins.
    pub fn range(&self) -> Result<Option<TimeRange>, CommandError> {
        let range = TimeRange { from_ns: self.from.unwrap_or(i64::MIN), to_ns: self.to.unwrap_or(i64::MAX) };
        match (self.from.or(self.to), range.from_ns < range.to_ns) {
            (None, _) => Ok(None),
            (_, true) => Ok(Some(range)),
            (_, false) => {
                Err(CommandError::input("--to: expected a time after that of --from, got an earlier one or the same"))
            }
        }
    }
}

fn instant(text: &str) -> Result<i64, String> {
    instant_ns(text).ok_or_else(|| format!("expected UTC as 2026-11-27T10:00:00Z or seconds since 1970, got {text}"))
}
