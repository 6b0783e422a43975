//! Many sessions in one process that follow one swarm, and the times of the states that each receives.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use jostle_proto::{State, keys};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio::sync::Semaphore;
use zenoh::Session;
use zenoh::pubsub::Subscriber;

/// Sessions that are being opened at once.
const AT_ONCE: usize = 32;

/// States at either end of the count, which some sessions received before and others after it.
const UNDER_WAY: usize = 3;

/// What all sessions received.
#[derive(Debug, Deserialize, Serialize)]
pub struct Report {
    /// The number of sessions.
    pub sessions: usize,
    /// Milliseconds from the first session's receipt of a state to another's: the median, the
    /// 99th and the 99.9th percentile.
    pub delivery_ms: [f64; 3],
    /// States that each should have received, by the swarm's steps. The others are lost, wherever they
    /// were dropped.
    pub states: u64,
    /// The largest share of them that one session did not receive.
    pub most_lost: f64,
    /// The share of all sessions together.
    pub lost: f64,
}

struct Follower {
    _session: Session,
    _subscriber: Subscriber<()>,
    /// The step of each state, and the time of its receipt.
    came: Arc<Mutex<Vec<(u64, Instant)>>>,
}

/// Follows a swarm's states with so many sessions, prints `connected` and the seconds that took;
/// then, for each line of its input, counts for so many seconds and prints `report` and a
/// [`Report`].
pub async fn follow(endpoint: &str, swarm: &str, sessions: usize) {
    let allowed = getrlimit(Resource::Nofile);
    let most = Rlimit {
        current: allowed.maximum,
        ..allowed
    };
    setrlimit(Resource::Nofile, most).unwrap();
    let (room, began) = (Arc::new(Semaphore::new(AT_ONCE)), Instant::now());
    let opening = (0..sessions).map(|_| {
        let (room, endpoint) = (room.clone(), endpoint.to_owned());
        let key = keys::state("jostle", swarm);
        tokio::spawn(async move {
            let _room = room.acquire().await;
            Follower::open(&endpoint, key).await
        })
    });
    let mut crowd = Vec::new();
    for opening in opening.collect::<Vec<_>>() {
        crowd.push(opening.await.unwrap());
    }
    println!("connected {}", began.elapsed().as_secs_f64());
    for line in std::io::stdin().lines() {
        let counted = Duration::from_secs_f64(line.unwrap().parse().unwrap());
        crowd.iter().for_each(|it| drop(it.taken()));
        tokio::time::sleep(counted).await;
        let came: Vec<_> = crowd.iter().map(Follower::taken).collect();
        println!("report {}", serde_json::to_string(&report(&came)).unwrap());
    }
}

impl Follower {
    async fn open(endpoint: &str, key: String) -> Self {
        let mut config = zenoh::Config::default();
        for (setting, value) in [
            ("mode", json!("client")),
            ("connect/endpoints", json!([endpoint])),
            ("connect/timeout_ms", json!(20_000)),
            ("scouting/multicast/enabled", json!(false)),
            ("scouting/gossip/enabled", json!(false)),
        ] {
            config.insert_json5(setting, &value.to_string()).unwrap();
        }
        let session = zenoh::open(config).await.unwrap();
        let came = Arc::new(Mutex::new(Vec::new()));
        let coming = came.clone();
        let subscriber = session.declare_subscriber(key).callback(move |sample| {
            let came_at = Instant::now();
            let state = State::from_cbor(&sample.payload().to_bytes()).unwrap();
            lock(&coming).push((state.step, came_at));
        });
        Follower {
            _subscriber: subscriber.await.unwrap(),
            _session: session,
            came,
        }
    }

    fn taken(&self) -> Vec<(u64, Instant)> {
        std::mem::take(&mut *lock(&self.came))
    }
}

fn lock<T>(of: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

fn report(came: &[Vec<(u64, Instant)>]) -> Report {
    let seen: BTreeSet<u64> = came.iter().flatten().map(|(step, _)| *step).collect();
    let seen: Vec<u64> = seen.into_iter().collect();
    assert!(
        seen.len() > 4 * UNDER_WAY,
        "the swarm stands still: {seen:?}"
    );
    // A state that no session received is a gap between steps, which have equal distances otherwise.
    let every = seen.windows(2).map(|pair| pair[1] - pair[0]).min().unwrap();
    let counted = seen[UNDER_WAY]..=seen[seen.len() - 1 - UNDER_WAY];
    let states = (counted.end() - counted.start()) / every + 1;
    let lost = came.iter().map(|of_one| {
        let there = of_one.iter().filter(|(step, _)| counted.contains(step));
        1.0 - there.count() as f64 / states as f64
    });
    let lost: Vec<f64> = lost.collect();
    let mut first = BTreeMap::new();
    for (step, came_at) in came.iter().flatten() {
        let first = first.entry(*step).or_insert(*came_at);
        *first = (*first).min(*came_at);
    }
    let took = came.iter().flatten().map(|(step, at)| *at - first[step]);
    let mut took: Vec<Duration> = took.collect();
    took.sort_unstable();
    Report {
        sessions: came.len(),
        delivery_ms: [500, 990, 999].map(|of_1000| {
            let at = took.len() * of_1000 / 1000;
            1e3 * took[at].as_secs_f64()
        }),
        states,
        most_lost: lost.iter().copied().fold(0.0, f64::max),
        lost: lost.iter().sum::<f64>() / lost.len() as f64,
    }
}
