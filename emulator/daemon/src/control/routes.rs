//! The table of routes and their handlers.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, Request, State};
use axum::http::{Method, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::sse::{KeepAlive, Sse};
use axum::response::{IntoResponse, Response, sse};
use serde_json::Value;
use tokio::sync::Semaphore;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::BroadcastStream;

use super::answer::{ApiError, ApiResult, json};
use super::backend::ControlBackend;
use super::guard::Guard;
use super::request::{MAX_BODY, bad_request, object, payload, read_body};
use super::route::ResponseSpec::{Json, Text};
use super::watch::{self, RateLimit};
use super::{openapi, page};

/// Maximum number of event streams; the remaining connections are for requests.
pub(super) const STREAMS: usize = 16;
/// Timeout of a command. The replies of a link take 20 ms; a unit that takes longer than this is not running.
const REPLY_TIMEOUT: Duration = Duration::from_secs(2);
/// Requests processed at once, each on its own thread: a long one delays neither other clients nor the end of the run.
const WORKERS: usize = 2;
/// Interval of the keep-alive comments of an event stream; they detect disconnected clients.
const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(5);

/// State shared by all handlers.
pub(super) struct AppState {
    backend: Arc<dyn ControlBackend>,
    streams: Arc<Semaphore>,
    workers: Arc<Semaphore>,
    watch: RateLimit,
}

impl AppState {
    /// Runs `job` on a worker thread.
    async fn work<T: Send + 'static>(
        &self,
        job: impl FnOnce(&dyn ControlBackend) -> Result<T, ApiError> + Send + 'static,
    ) -> Result<T, ApiError> {
        let (backend, workers) = (self.backend.clone(), self.workers.clone());
        let ends = || unavailable("the emulator ends; start it again".to_owned());
        let permit = workers.acquire_owned().await.map_err(|_| ends())?;
        let done = tokio::task::spawn_blocking(move || {
            // Held until the job is done, even if the client has disconnected.
            let _permit = permit;
            job(&*backend)
        });
        done.await.map_err(|_| ends())?
    }

    /// The response with the JSON that `job` returns.
    async fn respond(
        &self,
        status: StatusCode,
        job: impl FnOnce(&dyn ControlBackend) -> Result<Value, ApiError> + Send + 'static,
    ) -> ApiResult {
        self.work(move |backend| Ok(json(status, &job(backend)?))).await
    }
}

type Shared = State<Arc<AppState>>;
type Route = super::route::Route<Arc<AppState>>;

/// All routes.
pub(super) fn table() -> Vec<Route> {
    let get = Method::GET;
    let mut table = vec![
        read("/api/status", "State of the run", "Status", |backend| backend.status()),
        read("/api/lateness", "How late samples were sent", "Lateness", |backend| backend.status()["lateness"].take()),
        read("/api/truth", "The true motion, beside the unit's output", "Truth", |backend| {
            backend.status()["truth"].take()
        }),
        read("/api/catalogue", "Parameters, faults and commands", "Catalogue", |backend| backend.catalogue()),
        read("/api/parameters", "Parameters that a fault can change", "Parameters", |backend| {
            backend.catalogue()["parameters"].take()
        }),
        read("/api/layout", "Fields of the frames of a sample", "Layout", |backend| backend.layout()),
        Route::new(get.clone(), "/api/faults", "All faults: armed, active, over", Json(200, "Faults"), faults),
        Route::new(
            Method::POST,
            "/api/faults",
            "Injects a fault, or all of a plan, or starts one",
            Json(201, "Injected"),
            inject,
        )
        .with_body("Injection"),
        Route::new(Method::DELETE, "/api/faults", "Ends all faults", Json(200, "AllCleared"), clear_all),
        Route {
            errors: &[404],
            ..Route::new(Method::DELETE, "/api/faults/{id}", "Ends one fault", Json(200, "Cleared"), clear)
        },
        Route::new(Method::POST, "/api/commands", "Sends the unit a command", Json(200, "Reply"), command)
            .with_body("Command"),
        Route::new(
            get.clone(),
            "/api/events",
            "Server-sent events: half-second (schema HalfSecond), timeline (schema Happening), watch (schema WatchEvent)",
            Text("text/event-stream"),
            events,
        ),
        Route::new(
            get.clone(),
            "/api/timeline",
            "Events of the run until now, one Happening a line",
            Text("application/x-ndjson"),
            timeline,
        ),
        read("/api/history", "The last ten minutes (1200 samples), oldest first, at any speed", "History", |backend| {
            backend.history()
        }),
        read("/api/watch", "The last 100 events of geu watch, oldest first", "WatchEvents", |backend| {
            backend.watch_events()
        }),
        Route {
            errors: &[400, 408, 413, 415, 429],
            ..Route::new(
                Method::POST,
                "/api/watch",
                "Adds an event of geu watch",
                Json(201, "WatchEvent"),
                add_watch_event,
            )
            .with_body("PostedWatchEvent")
        },
        read("/api/openapi.json", "This document", "Document", |_| openapi::document(&table())),
    ];
    table.extend(page::FILES.iter().map(|file| {
        let content = move || async move { ([(header::CONTENT_TYPE, file.content_type)], file.text) };
        Route::new(get.clone(), file.path, file.summary, Text(file.content_type), content)
    }));
    table
}

/// A GET route whose response is the JSON that `value` returns.
fn read(
    path: &'static str,
    summary: &'static str,
    schema: &'static str,
    value: fn(&dyn ControlBackend) -> Value,
) -> Route {
    let handler = move |State(state): Shared| async move { json(StatusCode::OK, &value(&*state.backend)) };
    Route::new(Method::GET, path, summary, Json(200, schema), handler)
}

/// The router of the table, behind the guard.
pub(super) fn router(backend: Arc<dyn ControlBackend>, guard: Guard) -> Router {
    let (streams, workers) = (Arc::new(Semaphore::new(STREAMS)), Arc::new(Semaphore::new(WORKERS)));
    (table().into_iter())
        .fold(Router::new(), |router, route| router.route(route.path, route.handler))
        .fallback(no_such_path)
        .method_not_allowed_fallback(no_such_method)
        .layer(middleware::from_fn(move |request, next| guarded(guard.clone(), request, next)))
        .with_state(Arc::new(AppState { backend, streams, workers, watch: RateLimit::new() }))
}

/// Checks a request before its handler, and adds the security headers to the response.
async fn guarded(guard: Guard, request: Request, next: Next) -> Response {
    let mut response = match guard.check(&request) {
        Ok(()) => next.run(request).await,
        Err(error) => error.into_response(),
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
    let message = format!("{path}: expected a method that /api/openapi.json has for it, got {method}");
    ApiError(StatusCode::METHOD_NOT_ALLOWED, message)
}

fn unavailable(message: String) -> ApiError {
    ApiError(StatusCode::SERVICE_UNAVAILABLE, message)
}

async fn faults(State(state): Shared) -> ApiResult {
    state.respond(StatusCode::OK, |backend| Ok(backend.faults())).await
}

async fn inject(State(state): Shared, request: Request) -> ApiResult {
    let body = read_body(request, MAX_BODY).await?;
    state.respond(StatusCode::CREATED, move |backend| backend.inject(&object(&body)?).map_err(bad_request)).await
}

async fn clear(State(state): Shared, id: Result<Path<String>, PathRejection>) -> ApiResult {
    let Path(id) = id.map_err(|rejection| bad_request(rejection.body_text()))?;
    let not_found = |message| ApiError(StatusCode::NOT_FOUND, message);
    state.respond(StatusCode::OK, move |backend| backend.clear(&id).map_err(not_found)).await
}

async fn clear_all(State(state): Shared) -> ApiResult {
    state.respond(StatusCode::OK, |backend| Ok(backend.clear_all())).await
}

async fn command(State(state): Shared, request: Request) -> ApiResult {
    let body = read_body(request, MAX_BODY).await?;
    let payload = state.work(move |_| payload(&object(&body)?).map_err(bad_request)).await?;
    let reply = tokio::time::timeout(REPLY_TIMEOUT, state.backend.command(payload)).await.map_err(|_| {
        unavailable(format!("the unit has not answered within {} s; is it running?", REPLY_TIMEOUT.as_secs()))
    })?;
    Ok(json(StatusCode::OK, &reply))
}

async fn add_watch_event(State(state): Shared, request: Request) -> ApiResult {
    let event = object(&read_body(request, watch::MAX_BODY).await?)?;
    watch::check(&event, state.backend.gyros()).map_err(bad_request)?;
    if !state.watch.accepts(Instant::now()) {
        let message = format!("expected at most {} events per second, got more; try again later", watch::RATE_HZ);
        return Err(ApiError(StatusCode::TOO_MANY_REQUESTS, message));
    }
    Ok(json(StatusCode::CREATED, &state.backend.add_watch_event(event)))
}

async fn events(State(state): Shared) -> ApiResult {
    let permit = state.streams.clone().try_acquire_owned().map_err(|_| {
        unavailable(format!("expected at most {STREAMS} event streams at once, got more; try again later"))
    })?;
    // The stream of a client that falls behind ends; the client reconnects to get the present.
    let events = BroadcastStream::new(state.backend.subscribe()).map_while(Result::ok).map(move |event| {
        let _permit = &permit;
        Ok::<_, Infallible>(sse::Event::default().event(event.name).data(event.data))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE_INTERVAL)).into_response())
}

async fn timeline(State(state): Shared) -> impl IntoResponse {
    let headers = [
        (header::CONTENT_TYPE, "application/x-ndjson"),
        (header::CONTENT_DISPOSITION, "attachment; filename=\"timeline.jsonl\""),
    ];
    (headers, lines(state.backend.timeline()))
}

/// A body of these lines. Each is copied after the client has read those before it, so a client needs no memory of its
/// own.
pub(super) fn lines(lines: Vec<Arc<str>>) -> Body {
    let lines = lines.into_iter().map(|line| Ok::<_, Infallible>(format!("{line}\n")));
    Body::from_stream(tokio_stream::iter(lines))
}
