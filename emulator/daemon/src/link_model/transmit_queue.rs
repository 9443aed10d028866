//! When transmissions are due.

use std::collections::{BTreeMap, VecDeque};

use geu_model::units::SAMPLE_INTERVAL_NS;

use super::transmission::{Transmission, WireData};

/// Pieces that wait. Messages may leave in another order than they came in; a frame that has begun is finished before
/// anything else leaves, for a line cannot overtake itself.
#[derive(Debug, Default)]
pub(crate) struct TransmitQueue {
    /// For a sample that has not ended: by its index, then in the order in which they came.
    held: BTreeMap<u64, Vec<Vec<Transmission>>>,
    /// By on-board time at which they are due, ns, and order; each part with its own time.
    due: BTreeMap<(i64, u64), VecDeque<(i64, WireData)>>,
    /// The rest of the frame that has begun.
    begun: VecDeque<(i64, WireData)>,
    /// When something left last, ns.
    left_ns: i64,
    /// Index of the sample that comes next.
    next_frame: u64,
    count: u64,
}

impl TransmitQueue {
    /// Adds the transmissions of sample `frame`, which ends at `end_ns`.
    pub fn put(&mut self, transmissions: Vec<Transmission>, frame: u64, end_ns: i64) {
        self.next_frame = frame.saturating_add(1);
        while let Some(entry) = self.held.first_entry()
            && *entry.key() <= frame
        {
            let messages = entry.remove();
            self.schedule(messages, end_ns);
        }
        let mut messages: Vec<Vec<Transmission>> = Vec::new();
        for transmission in transmissions {
            match messages.last_mut() {
                Some(message) if message.last().is_some_and(|it| it.more_fragments) => message.push(transmission),
                _ => messages.push(vec![transmission]),
            }
        }
        let (later, now): (Vec<_>, Vec<_>) = messages.into_iter().partition(|message| message[0].frame > frame);
        self.schedule(now, end_ns);
        later.into_iter().for_each(|message| self.held.entry(message[0].frame).or_default().push(message));
    }

    /// The run ends with the sample that ended at `end_ns`: what was held for one that does not come is due when that
    /// would have ended.
    pub fn end(&mut self, end_ns: i64) {
        for (frame, messages) in std::mem::take(&mut self.held) {
            let more = frame.saturating_add(1).saturating_sub(self.next_frame) as i64;
            self.schedule(messages, end_ns.saturating_add(more.saturating_mul(SAMPLE_INTERVAL_NS)));
        }
    }

    /// Gives messages of a sample that ended at `end_ns` their times.
    fn schedule(&mut self, messages: Vec<Vec<Transmission>>, end_ns: i64) {
        for message in messages {
            self.count += 1;
            let due_ns = end_ns + message[0].after_ns;
            let parts = message.into_iter().map(|transmission| (end_ns + transmission.after_ns, transmission.content));
            self.due.insert((due_ns, self.count), parts.collect());
        }
    }

    /// When the next can leave, on-board time.
    pub fn next_ns(&self) -> Option<i64> {
        let next = self.begun.front().map(|(due_ns, _)| *due_ns);
        next.or_else(|| self.due.first_key_value().map(|((due_ns, _), _)| *due_ns)).map(|it| it.max(self.left_ns))
    }

    /// Takes what leaves next, all of the same time, if that is not after `until_ns`.
    pub fn take(&mut self, until_ns: i64) -> Option<(i64, Vec<WireData>)> {
        let now_ns = self.next_ns().filter(|&next_ns| next_ns <= until_ns)?;
        self.left_ns = now_ns;
        let mut contents = Vec::new();
        while self.next_ns() == Some(now_ns) {
            contents.extend(self.pop());
        }
        Some((now_ns, contents))
    }

    /// The next content, whose time has come.
    fn pop(&mut self) -> Option<WireData> {
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
        let mut queue = TransmitQueue::default();
        queue.put(
            vec![transmission(0, 0, 1), transmission(0, 600, 2), transmission(1, 1, 3), transmission(1, 0, 4)],
            0,
            500,
        );
        assert_eq!(queue.take(499), None);
        assert_eq!(queue.take(500), Some((500, vec![WireData::Bytes(vec![1])])));
        assert_eq!(queue.next_ns(), Some(1100));
        queue.put(vec![transmission(1, 0, 5)], 1, 1000);
        assert_eq!(all(&mut queue), [(1000, bytes(&[4, 5])), (1001, bytes(&[3])), (1100, bytes(&[2]))]);
    }

    #[test]
    fn a_frame_that_has_begun_is_finished_before_anything_else_leaves() {
        let head = |after_ns, byte| Transmission { more_fragments: true, ..transmission(0, after_ns, byte) };
        let mut queue = TransmitQueue::default();
        queue.put(vec![head(0, 1), transmission(0, 700, 2)], 0, 500);
        assert_eq!(queue.take(500), Some((500, bytes(&[1]))));
        assert!(queue.is_within_frame());
        // Another that has a gap too, and one that has none, while the first is not through.
        queue.put(vec![head(0, 3), transmission(0, 700, 4)], 1, 1000);
        queue.put(vec![transmission(0, 0, 5)], 2, 1500);
        assert_eq!(queue.take(1199), None);
        assert_eq!(all(&mut queue), [(1200, bytes(&[2, 3])), (1900, bytes(&[4, 5]))]);
    }

    #[test]
    fn what_is_held_for_a_sample_that_never_comes_is_due_when_it_would_have_ended() {
        let mut queue = TransmitQueue::default();
        queue.put(vec![transmission(9, 0, 1), transmission(8, 1, 2), transmission(0, 60, 3)], 0, 500);
        queue.end(500);
        let (eighth, ninth) = (500 + 8 * SAMPLE_INTERVAL_NS + 1, 500 + 9 * SAMPLE_INTERVAL_NS);
        assert_eq!(all(&mut queue), [(560, bytes(&[3])), (eighth, bytes(&[2])), (ninth, bytes(&[1]))]);
    }

    #[test]
    fn times_never_go_back_whatever_comes_late() {
        let mut queue = TransmitQueue::default();
        queue.put(vec![transmission(0, 10, 1)], 0, 500);
        assert_eq!(queue.take(510), Some((510, bytes(&[1]))));
        queue.put(vec![transmission(0, 0, 2)], 0, 500);
        assert_eq!(all(&mut queue), [(510, bytes(&[2]))]);
    }

    fn transmission(frame: u64, after_ns: i64, byte: u8) -> Transmission {
        Transmission { after_ns, ..Transmission::on_time(frame, WireData::Bytes(vec![byte])) }
    }

    fn bytes(bytes: &[u8]) -> Vec<WireData> {
        bytes.iter().map(|&byte| WireData::Bytes(vec![byte])).collect()
    }

    fn all(queue: &mut TransmitQueue) -> Vec<(i64, Vec<WireData>)> {
        std::iter::from_fn(|| queue.take(i64::MAX)).collect()
    }
}
