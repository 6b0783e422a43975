//! Many who follow one swarm, and some who do not take what they are sent: what the daemon needs for
//! them, and that neither steps nor the others notice.

#[path = "../../../benches/load/crowd.rs"]
mod crowd;

use std::io::{BufRead, BufReader, Write};
use std::process::Stdio;
use std::time::Duration;

use jostle_proto::keys;
use serde_json::json;

use crate::apart::{Process, busy_time, jostled};
use crate::load::{Output, find, helper};
use crate::support::{Client, PREFIX, alone};

use crowd::{Counted, Report};

/// Followers, and the seconds that they are counted; with `JOSTLE_LONG=1` as many as are wanted.
const FOLLOWERS: [(usize, u32); 2] = [(100, 4), (1000, 20)];

/// What is wanted with a thousand of them.
const CORES: f64 = 0.4;
const RESIDENT_MB: f64 = 150.0;
const DELIVERY_MS: f64 = 100.0;

/// By how much later 99.9 % of the steps may be than without them.
const LATER_MS: f64 = 1.0;

/// What one who takes all he is sent may lose while others do not, and what the daemon may grow by.
const LOST: f64 = 1e-3;
const GROWN_MB: f64 = 10.0;

/// The best of so many: what else goes on here makes one late now and then, a slow daemon all.
const ROUNDS: usize = 3;

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

/// A client that takes a second for each state, where its session reads.
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

/// A daemon with one swarm that runs, where it listens and where it serves HTTP.
async fn followed(spec: serde_json::Value, settle: u64) -> (Process, String, String) {
    let folder = tempfile::tempdir().unwrap();
    let mut command = jostled(&["--listen", "tcp/127.0.0.1:0", "--node", "test"]);
    command
        .args(["--http", "127.0.0.1:0", "--max-individuals", "5000"])
        .arg("--data-dir")
        .arg(folder.path())
        .stdout(Stdio::piped());
    let mut daemon = Process(command.spawn().unwrap(), folder);
    let mut said = BufReader::new(daemon.0.stdout.take().unwrap()).lines();
    let endpoint = find(&mut said, "listening on ");
    let http = find(&mut said, "http on http://");
    let client = Client::open(&endpoint).await;
    client.create("followed", spec).await;
    let steps = json!({"timeout_secs": 60, "args": {"steps": settle}});
    client.ok("followed", "step", steps).await;
    client.ok("followed", "run", json!({})).await;
    (daemon, endpoint, http)
}

/// What the daemon counted while a crowd did, what came to that, and how many cores others took.
fn count(
    daemon: &Process,
    crowd: &mut Crowd,
    http: &str,
    secs: u32,
) -> (Counted, Counted, Report, f64) {
    let before = Counted::by(http);
    let others = elsewhere(&[daemon, &crowd.0]);
    writeln!(crowd.0.0.stdin.as_ref().unwrap(), "{secs}").unwrap();
    let report = serde_json::from_str(&find(&mut crowd.2, "report ")).unwrap();
    let others = elsewhere(&[daemon, &crowd.0]).saturating_sub(others);
    let others = others.as_secs_f64() / f64::from(secs);
    (before, Counted::by(http), report, others)
}

type Crowd = (Process, String, Output);

/// Time that all cores have worked for anybody but these.
fn elsewhere(these: &[&Process]) -> Duration {
    let own: Duration = these.iter().map(|it| it.cpu_time()).sum();
    busy_time().saturating_sub(own)
}

/// With `JOSTLE_LONG=1` the second.
fn of_two<T: Copy>(choices: [T; 2]) -> T {
    choices[usize::from(std::env::var_os("JOSTLE_LONG").is_some())]
}

#[tokio::test(flavor = "multi_thread")]
async fn a_thousand_who_follow_are_served_and_no_step_is_late_for_it() {
    let _alone = alone().await;
    let (followers, secs) = of_two(FOLLOWERS);
    let spec = json!({"n": 50, "seed": 1, "rate": 2, "publish_every": 5});
    let (daemon, endpoint, http) = followed(spec, 5000).await;
    let mut problems = Vec::new();
    for _ in 0..ROUNDS {
        let (before, others) = (Counted::by(&http), elsewhere(&[&daemon]));
        tokio::time::sleep(Duration::from_secs(secs.into())).await;
        let others = elsewhere(&[&daemon]).saturating_sub(others).as_secs_f64() / f64::from(secs);
        let [_, late_alone] = Counted::by(&http).lateness_since(&before);
        let asked = format!("{endpoint} {followers}");
        let mut crowd = helper("0", FOLLOWING, &asked, "connected ");
        let (before, after, report, meanwhile) = count(&daemon, &mut crowd, &http, secs);
        let (cores, resident_mb) = (after.cores_since(&before), after.resident_mb);
        let [late_from, late_to] = after.lateness_since(&before);
        println!(
            "connected in {} s: {:.1} % of a core, {resident_mb:.0} MB, {late_from} to {late_to} ms \
             late, alone {late_alone}; {report:?}",
            crowd.1,
            100.0 * cores
        );
        assert!(cores <= CORES && resident_mb <= RESIDENT_MB);
        // That nobody loses anything is as sure as the rest.
        let is_served = report.delivery_ms[1] < DELIVERY_MS && report.most_lost == 0.0;
        let is_well = is_served && late_to <= late_alone + LATER_MS;
        let (others, seen) = (others.max(meanwhile), (late_to, late_alone, report));
        if judge(&mut problems, others, is_well, seen) {
            return;
        }
    }
    assert!(problems.is_empty(), "{problems:#?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_who_stopped_and_one_who_is_slow_cost_nobody_anything() {
    const OTHERS: usize = 18;
    let secs = of_two([6, 60]);
    let _alone = alone().await;
    // Some 200 kB a state, twenty a second: what is not taken fills every buffer soon.
    let spec = json!({"n": 4500, "seed": 1, "rate": 0.4, "publish_every": 1,
        "start": {"kind": "disc", "radius": 1000}});
    let (daemon, endpoint, http) = followed(spec, 1).await;
    let follow =
        |count: usize| helper("0", FOLLOWING, &format!("{endpoint} {count}"), "connected ");
    let mut all_others = follow(OTHERS);
    let mut problems = Vec::new();
    for _ in 0..ROUNDS {
        let stopping = follow(1);
        let (before, alone, _, others) = count(&daemon, &mut all_others, &http, secs);
        let [_, late_alone] = alone.lateness_since(&before);
        stopping.0.signal("-STOP");
        let _slow = helper("0", "followers::a_slow_process", &endpoint, "connected ");
        let (before, after, report, meanwhile) = count(&daemon, &mut all_others, &http, secs);
        let [late_from, late_to] = after.lateness_since(&before);
        let grown_mb = after.resident_mb - alone.resident_mb;
        println!(
            "{grown_mb:.1} MB more, {late_from} to {late_to} ms late, before {late_alone}; the others \
             {report:?}"
        );
        assert!(grown_mb < GROWN_MB);
        let is_well = report.most_lost <= LOST && late_to <= late_alone + LATER_MS;
        let (others, seen) = (others.max(meanwhile), (late_to, late_alone, report));
        if judge(&mut problems, others, is_well, seen) {
            return;
        }
    }
    assert!(problems.is_empty(), "{problems:#?}");
}

type Problem = (f64, f64, Report);

/// Whether all is well; if not, it is kept. Beside others who take the cores times say nothing,
/// neither of the daemon nor of what it is held against.
fn judge(problems: &mut Vec<Problem>, others: f64, is_well: bool, seen: Problem) -> bool {
    if others >= 0.2 {
        println!("not judged: other work took {others:.1} cores meanwhile");
        return false;
    }
    if !is_well {
        problems.push(seen);
    }
    is_well
}
