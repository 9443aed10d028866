//! Neither samples nor replies are sent.

use geu_model::fault::catalogue::link_fault::Silence;

use super::{Blocked, LinkBehaviour};

impl LinkBehaviour for Silence {
    fn blocked(&self) -> Blocked {
        Blocked::Everything
    }
}
