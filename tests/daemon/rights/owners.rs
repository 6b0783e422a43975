//! Whose swarms they are: the events and the log say who created and deleted them, also after a kill, and
//! users have equal shares of the cores.

use std::fs;
use std::num::NonZero;
use std::ops::RangeInclusive;
use std::thread;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{Event, Reply, Role, Snapshot, keys};
use serde_json::{Value, json};

use super::UserSession;
use super::live::process::AuthProcess;
use crate::support::process::{Process, jostled};
use crate::support::{NODE, PREFIX, TIMEOUT, until};

const EXPERIMENT: &str = "name = \"grid\"\nseeds = [1]\nduration = 1\nspec = { n = 3 }\n";

/// The events of a swarm that say that it was created.
pub(super) fn created(daemon: &AuthProcess, swarm: &str) -> Vec<Value> {
    let (status, reply) = daemon.http(&format!("GET /api/get/{swarm}/get/events"), "olga", "");
    assert_eq!(status, 200, "{swarm}: {reply}");
    let events = reply["result"]["events"].as_array().unwrap().iter();
    let is_created = |event: &&Value| event["event"]["kind"] == "created";
    events.filter(is_created).cloned().collect()
}

/// The base64 of a swarm's snapshot.
async fn snapshot(user: &UserSession, swarm: &str) -> String {
    let replies = user.session.get(keys::get(PREFIX, swarm, "snapshot"));
    let reply = replies.await.unwrap().recv_async().await.unwrap();
    let sample = reply.into_result().unwrap();
    let bytes = sample.payload().to_bytes();
    let reply: Reply<Snapshot> = ciborium::from_reader(&*bytes).unwrap();
    STANDARD.encode(jostle_proto::to_cbor(&reply.result))
}

/// Whether the log has a line with all of these words.
fn is_logged(daemon: &AuthProcess, words: &[&str]) -> bool {
    let log = daemon.log();
    let has_all = |line: &str| words.iter().all(|word| line.contains(word));
    log.lines().any(has_all)
}

#[tokio::test(flavor = "multi_thread")]
async fn events_and_the_log_name_who_created_and_deleted_a_swarm_also_after_a_kill() {
    let daemon = AuthProcess::start(&[("otto", Role::Operator)]).await;
    let otto = daemon.open_session("otto").await;
    let send = |user: &str, key: &str, request: Value| {
        let (status, reply) = daemon.http(&format!("POST /api/{key}"), user, &request.to_string());
        assert_eq!(status, 200, "{key}: {reply}");
    };
    let spec = json!({"name": "a", "spec": {"n": 3, "rate": null}});
    let create = json!({"client": "notebook", "request_id": "c1", "args": spec});
    send("olga", "node/create", create);
    send("otto", "cmd/a/step", json!({"steps": 7}));
    // The name that a client gives follows the user's: it is not otto who forks.
    let fork = json!({"client": "otto", "args": {"name": "b"}});
    send("olga", "cmd/a/fork", fork);
    let fork = json!({"request_id": "c2", "args": {"name": "c", "step": 3}});
    send("otto", "cmd/a/fork", fork);
    let bytes = snapshot(&otto, "a").await;
    otto.node_cmd("restore", json!({"name": "d", "snapshot": bytes}))
        .await;

    let mut before = Vec::new();
    for (swarm, verb, client, request_id, step) in [
        ("s", "create", "olga", None, 0),
        ("a", "create", "olga:notebook", Some("c1"), 0),
        ("b", "fork", "olga:otto", None, 7),
        ("c", "fork", "otto", Some("c2"), 3),
        ("d", "restore", "otto", None, 7),
    ] {
        let events = created(&daemon, swarm);
        let expected = json!({"kind": "created", "verb": verb, "client": client,
            "request_id": request_id});
        assert_eq!(events.len(), 1, "{swarm}: {events:?}");
        assert_eq!(events[0]["event"], expected, "{swarm}");
        assert_eq!(
            (&events[0]["number"], &events[0]["step"]),
            (&json!(1), &json!(step))
        );
        let named = [format!("swarm=\"{swarm}\""), format!("client=\"{client}\"")];
        let words = [" created ", &named[0], &named[1]];
        assert!(is_logged(&daemon, &words), "{words:?}: {}", daemon.log());
        before.push((swarm, events));
    }

    let record = json!({"client": "pad", "args": {"begin": {"swarm": "a", "recording": "r"}}});
    send("otto", "node/record", record);
    send("otto", "cmd/a/step", json!({"steps": 40}));
    send("otto", "node/record", json!({"stop": {"recording": "r"}}));
    let open = json!({"open": {"name": "p", "recording": "r"}});
    send(
        "otto",
        "node/replay",
        json!({"client": "pad", "args": open}),
    );
    let played = created(&daemon, "p");
    // The recording began after the creation, so that it has no such event of its own.
    assert_eq!(played.len(), 1, "{played:?}");
    let expected = json!({"kind": "created", "verb": "replay", "client": "otto:pad",
        "request_id": null});
    assert_eq!(played[0]["event"], expected);
    send("olga", "node/record", json!({"delete": {"recording": "r"}}));
    send(
        "otto",
        "node/experiment",
        json!({"submit": {"toml": EXPERIMENT}}),
    );
    until("the experiment is over", async || {
        let request = json!({"delete": {"name": "grid"}}).to_string();
        daemon.http("POST /api/node/experiment", "olga", &request).0 == 200
    })
    .await;

    let key = keys::event(PREFIX, "*");
    let events = otto.session.declare_subscriber(key).await.unwrap();
    // A reply on the same connection: the daemon has the subscription.
    otto.ok(&keys::get(PREFIX, "a", "status"), None).await;
    let delete = json!({"client": "pad", "request_id": "d1", "args": {}});
    send("otto", "cmd/a/delete", delete);
    send("olga", "node/discard", json!({"name": "b"}));
    send("olga", "cmd/p/delete", json!({}));
    let mut deleted = Vec::new();
    while deleted.len() < 3 {
        let sample = tokio::time::timeout(TIMEOUT, events.recv_async()).await;
        let bytes = sample.unwrap().unwrap().payload().to_bytes().into_owned();
        let event: Event = serde_json::from_slice(&bytes).unwrap();
        let kind = serde_json::to_value(&event.event).unwrap();
        if kind["kind"] == "deleted" {
            deleted.push((
                event.swarm,
                kind["client"].clone(),
                kind["request_id"].clone(),
            ));
        }
    }
    deleted.sort_by_key(|it| it.0.clone());
    assert_eq!(
        deleted,
        [
            ("a".to_owned(), json!("otto:pad"), json!("d1")),
            ("b".to_owned(), json!("olga"), json!(null)),
            ("p".to_owned(), json!("olga"), json!(null)),
        ]
    );
    for words in [
        [" created ", "swarm=\"p\"", "client=\"otto:pad\""],
        [" deleted ", "swarm=\"a\"", "client=\"otto:pad\""],
        [" deleted ", "swarm=\"b\"", "client=\"olga\""],
        [" deleted ", "swarm=\"p\"", "client=\"olga\""],
        [
            "started to record",
            "recording=\"r\"",
            "client=\"otto:pad\"",
        ],
        [" stopped ", "recording=\"r\"", "client=\"otto\""],
        [" deleted ", "recording=\"r\"", "client=\"olga\""],
        [
            "action=\"submit\"",
            "experiment=\"grid\"",
            "client=\"otto\"",
        ],
        [
            "action=\"delete\"",
            "experiment=\"grid\"",
            "client=\"olga\"",
        ],
    ] {
        assert!(is_logged(&daemon, &words), "{words:?}: {}", daemon.log());
    }

    otto.session.close().await.unwrap();
    let daemon = daemon.killed().await;
    for (swarm, events) in before {
        if !["a", "b"].contains(&swarm) {
            assert_eq!(created(&daemon, swarm), events, "{swarm}");
        }
    }
    daemon.end();
}

/// The processor time of the threads of swarms whose names begin so, in ticks of the kernel.
fn ticks(process: &Process, names: &str) -> u64 {
    let tasks = fs::read_dir(format!("/proc/{}/task", process.0.id())).unwrap();
    let stats = tasks.filter_map(|it| fs::read_to_string(it.unwrap().path().join("stat")).ok());
    let of_one = |stat: String| {
        // The name is in parentheses; the 12th and 13th field after it are the user and system time.
        let (name, fields) = stat.split_once('(')?.1.rsplit_once(") ")?;
        let fields = fields.split(' ').skip(11).take(2);
        name.starts_with(&format!("swarm-{names}"))
            .then(|| fields.map(|it| it.parse::<u64>().unwrap()).sum::<u64>())
    };
    stats.filter_map(of_one).sum::<u64>()
}

fn cores() -> usize {
    thread::available_parallelism().map_or(1, NonZero::get)
}

/// Waits until olga's swarms take a part in this range of the processor time of olga's and otto's, over a
/// second for each core. While other programs use the cores, the kernel prefers threads that have slept: those
/// of the user with more swarms.
async fn until_part_of_olga(process: &Process, range: RangeInclusive<f64>, what: &str) {
    let taken = || ["olga", "otto"].map(|names| ticks(process, names));
    let mut before = taken();
    until(what, async || {
        let now = taken();
        let [olga, both] = [now[0] - before[0], (0..2).map(|k| now[k] - before[k]).sum()];
        if both < 100 * cores() as u64 {
            return false;
        }
        before = now;
        let part = olga as f64 / both as f64;
        println!("{what}: {part:.3}");
        range.contains(&part)
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_user_with_one_swarm_gets_as_much_of_the_cores_as_one_with_four() {
    let daemon = AuthProcess::start(&[("otto", Role::Operator)]).await;
    // Each user could use all cores but one.
    let of_olga = cores().div_ceil(2);
    for (user, count) in [("olga", of_olga), ("otto", 4 * of_olga)] {
        for k in 0..count {
            let spec = json!({"name": format!("{user}{k}"), "spec": {"n": 100, "rate": null}});
            let create = json!({"client": "sweep", "args": spec}).to_string();
            assert_eq!(daemon.http("POST /api/node/create", user, &create).0, 200);
        }
    }
    for (user, count) in [("olga", of_olga), ("otto", 4 * of_olga)] {
        for k in 0..count {
            // Whoever lets it run: it belongs to the user who created it.
            let run = format!("POST /api/cmd/{user}{k}/run");
            assert_eq!(daemon.http(&run, "olga", "{}").0, 200);
        }
    }
    // Wrong shares are a fifth, or a quarter if the kernel decides.
    until_part_of_olga(&daemon.process, 0.34..=0.64, "about half").await;
    let daemon = daemon.killed().await;
    until_part_of_olga(&daemon.process, 0.34..=0.64, "about half after a kill").await;

    // Without users the swarms belong to nobody.
    let data = daemon.base.path().join("data");
    let mut process = daemon.process;
    process.signal("-KILL");
    process.end();
    let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", NODE]);
    let mut open = Process::of(command.arg("--data-dir").arg(data));
    until_part_of_olga(&open, 0.1..=0.28, "a fifth without users").await;
    open.signal("-KILL");
    open.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_user_forks_or_restores_has_no_share_beside_that_of_the_user() {
    let daemon = AuthProcess::start(&[("otto", Role::Operator)]).await;
    let send = |request: &str, user: &str, args: &Value| {
        let (status, reply) = daemon.http(request, user, &args.to_string());
        assert_eq!(status, 200, "{request} {args}: {reply}");
    };
    let school = json!({"name": "school", "spec": {"n": 100, "rate": null}});
    send("POST /api/node/create", "olga", &school);
    let otto = daemon.open_session("otto").await;
    let bytes = snapshot(&otto, "school").await;
    otto.session.close().await.unwrap();
    let of_olga = cores().div_ceil(2);
    for (verb, request) in [
        ("fork", "POST /api/cmd/school/fork"),
        ("restore", "POST /api/node/restore"),
    ] {
        let mut swarms = Vec::new();
        for (user, count) in [("olga", of_olga), ("otto", 4 * of_olga)] {
            for k in 0..count {
                let mut args = json!({"name": format!("{user}-{verb}{k}")});
                if verb == "restore" {
                    args["snapshot"] = json!(bytes);
                }
                send(request, user, &args);
                swarms.push(args["name"].as_str().unwrap().to_owned());
            }
        }
        for swarm in &swarms {
            send(&format!("POST /api/cmd/{swarm}/run"), "olga", &json!({}));
        }
        // If all belong to one user, or to nobody, it is a fifth.
        let what = format!("about half of what is made by {verb}");
        until_part_of_olga(&daemon.process, 0.34..=0.64, &what).await;
        for swarm in &swarms {
            send(&format!("POST /api/cmd/{swarm}/pause"), "olga", &json!({}));
        }
    }
    daemon.end();
}
