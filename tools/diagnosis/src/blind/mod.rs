//! The blind trial: effects hidden at random in simulated recordings, and what a diagnosis makes of them.
//!
//! ```
//! use geu_diagnosis::blind::{TrialMotion, generate_trial};
//! use geu_model::Configuration;
//!
//! let survey = TrialMotion::new(Configuration::reference(), 1500.0).expect("long enough");
//! let (key, flight) = generate_trial(&survey, 7);
//! assert!(key.hidden.len() <= 3 && flight.rows.len() == 3000);
//! ```

mod campaign;
mod draw;
mod fly;
mod hidden;
mod score;
mod survey;

pub use campaign::{BlindCampaign, CampaignPlan, Group, TrialKind, TrialRun, campaign};
pub use draw::generate_trial;
pub use fly::{SimulatedRecording, fly};
pub use hidden::{AnswerKey, BadKey, InjectedEffect, Origin};
pub use score::{BadResult, EffectScore, IsolationResult, ReportedDiagnosis, Score, SizeError, score};
pub use survey::{SURVEY_S, TrialMotion};
