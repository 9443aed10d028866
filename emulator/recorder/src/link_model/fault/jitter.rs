//! Samples are sent late, each by a delay drawn from a uniform distribution.

use geu_model::fault::catalogue::link_fault::Jitter;

use super::{Context, LinkBehaviour, Schedule, ns};

impl LinkBehaviour for Jitter {
    fn schedule(&self, schedule: &mut Schedule, context: &Context) {
        schedule.delay(ns(self.jitter_s * context.draw().uniform()));
    }
}
