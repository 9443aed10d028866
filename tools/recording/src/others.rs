//! Identifiers before the first row, and the likely base of the unit.

use std::collections::BTreeSet;

use geu_protocol::CanIdMap;
use geu_protocol::can::close_status;
use geu_protocol::capture::Frame;

const IDS: usize = 1 << 11;

/// Data frames of eleven bits, until the first row.
#[derive(Debug, Default)]
pub struct Others(Vec<Seen>);

#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    frames: u64,
    /// Number of STATUS among them: their CRC covers the last frame of the identifier before.
    status: u64,
    last: [u8; 8],
}

impl Others {
    #[cold]
    pub(crate) fn push(&mut self, frame: &Frame) {
        if frame.extended {
            return;
        }
        self.0.resize(IDS, Seen::default());
        let (id, data) = (frame.id as usize % IDS, frame.data);
        let before = id.checked_sub(1).map(|before| self.0[before]).filter(|before| before.frames > 0);
        let seen = &mut self.0[id];
        seen.frames += 1;
        let Ok(data) = <[u8; 8]>::try_from(data) else { return };
        seen.last = data;
        let mut closed = data;
        seen.status += u64::from(before.is_some_and(|before| {
            close_status(&before.last, &mut closed);
            closed == data
        }));
    }

    pub fn ids(&self) -> BTreeSet<u16> {
        (0..).zip(&self.0).filter(|(_, seen)| seen.frames > 0).map(|(id, _)| id).collect()
    }

    /// The base with most STATUS frames; `None` if they are a minority of every identifier.
    pub fn likely(&self) -> Option<CanIdMap> {
        let statuses = (0..).zip(&self.0).filter(|(_, seen)| seen.status * 2 > seen.frames);
        statuses.max_by_key(|(_, seen)| seen.status).and_then(|(id, _): (u16, _)| CanIdMap::with_base(id - 1))
    }
}

#[cfg(test)]
mod tests {
    use geu_protocol::Sample;

    use super::*;

    #[test]
    fn the_base_is_where_the_crc_matches_and_not_where_it_does_by_accident() {
        let (mut others, plan) = (Others::default(), CanIdMap::with_base(0x300).expect("a base"));
        let increments = [[1; 8], [2; 8], [3; 8]];
        let push = |others: &mut Others, id, data: &[u8]| {
            others.push(&Frame { time: None, interface: b"", id, extended: false, data });
        };
        for increments in increments {
            let mut status = [7; 8];
            if increments == [1; 8] {
                close_status(&increments, &mut status);
            }
            push(&mut others, 0x100, &increments);
            push(&mut others, 0x101, &status);
        }
        assert!(others.likely().is_none());
        for frame in plan.frames(&Sample::default()) {
            push(&mut others, frame.id(), frame.data());
        }
        assert_eq!(others.likely(), Some(plan));
        assert_eq!(others.ids(), [0x100, 0x101, 0x300, 0x301, 0x302].into());
    }
}
