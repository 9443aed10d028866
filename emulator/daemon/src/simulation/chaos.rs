//! A run of the unit as a seed draws it, with its invariants.

use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use geu_model::fault::catalogue::Transport;
use geu_model::{Configuration, Truth};
use geu_recorder::link_model::LinkModel;
use serde_json::json;
use tokio::sync::Notify;

use super::client::{self, Endpoint, Habits, Setting, Totals};
use super::disk::{self, Disk};
use super::port::{self, Pty};
use super::world::{Host, panic_text};
use crate::cadence::Speed;
use crate::control::ControlBackend;
use crate::control_service::{ControlService, StatusSource};
use crate::host::{self, Thread};
use crate::link::{LinkAddress, LinkInfo, StreamLink, pty, tcp};
use crate::recorder_thread::RecorderThread;
use crate::run::{RunOptions, RunSummary, Session, run_unit};
use crate::shared_unit::SharedUnit;

/// A run ends this long after the request, at the latest.
const END_NS: i64 = 1_000_000_000;
/// Time after the last sample of a run that ends by itself, at which it is asked to end.
const PATIENCE_NS: i64 = 20_000_000_000;
/// Lateness that wake-ups explain, without a stall of the host, ns.
const LATE_NS: u64 = 2_000_000;

/// A link of the simulated host.
#[derive(Clone)]
pub struct SimulatedLink(Arc<Slot>);

struct Slot {
    kind: Transport,
    pty: Pty,
    clients: OnceLock<Arc<tcp::Clients>>,
    is_bounded: OnceLock<Box<dyn Fn() -> bool + Send + Sync>>,
}

impl fmt::Debug for SimulatedLink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "simulated {}", self.kind().name())
    }
}

impl SimulatedLink {
    fn new(kind: Transport) -> SimulatedLink {
        SimulatedLink(Arc::new(Slot { kind, pty: Pty::new(), clients: OnceLock::new(), is_bounded: OnceLock::new() }))
    }

    pub fn kind(&self) -> Transport {
        self.0.kind
    }

    pub(crate) fn open(&self, model: LinkModel, unit: &Arc<SharedUnit>, speedup: f64) -> StreamLink {
        let link = match self.kind() {
            Transport::Pty => {
                let unread = self.0.pty.clone();
                let count_unread = Box::new(move || unread.count_unread());
                pty::start(self.0.pty.clone(), "pty simulated".to_owned(), model, unit, speedup, count_unread)
            }
            _ => {
                let (link, clients) = tcp::start(LinkInfo::new(model, "tcp simulated"), unit);
                let _ = self.0.clients.set(clients);
                link
            }
        };
        let _ = self.0.is_bounded.set(link.bounds());
        link
    }
}

/// Sample interval, ns, and largest number of samples of a run. The end comes within a second also in a long interval.
pub(crate) const RUNS: [(i64, i64); 3] = [(500_000_000, 40), (20_000_000, 400), (5_000_000_000, 6)];
/// Pause before a client opens its first connection, at most.
const FIRST_PAUSE_NS: i64 = 3_000_000_000;

/// The random choices of a run.
#[derive(Debug)]
struct Plan {
    interval_ns: i64,
    links: Vec<SimulatedLink>,
    clients: Vec<(usize, Habits)>,
    disk: Option<disk::Habits>,
    speed: Speed,
    samples: u64,
    /// Time of the request to end; `None`: the run ends by itself.
    asked_ns: Option<i64>,
    /// Number of times at which the process stands still.
    stalls: i64,
    has_operator: bool,
}

impl Plan {
    fn draw(host: &Host) -> Plan {
        let links = match host.draw(0..=3) {
            0 => vec![Transport::Tcp],
            1 => vec![Transport::Pty, Transport::Tcp],
            _ => vec![Transport::Pty],
        };
        let links: Vec<_> = links.into_iter().map(SimulatedLink::new).collect();
        let mut clients = Vec::new();
        for (index, link) in links.iter().enumerate() {
            // Two clients of one pty share its bytes: then no client is attentive.
            let count = if link.kind() == Transport::Tcp { host.draw(0..=5) } else { host.draw(1..=2) };
            for _ in 0..count {
                let mut habits = Habits::draw(host);
                habits.is_attentive &= link.kind() == Transport::Tcp || count == 1;
                clients.push((index, habits));
            }
        }
        if links.iter().any(|link| link.kind() == Transport::Tcp) && host.happens(0.03) {
            let habits = Habits { is_attentive: false, pause_ns: 100_000_000, ..Habits::draw(host) };
            clients.extend((0..70).map(|_| (links.len() - 1, habits.clone())));
        }
        let disk = host.happens(0.7).then(|| disk::Habits {
            flush_ns: host.draw(20_000..=2_000_000),
            stalls: if host.happens(0.3) { 0.05 } else { 0.0 },
            stall_ns: host.draw(10_000_000..=3_000_000_000),
            fails: if host.happens(0.1) { 0.01 } else { 0.0 },
        });
        let (interval_ns, most) = RUNS[if host.happens(0.7) { 0 } else { host.draw(1..=2) as usize }];
        let samples = host.draw(4..=most) as u64;
        let speed = Speed::Times(if host.happens(0.85) { 1.0 } else { host.draw(2..=50) as f64 });
        let asked_ns = host.happens(0.7).then(|| host.draw(0..=interval_ns * samples as i64));
        let stalls = if host.happens(0.15) { host.draw(1..=3) } else { 0 };
        Plan { interval_ns, links, clients, disk, speed, samples, asked_ns, stalls, has_operator: host.happens(0.4) }
    }

    /// Duration of all samples in real time.
    fn duration_ns(&self) -> i64 {
        self.interval_ns * self.samples as i64
    }
}

/// Counts of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Outcome {
    pub interval_ns: i64,
    pub samples: u64,
    pub received: u64,
    pub replies: u64,
    pub connections: u64,
    /// Digest of the order of turns and of all data.
    pub digest: u64,
}

/// Runs one seed.
///
/// # Errors
/// The first violation.
pub(crate) fn run(seed: u64) -> Result<Outcome, String> {
    let host = Host::enter(seed);
    // After a violation threads may hold locks for ever, for which the end of the run waits in vain.
    let result = catch_unwind(AssertUnwindSafe(|| run_on(&host)));
    let failure = host.failure();
    host.leave();
    result.unwrap_or_else(|panic| Err(failure.unwrap_or_else(|| panic_text(&*panic))))
}

fn run_on(host: &Host) -> Result<Outcome, String> {
    let plan = Plan::draw(host);
    let mut configuration = Configuration::reference();
    Arc::make_mut(&mut configuration.device).interval_s = plan.interval_ns as f64 * 1e-9;
    let session = Session::new(&[], plan.speed, false).map_err(|error| error.to_string())?;
    let disk = plan.disk.map(|habits| (Arc::<Disk>::default(), habits));
    let (feed, writer) = disk
        .clone()
        .map(|(disk, habits)| RecorderThread::new(Path::new("simulated"), move || Ok(disk.writer(habits))))
        .unzip();
    let status = feed.as_ref().map(|feed| feed.status.clone());
    let (service, observer, _publisher) =
        ControlService::start(&configuration.device).map_err(|error| error.to_string())?;
    let unit = Arc::new(SharedUnit::new(&configuration, &Truth::Scenario, plan.speed, feed, Some(observer)));
    service.set_source(StatusSource::new(&unit, &[], None, &session.monitor));
    let settings = RunOptions {
        links: plan.links.iter().cloned().map(LinkAddress::Simulated).collect(),
        speed: plan.speed,
        samples: Some(plan.samples),
        spin: Duration::ZERO,
        realtime: false,
        wait_for_client: false,
        live: None,
        truth_wait: None,
    };
    let setting = Arc::new(Setting {
        host: host.clone(),
        totals: Totals::default(),
        unit: unit.clone(),
        has_ended: AtomicBool::new(false),
        is_faster: plan.speed.is_faster_than_real(),
        has_stalled: AtomicBool::new(false),
        disk: disk.as_ref().map(|(disk, _)| disk.clone()),
    });
    let asked = Arc::<Notify>::default();
    let asked_at_ns = Arc::new(AtomicI64::new(i64::MAX));
    let shutdown = {
        let asked = asked.clone();
        async move {
            asked.notified().await;
            Ok(())
        }
    };
    let body = run_unit(&session, &unit, &settings, None, writer.map(|writer| (writer, Transport::Pty)));
    start_clients(host, &plan, &setting);
    start_operator(&plan, &service, &setting);
    start_stalls(host, &plan, &setting, &asked_at_ns);
    // A run that ends by itself waits for its disk without a limit, until it is asked to end.
    let asked_ns = plan.asked_ns.unwrap_or(plan.duration_ns() + PATIENCE_NS);
    let (own_host, at_ns) = (host.clone(), asked_at_ns.clone());
    host.spawn(async move {
        host::sleep(Duration::from_nanos(asked_ns as u64)).await;
        at_ns.store(own_host.now_ns(), Relaxed);
        asked.notify_one();
    });
    let bounds = |host: &Host| {
        let now_ns = host.now_ns();
        if now_ns - asked_at_ns.load(Relaxed).min(now_ns) > END_NS {
            host.fail("the run has not ended a second after the request to end");
        }
        for link in &plan.links {
            if link.0.is_bounded.get().is_some_and(|is_bounded| !is_bounded()) {
                host.fail(format_args!("{link:?}: more waits for one client than the limits permit"));
            }
        }
        if status.as_ref().is_some_and(|status| !status.is_bounded()) {
            host.fail("more waits for the disk than the limit permits");
        }
    };
    let ended = host.run(session.until_end(shutdown, body), bounds);
    setting.has_ended.store(true, Relaxed);
    match (host.failure(), ended) {
        (Some(failure), _) => Err(format!("{failure}\n    at {} ms: {plan:?}", host.now_ns() / 1_000_000)),
        (None, None) => Err("the run did not end".to_owned()),
        (None, Some(Err(error))) => Err(error.to_string()),
        (None, Some(Ok(summary))) => {
            check_summary(host, &plan, &setting, &summary, disk.as_ref().map(|(disk, _)| &**disk))
        }
    }
}

fn check_summary(
    host: &Host,
    plan: &Plan,
    setting: &Setting,
    summary: &RunSummary,
    disk: Option<&Disk>,
) -> Result<Outcome, String> {
    if setting.is_exact() {
        if summary.missed > 0 || summary.lateness.max_ns() > LATE_NS {
            return Err(format!("{} samples missed, lateness {}", summary.missed, summary.lateness));
        }
        if plan.asked_ns.is_none() && summary.samples != plan.samples {
            return Err(format!("{} samples of {}", summary.samples, plan.samples));
        }
    }
    if let Some(disk) = disk {
        let contents = disk.contents();
        let is_complete = contents.samples == summary.samples && contents.has_ended;
        if summary.recording.is_ok() && !is_complete {
            return Err(format!("recorded {} samples of {}", contents.samples, summary.samples));
        }
    }
    let load = |count: &AtomicU64| count.load(Relaxed);
    Ok(Outcome {
        interval_ns: plan.interval_ns,
        samples: summary.samples,
        received: load(&setting.totals.samples),
        replies: load(&setting.totals.replies),
        connections: load(&setting.totals.opened),
        digest: host.digest(),
    })
}

/// Clients of the links, which come, go and come back.
fn start_clients(host: &Host, plan: &Plan, setting: &Arc<Setting>) {
    let first_pause_ns = FIRST_PAUSE_NS.min(plan.duration_ns() / 4);
    for (number, (index, habits)) in plan.clients.iter().cloned().enumerate() {
        let (link, setting) = (plan.links[index].clone(), setting.clone());
        let is_shared = plan.clients.iter().filter(|(other, _)| *other == index).count() > 1;
        host.spawn(async move {
            let (mut replies, mut connections) = (0, 0);
            while !setting.is_over() {
                let pause_ns = setting.host.draw(0..=if connections == 0 { first_pause_ns } else { 300_000_000 });
                host::sleep(Duration::from_nanos(if setting.host.happens(0.3) { 0 } else { pause_ns as u64 })).await;
                connections += 1;
                if link.kind() == Transport::Pty {
                    let endpoint = Endpoint { link: "pty simulated".to_owned(), is_pty: true, is_shared };
                    client::serve(&setting, &endpoint, &mut replies, link.0.pty.open(), &habits).await;
                } else if let Some(clients) = link.0.clients.get() {
                    let (port, end) = port::connection();
                    let peer = std::net::SocketAddr::from(([127, 0, (number + 1) as u8, 1], 1000 + connections));
                    let admitted = clients.connect(peer, || Ok(port));
                    if admitted.is_ok() {
                        let endpoint = Endpoint { link: format!("tcp {peer}"), is_pty: false, is_shared: false };
                        client::serve(&setting, &endpoint, &mut 0, end, &habits).await;
                    }
                }
            }
        });
    }
}

/// The operator, who injects and clears faults on a thread of the control interface; every answer is on the disk.
fn start_operator(plan: &Plan, service: &Arc<ControlService>, setting: &Arc<Setting>) {
    if !plan.has_operator {
        return;
    }
    let (service, setting) = (service.clone(), setting.clone());
    // A fault lasts one sample or longer.
    let [stuck_s, dead_s] = [1.0, 2.0].map(|shortest_s: f64| shortest_s.max(plan.interval_ns as f64 * 1e-9));
    let work = move || {
        let own = super::host().expect("simulated");
        // Falls behind.
        let _events = service.subscribe();
        for number in 0_i64.. {
            host::sleep_thread(Duration::from_nanos(own.draw(1_000_000..=800_000_000) as u64));
            if setting.is_over() {
                return;
            }
            let id = format!("fault{number}");
            let fault = match own.draw(0..=2) {
                0 => json!({ "id": id, "fault": "stuck-count", "gyro": "GYRX", "counts": 5, "for_s": stuck_s }),
                1 => json!({ "id": id, "fault": "dead", "gyro": "GYRY", "for_s": dead_s }),
                _ => {
                    json!({ "id": id, "parameter": "drift.arcsec_per_h", "gyro": "GYRZA", "course": { "step": 10.0 } })
                }
            };
            let change = match own.happens(0.8) {
                true => {
                    let injected = service.inject(fault.as_object().expect("an object")).map(|_| id.clone());
                    if let Err(error) = &injected
                        && !setting.is_over()
                    {
                        own.fail(format_args!("{id} was refused: {error:?}"));
                    }
                    injected
                }
                false => {
                    let before = format!("fault{}", number - 1);
                    service.clear(&before).map(|_| format!("{before} cleared"))
                }
            };
            let _ = (service.status(), service.faults(), service.timeline());
            let (Ok(change), Some(disk)) = (change, &setting.disk) else { continue };
            let is_recorded = disk.contents().changes.contains(&change);
            if !is_recorded && !disk.is_excused(own.now_ns()) && !setting.is_over() {
                own.fail(format_args!("{change}: acknowledged to the operator, and not on the disk, which works"));
            }
        }
    };
    drop(Thread::spawn("operator", work));
}

/// Times at which the whole process stands still.
fn start_stalls(host: &Host, plan: &Plan, setting: &Arc<Setting>, asked_at_ns: &Arc<AtomicI64>) {
    for _ in 0..plan.stalls {
        let (host, setting, asked_at_ns) = (host.clone(), setting.clone(), asked_at_ns.clone());
        let after_ns = host.draw(0..=plan.duration_ns());
        host.clone().spawn(async move {
            host::sleep(Duration::from_nanos(after_ns as u64)).await;
            setting.has_stalled.store(true, Relaxed);
            let stall_ns = host.draw(1_000_000..=4_000_000_000);
            host.stall(Duration::from_nanos(stall_ns as u64));
            // A request before it could not be obeyed meanwhile; `i64::MAX` is none.
            asked_at_ns.store(asked_at_ns.load(Relaxed).saturating_add(stall_ns), Relaxed);
            if let Some(disk) = &setting.disk {
                disk.stood_still(host.now_ns());
            }
        });
    }
}
