//! Requests and their answers.

use tokio_stream::StreamExt;

use super::*;

#[test]
fn every_read_route_responds() {
    let served = served(None);
    assert_eq!(served.get("/api/status").json()["t_s"], 1.5);
    assert_eq!(served.get("/api/lateness").json(), json!({ "count": 3 }));
    assert_eq!(served.get("/api/truth").json(), json!({ "theta_deg": 90.0 }));
    assert_eq!(served.get("/api/parameters").json(), json!([{ "parameter": "drift.arcsec_per_h" }]));
    assert_eq!(served.get("/api/catalogue").json()["commands"][0]["name"], "PING");
    let timeline = served.get("/api/timeline");
    let sent: String = timeline.body.lines().filter(|line| line.starts_with('{')).collect();
    assert_eq!(sent, "{\"t_s\":1}{\"t_s\":2}");
    assert!(timeline.head.contains("content-disposition: attachment; filename=\"timeline.jsonl\""), "{timeline:?}");
    assert!(timeline.head.contains("content-type: application/x-ndjson"), "{timeline:?}");
    for file in page::FILES {
        let got = served.get(file.path);
        assert_eq!((got.status, got.body.as_str()), (200, file.text), "{}", file.path);
        assert!(got.head.contains("content-security-policy: default-src 'none'; script-src 'self';"), "{got:?}");
    }
    assert_eq!(served.ask("HEAD", "/api/status", &[], "").status, 200);
}

#[tokio::test]
async fn timeline_is_copied_line_by_line_as_the_client_reads() {
    let line: Arc<str> = "{}".into();
    let mut body = routes::lines(vec![line.clone(); 1000]).into_data_stream();
    assert_eq!(Arc::strong_count(&line), 1001);
    let first = body.next().await.expect("a line").expect("no error");
    assert_eq!((&*first, Arc::strong_count(&line)), (&b"{}\n"[..], 1000));
}

#[test]
fn faults_are_injected_and_cleared() {
    let served = served(None);
    let injected = served.post("/api/faults", r#"{"id": "a/b ü"}"#);
    assert_eq!((injected.status, injected.json()), (201, json!({ "id": "a/b ü" })));
    assert_eq!(served.post("/api/faults", r#"{"id": "second"}"#).status, 201);
    assert_eq!(served.get("/api/faults").json(), json!(["a/b ü", "second"]));
    assert_eq!(served.ask("DELETE", "/api/faults/a%2Fb%20%C3%BC", &[], "").json()["id"], "a/b ü");
    assert_eq!(served.ask("DELETE", "/api/faults/second%20", &[], "").error_status(), 404);
    assert_eq!(served.ask("DELETE", "/api/faults/%FF", &[], "").error_status(), 400);
    assert_eq!(served.ask("DELETE", "/api/faults", &[], "").json(), json!({ "cleared": 1 }));
    let rejected = served.post("/api/faults", "{}");
    assert_eq!(
        (rejected.error_status(), rejected.json()["error"].as_str()),
        (400, Some("id: expected a name, got none"))
    );
}

#[test]
fn long_requests_delay_neither_other_requests_nor_the_end() {
    let served = served(None);
    let backend = served.backend.clone();
    // Injections wait until the test ends.
    let held = backend.faults.lock().unwrap();
    let head = format!("POST /api/faults HTTP/1.1\r\nhost: {}\r\ncontent-type: application/json\r\n", served.address);
    let waiting: Vec<TcpStream> = (0..5)
        .map(|_| {
            let mut stream = served.connect();
            stream.write_all(format!("{head}content-length: 10\r\n\r\n{{\"id\":\"a\"}}").as_bytes()).unwrap();
            stream
        })
        .collect();
    std::thread::sleep(Duration::from_millis(100));
    assert_eq!(served.get("/api/status").status, 200);
    let start = Instant::now();
    drop(served);
    // Does not wait for them; the limit allows for a loaded machine.
    assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
    drop((held, waiting));
}

#[test]
fn duplicate_keys_are_rejected() {
    let served = served(None);
    for body in [
        r#"{"id": "a", "id": "b"}"#,
        r#"{"id": "a", "course": {"step": 1, "step": 1}}"#,
        r#"{"a": [{"b": 1, "b": 2}]}"#,
    ] {
        let rejected = served.post("/api/faults", body);
        assert_eq!(rejected.error_status(), 400, "{body}");
        assert!(rejected.body.contains("expected each key once, got"), "{rejected:?}");
    }
    let all = r#"{"id": "a", "numbers": [1, -2, 0.5, 1e300], "flags": [true, false, null], "inner": {"id": ["id"]}}"#;
    assert_eq!(served.post("/api/faults", all).status, 201);
    assert_eq!(serde_json::from_str::<unique::Unique>(all).unwrap().0, serde_json::from_str::<Value>(all).unwrap());
    assert_eq!(served.get("/api/faults").json(), json!(["a"]));
}

#[test]
fn commands_are_sent_by_name_or_as_bytes() {
    let served = served(None);
    for body in [r#"{"name": "set-mode", "arguments": [1]}"#, r#"{"bytes": "02 01"}"#] {
        let got = served.post("/api/commands", body);
        assert_eq!(
            (got.status, &got.json()["name"], &got.json()["outcome"]),
            (200, &json!("SET_MODE"), &json!("done"))
        );
    }
    let ping = served.post("/api/commands", r#"{"name": "PING"}"#).json();
    assert_eq!((&ping["values"], &ping["bytes"]), (&json!({ "major": 1, "minor": 0 }), &json!("01000100")));
    for wrong in [
        r#"{}"#,
        r#"{"name": "NONSENSE"}"#,
        r#"{"name": "SET_MODE"}"#,
        r#"{"name": "SET_MODE", "arguments": [256]}"#,
        r#"{"name": "SET_MODE", "arguments": ["1"]}"#,
        r#"{"name": "SET_MODE", "arguments": 1}"#,
        r#"{"name": "PING", "bytes": "01"}"#,
        r#"{"bytes": "1"}"#,
        r#"{"bytes": "01", "arguments": [1]}"#,
        r#"{"name": "PING", "twice": true}"#,
        r#"{"name": 7}"#,
    ] {
        assert_eq!(served.post("/api/commands", wrong).error_status(), 400, "{wrong}");
    }
    assert_eq!(served.post("/api/commands", r#"{"name": "RESET_SEQUENCE"}"#).error_status(), 503, "no answer");
}

#[test]
fn watch_events_are_checked_and_limited() {
    let served = served(None);
    let valid = json!({
        "t_s": 3012.5, "event": "alarm", "code": "unknown", "gyros": ["GYRX"], "statistic": 40.2, "threshold": 31.0
    });
    let posted = served.post("/api/watch", &valid.to_string());
    assert_eq!((posted.status, posted.json()), (201, valid.clone()));
    for (key, wrong, expected) in [
        ("t_s", json!("1"), "t_s: expected a time from 0 to 1e12 s, got \"1\""),
        ("t_s", json!(-1), "t_s: "),
        ("t_s", json!(1e300), "t_s: "),
        ("t_s", Value::Null, "t_s: "),
        ("event", json!("<b>"), "event: expected alarm, named, interruption or reference-end, got \"<b>\""),
        ("code", json!(""), "code: "),
        ("code", json!("<script>"), "code: expected 1 to 64 characters a-z, 0-9 and -, got"),
        ("code", json!("x".repeat(65)), "code: "),
        ("code", json!(["drift"]), "code: "),
        ("gyros", json!("GYRX"), "gyros: expected a list of GYRX, GYRY, GYRZA and GYRZB, each at most once, got"),
        ("gyros", json!(["GYRX", "GYRX"]), "gyros: "),
        ("gyros", json!(["GYRQ"]), "gyros: "),
        ("statistic", Value::Null, "statistic: expected a number, got null"),
        ("threshold", json!({}), "threshold: "),
        ("number", json!(1), "expected the keys t_s, event, code, gyros, statistic, threshold, got \"number\""),
    ] {
        let mut event = valid.clone();
        event[key] = wrong;
        let rejected = served.post("/api/watch", &event.to_string());
        assert_eq!(rejected.error_status(), 400, "{event}");
        assert!(rejected.json()["error"].as_str().unwrap().contains(expected), "{rejected:?}");
    }
    for body in ["", "[]", "{", "{}", r#"{"t_s": 1e999}"#, r#"{"t_s": 1, "t_s": 2}"#, &"[".repeat(1000)] {
        assert_eq!(served.post("/api/watch", body).error_status(), 400, "{body}");
    }
    assert_eq!(served.post("/api/watch", &format!("{valid}{}", " ".repeat(watch::MAX_BODY))).error_status(), 413);
    assert_eq!(served.ask("POST", "/api/watch", &[], &valid.to_string()).error_status(), 415);
    assert_eq!(served.get("/api/watch").json(), json!([valid]), "nothing rejected is kept");

    let (limit, start) = (watch::RateLimit::new(), Instant::now());
    let accepted =
        |at_s: f64, count: usize| (0..count).filter(|_| limit.accepts(start + Duration::from_secs_f64(at_s))).count();
    assert_eq!([accepted(0.001, 1000), accepted(1.001, 1000), accepted(3600.0, 1000)], [100, 20, 100]);
    // At once over one connection: the excess would take ten seconds at the permitted rate.
    let (valid, mut stream) = (valid.to_string(), served.connect());
    let head = "POST /api/watch HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: ";
    let requests = format!("{head}{}\r\n\r\n{valid}", valid.len()).repeat(300);
    stream
        .write_all(format!("{requests}GET / HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n").as_bytes())
        .unwrap();
    let answers = rest(&mut stream).body;
    assert!(answers.contains("429 Too Many Requests") && answers.contains("at most 20 events per second, got more"));
}

#[test]
fn invalid_requests_are_rejected_in_json() {
    let served = served(None);
    assert_eq!(served.get("/api/nothing").error_status(), 404);
    assert_eq!(served.get("/../etc/passwd").error_status(), 404);
    assert_eq!(served.post("/api/status", "{}").error_status(), 405);
    assert_eq!(served.ask("OPTIONS", "/api/faults", &[], "").error_status(), 405);
    for body in ["", "nonsense", "[1]", "{\"a\":", &"[".repeat(5000), "\u{0}"] {
        assert_eq!(served.post("/api/faults", body).error_status(), 400, "{body:.20}");
    }
    for wrong in ["text/plain", "application/x-www-form-urlencoded", "application/jsonp"] {
        assert_eq!(served.ask("POST", "/api/faults", &[("content-type", wrong)], "{}").error_status(), 415);
    }
    assert_eq!(served.ask("POST", "/api/faults", &[], "{}").error_status(), 415);
    assert_eq!(served.ask("DELETE", "/api/faults", &[], "x").error_status(), 415);
    let with_charset = [("content-type", "Application/JSON; charset=utf-8")];
    assert_eq!(served.ask("POST", "/api/faults", &with_charset, r#"{"id": "a"}"#).status, 201);
}
