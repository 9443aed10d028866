//! Who may use the interface: pages of other sites, hosts, tokens, addresses.

use std::net::TcpListener;

use super::*;

#[test]
fn pages_of_other_sites_are_rejected() {
    let served = served(None);
    let own = format!("http://{}", served.address);
    assert_eq!(served.ask("GET", "/api/status", &[("origin", &own)], "").status, 200);
    for origin in ["http://evil.example", "null", "https://127.0.0.1:8470", "http://127.0.0.1:1", "http://localhost"] {
        for (method, path) in [("GET", "/api/status"), ("GET", "/"), ("DELETE", "/api/faults")] {
            assert_eq!(served.ask(method, path, &[("origin", origin)], "").error_status(), 403, "{origin} {path}");
        }
    }
    for site in ["cross-site", "same-site"] {
        assert_eq!(served.ask("GET", "/api/events", &[("sec-fetch-site", site)], "").error_status(), 403);
    }
    assert_eq!(served.ask("GET", "/api/status", &[("sec-fetch-site", "same-origin")], "").status, 200);
    assert_eq!(
        served.ask("GET", "/", &[("sec-fetch-site", "cross-site")], "").status,
        200,
        "links from other sites are permitted"
    );
}

#[test]
fn dns_rebinding_hosts_are_rejected() {
    let served = served(None);
    let port = served.address.port();
    for host in ["localhost", "LOCALHOST", "127.0.0.1", "127.0.0.2", "[::1]"] {
        assert_eq!(served.ask("GET", "/api/status", &[("host", &format!("{host}:{port}"))], "").status, 200, "{host}");
    }
    assert_eq!(served.ask("GET", "/", &[("host", "127.0.0.1:9000")], "").status, 200, "through a tunnel");
    let evil = [
        "evil.example",
        "127.0.0.1.evil.example",
        "localhost.evil.example",
        "192.0.2.1",
        "evil@localhost",
        "a b",
        "",
        "0",
        "[::1",
        "2130706433",
    ];
    for host in evil {
        let rejected = served.ask("GET", "/api/status", &[("host", host)], "");
        assert!([400, 403].contains(&rejected.status), "{host}: {rejected:?}");
    }
    assert_eq!(
        served.ask("GET", "/api/status", &[("host", "localhost"), ("host", "localhost")], "").error_status(),
        400
    );
    assert_eq!(served.raw(b"GET /api/status HTTP/1.0\r\n\r\n").error_status(), 400);
    let absolute = format!("http://evil.example:{port}/api/status");
    assert_eq!(served.ask("GET", &absolute, &[], "").error_status(), 403);
}

#[test]
fn requests_without_the_token_are_rejected() {
    let served = served(Some("s3cret"));
    assert_eq!(served.get("/").status, 200, "the page holds no secret");
    for (path, headers) in [
        ("/api/status", &[][..]),
        ("/api/status?token=", &[]),
        ("/api/status?token=s3cre", &[]),
        ("/api/status?token=s3crets", &[]),
        ("/api/nothing", &[]),
        ("/%61pi/status", &[]),
        ("//api/status", &[]),
        ("/api/status", &[("authorization", "Bearer wrong")]),
        ("/api/status", &[("authorization", "Basic s3cret")]),
        ("/api/events", &[]),
    ] {
        assert_eq!(served.ask("GET", path, headers, "").error_status(), 401, "{path} {headers:?}");
    }
    assert_eq!(served.ask("DELETE", "/api/faults", &[], "").error_status(), 401);
    assert_eq!(served.get("/api/status?token=s3cret").status, 200);
    assert_eq!(served.ask("GET", "/api/status", &[("authorization", "Bearer s3cret")], "").status, 200);
}

#[test]
fn public_addresses_need_a_token_and_only_the_default_port_is_replaced_if_in_use() {
    for address in ["0.0.0.0:0", "[::]:0"] {
        for token in [None, Some(String::new())] {
            let error = ControlListener::open(address, false, token).unwrap_err().to_string();
            assert!(error.contains("expected a token"), "{error}");
        }
    }
    let listener = ControlListener::open("0.0.0.0:0", false, Some("s3cret".to_owned())).unwrap();
    assert!(listener.address().ip().is_unspecified());
    for address in ["nonsense", "127.0.0.1", "127.0.0.1:70000", "192.0.2.1:0"] {
        let error = ControlListener::open(address, true, Some("s3cret".to_owned())).unwrap_err().to_string();
        assert!(error.starts_with(&format!("--control {address}: ")), "{error}");
    }
    // One port is in use, and one of the next hundred is free.
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    assert!(ControlListener::open(&address.to_string(), false, None).unwrap_err().to_string().contains("free"));
    if address.port() < u16::MAX - 100 {
        let next = ControlListener::open(&address.to_string(), true, None).unwrap().address();
        assert!(next.port() > address.port() && next.port() < address.port() + 100, "{next}");
    }
}
