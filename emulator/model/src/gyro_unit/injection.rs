//! Faults on the unit: their start and end, and the copy of the unit without the active faults.

use std::sync::Arc;

use geu_protocol::Gyro;
use geu_protocol::field::CLOCK_MODULUS;

use super::{Channel, CompletedSample, FS, GyroUnit, Power};
use crate::fault::Fault;
use crate::fault::catalogue::{FaultAction, GyroFault, UnitFault};
use crate::fault::engine::{ActiveFault, FaultEngine, FaultEvent};
use crate::fault::expression::ConditionInputs;
use crate::units::RAD_PER_DEG;

/// Largest lead of the copy's sample end in true time, as a share of a sample. An external truth must be known until then, so it
/// is less than the sample by which a truth that follows the unit is ahead.
const CLEAN_BEHIND: f64 = 0.2;

/// The effect of faults on a sample.
#[derive(Debug, Clone, PartialEq)]
pub struct InjectionRecord {
    /// The sample without the active faults.
    pub clean: CompletedSample,
    pub acting: Arc<Vec<ActiveFault>>,
}

impl GyroUnit {
    /// The effect of faults on the last sample; `None` if no fault was active.
    pub fn injected(&self) -> Option<&Arc<InjectionRecord>> {
        self.injected.as_ref()
    }

    /// Events of faults and expectations since the last call.
    pub fn take_happened(&mut self) -> Vec<FaultEvent> {
        self.faults.take_happened()
    }

    /// The faults and expectations of the run.
    pub fn faults(&self) -> &FaultEngine {
        &self.faults
    }

    /// Adds a fault from the next sample on; what was added, as a plan that is run again must have it.
    pub fn inject(&mut self, mut fault: Fault) -> Fault {
        fault.at_s = fault.at_s.max(self.next_start_s());
        self.faults.add(fault.clone());
        fault
    }

    /// Starts an operator-triggered fault with the next sample or at its own time. Returns that on-board time; `None` for
    /// an unknown fault, or if its end has passed.
    pub fn start(&mut self, id: &str) -> Option<f64> {
        self.faults.start(id, self.next_start_s())
    }

    /// Ends a fault from the next sample on. Returns that on-board time; `None` for an unknown fault.
    pub fn clear(&mut self, id: &str) -> Option<f64> {
        let until_s = self.next_start_s();
        self.faults.clear(id, until_s).then_some(until_s)
    }

    /// On-board time at which the next sample starts.
    fn next_start_s(&self) -> f64 {
        self.configuration.device.on_board_s(self.ended + 1)
    }

    /// Keeps the unit without faults from running away in true time: how far its clock may be behind this unit's.
    pub(super) fn hold_clean(&mut self) {
        if let Some(clean) = &mut self.clean {
            let behind_fs = (CLEAN_BEHIND * self.configuration.device.interval_s * FS) as i128;
            clean.end_fs = clean.end_fs.min(self.end_fs + behind_fs);
        }
    }

    /// The effect of the active faults on the sample.
    pub(super) fn compare(&mut self, ended: &CompletedSample) -> Option<Arc<InjectionRecord>> {
        let clean = self.clean.as_mut().map(|clean| clean.end_sample());
        if self.faults.acting().is_empty() {
            return None;
        }
        let clean = clean.unwrap_or(*ended);
        Some(Arc::new(InjectionRecord { clean, acting: self.faults.acting().clone() }))
    }

    /// Begins a sample: which faults act over it.
    pub(super) fn begin_faults(&mut self) {
        if self.faults.is_empty() {
            return;
        }
        let mut now = self.moment();
        for (law, gyro) in self.faults.begin(&mut now, self.last) {
            self.recover(law, gyro);
        }
        if !self.faults.touch_unit() {
            self.clean = None;
        } else if self.clean.is_none() {
            let mut clean = GyroUnit { faults: FaultEngine::default(), injected: None, ..self.clone() };
            clean.begin();
            self.clean = Some(Box::new(clean));
        }
        for (law, elapsed) in self.faults.on_unit() {
            match law {
                UnitFault::BrownOut => self.channels.iter_mut().for_each(|channel| channel.power = Power::Off),
                UnitFault::ClockJump { cycles } if elapsed == 0 => {
                    let modulus = CLOCK_MODULUS as i64;
                    self.clock_count = (self.clock_count as i64 + cycles).rem_euclid(modulus) as u64;
                }
                _ => {}
            }
        }
    }

    fn recover(&mut self, law: FaultAction, gyro: Option<Gyro>) {
        let samples = self.spin_up_samples();
        let spin_up = |channel: &mut Channel| channel.power = Power::On(samples);
        match law {
            FaultAction::Head(GyroFault::SpinDown { .. }) => {
                let own = gyro.map(|gyro| &mut self.channels[gyro.index()]);
                own.filter(|channel| matches!(channel.power, Power::On(_))).map(spin_up);
            }
            FaultAction::Unit(law @ (UnitFault::Reset | UnitFault::BrownOut | UnitFault::BootDelay)) => {
                (self.sequence, self.clock_count, self.polled) = (u64::MAX, 0, false);
                (self.self_test, self.last) = (None, None);
                if law == UnitFault::BrownOut {
                    self.sensor.heater_on = true;
                    self.channels.iter_mut().for_each(spin_up);
                }
            }
            _ => {}
        }
    }

    /// Inputs of conditions at the start of the sample interval.
    fn moment(&self) -> ConditionInputs {
        let (truth, last) = (self.motion.now(), self.last.unwrap_or_default());
        let angle = |rad: f64| if self.motion.knows_sun() { rad / RAD_PER_DEG } else { f64::NAN };
        ConditionInputs {
            t_s: self.configuration.device.on_board_s(self.ended),
            frame: self.ended,
            sequence: self.sequence.wrapping_add(1) as u16,
            rate_arcsec_s: truth.rate_control_arcsec_s,
            theta_deg: angle(truth.theta_rad),
            psi_deg: angle(truth.psi_rad),
            electronics_c: self.temperatures(self.start_fs as f64 * 1e-15).electronics_c,
            sensor_c: self.sensor.temperature_c,
            is_polled: self.polled,
            outputs: last.outputs,
            commands: self.heard.clone(),
            active: Vec::new(),
        }
    }
}
