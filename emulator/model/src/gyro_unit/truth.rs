//! The motion of a unit: its scenario or a truth from elsewhere, and the number of samples that it covers.

use std::sync::Arc;

use super::GyroUnit;
use crate::attitude::{AttitudeProfile, Motion, RecordedAttitude, StreamedAttitude};
use crate::configuration::Configuration;
use crate::fault::{EffectList, Fault, FaultKind};

/// A truth may end by this share of a sample interval early: its stamps are rounded.
const GRAIN: f64 = 1e-6;

#[derive(Debug, Clone, Default)]
pub enum Truth {
    /// The configuration's scenario, or its prescribed rates.
    #[default]
    Scenario,
    /// Rows of a file; their time 0 is the start of the first sample interval.
    Recorded(Arc<RecordedAttitude>),
    /// Knots received during this run or an earlier one; their time 0 is the same.
    Stepped(Arc<StreamedAttitude>),
}

impl Truth {
    /// The motion from `t_s` on, true time since the start of the first sample interval; a scenario is at rest before that,
    /// and begins there.
    pub fn motion(&self, configuration: &Configuration, t_s: f64) -> Motion {
        match self {
            Truth::Scenario if configuration.is_of_rates() => {
                Motion::of_rates(&configuration.motion, configuration.seed, t_s)
            }
            Truth::Scenario => {
                let scenario = &configuration.scenario;
                let plan =
                    AttitudeProfile::new(scenario).expect("a configuration holds only scenarios that were tried");
                Motion::starting_before(plan, scenario.limit_cycle, (-t_s).max(0.0))
            }
            Truth::Recorded(rows) => Motion::recorded(rows.clone(), t_s),
            Truth::Stepped(knots) => Motion::stepped(knots.clone(), t_s),
        }
    }
}

impl GyroUnit {
    /// Number of samples, at most `most`, that a truth covers: all their true time, the motion that an effect shifts to them,
    /// and for a recorded truth the sample of true time in which the last one ends.
    pub fn samples_within(configuration: &Configuration, truth: &Truth, most: u64) -> u64 {
        if matches!(truth, Truth::Scenario) {
            return most;
        }
        let moves_time = |fault: &Fault| matches!(fault.action, FaultKind::Parameter { target, .. } if target.list == EffectList::Unit);
        // A fault that shifts the unit's time starts when its conditions hold, so it needs a run.
        let is_run = configuration.faults.iter().any(moves_time);
        let mut unit = if is_run { GyroUnit::on(configuration, truth) } else { GyroUnit::new(configuration) };
        let mut commands = configuration.run.commands.iter().peekable();
        let covered = |unit: &GyroUnit| match truth {
            Truth::Scenario => true,
            Truth::Recorded(rows) => {
                let end_s = unit.end_fs as f64 * 1e-15;
                let interval_s = unit.configuration.device.interval_s;
                let needed_s = (end_s / interval_s - GRAIN).ceil() * interval_s;
                needed_s.max(unit.needs_truth_s()) <= rows.end_s() + GRAIN
            }
            Truth::Stepped(knots) => unit.needs_truth_s() <= knots.end_s() + GRAIN,
        };
        let mut count = 0;
        while count < most && covered(&unit) {
            count += 1;
            if is_run {
                while let Some(command) = commands.next_if(|command| command.sample < count) {
                    let _ = unit.command(&command.payload);
                }
                unit.end_sample();
            } else {
                unit.start_fs = unit.end_fs;
                unit.schedule_end();
            }
        }
        count
    }

    /// Time until which the truth must be known to end the running sample interval: its end, or later if an effect shifts the
    /// motion forward, in the unit or in the one without faults.
    pub fn needs_truth_s(&self) -> f64 {
        let end_s = self.end_fs as f64 * 1e-15;
        let own_s = end_s.max(end_s - self.timing.shift_s);
        self.clean.as_ref().map_or(own_s, |clean| clean.needs_truth_s().max(own_s))
    }
}
