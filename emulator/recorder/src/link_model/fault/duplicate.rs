//! Samples are sent more than once.

use geu_model::fault::catalogue::link_fault::Duplicate;

use super::{Context, LinkBehaviour, MAX_TRANSMISSIONS, Schedule};

impl LinkBehaviour for Duplicate {
    fn schedule(&self, schedule: &mut Schedule, _: &Context) {
        let Schedule { transmissions, repeats } = schedule;
        let once = transmissions[..transmissions.len() / *repeats].to_vec();
        let capacity = (MAX_TRANSMISSIONS / once.len().max(1)).saturating_sub(*repeats);
        let copies = capacity.min(self.copies as usize);
        (0..copies).for_each(|_| transmissions.extend(once.iter().cloned()));
        *repeats += copies;
    }
}
