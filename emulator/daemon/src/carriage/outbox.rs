//! When pieces are due.

use std::collections::BTreeMap;

use super::{Content, Piece};

/// Pieces that wait.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    /// For a half second that has not ended: by its index, then in the order in which they came.
    held: BTreeMap<u64, Vec<Piece>>,
    /// By on-board time at which they are due, ns, and order.
    due: BTreeMap<(i64, u64), Content>,
    count: u64,
}

impl Outbox {
    /// Takes the pieces of half second `frame`, which ends at `end_ns`, in.
    pub fn put(&mut self, pieces: Vec<Piece>, frame: u64, end_ns: i64) {
        for piece in pieces {
            self.held.entry(piece.frame.max(frame)).or_default().push(piece);
        }
        while let Some(entry) = self.held.first_entry()
            && *entry.key() <= frame
        {
            for piece in entry.remove() {
                self.count += 1;
                self.due.insert((end_ns + piece.after_ns, self.count), piece.content);
            }
        }
    }

    /// When the next is due, on-board time.
    pub fn next_ns(&self) -> Option<i64> {
        self.due.first_key_value().map(|((due_ns, _), _)| *due_ns)
    }

    /// Takes what is due next, all of the same time, if that is not after `until_ns`.
    pub fn take(&mut self, until_ns: i64) -> Option<(i64, Vec<Content>)> {
        let due_ns = self.next_ns().filter(|&due_ns| due_ns <= until_ns)?;
        let mut contents = Vec::new();
        while let Some(entry) = self.due.first_entry()
            && entry.key().0 == due_ns
        {
            contents.push(entry.remove());
        }
        Some((due_ns, contents))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_come_out_when_they_are_due_in_order() {
        let piece = |frame, after_ns, byte| Piece { frame, after_ns, content: Content::Bytes(vec![byte]) };
        let mut outbox = Outbox::default();
        outbox.put(vec![piece(0, 0, 1), piece(0, 600, 2), piece(1, 1, 3), piece(1, 0, 4)], 0, 500);
        assert_eq!(outbox.take(499), None);
        assert_eq!(outbox.take(500), Some((500, vec![Content::Bytes(vec![1])])));
        assert_eq!(outbox.next_ns(), Some(1100));
        outbox.put(vec![piece(1, 0, 5)], 1, 1000);
        let mut all = Vec::new();
        while let Some(due) = outbox.take(2000) {
            all.push(due);
        }
        let bytes = |bytes: &[u8]| bytes.iter().map(|&byte| Content::Bytes(vec![byte])).collect::<Vec<_>>();
        assert_eq!(all, [(1000, bytes(&[4, 5])), (1001, bytes(&[3])), (1100, bytes(&[2]))]);
    }
}
