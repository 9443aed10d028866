//! Samples are held and sent together.

use geu_model::fault::catalogue::link_fault::Merge;

use super::{Context, LinkBehaviour, Schedule};

impl LinkBehaviour for Merge {
    fn schedule(&self, schedule: &mut Schedule, context: &Context) {
        let held = self.frames - 1 - context.acting.elapsed % self.frames;
        schedule.transmissions.iter_mut().for_each(|it| it.frame += held);
    }
}
