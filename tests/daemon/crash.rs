//! The daemon is killed at any moment, and nothing that it answered is lost, done twice or other
//! than it would have been.

mod clients;
mod damage;
mod dice;
pub mod disk;
pub mod life;
mod recovery;
pub mod twin;

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
use crate::crash::dice::Dice;
use crate::crash::life::{Left, Life};
use crate::crash::twin::Twin;
use crate::support::{Client, PATIENCE, PREFIX, alone};

/// Kills, one world after the other; with `JOSTLE_LONG=1` the second.
const KILLS: [usize; 2] = [30, 1000];
const KILLS_PER_WORLD: usize = 100;

/// The seed of the first world. `JOSTLE_SEED` repeats another one.
const SEED: u64 = 1;

/// The exit code of a daemon whose disk fails, and of one that cannot open its data therefore.
const DISK_FAILED: i32 = 8;
const CANNOT_OPEN: i32 = 2;

/// A point in the code where the process dies.
#[derive(Clone, Copy, Debug)]
struct Point {
    name: &'static str,
    /// How often the process passes it before it dies there, the first time that the point is armed.
    passes: u64,
    /// An upper bound of that for the kills at random.
    most: u64,
    /// Whether the process also passes it when it serves, and so meets it sooner or later.
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

const POINTS: [Point; 12] = [
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
    Point::serving("swarm-ended", 1, 4),
];

/// The swarms whose past is told: their size, and how many steps they settle before.
const SWARMS: [(&str, u64, u64); 4] = [
    ("five", 5, 0),
    ("twenty", 20, 400),
    ("fifty", 50, 400),
    ("packed", 74, 600),
];

/// How the kills went.
#[derive(Debug, Default)]
struct Tally {
    kills: usize,
    at_points: usize,
    in_recovery: usize,
    with_unanswered: usize,
    with_just_answered: usize,
    answers: usize,
    steps_not_safe: usize,
    compared: usize,
    /// Commands that were rejected because a write failed.
    refused_as_full: usize,
    /// Ends by itself, because the disk failed.
    ended: usize,
    /// The points at which a daemon was killed.
    met: BTreeSet<&'static str>,
}

/// A folder, the daemons on it, whoever talks to them, and what must come of it.
struct World {
    folder: TempDir,
    seed: u64,
    dice: Dice,
    twins: Vec<(Twin, String)>,
    senders: Vec<Sender>,
    /// The points at which no daemon was killed yet, the next one last.
    due: Vec<Point>,
    /// What goes wrong with the disk, in libfiu's words.
    faults: Option<String>,
    tally: Tally,
}

#[tokio::test(flavor = "multi_thread")]
async fn killed_anywhere_it_loses_nothing_that_it_answered_and_repeats_nothing() {
    let _alone = alone().await;
    let given = std::env::var("JOSTLE_SEED").ok();
    let first = given.map_or(SEED, |seed| seed.parse().unwrap());
    let kills = KILLS[usize::from(std::env::var_os("JOSTLE_LONG").is_some())];
    let (mut seed, mut total, began) = (first, Tally::default(), Instant::now());
    while total.kills < kills {
        println!("JOSTLE_SEED={seed}");
        let mut world = World::begin(seed).await;
        let until = (kills - total.kills).min(KILLS_PER_WORLD);
        while world.tally.kills < until {
            world.live_and_die().await;
        }
        world.live_on().await;
        total.add(&world.tally);
        seed += 1;
    }
    println!("{total:#?} in {:?}", began.elapsed());
    let points: BTreeSet<_> = POINTS.map(|point| point.name).into();
    assert_eq!(total.met, points);
    let enough = kills / 20;
    assert!(total.with_unanswered >= enough && total.with_just_answered >= enough);
    assert!(total.at_points > kills / 4 && total.compared > kills);
    assert!(total.answers > 10 * kills, "{}", total.answers);
}

/// A point that the code has and this test does not would never be armed.
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
    read(
        &Path::new(env!("CARGO_MANIFEST_DIR")).join("src"),
        &mut points,
    );
    let armed: BTreeSet<_> = POINTS.map(|point| point.name.to_owned()).into();
    assert_eq!(points, armed);
}

impl World {
    async fn begin(seed: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut life = Life::begin(&mut life::daemon(folder.path())).unwrap();
        let client = Client::open(&life.endpoint).await;
        let (mut twins, mut senders) = (Vec::new(), Vec::new());
        for (k, (name, n, settles)) in (0..).zip(SWARMS) {
            let spec = json!({"n": n, "seed": seed + k});
            client.create(name, spec.clone()).await;
            if settles > 0 {
                let step =
                    json!({"client": "setup", "request_id": name, "args": {"steps": settles}});
                client.ok(name, "step", step).await;
            }
            twins.push((Twin::new(name, &spec), name.to_owned()));
            senders.push(Sender::new(name, Role::Moves, 100 * seed + 2 * k));
            senders.push(Sender::new(name, Role::Changes, 100 * seed + 2 * k + 1));
        }
        senders.push(Sender::new("phoenix", Role::Creates, 100 * seed + 99));
        // Whatever was lazy is safe with this.
        for (name, ..) in SWARMS {
            let request = json!({"client": "setup", "request_id": format!("{name}-end")});
            client.ok(name, "pause", request).await;
        }
        life.kill();
        let mut world = World {
            folder,
            seed,
            dice: Dice::new(seed),
            twins,
            senders,
            due: POINTS.into_iter().rev().collect(),
            faults: None,
            tally: Tally::default(),
        };
        world.check_answers(&new_traffic(false));
        world
    }

    /// Where the next daemon is to die, and after how many passes: first at each point once, then
    /// at a random one or, half of the time, at any moment.
    fn choose_point(&mut self) -> Option<(Point, u64)> {
        if self.faults.is_none()
            && let Some(point) = self.due.last()
        {
            return Some((*point, point.passes));
        }
        if self.dice.below(2) == 0 {
            return None;
        }
        let point = *self.dice.pick(&POINTS);
        Some((point, self.dice.below(point.most)))
    }

    /// Takes in that a daemon died at the point that was armed.
    fn met(&mut self, armed: Option<(Point, u64)>) {
        self.tally.at_points += 1;
        if let (Some((point, _)), None) = (armed, &self.faults) {
            self.tally.met.insert(point.name);
            self.due.retain(|due| due.name != point.name);
        }
    }

    /// A daemon comes back, is what it must be, is kept busy, and dies.
    async fn live_and_die(&mut self) {
        let armed = self.choose_point();
        let point = match armed {
            Some((point, 0)) => format!("{}=return", point.name),
            Some((point, passes)) => format!("{}={passes}*off->return", point.name),
            None => String::new(),
        };
        let must_be_met = self.faults.is_none() && armed.is_some_and(|(point, _)| point.serves);
        let told = format!("seed {}, kill {}, {point:?}", self.seed, self.tally.kills);
        println!("{told}");
        let mut command = life::daemon(self.folder.path());
        command.args(["--quota-mb", "2"]);
        if let Some(faults) = &self.faults {
            disk::fail(&mut command, faults);
        }
        if !point.is_empty() {
            command.env("FAILPOINTS", &point);
        }
        let begun = Life::begin(&mut command);
        let Ok(mut life) = begun else {
            let code = begun.err().flatten();
            assert!(
                may_end(code, armed, self.failures(&[CANNOT_OPEN, DISK_FAILED])),
                "{told}: {code:?}"
            );
            self.tally.kills += 1;
            self.tally.in_recovery += 1;
            self.met(armed);
            return self.check_answers(&new_traffic(false));
        };
        let traffic = new_traffic(self.faults.is_some());
        let Ok(clients) = tokio::try_join!(connect(&life), connect(&life)) else {
            let code = life.end();
            assert!(
                may_end(code, armed, self.failures(&[DISK_FAILED])),
                "{told}: {code:?}"
            );
            self.tally.kills += 1;
            self.met(armed);
            return self.check_answers(&new_traffic(false));
        };
        let clients = [clients.0, clients.1];
        self.compare(&clients[0], Some((&mut life, armed))).await;
        let mut tasks = tokio::task::JoinSet::new();
        for (k, mut sender) in self.senders.drain(..).enumerate() {
            let (client, traffic) = (clients[k % 2].clone(), traffic.clone());
            tasks.spawn(async move {
                sender.send_on(&client, &traffic).await;
                sender
            });
        }
        let patience = match armed {
            None => Duration::from_millis(1 + self.dice.below(150)),
            Some(_) if must_be_met => PATIENCE,
            // Where little is replayed it may be passed too seldom.
            Some(_) => Duration::from_millis(700),
        };
        let began = Instant::now();
        let mut is_dead = false;
        while began.elapsed() < patience && !is_dead {
            tokio::time::sleep(Duration::from_millis(1)).await;
            is_dead = life.child.try_wait().unwrap().is_some();
        }
        if is_dead {
            let code = life.end();
            assert!(
                may_end(code, armed, self.failures(&[DISK_FAILED])),
                "{told}: {code:?}"
            );
            self.tally.ended += usize::from(code.is_some());
            self.met(armed);
        }
        assert!(is_dead || !must_be_met, "{told}: the point is never met");
        // Where the machine is slow a process takes long to be gone.
        let killed = Instant::now();
        life.kill();
        let answered = killed.saturating_duration_since(*traffic.answered.lock().unwrap());
        traffic.is_over.store(true, Ordering::Relaxed);
        while let Some(sender) = tasks.join_next().await {
            self.senders.push(sender.unwrap());
        }
        self.senders.sort_by(|a, b| a.name.cmp(&b.name));
        self.tally.kills += 1;
        let unanswered = traffic.under_way.load(Ordering::Relaxed);
        self.tally.with_unanswered += usize::from(unanswered > 0);
        self.tally.with_just_answered += usize::from(answered < Duration::from_millis(3));
        self.check_answers(&traffic);
    }

    /// The exit codes that a failing disk may cause: none where it does not fail.
    fn failures(&self, codes: &'static [i32]) -> &'static [i32] {
        if self.faults.is_some() { codes } else { &[] }
    }

    /// The last daemon answers everybody and is what it must be.
    async fn live_on(&mut self) {
        let mut life = Life::begin(&mut life::daemon(self.folder.path())).unwrap();
        let client = connect(&life).await.unwrap();
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
        life.kill();
        self.check_answers(&traffic);
        let life = Life::begin(&mut life::daemon(self.folder.path())).unwrap();
        let client = connect(&life).await.unwrap();
        self.compare(&client, None).await;
    }

    /// Holds every swarm, as it has just come back, against its twin. Dying meanwhile is let.
    async fn compare(
        &mut self,
        client: &Client,
        mut life: Option<(&mut Life, Option<(Point, u64)>)>,
    ) {
        let failures = self.failures(&[DISK_FAILED]);
        for (twin, name) in &mut self.twins {
            let key = keys::get(PREFIX, name, "status");
            let answer = tokio::select! {
                mut answers = client.ask(&key, None) => answers.pop(),
                () = death(life.as_mut().map(|(life, _)| &mut **life)) => None,
            };
            match answer {
                Some(Ok(status)) => {
                    twin.compare(&status);
                    self.tally.compared += 1;
                }
                other => match &mut life {
                    Some((life, armed)) => {
                        let code = life.end();
                        assert!(may_end(code, *armed, failures), "{other:?}, {code:?}");
                    }
                    None => panic!("{name}: {other:?}"),
                },
            }
        }
    }

    /// Holds what the journals say against what was answered.
    fn check_answers(&mut self, traffic: &Traffic) {
        let answers = traffic.answers.lock().unwrap();
        let left = Left::on(self.folder.path());
        for (twin, name) in &mut self.twins {
            twin.tell(left.rows(name, twin.line), &answers);
        }
        for (id, answer) in answers.iter() {
            let swarm = answer["swarm"].as_str().unwrap();
            let (twin, _) = self.twins.iter().find(|(_, name)| name == swarm).unwrap();
            self.tally.answers += 1;
            if twin.has(id) {
                twin.check(id, answer);
                continue;
            }
            // What was not safe was said not to be.
            let durable = answer["result"]["durable_step"].as_u64();
            let may_be_lost = durable.is_some_and(|step| step < answer["step"].as_u64().unwrap());
            assert!(may_be_lost, "lost {id:?}: {answer}");
            self.tally.steps_not_safe += 1;
        }
        self.tally.refused_as_full += traffic.refused_as_full.load(Ordering::Relaxed);
        for id in traffic.refused.lock().unwrap().iter() {
            let has = self.twins.iter().any(|(twin, _)| twin.has(id));
            assert!(!has, "{id:?} was refused, and carried out");
        }
    }
}

impl Tally {
    fn add(&mut self, other: &Tally) {
        self.kills += other.kills;
        self.at_points += other.at_points;
        self.in_recovery += other.in_recovery;
        self.with_unanswered += other.with_unanswered;
        self.with_just_answered += other.with_just_answered;
        self.answers += other.answers;
        self.steps_not_safe += other.steps_not_safe;
        self.compared += other.compared;
        self.refused_as_full += other.refused_as_full;
        self.ended += other.ended;
        self.met.extend(&other.met);
    }
}

fn new_traffic(disk_fails: bool) -> Arc<Traffic> {
    Arc::new(Traffic {
        is_over: false.into(),
        under_way: 0.into(),
        answered: Mutex::new(Instant::now()),
        answers: Mutex::default(),
        disk_fails,
        refused_as_full: 0.into(),
        refused: Mutex::default(),
    })
}

async fn connect(life: &Life) -> zenoh::Result<Arc<Client>> {
    Client::try_open(&life.endpoint).await.map(Arc::new)
}

/// Waits until a daemon is dead; without one, for ever.
/// Whether a daemon may end by itself with this code: killed at the point that is armed, or because
/// the disk fails.
fn may_end(code: Option<i32>, armed: Option<(Point, u64)>, failures: &[i32]) -> bool {
    match code {
        None => armed.is_some(),
        Some(code) => failures.contains(&code),
    }
}

async fn death(life: Option<&mut Life>) {
    let Some(life) = life else {
        return std::future::pending().await;
    };
    while life.child.try_wait().unwrap().is_none() {
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}
