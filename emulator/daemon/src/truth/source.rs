//! Tasks that read a source, pass its samples to the synchroniser, and send it reports if it subscribed.
//!
//! A source that runs ahead of the unit is read no further than [`AHEAD_S`]; the rest waits in the kernel. 42 waits for an
//! acknowledgement of each message: it is sent when the running sample interval needs more, so 42 keeps the unit's pace.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{ReadHalf, WriteHalf};
use tokio::net::{TcpStream, UdpSocket};
use tokio::sync::mpsc::Receiver;

use super::address::{Scheme, TruthAddress};
use super::external_truth::ExternalTruth;
use super::forty_two::Message;
use super::json;
use super::lines::Lines;
use crate::console;
use crate::link::tcp::keep_alive;

/// Maximum time of read samples ahead of the unit, on-board s.
const AHEAD_S: f64 = 2.0;
/// Maximum length of a datagram, byte.
const DATAGRAM: usize = 65_536;
/// Maximum length of a read from a server, byte.
const CHUNK: usize = 16_384;
/// Pause before the next connection attempt.
const RETRY_INTERVAL: Duration = Duration::from_millis(250);
/// Timeout of a connection attempt.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);
/// Time without data, while the truth is missing, after which a server is reconnected. A simulator may need long for a
/// step; in a run that waits for it the truth is not missing.
const SILENCE_TIMEOUT: Duration = Duration::from_secs(300);
/// Answer to a message of 42.
const ACKNOWLEDGEMENT: &[u8] = b"Ack\n";

/// Starts the tasks.
pub(super) fn open(live: &Arc<ExternalTruth>) -> io::Result<()> {
    let TruthAddress { scheme, host_port } = live.address().clone();
    if scheme != Scheme::Udp {
        tokio::spawn(connect(live.clone(), host_port));
        return Ok(());
    }
    let socket = std::net::UdpSocket::bind(host_port)?;
    let host_port = socket.local_addr()?.to_string();
    socket.set_nonblocking(true)?;
    let socket = Arc::new(UdpSocket::from_std(socket)?);
    console::ready(&format!("truth {}", live.bound.get_or_init(|| TruthAddress { scheme, host_port })));
    tokio::spawn(report_over_udp(live.clone(), socket.clone()));
    tokio::spawn(listen(live.clone(), socket));
    Ok(())
}

/// Receives datagrams, each of one or more lines.
async fn listen(live: Arc<ExternalTruth>, socket: Arc<UdpSocket>) {
    let (mut lines, mut datagram) = (Lines::default(), vec![0; DATAGRAM]);
    loop {
        live.until_needed(AHEAD_S).await;
        let Ok((length, peer)) = socket.recv_from(&mut datagram).await else {
            tokio::time::sleep(RETRY_INTERVAL).await;
            continue;
        };
        let mut on_line = |number: u64, line: Result<&str, String>| {
            push_line(&live, format_args!("line {number}, from {peer}"), line, Some(peer));
        };
        lines.push(&datagram[..length], &mut on_line);
        if !datagram[..length].ends_with(b"\n") {
            lines.end(&mut on_line);
        }
    }
}

/// Adds the sample of a JSON line.
fn push_line(live: &ExternalTruth, place: fmt::Arguments<'_>, line: Result<&str, String>, peer: Option<SocketAddr>) {
    match line.and_then(json::line) {
        Ok(line) => {
            if line.subscribes {
                live.reports.subscribe(peer);
            }
            line.sample.into_iter().for_each(|sample| live.push(place, Ok(sample)));
        }
        Err(error) => live.push(place, Err(error)),
    }
}

/// Sends reports to the last subscriber.
async fn report_over_udp(live: Arc<ExternalTruth>, socket: Arc<UdpSocket>) {
    let Some(mut reports) = live.reports.receiver() else { return };
    while let Some(line) = reports.recv().await {
        let peer = *live.reports.peer();
        if let Some(peer) = peer
            && socket.send_to(line.as_bytes(), peer).await.is_ok()
        {
            continue;
        }
        live.reports.count_lost();
    }
}

/// Connects to a server, reads it, and reconnects when the connection ends.
async fn connect(live: Arc<ExternalTruth>, address: String) {
    let Some(mut reports) = live.reports.receiver() else { return };
    let mut was_reachable = true;
    loop {
        let stream = tokio::time::timeout(CONNECT_TIMEOUT, TcpStream::connect(&address)).await;
        match stream.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into())) {
            Ok(stream) => {
                was_reachable = true;
                live.log(format_args!("connected"));
                let ended = read(&live, stream, &mut reports, SILENCE_TIMEOUT).await;
                live.reports.unsubscribe();
                while reports.try_recv().is_ok() {
                    live.reports.count_lost();
                }
                let why = ended.err().map_or_else(|| "it closed the connection".to_owned(), |error| error.to_string());
                live.log(format_args!("{why}; reconnecting"));
            }
            Err(error) if std::mem::take(&mut was_reachable) => {
                live.log(format_args!("{error}; retrying"));
            }
            Err(_) => {}
        }
        tokio::time::sleep(RETRY_INTERVAL).await;
    }
}

/// Reads a server to its end, or until it was silent for `silence`. Not so 42: it accepts a single connection, and may be
/// paused by its user.
async fn read(
    live: &ExternalTruth,
    mut stream: TcpStream,
    reports: &mut Receiver<String>,
    silence: Duration,
) -> io::Result<()> {
    stream.set_nodelay(true)?;
    keep_alive(&stream)?;
    let (mut reader, mut writer) = stream.split();
    if live.address().scheme == Scheme::FortyTwo {
        return read_lines(live, &mut reader, Some(&mut writer), silence).await;
    }
    // If the server does not read, this waits and the queue drops reports.
    let write_reports = async {
        while let Some(line) = reports.recv().await {
            writer.write_all(line.as_bytes()).await?;
        }
        std::future::pending().await
    };
    tokio::select! {
        ended = read_lines(live, &mut reader, None, silence) => ended,
        failed = write_reports => failed,
    }
}

/// Reads the lines of a server; those of 42 if there is a writer for acknowledgements.
async fn read_lines(
    live: &ExternalTruth,
    reader: &mut ReadHalf<'_>,
    mut forty_two: Option<&mut WriteHalf<'_>>,
    silence: Duration,
) -> io::Result<()> {
    let is_forty_two = forty_two.is_some();
    let (mut lines, mut message, mut chunk) = (Lines::default(), Message::default(), vec![0; CHUNK]);
    loop {
        if !is_forty_two {
            live.until_needed(AHEAD_S).await;
        }
        let length = loop {
            match tokio::time::timeout(silence, reader.read(&mut chunk)).await {
                Ok(length) => break length?,
                Err(_) if live.is_missing() && !is_forty_two => {
                    let why = format!("it sent nothing for {} s", silence.as_secs());
                    return Err(io::Error::new(io::ErrorKind::TimedOut, why));
                }
                Err(_) => {}
            }
        };
        if length == 0 {
            return Ok(());
        }
        let mut messages = 0;
        lines.push(&chunk[..length], |number, line| {
            let place = format_args!("line {number}");
            if !is_forty_two {
                push_line(live, place, line, None);
                return;
            }
            let read = match line {
                Ok(line) => message.line(line),
                Err(error) => Some(Err(error)),
            };
            let Some(read) = read else { return };
            messages += 1;
            live.push(place, read);
        });
        let Some(answers) = &mut forty_two else { continue };
        for _ in 0..messages {
            live.until_needed(0.0).await;
            answers.write_all(ACKNOWLEDGEMENT).await?;
        }
    }
}

#[cfg(test)]
mod tests {
    use geu_model::attitude::TruthNumbers;
    use nix::sys::socket::{getsockopt, sockopt};
    use tokio::net::TcpListener;

    use super::*;
    use crate::link::tcp::ACKNOWLEDGE_TIMEOUT_MS;

    #[tokio::test]
    async fn vanished_or_silent_servers_are_detected() {
        for (is_forty_two, line) in
            [(false, "{\"t_s\": 1.0, \"rate_arcsec_s\": [0.0, 0.0, 0.0]}\n"), (true, "[ENDMSG]\n")]
        {
            let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
            let address = listener.local_addr().expect("an address").to_string();
            let stream = TcpStream::connect(&address).await.expect("a server");
            let (mut server, _) = listener.accept().await.expect("a client");
            keep_alive(&stream).expect("options");
            assert!(getsockopt(&stream, sockopt::KeepAlive).expect("an option"));
            assert_eq!(getsockopt(&stream, sockopt::TcpUserTimeout).expect("an option"), ACKNOWLEDGE_TIMEOUT_MS);

            let scheme = if is_forty_two { Scheme::FortyTwo } else { Scheme::Tcp };
            let address = TruthAddress { scheme, host_port: address };
            let live = ExternalTruth::new(address, TruthNumbers::default());
            let reader = live.clone();
            let silence = Duration::from_millis(50);
            let mut reports = live.reports.receiver().expect("the first");
            let reading = tokio::spawn(async move { read(&reader, stream, &mut reports, silence).await });
            server.write_all(line.as_bytes()).await.expect("sent");
            tokio::time::sleep(6 * silence).await;
            assert!(!reading.is_finished(), "not missing: the unit has not run yet");
            live.finish(20.0, false, None, || false);
            tokio::time::sleep(6 * silence).await;
            assert_eq!(reading.is_finished(), !is_forty_two);
            if !is_forty_two {
                let error = reading.await.expect("no panic").expect_err("it sent nothing");
                assert_eq!(error.kind(), io::ErrorKind::TimedOut);
            }
        }
    }
}
