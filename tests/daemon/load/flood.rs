//! A flood from many clients, of the daemon and, beside it, of a zenoh queryable that only makes
//! safe what it takes: what the bus, the disk and the machine take is not the daemon's.

use std::io::Write;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use jostled::rights::Rights;
use serde_json::json;
use tokio::sync::Semaphore;
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};

use crate::apart::Process;
use crate::load::{find, helper};
use crate::support::{Client, PATIENCE, PREFIX, alone, until};

/// How many clients flood, and for how long.
const CLIENTS: usize = 32;
const FLOODING: Duration = Duration::from_secs(3);

/// How long meanwhile the others are watched.
const WATCHING: Duration = Duration::from_secs(2);

/// How soon others are answered meanwhile and who is turned away, at the median; in the long run who
/// is turned away at the 99th percentile.
const SOON: Duration = Duration::from_millis(10);

/// Commands a second that are made safe and answered meanwhile, at least.
const DURABLE: f64 = 1500.0;

/// What a flood may add to the daemon's memory.
const GROWN_MB: u64 = 20;

/// How many times a bare queryable's median and 99th percentile the daemon's may be. Both are
/// measured in one run, as times alone say more of the machine than of the daemon.
const TIMES: (u32, u32) = (3, 4);

/// What a bare queryable writes down for a request, and what it answers: about what the daemon does.
const LINE_BYTES: usize = 300;
const ACCEPTED: &str =
    r#"{"swarm":"flooded","epoch":1,"step":100,"time":2.0,"seq":1000,"result":{}}"#;

/// The clients that flood `asked`: an endpoint, and how many requests of each may be unanswered.
#[tokio::test(flavor = "multi_thread")]
async fn a_flooding_process() {
    let Ok(asked) = std::env::var("JOSTLE_TEST_HELPER") else {
        return;
    };
    let (endpoint, unanswered) = asked.split_once(' ').unwrap();
    let unanswered: u32 = unanswered.parse().unwrap();
    let mut clients = Vec::new();
    for _ in 0..CLIENTS {
        clients.push(Client::open(endpoint).await);
    }
    println!("flooding");
    let (flooding, (told, heard)) = (Instant::now(), channel());
    let tasks = clients.into_iter().map(|client| {
        let told = told.clone();
        tokio::spawn(async move {
            let (began, room) = (Instant::now(), Semaphore::new(unanswered as usize));
            let room = Arc::new(room);
            while began.elapsed() < FLOODING {
                let place = Mutex::new(Some(room.clone().acquire_owned().await.unwrap()));
                let (told, sent) = (told.clone(), Instant::now());
                let query = client.session.get("jostle/flooded/cmd/set");
                let query = query.payload("{\"pi3\": 1}").timeout(2 * PATIENCE);
                let answered = move |reply: zenoh::query::Reply| {
                    told.send((reply.result().is_err(), sent.elapsed()))
                        .unwrap();
                    place.lock().unwrap().take();
                };
                query.callback(answered).await.unwrap();
            }
            // Until all are answered.
            drop(room.acquire_many(unanswered).await.unwrap());
        })
    });
    for task in tasks.collect::<Vec<_>>() {
        task.await.unwrap();
    }
    drop(told);
    let answers: Vec<(bool, Duration)> = heard.iter().collect();
    let busy = answers.iter().filter(|(is_busy, _)| *is_busy);
    let busy: Vec<Duration> = busy.map(|(_, took)| *took).collect();
    println!(
        "flooders: {} answered in {:.3} s, busy {}",
        answers.len(),
        flooding.elapsed().as_secs_f64(),
        spread(busy)
    );
}

/// A queryable and nothing else, on a session like the daemon's. It takes as many at once as the
/// daemon, writes them to a file together, syncs it and answers them; the rest it turns away with
/// the daemon's words.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_bare_process() {
    const MOST_TURNS: usize = 128;
    if std::env::var("JOSTLE_TEST_HELPER").is_err() {
        return;
    }
    let listen = ["tcp/127.0.0.1:0".to_owned()];
    let session = jostled::server::session::open(&listen, "jostle", &Rights::Everybody, 64)
        .await
        .unwrap();
    let busy = r#"{"code":"busy","message":"too many requests wait already: try again"}"#;
    let busy = ZBytes::from(busy);
    let (accepted, to_write) = channel::<zenoh::query::Query>();
    let turns = Arc::new(AtomicUsize::new(0));
    let taken = turns.clone();
    let take = move |query: zenoh::query::Query| {
        if taken.fetch_add(1, Ordering::Relaxed) < MOST_TURNS {
            return accepted.send(query).unwrap();
        }
        taken.fetch_sub(1, Ordering::Relaxed);
        let refusal = query.reply_err(busy.clone());
        let refusal = refusal.encoding(Encoding::APPLICATION_JSON);
        refusal.wait().unwrap();
    };
    let mut file = tempfile::tempfile().unwrap();
    std::thread::spawn(move || {
        while let Ok(first) = to_write.recv() {
            let together: Vec<_> = [first].into_iter().chain(to_write.try_iter()).collect();
            file.write_all(&vec![b'x'; LINE_BYTES * together.len()])
                .unwrap();
            file.sync_data().unwrap();
            for query in together {
                let answer = query.reply(query.key_expr(), ACCEPTED);
                let answer = answer.encoding(Encoding::APPLICATION_JSON);
                answer.wait().unwrap();
                turns.fetch_sub(1, Ordering::Relaxed);
            }
        }
    });
    let queryable = session.declare_queryable("jostle/*/cmd/**");
    let _queryable = queryable.callback(take).await.unwrap();
    println!("listening on {}", session.info().locators().await[0]);
    std::future::pending::<()>().await;
}

/// The median, the 99th percentile and the largest.
fn percentiles(mut all: Vec<Duration>) -> [Duration; 3] {
    all.sort_unstable();
    [50, 99, 100].map(|percent| {
        let at = all.get(all.len() * percent / 100).or(all.last());
        at.copied().unwrap_or_default()
    })
}

fn spread(all: Vec<Duration>) -> String {
    let count = all.len();
    let [half, most, longest] = percentiles(all);
    format!("{count} of them after {half:.1?}, {most:.1?}, {longest:.1?}")
}

/// What a flood did to others: how long those waited that ask one by one, at the flooded swarm and
/// at another one, how many of the former and of the flooders were turned away.
struct Flood {
    probe: [Duration; 3],
    commands: [Duration; 3],
    commands_failed: usize,
    turned_away: usize,
    /// How long those waited, of the former, that were turned away.
    busy: [Duration; 3],
    /// Commands of the flooders a second that were not.
    durable: f64,
}

/// Floods who listens at `endpoint`.
async fn flood(endpoint: &str, unanswered: usize) -> Flood {
    // What floods from elsewhere takes no time from the daemon's cores; from here it ranks last.
    let asked = format!("{endpoint} {unanswered}");
    let (_flooders, _, mut output) = helper("19", "flood::a_flooding_process", &asked, "flooding");
    // One whose own requests do not wait for each other sees how long an answer takes.
    let probe = Client::open(endpoint).await;
    let probing = tokio::spawn(async move {
        let (began, mut busy, mut all) = (Instant::now(), Vec::new(), Vec::new());
        while began.elapsed() < WATCHING {
            let asked = Instant::now();
            let answer = probe.cmd("flooded", "set", json!({"pi3": 1})).await;
            all.push(asked.elapsed());
            if answer.is_err_and(|error| error.code == ErrorCode::Busy) {
                busy.push(asked.elapsed());
            }
        }
        (all, busy)
    });
    let client = Client::open(endpoint).await;
    let (mut commands, mut commands_failed) = (Vec::new(), 0);
    while !probing.is_finished() {
        let asked = Instant::now();
        let answer = client.cmd("other0", "set", json!({"pi3": 1})).await;
        commands.push(asked.elapsed());
        commands_failed += usize::from(answer.is_err());
    }
    let (all, busy) = probing.await.unwrap();
    let flooders = find(&mut output, "flooders: ");
    println!("  one by one: {}", spread(all.clone()));
    println!("  of these busy: {}", spread(busy.clone()));
    println!("  another's commands: {}", spread(commands.clone()));
    println!("  flooders: {flooders}");
    let words: Vec<&str> = flooders.split(' ').collect();
    let [
        answered,
        "answered",
        "in",
        secs,
        "s,",
        "busy",
        turned_away,
        ..,
    ] = words[..]
    else {
        panic!("{flooders}");
    };
    let (answered, turned_away): (usize, usize) =
        (answered.parse().unwrap(), turned_away.parse().unwrap());
    Flood {
        probe: percentiles(all),
        commands: percentiles(commands),
        commands_failed,
        turned_away,
        busy: percentiles(busy),
        durable: (answered - turned_away) as f64 / secs.parse::<f64>().unwrap(),
    }
}

/// Floods a daemon of nine swarms; tells the slowest rate of the other swarms too, of 1, and by how
/// many megabytes its memory grew.
async fn flood_daemon(unanswered: usize) -> (Flood, f64, u64) {
    let (daemon, endpoint) = Process::serve();
    let client = Client::open(&endpoint).await;
    let swarms: Vec<String> = (0..8).map(|k| format!("other{k}")).collect();
    for name in swarms.iter().map(String::as_str).chain(["flooded"]) {
        client.create(name, json!({"n": 20, "rate": 1})).await;
        client.ok(name, "run", json!({})).await;
    }
    // Asked again when turned away, so that the rates are known even if the rest fails.
    let times = async || {
        let mut times = Vec::new();
        for name in &swarms {
            let key = keys::get(PREFIX, name, "status");
            until("a status", async || match client.one(&key, None).await {
                Ok(status) => {
                    times.push((Instant::now(), status["time"].as_f64().unwrap()));
                    true
                }
                Err(_) => false,
            })
            .await;
        }
        times
    };
    println!("{unanswered} each, the daemon:");
    let (before, resident) = (times().await, daemon.resident_bytes());
    let flood = flood(&endpoint, unanswered).await;
    let after = times().await;
    let rates = before
        .iter()
        .zip(&after)
        .map(|((then, from), (now, to))| (to - from) / now.duration_since(*then).as_secs_f64());
    let slowest = rates.fold(f64::INFINITY, f64::min);
    let grown_mb = daemon.resident_bytes().saturating_sub(resident) >> 20;
    println!(
        "  slowest of the other swarms: {slowest:.3} of 1; {:.0} durable commands a second, \
         {grown_mb} MB more",
        flood.durable
    );
    assert_eq!(flood.commands_failed, 0, "others have room of their own");
    (flood, slowest, grown_mb)
}

async fn flood_bare(unanswered: usize) -> Flood {
    let (_bare, endpoint, _output) = helper("0", "flood::a_bare_process", "", "listening on ");
    println!("{unanswered} each, a bare queryable:");
    flood(&endpoint, unanswered).await
}

/// The best of so many: what else goes on here makes one slow now and then, a slow daemon makes
/// them all so.
const ROUNDS: usize = 5;

/// Whom a flood leaves alone: the median is soon, and what the daemon adds to a bare queryable's
/// median and 99th percentile is little. Those of a bare one are what the bus, the disk and the
/// flooders take of the same machine; its longest is often above [`SOON`] by itself.
#[tokio::test(flavor = "multi_thread")]
async fn a_flood_from_32_clients_is_turned_away_and_hurts_nobody() {
    let _alone = alone().await;
    for unanswered in [64, 8, 1] {
        let mut problems = Vec::new();
        for _ in 0..ROUNDS {
            let (flood, slowest, grown_mb) = flood_daemon(unanswered).await;
            assert!(grown_mb < GROWN_MB, "{grown_mb} MB");
            let bare = flood_bare(unanswered).await;
            let [half, most, _] = flood.probe;
            let [bare_half, bare_most, _] = bare.probe;
            // Below this many nothing needs to be turned away.
            let is_turned_away = unanswered < 64 || flood.turned_away > 0;
            // The flooders compute on the same cores: who waits longest for `busy` waits for them.
            let is_long = std::env::var_os("JOSTLE_LONG").is_some();
            let busy = flood.busy[usize::from(is_long)];
            let is_soon = half < SOON && flood.commands[0] < SOON && busy < SOON;
            let is_durable = flood.durable > DURABLE;
            let adds_little = half < TIMES.0 * bare_half && most < TIMES.1 * bare_most;
            if slowest > 0.95 && is_turned_away && is_soon && is_durable && adds_little {
                problems.clear();
                break;
            }
            problems.push(format!(
                "{:?} beside {:?}, {:?}, {} turned away, {:?}, {:.0} durable a second, rate \
                 {slowest:.3}, {grown_mb} MB",
                flood.probe,
                bare.probe,
                flood.commands,
                flood.turned_away,
                flood.busy,
                flood.durable
            ));
        }
        assert!(problems.is_empty(), "{unanswered} each: {problems:#?}");
    }
}
