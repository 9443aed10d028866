//! The OpenAPI document of the table of routes; its schemas stand in `schemas.json`.

use serde_json::{Value, json};

use super::route::{ResponseSpec, Route};

/// Bodies of requests and answers.
const SCHEMAS: &str = include_str!("schemas.json");
/// What the guard and the bounds on connections may answer to anything.
const ANY: [u16; 4] = [400, 401, 403, 503];

/// The document.
pub(super) fn document<S>(table: &[Route<S>]) -> Value {
    let mut paths = json!({});
    for route in table {
        paths[route.path][route.method.as_str().to_lowercase()] = operation(route);
    }
    let schemas: Value = serde_json::from_str(SCHEMAS).expect("the schemas are JSON, as a test holds them to be");
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "GEU control interface",
            "version": env!("CARGO_PKG_VERSION"),
            "license": { "name": "MIT", "identifier": "MIT" },
            "description": "A running gyro electronics unit: what it does, what really happens, and faults on command. \
                A token is wanted where the unit was started with one.",
        },
        "servers": [{ "url": "/" }],
        "security": [{}, { "bearer": [] }, { "query": [] }],
        "paths": paths,
        "components": {
            "schemas": schemas,
            "securitySchemes": {
                "bearer": { "type": "http", "scheme": "bearer" },
                "query": { "type": "apiKey", "in": "query", "name": "token" },
            },
        },
    })
}

fn operation<S>(route: &Route<S>) -> Value {
    let (status, content) = match route.gives {
        ResponseSpec::Json(status, schema) => (status, json!({ "application/json": { "schema": reference(schema) } })),
        ResponseSpec::Text(content_type) => (200, json!({ content_type: { "schema": { "type": "string" } } })),
    };
    let mut answers = json!({ status.to_string(): { "description": route.what, "content": content } });
    for refused in ANY.iter().chain(route.refuses) {
        answers[refused.to_string()] = json!({ "description": why(*refused),
            "content": { "application/json": { "schema": reference("Error") } } });
    }
    let mut operation = json!({ "summary": route.what, "operationId": name(route), "responses": answers });
    if let Some(schema) = route.takes {
        operation["requestBody"] =
            json!({ "required": true, "content": { "application/json": { "schema": reference(schema) } } });
    }
    let parameters: Vec<Value> = (route.path.split('/'))
        .filter_map(|part| part.strip_prefix('{')?.strip_suffix('}'))
        .map(|name| json!({ "name": name, "in": "path", "required": true, "schema": { "type": "string" } }))
        .collect();
    if !parameters.is_empty() {
        operation["parameters"] = parameters.into();
    }
    operation
}

fn reference(schema: &str) -> Value {
    json!({ "$ref": format!("#/components/schemas/{schema}") })
}

/// `get-api-faults`: unique, as method and path together are.
fn name<S>(route: &Route<S>) -> String {
    let words = route.path.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    std::iter::once(route.method.as_str().to_lowercase()).chain(words.map(str::to_owned)).collect::<Vec<_>>().join("-")
}

fn why(status: u16) -> &'static str {
    match status {
        400 => "Not understood; the error says what was expected",
        401 => "Without the token, or with another",
        403 => "Of another site's page, or by a name that is not this server's",
        404 => "Nothing of that name",
        408 => "Body that did not come to its end in time",
        413 => "Body too long",
        415 => "Body that is not said to be JSON",
        _ => "No room for another connection or stream, or the unit does not answer",
    }
}
