//! Samples are sent late.

use geu_model::fault::catalogue::link_fault::Delay;

use super::{Context, LinkBehaviour, Schedule, ns};

impl LinkBehaviour for Delay {
    fn schedule(&self, schedule: &mut Schedule, _: &Context) {
        schedule.delay(ns(self.delay_s));
    }
}
