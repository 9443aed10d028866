//! Selection of gyros, and the events that a tracker reports beside the attitude.

use clap::ValueEnum;
use clap::builder::PossibleValue;
use geu_protocol::Gyros;

use crate::counts::BreakKind;
use crate::parity::{ParityResidual, ParityTest, THRESHOLD_SIGMA};
use crate::transfer::GyroSet;

/// Gyros in use; the texts are those of the option `--gyros`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum GyroSelection {
    /// GYRX, GYRY, GYRZA.
    #[default]
    Za,
    /// GYRX, GYRY, GYRZB.
    Zb,
    /// All four, by least squares.
    All,
    /// As za; samples without GYRZA by GYRZB.
    Auto,
}

impl GyroSelection {
    /// The sets to use, in order of preference: the first whose gyros all measured.
    pub(super) fn candidates(self) -> &'static [GyroSet] {
        match self {
            GyroSelection::Za => &[GyroSet::WithZa],
            GyroSelection::Zb => &[GyroSet::WithZb],
            GyroSelection::All => &[GyroSet::All],
            GyroSelection::Auto => &[GyroSet::WithZa, GyroSet::WithZb],
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TrackerEvent {
    /// Increments are missing: the attitude lacks the rotation meanwhile.
    Lost {
        kind: BreakKind,
        /// The affected gyros.
        gyros: Gyros,
        /// Another selection whose gyros all measured.
        other: Option<GyroSelection>,
    },
    /// Increments are present again after a number of samples without.
    Again {
        samples: u64,
    },
    /// Another set of gyros is used from now on.
    Switched(GyroSet),
    /// The parity residual exceeded the threshold.
    Exceeds(ParityTest, ParityResidual),
    Recovered(ParityTest, ParityResidual),
}

impl std::fmt::Display for TrackerEvent {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match *self {
            TrackerEvent::Lost { kind, gyros, other } => {
                write!(f, "{}; the attitude lacks what the unit turned meanwhile", Reason { kind, gyros })?;
                match other {
                    Some(other) => write!(f, "; --gyros {other} would continue"),
                    None => Ok(()),
                }
            }
            TrackerEvent::Again { samples: 1 } => write!(f, "increments again, after 1 sample without"),
            TrackerEvent::Again { samples } => write!(f, "increments again, after {samples} samples without"),
            TrackerEvent::Switched(in_use) => write!(f, "continues with {}", gyro_set_name(in_use)),
            TrackerEvent::Exceeds(test, ParityResidual { arcsec, sigma_arcsec }) => write!(
                f,
                "GYRZA and GYRZB differ by {arcsec:+.2}″ {test}, more than {THRESHOLD_SIGMA} sigma of {sigma_arcsec:.2}″"
            ),
            TrackerEvent::Recovered(test, ParityResidual { arcsec, sigma_arcsec }) => {
                write!(f, "GYRZA and GYRZB agree again: {arcsec:+.2}″ {test}, sigma {sigma_arcsec:.2}″")
            }
        }
    }
}

impl std::fmt::Display for GyroSelection {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(self.to_possible_value().as_ref().map_or("", PossibleValue::get_name))
    }
}

/// Name of a gyro set in output.
pub fn gyro_set_name(in_use: GyroSet) -> &'static str {
    match in_use {
        GyroSet::WithZa => "za",
        GyroSet::WithZb => "zb",
        GyroSet::All => "all",
    }
}

/// Why increments are missing, and of which gyros.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reason {
    pub kind: BreakKind,
    /// The affected gyros.
    pub gyros: Gyros,
}

impl std::fmt::Display for Reason {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        if !self.gyros.is_all() {
            write!(f, "{}: ", self.gyros.names().join(" and "))?;
        }
        self.kind.fmt(f)
    }
}
