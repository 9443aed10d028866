//! Commands out of a byte stream, whatever else is in it.

use std::io;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use bytes::{Buf, BytesMut};
use geu_protocol::serial::{Deframer, Found, Kind};
use nix::unistd;
use tokio::io::unix::AsyncFd;
use tokio::task::yield_now;
use tokio::time::timeout;

use super::Watched;
use super::line::{Line, Port};
use crate::carriage::Carrier;
use crate::desk::Desk;

/// After so long without a byte, a good frame inside what looks like the start of another is no longer kept waiting.
const PAUSE: Duration = Duration::from_millis(4);

/// After so many commands of one client the others have their turn.
const TURN: usize = 16;

/// Puts commands together from pieces.
#[derive(Default)]
struct Receiver {
    deframer: Deframer,
    /// The start of a frame, perhaps.
    partial: BytesMut,
    rejected: u64,
}

impl Receiver {
    fn take(&mut self, bytes: &[u8], mut sink: impl FnMut(&[u8])) {
        self.partial.extend_from_slice(bytes);
        let rejected = &mut self.rejected;
        let used = self.deframer.consume(&self.partial, &mut |found| match found {
            Found::Frame { kind: Kind::Command, payload, .. } => sink(payload),
            Found::Rejected { .. } => *rejected += 1,
            _ => {}
        });
        self.partial.advance(used);
    }

    /// No byte came for a while: where a whole frame stands behind the start of a frame, that start was a cut one and
    /// must not swallow it. A start with nothing behind it may still go on, on a line as slow as it likes.
    fn pause(&mut self, mut sink: impl FnMut(&[u8])) {
        for start in 1..self.partial.len() {
            let (mut deframer, mut found_any) = (Deframer::default(), false);
            let used = deframer.consume(&self.partial[start..], &mut |found| {
                found_any |= matches!(found, Found::Frame { .. });
                if let Found::Frame { kind: Kind::Command, payload, .. } = found {
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

/// Reads commands and answers them, until the stream ends.
///
/// # Errors
/// What reading says when the device is gone.
pub(super) async fn serve(
    port: &AsyncFd<Watched<Port>>,
    line: &Line,
    desk: &Desk,
    carrier: &Carrier,
    link: &str,
) -> io::Result<()> {
    let (mut receiver, mut bytes, mut can_pause) = (Receiver::default(), [0; 512], false);
    let mut commands: Vec<Vec<u8>> = Vec::new();
    let end = loop {
        let read =
            if can_pause { timeout(PAUSE, read(port, &mut bytes)).await } else { Ok(read(port, &mut bytes).await) };
        let mut found = |payload: &[u8]| commands.push(payload.to_vec());
        match read {
            Ok(Ok(0)) => break Ok(()),
            Ok(Ok(length)) => receiver.take(&bytes[..length], &mut found),
            Ok(Err(error)) => break Err(error),
            Err(_) => receiver.pause(&mut found),
        }
        can_pause = read.is_ok() && !receiver.partial.is_empty();
        desk.rejected.fetch_add(std::mem::take(&mut receiver.rejected), Relaxed);
        for (index, payload) in commands.drain(..).enumerate() {
            if index % TURN == TURN - 1 {
                yield_now().await;
            }
            // Without room for the reply nothing more is read: a client that does not read is not served on.
            line.reply_room().await;
            let answered = desk.command(link, &payload).await;
            line.answer(&answered.leaving(carrier));
        }
        yield_now().await;
    };
    desk.rejected.fetch_add(u64::from(!receiver.partial.is_empty()), Relaxed);
    end
}

/// Reads what is there, waiting for it; 0 at the end of the stream, or after a hang-up.
async fn read(port: &AsyncFd<Watched<Port>>, bytes: &mut [u8]) -> io::Result<usize> {
    loop {
        let mut guard = port.readable().await?;
        let hung_up = guard.ready().is_read_closed();
        match guard.try_io(|port| Ok(unistd::read(&**port.get_ref(), bytes)?)) {
            Ok(result) => return result,
            // A pty that somebody reopened at once: the hang-up stays in the readiness, only a new one tells more.
            Err(_) if hung_up => return Ok(0),
            Err(_) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use geu_protocol::serial::{data_frame, frame};

    use super::*;

    fn commands(pieces: &[&[u8]]) -> (Vec<Vec<u8>>, u64) {
        let (mut receiver, mut found) = (Receiver::default(), Vec::new());
        for piece in pieces {
            receiver.take(piece, |payload| found.push(payload.to_vec()));
            receiver.pause(|payload| found.push(payload.to_vec()));
        }
        (found, receiver.rejected)
    }

    #[test]
    fn a_truncated_command_never_swallows_the_next_good_one() {
        let (long, good) = (frame(Kind::Command, &[4, 1, 0, 5, 9]), frame(Kind::Command, &[1]));
        for cut in 1..long.len() {
            let truncated = &long[..cut];
            for pieces in [&[truncated, &good][..], &[&[truncated, &good].concat()]] {
                assert_eq!(commands(pieces).0, [vec![1]], "cut after {cut}");
            }
            let both = [truncated, &good, truncated].concat();
            assert_eq!(commands(&[&both, &good]).0, [vec![1], vec![1]], "cut after {cut}");
        }
    }

    #[test]
    fn a_command_that_comes_byte_by_byte_with_pauses_is_one_command() {
        let good = frame(Kind::Command, &[2, 1]);
        let bytes: Vec<&[u8]> = good.chunks(1).collect();
        assert_eq!(commands(&bytes), (vec![vec![2, 1]], 0));
    }

    #[test]
    fn data_and_replies_are_no_commands_and_a_wrong_crc_is_counted() {
        let mut wrong = frame(Kind::Command, &[1]);
        *wrong.last_mut().unwrap() ^= 1;
        let bytes = [data_frame(&Default::default()).to_vec(), frame(Kind::Reply, &[1, 0]), wrong].concat();
        assert_eq!(commands(&[&bytes]), (vec![], 1));
    }
}
