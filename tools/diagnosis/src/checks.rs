//! The exact checks with which a diagnosis begins: what is certain before any statistics of small effects, and what must be
//! out of the way for them.
//!
//! The link first (sequence, times, flags, ends of the range), then the receiver's clock against the unit's, then the counts
//! against the motion: a wrong unit, and the faults of [`geu_model::effect::WiringEffects`].
//!
//! ```
//! use geu_diagnosis::checks::check;
//! use geu_model::Configuration;
//! use geu_recording::ReferenceAttitude;
//!
//! let rows = "t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s\n0.5,0,0,0\n1.0,0,0,0\n1.5,0,0,0\n";
//! let reference = ReferenceAttitude::parse("reference.csv", rows).expect("a reference");
//! let checked = check(&[], &[], &Configuration::reference(), &reference);
//! assert!(checked.faults.is_empty() && checked.rows.is_empty());
//! ```

mod clock;
mod compared;
mod following;
mod law;
mod link;
mod timeline;
mod told;
mod wiring;

use geu_model::Configuration;
use geu_recording::{Defect, ReceivedSample, ReferenceAttitude};

use crate::Finding;
use compared::CountComparison;
pub use law::WiringFault;
use law::WiringHypothesis;
use timeline::SampleTimes;
use told::FindingCollector;

/// What the checks found, and the rows as they are without what could be put right.
#[derive(Debug, Clone, PartialEq)]
pub struct CheckResult {
    /// In order of time; runs of the same thing are one. Places are told in s since the start of the first sample interval.
    pub findings: Vec<Finding>,
    /// What the model has a code for, in order of time.
    pub faults: Vec<WiringFault>,
    /// As many as were given: wiring faults undone; where that cannot be, or a count stands at an end of its range without
    /// the flag, marked as no measurement.
    pub rows: Vec<ReceivedSample>,
}

/// Checks a recording: `rows` and `defects` as the decoder gave them, in order; `configuration` is what is believed.
pub fn check(
    rows: &[ReceivedSample],
    defects: &[Defect],
    configuration: &Configuration,
    reference: &ReferenceAttitude,
) -> CheckResult {
    let timeline = SampleTimes::of(rows);
    let mut told = FindingCollector::new(&timeline);
    told.defects(defects);
    let mut corrected = rows.to_vec();
    link::check(&mut corrected, &timeline, &mut told);
    clock::check(rows, &timeline, configuration, &mut told);

    let compared = CountComparison::of(&corrected, &timeline, configuration, reference, &mut told);
    let mut faults = Vec::new();
    if let Some(mut compared) = compared {
        // Two exchanged gyros can look as if each were in another unit; counts in a coarser unit as if they were stuck.
        let laws = WiringHypothesis::all();
        let reversible: Vec<WiringHypothesis> = laws.iter().copied().filter(WiringHypothesis::undoes_itself).collect();
        faults = wiring::search(reversible, &[], &mut compared, &timeline);
        if following::wrong_units(&mut compared, &mut told) {
            let further = wiring::search(laws, &faults, &mut compared, &timeline);
            faults.extend(further);
        }
        wiring::undo(&faults, &compared, &mut corrected);
        following::uncorrelated_gyros(&compared, &mut told);
    }
    let mut faults: Vec<WiringFault> = faults.into_iter().map(|found| found.fault).collect();
    faults.sort_by(|one, other| one.onset_s.unwrap_or(0.0).total_cmp(&other.onset_s.unwrap_or(0.0)));
    faults.iter().for_each(|fault| told.fault(fault));
    CheckResult { findings: told.findings(), faults, rows: corrected }
}
