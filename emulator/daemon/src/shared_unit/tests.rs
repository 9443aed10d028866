use std::future::Future;
use std::task::{Context, Poll, Waker};

use geu_model::GyroUnit;
use geu_protocol::CommandResult;

use super::*;
use geu_recorder::PolledSample;

fn now(shared: &SharedUnit, payload: &[u8]) -> CommandResponse {
    shared.try_command("test", payload).expect("no sample is pending").0
}

#[test]
fn a_command_just_before_the_deadline_is_executed_just_after_it() {
    let shared = SharedUnit::new(&Configuration::reference(), &Truth::Scenario, Speed::Max, None, None);
    assert_eq!(now(&shared, &[2, 1]).reply.expect("not silenced").outcome(), CommandResult::Done);
    assert_eq!(now(&shared, &[3]).reply.expect("not silenced").outcome(), CommandResult::NotPossibleNow);
    let (first, _) = shared.end_sample();
    assert!(!first.cyclic);
    let mut poll = std::pin::pin!(shared.command("test", &[3]));
    let mut context = Context::from_waker(Waker::noop());
    assert!(poll.as_mut().poll(&mut context).is_pending());
    assert_eq!(shared.waiting.load(Relaxed), 1);
    shared.complete();
    let Poll::Ready(answered) = poll.as_mut().poll(&mut context) else { panic!("the deadline has passed") };
    assert_eq!(answered.polled, Some(first));
    assert_eq!(shared.waiting.load(Relaxed), 0);
    let (second, _) = shared.end_sample();
    assert!(shared.try_command("test", &[3]).is_none());
    shared.complete();
    assert_eq!(now(&shared, &[3]).polled, Some(second));
    assert_eq!(now(&shared, &[3]).polled, Some(second));
}

#[test]
fn changes_of_faults_during_a_pending_sample_are_published_after_it() {
    let (recording, events) = recorder_thread::unwritten_feed();
    let mut configuration = Configuration::reference();
    let plan = "[[fault]]\nid = \"waits\"\nby_hand = true\nfault = \"drop\"\n[[fault]]\nid = \"dead\"\nfault = \"dead\"\ngyro = \"GYRX\"";
    configuration.add_plan("plan", plan).expect("a plan");
    let shared = SharedUnit::new(&configuration, &Truth::Scenario, Speed::Max, Some(recording), None);
    shared.end_sample();
    assert_eq!(shared.start("waits"), Some(1.0), "with the next sample that begins");
    assert_eq!(shared.clear("dead"), Some(1.0));
    shared.complete();
    shared.close();
    let published = events.into_iter().map(|event| match event {
        UnitEvent::Sample(..) => "sample",
        UnitEvent::Happened(_) => "happened",
        UnitEvent::StartedByHand { .. } => "started",
        UnitEvent::Cleared { .. } => "cleared",
        _ => "else",
    });
    assert_eq!(published.collect::<Vec<_>>(), ["happened", "sample", "started", "cleared"]);
}

#[test]
fn a_second_unit_repeats_the_published_events() {
    let configuration = Configuration::reference();
    let (recording, events) = recorder_thread::unwritten_feed();
    let shared = SharedUnit::new(&configuration, &Truth::Scenario, Speed::Max, Some(recording), None);
    let payloads: [&[u8]; 8] = [&[1], &[2, 1], &[3], &[5], &[3], &[2, 0], &[4, 1, 0, 5, 3], &[3]];
    let mut context = Context::from_waker(Waker::noop());
    for index in 0..400 {
        let payload = payloads[((index * 5) ^ (index / 8)) % 8];
        let mut command = std::pin::pin!(shared.command("test", payload));
        let is_early = index % 3 == 0;
        if is_early {
            assert!(command.as_mut().poll(&mut context).is_ready());
        }
        shared.end_sample();
        if !is_early {
            assert!(command.as_mut().poll(&mut context).is_pending());
        }
        shared.complete();
        if !is_early {
            assert!(command.as_mut().poll(&mut context).is_ready());
        }
    }
    shared.close();
    let mut unit = GyroUnit::new(&configuration);
    let (mut polled, mut end_ns, mut polls) = (None, 0, 0);
    for event in events {
        match event {
            UnitEvent::Sample(ended, traces, _) => {
                assert_eq!((ended, traces), unit.end_sample_traced());
                end_ns = ended.end_ns;
            }
            UnitEvent::Command { payload, running_end_ns, .. } => {
                assert_eq!(running_end_ns, unit.running_end_ns());
                assert_eq!(polled, None, "a recorded POLL has its data");
                polled = unit.command(&payload).expect("not silenced").polled;
            }
            UnitEvent::Polled(PolledSample { sample, end_ns: stamp_ns, .. }) => {
                polls += 1;
                assert_eq!((Some(sample), stamp_ns), (polled.take(), end_ns));
            }
            _ => unreachable!("no fault"),
        }
    }
    assert!(polls > 20 && unit.ended() == 400, "{polls}");
}
