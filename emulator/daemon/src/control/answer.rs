//! Responses as JSON, errors included.

use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};

/// A rejected request: status and message.
#[derive(Debug)]
pub(super) struct ApiError(pub StatusCode, pub String);

pub(super) type ApiResult = Result<Response, ApiError>;

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        json(self.0, &json!({ "error": self.1 }))
    }
}

/// A JSON document.
pub(super) fn json(status: StatusCode, value: &Value) -> Response {
    (status, [(header::CONTENT_TYPE, "application/json")], value.to_string()).into_response()
}
