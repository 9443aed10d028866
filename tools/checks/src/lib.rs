//! Exact checks before a diagnosis: defects that are certain without statistics, corrected before the search for small effects.
//!
//! The order is: the link (sequence, times, flags, limits), the receiver's clock against the unit's, the counts against the motion
//! (a wrong unit, and the faults of [`geu_model::effect::WiringEffects`]).
//!
//! ```
//! use geu_checks::check;
//! use geu_model::Configuration;
//! use geu_recording::ReferenceAttitude;
//!
//! let rows = "t_s,rate_x_arcsec_s,rate_y_arcsec_s,rate_z_arcsec_s\n0.5,0,0,0\n1.0,0,0,0\n1.5,0,0,0\n";
//! let reference = ReferenceAttitude::parse("reference.csv", rows).expect("a reference");
//! let checked = check(&[], &[], &Configuration::reference(), &reference);
//! assert!(checked.faults.is_empty() && checked.rows.is_empty());
//! ```

mod alignment;
mod clock;
mod compared;
mod correlation;
mod finding;
mod findings;
mod follows;
mod heads;
mod link;
mod moments;
mod timeline;
mod wiring;
mod wiring_hypothesis;

use geu_model::Configuration;
use geu_recording::{Defect, ReceivedSample, ReferenceAttitude};

pub use alignment::Alignment;
use compared::CountComparison;
pub use compared::{LONE, MAX_WRONG};
pub use finding::Finding;
use findings::FindingCollector;
pub use heads::{HeadCheck, check_heads};
pub use moments::median;
use timeline::SampleTimes;
pub use wiring_hypothesis::WiringFault;
use wiring_hypothesis::WiringHypothesis;

/// Findings, and the corrected rows.
#[derive(Debug, Clone, PartialEq)]
pub struct CheckResult {
    /// In time order, with runs of one kind joined. Places are in s since the start of the first sample interval.
    pub findings: Vec<Finding>,
    /// Wiring faults, in time order.
    pub faults: Vec<WiringFault>,
    /// All rows, with wiring faults undone. Lost counts are marked as invalid, and counts at a limit as saturated.
    pub rows: Vec<ReceivedSample>,
    /// Why counts and motion cannot be compared, as what was got in place of the motion that the gyros measure: the opposite, or one in another
    /// unit.
    pub mismatch: Option<String>,
}

/// Checks a recording: `rows` and `defects` of the decoder, in order, against the nominal `configuration`.
pub fn check(
    rows: &[ReceivedSample],
    defects: &[Defect],
    configuration: &Configuration,
    reference: &ReferenceAttitude,
) -> CheckResult {
    let timeline = SampleTimes::new(rows);
    let mut findings = FindingCollector::new(&timeline);
    findings.defects(defects);
    let mut corrected = rows.to_vec();
    link::check(&mut corrected, &timeline, &mut findings);
    clock::check(rows, &timeline, configuration, &mut findings);

    let compared = CountComparison::new(&corrected, &timeline, configuration, reference, &mut findings);
    let (mut faults, mut mismatch) = (Vec::new(), compared.as_ref().and_then(correlation::reversed));
    if let Some(mut compared) = compared.filter(|_| mismatch.is_none()) {
        // Two exchanged gyros may look like counts in another unit, and counts in a coarser unit like a stuck output.
        let all = WiringHypothesis::all();
        let reversible: Vec<WiringHypothesis> = all.iter().copied().filter(WiringHypothesis::undoes_itself).collect();
        faults = wiring::search(reversible, &[], &mut compared, &timeline);
        mismatch = correlation::wrong_units(&mut compared, &mut findings);
        if mismatch.is_none() {
            let further = wiring::search(all, &faults, &mut compared, &timeline);
            faults.extend(further);
        }
        wiring::undo(&faults, &compared, &mut corrected);
        correlation::uncorrelated_gyros(&compared, &mut findings);
    }
    let mut faults: Vec<WiringFault> = faults.into_iter().map(|found| found.fault).collect();
    faults.sort_by(|one, other| one.onset_s.unwrap_or(0.0).total_cmp(&other.onset_s.unwrap_or(0.0)));
    faults.iter().for_each(|fault| findings.fault(fault));
    CheckResult { findings: findings.findings(), faults, rows: corrected, mismatch }
}
