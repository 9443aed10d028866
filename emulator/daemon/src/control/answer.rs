//! Answers: JSON, refusals too.

use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};

/// Why a request is refused.
#[derive(Debug)]
pub(super) struct ApiError(pub StatusCode, pub String);

/// An answer or why there is none.
pub(super) type ApiResult = Result<Response, ApiError>;

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        json(self.0, &json!({ "error": self.1 }))
    }
}

/// A JSON document.
pub(super) fn json(status: StatusCode, value: &Value) -> Response {
    text(status, "application/json", value.to_string())
}

/// A text of that type.
pub(super) fn text(status: StatusCode, content_type: &'static str, text: impl Into<axum::body::Body>) -> Response {
    (status, [(header::CONTENT_TYPE, content_type)], text.into()).into_response()
}
