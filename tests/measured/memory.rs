//! The daemon's private memory while swarms are created and deleted and requests are answered.
//!
//! After a warm-up, in which caches, tables and the allocator's heaps reach their size, equal windows
//! are measured, until memory grows by less than a limit over five that follow each other. Before that
//! a cache may still fill up, or the allocator take a piece of memory from the system; a leak
//! continues in each window. A small leak first fills gaps in the heaps, so the limits are low.

use std::time::Instant;

use futures_util::future::join_all;
use jostle_proto::keys;
use serde_json::json;
use zenoh::Session;

use crate::support::process::Process;
use crate::support::{Client, NODE, PREFIX, TIMEOUT, until};

/// Replies before the first measurement: as many as the daemon remembers, and more, so that it evicts
/// the oldest.
const WARMING_REPLIES: usize = 120_000;

/// Swarms before the first measurement.
const WARMING_SWARMS: usize = 1_200;

/// Clients that send at once.
const CLIENTS: usize = 4;

/// Swarms of each client that stay. To each of them it sends a `set` and a `step` before it waits for
/// the replies.
const KEPT: usize = 5;

/// Requests that a client sends before it waits for their replies.
const IN_FLIGHT: usize = 2 * KEPT;

/// Swarms that a client has at once of those that it creates and deletes.
const AT_ONCE: usize = 10;

/// Windows over which the growth is judged.
const WINDOWS: usize = 5;

/// Windows that are measured at most until memory grows little enough.
const MAX_WINDOWS: usize = 15;

/// The limits in bytes, for each of 2,000 swarms and of 50,000 replies.
const PER_SWARM: f64 = 400.0;
const PER_REPLY: f64 = 25.0;

/// The limit for each of 20,000 swarms.
const PER_SWARM_OF_MANY: f64 = 200.0;

struct Load {
    daemon: Process,
    clients: Vec<Client>,
    replies: usize,
    swarms: usize,
    /// The daemon's threads when it hosts no swarm but those of the clients.
    threads: usize,
}

impl Load {
    async fn start() -> Self {
        let (daemon, endpoint) = Process::serve();
        let mut clients = Vec::new();
        for number in 0..CLIENTS {
            let client = Client::open(&endpoint).await;
            for swarm in 0..KEPT {
                client
                    .create(&kept_name(number, swarm), json!({"n": 3}))
                    .await;
            }
            clients.push(client);
        }
        let mut load = Load {
            daemon,
            clients,
            replies: 0,
            swarms: 0,
            threads: 0,
        };
        let began = Instant::now();
        load.reply(WARMING_REPLIES).await;
        let replies = began.elapsed();
        load.threads = load.thread_count();
        load.create_and_delete(WARMING_SWARMS).await;
        println!(
            "warm-up: {WARMING_REPLIES} replies in {replies:.1?}, {WARMING_SWARMS} swarms in {:.1?}",
            began.elapsed() - replies
        );
        load
    }

    /// Has `count` requests answered, half of them `set` and half of them `step`, each with a
    /// `request_id` of its own.
    async fn reply(&mut self, count: usize) {
        assert!(count.is_multiple_of(CLIENTS * IN_FLIGHT));
        let (first, each) = (self.replies, count / CLIENTS);
        self.replies += count;
        let sending = self
            .clients
            .iter()
            .enumerate()
            .map(async |(number, client)| {
                let begin = first + number * each;
                for some in (begin..begin + each).step_by(IN_FLIGHT) {
                    let requests = (0..IN_FLIGHT).map(|k| {
                        let (verb, args) = match k % 2 {
                            0 => ("set", json!({"pi3": 1})),
                            _ => ("step", json!({})),
                        };
                        // As long as every other id.
                        let id = format!("{:09}", some + k);
                        let client = format!("client-{number}");
                        let request = json!({"client": client, "request_id": id, "args": args});
                        let key = keys::cmd(PREFIX, &kept_name(number, k / 2), verb);
                        (key, request.to_string())
                    });
                    all_ok(&client.session, requests).await;
                }
            });
        join_all(sending).await;
    }

    /// Creates `count` swarms, each under a name of its own, has them step and deletes them.
    async fn create_and_delete(&mut self, count: usize) {
        assert!(count.is_multiple_of(CLIENTS * AT_ONCE));
        let (first, each) = (self.swarms, count / CLIENTS);
        self.swarms += count;
        let sending = self
            .clients
            .iter()
            .enumerate()
            .map(async |(number, client)| {
                let begin = first + number * each;
                for some in (begin..begin + each).step_by(AT_ONCE) {
                    let names = || (some..some + AT_ONCE).map(|number| format!("s{number:09}"));
                    let create = keys::node_cmd(PREFIX, NODE, "create");
                    let created = names().map(|name| {
                        let request = json!({"name": name, "spec": {"n": 20, "seed": 1}});
                        (create.clone(), request.to_string())
                    });
                    all_ok(&client.session, created).await;
                    for (verb, request) in [("step", "{\"steps\": 5}"), ("delete", "{}")] {
                        let sent = names()
                            .map(|name| (keys::cmd(PREFIX, &name, verb), request.to_owned()));
                        all_ok(&client.session, sent).await;
                    }
                }
            });
        join_all(sending).await;
        let status = self.clients[0].node("status").await;
        assert_eq!(status["swarms"], CLIENTS * KEPT);
        until("the threads of the deleted swarms end", async || {
            self.thread_count() <= self.threads
        })
        .await;
    }

    /// Waits until the store has written everything that the daemon keeps in memory for it.
    async fn until_written(&self) {
        until("everything is written", async || {
            self.clients[0].node("metrics").await["store"]["waiting"] == 0
        })
        .await;
    }

    fn thread_count(&self) -> usize {
        let path = format!("/proc/{}/task", self.daemon.0.id());
        std::fs::read_dir(path).unwrap().count()
    }

    /// Memory that is the daemon's alone and in no file.
    fn private_bytes(&self) -> i64 {
        let path = format!("/proc/{}/smaps_rollup", self.daemon.0.id());
        let rollup = std::fs::read_to_string(path).unwrap();
        let kilobytes = |name: &str| -> i64 {
            let line = rollup.lines().find_map(|line| line.strip_prefix(name));
            let number = line.unwrap().trim().strip_suffix(" kB").unwrap();
            number.parse().unwrap()
        };
        (kilobytes("Anonymous:") + kilobytes("Swap:")) * 1024
    }
}

/// The name of a swarm that stays.
fn kept_name(client: usize, swarm: usize) -> String {
    format!("kept-{client}-{swarm}")
}

/// Sends requests, waits for their replies, and expects no error.
async fn all_ok(session: &Session, requests: impl Iterator<Item = (String, String)>) {
    let mut pending = Vec::new();
    for (key, request) in requests {
        let query = session.get(key.clone()).payload(request);
        pending.push((key, query.timeout(2 * TIMEOUT).await.unwrap()));
    }
    for (key, replies) in pending {
        let reply = replies.recv_async().await.unwrap().into_result();
        if let Err(error) = reply {
            let error = error.payload().to_bytes();
            panic!("{key}: {}", String::from_utf8_lossy(&error));
        }
    }
}

/// What is done in a window.
#[derive(Clone, Copy, Debug)]
enum Workload {
    Swarms,
    Replies,
}

/// Measures windows of `each` swarms or replies until memory grows by less than `limit` bytes for each
/// of them over the last [`WINDOWS`]; returns what it grows by.
async fn growth(load: &mut Load, what: Workload, each: usize, limit: f64) -> f64 {
    load.until_written().await;
    let mut grown = Vec::new();
    let mut before = load.private_bytes();
    println!("{what:?}: {} kB", before / 1024);
    loop {
        match what {
            Workload::Swarms => load.create_and_delete(each).await,
            Workload::Replies => load.reply(each).await,
        }
        load.until_written().await;
        let after = load.private_bytes();
        grown.push(after - before);
        before = after;
        println!("{} kB more", grown[grown.len() - 1] / 1024);
        let Some(last) = grown.last_chunk::<WINDOWS>() else {
            continue;
        };
        let mean = last.iter().sum::<i64>() as f64 / (WINDOWS * each) as f64;
        if mean < limit || grown.len() == MAX_WINDOWS {
            println!("{mean:.0} bytes for each of {what:?}");
            return mean;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn two_thousand_swarms_and_fifty_thousand_replies_leave_no_memory_behind() {
    let mut load = Load::start().await;
    let swarm = growth(&mut load, Workload::Swarms, 2_000 / WINDOWS, PER_SWARM).await;
    let reply = growth(&mut load, Workload::Replies, 50_000 / WINDOWS, PER_REPLY).await;
    let judged = format!("{swarm:.0} bytes for each swarm, {reply:.0} for each reply");
    assert!(swarm < PER_SWARM && reply < PER_REPLY, "{judged}");
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "long: minutes, with 20,000 swarms"]
async fn twenty_thousand_swarms_leave_no_memory_behind() {
    let mut load = Load::start().await;
    let swarm = growth(
        &mut load,
        Workload::Swarms,
        20_000 / WINDOWS,
        PER_SWARM_OF_MANY,
    )
    .await;
    assert!(swarm < PER_SWARM_OF_MANY, "{swarm:.0} bytes for each swarm");
}
