//! The control interface over TCP, with a fake backend.

mod access;
mod document;
mod limits;
mod requests;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use geu_protocol::{CommandResult, Gyros, Reply};
use serde_json::{Map, Value, json};
use tokio::sync::broadcast;

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
