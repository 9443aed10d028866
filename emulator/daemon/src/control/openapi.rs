//! The OpenAPI document of the table of routes; its constant part is `openapi.json`.

use serde_json::{Value, json};

use super::route::{ResponseSpec, Route};

/// The constant part of the document: everything but version and paths.
const TEMPLATE: &str = include_str!("openapi.json");
/// Error statuses of all routes: the guard and the connection limits.
const COMMON_ERRORS: [u16; 4] = [400, 401, 403, 503];

/// The document.
pub(super) fn document<S>(table: &[Route<S>]) -> Value {
    let mut paths = json!({});
    for route in table {
        paths[route.path][route.method.as_str().to_lowercase()] = operation(route);
    }
    let mut document: Value = serde_json::from_str(TEMPLATE).expect("the template is JSON, as a test checks");
    document["info"]["version"] = json!(env!("CARGO_PKG_VERSION"));
    document["paths"] = paths;
    document
}

fn operation<S>(route: &Route<S>) -> Value {
    let (status, content) = match route.response {
        ResponseSpec::Json(status, schema) => (status, json_body(schema)),
        ResponseSpec::Text(content_type) => (200, json!({ content_type: { "schema": { "type": "string" } } })),
    };
    let mut responses = json!({ status.to_string(): { "description": route.summary, "content": content } });
    for error in COMMON_ERRORS.iter().chain(route.errors) {
        responses[error.to_string()] = json!({ "description": description(*error), "content": json_body("Error") });
    }
    let mut operation = json!({ "summary": route.summary, "operationId": operation_id(route), "responses": responses });
    if let Some(schema) = route.body {
        operation["requestBody"] = json!({ "required": true, "content": json_body(schema) });
    }
    if route.path.contains("{id}") {
        operation["parameters"] =
            json!([{ "name": "id", "in": "path", "required": true, "schema": { "type": "string" } }]);
    }
    operation
}

fn json_body(schema: &str) -> Value {
    json!({ "application/json": { "schema": { "$ref": format!("#/components/schemas/{schema}") } } })
}

/// `get-api-faults`: unique, as method and path together are.
fn operation_id<S>(route: &Route<S>) -> String {
    let words = route.path.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    std::iter::once(route.method.as_str().to_lowercase()).chain(words.map(str::to_owned)).collect::<Vec<_>>().join("-")
}

fn description(status: u16) -> &'static str {
    match status {
        400 => "Invalid request; the error states what was expected",
        401 => "Missing or wrong token",
        403 => "Page of another site, or a host name that is not this server's",
        404 => "No fault with this identifier",
        408 => "Body not complete in time",
        413 => "Body too long",
        415 => "Content type of the body is not JSON",
        429 => "More events than are accepted per second",
        _ => "Too many connections or streams, or the unit does not answer",
    }
}
