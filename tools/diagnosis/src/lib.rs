//! Diagnosis: compares model and measurement and isolates missing effects, their gyros and amplitudes.
//!
//! A module uses only those named before it:
//! - the data: `time_origin`, `measured`, `residual_stats`, `motion_segments`;
//! - signatures: `courses`, `signature_bank`, `small_motions`, `shape_search`;
//! - statistics: `significance`, `linear_algebra`, `rounding`, `whitening`, `normal_equations`, `course_list`, `course_products`, `sweep`, `signature`, `linear_signatures`, `spots`, `recent`, `calibration_signatures`, `fitted_hypothesis`, `model_state`, `diagnosis_case` (a fit), `noise`, `whiteness`, `search`, `null_products`, `null_distribution`, `temperature_lag`;
//! - the selection of hypotheses: `model_selection`, `solution`;
//! - the report: `residual_map`, `alternatives`, `next_manoeuvre`, `outcome` (types only), `discriminating_test`, `entries`, `cross_validation`, `shares`, `unexplained`;
//! - the whole: `diagnosis`, `report`.

mod accelerations;
pub mod alternatives;
mod calibration_signatures;
mod course_list;
mod course_products;
mod courses;
mod cross_validation;
mod described;
mod diagnosis;
pub mod diagnosis_case;
pub mod discriminating_test;
mod entries;
pub mod fitted_hypothesis;
mod jumps;
mod linear_algebra;
pub mod linear_signatures;
pub mod measured;
pub mod model_selection;
pub mod model_state;
pub mod motion_segments;
pub mod next_manoeuvre;
pub mod noise;
pub mod normal_equations;
pub mod null_distribution;
mod null_products;
pub mod outcome;
pub mod recent;
pub mod report;
pub mod residual_map;
pub mod residual_stats;
pub mod rounding;
pub mod search;
mod shape_search;
mod shares;
pub mod signature;
pub mod signature_bank;
pub mod significance;
pub mod small_motions;
mod solution;
mod spots;
mod sweep;
mod temperature_lag;
mod time_origin;
mod trial_drifts;
mod unexplained;
mod whiteness;
pub mod whitening;

pub use described::diagnose_device;
pub use diagnosis::diagnose_rows;
pub use diagnosis_case::DiagnosisCase;
pub use measured::{MeasuredData, MeasuredError};
pub use null_distribution::Thresholds;
pub use outcome::{Diagnosis, Verdict};
pub use signature_bank::SignatureBank;
pub use solution::DiagnosisOptions;
