//! Reading a source: tasks of the runtime that take what comes and hand it to the synchroniser, and report to the source what
//! left where it asks.
//!
//! A source that runs ahead of the unit is read no further than [`AHEAD_S`]; what it sends meanwhile waits in the kernel. 42
//! waits for its answer after every message: it is given when the running sample interval needs more, so 42 keeps the unit's
//! pace.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use nix::sys::socket::{setsockopt, sockopt};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{ReadHalf, WriteHalf};
use tokio::net::{TcpStream, UdpSocket};
use tokio::sync::mpsc::Receiver;

use super::address::TruthAddress;
use super::external_truth::ExternalTruth;
use super::forty_two::Message;
use super::json;
use super::lines::Lines;
use crate::console;

/// Further than this ahead of what the unit needs nothing is read, on-board s.
const AHEAD_S: f64 = 2.0;
/// Longest datagram, byte.
const DATAGRAM: usize = 65_536;
/// Read at a time from a server, byte.
const CHUNK: usize = 16_384;
/// A server that is not there is tried again after so long.
const TRY_AGAIN: Duration = Duration::from_millis(250);
/// A server that does not answer is not waited for any longer.
const ANSWER: Duration = Duration::from_secs(2);
/// A server is asked for a sign of life after so long, and again after so long, s.
const KEEP_ALIVE: u32 = 10;
/// One that acknowledges nothing for so long is gone, ms.
const SILENCE_MS: u32 = 60_000;
/// One that is there, but told nothing for so long while the truth is missing, is left and visited again. A simulator may
/// take its time for a step; in a run that waits for it nothing is missing.
const MUTE: Duration = Duration::from_secs(300);
/// What 42 waits for.
const ACKNOWLEDGEMENT: &[u8] = b"Ack\n";

/// Begins to read.
pub(super) fn open(live: &Arc<ExternalTruth>) -> io::Result<()> {
    let reader = live.clone();
    match live.address() {
        TruthAddress::Udp(address) => {
            let socket = std::net::UdpSocket::bind(address)?;
            let at = socket.local_addr()?;
            socket.set_nonblocking(true)?;
            let socket = Arc::new(UdpSocket::from_std(socket)?);
            let bound = live.bound.get_or_init(|| TruthAddress::Udp(at.to_string()));
            console::ready(&format!("truth {bound}"));
            tokio::spawn(report_over_udp(live.clone(), socket.clone()));
            tokio::spawn(listen(reader, socket));
        }
        TruthAddress::Tcp(address) | TruthAddress::FortyTwo(address) => {
            tokio::spawn(visit(reader, address.clone()));
        }
    }
    Ok(())
}

/// Takes datagrams, each of one or more lines.
async fn listen(live: Arc<ExternalTruth>, socket: Arc<UdpSocket>) {
    let (mut lines, mut datagram) = (Lines::default(), vec![0; DATAGRAM]);
    loop {
        live.until_wanted(AHEAD_S).await;
        let Ok((length, peer)) = socket.recv_from(&mut datagram).await else {
            tokio::time::sleep(TRY_AGAIN).await;
            continue;
        };
        let mut take = |number: u64, line: Result<&str, String>| {
            take_line(&live, format_args!("line {number}, from {peer}"), line, Some(peer));
        };
        lines.take(&datagram[..length], &mut take);
        if !datagram[..length].ends_with(b"\n") {
            lines.end(&mut take);
        }
    }
}

/// Takes a JSON line of a peer.
fn take_line(live: &ExternalTruth, place: fmt::Arguments<'_>, line: Result<&str, String>, peer: Option<SocketAddr>) {
    match line.and_then(json::line) {
        Ok(line) => {
            if line.subscribes {
                live.reports.subscribe(peer);
            }
            line.sample.into_iter().for_each(|sample| live.take(place, Ok(sample)));
        }
        Err(wrong) => live.take(place, Err(wrong)),
    }
}

/// Sends reports to whoever asked for them last.
async fn report_over_udp(live: Arc<ExternalTruth>, socket: Arc<UdpSocket>) {
    let Some(mut reports) = live.reports.receiver() else { return };
    while let Some(line) = reports.recv().await {
        let peer = *live.reports.peer();
        let sent = match peer {
            Some(peer) => socket.send_to(line.as_bytes(), peer).await.is_ok(),
            None => false,
        };
        if !sent {
            live.reports.lost();
        }
    }
}

/// Writes reports to a server. Where it does not read, this waits, and what has no room to wait is dropped.
async fn report_over_tcp(stream: &mut WriteHalf<'_>, reports: &mut Receiver<String>) -> io::Result<()> {
    while let Some(line) = reports.recv().await {
        stream.write_all(line.as_bytes()).await?;
    }
    std::future::pending().await
}

/// Connects to a server, reads it, and connects again when it is gone.
async fn visit(live: Arc<ExternalTruth>, address: String) {
    let Some(mut reports) = live.reports.receiver() else { return };
    let mut was_there = true;
    loop {
        let stream = match tokio::time::timeout(ANSWER, TcpStream::connect(&address)).await {
            Ok(stream) => stream,
            Err(_) => Err(io::ErrorKind::TimedOut.into()),
        };
        match stream {
            Ok(stream) => {
                was_there = true;
                console::say(format_args!("truth {}: connected", live.address()));
                let ended = read(&live, stream, &mut reports, MUTE).await;
                live.reports.unsubscribe();
                while reports.try_recv().is_ok() {
                    live.reports.lost();
                }
                let why = ended.err().map_or_else(|| "it closed the connection".to_owned(), |error| error.to_string());
                console::say(format_args!("truth {}: {why}; tried again until it is back", live.address()));
            }
            Err(error) if std::mem::take(&mut was_there) => {
                console::say(format_args!("truth {}: {error}; tried again until it is there", live.address()));
            }
            Err(_) => {}
        }
        tokio::time::sleep(TRY_AGAIN).await;
    }
}

/// Has the kernel notice a server that went away without a word.
fn keep_alive(stream: &TcpStream) -> io::Result<()> {
    setsockopt(stream, sockopt::KeepAlive, &true)?;
    setsockopt(stream, sockopt::TcpKeepIdle, &KEEP_ALIVE)?;
    setsockopt(stream, sockopt::TcpKeepInterval, &KEEP_ALIVE)?;
    setsockopt(stream, sockopt::TcpUserTimeout, &SILENCE_MS)?;
    Ok(())
}

/// Reads a server to its end, or until it was `mute` for too long. Not so 42: it takes one connection and no other, and
/// stands still while somebody looks at it.
async fn read(
    live: &ExternalTruth,
    mut stream: TcpStream,
    reports: &mut Receiver<String>,
    mute: Duration,
) -> io::Result<()> {
    stream.set_nodelay(true)?;
    keep_alive(&stream)?;
    let (mut reader, mut writer) = stream.split();
    match live.address() {
        TruthAddress::FortyTwo(_) => read_lines(live, &mut reader, Some(&mut writer), mute).await,
        _ => tokio::select! {
            ended = read_lines(live, &mut reader, None, mute) => ended,
            failed = report_over_tcp(&mut writer, reports) => failed,
        },
    }
}

/// Reads the lines of a server; of 42 where there is something to acknowledge its messages on.
async fn read_lines(
    live: &ExternalTruth,
    reader: &mut ReadHalf<'_>,
    mut forty_two: Option<&mut WriteHalf<'_>>,
    mute: Duration,
) -> io::Result<()> {
    let is_forty_two = forty_two.is_some();
    let (mut lines, mut message, mut chunk) = (Lines::default(), Message::default(), vec![0; CHUNK]);
    loop {
        if !is_forty_two {
            live.until_wanted(AHEAD_S).await;
        }
        let length = loop {
            match tokio::time::timeout(mute, reader.read(&mut chunk)).await {
                Ok(length) => break length?,
                Err(_) if live.is_missing() && !is_forty_two => {
                    let why = format!("it told nothing for {} s", mute.as_secs());
                    return Err(io::Error::new(io::ErrorKind::TimedOut, why));
                }
                Err(_) => {}
            }
        };
        if length == 0 {
            return Ok(());
        }
        let mut messages = 0;
        lines.take(&chunk[..length], |number, line| {
            let place = format_args!("line {number}");
            if !is_forty_two {
                take_line(live, place, line, None);
                return;
            }
            let read = match line {
                Ok(line) => message.line(line),
                Err(wrong) => Some(Err(wrong)),
            };
            let Some(read) = read else { return };
            messages += 1;
            live.take(place, read);
        });
        let Some(answers) = &mut forty_two else { continue };
        for _ in 0..messages {
            live.until_wanted(0.0).await;
            answers.write_all(ACKNOWLEDGEMENT).await?;
        }
    }
}

#[cfg(test)]
mod tests {
    use geu_model::attitude::TruthNumbers;
    use nix::sys::socket::getsockopt;
    use tokio::net::TcpListener;

    use super::*;

    #[tokio::test]
    async fn a_server_that_went_away_without_a_word_is_noticed() {
        for (is_forty_two, line) in
            [(false, "{\"t_s\": 1.0, \"rate_arcsec_s\": [0.0, 0.0, 0.0]}\n"), (true, "[ENDMSG]\n")]
        {
            let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
            let address = listener.local_addr().expect("an address").to_string();
            let stream = TcpStream::connect(&address).await.expect("a server");
            let (mut server, _) = listener.accept().await.expect("a client");
            keep_alive(&stream).expect("options");
            assert!(getsockopt(&stream, sockopt::KeepAlive).expect("an option"));
            assert_eq!(getsockopt(&stream, sockopt::TcpUserTimeout).expect("an option"), SILENCE_MS);

            let address = if is_forty_two { TruthAddress::FortyTwo(address) } else { TruthAddress::Tcp(address) };
            let live = ExternalTruth::new(address, TruthNumbers::default());
            let reader = live.clone();
            let mute = Duration::from_millis(50);
            let mut reports = live.reports.receiver().expect("the first");
            let reading = tokio::spawn(async move { read(&reader, stream, &mut reports, mute).await });
            server.write_all(line.as_bytes()).await.expect("sent");
            tokio::time::sleep(6 * mute).await;
            assert!(!reading.is_finished(), "nothing is missing: the unit has not run yet");
            live.finish(20.0, false, None, || false);
            tokio::time::sleep(6 * mute).await;
            assert_eq!(reading.is_finished(), !is_forty_two);
            if !is_forty_two {
                let error = reading.await.expect("no panic").expect_err("it told nothing");
                assert_eq!(error.kind(), io::ErrorKind::TimedOut);
            }
        }
    }
}
