//! The control service without HTTP: the test ends the samples of the unit.

use std::thread;
use std::time::{Duration, Instant};

use geu_model::configuration::fault::MAX_RUN_FAULTS;
use geu_model::device::Device;
use geu_model::fault::catalogue::Transport;
use geu_model::{Configuration, Truth};

use super::*;
use crate::cadence::Speed;
use crate::shared_unit::SharedUnit;

/// The service of a unit.
struct Served {
    service: Arc<ControlService>,
    unit: Arc<SharedUnit>,
}

fn served() -> Served {
    served_with(&Truth::Scenario)
}

fn served_with(truth: &Truth) -> Served {
    let (service, observer, _) = ControlService::start(&Device::iras()).expect("a thread");
    let unit = SharedUnit::new(&Configuration::reference(), truth, Speed::Max, None, Some(observer));
    let unit = Arc::new(unit);
    service.set_source(StatusSource::new(&unit, &[], None, &Arc::default()));
    Served { service, unit }
}

impl Served {
    fn run(&self, samples: u64) {
        for _ in 0..samples {
            self.unit.end_sample();
            self.unit.complete();
        }
    }

    fn inject(&self, fault: Value) -> Result<Value, String> {
        self.service.inject(fault.as_object().expect("an object"))
    }

    /// Runs until a published status matches `is_meant`.
    fn published(&self, is_meant: impl Fn(&Value) -> bool) -> Value {
        let start = Instant::now();
        loop {
            self.run(1);
            let status = self.service.status();
            if is_meant(&status) {
                return status;
            }
            assert!(start.elapsed() < Duration::from_secs(10), "{status}");
            thread::sleep(Duration::from_millis(10));
        }
    }
}

#[test]
fn conditions_on_unavailable_truth_are_rejected() {
    let fault = json!({ "fault": "dead", "gyro": "GYRX", "when": "theta_deg > 90" });
    assert!(served().inject(fault.clone()).is_ok());
    let served = served_with(&Truth::Stepped(Arc::default()));
    let rejected = served.inject(fault).expect_err("no sun");
    assert!(rejected.contains("when: theta_deg is not available from the truth of this run"), "{rejected}");
    let rejected = served
        .inject(json!({ "plan": "[[fault]]\nfault = \"reset\"\nend_when = \"psi_deg < 3\"\n" }))
        .expect_err("no sun");
    assert!(rejected.contains("end_when: psi_deg"), "{rejected}");
}

#[test]
fn history_is_complete_though_events_are_paced() {
    let served = served();
    served.run(1500);
    let history = served.service.history();
    let samples = history.as_array().expect("a list");
    assert_eq!(samples.len(), 1200);
    let times: Vec<f64> = samples.iter().filter_map(|sample| sample["t_s"].as_f64()).collect();
    assert_eq!((times[0], times[1199]), (150.5, 750.0));
    assert!(times.windows(2).all(|pair| pair[1] - pair[0] == 0.5), "{times:?}");
    let last = &samples[1199];
    assert_eq!(last["gyro_flags"], 0x0f);
    // Summed over the run, as in the events.
    assert!(last["departure_arcsec"][0].as_f64().is_some_and(|departure| departure != 0.0), "{last}");
}

#[test]
fn ended_faults_do_not_count_and_are_listed_only_on_request() {
    let served = served();
    let short = json!({ "fault": "dead", "gyro": "GYRX", "for_s": 0.5 });
    for _ in 0..3 {
        let plan = "[[fault]]\nfault = \"dead\"\ngyro = \"GYRX\"\nfor_s = 0.5\n".repeat(MAX_FAULTS);
        assert_eq!(served.inject(json!({ "plan": plan })).expect("a plan").as_array().map(Vec::len), Some(MAX_FAULTS));
        let rejected = served.inject(short.clone()).expect_err("full");
        assert!(rejected.contains("at most 1000 faults that are armed or active, got 1001"), "{rejected}");
        served.run(4);
    }
    served.inject(short).expect("below the limit again");
    assert_eq!(served.service.faults().as_array().map(Vec::len), Some(3 * MAX_FAULTS + 1));
    let status = served.published(|status| status["faults"].as_array().is_some_and(Vec::is_empty));
    assert!(status.to_string().len() < 5000, "{status}");
    assert_eq!(served.inject(json!({ "plan": "" })), Ok(json!([])));
    served.unit.close();
}

#[test]
fn number_of_faults_of_a_run_is_limited_and_its_record_is_read_again() {
    let (mut configuration, plan) = (Configuration::reference(), "[[fault]]\nfault = \"drop\"\n");
    configuration.add_plan("plan", &plan.repeat(MAX_FAULTS)).expect("a plan");
    let rejected = configuration.add_plan("plan", plan).expect_err("too many").to_string();
    assert!(rejected.contains("expected at most 1000 faults, got 1001"), "{rejected}");
    while configuration.faults.len() < MAX_RUN_FAULTS {
        let more =
            read_plan_text(&Device::iras(), "plan", &plan.repeat(MAX_FAULTS), &configuration.faults, &Transport::ALL)
                .expect("a plan");
        configuration.run.injected.extend(more.iter().map(|fault| fault.id.clone()));
        configuration.faults.extend(more);
    }
    let rejected =
        read_fault_text(&Device::iras(), "fault", "fault = \"drop\"", &configuration.faults, &Transport::ALL)
            .expect_err("too many")
            .to_string();
    assert!(rejected.contains("expected at most 10000 faults in a run") && rejected.contains("begin another run"));
    let again = Configuration::parse("run.toml", &configuration.to_toml(false), &[]).expect("read again");
    assert_eq!(again.faults.len(), MAX_RUN_FAULTS);
}

#[test]
fn accumulated_departure_includes_unpublished_samples() {
    let served = served();
    let mut unit = geu_model::GyroUnit::new(&Configuration::reference());
    served.run(500);
    let status = served.published(|status| status["t_s"].as_f64() > Some(250.0));
    let mut departure = [0.0; 4];
    // The reference unit's own clock is right.
    while unit.ended() < (status["t_s"].as_f64().expect("a time") * 2.0).round() as u64 {
        let (ended, traces) = unit.end_sample_traced();
        for (gyro, trace) in traces.iter().enumerate() {
            departure[gyro] += f64::from(ended.sample.increments[gyro]) - trace.true_arcsec;
        }
    }
    assert_eq!(status["departure_arcsec"], json!(departure));
    served.unit.close();
}

#[tokio::test]
async fn commands_displace_no_other_timeline_lines() {
    let served = served();
    served.inject(json!({ "id": "first", "fault": "dead", "gyro": "GYRX", "for_s": 1.0 })).expect("a fault");
    served.published(|status| status["faults"].as_array().is_some_and(Vec::is_empty));
    for _ in 0..2 {
        for _ in 0..1000 {
            served.service.command(vec![1]).await;
        }
        served.run(1);
    }
    let start = Instant::now();
    let count = |text: &str| served.service.timeline().iter().filter(|line| line.contains(text)).count();
    while count("996 more commands") < 2 {
        assert!(start.elapsed() < Duration::from_secs(10), "{:?}", served.service.timeline());
        thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(count("PING (01) over control"), 8);
    let mut timeline = Timeline::default();
    timeline.push(false, "fault".into());
    (0..2 * TIMELINE).for_each(|_| timeline.push(true, "command".into()));
    assert_eq!((timeline.0.len(), &*timeline.0[0].1), (TIMELINE, "fault"));
    assert_eq!(served.service.status()["lost"], 0);
    served.unit.close();
}
