//! When pieces are due.

use std::collections::{BTreeMap, VecDeque};

use geu_model::units::HALF_SECOND_NS;

use super::{Content, Piece};

/// Pieces that wait. Messages may leave in another order than they came in; a frame that has begun is finished before
/// anything else leaves, for a line cannot overtake itself.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    /// For a half second that has not ended: by its index, then in the order in which they came.
    held: BTreeMap<u64, Vec<Vec<Piece>>>,
    /// By on-board time at which they are due, ns, and order; each part with its own time.
    due: BTreeMap<(i64, u64), VecDeque<(i64, Content)>>,
    /// The rest of the frame that has begun.
    begun: VecDeque<(i64, Content)>,
    /// When something left last, ns.
    left_ns: i64,
    /// Index of the half second that comes next.
    next_frame: u64,
    count: u64,
}

impl Outbox {
    /// Takes the pieces of half second `frame`, which ends at `end_ns`, in.
    pub fn put(&mut self, pieces: &[Piece], frame: u64, end_ns: i64) {
        self.next_frame = frame.saturating_add(1);
        for message in pieces.chunk_by(|piece, _| piece.goes_on) {
            self.held.entry(message[0].frame.max(frame)).or_default().push(message.to_vec());
        }
        while let Some(entry) = self.held.first_entry()
            && *entry.key() <= frame
        {
            let messages = entry.remove();
            self.schedule(messages, end_ns);
        }
    }

    /// The run ends with the half second that ended at `end_ns`: what was held for one that does not come is due when that
    /// would have ended.
    pub fn end(&mut self, end_ns: i64) {
        for (frame, messages) in std::mem::take(&mut self.held) {
            let more = frame.saturating_add(1).saturating_sub(self.next_frame) as i64;
            self.schedule(messages, end_ns.saturating_add(more.saturating_mul(HALF_SECOND_NS)));
        }
    }

    /// Gives messages of a half second that ended at `end_ns` their times.
    fn schedule(&mut self, messages: Vec<Vec<Piece>>, end_ns: i64) {
        for message in messages {
            self.count += 1;
            let due_ns = end_ns + message[0].after_ns;
            let parts = message.into_iter().map(|piece| (end_ns + piece.after_ns, piece.content));
            self.due.insert((due_ns, self.count), parts.collect());
        }
    }

    /// When the next can leave, on-board time.
    pub fn next_ns(&self) -> Option<i64> {
        let next = self.begun.front().map(|(due_ns, _)| *due_ns);
        next.or_else(|| self.due.first_key_value().map(|((due_ns, _), _)| *due_ns)).map(|it| it.max(self.left_ns))
    }

    /// Takes what leaves next, all of the same time, if that is not after `until_ns`.
    pub fn take(&mut self, until_ns: i64) -> Option<(i64, Vec<Content>)> {
        let now_ns = self.next_ns().filter(|&next_ns| next_ns <= until_ns)?;
        self.left_ns = now_ns;
        let mut contents = Vec::new();
        while self.next_ns() == Some(now_ns) {
            contents.extend(self.pop());
        }
        Some((now_ns, contents))
    }

    /// The next content, whose time has come.
    fn pop(&mut self) -> Option<Content> {
        if self.begun.is_empty() {
            let ((due_ns, _), parts) = self.due.pop_first()?;
            // What waited for others keeps its gaps.
            let late_ns = self.left_ns - due_ns;
            self.begun = parts.into_iter().map(|(part_ns, content)| (part_ns + late_ns, content)).collect();
        }
        self.begun.pop_front().map(|(_, content)| content)
    }

    /// Whether the frame that left last goes on: only its rest can leave.
    pub fn is_within_frame(&self) -> bool {
        !self.begun.is_empty()
    }

    /// Messages that have a time, and wait for it.
    pub fn len(&self) -> usize {
        self.due.len() + usize::from(self.is_within_frame())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_come_out_when_they_are_due_in_order() {
        let mut outbox = Outbox::default();
        outbox.put(&[piece(0, 0, 1), piece(0, 600, 2), piece(1, 1, 3), piece(1, 0, 4)], 0, 500);
        assert_eq!(outbox.take(499), None);
        assert_eq!(outbox.take(500), Some((500, vec![Content::Bytes(vec![1])])));
        assert_eq!(outbox.next_ns(), Some(1100));
        outbox.put(&[piece(1, 0, 5)], 1, 1000);
        assert_eq!(all(&mut outbox), [(1000, bytes(&[4, 5])), (1001, bytes(&[3])), (1100, bytes(&[2]))]);
    }

    #[test]
    fn a_frame_that_has_begun_is_finished_before_anything_else_leaves() {
        let head = |after_ns, byte| Piece { goes_on: true, ..piece(0, after_ns, byte) };
        let mut outbox = Outbox::default();
        outbox.put(&[head(0, 1), piece(0, 700, 2)], 0, 500);
        assert_eq!(outbox.take(500), Some((500, bytes(&[1]))));
        assert!(outbox.is_within_frame());
        // Another that has a gap too, and one that has none, while the first is not through.
        outbox.put(&[head(0, 3), piece(0, 700, 4)], 1, 1000);
        outbox.put(&[piece(0, 0, 5)], 2, 1500);
        assert_eq!(outbox.take(1199), None);
        assert_eq!(all(&mut outbox), [(1200, bytes(&[2, 3])), (1900, bytes(&[4, 5]))]);
    }

    #[test]
    fn what_is_held_for_a_half_second_that_never_comes_is_due_when_it_would_have_ended() {
        let mut outbox = Outbox::default();
        outbox.put(&[piece(9, 0, 1), piece(8, 1, 2), piece(0, 60, 3)], 0, 500);
        outbox.end(500);
        let (eighth, ninth) = (500 + 8 * HALF_SECOND_NS + 1, 500 + 9 * HALF_SECOND_NS);
        assert_eq!(all(&mut outbox), [(560, bytes(&[3])), (eighth, bytes(&[2])), (ninth, bytes(&[1]))]);
    }

    #[test]
    fn times_never_go_back_whatever_comes_late() {
        let mut outbox = Outbox::default();
        outbox.put(&[piece(0, 10, 1)], 0, 500);
        assert_eq!(outbox.take(510), Some((510, bytes(&[1]))));
        outbox.put(&[piece(0, 0, 2)], 0, 500);
        assert_eq!(all(&mut outbox), [(510, bytes(&[2]))]);
    }

    fn piece(frame: u64, after_ns: i64, byte: u8) -> Piece {
        Piece { after_ns, ..Piece::on_time(frame, Content::Bytes(vec![byte])) }
    }

    fn bytes(bytes: &[u8]) -> Vec<Content> {
        bytes.iter().map(|&byte| Content::Bytes(vec![byte])).collect()
    }

    fn all(outbox: &mut Outbox) -> Vec<(i64, Vec<Content>)> {
        std::iter::from_fn(|| outbox.take(i64::MAX)).collect()
    }
}
