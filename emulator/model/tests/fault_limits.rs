//! Long lists of faults: what is too long is refused before it is read, and reading takes a time in proportion.

use std::time::Duration;

use geu_model::Configuration;
use geu_model::configuration::fault::{MAX_FAULTS, read_plan_text};
use geu_model::device::Device;
use geu_model::fault::Fault;
use geu_model::fault::catalogue::Transport;
use nix::time::{ClockId, clock_gettime};

const DROP: &str = "[[fault]]\nfault = \"drop\"\nat_s = 1e6\n";

/// Processor times of one and of the other, in turn, the minimum of five each: the other load of the machine slows both.
fn min_times(one: impl Fn(), other: impl Fn()) -> [Duration; 2] {
    let now = || Duration::from(clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).expect("the thread's clock"));
    let time = |work: &dyn Fn()| {
        let start = now();
        work();
        now() - start
    };
    let rounds = (0..5).map(|_| [time(&one), time(&other)]);
    rounds.fold([Duration::MAX; 2], |min, own| [min[0].min(own[0]), min[1].min(own[1])])
}

/// A configuration as a run records it, with this number of injected faults.
fn recorded(count: usize, fault: impl Fn(usize) -> String) -> String {
    let ids: Vec<String> = (1..=count).map(|number| format!("\"fault-{number}\"")).collect();
    let faults: String = (1..=count).map(fault).collect();
    format!("[run]\ninjected = [{}]\n{faults}", ids.join(", "))
}

#[test]
fn too_many_faults_are_refused_before_one_is_read() {
    let many = format!("[[fault]]\nfault = \"no such fault\"\n{}", DROP.repeat(100_000));
    let mut configuration = Configuration::reference();
    let in_file = Configuration::parse("file", &many, &[]).expect_err("too many").message;
    let in_plan = configuration.add_plan("plan", &many).expect_err("too many").message;
    let live = read_plan_text(&Device::iras(), "plan", &many, &[], &Transport::ALL).expect_err("too many").message;
    for refused in [in_file, in_plan, live] {
        assert_eq!(refused, format!("expected at most {MAX_FAULTS} faults, got 100001"));
    }
    let expectations = "[[expect]]\ncondition = \"no such condition\"\n".repeat(100_000);
    let refused = configuration.add_plan("plan", &expectations).expect_err("too many").message;
    assert_eq!(refused, format!("expected at most {MAX_FAULTS} expectations, got 100000"));
}

#[test]
fn ten_times_as_many_faults_take_about_ten_times_as_long() {
    let made_up = |_: usize| DROP.to_owned();
    let named =
        |number: usize| format!("[[fault]]\nid = \"fault-{number}\"\nfault = \"drop\"\nwhen = \"active(fault-1)\"\n");
    for fault in [&made_up as &dyn Fn(usize) -> String, &named] {
        let [few, many] = [1_000, 10_000].map(|count| recorded(count, fault));
        let read = |text: &String| {
            let configuration = Configuration::parse("run.toml", text, &[]).expect("valid");
            assert!(!configuration.columns().is_empty());
        };
        let [few, many] = min_times(|| read(&few), || read(&many));
        // Ten, and caches that are too small for it; a time that grows with the square is a hundred.
        assert!(many < few * 25, "{few:?} for a thousand, {many:?} for ten thousand");
    }
}

#[test]
fn identifiers_are_made_up_as_ever() {
    let read = |others: &[Fault], text: &str| -> Vec<String> {
        let faults = read_plan_text(&Device::iras(), "plan", text, others, &Transport::ALL).expect("valid");
        faults.into_iter().map(|fault| fault.id).collect()
    };
    let others =
        read_plan_text(&Device::iras(), "plan", "[[fault]]\nid = \"fault-2\"\nfault = \"drop\"", &[], &Transport::ALL)
            .expect("valid");
    let named = "[[fault]]\nid = \"fault-3\"\nfault = \"drop\"\n";
    assert_eq!(read(&others, &[DROP, DROP, named, DROP].concat()), ["fault-1", "fault-4", "fault-3", "fault-5"]);
}

#[test]
fn a_message_lists_few_of_many_faults_and_offers_the_likeliest() {
    let many: String =
        (1..=900).map(|number| format!("[[fault]]\nid = \"valve-{number}\"\nfault = \"drop\"\n")).collect();
    let asking = format!("{many}[[fault]]\nfault = \"drop\"\nwhen = \"active(valv-900)\"\n");
    let refused = read_plan_text(&Device::iras(), "plan", &asking, &[], &Transport::ALL).expect_err("unknown").message;
    assert!(refused.contains("did you mean `valve-900`?") && refused.contains("and 871 more"), "{refused}");
    assert!(refused.len() < 1000, "{refused}");
}

#[test]
fn names_in_a_fault_that_are_none_are_refused_with_the_likeliest() {
    for (text, meant) in [
        ("fault = \"stuck-cuont\"", "stuck-count"),
        ("fault = \"stuck-count\"\ncounts = 1\ngyro = \"GYRXX\"", "GYRX"),
        ("fault = \"drop\"\nlink = \"serail\"", "serial"),
        (
            "parameter = \"pivot-clearence.clearance_arcsec\"\ngyro = \"GYRX\"\ncourse = { step = 1 }",
            "pivot-clearance.clearance_arcsec",
        ),
        ("fault = \"drop\"\nprobabilty = 0.5", "probability"),
    ] {
        let refused = read_plan_text(&Device::iras(), "plan", &format!("[[fault]]\n{text}\n"), &[], &Transport::ALL)
            .expect_err(text)
            .message;
        assert!(refused.contains(&format!("did you mean `{meant}`?")), "{refused}");
    }
}
