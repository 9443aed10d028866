use std::fmt;

use crate::clock::TimestampAnomalies;

/// What a recording held, and what of it was not sent.
#[derive(Debug, Clone, Default)]
pub struct ReplayReport {
    /// Of one pass.
    pub length_ns: i64,
    /// Of its time stamps.
    pub anomalies: TimestampAnomalies,
    /// Extended, remote, FD and error frames, which no link here carries.
    pub other_frames: u64,
    /// Frames on other interfaces.
    pub elsewhere: u64,
    /// Records that are none.
    pub broken: u64,
    /// Whether all was read, and no link carries anything of it.
    pub nothing_carried: bool,
}

impl fmt::Display for ReplayReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let TimestampAnomalies { gaps, longest_ns, jumps } = self.anomalies;
        if gaps + jumps > 0 {
            let longest_s = longest_ns as f64 * 1e-9;
            writeln!(f, "time stamps  {gaps} gaps shortened, the longest of {longest_s:.3} s; {jumps} jumps back")?;
        }
        if self.other_frames + self.elsewhere + self.broken > 0 {
            writeln!(
                f,
                "not sent     {} extended, remote, FD and error frames, {} frames of other interfaces, {} broken records",
                self.other_frames, self.elsewhere, self.broken
            )?;
        }
        Ok(())
    }
}
