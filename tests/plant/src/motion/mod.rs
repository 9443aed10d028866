//! The truth: inertial rates about the control axes at any instant.

mod closed_loop;
mod rate_table;
mod survey;

use closed_loop::ClosedLoop;
use rate_table::RateTable;
use survey::Survey;

use crate::noise::Noise;

/// Kind of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotionKind {
    /// A survey with the limit cycle of the attitude control.
    Survey,
    /// A survey without it.
    QuietSurvey,
    /// Constant rates about the axes in turn.
    RateTable,
    /// Slews and rests under a control that uses the unit's own counts.
    ClosedLoop,
}

/// The state of motion at an instant.
pub struct State {
    /// Inertial rates about the control axes, arcsec/s.
    pub rates: [f64; 3],
    /// θ and ψ, where there is a sun.
    pub sun_deg: Option<(f64, f64)>,
}

pub enum Motion {
    Survey(Survey),
    RateTable(RateTable),
    ClosedLoop(ClosedLoop),
}

impl Motion {
    pub fn drawn(kind: MotionKind, random: &mut Noise, duration_s: f64) -> Motion {
        match kind {
            MotionKind::Survey | MotionKind::QuietSurvey => {
                Motion::Survey(Survey::drawn(random, duration_s, kind == MotionKind::Survey))
            }
            MotionKind::RateTable => Motion::RateTable(RateTable::drawn(random, duration_s)),
            MotionKind::ClosedLoop => Motion::ClosedLoop(ClosedLoop::drawn(random, duration_s)),
        }
    }

    /// State at `t`, in a closed loop up to the end of the last sample.
    pub fn at(&self, t: f64) -> State {
        let without_sun = |rates| State { rates, sun_deg: None };
        match self {
            Motion::Survey(survey) => survey.at(t),
            Motion::RateTable(table) => without_sun(table.at(t)),
            Motion::ClosedLoop(closed_loop) => without_sun(closed_loop.at(t)),
        }
    }

    /// The control's answer to the counts of a sample that ends at `end_s`.
    pub fn answer(&mut self, end_s: f64, counts: [i16; 4]) {
        if let Motion::ClosedLoop(closed_loop) = self {
            closed_loop.answer(end_s, counts);
        }
    }
}
