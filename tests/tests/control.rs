//! The control interface under what clients can do to it, and clients of it under what answers them.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::process::CommandExt;
use std::process::Output;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use geu_tests::emulator::Emulator;
use geu_tests::geu;
use nix::sys::resource::{Resource, setrlimit};
use serde_json::json;

/// Control and one TCP link, with more arguments.
fn start(arguments: &[&str]) -> (Emulator, String) {
    let arguments = [&["--tcp", "127.0.0.1:0", "--control", "127.0.0.1:0"], arguments].concat();
    let mut emulator = Emulator::start(1, &arguments);
    let address = emulator.control();
    (emulator, address)
}

/// Status and body of an answer, or why there is none.
fn ask(address: &str, method: &str, path: &str, body: &str) -> std::io::Result<(u16, String)> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(Duration::from_secs(20)))?;
    let head = format!(
        "{method} {path} HTTP/1.1\r\nhost: {address}\r\ncontent-type: application/json\r\nconnection: close\r\ncontent-length: {}\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body.as_bytes())?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    let status = answer.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or_default();
    Ok((status, answer))
}

fn failed(output: &Output, code: i32) -> String {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{said}");
    said
}

#[test]
fn long_plans_hold_up_neither_other_clients_nor_the_end() {
    let (mut emulator, address) = start(&[]);
    // As many as may be: the longest plan that is read to its end, and then refused for its last fault.
    let read = format!("{}[[fault]]\nfault = \"none such\"\n", "[[fault]]\nfault = \"drop\"\nat_s = 1e6\n".repeat(999));
    let refused = "[[fault]]\nfault=\"drop\"\n".repeat(20_000);
    let (stop, answered) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
    let posters: Vec<_> = [(read, "none such"), (refused, "at most 1000 faults, got 20000")]
        .into_iter()
        .cycle()
        .take(6)
        .map(|(plan, expected)| {
            let (stop, answered, address) = (stop.clone(), answered.clone(), address.clone());
            let body = json!({ "plan": plan }).to_string();
            thread::spawn(move || {
                while !stop.load(Relaxed) {
                    match ask(&address, "POST", "/api/faults", &body) {
                        Ok((status, answer)) if status != 0 => {
                            assert!(status == 400 && answer.contains(expected), "{answer:.200}");
                            answered.fetch_add(1, Relaxed);
                        }
                        // It ends meanwhile.
                        _ => assert!(stop.load(Relaxed), "no answer"),
                    }
                }
            })
        })
        .collect();
    let mut slowest = Duration::ZERO;
    for _ in 0..20 {
        let start = Instant::now();
        let (status, _) = ask(&address, "GET", "/api/status", "").expect("an answer");
        assert_eq!(status, 200);
        slowest = slowest.max(start.elapsed());
        sleep(Duration::from_millis(50));
    }
    // Each plan took seconds. Two processors are shared with six posters and with other tests.
    assert!(slowest < Duration::from_millis(1500), "{slowest:?}");
    assert!(answered.load(Relaxed) >= 6, "plans were answered meanwhile");
    stop.store(true, Relaxed);
    let start = Instant::now();
    emulator.ask_to_end();
    assert!(emulator.child.wait().expect("its end").success());
    // A second is allowed; as much again is the machine's, on which six posters and other tests run. It took five and more.
    assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
    posters.into_iter().for_each(|poster| poster.join().expect("answered as expected"));
}

#[test]
fn a_plan_of_a_hundred_thousand_faults_is_refused_by_its_count() {
    let directory = tempfile::tempdir().expect("a directory");
    let plan = directory.path().join("plan.toml");
    fs::write(&plan, "[[fault]]\nfault=\"drop\"\n".repeat(100_000)).expect("written");
    let plan = plan.to_str().expect("text");
    for arguments in [&["config", "check", plan][..], &["run", "--tcp", "127.0.0.1:0", "--faults", plan]] {
        let start = Instant::now();
        let said = failed(&geu().args(arguments).output().expect("geu starts"), 2);
        assert!(said.contains("expected at most 1000 faults, got 100000"), "{said}");
        // Two megabytes of TOML take a second; reading the faults took minutes.
        assert!(start.elapsed() < Duration::from_secs(15), "{:?}", start.elapsed());
    }
}

/// A control interface that answers each request with an event stream of one endless line of up to `max` bytes.
fn sends_an_endless_line(max: usize) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address").to_string();
    thread::spawn(move || {
        let (stream, _) = listener.accept().expect("a client");
        let mut lines = BufReader::new(&stream).lines();
        lines.find(|line| line.as_ref().is_ok_and(String::is_empty)).expect("the end of the head").expect("text");
        let head =
            "HTTP/1.1 200 OK\r\ncontent-type: text/event-stream\r\nconnection: close\r\n\r\nevent: timeline\ndata: ";
        (&stream).write_all(head.as_bytes()).expect("sent");
        let block = vec![b'1'; 1 << 20];
        for _ in 0..max >> 20 {
            if (&stream).write_all(&block).is_err() {
                break;
            }
        }
    });
    address
}

#[test]
fn an_endless_event_line_ends_the_monitor_with_a_message() {
    let address = sends_an_endless_line(1 << 30);
    let mut monitor = geu();
    monitor.args(["monitor", "--control", &address]);
    // Half of what is sent: where lines are kept whole, this aborts.
    let max = 512 << 20;
    // SAFETY: between fork and exec this makes one system call and touches no memory.
    unsafe { monitor.pre_exec(move || setrlimit(Resource::RLIMIT_AS, max, max).map_err(std::io::Error::from)) };
    let said = failed(&monitor.output().expect("geu starts"), 1);
    assert!(said.contains("lines of at most") && said.contains("is it an emulator?"), "{said}");
}

#[test]
fn a_silent_address_ends_the_monitor() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("its address").to_string();
    let start = Instant::now();
    let said = failed(&geu().args(["monitor", "--control", &address]).output().expect("geu starts"), 1);
    assert!(start.elapsed() < Duration::from_secs(10), "{:?}", start.elapsed());
    assert!(said.contains(&format!("{address}: expected an answer within 5s, got none")), "{said}");
}

/// A server that gives every request this answer.
fn answers(answer: &'static str) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("its address").to_string();
    thread::spawn(move || {
        while let Ok((mut stream, _)) = listener.accept() {
            // The request fits into one read.
            let _ = stream.read(&mut [0; 4096]);
            let _ = stream.write_all(answer.as_bytes());
        }
    });
    address
}

#[test]
fn a_server_that_is_no_emulator_is_recognised() {
    let json = "HTTP/1.1 200 OK\r\ncontent-type: application/json\r\ncontent-length: 2\r\nconnection: close\r\n\r\n{}";
    let moved =
        "HTTP/1.1 302 Found\r\nlocation: http://127.0.0.1:1/\r\ncontent-length: 2\r\nconnection: close\r\n\r\n{}";
    let directory = tempfile::tempdir().expect("a directory");
    let plan = directory.path().join("plan.toml");
    fs::write(&plan, "[[fault]]\nfault = \"dead\"\ngyro = \"GYRX\"\nfor_s = 1\n").expect("written");
    let plan = plan.to_str().expect("text");
    for (arguments, expected) in [
        (&["inject", "stuck-count", "GYRX", "counts=1"][..], "expected the answer of an emulator, got {};"),
        (&["inject", "--plan", plan], "expected the answer of an emulator, got {};"),
        (&["inject", "--clear", "all"], "expected the answer of an emulator, got {};"),
        (&["inject", "--list"], "expected the answer of an emulator, got {};"),
        (&["monitor"], "expected a stream of events, got another answer; is it an emulator?"),
    ] {
        let said = failed(&geu().args(arguments).args(["--control", &answers(json)]).output().expect("geu starts"), 1);
        assert!(said.contains(expected), "{arguments:?}: {said}");
    }
    let redirected = geu().args(["inject", "--clear", "all", "--control", &answers(moved)]).output();
    assert!(failed(&redirected.expect("geu starts"), 2).contains("302"));
}

#[test]
fn a_plan_without_a_fault_is_refused() {
    let (_emulator, address) = start(&[]);
    let directory = tempfile::tempdir().expect("a directory");
    let plan = directory.path().join("plan.toml");
    fs::write(&plan, "# none yet\n").expect("written");
    let output = geu().args(["inject", "--control", &address, "--plan"]).arg(&plan).output();
    let said = failed(&output.expect("geu starts"), 2);
    assert!(said.contains("expected a plan with [[fault]], got none"), "{said}");
}

#[test]
fn the_token_comes_from_a_file_or_the_environment_and_no_message_shows_it() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = |name: &str| directory.path().join(name).to_str().expect("text").to_owned();
    let (file, wrong, blank) = (path("token"), path("wrong"), path("blank"));
    fs::write(&file, "of-a-file\n").expect("written");
    fs::write(&wrong, "se cret\nof two lines").expect("written");
    fs::write(&blank, "\n").expect("written");
    let (_emulator, address) = start(&["--control-token-file", &file]);
    let list = |arguments: &[&str], environment: &str| {
        let mut inject = geu();
        inject.env("GEU_CONTROL_TOKEN", environment).args(["inject", "--list", "--control", &address]).args(arguments);
        inject.output().expect("geu starts")
    };
    for (arguments, environment) in
        [(&["--control-token-file", &*file][..], ""), (&["--control-token", "of-a-file"], ""), (&[], "of-a-file")]
    {
        let output = list(arguments, environment);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    // The file is the more particular.
    assert!(list(&["--control-token-file", &file], "another").status.success());
    let said = failed(&list(&[], "secret-word"), 2);
    assert!(
        said.contains("got another; give it with --control-token-file FILE") && !said.contains("secret-word"),
        "{said}"
    );
    for (arguments, environment, expected) in [
        (&["--control-token-file", &*wrong][..], "", "visible ASCII"),
        (&["--control-token-file", &*blank], "", "visible ASCII"),
        (&["--control-token-file", "/none/such"], "", "cannot be read"),
        (&[], "se\ncret", "GEU_CONTROL_TOKEN"),
    ] {
        let said = failed(&list(arguments, environment), 2);
        assert!(said.contains(expected) && !said.contains("cret"), "{said}");
    }
    for command in ["run", "inject", "monitor"] {
        let help =
            geu().env("GEU_CONTROL_TOKEN", "secret-word").args([command, "--help"]).output().expect("geu starts");
        let help = String::from_utf8_lossy(&help.stdout).into_owned();
        assert!(help.contains("--control-token-file") && help.contains("GEU_CONTROL_TOKEN"), "{help}");
        assert!(!help.contains("secret-word"), "{help}");
    }
}
