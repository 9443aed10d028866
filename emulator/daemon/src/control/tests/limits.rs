//! Limits of bodies, streams and connections; slow clients and garbage.

use std::net::IpAddr;

use super::super::server::{CONNECTIONS, CONNECTIONS_EACH, ConnectionLimiter, HEADERS_TIMEOUT, WRITE_TIMEOUT};
use super::*;

#[test]
fn body_length_is_limited() {
    let served = served(None);
    let longest = format!(r#"{{"id": "{}"}}"#, "x".repeat(request::MAX_BODY - 10));
    assert_eq!(longest.len(), request::MAX_BODY);
    assert_eq!(served.post("/api/faults", &longest).status, 201);
    assert_eq!(served.post("/api/faults", &format!("{longest} ")).error_status(), 413);
    let head = format!("POST /api/faults HTTP/1.1\r\nhost: {}\r\ncontent-type: application/json\r\n", served.address);
    let promised = format!("{head}connection: close\r\ncontent-length: 99999999999\r\n\r\n");
    assert_eq!(served.raw(promised.as_bytes()).error_status(), 413);
    let chunk = format!("1000\r\n{}\r\n", " ".repeat(4096));
    let chunked = format!(
        "{head}connection: close\r\ntransfer-encoding: chunked\r\n\r\n{}0\r\n\r\n",
        chunk.repeat(request::MAX_BODY / 4096 + 1)
    );
    assert_eq!(served.raw(chunked.as_bytes()).error_status(), 413);
    let start = Instant::now();
    let broken_off = format!("{head}connection: close\r\ncontent-length: 10\r\n\r\n{{");
    assert_eq!(served.raw(broken_off.as_bytes()).error_status(), 408);
    assert!(start.elapsed() < 2 * request::BODY_TIMEOUT);
}

#[test]
fn events_reach_all_clients() {
    let served = served(None);
    let mut streams: Vec<_> = (0..3).map(|_| served.events()).collect();
    served.publish("{\"half_second\":1}");
    let expected = b"event: half-second\ndata: {\"half_second\":1}\n\n";
    for (stream, head) in &mut streams {
        assert!(head.contains("200 OK") && head.contains("text/event-stream"), "{head}");
        let mut seen = Vec::new();
        while !seen.windows(expected.len()).any(|window| window == expected) {
            let mut transmission = [0; 256];
            let length = stream.read(&mut transmission).unwrap();
            assert!(length > 0, "{}", String::from_utf8_lossy(&seen));
            seen.extend_from_slice(&transmission[..length]);
        }
    }
}

#[test]
fn streams_and_connections_are_limited_and_released() {
    let served = served(None);
    let mut streams: Vec<_> = (0..routes::STREAMS).map(|_| served.events()).collect();
    assert!(streams.iter().all(|(_, head)| head.contains("200 OK")));
    assert_eq!(served.get("/api/events").error_status(), 503);
    let idle: Vec<_> = (0..CONNECTIONS - routes::STREAMS).map(|_| served.connect()).collect();
    assert_eq!(served.get("/api/status").error_status(), 503);
    drop(idle);
    streams.pop();
    let start = Instant::now();
    while served.get("/api/status").status != 200 || !served.events().1.contains("200 OK") {
        assert!(start.elapsed() < Duration::from_secs(5), "no connection is released");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn connections_are_limited_per_remote_machine_but_not_for_this_one() {
    let address = |text: &str| text.parse::<IpAddr>().unwrap();
    let acquire = |limiter: &mut ConnectionLimiter, text: &str| {
        (0..2 * CONNECTIONS).map_while(|_| limiter.acquire(address(text))).collect::<Vec<_>>()
    };
    for own in ["127.0.0.1", "::1", "::ffff:127.0.0.1"] {
        assert_eq!(acquire(&mut ConnectionLimiter::new(), own).len(), CONNECTIONS, "{own}");
    }
    let mut limiter = ConnectionLimiter::new();
    let held = acquire(&mut limiter, "192.0.2.1");
    assert_eq!(held.len(), CONNECTIONS_EACH);
    assert!(limiter.acquire(address("::ffff:192.0.2.1")).is_none(), "the same machine");
    let network = acquire(&mut limiter, "2001:db8::1");
    assert!(network.len() == CONNECTIONS_EACH && limiter.acquire(address("2001:db8::2")).is_none());
    assert_eq!(acquire(&mut limiter, "192.0.2.2").len(), CONNECTIONS - 2 * CONNECTIONS_EACH);
    drop(held);
    assert_eq!(acquire(&mut limiter, "192.0.2.1").len(), CONNECTIONS_EACH);
}

#[test]
fn slow_or_idle_clients_are_disconnected() {
    let served = served(None);
    let start = Instant::now();
    let mut slow = served.connect();
    let mut idle = served.connect();
    write!(idle, "GET /api/status HTTP/1.1\r\nhost: {}\r\n\r\n", served.address).unwrap();
    slow.write_all(b"GET /api/status HTTP/1.1\r\n").unwrap();
    // Single bytes do not extend the time.
    while start.elapsed() < HEADERS_TIMEOUT - Duration::from_secs(1) {
        slow.write_all(b"x").unwrap();
        std::thread::sleep(Duration::from_millis(200));
    }
    assert_ne!(rest(&mut slow).status, 200);
    assert_eq!(rest(&mut idle).status, 200);
    assert!(start.elapsed() < HEADERS_TIMEOUT + Duration::from_secs(3), "{:?}", start.elapsed());
}

#[test]
fn event_client_that_does_not_read_is_disconnected_and_others_are_served() {
    let served = served(None);
    let (_stalled, _) = served.events();
    let (start, much) = (Instant::now(), format!("\"{}\"", "x".repeat(50_000)));
    let mut longest = Duration::ZERO;
    while served.backend.events.receiver_count() > 0 {
        served.publish(&much);
        let asked = Instant::now();
        assert_eq!(served.get("/api/status").status, 200);
        longest = longest.max(asked.elapsed());
        assert!(start.elapsed() < WRITE_TIMEOUT + Duration::from_secs(10), "still listening");
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(longest < Duration::from_secs(1), "{longest:?}");
}

#[test]
fn garbage_is_rejected() {
    let served = served(None);
    let long = format!("GET /{} HTTP/1.1\r\nhost: localhost\r\n\r\n", "x".repeat(70_000));
    let many: String = (0..2000).map(|n| format!("h{n}: x\r\n")).collect();
    let many = format!("GET / HTTP/1.1\r\nhost: localhost\r\n{many}\r\n");
    let transmissions: [&[u8]; 8] = [
        b"\r\n\r\n\r\n",
        b"nonsense\r\n\r\n",
        b"\xEB\x90\x01\x16\x00\x00\xFF\xFE\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"POST /api/faults HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ntransfer-encoding: chunked\r\n\r\nZZ\r\n",
        b"POST /api/faults HTTP/1.1\r\nhost: localhost\r\ncontent-length: -1\r\n\r\n",
        long.as_bytes(),
        many.as_bytes(),
    ];
    for transmission in transmissions {
        let mut stream = served.connect();
        let _ = stream.write_all(transmission);
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let got = rest(&mut stream);
        assert_ne!(got.status, 200, "{got:?}");
        assert!(!got.body.contains('<'), "{got:?}");
    }
    let mut state = 1u32;
    for _ in 0..200 {
        let noise: Vec<u8> = (0..300)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 24) as u8
            })
            .collect();
        let mut stream = served.connect();
        let _ = stream.write_all(&noise);
    }
    let start = Instant::now();
    while served.get("/api/status").status != 200 {
        assert!(start.elapsed() < Duration::from_secs(10));
        std::thread::sleep(Duration::from_millis(20));
    }
}
