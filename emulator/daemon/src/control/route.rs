//! A route, as the router and the OpenAPI document are built from it.

use axum::http::Method;
use axum::routing::MethodRouter;

/// One route: what it is called, takes, gives and refuses, and what answers it.
pub(super) struct Route<S> {
    pub method: Method,
    pub path: &'static str,
    pub what: &'static str,
    /// Schema of the body.
    pub takes: Option<&'static str>,
    pub gives: ResponseSpec,
    /// Beside those that any route may give.
    pub refuses: &'static [u16],
    pub handler: MethodRouter<S>,
}

/// What a route answers when all is well.
#[derive(Debug, Clone, Copy)]
pub(super) enum ResponseSpec {
    /// JSON of this schema.
    Json(u16, &'static str),
    /// Text of this type.
    Text(&'static str),
}
