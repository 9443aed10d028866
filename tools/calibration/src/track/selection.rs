//! Which gyros are used, and what a tracker reports beside attitude.

use geu_protocol::Gyro;

use crate::counts::BreakKind;
use crate::redundancy::{ParityResidual, ParityTest, THRESHOLD_SIGMA};
use crate::transfer::GyroSet;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GyroSelection {
    #[default]
    Za,
    Zb,
    All,
    /// As `Za`; samples without GYRZA by GYRZB.
    Auto,
}

impl GyroSelection {
    /// Those to use in turn: the first of which all gyros measured.
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
    /// Increments ceased: the attitude lacks what the unit turned meanwhile.
    Lost {
        kind: BreakKind,
        /// The gyros concerned, in wire order.
        gyros: [bool; 4],
        /// Another choice that has all its gyros.
        other: Option<GyroSelection>,
    },
    /// Increments are there again, after so many samples without.
    Again {
        samples: u64,
    },
    /// Other gyros are used from now on.
    Switched(GyroSet),
    /// The redundant difference began to exceed.
    Exceeds(ParityTest, ParityResidual),
    Recovered(ParityTest, ParityResidual),
}

impl std::fmt::Display for TrackerEvent {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match *self {
            TrackerEvent::Lost { kind, gyros, other } => {
                write!(f, "{}; the attitude lacks what the unit turned meanwhile", Reason { kind, gyros })?;
                match other {
                    Some(other) => write!(f, "; --gyros {other} would go on"),
                    None => Ok(()),
                }
            }
            TrackerEvent::Again { samples: 1 } => write!(f, "increments again, after 1 sample without"),
            TrackerEvent::Again { samples } => write!(f, "increments again, after {samples} samples without"),
            TrackerEvent::Switched(in_use) => write!(f, "goes on with {}", in_use_name(in_use)),
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
        f.write_str(match self {
            GyroSelection::Za => "za",
            GyroSelection::Zb => "zb",
            GyroSelection::All => "all",
            GyroSelection::Auto => "auto",
        })
    }
}

/// What the gyros in use are called in output.
pub fn in_use_name(in_use: GyroSet) -> &'static str {
    match in_use {
        GyroSet::WithZa => "za",
        GyroSet::WithZb => "zb",
        GyroSet::All => "all",
    }
}

/// Why there are no increments, with the gyros where it is not all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reason {
    pub kind: BreakKind,
    /// The gyros concerned, in wire order.
    pub gyros: [bool; 4],
}

impl std::fmt::Display for Reason {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        if self.gyros != [true; 4] {
            let names = Gyro::ALL.into_iter().filter(|&gyro| self.gyros[gyro as usize]).map(Gyro::name);
            write!(f, "{}: ", names.collect::<Vec<_>>().join(" and "))?;
        }
        self.kind.fmt(f)
    }
}
