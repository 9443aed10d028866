//! Why a recording cannot be diagnosed.

/// Longest rows of rates and turns, s: the motion of a unit in a hand or on a table is another one within longer rows.
pub const MAX_ROW_S: f64 = 2.0;

/// Reason why a recording cannot be diagnosed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MeasuredError {
    /// The recording has no sample.
    #[error("the recording: expected samples, got none; `geu decode` prints its contents")]
    Empty,
    /// The common interval of recording and reference is too short.
    #[error(
        "the recording ({from_s:.1}…{to_s:.1} s) and the reference ({reference_from_s:.1}…{reference_to_s:.1} s): expected at least {min_s:.0} s in common, got {common_s:.1} s"
    )]
    NoOverlap {
        /// Start of the recording.
        from_s: f64,
        /// End of the recording.
        to_s: f64,
        /// Start of the reference.
        reference_from_s: f64,
        /// End of the reference.
        reference_to_s: f64,
        /// Length of the common interval.
        common_s: f64,
        /// Minimum usable length.
        min_s: f64,
    },
    /// The reference does not show the motion.
    #[error(
        "the reference: expected rows of rates or turns of at most {MAX_ROW_S} s, which show the motion, got {row_s:.1} s; `geu calibrate` takes longer ones"
    )]
    LongRows { row_s: f64 },
    /// The reference is of opposite sign or in another unit.
    #[error("the reference: expected the motion that the gyros measure, {0}")]
    Mismatch(String),
    /// Too many samples of the common interval are not usable.
    #[error(
        "the recording: expected at least {min_s:.0} s of one gyro beside the reference, without lost, clipped or invalid samples, got {good_s:.0} s of {common_s:.0} s; `geu decode` lists the losses"
    )]
    Broken {
        /// Usable length of the gyro that has the longest.
        good_s: f64,
        /// Length of the common interval.
        common_s: f64,
        /// Minimum usable length.
        min_s: f64,
    },
}
