//! The document of the interface and the layout of the frames.

use std::collections::BTreeSet;

use super::*;

#[test]
fn document_has_every_route_and_every_reference_resolves() {
    let served = served(None);
    let document = served.get("/api/openapi.json").json();
    assert_eq!(document["openapi"], "3.1.0");
    let mut names = BTreeSet::new();
    let table = routes::table();
    for route in &table {
        let method = route.method.as_str().to_lowercase();
        let operation = &document["paths"][route.path][&method];
        assert!(operation["responses"].is_object(), "{method} {}", route.path);
        assert!(names.insert(operation["operationId"].as_str().unwrap().to_owned()), "{operation}");
        // It is in the router too.
        let got = match route.path {
            "/api/events" => served.events().1.contains("200 OK").into(),
            path => served.ask(route.method.as_str(), &path.replace("{id}", "none"), &[], "").status,
        };
        assert!(![0, 405].contains(&got) && (got != 404 || route.path.contains('{')), "{method} {}: {got}", route.path);
    }
    let operations: usize =
        document["paths"].as_object().unwrap().values().map(|path| path.as_object().unwrap().len()).sum();
    assert_eq!(operations, table.len());
    let mut references = Vec::new();
    gather(&document, &mut references);
    assert!(references.len() > 40);
    for reference in references {
        let pointer = reference.strip_prefix('#').unwrap();
        assert!(document.pointer(pointer).is_some(), "{reference} does not resolve");
    }
}

fn gather(value: &Value, references: &mut Vec<String>) {
    match value {
        Value::Object(object) => {
            references.extend(object.get("$ref").and_then(Value::as_str).map(str::to_owned));
            object.values().for_each(|value| gather(value, references));
        }
        Value::Array(values) => values.iter().for_each(|value| gather(value, references)),
        _ => {}
    }
}

#[test]
fn layout_covers_the_frames_without_gaps() {
    let layout = served(None).get("/api/layout").json();
    let serial = std::iter::once((&layout["serial"], geu_protocol::serial::MAX_FRAME as u64));
    let can = layout["can"].as_array().unwrap();
    assert_eq!(can.len(), 3);
    for (fields, length) in serial.chain(can.iter().map(|message| (&message["fields"], 8))) {
        let end = fields.as_array().unwrap().iter().fold(0, |at, field| {
            assert_eq!(field["at"], at, "{field}");
            at + field["length"].as_u64().unwrap()
        });
        assert_eq!(end, length);
    }
}
