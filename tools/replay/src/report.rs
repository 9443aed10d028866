use std::fmt;

use crate::clock::TimestampAnomalies;

/// Report of a pass: length, anomalies, and records that were not sent.
#[derive(Debug, Clone, Default)]
pub struct ReplayReport {
    pub length_ns: i64,
    pub anomalies: TimestampAnomalies,
    /// Extended, remote, FD and error frames, which no link here supports.
    pub other_frames: u64,
    /// Frames on other interfaces.
    pub elsewhere: u64,
    /// Records that cannot be read.
    pub broken: u64,
    /// True if all was read, and no link sent any of it.
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
