//! A recording of a described unit: its counts, and findings in the samples.

use super::AccumulatedCounts;

/// Samples of one gyro with exactly one value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConstantRun {
    pub gyro: usize,
    /// The nodes that contain it.
    pub from: usize,
    pub to: usize,
    pub samples: u64,
    /// The value, arcsec.
    pub arcsec: f64,
}

/// A recording of a described unit.
#[derive(Debug, Clone)]
pub struct DeviceRecording {
    /// Angles, arcsec.
    pub counts: AccumulatedCounts,
    /// True with receive times, or times of a table.
    pub is_timed: bool,
    pub constant: Vec<ConstantRun>,
    /// Smallest and largest sample of each gyro after each node, arcsec.
    pub extremes: Vec<Vec<[f64; 2]>>,
    /// Smallest change of each gyro from sample to sample, arcsec.
    pub steps: Vec<f64>,
    /// Size of a count of each rate, arcsec over a sample; 0 for increments and real numbers.
    pub rate_arcsec: Vec<f64>,
    /// Outliers that are left out, for each gyro.
    pub outliers: Vec<u64>,
    pub samples: u64,
    pub missing: u64,
    /// Number of missing samples that are interpolated.
    pub interpolated: u64,
    pub defects: u64,
    pub left_out: RowsLeftOut,
}

/// Number of rows that are no part of the recording.
#[derive(Debug, Clone, Copy, Default)]
pub struct RowsLeftOut {
    /// Rows at the time of an earlier row, or before it.
    pub repeated: u64,
    /// Rows of trials that the reference does not state; without trials in it, of others than the first.
    pub of_other_trials: u64,
    /// Rows of a trial after rows of a later trial of the reference.
    pub out_of_order: u64,
    /// Rows after more missing samples than a recording may have.
    pub after_gap: u64,
}
