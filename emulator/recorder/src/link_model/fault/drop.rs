//! Samples are not sent.

use geu_model::fault::catalogue::link_fault::Drop;

use super::{Blocked, LinkBehaviour};

impl LinkBehaviour for Drop {
    fn blocked(&self) -> Blocked {
        Blocked::Samples
    }
}
