//! A bench that makes something up, to try the page on.
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use geu_daemon::control::{self, Bench, Door, Event};
use geu_protocol::serial::{Kind, frame};
use geu_protocol::{CanPlan, HalfSecond, Outcome, Reply};
use serde_json::{Map, Value, json};
use tokio::sync::broadcast;

struct Fake {
    inner: Mutex<Inner>,
    events: broadcast::Sender<Event>,
}

#[derive(Default)]
struct Inner {
    n: u64,
    next: u64,
    faults: BTreeMap<String, Value>,
    last: Value,
    timeline: Vec<Arc<str>>,
}

impl Fake {
    fn happen(&self, inner: &mut Inner, kind: &str, text: String) {
        let line: Arc<str> = json!({"t_s": inner.n as f64 / 2.0, "kind": kind, "text": text}).to_string().into();
        inner.timeline.push(line.clone());
        let _ = self.events.send(Event { name: "timeline", data: line });
    }

    fn step(&self) {
        let mut inner = self.inner.lock().unwrap();
        inner.n += 1;
        let n = inner.n;
        let t = n as f64 / 2.0;
        let rate = [200.0 * (t / 20.0).sin(), 720.0 * (t / 35.0).cos(), 90.0 * (t / 9.0).sin()];
        let truth = [rate[0] / 2.0, rate[1] / 2.0, rate[2] / 2.0, rate[2] / 2.0];
        let mut increments = [0i16; 4];
        let mut over = Vec::new();
        for (index, value) in increments.iter_mut().enumerate() {
            let gyro = ["GYRX", "GYRY", "GYRZA", "GYRZB"][index];
            let hit = inner.faults.values().any(|f| f["gyro"] == gyro && f["state"] == "active");
            let wobble = ((n * 7 + index as u64 * 13) % 5) as f64 / 4.0 - 0.5;
            *value = (truth[index] + wobble + if hit { 11.5 * (t * 2.0).sin() } else { 0.0 }).round() as i16;
        }
        for (id, fault) in &mut inner.faults {
            if fault["state"] == "active" && fault["until_s"].as_f64().is_some_and(|end| end <= t) {
                fault["state"] = "over".into();
                over.push(id.clone());
            }
        }
        for id in over {
            self.happen(&mut inner, "fault-end", format!("{id} is over"));
        }
        let half = HalfSecond {
            sequence: (n - 1) as u16,
            increments,
            gyro_flags: 15,
            unit_flags: 7,
            electronics_centi_c: 2000 + (n % 30) as i16,
            clock_count: n * 500_000,
            sensor_centi_c: 7000,
        };
        let faults: Vec<Value> = inner.faults.values().cloned().collect();
        let can: Vec<String> =
            CanPlan::default().frames(&half).iter().map(|f| format!("{:03X}#{}", f.id, hex(f.data()))).collect();
        let mut payload = [0; 22];
        <geu_protocol::message::Data as geu_protocol::message::Message>::write(&half, &mut payload);
        inner.last = json!({"t_s": t, "half_second": n, "sequence": half.sequence, "clock_count": half.clock_count,
            "increments": increments, "true_arcsec": truth, "rate_arcsec_s": rate, "theta_deg": 90.0, "psi_deg": null,
            "gyro_flags": 15, "unit_flags": 7, "electronics_c": f64::from(half.electronics_centi_c) / 100.0, "sensor_c": 70.0,
            "cyclic": true, "wire": {"serial": hex(&frame(Kind::Data, &payload)), "can": can},
            "links": [{"name": "pty /tmp/geu0", "kind": "pty", "clients": 1, "sent": n, "dropped": 0, "replies": 2},
                {"name": "tcp 127.0.0.1:4700", "kind": "tcp", "clients": 2, "sent": 2 * n, "dropped": 1, "replies": 0}],
            "lateness": {"count": n, "p50_us": 61.0, "p99_us": 100.0, "max_us": 130.0}, "late": 0, "missed": 0, "faults": faults});
        let _ = self.events.send(Event { name: "half-second", data: inner.last.to_string().into() });
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02X}")).collect()
}

impl Bench for Fake {
    fn status(&self) -> Value {
        let last = self.inner.lock().unwrap().last.clone();
        json!({"lateness": last["lateness"], "truth": {"true_arcsec": last["true_arcsec"]}, "links": last["links"], "faults": last["faults"]})
    }

    fn catalogue(&self) -> Value {
        let gyros = json!(["GYRX", "GYRY", "GYRZA", "GYRZB"]);
        let parameter = |name: &str,
                         title: &str,
                         per: bool,
                         form: &str,
                         low: Value,
                         high: Value,
                         unit: &str,
                         meaning: &str| {
            json!({"parameter": name, "title": title, "per_gyro": per, "gyros": if per { gyros.clone() } else { json!([]) },
                "form": form, "least": low, "greatest": high, "unit": unit, "meaning": meaning})
        };
        let number = |name: &str, form: &str, low: Value, high: Value, default: Value, unit: &str, meaning: &str| json!({"name": name, "form": form, "least": low, "greatest": high, "default": default, "unit": unit, "meaning": meaning, "choices": []});
        let n = Value::Null;
        json!({"gyros": gyros, "parameters": [
            parameter("pivot-clearance.clearance_arcsec", "pivot clearance", true, "real", json!(-100.0), json!(100.0), "arcsec", "From stop to stop."),
            parameter("drift.arcsec_per_h", "drift", true, "real", json!(-1e6), json!(1e6), "arcsec/h", "Constant drift."),
            parameter("sign-inversion.inverted", "sign inversion", true, "flag", n.clone(), n.clone(), "", "Counts the wrong way round."),
            parameter("axis-swap.with", "axis swap", true, "gyro", n.clone(), n.clone(), "", "Measures about another gyro's axis."),
            parameter("clock-frequency.ppm", "clock frequency", false, "real", json!(-1000.0), json!(1000.0), "ppm", "Off the nominal 1 MHz."),
        ], "courses": [
            {"course": "step", "meaning": "All at once, and held.", "numbers": [number("step", "real", n.clone(), n.clone(), n.clone(), "", "The value.")]},
            {"course": "ramp", "meaning": "Evenly over a time, then held.", "numbers": [number("ramp", "real", n.clone(), n.clone(), n.clone(), "", "The value at its end."), number("over_s", "real", json!(0.5), n.clone(), json!(60.0), "s", "Length of the ramp.")]},
            {"course": "sine", "meaning": "To and fro.", "numbers": [number("sine", "real", n.clone(), n.clone(), n.clone(), "", "Amplitude."), number("period_s", "real", json!(1.0), n.clone(), json!(60.0), "s", "Of a whole swing."), number("phase_rad", "real", n.clone(), n.clone(), json!(0.0), "rad", "At the start.")]},
        ], "faults": [
            {"fault": "stuck-count", "scope": "gyro", "title": "count stands still", "numbers": [number("counts", "whole", json!(-32768), json!(32767), n.clone(), "count", "What it reads.")], "links": {}},
            {"fault": "bit-flip", "scope": "link", "title": "bits flipped in frames", "numbers": [number("bits", "whole", json!(1), json!(64), json!(1), "bit", "In each frame."), json!({"name": "where", "form": "choice", "choices": ["anywhere", "payload", "crc"], "default": "anywhere", "meaning": "Which bits.", "unit": ""})],
             "links": {"pty": null, "serial": null, "can": "the controller sends whole frames", "tcp": null}},
            {"fault": "restart", "scope": "unit", "title": "unit restarts", "numbers": [], "links": {}},
        ], "commands": control::commands()})
    }

    fn faults(&self) -> Value {
        self.inner.lock().unwrap().faults.values().cloned().collect()
    }

    fn inject(&self, fault: &Map<String, Value>) -> Result<Value, String> {
        eprintln!("inject {}", Value::Object(fault.clone()));
        let mut inner = self.inner.lock().unwrap();
        if let Some(value) = fault.get("course").and_then(|c| c.get("step")).and_then(Value::as_f64)
            && value.abs() > 100.0
        {
            return Err(format!("course.step: expected -100 to 100 arcsec, got {value}"));
        }
        if fault.get("when").is_some_and(|w| w == "nonsense") {
            return Err("when: column 1: expected a quantity such as rate_y, got nonsense".into());
        }
        inner.next += 1;
        let id = fault.get("id").and_then(Value::as_str).map_or(format!("fault-{}", inner.next), str::to_owned);
        let t = inner.n as f64 / 2.0;
        let armed = fault.contains_key("when");
        let until = fault.get("for_s").and_then(Value::as_f64).map(|d| t + d);
        let what = fault.get("parameter").or(fault.get("fault")).cloned().unwrap_or(Value::Null);
        let state = json!({"id": id, "what": what, "gyro": fault.get("gyro"), "state": if armed { "armed" } else { "active" }, "since_s": if armed { None } else { Some(t) }, "until_s": until});
        inner.faults.insert(id.clone(), state.clone());
        self.happen(&mut inner, "injected", format!("{id}: {what}"));
        if !armed {
            self.happen(&mut inner, "fault-start", format!("{id} begins"));
        }
        Ok(state)
    }

    fn clear(&self, id: &str) -> Result<Value, String> {
        let mut inner = self.inner.lock().unwrap();
        let t = inner.n as f64 / 2.0;
        let fault = inner.faults.get_mut(id).ok_or(format!("{id}: no such fault"))?;
        fault["state"] = "over".into();
        fault["until_s"] = t.into();
        let fault = fault.clone();
        self.happen(&mut inner, "cleared", format!("{id} cleared"));
        Ok(fault)
    }

    fn clear_all(&self) -> Value {
        let mut inner = self.inner.lock().unwrap();
        let t = inner.n as f64 / 2.0;
        for fault in inner.faults.values_mut().filter(|f| f["state"] != "over") {
            fault["state"] = "over".into();
            fault["until_s"] = t.into();
        }
        self.happen(&mut inner, "cleared", "all faults cleared".into());
        json!({"cleared": true})
    }

    async fn command(&self, payload: Vec<u8>) -> Value {
        let outcome = geu_protocol::command::parse(&payload).map_or_else(|o| o, |_| Outcome::Done);
        let mut inner = self.inner.lock().unwrap();
        self.happen(&mut inner, "command", format!("{}: {}", hex(&payload), outcome.text()));
        let values: &[u8] = if payload == [1] { &[1, 0] } else { &[] };
        control::reply(&Reply::new(payload[0], outcome, values), None)
    }

    fn timeline(&self) -> Vec<Arc<str>> {
        self.inner.lock().unwrap().timeline.clone()
    }

    fn subscribe(&self) -> broadcast::Receiver<Event> {
        self.events.subscribe()
    }
}

fn main() {
    let period = std::env::args().nth(2).map_or(0.5, |p| p.parse().unwrap());
    let address = std::env::args().nth(1).unwrap_or("127.0.0.1:8470".into());
    let door = Door::open(&address, false, std::env::var("GEU_CONTROL_TOKEN").ok()).unwrap_or_else(|e| panic!("{e}"));
    println!("control http://{}", door.address());
    let fake = Arc::new(Fake { inner: Mutex::default(), events: broadcast::channel(64).0 });
    let _server = door.serve(fake.clone()).unwrap();
    loop {
        std::thread::sleep(Duration::from_secs_f64(period));
        fake.step();
    }
}
