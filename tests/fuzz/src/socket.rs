//! What clients and simulators send to a running unit.

use std::pin::Pin;
use std::sync::{Arc, LazyLock};

use axum::Router;
use axum::body::Body;
use axum::http::{Request, StatusCode, header};
use geu_daemon::control::{ControlBackend, SseEvent, commands, reply};
use geu_daemon::{catalogue, fuzzing};
use geu_model::configuration::fault::{fault_text, read_fault_text, read_plan_text};
use geu_model::device::Device;
use geu_model::fault::catalogue::Transport;
use geu_protocol::{CommandResult, Gyros, Reply};
use geu_recorder::fault_json;
use http_body_util::BodyExt;
use serde_json::{Map, Value, json};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::broadcast;
use tower_service::Service;

use crate::parts;

/// Lines of a simulator, as JSON or of 42: in one part and in three they are the same truth, and all of it is finite.
pub fn truth(is_forty_two: bool, data: &[u8]) {
    let (content, parts) = parts(data);
    let whole = fuzzing::truth(is_forty_two, &[content]);
    assert_eq!(whole, fuzzing::truth(is_forty_two, &parts));
    let mut before_s = f64::NEG_INFINITY;
    for knot in whole.1 {
        assert!(knot.t_s > before_s && knot.angle_control_arcsec.iter().all(|part| part.is_finite()), "{knot:?}");
        before_s = knot.t_s;
    }
}

struct Unit;

impl ControlBackend for Unit {
    fn gyros(&self) -> Gyros {
        Gyros::ALL
    }
    fn status(&self) -> Value {
        json!({ "lateness": {}, "truth": {} })
    }
    fn catalogue(&self) -> Value {
        static CATALOGUE: LazyLock<Value> = LazyLock::new(|| catalogue(&Device::iras()));
        CATALOGUE.clone()
    }
    fn faults(&self) -> Value {
        json!([])
    }
    fn inject(&self, injection: &Map<String, Value>) -> Result<Value, String> {
        let device = Device::iras();
        if let Some(plan) = injection.get("plan").and_then(Value::as_str) {
            let read = read_plan_text(&device, "plan", plan, &[], &Transport::ALL);
            return read.map(|faults| json!(faults.len())).map_err(|error| error.to_string());
        }
        let read = |text: &str| read_fault_text(&device, "fault", text, &[], &Transport::ALL);
        let fault = read(&fuzzing::toml(injection)).map_err(|error| error.message)?;
        let written = fault_text(&device, &fault);
        let again = read(&written).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(fault_text(&device, &again), written);
        Ok(json!({ "id": fault.id, "keys": fault_json::keys(&device, &fault) }))
    }
    fn clear(&self, id: &str) -> Result<Value, String> {
        Err(id.to_owned())
    }
    fn clear_all(&self) -> Value {
        json!({ "cleared": 0 })
    }
    fn command(&self, payload: Vec<u8>) -> Pin<Box<dyn Future<Output = Value> + Send + '_>> {
        assert!((1..=8).contains(&payload.len()));
        Box::pin(async move { reply(&Reply::new(payload[0], CommandResult::Done, &[]), None) })
    }
    fn timeline(&self) -> Vec<Arc<str>> {
        vec![commands().to_string().into()]
    }
    fn history(&self) -> Value {
        json!([])
    }
    fn watch_events(&self) -> Value {
        json!([])
    }
    fn add_watch_event(&self, event: Map<String, Value>) -> Value {
        event.into()
    }
    fn subscribe(&self) -> broadcast::Receiver<SseEvent> {
        broadcast::channel(1).1
    }
}

/// A request: a line with method and target, lines of headers, an empty line and the body. No response is an error of the server.
pub fn request(data: &[u8]) {
    thread_local! {
        static SERVER: (Runtime, Router) = (
            Builder::new_current_thread().enable_time().max_blocking_threads(1).build().expect("a runtime"),
            fuzzing::router(Arc::new(Unit), None),
        );
    }
    let Some(request) = parse(data) else { return };
    SERVER.with(|(runtime, router)| {
        runtime.block_on(async {
            let response = router.clone().call(request).await.expect("infallible");
            let (status, headers) = (response.status(), response.headers().clone());
            assert!(!status.is_server_error() || status == StatusCode::SERVICE_UNAVAILABLE, "{status}");
            let is = |text: &str| headers.get(header::CONTENT_TYPE).is_some_and(|own| own == text);
            if !is("application/json") {
                return;
            }
            let body = response.into_body().collect().await.expect("a body").to_bytes();
            if !body.is_empty() {
                let value: Value = serde_json::from_slice(&body).expect("JSON");
                assert!(status.is_success() || value["error"].is_string(), "{value}");
            }
        });
    });
}

fn parse(data: &[u8]) -> Option<Request<Body>> {
    let split = data.windows(2).position(|pair| pair == b"\n\n");
    let (head, body) = split.map_or((data, &[][..]), |at| (&data[..at], &data[at + 2..]));
    let mut lines = str::from_utf8(head).ok()?.lines();
    let (method, target) = lines.next()?.split_once(' ')?;
    let mut request = Request::builder().method(method).uri(target);
    let mut has_host = false;
    for (name, value) in lines.filter_map(|line| line.split_once(": ")) {
        has_host |= name.eq_ignore_ascii_case("host");
        request = request.header(name, value);
    }
    if !has_host {
        request = request.header(header::HOST, "127.0.0.1:8470").header(header::CONTENT_TYPE, "application/json");
    }
    request.body(Body::from(body.to_vec())).ok()
}
