//! The blind trial: simulated recordings with random effects injected, and scores of their diagnosis.
//!
//! ```
//! use geu_blind::{TrialMotion, generate_trial};
//! use geu_model::Configuration;
//!
//! let motion = TrialMotion::new(Configuration::reference(), 1500.0).expect("long enough");
//! let (key, recording) = generate_trial(&motion, 7);
//! assert!(key.injected.len() <= 3 && recording.rows.len() == 3000);
//! ```

mod campaign;
mod injected;
mod record;
mod score;
mod simulate;
mod survey;
mod tables;
mod trial;

pub use campaign::{BlindCampaign, CampaignPlan, Group, Shard, TrialKind, TrialRun, campaign, on_threads};
pub use injected::{AnswerKey, FieldError, InjectedEffect, Origin};
pub use record::{MergeError, ShardFile, TrialRecord, merged};
pub use score::{EffectScore, IsolationResult, ReportedDiagnosis, Score, SizeError, score};
pub use simulate::{SimulatedRecording, simulate};
pub use survey::{SURVEY_S, TrialMotion};
pub use trial::{TrialGenerator, generate_trial};
