//! Samples are held and sent together.

use geu_model::fault::catalogue::link_fault::Merge;

use super::{Context, LinkBehaviour, Schedule};

impl LinkBehaviour for Merge {
    fn schedule(&self, schedule: &mut Schedule, context: &Context) {
        let frames = self.frames as u64;
        let held = frames - 1 - context.acting.elapsed % frames;
        schedule.transmissions.iter_mut().for_each(|it| it.frame += held);
    }
}
