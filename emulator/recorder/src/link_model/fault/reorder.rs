//! Swaps each two consecutive samples.

use geu_model::fault::catalogue::link_fault::Reorder;

use super::{Context, LinkBehaviour, Schedule};

impl LinkBehaviour for Reorder {
    fn schedule(&self, schedule: &mut Schedule, context: &Context) {
        if context.acting.elapsed.is_multiple_of(2) {
            // Just after the next.
            schedule.transmissions.iter_mut().for_each(|it| (it.frame, it.after_ns) = (it.frame + 1, it.after_ns + 1));
        }
    }
}
