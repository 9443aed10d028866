//! The control interface over TCP, with a fake backend.

use geu_protocol::Gyros;
use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use geu_protocol::{CommandResult, Reply};
use serde_json::{Map, Value, json};
use tokio::sync::broadcast;
use tokio_stream::StreamExt;

use super::server::{CONNECTIONS, CONNECTIONS_EACH, ConnectionLimiter, HEADERS_TIMEOUT, WRITE_TIMEOUT};
use super::*;

struct FakeBackend {
    faults: Mutex<Vec<String>>,
    watch: Mutex<Vec<Value>>,
    events: broadcast::Sender<SseEvent>,
}

impl ControlBackend for FakeBackend {
    fn gyros(&self) -> Gyros {
        Gyros::ALL
    }

    fn status(&self) -> Value {
        json!({ "t_s": 1.5, "lateness": { "count": 3 }, "truth": { "theta_deg": 90.0 } })
    }

    fn catalogue(&self) -> Value {
        json!({ "parameters": [{ "parameter": "drift.arcsec_per_h" }], "commands": commands() })
    }

    fn faults(&self) -> Value {
        json!(*self.faults.lock().unwrap())
    }

    fn inject(&self, fault: &Map<String, Value>) -> Result<Value, String> {
        let id = fault.get("id").and_then(Value::as_str).ok_or("id: expected a name, got none")?;
        self.faults.lock().unwrap().push(id.to_owned());
        Ok(json!({ "id": id }))
    }

    fn clear(&self, id: &str) -> Result<Value, String> {
        let mut faults = self.faults.lock().unwrap();
        let at = faults.iter().position(|known| known == id).ok_or_else(|| format!("{id}: no such fault"))?;
        Ok(json!({ "id": faults.remove(at) }))
    }

    fn clear_all(&self) -> Value {
        json!({ "cleared": self.faults.lock().unwrap().drain(..).count() })
    }

    fn command(&self, payload: Vec<u8>) -> Pin<Box<dyn Future<Output = Value> + Send + '_>> {
        Box::pin(async move {
            if payload == [5] {
                std::future::pending::<()>().await;
            }
            reply(&Reply::new(payload[0], CommandResult::Done, &[1, 0]), None)
        })
    }

    fn timeline(&self) -> Vec<Arc<str>> {
        vec!["{\"t_s\":1}".into(), "{\"t_s\":2}".into()]
    }

    fn history(&self) -> Value {
        json!([])
    }

    fn watch_events(&self) -> Value {
        json!(*self.watch.lock().unwrap())
    }

    fn add_watch_event(&self, event: Map<String, Value>) -> Value {
        self.watch.lock().unwrap().push(event.clone().into());
        event.into()
    }

    fn subscribe(&self) -> broadcast::Receiver<SseEvent> {
        self.events.subscribe()
    }
}

/// A served backend; ends with the test.
struct Served {
    backend: Arc<FakeBackend>,
    address: SocketAddr,
    _server: Server,
}

fn served(token: Option<&str>) -> Served {
    let listener = ControlListener::open("127.0.0.1:0", false, token.map(str::to_owned)).unwrap();
    let backend =
        Arc::new(FakeBackend { faults: Mutex::default(), watch: Mutex::default(), events: broadcast::channel(64).0 });
    let address = listener.address();
    Served { _server: listener.serve(backend.clone()).unwrap(), backend, address }
}

/// A response.
#[derive(Debug)]
struct Response {
    status: u16,
    head: String,
    body: String,
}

impl Response {
    fn json(&self) -> Value {
        assert!(self.head.contains("content-type: application/json"), "{self:?}");
        serde_json::from_str(&self.body).unwrap()
    }

    /// The status of an error response, whose JSON body contains the reason.
    fn error_status(&self) -> u16 {
        assert!(self.json()["error"].as_str().is_some_and(|error| error.len() > 10), "{self:?}");
        self.status
    }
}

impl Served {
    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream
    }

    /// Sends these bytes and reads to the end of the connection.
    fn raw(&self, bytes: &[u8]) -> Response {
        let mut stream = self.connect();
        // The server may reject the request and close before it has received all.
        let _ = stream.write_all(bytes);
        rest(&mut stream)
    }

    fn ask(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &str) -> Response {
        let mut head = format!("{method} {path} HTTP/1.1\r\nconnection: close\r\n");
        if !headers.iter().any(|(name, _)| *name == "host") {
            head += &format!("host: {}\r\n", self.address);
        }
        if !body.is_empty() {
            head += &format!("content-length: {}\r\n", body.len());
        }
        for (name, value) in headers {
            head += &format!("{name}: {value}\r\n");
        }
        self.raw(format!("{head}\r\n{body}").as_bytes())
    }

    fn get(&self, path: &str) -> Response {
        self.ask("GET", path, &[], "")
    }

    fn post(&self, path: &str, body: &str) -> Response {
        self.ask("POST", path, &[("content-type", "application/json")], body)
    }

    /// An event stream, its head read.
    fn events(&self) -> (TcpStream, String) {
        let mut stream = self.connect();
        write!(stream, "GET /api/events HTTP/1.1\r\nhost: {}\r\n\r\n", self.address).unwrap();
        let mut head = String::new();
        let mut byte = [0];
        while !head.ends_with("\r\n\r\n") && stream.read(&mut byte).unwrap() > 0 {
            head.push(byte[0] as char);
        }
        (stream, head)
    }

    fn publish(&self, data: &str) {
        let _ = self.backend.events.send(SseEvent { name: "half-second", data: data.into() });
    }
}

fn rest(stream: &mut TcpStream) -> Response {
    let mut bytes = Vec::new();
    let _ = stream.read_to_end(&mut bytes);
    let text = String::from_utf8_lossy(&bytes);
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
    let status = head.get(9..12).and_then(|status| status.parse().ok()).unwrap_or(0);
    Response { status, head: head.to_lowercase(), body: body.to_owned() }
}

#[test]
fn every_read_route_responds() {
    let served = served(None);
    assert_eq!(served.get("/api/status").json()["t_s"], 1.5);
    assert_eq!(served.get("/api/lateness").json(), json!({ "count": 3 }));
    assert_eq!(served.get("/api/truth").json(), json!({ "theta_deg": 90.0 }));
    assert_eq!(served.get("/api/parameters").json(), json!([{ "parameter": "drift.arcsec_per_h" }]));
    assert_eq!(served.get("/api/catalogue").json()["commands"][0]["name"], "PING");
    let timeline = served.get("/api/timeline");
    let sent: String = timeline.body.lines().filter(|line| line.starts_with('{')).collect();
    assert_eq!(sent, "{\"t_s\":1}{\"t_s\":2}");
    assert!(timeline.head.contains("content-disposition: attachment; filename=\"timeline.jsonl\""), "{timeline:?}");
    assert!(timeline.head.contains("content-type: application/x-ndjson"), "{timeline:?}");
    for file in page::FILES {
        let got = served.get(file.path);
        assert_eq!((got.status, got.body.as_str()), (200, file.text), "{}", file.path);
        assert!(got.head.contains("content-security-policy: default-src 'none'; script-src 'self';"), "{got:?}");
    }
    assert_eq!(served.ask("HEAD", "/api/status", &[], "").status, 200);
}

#[tokio::test]
async fn timeline_is_copied_line_by_line_as_the_client_reads() {
    let line: Arc<str> = "{}".into();
    let mut body = routes::lines(vec![line.clone(); 1000]).into_data_stream();
    assert_eq!(Arc::strong_count(&line), 1001);
    let first = body.next().await.expect("a line").expect("no error");
    assert_eq!((&*first, Arc::strong_count(&line)), (&b"{}\n"[..], 1000));
}

#[test]
fn faults_are_injected_and_cleared() {
    let served = served(None);
    let injected = served.post("/api/faults", r#"{"id": "a/b ü"}"#);
    assert_eq!((injected.status, injected.json()), (201, json!({ "id": "a/b ü" })));
    assert_eq!(served.post("/api/faults", r#"{"id": "second"}"#).status, 201);
    assert_eq!(served.get("/api/faults").json(), json!(["a/b ü", "second"]));
    assert_eq!(served.ask("DELETE", "/api/faults/a%2Fb%20%C3%BC", &[], "").json()["id"], "a/b ü");
    assert_eq!(served.ask("DELETE", "/api/faults/second%20", &[], "").error_status(), 404);
    assert_eq!(served.ask("DELETE", "/api/faults/%FF", &[], "").error_status(), 400);
    assert_eq!(served.ask("DELETE", "/api/faults", &[], "").json(), json!({ "cleared": 1 }));
    let rejected = served.post("/api/faults", "{}");
    assert_eq!(
        (rejected.error_status(), rejected.json()["error"].as_str()),
        (400, Some("id: expected a name, got none"))
    );
}

#[test]
fn long_requests_delay_neither_other_requests_nor_the_end() {
    let served = served(None);
    let backend = served.backend.clone();
    // Injections wait until the test ends.
    let held = backend.faults.lock().unwrap();
    let head = format!("POST /api/faults HTTP/1.1\r\nhost: {}\r\ncontent-type: application/json\r\n", served.address);
    let waiting: Vec<TcpStream> = (0..5)
        .map(|_| {
            let mut stream = served.connect();
            stream.write_all(format!("{head}content-length: 10\r\n\r\n{{\"id\":\"a\"}}").as_bytes()).unwrap();
            stream
        })
        .collect();
    std::thread::sleep(Duration::from_millis(100));
    assert_eq!(served.get("/api/status").status, 200);
    let start = Instant::now();
    drop(served);
    // Does not wait for them; the limit allows for a loaded machine.
    assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
    drop((held, waiting));
}

#[test]
fn duplicate_keys_are_rejected() {
    let served = served(None);
    for body in [
        r#"{"id": "a", "id": "b"}"#,
        r#"{"id": "a", "course": {"step": 1, "step": 1}}"#,
        r#"{"a": [{"b": 1, "b": 2}]}"#,
    ] {
        let rejected = served.post("/api/faults", body);
        assert_eq!(rejected.error_status(), 400, "{body}");
        assert!(rejected.body.contains("expected each key once, got"), "{rejected:?}");
    }
    let all = r#"{"id": "a", "numbers": [1, -2, 0.5, 1e300], "flags": [true, false, null], "inner": {"id": ["id"]}}"#;
    assert_eq!(served.post("/api/faults", all).status, 201);
    assert_eq!(serde_json::from_str::<unique::Unique>(all).unwrap().0, serde_json::from_str::<Value>(all).unwrap());
    assert_eq!(served.get("/api/faults").json(), json!(["a"]));
}

#[test]
fn commands_are_sent_by_name_or_as_bytes() {
    let served = served(None);
    for body in [r#"{"name": "set-mode", "arguments": [1]}"#, r#"{"bytes": "02 01"}"#] {
        let got = served.post("/api/commands", body);
        assert_eq!(
            (got.status, &got.json()["name"], &got.json()["outcome"]),
            (200, &json!("SET_MODE"), &json!("done"))
        );
    }
    let ping = served.post("/api/commands", r#"{"name": "PING"}"#).json();
    assert_eq!((&ping["values"], &ping["bytes"]), (&json!({ "major": 1, "minor": 0 }), &json!("01000100")));
    for wrong in [
        r#"{}"#,
        r#"{"name": "NONSENSE"}"#,
        r#"{"name": "SET_MODE"}"#,
        r#"{"name": "SET_MODE", "arguments": [256]}"#,
        r#"{"name": "SET_MODE", "arguments": ["1"]}"#,
        r#"{"name": "SET_MODE", "arguments": 1}"#,
        r#"{"name": "PING", "bytes": "01"}"#,
        r#"{"bytes": "1"}"#,
        r#"{"bytes": "01", "arguments": [1]}"#,
        r#"{"name": "PING", "twice": true}"#,
        r#"{"name": 7}"#,
    ] {
        assert_eq!(served.post("/api/commands", wrong).error_status(), 400, "{wrong}");
    }
    assert_eq!(served.post("/api/commands", r#"{"name": "RESET_SEQUENCE"}"#).error_status(), 503, "no answer");
}

#[test]
fn watch_events_are_checked_and_limited() {
    let served = served(None);
    let valid = json!({
        "t_s": 3012.5, "event": "alarm", "code": "unknown", "gyros": ["GYRX"], "statistic": 40.2, "threshold": 31.0
    });
    let posted = served.post("/api/watch", &valid.to_string());
    assert_eq!((posted.status, posted.json()), (201, valid.clone()));
    for (key, wrong, expected) in [
        ("t_s", json!("1"), "t_s: expected a time from 0 to 1e12 s, got \"1\""),
        ("t_s", json!(-1), "t_s: "),
        ("t_s", json!(1e300), "t_s: "),
        ("t_s", Value::Null, "t_s: "),
        ("event", json!("<b>"), "event: expected alarm, named, interruption or reference-end, got \"<b>\""),
        ("code", json!(""), "code: "),
        ("code", json!("<script>"), "code: expected 1 to 64 characters a-z, 0-9 and -, got"),
        ("code", json!("x".repeat(65)), "code: "),
        ("code", json!(["drift"]), "code: "),
        ("gyros", json!("GYRX"), "gyros: expected a list of GYRX, GYRY, GYRZA and GYRZB, each at most once, got"),
        ("gyros", json!(["GYRX", "GYRX"]), "gyros: "),
        ("gyros", json!(["GYRQ"]), "gyros: "),
        ("statistic", Value::Null, "statistic: expected a number, got null"),
        ("threshold", json!({}), "threshold: "),
        ("number", json!(1), "expected the keys t_s, event, code, gyros, statistic, threshold, got \"number\""),
    ] {
        let mut event = valid.clone();
        event[key] = wrong;
        let rejected = served.post("/api/watch", &event.to_string());
        assert_eq!(rejected.error_status(), 400, "{event}");
        assert!(rejected.json()["error"].as_str().unwrap().contains(expected), "{rejected:?}");
    }
    for body in ["", "[]", "{", "{}", r#"{"t_s": 1e999}"#, r#"{"t_s": 1, "t_s": 2}"#, &"[".repeat(1000)] {
        assert_eq!(served.post("/api/watch", body).error_status(), 400, "{body}");
    }
    assert_eq!(served.post("/api/watch", &format!("{valid}{}", " ".repeat(watch::MAX_BODY))).error_status(), 413);
    assert_eq!(served.ask("POST", "/api/watch", &[], &valid.to_string()).error_status(), 415);
    assert_eq!(served.get("/api/watch").json(), json!([valid]), "nothing rejected is kept");

    let (limit, start) = (watch::RateLimit::new(), Instant::now());
    let accepted =
        |at_s: f64, count: usize| (0..count).filter(|_| limit.accepts(start + Duration::from_secs_f64(at_s))).count();
    assert_eq!([accepted(0.001, 1000), accepted(1.001, 1000), accepted(3600.0, 1000)], [100, 20, 100]);
    // At once over one connection: the excess would take ten seconds at the permitted rate.
    let (valid, mut stream) = (valid.to_string(), served.connect());
    let head = "POST /api/watch HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: ";
    let requests = format!("{head}{}\r\n\r\n{valid}", valid.len()).repeat(300);
    stream
        .write_all(format!("{requests}GET / HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n").as_bytes())
        .unwrap();
    let answers = rest(&mut stream).body;
    assert!(answers.contains("429 Too Many Requests") && answers.contains("at most 20 events per second, got more"));
}

#[test]
fn invalid_requests_are_rejected_in_json() {
    let served = served(None);
    assert_eq!(served.get("/api/nothing").error_status(), 404);
    assert_eq!(served.get("/../etc/passwd").error_status(), 404);
    assert_eq!(served.post("/api/status", "{}").error_status(), 405);
    assert_eq!(served.ask("OPTIONS", "/api/faults", &[], "").error_status(), 405);
    for body in ["", "nonsense", "[1]", "{\"a\":", &"[".repeat(5000), "\u{0}"] {
        assert_eq!(served.post("/api/faults", body).error_status(), 400, "{body:.20}");
    }
    for wrong in ["text/plain", "application/x-www-form-urlencoded", "application/jsonp"] {
        assert_eq!(served.ask("POST", "/api/faults", &[("content-type", wrong)], "{}").error_status(), 415);
    }
    assert_eq!(served.ask("POST", "/api/faults", &[], "{}").error_status(), 415);
    assert_eq!(served.ask("DELETE", "/api/faults", &[], "x").error_status(), 415);
    let with_charset = [("content-type", "Application/JSON; charset=utf-8")];
    assert_eq!(served.ask("POST", "/api/faults", &with_charset, r#"{"id": "a"}"#).status, 201);
}

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
fn pages_of_other_sites_are_rejected() {
    let served = served(None);
    let own = format!("http://{}", served.address);
    assert_eq!(served.ask("GET", "/api/status", &[("origin", &own)], "").status, 200);
    for origin in ["http://evil.example", "null", "https://127.0.0.1:8470", "http://127.0.0.1:1", "http://localhost"] {
        for (method, path) in [("GET", "/api/status"), ("GET", "/"), ("DELETE", "/api/faults")] {
            assert_eq!(served.ask(method, path, &[("origin", origin)], "").error_status(), 403, "{origin} {path}");
        }
    }
    for site in ["cross-site", "same-site"] {
        assert_eq!(served.ask("GET", "/api/events", &[("sec-fetch-site", site)], "").error_status(), 403);
    }
    assert_eq!(served.ask("GET", "/api/status", &[("sec-fetch-site", "same-origin")], "").status, 200);
    assert_eq!(
        served.ask("GET", "/", &[("sec-fetch-site", "cross-site")], "").status,
        200,
        "links from other sites are permitted"
    );
}

#[test]
fn dns_rebinding_hosts_are_rejected() {
    let served = served(None);
    let port = served.address.port();
    for host in ["localhost", "LOCALHOST", "127.0.0.1", "127.0.0.2", "[::1]"] {
        assert_eq!(served.ask("GET", "/api/status", &[("host", &format!("{host}:{port}"))], "").status, 200, "{host}");
    }
    assert_eq!(served.ask("GET", "/", &[("host", "127.0.0.1:9000")], "").status, 200, "through a tunnel");
    let evil = [
        "evil.example",
        "127.0.0.1.evil.example",
        "localhost.evil.example",
        "192.0.2.1",
        "evil@localhost",
        "a b",
        "",
        "0",
        "[::1",
        "2130706433",
    ];
    for host in evil {
        let rejected = served.ask("GET", "/api/status", &[("host", host)], "");
        assert!([400, 403].contains(&rejected.status), "{host}: {rejected:?}");
    }
    assert_eq!(
        served.ask("GET", "/api/status", &[("host", "localhost"), ("host", "localhost")], "").error_status(),
        400
    );
    assert_eq!(served.raw(b"GET /api/status HTTP/1.0\r\n\r\n").error_status(), 400);
    let absolute = format!("http://evil.example:{port}/api/status");
    assert_eq!(served.ask("GET", &absolute, &[], "").error_status(), 403);
}

#[test]
fn requests_without_the_token_are_rejected() {
    let served = served(Some("s3cret"));
    assert_eq!(served.get("/").status, 200, "the page holds no secret");
    for (path, headers) in [
        ("/api/status", &[][..]),
        ("/api/status?token=", &[]),
        ("/api/status?token=s3cre", &[]),
        ("/api/status?token=s3crets", &[]),
        ("/api/nothing", &[]),
        ("/%61pi/status", &[]),
        ("//api/status", &[]),
        ("/api/status", &[("authorization", "Bearer wrong")]),
        ("/api/status", &[("authorization", "Basic s3cret")]),
        ("/api/events", &[]),
    ] {
        assert_eq!(served.ask("GET", path, headers, "").error_status(), 401, "{path} {headers:?}");
    }
    assert_eq!(served.ask("DELETE", "/api/faults", &[], "").error_status(), 401);
    assert_eq!(served.get("/api/status?token=s3cret").status, 200);
    assert_eq!(served.ask("GET", "/api/status", &[("authorization", "Bearer s3cret")], "").status, 200);
}

#[test]
fn public_addresses_need_a_token_and_only_the_default_port_is_replaced_if_in_use() {
    for address in ["0.0.0.0:0", "[::]:0"] {
        for token in [None, Some(String::new())] {
            let error = ControlListener::open(address, false, token).unwrap_err().to_string();
            assert!(error.contains("expected a token"), "{error}");
        }
    }
    let listener = ControlListener::open("0.0.0.0:0", false, Some("s3cret".to_owned())).unwrap();
    assert!(listener.address().ip().is_unspecified());
    for address in ["nonsense", "127.0.0.1", "127.0.0.1:70000", "192.0.2.1:0"] {
        let error = ControlListener::open(address, true, Some("s3cret".to_owned())).unwrap_err().to_string();
        assert!(error.starts_with(&format!("--control {address}: ")), "{error}");
    }
    // One port is in use, and one of the next hundred is free.
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    assert!(ControlListener::open(&address.to_string(), false, None).unwrap_err().to_string().contains("free"));
    if address.port() < u16::MAX - 100 {
        let next = ControlListener::open(&address.to_string(), true, None).unwrap().address();
        assert!(next.port() > address.port() && next.port() < address.port() + 100, "{next}");
    }
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

#[test]
fn document_has_every_route_and_every_reference_resolves() {
    let served = served(None);
    let document = served.get("/api/openapi.json").json();
    assert_eq!(document["openapi"], "3.1.0");
    let mut names = BTreeSet::new();
    let table = routes::table();
    for route in &table {
        let method = route.method.as_str().to_lowercase();
        let operation = &document["paths"][route.path][&method];
        assert!(operation["responses"].is_object(), "{method} {}", route.path);
        assert!(names.insert(operation["operationId"].as_str().unwrap().to_owned()), "{operation}");
        // It is in the router too.
        let got = match route.path {
            "/api/events" => served.events().1.contains("200 OK").into(),
            path => served.ask(route.method.as_str(), &path.replace("{id}", "none"), &[], "").status,
        };
        assert!(![0, 405].contains(&got) && (got != 404 || route.path.contains('{')), "{method} {}: {got}", route.path);
    }
    let operations: usize =
        document["paths"].as_object().unwrap().values().map(|path| path.as_object().unwrap().len()).sum();
    assert_eq!(operations, table.len());
    let mut references = Vec::new();
    gather(&document, &mut references);
    assert!(references.len() > 40);
    for reference in references {
        let pointer = reference.strip_prefix('#').unwrap();
        assert!(document.pointer(pointer).is_some(), "{reference} does not resolve");
    }
}

fn gather(value: &Value, references: &mut Vec<String>) {
    match value {
        Value::Object(object) => {
            references.extend(object.get("$ref").and_then(Value::as_str).map(str::to_owned));
            object.values().for_each(|value| gather(value, references));
        }
        Value::Array(values) => values.iter().for_each(|value| gather(value, references)),
        _ => {}
    }
}

#[test]
fn layout_covers_the_frames_without_gaps() {
    let layout = served(None).get("/api/layout").json();
    let serial = std::iter::once((&layout["serial"], geu_protocol::serial::MAX_FRAME as u64));
    let can = layout["can"].as_array().unwrap();
    assert_eq!(can.len(), 3);
    for (fields, length) in serial.chain(can.iter().map(|message| (&message["fields"], 8))) {
        let end = fields.as_array().unwrap().iter().fold(0, |at, field| {
            assert_eq!(field["at"], at, "{field}");
            at + field["length"].as_u64().unwrap()
        });
        assert_eq!(end, length);
    }
}
