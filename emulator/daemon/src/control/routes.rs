//! The table of routes: the router is built from it, and so is the document that describes them.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::body::{Bytes, HttpBody};
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, Request, State};
use axum::handler::Handler;
use axum::http::{Method, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::sse::{KeepAlive, Sse};
use axum::response::{IntoResponse, Response, sse};
use axum::routing::{MethodFilter, on};
use axum::{Router, body};
use geu_protocol::command;
use http_body_util::{BodyExt, LengthLimitError, Limited};
use serde_json::{Map, Value};
use tokio::sync::Semaphore;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::BroadcastStream;

use super::answer::{ApiError, ApiResult, json, text};
use super::backend::ControlBackend;
use super::guard::Guard;
use super::route::ResponseSpec::{Json, Text};
use super::route::{ResponseSpec, Route};
use super::unique::Unique;
use super::{openapi, page, protocol_json};

/// Event streams at once; the other connections are for questions.
pub(super) const STREAMS: usize = 16;
/// Longest body, byte: a plan of as many faults as there may be, with comments.
pub(super) const BODY: usize = 1024 * 1024;
/// A client has so long to send it.
pub(super) const BODY_WITHIN: Duration = Duration::from_secs(5);
/// A unit that has not answered a command by then (the link's replies take 20 ms) is not running.
const REPLY_WITHIN: Duration = Duration::from_secs(2);
/// Questions worked on at once, each on a thread of its own: what takes long holds up neither other clients nor the end.
const WORKERS: usize = 2;
/// An event stream says so often that it lives; a client that is gone is noticed by it.
const SIGN_OF_LIFE: Duration = Duration::from_secs(5);

/// What every handler sees.
pub(super) struct AppState<B> {
    bench: Arc<B>,
    streams: Arc<Semaphore>,
    workers: Arc<Semaphore>,
    openapi: String,
}

impl<B: ControlBackend> AppState<B> {
    /// What `job` gives, done by a worker.
    async fn work<T: Send + 'static>(
        &self,
        job: impl FnOnce(&B) -> Result<T, ApiError> + Send + 'static,
    ) -> Result<T, ApiError> {
        let (bench, workers) = (self.bench.clone(), self.workers.clone());
        let ended = |_| ApiError(StatusCode::SERVICE_UNAVAILABLE, "the emulator ends; start it again".to_owned());
        let place = workers.acquire_owned().await.map_err(|_| ended(()))?;
        let done = tokio::task::spawn_blocking(move || {
            // Held until it is done, whether the client still waits or not.
            let _place = place;
            job(&bench)
        });
        done.await.map_err(|_| ended(()))?
    }
}

type Here<B> = State<Arc<AppState<B>>>;

/// Every route.
pub(super) fn table<B: ControlBackend>() -> Vec<Route<Arc<AppState<B>>>> {
    let mut table = vec![
        get("/api/status", "State of the run", Json(200, "Status"), status::<B>),
        get("/api/lateness", "How late samples were sent", Json(200, "Lateness"), lateness::<B>),
        get("/api/truth", "What really happened, beside what the unit tells", Json(200, "Truth"), truth::<B>),
        get("/api/catalogue", "What can be set, injected and commanded", Json(200, "Catalogue"), catalogue::<B>),
        get("/api/parameters", "Parameters that a fault can change", Json(200, "Parameters"), parameters::<B>),
        get("/api/layout", "What stands where in the frames of a sample", Json(200, "Layout"), layout),
        get("/api/faults", "Every fault: armed, active, over", Json(200, "Faults"), faults::<B>),
        Route {
            takes: Some("Injection"),
            refuses: &[400, 408, 413, 415],
            ..route(
                Method::POST,
                "/api/faults",
                "Injects a fault, or all of a plan, or starts one",
                Json(201, "Injected"),
                inject::<B>,
            )
        },
        route(Method::DELETE, "/api/faults", "Ends every fault", Json(200, "AllCleared"), clear_all::<B>),
        Route {
            refuses: &[404],
            ..route(Method::DELETE, "/api/faults/{id}", "Ends one fault", Json(200, "Cleared"), clear::<B>)
        },
        Route {
            takes: Some("Command"),
            refuses: &[400, 408, 413, 415],
            ..route(Method::POST, "/api/commands", "Sends the unit a command", Json(200, "Reply"), command::<B>)
        },
        get(
            "/api/events",
            "Server-sent events: half-second (schema HalfSecond) and timeline (schema Happening)",
            Text("text/event-stream"),
            events::<B>,
        ),
        get("/api/timeline", "What happened so far, one Happening a line", Text("application/x-ndjson"), timeline::<B>),
        get(
            "/api/history",
            "The last ten minutes (1200 samples), the oldest first, whatever the speed",
            Json(200, "History"),
            history::<B>,
        ),
        get("/api/openapi.json", "This document", Json(200, "Document"), document::<B>),
    ];
    for file in page::FILES {
        let content = move || async move { text(StatusCode::OK, file.content_type, file.text) };
        table.push(get(file.path, file.what, Text(file.content_type), content));
    }
    table
}

fn get<S, T, H>(path: &'static str, what: &'static str, gives: ResponseSpec, handler: H) -> Route<S>
where
    S: Clone + Send + Sync + 'static,
    T: 'static,
    H: Handler<T, S>,
{
    route(Method::GET, path, what, gives, handler)
}

fn route<S, T, H>(method: Method, path: &'static str, what: &'static str, gives: ResponseSpec, handler: H) -> Route<S>
where
    S: Clone + Send + Sync + 'static,
    T: 'static,
    H: Handler<T, S>,
{
    let filter = MethodFilter::try_from(method.clone()).expect("the methods of the table are ordinary ones");
    Route { method, path, what, takes: None, gives, refuses: &[], handler: on(filter, handler) }
}

/// The router of the table, behind the guard.
pub(super) fn router<B: ControlBackend>(bench: Arc<B>, guard: Guard) -> Router {
    let table = table::<B>();
    let (streams, workers) = (Arc::new(Semaphore::new(STREAMS)), Arc::new(Semaphore::new(WORKERS)));
    let room = Arc::new(AppState { bench, streams, workers, openapi: openapi::document(&table).to_string() });
    let mut router = Router::new();
    for route in table {
        router = router.route(route.path, route.handler);
    }
    router
        .fallback(no_such_path)
        .method_not_allowed_fallback(no_such_method)
        .layer(middleware::from_fn(move |request, next| watch(guard.clone(), request, next)))
        .with_state(room)
}

/// The guard before every answer, and what a browser is told to allow after it.
async fn watch(guard: Guard, request: Request, next: Next) -> Response {
    let mut response = match guard.check(&request) {
        Ok(()) => next.run(request).await,
        Err(refusal) => refusal.into_response(),
    };
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_SECURITY_POLICY, header::HeaderValue::from_static(page::POLICY));
    headers.insert(header::CACHE_CONTROL, header::HeaderValue::from_static("no-store"));
    headers.insert(header::REFERRER_POLICY, header::HeaderValue::from_static("no-referrer"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, header::HeaderValue::from_static("nosniff"));
    headers.insert("cross-origin-resource-policy", header::HeaderValue::from_static("same-origin"));
    response
}

async fn no_such_path(request: Request) -> ApiError {
    let path = request.uri().path();
    ApiError(StatusCode::NOT_FOUND, format!("{path}: no such path; expected one of those in /api/openapi.json"))
}

async fn no_such_method(request: Request) -> ApiError {
    let (method, path) = (request.method(), request.uri().path());
    let message = format!("{path}: expected a method that /api/openapi.json tells for it, got {method}");
    ApiError(StatusCode::METHOD_NOT_ALLOWED, message)
}

async fn status<B: ControlBackend>(State(room): Here<B>) -> Response {
    json(StatusCode::OK, &room.bench.status())
}

async fn lateness<B: ControlBackend>(State(room): Here<B>) -> Response {
    json(StatusCode::OK, &room.bench.status()["lateness"])
}

async fn truth<B: ControlBackend>(State(room): Here<B>) -> Response {
    json(StatusCode::OK, &room.bench.status()["truth"])
}

async fn catalogue<B: ControlBackend>(State(room): Here<B>) -> Response {
    json(StatusCode::OK, &room.bench.catalogue())
}

async fn parameters<B: ControlBackend>(State(room): Here<B>) -> Response {
    json(StatusCode::OK, &room.bench.catalogue()["parameters"])
}

async fn layout() -> Response {
    json(StatusCode::OK, &protocol_json::layout())
}

async fn faults<B: ControlBackend>(State(room): Here<B>) -> ApiResult {
    room.work(|bench| Ok(json(StatusCode::OK, &bench.faults()))).await
}

async fn inject<B: ControlBackend>(State(room): Here<B>, request: Request) -> ApiResult {
    let body = whole_body(request).await?;
    room.work(move |bench| {
        let injected = bench.inject(&object(&body)?).map_err(bad)?;
        Ok(json(StatusCode::CREATED, &injected))
    })
    .await
}

async fn clear<B: ControlBackend>(State(room): Here<B>, id: Result<Path<String>, PathRejection>) -> ApiResult {
    let Path(id) = id.map_err(|rejection| bad(rejection.body_text()))?;
    room.work(move |bench| {
        let cleared = bench.clear(&id).map_err(|message| ApiError(StatusCode::NOT_FOUND, message))?;
        Ok(json(StatusCode::OK, &cleared))
    })
    .await
}

async fn clear_all<B: ControlBackend>(State(room): Here<B>) -> ApiResult {
    room.work(|bench| Ok(json(StatusCode::OK, &bench.clear_all()))).await
}

async fn command<B: ControlBackend>(State(room): Here<B>, request: Request) -> ApiResult {
    let body = whole_body(request).await?;
    let payload = room.work(move |_| payload(&object(&body)?).map_err(bad)).await?;
    let reply = tokio::time::timeout(REPLY_WITHIN, room.bench.command(payload)).await.map_err(|_| {
        let message = format!("the unit has not answered within {} s; is it running?", REPLY_WITHIN.as_secs());
        ApiError(StatusCode::SERVICE_UNAVAILABLE, message)
    })?;
    Ok(json(StatusCode::OK, &reply))
}

async fn events<B: ControlBackend>(State(room): Here<B>) -> ApiResult {
    let place = room.streams.clone().try_acquire_owned().map_err(|_| {
        let message = format!("expected at most {STREAMS} event streams at once, got more; try again later");
        ApiError(StatusCode::SERVICE_UNAVAILABLE, message)
    })?;
    // Who falls behind is let go, and comes again for the present.
    let events = BroadcastStream::new(room.bench.subscribe()).map_while(Result::ok).map(move |event| {
        let _held = &place;
        Ok::<_, Infallible>(sse::Event::default().event(event.name).data(event.data))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(SIGN_OF_LIFE)).into_response())
}

async fn timeline<B: ControlBackend>(State(room): Here<B>) -> Response {
    let mut response = text(StatusCode::OK, "application/x-ndjson", lines(room.bench.timeline()));
    let saved_as = header::HeaderValue::from_static("attachment; filename=\"timeline.jsonl\"");
    response.headers_mut().insert(header::CONTENT_DISPOSITION, saved_as);
    response
}

async fn history<B: ControlBackend>(State(room): Here<B>) -> Response {
    json(StatusCode::OK, &room.bench.history())
}

/// A body of these lines, each copied when the client has taken those before: a client costs no memory of its own.
pub(super) fn lines(lines: Vec<Arc<str>>) -> body::Body {
    let lines = lines.into_iter().map(|line| Ok::<_, Infallible>(format!("{line}\n")));
    body::Body::from_stream(tokio_stream::iter(lines))
}

async fn document<B: ControlBackend>(State(room): Here<B>) -> Response {
    text(StatusCode::OK, "application/json", room.openapi.clone())
}

fn bad(message: String) -> ApiError {
    ApiError(StatusCode::BAD_REQUEST, message)
}

/// The bytes of a body.
async fn whole_body(request: Request) -> Result<Bytes, ApiError> {
    let too_long = || ApiError(StatusCode::PAYLOAD_TOO_LARGE, format!("body: expected at most {BODY} bytes, got more"));
    let body: body::Body = request.into_body();
    if body.size_hint().lower() > BODY as u64 {
        return Err(too_long());
    }
    let read = tokio::time::timeout(BODY_WITHIN, Limited::new(body, BODY).collect()).await.map_err(|_| {
        let message = format!("body: expected all of it within {} s, got a part", BODY_WITHIN.as_secs());
        ApiError(StatusCode::REQUEST_TIMEOUT, message)
    })?;
    let bytes = read.map_err(|error| match error.downcast::<LengthLimitError>() {
        Ok(_) => too_long(),
        Err(error) => bad(format!("body: {error}")),
    })?;
    Ok(bytes.to_bytes())
}

/// The JSON object of a body.
fn object(body: &[u8]) -> Result<Map<String, Value>, ApiError> {
    match serde_json::from_slice(body) {
        Ok(Unique(Value::Object(object))) => Ok(object),
        Ok(Unique(other)) => Err(bad(format!("body: expected a JSON object, got {}", kind(&other)))),
        Err(error) => Err(bad(format!("body: expected a JSON object: {error}"))),
    }
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a truth value",
        Value::Number(_) => "a number",
        Value::String(_) => "a text",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}

/// The payload of a COMMAND: `{"name": …, "arguments": […]}` or `{"bytes": …}`.
pub(super) fn payload(command: &Map<String, Value>) -> Result<Vec<u8>, String> {
    if let Some(other) = command.keys().find(|key| !["name", "arguments", "bytes"].contains(&key.as_str())) {
        return Err(format!("{other:?}: expected name and arguments, or bytes"));
    }
    let arguments = match command.get("arguments") {
        None => Vec::new(),
        Some(Value::Array(values)) => values
            .iter()
            .map(|value| value.as_i64().ok_or_else(|| format!("arguments: expected whole numbers, got {value}")))
            .collect::<Result<_, _>>()?,
        Some(other) => return Err(format!("arguments: expected a list of whole numbers, got {}", kind(other))),
    };
    match (command.get("name"), command.get("bytes")) {
        (Some(Value::String(name)), None) => command::named(name, &arguments),
        (None, Some(Value::String(hex))) if arguments.is_empty() => command::from_hex(hex)
            .ok_or_else(|| format!("bytes: expected 1 to 8 bytes, two hexadecimal digits each, got {hex:?}")),
        _ => Err("expected the name of a command and its arguments, or bytes without arguments".to_owned()),
    }
}
