//! A route, from which the router and the OpenAPI document are built.

use axum::handler::Handler;
use axum::http::Method;
use axum::routing::{MethodFilter, MethodRouter, on};

/// A route with its description and handler.
pub(super) struct Route<S> {
    pub method: Method,
    pub path: &'static str,
    pub summary: &'static str,
    /// Schema of the request body.
    pub body: Option<&'static str>,
    pub response: ResponseSpec,
    /// Error statuses beside those of all routes.
    pub errors: &'static [u16],
    pub handler: MethodRouter<S>,
}

/// Response of a route on success.
#[derive(Debug, Clone, Copy)]
pub(super) enum ResponseSpec {
    /// JSON of this schema.
    Json(u16, &'static str),
    /// Text of this type.
    Text(&'static str),
}

impl<S: Clone + Send + Sync + 'static> Route<S> {
    pub fn new<T: 'static>(
        method: Method,
        path: &'static str,
        summary: &'static str,
        response: ResponseSpec,
        handler: impl Handler<T, S>,
    ) -> Route<S> {
        let filter = MethodFilter::try_from(method.clone()).expect("the methods of the table are standard");
        Route { method, path, summary, body: None, response, errors: &[], handler: on(filter, handler) }
    }

    /// Adds a request body of this schema.
    pub fn with_body(self, schema: &'static str) -> Route<S> {
        Route { body: Some(schema), errors: &[400, 408, 413, 415], ..self }
    }
}
