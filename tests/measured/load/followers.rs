//! Many followers of one swarm, and some that do not read: the memory that the daemon needs for them,
//! and that the others lose no state. Times are measured by `cargo bench --bench load`.

#[path = "../../../benches/load/crowd.rs"]
mod crowd;

use std::io::Write;
use std::time::Duration;

use jostle_proto::keys;
use serde_json::json;

use crate::load::{Output, find, helper};
use crate::stolen::Stolen;
use crate::support::process::{Process, jostled};
use crate::support::{Client, PREFIX};

use crowd::Report;

/// Followers, and the seconds that they are counted; with `JOSTLE_LONG=1` the second.
const FOLLOWERS: [(usize, u32); 2] = [(100, 4), (1000, 20)];

/// The daemon's resident memory with a thousand of them.
const RESIDENT_MB: f64 = 150.0;

/// The share of the states that a follower may lose while others do not read, and what the daemon may
/// grow by.
const LOST: f64 = 1e-3;
const GROWN_MB: f64 = 10.0;

/// The share of the processors' time that a host may take from a count, and the counts that it may spoil.
const MOST_STOLEN: f64 = 0.02;
const COUNTS: usize = 10;

const FOLLOWING: &str = "followers::a_following_process";

/// The clients that follow `asked`: an endpoint, and how many they are.
#[tokio::test(flavor = "multi_thread")]
async fn a_following_process() {
    let Ok(asked) = std::env::var("JOSTLE_TEST_HELPER") else {
        return;
    };
    let (endpoint, followers) = asked.split_once(' ').unwrap();
    crowd::follow(endpoint, "followed", followers.parse().unwrap()).await;
}

/// A client whose session needs a second for each state.
#[tokio::test(flavor = "multi_thread")]
async fn a_slow_process() {
    let Ok(endpoint) = std::env::var("JOSTLE_TEST_HELPER") else {
        return;
    };
    let client = Client::open(&endpoint).await;
    let key = keys::state(PREFIX, "followed");
    let states = client.session.declare_subscriber(key);
    let slow = states.callback(|_| std::thread::sleep(Duration::from_secs(1)));
    let _slow = slow.await.unwrap();
    println!("connected ");
    std::future::pending::<()>().await;
}

fn resident_mb(daemon: &Process) -> f64 {
    daemon.resident_bytes() as f64 / 1e6
}

/// A daemon with one swarm that runs, and where it listens.
async fn followed(spec: serde_json::Value, settle: u64) -> (Process, String) {
    let mut command = jostled(&["--listen", "tcp/127.0.0.1:0", "--node", "test"]);
    command.args(["--max-individuals", "5000"]);
    let (daemon, endpoint) = Process::start(&mut command, tempfile::tempdir().unwrap());
    let client = Client::open(&endpoint).await;
    client.create("followed", spec).await;
    let steps = json!({"timeout_secs": 60, "args": {"steps": settle}});
    client.ok("followed", "step", steps).await;
    client.ok("followed", "run", json!({})).await;
    (daemon, endpoint)
}

type Crowd = (Process, String, Output);

/// Lets the clients count what they receive for so many seconds.
fn count(crowd: &mut Crowd, secs: u32) -> Report {
    writeln!(crowd.0.0.stdin.as_ref().unwrap(), "{secs}").unwrap();
    serde_json::from_str(&find(&mut crowd.2, "report ")).unwrap()
}

/// Counts until no follower loses more than `lost`, or the host has left the machine its processors: the
/// daemon drops what it cannot send meanwhile.
fn count_with_processors(crowd: &mut Crowd, secs: u32, lost: f64) -> Report {
    for _ in 0..COUNTS {
        let stolen = Stolen::begin();
        let report = count(crowd, secs);
        println!("{report:?}");
        if stolen.share() < MOST_STOLEN || report.most_lost <= lost {
            return report;
        }
    }
    panic!("the host takes the processors: nothing can be said of lost states");
}

/// With `JOSTLE_LONG=1` the second.
fn of_two<T: Copy>(choices: [T; 2]) -> T {
    choices[usize::from(std::env::var_os("JOSTLE_LONG").is_some())]
}

#[tokio::test(flavor = "multi_thread")]
async fn a_thousand_followers_receive_every_state() {
    let (followers, secs) = of_two(FOLLOWERS);
    let spec = json!({"n": 50, "seed": 1, "rate": 2, "publish_every": 5});
    let (daemon, endpoint) = followed(spec, 5000).await;
    let asked = format!("{endpoint} {followers}");
    let mut crowd = helper("0", FOLLOWING, &asked, "connected ");
    let report = count_with_processors(&mut crowd, secs, 0.0);
    let resident_mb = resident_mb(&daemon);
    println!("connected in {} s: {resident_mb:.0} MB", crowd.1);
    assert_eq!(report.sessions, followers);
    assert!(resident_mb <= RESIDENT_MB, "{resident_mb} MB");
    assert!(report.most_lost == 0.0, "{report:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stopped_and_a_slow_follower_cost_the_others_no_state() {
    const OTHERS: usize = 18;
    let secs = of_two([6, 60]);
    // Some 200 kB a state, twenty a second: they fill every buffer of a client that does not read.
    let spec = json!({"n": 4500, "seed": 1, "rate": 0.4, "publish_every": 1,
        "start": {"kind": "disc", "radius": 1000}});
    let (daemon, endpoint) = followed(spec, 1).await;
    let follow =
        |count: usize| helper("0", FOLLOWING, &format!("{endpoint} {count}"), "connected ");
    let mut others = follow(OTHERS);
    let stopping = follow(1);
    count(&mut others, secs);
    let before_mb = resident_mb(&daemon);
    stopping.0.signal("-STOP");
    let _slow = helper("0", "followers::a_slow_process", &endpoint, "connected ");
    let report = count_with_processors(&mut others, secs, LOST);
    let grown_mb = resident_mb(&daemon) - before_mb;
    println!("{grown_mb:.1} MB more");
    assert!(grown_mb < GROWN_MB, "{grown_mb} MB");
    assert!(report.most_lost <= LOST, "{report:?}");
}
