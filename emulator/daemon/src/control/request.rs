//! The body of a request: its bytes, its JSON object, the command in it.

use std::time::Duration;

use axum::body::{Bytes, HttpBody};
use axum::extract::Request;
use axum::http::StatusCode;
use geu_protocol::command;
use geu_protocol::excerpt::excerpt;
use http_body_util::{BodyExt, LengthLimitError, Limited};
use serde_json::{Map, Value};

use super::answer::ApiError;
use super::unique::Unique;

/// Maximum length of a body, byte: a plan with as many faults as permitted, and comments.
pub(super) const MAX_BODY: usize = 1024 * 1024;
/// Time that a client has to send a body.
pub(super) const BODY_TIMEOUT: Duration = Duration::from_secs(5);

pub(super) fn bad_request(message: String) -> ApiError {
    ApiError(StatusCode::BAD_REQUEST, message)
}

/// The bytes of a body of at most `max` bytes.
pub(super) async fn read_body(request: Request, max: usize) -> Result<Bytes, ApiError> {
    let too_long = || ApiError(StatusCode::PAYLOAD_TOO_LARGE, format!("body: expected at most {max} bytes, got more"));
    let body = request.into_body();
    if body.size_hint().lower() > max as u64 {
        return Err(too_long());
    }
    let read = tokio::time::timeout(BODY_TIMEOUT, Limited::new(body, max).collect()).await.map_err(|_| {
        let message = format!("body: expected all of it within {} s, got a part", BODY_TIMEOUT.as_secs());
        ApiError(StatusCode::REQUEST_TIMEOUT, message)
    })?;
    let bytes = read.map_err(|error| match error.is::<LengthLimitError>() {
        true => too_long(),
        false => bad_request(format!("body: {error}")),
    })?;
    Ok(bytes.to_bytes())
}

/// The JSON object of a body.
pub(super) fn object(body: &[u8]) -> Result<Map<String, Value>, ApiError> {
    match serde_json::from_slice(body) {
        Ok(Unique(Value::Object(object))) => Ok(object),
        Ok(Unique(other)) => {
            Err(bad_request(format!("body: expected a JSON object, got {}", excerpt(&other.to_string()))))
        }
        Err(error) => Err(bad_request(format!("body: expected a JSON object: {error}"))),
    }
}

/// The payload of a COMMAND: `{"name": …, "arguments": […]}` or `{"bytes": …}`.
pub(super) fn payload(command: &Map<String, Value>) -> Result<Vec<u8>, String> {
    if let Some(other) = command.keys().find(|key| !["name", "arguments", "bytes"].contains(&key.as_str())) {
        return Err(format!("{other:?}: expected name and arguments, or bytes"));
    }
    let whole = |values: &Value| values.as_array()?.iter().map(Value::as_i64).collect::<Option<Vec<_>>>();
    let arguments = command.get("arguments").map_or(Some(Vec::new()), whole).ok_or_else(|| {
        format!("arguments: expected a list of whole numbers, got {}", excerpt(&command["arguments"].to_string()))
    })?;
    match (command.get("name"), command.get("bytes")) {
        (Some(Value::String(name)), None) => command::from_name(name, &arguments),
        (None, Some(Value::String(hex))) if arguments.is_empty() => command::from_hex(hex)
            .ok_or_else(|| format!("bytes: expected 1 to 8 bytes, two hexadecimal digits each, got {hex:?}")),
        _ => Err("expected the name of a command and its arguments, or bytes without arguments".to_owned()),
    }
}
