//! What a diagnosis comes to: types alone.

use geu_model::Configuration;

use crate::change::Gyros;
use crate::explain::Round;
use crate::finding::Finding;
use crate::gap::Gap;
use crate::measured::{CHANNELS, Series, TIMING};
use crate::normal::THIRDS;
use crate::null::Thresholds;
use crate::stretches::Stretch;
use crate::whereabouts::Whereabouts;

/// What a diagnosis comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// No missing effect, and noise-like once what may be out of date is refitted.
    Consistent,
    /// At least one missing effect, and noise-like after.
    Explained,
    /// Otherwise.
    Unexplained,
}

impl Verdict {
    /// All of them.
    pub const ALL: [Verdict; 3] = [Verdict::Consistent, Verdict::Explained, Verdict::Unexplained];

    /// As JSON has it.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::Consistent => "consistent",
            Verdict::Explained => "explained",
            Verdict::Unexplained => "unexplained",
        }
    }
}

/// A number found.
#[derive(Debug, Clone, PartialEq)]
pub struct Number {
    /// Key in the configuration, unit last.
    pub name: String,
    /// Value.
    pub value: f64,
    /// One sigma; nothing where it was not fitted.
    pub sigma: Option<f64>,
    /// As a configuration writes it, where that is no number: what is on, another gyro.
    pub written: Option<String>,
}

/// Whether something is missing in the model or only its calibration out of date.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// An effect that the configuration does not have.
    MissingEffect,
    /// The sixteen moved.
    Recalibration,
}

/// One thing found.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Code of the model.
    pub code: String,
    /// What it follows, where it is a term that stands in no catalogue, with the unit of its coefficient.
    pub formula: Option<(String, String)>,
    /// Missing or out of date.
    pub class: Class,
    /// The gyros that it acts on.
    pub gyros: Gyros,
    /// Its numbers.
    pub parameters: Vec<Number>,
    /// Fall of the fitted part's summed squared residual when it is added in order, over that of the configuration as given.
    pub gap_share: f64,
    /// By how much χ² falls with it, and what chance does in one recording of a hundred; nothing where it was found by exact checks.
    pub chi2: Option<(f64, f64)>,
    /// By how much better each third is foretold by the other two; nothing for one that has nearly all that tells of it.
    pub held_out: Option<[Option<f64>; THIRDS]>,
    /// What looks like it.
    pub rivals: Vec<RivalShown>,
    /// What puts it into a configuration.
    pub assignments: Vec<String>,
}

/// A rival as it is told.
#[derive(Debug, Clone, PartialEq)]
pub struct RivalShown {
    /// Code.
    pub code: String,
    /// Formula of a term that stands in no catalogue.
    pub formula: Option<String>,
    /// The gyros.
    pub gyros: Gyros,
    /// Cosine of the two signatures.
    pub cosine: f64,
    /// By how much χ² falls more with what was found; nothing where the two are one signature.
    pub behind_chi2: Option<f64>,
    /// What would tell them apart.
    pub remedy: Option<String>,
}

/// What is left that nothing explains.
#[derive(Debug, Clone, PartialEq)]
pub struct Unexplained {
    /// The gyros that show it.
    pub gyros: Gyros,
    /// From when to when it stands out, s.
    pub interval_s: [f64; 2],
    /// In words.
    pub shape: String,
    /// Terms that it follows, with what χ² falls by with each alone.
    pub follows: Vec<(String, f64)>,
}

/// A gap and the same held out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gaps {
    /// On all of the data that were fitted.
    pub fitted: Gap,
    /// On each third, by a fit to the other two.
    pub held_out: Gap,
}

/// The whole of it.
#[derive(Debug)]
pub struct Diagnosis {
    /// In a word.
    pub verdict: Verdict,
    /// What was found: what is missing, then what is out of date.
    pub entries: Vec<Entry>,
    /// What exact checks found.
    pub findings: Vec<Finding>,
    /// With the configuration as given.
    pub before: Gaps,
    /// With the configuration that was written.
    pub after: Gaps,
    /// What is left.
    pub unexplained: Option<Unexplained>,
    /// The configuration with everything found.
    pub configuration: Configuration,
    /// The search, round by round.
    pub rounds: Vec<Round>,
    /// What chance does.
    pub thresholds: Thresholds,
    /// Windowed residual at each node, before and after.
    pub windowed: [[Vec<f64>; TIMING]; 2],
    /// What the unit did.
    pub stretches: Vec<Stretch>,
    /// Root mean square of the residual in each stretch on each gyro, before and after.
    pub stretch_rms_arcsec: [Vec<[f64; TIMING]>; 2],
    /// Where the data leave the model, before (what exact checks mended taken as mended) and after.
    pub whereabouts: [Whereabouts; 2],
    /// Whitened residual at the end, for what it still follows.
    pub left: Series,
    /// Common lag, s, and its sigma.
    pub lag_s: (f64, f64),
    /// How much later than the electronics' own course the temperature is told, s.
    pub temperature_late_s: f64,
    /// Noise of each gyro as it was taken.
    pub noise: [crate::whitening::Noise; CHANNELS],
}
