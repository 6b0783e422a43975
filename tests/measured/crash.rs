//! A daemon that is killed at any moment loses no command that it acknowledged, executes none twice and
//! recovers the state that it would have had.

mod clients;
mod disk;
mod recovery;
mod rng;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use jostle_proto::keys;
use serde_json::json;
use tempfile::TempDir;

use crate::crash::clients::{Role, Sender, Traffic};
use crate::crash::rng::Rng;
use crate::support::daemon_process::{self, DaemonProcess, StoreCopy};
use crate::support::programs::ROOT;
use crate::support::reference_model::ReferenceModel;
use crate::support::{Client, PREFIX, TIMEOUT};

/// Kills, one scenario after the other; with `JOSTLE_LONG=1` the second. `JOSTLE_KILLS` is another
/// number, at least one for each of [`POINTS`].
const KILLS: [usize; 2] = [30, 1000];
const KILLS_PER_SCENARIO: usize = 100;

/// The seed of the first scenario. `JOSTLE_SEED` repeats another one.
const SEED: u64 = 1;

/// The exit codes of a daemon whose disk fails, and of one that therefore cannot open its data.
const DISK_FAILED: i32 = 8;
const CANNOT_OPEN: i32 = 2;

/// A failpoint at which the process is killed.
#[derive(Clone, Copy, Debug)]
struct Point {
    name: &'static str,
    /// The number of passes before the kill, the first time that the point is armed.
    passes: u64,
    /// An upper bound of that number for random kills.
    most: u64,
    /// Whether the process also passes it while it serves, so that it is reached in any case.
    serves: bool,
}

impl Point {
    const fn serving(name: &'static str, passes: u64, most: u64) -> Self {
        Point {
            name,
            passes,
            most,
            serves: true,
        }
    }

    const fn recovering(name: &'static str, passes: u64, most: u64) -> Self {
        Point {
            name,
            passes,
            most,
            serves: false,
        }
    }
}

const POINTS: [Point; 13] = [
    Point::serving("store-begin", 30, 60),
    Point::serving("store-written", 30, 60),
    Point::serving("store-synced", 30, 60),
    Point::serving("store-done", 30, 60),
    Point::serving("store-keep", 6, 20),
    Point::serving("swarm-durable", 20, 60),
    Point::serving("swarm-applied", 20, 60),
    Point::serving("swarm-stepped", 10, 60),
    Point::serving("swarm-checkpointed", 6, 20),
    Point::recovering("swarm-replayed", 2, 40),
    Point::recovering("swarm-resumed", 2, 6),
    Point::recovering("daemon-recovered", 0, 1),
    Point::serving("swarm-ended", 1, 4),
];

/// Those of the first start after an upgrade: `models::upgrade` arms them.
const OF_UPGRADE: [&str; 2] = ["store-migrating", "store-migrated"];

/// The swarms: their size, and the steps that they take at the start.
const SWARMS: [(&str, u64, u64); 4] = [
    ("five", 5, 0),
    ("twenty", 20, 400),
    ("fifty", 50, 400),
    ("packed", 74, 600),
];

/// The counts of kills and replies.
#[derive(Debug, Default)]
struct KillCounts {
    kills: usize,
    at_points: usize,
    in_recovery: usize,
    with_unanswered: usize,
    with_just_answered: usize,
    answers: usize,
    steps_not_durable: usize,
    compared: usize,
    /// Commands that were rejected because a write failed.
    rejected_as_full: usize,
    /// Exits of the daemon because the disk failed.
    ended: usize,
    /// The points at which a daemon was killed.
    points: BTreeSet<&'static str>,
}

/// A data folder, the daemons that use it in turn, their clients and the reference models.
struct Scenario {
    folder: TempDir,
    seed: u64,
    rng: Rng,
    models: Vec<(ReferenceModel, String)>,
    senders: Vec<Sender>,
    /// The points at which no daemon was killed yet; the last one is next.
    due: Vec<Point>,
    /// The faults of the disk, as libfiu's configuration.
    faults: Option<String>,
    counts: KillCounts,
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kill_anywhere_loses_no_acknowledged_command_and_executes_none_twice() {
    let given = std::env::var("JOSTLE_SEED").ok();
    let first = given.map_or(SEED, |seed| seed.parse().unwrap());
    let kills = match std::env::var("JOSTLE_KILLS") {
        Ok(given) => given.parse().unwrap(),
        Err(_) => KILLS[usize::from(std::env::var_os("JOSTLE_LONG").is_some())],
    };
    assert!(
        kills >= POINTS.len(),
        "too few kills for all points: {kills}"
    );
    let (mut seed, mut total, began) = (first, KillCounts::default(), Instant::now());
    while total.kills < kills {
        println!("JOSTLE_SEED={seed}");
        let mut scenario = Scenario::begin(seed).await;
        let until = (kills - total.kills).min(KILLS_PER_SCENARIO);
        while scenario.counts.kills < until {
            scenario.run_until_killed().await;
        }
        scenario.run_to_end().await;
        total.add(&scenario.counts);
        seed += 1;
    }
    println!("{total:#?} in {:?}", began.elapsed());
    let points: BTreeSet<_> = POINTS.map(|point| point.name).into();
    assert_eq!(total.points, points);
    let enough = kills / 20;
    assert!(total.with_unanswered >= enough && total.with_just_answered >= enough);
    assert!(total.at_points > kills / 4 && total.compared > kills);
    assert!(total.answers > 10 * kills, "{}", total.answers);
}

/// A point of the code that is missing in [`POINTS`] would never be armed.
#[test]
fn every_point_of_the_code_is_armed() {
    fn read(folder: &Path, points: &mut BTreeSet<String>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                read(&path, points);
            } else if path.extension().is_some_and(|it| it == "rs") {
                let text = fs::read_to_string(path).unwrap();
                let calls = text.split("failpoint::kill(\"").skip(1);
                points.extend(calls.map(|it| it.split('"').next().unwrap().to_owned()));
            }
        }
    }
    let mut points = BTreeSet::new();
    read(&Path::new(ROOT).join("src"), &mut points);
    let armed = POINTS.iter().map(|point| point.name).chain(OF_UPGRADE);
    let armed: BTreeSet<_> = armed.map(str::to_owned).collect();
    assert_eq!(points, armed);
}

impl Scenario {
    async fn begin(seed: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
        let client = Client::open(&process.endpoint).await;
        let (mut models, mut senders) = (Vec::new(), Vec::new());
        for (k, (name, n, settles)) in (0..).zip(SWARMS) {
            let spec = json!({"n": n, "seed": seed + k});
            client.create(name, spec.clone()).await;
            if settles > 0 {
                let step =
                    json!({"client": "setup", "request_id": name, "args": {"steps": settles}});
                client.ok(name, "step", step).await;
            }
            models.push((ReferenceModel::new(name, &spec), name.to_owned()));
            senders.push(Sender::new(name, Role::Moves, 100 * seed + 2 * k));
            senders.push(Sender::new(name, Role::Changes, 100 * seed + 2 * k + 1));
        }
        senders.push(Sender::new("phoenix", Role::Creates, 100 * seed + 99));
        // Makes everything before it durable.
        for (name, ..) in SWARMS {
            let request = json!({"client": "setup", "request_id": format!("{name}-end")});
            client.ok(name, "pause", request).await;
        }
        process.kill();
        let mut scenario = Scenario {
            folder,
            seed,
            rng: Rng::new(seed),
            models,
            senders,
            due: POINTS.into_iter().rev().collect(),
            faults: None,
            counts: KillCounts::default(),
        };
        scenario.check_answers(&new_traffic(false));
        scenario
    }

    /// The point at which the next daemon is killed, and after how many passes: first each point once,
    /// then a random point or, half of the time, any moment.
    fn choose_point(&mut self) -> Option<(Point, u64)> {
        if self.faults.is_none()
            && let Some(point) = self.due.last()
        {
            return Some((*point, point.passes));
        }
        if self.rng.below(2) == 0 {
            return None;
        }
        let point = *self.rng.pick(&POINTS);
        Some((point, self.rng.below(point.most)))
    }

    /// Records that a daemon was killed at the point that was armed.
    fn record_point(&mut self, armed: Option<(Point, u64)>) {
        self.counts.at_points += 1;
        if let (Some((point, _)), None) = (armed, &self.faults) {
            self.counts.points.insert(point.name);
            self.due.retain(|due| due.name != point.name);
        }
    }

    /// Starts a daemon, compares its swarms with the models, sends commands and kills it.
    async fn run_until_killed(&mut self) {
        let armed = self.choose_point();
        let point = match armed {
            Some((point, 0)) => format!("{}=return", point.name),
            Some((point, passes)) => format!("{}={passes}*off->return", point.name),
            None => String::new(),
        };
        let must_be_reached = self.faults.is_none() && armed.is_some_and(|(point, _)| point.serves);
        let context = format!("seed {}, kill {}, {point:?}", self.seed, self.counts.kills);
        println!("{context}");
        let mut command = daemon_process::daemon(self.folder.path());
        command.args(["--quota-mb", "2"]);
        if let Some(faults) = &self.faults {
            disk::fail(&mut command, faults);
        }
        if !point.is_empty() {
            command.env("FAILPOINTS", &point);
        }
        let started = DaemonProcess::start(&mut command);
        let Ok(mut process) = started else {
            let code = started.err().flatten();
            assert!(
                may_end(code, armed, self.failures(&[CANNOT_OPEN, DISK_FAILED])),
                "{context}: {code:?}"
            );
            self.counts.kills += 1;
            self.counts.in_recovery += 1;
            self.record_point(armed);
            return self.check_answers(&new_traffic(false));
        };
        let traffic = new_traffic(self.faults.is_some());
        let Ok(clients) = tokio::try_join!(connect(&process), connect(&process)) else {
            let code = process.end();
            assert!(
                may_end(code, armed, self.failures(&[DISK_FAILED])),
                "{context}: {code:?}"
            );
            self.counts.kills += 1;
            self.record_point(armed);
            return self.check_answers(&new_traffic(false));
        };
        let clients = [clients.0, clients.1];
        self.compare(&clients[0], Some((&mut process, armed))).await;
        let mut tasks = tokio::task::JoinSet::new();
        for (k, mut sender) in self.senders.drain(..).enumerate() {
            let (client, traffic) = (clients[k % 2].clone(), traffic.clone());
            tasks.spawn(async move {
                sender.send_until_over(&client, &traffic).await;
                sender
            });
        }
        let patience = match armed {
            None => Duration::from_millis(1 + self.rng.below(150)),
            Some(_) if must_be_reached => TIMEOUT,
            // With few lines to replay the point may be passed too seldom.
            Some(_) => Duration::from_millis(700),
        };
        let began = Instant::now();
        let mut is_dead = false;
        while began.elapsed() < patience && !is_dead {
            tokio::time::sleep(Duration::from_millis(1)).await;
            is_dead = process.child.try_wait().unwrap().is_some();
        }
        if is_dead {
            let code = process.end();
            assert!(
                may_end(code, armed, self.failures(&[DISK_FAILED])),
                "{context}: {code:?}"
            );
            self.counts.ended += usize::from(code.is_some());
            self.record_point(armed);
        }
        assert!(
            is_dead || !must_be_reached,
            "{context}: the point is never reached"
        );
        // On a slow machine a killed process takes long to disappear.
        let killed = Instant::now();
        process.kill();
        let answered = killed.saturating_duration_since(*traffic.answered.lock().unwrap());
        traffic.is_over.store(true, Ordering::Relaxed);
        while let Some(sender) = tasks.join_next().await {
            self.senders.push(sender.unwrap());
        }
        self.senders.sort_by(|a, b| a.name.cmp(&b.name));
        self.counts.kills += 1;
        let unanswered = traffic.under_way.load(Ordering::Relaxed);
        self.counts.with_unanswered += usize::from(unanswered > 0);
        self.counts.with_just_answered += usize::from(answered < Duration::from_millis(3));
        self.check_answers(&traffic);
    }

    /// The exit codes that a failing disk may cause: none where it does not fail.
    fn failures(&self, codes: &'static [i32]) -> &'static [i32] {
        if self.faults.is_some() { codes } else { &[] }
    }

    /// The last daemon replies to every client, and its swarms equal the models.
    async fn run_to_end(&mut self) {
        let mut process =
            DaemonProcess::start(&mut daemon_process::daemon(self.folder.path())).unwrap();
        let client = connect(&process).await.unwrap();
        self.compare(&client, None).await;
        let traffic = new_traffic(false);
        for sender in &mut self.senders {
            assert!(sender.send(&client, &traffic).await);
        }
        let swarms = client.node("swarms").await["swarms"].take();
        let named = |name: &str| {
            swarms
                .as_array()
                .unwrap()
                .iter()
                .any(|it| it["swarm"] == name)
        };
        for (name, is_there) in self.senders.iter().filter_map(Sender::has).flatten() {
            assert_eq!(named(&name), is_there, "{name}: {swarms}");
        }
        for (name, ..) in SWARMS {
            let request = json!({"client": "setup", "request_id": format!("{name}-last")});
            client.ok(name, "pause", request).await;
        }
        process.kill();
        self.check_answers(&traffic);
        let process =
            DaemonProcess::start(&mut daemon_process::daemon(self.folder.path())).unwrap();
        let client = connect(&process).await.unwrap();
        self.compare(&client, None).await;
    }

    /// Compares every recovered swarm with its model. The daemon may be killed meanwhile.
    async fn compare(
        &mut self,
        client: &Client,
        mut process: Option<(&mut DaemonProcess, Option<(Point, u64)>)>,
    ) {
        let failures = self.failures(&[DISK_FAILED]);
        for (model, name) in &mut self.models {
            let key = keys::get(PREFIX, name, "status");
            let answer = tokio::select! {
                mut answers = client.query_all(&key, None) => answers.pop(),
                () = death(process.as_mut().map(|(process, _)| &mut **process)) => None,
            };
            match answer {
                Some(Ok(status)) => {
                    model.compare(&status);
                    self.counts.compared += 1;
                }
                other => match &mut process {
                    Some((process, armed)) => {
                        let code = process.end();
                        assert!(may_end(code, *armed, failures), "{other:?}, {code:?}");
                    }
                    None => panic!("{name}: {other:?}"),
                },
            }
        }
    }

    /// Compares the journals with the replies.
    fn check_answers(&mut self, traffic: &Traffic) {
        let answers = traffic.answers.lock().unwrap();
        let left = StoreCopy::of(self.folder.path());
        for (model, name) in &mut self.models {
            model.replay(left.rows(name, model.line), &answers);
        }
        for (id, answer) in answers.iter() {
            let swarm = answer["swarm"].as_str().unwrap();
            let (model, _) = self.models.iter().find(|(_, name)| name == swarm).unwrap();
            self.counts.answers += 1;
            if model.has(id) {
                model.check(id, answer);
                continue;
            }
            // The reply of a command that may be lost has an earlier `durable_step`.
            let durable = answer["result"]["durable_step"].as_u64();
            let may_be_lost = durable.is_some_and(|step| step < answer["step"].as_u64().unwrap());
            assert!(may_be_lost, "lost {id:?}: {answer}");
            self.counts.steps_not_durable += 1;
        }
        self.counts.rejected_as_full += traffic.rejected_as_full.load(Ordering::Relaxed);
        for id in traffic.rejected.lock().unwrap().iter() {
            let has = self.models.iter().any(|(model, _)| model.has(id));
            assert!(!has, "{id:?} was rejected, and executed");
        }
    }
}

impl KillCounts {
    fn add(&mut self, other: &KillCounts) {
        self.kills += other.kills;
        self.at_points += other.at_points;
        self.in_recovery += other.in_recovery;
        self.with_unanswered += other.with_unanswered;
        self.with_just_answered += other.with_just_answered;
        self.answers += other.answers;
        self.steps_not_durable += other.steps_not_durable;
        self.compared += other.compared;
        self.rejected_as_full += other.rejected_as_full;
        self.ended += other.ended;
        self.points.extend(&other.points);
    }
}

fn new_traffic(disk_fails: bool) -> Arc<Traffic> {
    Arc::new(Traffic {
        is_over: false.into(),
        under_way: 0.into(),
        answered: Mutex::new(Instant::now()),
        answers: Mutex::default(),
        disk_fails,
        rejected_as_full: 0.into(),
        rejected: Mutex::default(),
    })
}

async fn connect(process: &DaemonProcess) -> zenoh::Result<Arc<Client>> {
    Client::try_open(&process.endpoint).await.map(Arc::new)
}

/// Whether a daemon may have ended with this code: killed at the point that is armed, or because
/// the disk fails.
fn may_end(code: Option<i32>, armed: Option<(Point, u64)>, failures: &[i32]) -> bool {
    match code {
        None => armed.is_some(),
        Some(code) => failures.contains(&code),
    }
}

/// Waits until the daemon has ended; without one, for ever.
async fn death(process: Option<&mut DaemonProcess>) {
    let Some(process) = process else {
        return std::future::pending().await;
    };
    while process.child.try_wait().unwrap().is_none() {
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}
