//! Queue of transmissions by time.

use std::collections::{BTreeMap, VecDeque};

use super::transmission::{Transmission, WireData};

/// Transmissions that wait for their time. Messages can be reordered; a frame that has begun is completed before other data.
#[derive(Debug, Default)]
pub struct TransmitQueue {
    /// Messages for a sample that has not ended, by its index.
    later: BTreeMap<u64, Vec<Vec<Transmission>>>,
    /// Messages by on-board time, ns, and order; each part with its own time.
    due: BTreeMap<(i64, u64), VecDeque<(i64, WireData)>>,
    /// Rest of the frame that has begun.
    begun: VecDeque<(i64, WireData)>,
    /// Time of the last transmission, ns.
    last_ns: i64,
    /// Index of the next sample.
    next_frame: u64,
    count: u64,
    /// Nominal interval of samples, ns.
    interval_ns: i64,
}

impl TransmitQueue {
    /// An empty queue for samples at this interval.
    pub fn new(interval_ns: i64) -> TransmitQueue {
        TransmitQueue { interval_ns, ..TransmitQueue::default() }
    }

    /// Adds the transmissions of sample `frame`, which ends at `end_ns`.
    pub fn put(&mut self, transmissions: Vec<Transmission>, frame: u64, end_ns: i64) {
        self.next_frame = frame.saturating_add(1);
        while let Some(entry) = self.later.first_entry()
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
        later.into_iter().for_each(|message| self.later.entry(message[0].frame).or_default().push(message));
    }

    /// The run ends with the sample that ended at `end_ns`: messages for a later sample are due at its nominal end.
    pub fn end(&mut self, end_ns: i64) {
        for (frame, messages) in std::mem::take(&mut self.later) {
            let more = frame.saturating_add(1).saturating_sub(self.next_frame) as i64;
            self.schedule(messages, end_ns.saturating_add(more.saturating_mul(self.interval_ns)));
        }
    }

    /// Schedules messages of a sample that ended at `end_ns`.
    fn schedule(&mut self, messages: Vec<Vec<Transmission>>, end_ns: i64) {
        for message in messages {
            self.count += 1;
            let due_ns = end_ns + message[0].after_ns;
            let parts = message.into_iter().map(|transmission| (end_ns + transmission.after_ns, transmission.content));
            self.due.insert((due_ns, self.count), parts.collect());
        }
    }

    /// Time of the next transmission, on-board time.
    pub fn next_ns(&self) -> Option<i64> {
        let next = self.begun.front().map(|(due_ns, _)| *due_ns);
        next.or_else(|| self.due.first_key_value().map(|((due_ns, _), _)| *due_ns)).map(|it| it.max(self.last_ns))
    }

    /// Removes the next data, all of the same time, if that is not after `until_ns`.
    pub fn next_due(&mut self, until_ns: i64) -> Option<(i64, Vec<WireData>)> {
        let now_ns = self.next_ns().filter(|&next_ns| next_ns <= until_ns)?;
        self.last_ns = now_ns;
        let mut contents = Vec::new();
        while self.next_ns() == Some(now_ns) {
            contents.extend(self.pop());
        }
        Some((now_ns, contents))
    }

    /// Removes the next data, which is due.
    fn pop(&mut self) -> Option<WireData> {
        if self.begun.is_empty() {
            let ((due_ns, _), parts) = self.due.pop_first()?;
            // A message that waited for others keeps its gaps.
            let late_ns = self.last_ns - due_ns;
            self.begun = parts.into_iter().map(|(part_ns, content)| (part_ns + late_ns, content)).collect();
        }
        self.begun.pop_front().map(|(_, content)| content)
    }

    /// True if the rest of the last frame is still to be sent, before any other data.
    pub fn is_within_frame(&self) -> bool {
        !self.begun.is_empty()
    }

    /// Number of scheduled messages.
    pub fn message_count(&self) -> usize {
        self.due.len() + usize::from(self.is_within_frame())
    }
}

#[cfg(test)]
mod tests {
    use geu_model::units::SAMPLE_INTERVAL_NS;

    use super::*;

    #[test]
    fn transmissions_are_due_in_order() {
        let mut queue = TransmitQueue::default();
        queue.put(
            vec![transmission(0, 0, 1), transmission(0, 600, 2), transmission(1, 1, 3), transmission(1, 0, 4)],
            0,
            500,
        );
        assert_eq!(queue.next_due(499), None);
        assert_eq!(queue.next_due(500), Some((500, vec![WireData::Bytes(vec![1])])));
        assert_eq!(queue.next_ns(), Some(1100));
        queue.put(vec![transmission(1, 0, 5)], 1, 1000);
        assert_eq!(all(&mut queue), [(1000, bytes(&[4, 5])), (1001, bytes(&[3])), (1100, bytes(&[2]))]);
    }

    #[test]
    fn a_frame_that_has_begun_is_completed_before_other_data() {
        let head = |after_ns, byte| Transmission { more_fragments: true, ..transmission(0, after_ns, byte) };
        let mut queue = TransmitQueue::default();
        queue.put(vec![head(0, 1), transmission(0, 700, 2)], 0, 500);
        assert_eq!(queue.next_due(500), Some((500, bytes(&[1]))));
        assert!(queue.is_within_frame());
        // One more with a gap, and one without, before the first is complete.
        queue.put(vec![head(0, 3), transmission(0, 700, 4)], 1, 1000);
        queue.put(vec![transmission(0, 0, 5)], 2, 1500);
        assert_eq!(queue.next_due(1199), None);
        assert_eq!(all(&mut queue), [(1200, bytes(&[2, 3])), (1900, bytes(&[4, 5]))]);
    }

    #[test]
    fn data_for_a_sample_after_the_end_is_due_at_its_nominal_end() {
        let mut queue = TransmitQueue::new(SAMPLE_INTERVAL_NS);
        queue.put(vec![transmission(9, 0, 1), transmission(8, 1, 2), transmission(0, 60, 3)], 0, 500);
        queue.end(500);
        let (eighth, ninth) = (500 + 8 * SAMPLE_INTERVAL_NS + 1, 500 + 9 * SAMPLE_INTERVAL_NS);
        assert_eq!(all(&mut queue), [(560, bytes(&[3])), (eighth, bytes(&[2])), (ninth, bytes(&[1]))]);
    }

    #[test]
    fn times_are_monotonic_with_late_data() {
        let mut queue = TransmitQueue::default();
        queue.put(vec![transmission(0, 10, 1)], 0, 500);
        assert_eq!(queue.next_due(510), Some((510, bytes(&[1]))));
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
        std::iter::from_fn(|| queue.next_due(i64::MAX)).collect()
    }
}
