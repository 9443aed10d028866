//! The bench without the control interface: a unit whose samples end when a test says so.

use std::time::{Duration, Instant};

use geu_model::configuration::fault::MOST_EVER;
use geu_model::{Configuration, Truth};

use super::*;
use crate::cadence::Speed;

/// A bench, its unit, and the thread that shows.
struct Room {
    bench: ControlService,
    unit: Arc<SharedUnit>,
    _shower: PublisherThread,
}

fn room() -> Room {
    room_on(&Truth::Scenario)
}

fn room_on(truth: &Truth) -> Room {
    let (bench, event_publisher, publisher) = ControlService::start().expect("a thread");
    let unit = SharedUnit::new(&Configuration::reference(), truth, Speed::Max, None, Some(event_publisher));
    let unit = Arc::new(unit);
    bench.know(&unit, &[], None, &Arc::default());
    Room { bench, unit, _shower: publisher }
}

impl Room {
    fn run(&self, samples: u64) {
        for _ in 0..samples {
            self.unit.end_sample();
            self.unit.complete();
        }
    }

    fn inject(&self, fault: Value) -> Result<Value, String> {
        self.bench.inject(fault.as_object().expect("an object"))
    }

    /// Runs on until a sample is shown of which this holds.
    fn shown(&self, is_meant: impl Fn(&Value) -> bool) -> Value {
        let start = Instant::now();
        loop {
            self.run(1);
            let status = self.bench.status();
            if is_meant(&status) {
                return status;
            }
            assert!(start.elapsed() < Duration::from_secs(10), "{status}");
            thread::sleep(Duration::from_millis(10));
        }
    }
}

#[test]
fn a_condition_on_what_the_truth_does_not_tell_is_refused() {
    let fault = json!({ "fault": "dead", "gyro": "GYRX", "when": "theta_deg > 90" });
    assert!(room().inject(fault.clone()).is_ok());
    let room = room_on(&Truth::Stepped(Arc::default()));
    let refused = room.inject(fault).expect_err("no sun");
    assert!(refused.contains("when: theta_deg is not told by the truth of this run"), "{refused}");
    let refused = room
        .inject(json!({ "plan": "[[fault]]\nfault = \"reset\"\nend_when = \"psi_deg < 3\"\n" }))
        .expect_err("no sun");
    assert!(refused.contains("end_when: psi_deg"), "{refused}");
}

#[test]
fn the_last_ten_minutes_are_told_whole_though_events_are_paced() {
    let room = room();
    room.run(1500);
    let history = room.bench.history();
    let told = history.as_array().expect("a list");
    assert_eq!(told.len(), 1200);
    let times: Vec<f64> = told.iter().filter_map(|sample| sample["t_s"].as_f64()).collect();
    assert_eq!((times[0], times[1199]), (150.5, 750.0));
    assert!(times.windows(2).all(|pair| pair[1] - pair[0] == 0.5), "{times:?}");
    let last = &told[1199];
    assert_eq!(last["gyro_flags"], 0x0f);
    // What counts and truth differ by, summed over the run, as the events tell it.
    assert!(last["departure_arcsec"][0].as_f64().is_some_and(|departure| departure != 0.0), "{last}");
}

#[test]
fn faults_that_are_over_make_room_and_are_told_on_demand_alone() {
    let room = room();
    let short = json!({ "fault": "dead", "gyro": "GYRX", "for_s": 0.5 });
    for _ in 0..3 {
        let plan = "[[fault]]\nfault = \"dead\"\ngyro = \"GYRX\"\nfor_s = 0.5\n".repeat(MOST);
        assert_eq!(room.inject(json!({ "plan": plan })).expect("a plan").as_array().map(Vec::len), Some(MOST));
        let refused = room.inject(short.clone()).expect_err("full");
        assert!(refused.contains("at most 1000 faults that are armed or active, got 1001"), "{refused}");
        room.run(4);
    }
    room.inject(short).expect("room again");
    assert_eq!(room.bench.faults().as_array().map(Vec::len), Some(3 * MOST + 1));
    let shown = room.shown(|status| status["faults"].as_array().is_some_and(Vec::is_empty));
    assert!(shown.to_string().len() < 5000, "{shown}");
    assert_eq!(room.inject(json!({ "plan": "" })), Ok(json!([])));
    room.unit.close();
}

#[test]
fn a_run_has_a_greatest_number_of_faults_and_its_record_is_read_again() {
    let (mut configuration, plan) = (Configuration::reference(), "[[fault]]\nfault = \"drop\"\n");
    configuration.add_plan("plan", &plan.repeat(MOST)).expect("a plan");
    let refused = configuration.add_plan("plan", plan).expect_err("too many").to_string();
    assert!(refused.contains("expected at most 1000 faults, got 1001"), "{refused}");
    while configuration.faults.len() < MOST_EVER {
        let more = read_plan_text("plan", &plan.repeat(MOST), &configuration.faults, &Transport::ALL).expect("a plan");
        configuration.run.injected.extend(more.iter().map(|fault| fault.id.clone()));
        configuration.faults.extend(more);
    }
    let refused = read_fault_text("fault", "fault = \"drop\"", &configuration.faults, &Transport::ALL)
        .expect_err("too many")
        .to_string();
    assert!(refused.contains("expected at most 10000 faults in a run") && refused.contains("begin another run"));
    let again = Configuration::parse("run.toml", &configuration.to_toml(false), &[]).expect("read again");
    assert_eq!(again.faults.len(), MOST_EVER);
}

#[test]
fn what_is_accumulated_holds_samples_that_were_not_shown() {
    let room = room();
    let mut unit = geu_model::GyroUnit::new(&Configuration::reference());
    room.run(500);
    let shown = room.shown(|status| status["t_s"].as_f64() > Some(250.0));
    let mut departure = [0.0; 4];
    // The reference unit's own clock is right.
    while unit.ended() < (shown["t_s"].as_f64().expect("a time") * 2.0).round() as u64 {
        let (ended, traces) = unit.end_sample_traced();
        for (gyro, trace) in traces.iter().enumerate() {
            departure[gyro] += f64::from(ended.sample.increments[gyro]) - trace.true_arcsec;
        }
    }
    assert_eq!(shown["departure_arcsec"], json!(departure));
    room.unit.close();
}

#[tokio::test]
async fn commands_push_nothing_out_of_the_timeline() {
    let room = room();
    room.inject(json!({ "id": "first", "fault": "dead", "gyro": "GYRX", "for_s": 1.0 })).expect("a fault");
    room.shown(|status| status["faults"].as_array().is_some_and(Vec::is_empty));
    for _ in 0..2 {
        for _ in 0..1000 {
            room.bench.command(vec![1]).await;
        }
        room.run(1);
    }
    let start = Instant::now();
    let told = |text: &str| room.bench.timeline().iter().filter(|line| line.contains(text)).count();
    while told("996 more commands") < 2 {
        assert!(start.elapsed() < Duration::from_secs(10), "{:?}", room.bench.timeline());
        thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(told("PING (01) over control"), 8);
    let mut timeline = Timeline::default();
    timeline.push(false, "fault".into());
    (0..2 * TIMELINE).for_each(|_| timeline.push(true, "command".into()));
    assert_eq!((timeline.0.len(), &*timeline.0[0].1), (TIMELINE, "fault"));
    assert_eq!(room.bench.status()["lost"], 0);
    room.unit.close();
}
