//! Client commands find an emulator by address, by link, or as the only one that runs.

use std::path::Path;
use std::process::{Command, Output};

use geu_tests::emulator::Emulator;
use geu_tests::geu;

/// The program with its own runtime directory, in which no other emulator is found.
fn geu_in(directory: &Path) -> Command {
    let mut command = geu();
    command.env("XDG_RUNTIME_DIR", directory).env_remove("GEU_CONTROL_TOKEN");
    command
}

fn start(directory: &Path, pty: &Path, control: &str) -> Emulator {
    let arguments = ["--pty", pty.to_str().expect("text"), "--tcp", "127.0.0.1:0", "--control", control];
    Emulator::start_as(geu_in(directory), 2, &arguments)
}

fn ask(directory: &Path, arguments: &[&str]) -> Output {
    geu_in(directory).args(arguments).output().expect("geu starts")
}

fn done(output: &Output) -> (String, String) {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    (String::from_utf8_lossy(&output.stdout).into_owned(), said)
}

fn refused(output: &Output, code: i32) -> String {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{said}");
    said
}

#[test]
fn the_only_emulator_is_used_and_several_are_refused() {
    let directory = tempfile::tempdir().expect("a directory");
    let directory = directory.path();
    for client in [&["inject", "--list"][..], &["monitor", "--count", "1"], &["send", "PING"]] {
        assert!(refused(&ask(directory, client), 1).contains("expected a running emulator, got none"));
    }
    let (pty, other_pty) = (directory.join("one"), directory.join("other"));
    let mut one = start(directory, &pty, "127.0.0.1:0");
    let (control, pid) = (one.control(), format!("process {}", one.child.id()));
    for client in [&["inject", "--list"][..], &["monitor", "--count", "1"]] {
        let (_, said) = done(&ask(directory, client));
        assert!(said.contains(&pid) && said.contains(&control) && said.contains(pty.to_str().expect("text")), "{said}");
    }
    let (reply, said) = done(&ask(directory, &["send", "PING"]));
    assert!(reply.starts_with("PING: done") && said.contains(&pid), "{reply}{said}");

    let mut other = start(directory, &other_pty, "127.0.0.1:0");
    let other_control = other.control();
    for client in [&["inject", "--list"][..], &["monitor", "--count", "1"], &["send", "PING"]] {
        let said = refused(&ask(directory, client), 2);
        for expected in
            ["expected one running emulator, got 2", &control, &other_control, other_pty.to_str().expect("text")]
        {
            assert!(said.contains(expected), "{expected}: {said}");
        }
    }
    // By address, by link, by another path of that link.
    let pid = format!("process {}", other.child.id());
    let beside = directory.join(".").join("other");
    let tcp = other.ready.iter().find_map(|ready| ready.strip_prefix("tcp ")).expect("a TCP link").to_owned();
    for named in [
        &["--control", &*other_control][..],
        &["--control", &format!("http://{other_control}/")],
        &["--at", other_pty.to_str().expect("text")],
        &["--at", beside.to_str().expect("text")],
        &["--at", &tcp],
    ] {
        let (_, said) = done(&ask(directory, &[&["inject", "--list"], named].concat()));
        assert!(said.contains(&pid), "{named:?}: {said}");
    }
    let (_, said) = done(&ask(directory, &["send", other_pty.to_str().expect("text"), "HEATER", "off"]));
    assert!(said.contains(&pid), "{said}");
    let said = refused(&ask(directory, &["inject", "--list", "--at", "vcan7"]), 2);
    assert!(said.contains("--at vcan7") && said.contains(&tcp), "{said}");

    // A killed emulator is not listed; an emulator that ends removes its file.
    other.child.kill().expect("killed");
    other.child.wait().expect("its end");
    done(&ask(directory, &["inject", "--list"]));
    one.ask_to_end();
    one.child.wait().expect("its end");
    assert!(refused(&ask(directory, &["inject", "--list"]), 1).contains("got none"));
    assert_eq!(std::fs::read_dir(directory.join("geu")).expect("it is there").count(), 0);
}

#[test]
fn send_reports_an_emulator_without_control_interface() {
    let directory = tempfile::tempdir().expect("a directory");
    let _emulator = start(directory.path(), &directory.path().join("geu0"), "off");
    let said = refused(&ask(directory.path(), &["inject", "--list"]), 1);
    assert!(said.contains("control off") && said.contains("expected an emulator with a control interface"), "{said}");
    done(&ask(directory.path(), &["send", "--raw", "01"]));
}

#[test]
fn send_accepts_names_and_suggests_the_nearest_for_others() {
    let directory = tempfile::tempdir().expect("a directory");
    let pty = directory.path().join("geu0");
    let _emulator = start(directory.path(), &pty, "off");
    let pty = pty.to_str().expect("text");
    for arguments in [
        &["SELF_TEST", "GYRX,gyrzb", "-100", "4"][..],
        &["heater", "on"],
        &["set-mode", "cyclic"],
        &["GYRO_POWER", "all"],
    ] {
        let (reply, _) = done(&ask(directory.path(), &[&["send", pty], arguments].concat()));
        assert!(reply.contains("done"), "{reply}");
    }
    for (arguments, expected) in [
        (&["send", pty, "PNIG"][..], "did you mean `PING`?"),
        (&["send", "PNIG"], "did you mean `PING`?"),
        (&["send", pty, "HEATER", "of"], "did you mean `off`?"),
        (&["send", pty], "expected [LINK] COMMAND"),
        (&["send"], "expected [LINK] COMMAND"),
        (&["inject", "stuck-count", "GYRXX", "--control", "127.0.0.1:1"], "did you mean `GYRX`?"),
        (&["faults", "list", "--link", "serail"], "did you mean `serial`?"),
    ] {
        let said = refused(&ask(directory.path(), arguments), 2);
        assert!(said.contains(expected), "{arguments:?}: {said}");
    }
    let (help, _) = done(&ask(directory.path(), &["send", "--list"]));
    for name in ["0 off, 1 on", "0 cyclic, 1 polled", "GYRX, GYRY, GYRZA, GYRZB, all"] {
        assert!(help.contains(name), "{help}");
    }
}
