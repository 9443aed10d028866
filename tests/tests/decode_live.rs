//! `geu decode` on a live serial link: a pty whose other side this test holds.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::fd::OwnedFd;
use std::process::Stdio;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use geu_protocol::serial::data_frame;
use geu_protocol::{CLOCK_PER_HALF_SECOND, HalfSecond};
use geu_tests::geu;
use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use nix::pty::openpty;
use nix::sys::signal::{Signal, kill};
use nix::unistd::{Pid, ttyname};

fn half_second(index: u16) -> HalfSecond {
    HalfSecond {
        sequence: index,
        // Bytes that a terminal in cooked mode would change or act on: carriage return, interrupt, end of file.
        increments: [0x0D0A, 0x0304, 0x1113, 0x7F0D],
        clock_count: (u64::from(index) + 1) * CLOCK_PER_HALF_SECOND,
        ..HalfSecond::default()
    }
}

/// One test at a time: a program started between the opening of a pty and its marking would hold it open.
static TURN: Mutex<()> = Mutex::new(());

fn turn() -> MutexGuard<'static, ()> {
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

fn open() -> (File, OwnedFd, String) {
    let pty = openpty(None, None).expect("a pty");
    fcntl(&pty.master, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).expect("closed in programs");
    fcntl(&pty.slave, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).expect("closed in programs");
    let path = ttyname(&pty.slave).expect("its name").to_str().expect("UTF-8").to_owned();
    (File::from(pty.master), pty.slave, path)
}

fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).expect("after 1970").as_secs_f64()
}

#[test]
fn rows_of_a_pty_come_at_once_and_an_interrupt_ends_with_the_summary() {
    let _turn = turn();
    let (mut master, _slave, path) = open();
    let mut child =
        geu().args(["decode", &path]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("geu starts");
    let mut lines = BufReader::new(child.stdout.take().expect("its output")).lines();
    // The port discards what was there when it was opened: wait until it listens.
    std::thread::sleep(Duration::from_millis(500));
    let frame = data_frame(&half_second(0));
    master.write_all(&frame[..10]).expect("written");
    std::thread::sleep(Duration::from_millis(20));
    master.write_all(&frame[10..]).expect("written");
    let before_s = now_s();
    assert!(lines.next().expect("a header").expect("text").starts_with("t_s,"));
    let row = lines.next().expect("a row").expect("text");
    let t_s: f64 = row.split(',').next().and_then(|time| time.parse().ok()).expect("a time");
    assert!((t_s - before_s).abs() < 0.1, "{t_s} is not when the last byte came, {before_s}");
    assert!(row.ends_with(",0,500000,3338,772,4371,32525,0,0,0.00,0.00"), "{row}");
    master.write_all(&data_frame(&half_second(1))).expect("written");
    assert!(lines.next().expect("a row").expect("text").contains(",1,1000000,"));
    kill(Pid::from_raw(child.id() as i32), Signal::SIGINT).expect("a signal");
    let mut errors = String::new();
    child.stderr.take().expect("its errors").read_to_string(&mut errors).expect("text");
    assert!(child.wait().expect("its end").success(), "{errors}");
    for expected in
        ["bytes-decoded            56", "accounts for all", "defects                  0", "rows                     2"]
    {
        assert!(errors.contains(expected), "{expected} not in {errors}");
    }
}

#[test]
fn a_link_that_goes_away_ends_the_decoding() {
    let _turn = turn();
    let (mut master, slave, path) = open();
    let child =
        geu().args(["decode", &path]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("geu starts");
    std::thread::sleep(Duration::from_millis(500));
    drop(slave);
    master.write_all(&data_frame(&half_second(7))).expect("written");
    std::thread::sleep(Duration::from_millis(300));
    drop(master);
    let output = child.wait_with_output().expect("its end");
    assert!(output.status.success());
    assert_eq!(String::from_utf8_lossy(&output.stdout).lines().count(), 2);
}

#[test]
fn a_duration_ends_a_silent_link() {
    let _turn = turn();
    let (_master, _slave, path) = open();
    let output = geu().args(["decode", &path, "--duration", "0.3", "--strict"]).output().expect("geu starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
