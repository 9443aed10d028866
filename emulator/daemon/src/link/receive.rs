//! Commands in a byte stream with any other content.

use std::borrow::Cow;
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use bytes::{Buf, BytesMut};
use geu_protocol::serial::{Deframer, DeframerEvent, FrameType};
use tokio::task::yield_now;

use super::interface::LinkInfo;
use super::port::WatchedPort;
use super::stream_sender::StreamSender;
use crate::host;
use crate::shared_unit::SharedUnit;

/// After this time without a byte, a valid frame inside the apparent start of another is accepted.
const PAUSE: Duration = Duration::from_millis(4);

/// Time after a failed write in which commands that came before it are read and obeyed.
pub(super) const UNHEARD_TIMEOUT: Duration = Duration::from_secs(10);
/// Number of commands of one client before others have their turn.
const TURN: usize = 16;
/// First bytes of other network protocols: requests of HTTP, which any page in a browser can send with arbitrary bytes after
/// them, and TLS.
const FOREIGN: [(&[u8], &str); 11] = [
    (b"GET ", "HTTP"),
    (b"HEAD ", "HTTP"),
    (b"POST ", "HTTP"),
    (b"PUT ", "HTTP"),
    (b"DELETE ", "HTTP"),
    (b"OPTIONS ", "HTTP"),
    (b"PATCH ", "HTTP"),
    (b"CONNECT ", "HTTP"),
    (b"TRACE ", "HTTP"),
    (b"PRI * HTTP", "HTTP"),
    (&[0x16, 0x03], "TLS"),
];

/// Assembles commands from chunks.
#[derive(Default)]
pub(super) struct Receiver {
    /// The first bytes, while they may be the beginning of another protocol.
    first: Option<Vec<u8>>,
    deframer: Deframer,
    /// Possible start of a frame.
    partial: BytesMut,
    rejected: u64,
}

impl Receiver {
    /// Rejects clients that begin with another protocol.
    pub fn for_network() -> Receiver {
        Receiver { first: Some(Vec::new()), ..Receiver::default() }
    }

    /// Returns received bytes, with previously retained ones; none while they may be the beginning of another protocol.
    ///
    /// # Errors
    /// The beginning of another protocol.
    fn admit<'a>(&mut self, bytes: &'a [u8]) -> io::Result<Cow<'a, [u8]>> {
        let Some(first) = &mut self.first else { return Ok(bytes.into()) };
        first.extend_from_slice(bytes);
        if let Some((_, protocol)) = FOREIGN.iter().find(|(start, _)| first.starts_with(start)) {
            return Err(io::Error::new(io::ErrorKind::InvalidData, format!("speaks {protocol}, not the unit's link")));
        }
        if FOREIGN.iter().any(|(start, _)| start.starts_with(first)) {
            return Ok(Cow::default());
        }
        Ok(self.first.take().unwrap_or_default().into())
    }

    fn push(&mut self, bytes: &[u8], mut sink: impl FnMut(&[u8])) {
        self.partial.extend_from_slice(bytes);
        let rejected = &mut self.rejected;
        let used = self.deframer.consume(&self.partial, &mut |found| match found {
            DeframerEvent::Frame { kind: FrameType::Command, payload, .. } => sink(payload),
            DeframerEvent::Rejected { .. } => *rejected += 1,
            _ => {}
        });
        self.partial.advance(used);
    }

    /// No byte came for some time: if a complete frame follows the start of a frame, that start was truncated and must not
    /// consume it. Otherwise the frame may continue, on a line of any rate.
    fn pause(&mut self, mut sink: impl FnMut(&[u8])) {
        for start in 1..self.partial.len() {
            let (mut deframer, mut found_any) = (Deframer::default(), false);
            let used = deframer.consume(&self.partial[start..], &mut |found| {
                found_any |= matches!(found, DeframerEvent::Frame { .. });
                if let DeframerEvent::Frame { kind: FrameType::Command, payload, .. } = found {
                    sink(payload);
                }
            });
            if found_any {
                self.rejected += 1;
                self.deframer = deframer;
                self.partial.advance(start + used);
                return;
            }
        }
    }
}

/// Answers the commands that come over a link.
#[derive(Clone)]
pub(crate) struct CommandServer {
    pub unit: Arc<SharedUnit>,
    pub info: LinkInfo,
}

impl CommandServer {
    /// Reads and answers commands until the stream ends; an incomplete one stays in the receiver. `link`: name in recordings.
    ///
    /// # Errors
    /// An error of the device; [`io::ErrorKind::InvalidData`] from a client with another protocol.
    pub async fn serve(
        &self,
        port: &WatchedPort,
        sender: &StreamSender,
        receiver: &mut Receiver,
        link: &str,
    ) -> io::Result<()> {
        let (mut bytes, mut can_pause) = ([0; 512], false);
        let mut commands: Vec<Vec<u8>> = Vec::new();
        loop {
            let read = if can_pause {
                host::timeout(PAUSE, port.read(&mut bytes)).await
            } else {
                Some(port.read(&mut bytes).await)
            };
            let mut found = |payload: &[u8]| commands.push(payload.to_vec());
            match read {
                Some(Ok(0)) => return Ok(()),
                Some(Ok(length)) => {
                    let admitted = receiver.admit(&bytes[..length])?;
                    receiver.push(&admitted, &mut found);
                }
                Some(Err(error)) => return Err(error),
                None => receiver.pause(&mut found),
            }
            can_pause = read.is_some() && !receiver.partial.is_empty();
            self.reject(std::mem::take(&mut receiver.rejected));
            for (index, payload) in commands.drain(..).enumerate() {
                if index % TURN == TURN - 1 {
                    yield_now().await;
                }
                // Stops reading until the reply is accepted, but only while the client reads.
                sender.reply_capacity().await;
                let response = self.unit.command(link, &payload).await;
                sender.answer(self.unit.transmissions(&response, &self.info.model));
            }
            yield_now().await;
        }
    }

    /// The client is gone: counts its incomplete frame.
    pub fn end(&self, receiver: &mut Receiver) {
        self.reject(u64::from(!std::mem::take(receiver).partial.is_empty()));
    }

    fn reject(&self, frames: u64) {
        self.unit.rejected.fetch_add(frames, Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use geu_protocol::serial::{data_frame, frame};

    use super::*;

    fn commands(chunks: &[&[u8]]) -> (Vec<Vec<u8>>, u64) {
        let (mut receiver, mut found) = (Receiver::default(), Vec::new());
        for chunk in chunks {
            receiver.push(chunk, |payload| found.push(payload.to_vec()));
            receiver.pause(|payload| found.push(payload.to_vec()));
        }
        (found, receiver.rejected)
    }

    #[test]
    fn a_truncated_command_does_not_consume_the_next_valid_one() {
        let (long, good) = (frame(FrameType::Command, &[4, 1, 0, 5, 9]), frame(FrameType::Command, &[1]));
        for cut in 1..long.len() {
            let truncated = &long[..cut];
            for chunks in [&[truncated, &good][..], &[&[truncated, &good].concat()]] {
                assert_eq!(commands(chunks).0, [vec![1]], "cut after {cut}");
            }
            let both = [truncated, &good, truncated].concat();
            assert_eq!(commands(&[&both, &good]).0, [vec![1], vec![1]], "cut after {cut}");
        }
    }

    #[test]
    fn another_protocol_is_detected_by_its_first_bytes_in_any_chunks() {
        let ping = frame(FrameType::Command, &[1]);
        for foreign in [&b"POST / HTTP/1.1\r\n\r\n"[..], b"GET /", b"OPTIONS * ", b"PRI * HTTP/2.0", &[0x16, 3, 1, 2]] {
            for size in [1, 2, 3, foreign.len() + ping.len()] {
                let (mut receiver, bytes) = (Receiver::for_network(), [foreign, &ping].concat());
                let mut admitted = Vec::new();
                let end = bytes.chunks(size).try_for_each(|chunk| {
                    admitted.extend_from_slice(&receiver.admit(chunk)?);
                    io::Result::Ok(())
                });
                assert_eq!(end.map_err(|error| error.kind()), Err(io::ErrorKind::InvalidData), "{foreign:?} by {size}");
                assert!(admitted.is_empty(), "{foreign:?} by {size}");
            }
        }
        for good in [&ping[..], b"GEt", b"P\xEB\x90", &[0x16, 4]] {
            for size in [1, 2, good.len()] {
                let mut receiver = Receiver::for_network();
                let admitted: Vec<u8> = good
                    .chunks(size)
                    .flat_map(|chunk| receiver.admit(chunk).expect("no protocol").into_owned())
                    .collect();
                assert_eq!(admitted, good, "by {size}");
            }
        }
    }

    #[test]
    fn a_command_byte_by_byte_with_pauses_is_one_command() {
        let good = frame(FrameType::Command, &[2, 1]);
        let bytes: Vec<&[u8]> = good.chunks(1).collect();
        assert_eq!(commands(&bytes), (vec![vec![2, 1]], 0));
    }

    #[test]
    fn data_and_replies_are_ignored_and_a_wrong_crc_is_counted() {
        let mut wrong = frame(FrameType::Command, &[1]);
        *wrong.last_mut().unwrap() ^= 1;
        let bytes = [data_frame(&Default::default()).to_vec(), frame(FrameType::Reply, &[1, 0]), wrong].concat();
        assert_eq!(commands(&[&bytes]), (vec![], 1));
    }
}
