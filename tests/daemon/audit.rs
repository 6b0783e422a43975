//! The audit log: who sent which commands, with what outcome, also once what they concern is gone.

use std::time::{Duration, Instant};

use jostle_proto::keys;
use serde_json::{Value, json};

use crate::support::daemon_process::{self, DaemonProcess, killed, start};
use crate::support::{Client, Daemon, NODE, PREFIX, until};

/// The lines of the audit log that the parameters select.
async fn lines(client: &Client, parameters: &str) -> Vec<Value> {
    let key = keys::node_get(PREFIX, NODE, "audit");
    let reply = client.query(&format!("{key}?{parameters}"), None).await;
    let result = reply.unwrap()["result"].take();
    assert_eq!(result["damaged"], 0, "{result}");
    result["lines"].as_array().unwrap().clone()
}

/// A line without number and time: client, verb, action, name, and how many commands ended how.
fn short(line: &Value) -> String {
    let text = |field: &str| line[field].as_str().unwrap_or("-").to_owned();
    let outcomes = line["outcomes"].as_array().unwrap().iter();
    let outcomes: Vec<_> = outcomes
        .map(|it| format!("{} {}", it["outcome"].as_str().unwrap(), it["count"]))
        .collect();
    let fields = ["user", "client", "verb", "action", "name"].map(text);
    let count = &line["count"];
    format!("{} {count}: {}", fields.join(" "), outcomes.join(", "))
}

async fn shorts(client: &Client, parameters: &str) -> Vec<String> {
    lines(client, parameters).await.iter().map(short).collect()
}

/// A command to the daemon, and the code of its error.
async fn node(client: &Client, verb: &str, request: Value) -> Result<Value, String> {
    let key = keys::node_cmd(PREFIX, NODE, verb);
    let reply = client
        .query(&key, Some(request.to_string().as_bytes()))
        .await;
    reply.map_err(|error| json!(error.code).as_str().unwrap().to_owned())
}

fn by(client: &str, args: Value) -> Value {
    let mut request = json!({"client": client});
    request["args"] = args;
    request
}

#[tokio::test(flavor = "multi_thread")]
async fn every_command_has_a_line_that_outlives_what_it_concerns() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = start(folder.path()).await;
    let client = &daemon.1;
    let spec = json!({"name": "school", "spec": {"n": 8, "seed": 1}});
    node(client, "create", by("ada", spec.clone()))
        .await
        .unwrap();
    assert_eq!(
        node(client, "create", by("ben", spec)).await.unwrap_err(),
        "already_exists"
    );
    let select = json!({"select": {"count": 2}, "direction": 1});
    let inform = json!({"client": "ada", "request_id": "1", "args": select});
    // The same request is one command.
    for _ in 0..3 {
        client.ok("school", "inform", inform.clone()).await;
    }
    client
        .ok("school", "fork", by("ben", json!({"name": "copy"})))
        .await;
    for _ in 0..5 {
        client
            .ok("school", "step", by("ada", json!({"steps": 2})))
            .await;
    }
    client
        .err("school", "step", json!({"client": "ada", "expect_step": 3}))
        .await;
    let toml = "name = 'sweep'\nduration = 1\n[spec]\nn = 2\n";
    let submit = json!({"submit": {"toml": toml}});
    node(client, "experiment", by("ada", submit)).await.unwrap();
    let cancel = json!({"cancel": {"name": "nothing"}});
    assert_eq!(
        node(client, "experiment", by("ben", cancel))
            .await
            .unwrap_err(),
        "not_found"
    );
    let begin = json!({"begin": {"swarm": "school", "recording": "film"}});
    node(client, "record", by("ada", begin)).await.unwrap();
    let stop = json!({"delete": {"recording": "film"}});
    node(client, "record", by("ben", stop)).await.unwrap();
    node(client, "discard", by("cleo", json!({"name": "copy"})))
        .await
        .unwrap();
    client.ok("school", "delete", json!({})).await;
    // Arguments that cannot be read are no command, and neither is a read.
    client
        .err("school", "set", json!({"args": {"nonsense": 1}}))
        .await;
    let expected = [
        "- ada create - school 1: ok 1",
        "- ben create - school 1: already_exists 1",
        "- ada inform - school 1: ok 1",
        "- ben fork of school copy 1: ok 1",
        "- ada step - school 6: conflict 1, ok 5",
        "- ada experiment submit sweep 1: ok 1",
        "- ben experiment cancel nothing 1: not_found 1",
        "- ada record begin film 1: ok 1",
        "- ben record delete film 1: ok 1",
        "- cleo discard - copy 1: ok 1",
        "- - delete - school 1: ok 1",
    ];
    // A line of several commands is written once a second.
    until("all outcomes are stored", async || {
        shorts(client, "limit=1000").await == expected
    })
    .await;
    let all = lines(client, "limit=1000").await;
    for (k, line) in all.iter().enumerate() {
        assert_eq!(line["number"], k + 1, "{line}");
        let [first, last] = ["unix_secs", "last_unix_secs"].map(|it| line[it].as_f64().unwrap());
        assert!(
            first > 1.7e9 && last >= first && last < first + 60.0,
            "{line}"
        );
    }

    let daemon = killed(folder.path(), daemon).await;
    let client = &daemon.1;
    assert_eq!(lines(client, "limit=1000").await, all);
    assert_eq!(lines(client, "limit=1000;user=").await, all);
    assert_eq!(lines(client, "user=ada").await, [Value::Null; 0]);
    assert_eq!(
        shorts(client, "name=school;verb=delete").await,
        [expected[10]]
    );
    assert_eq!(
        shorts(client, "client=ben;limit=2").await,
        [expected[1], expected[3]]
    );
    assert_eq!(shorts(client, "before=5;limit=2").await, expected[2..4]);
    assert_eq!(shorts(client, "after=9").await, expected[9..]);
    let time = all[3]["unix_secs"].as_f64().unwrap();
    let until = shorts(client, &format!("to_time={time}")).await;
    assert_eq!(until.last().map(String::as_str), Some(expected[3]));
    let future = time + 1000.0;
    assert_eq!(
        lines(client, &format!("from_time={future}")).await,
        [Value::Null; 0]
    );
    // It goes on with the next number.
    node(client, "discard", json!({"name": "copy"}))
        .await
        .unwrap_err();
    assert_eq!(lines(client, "after=11").await[0]["number"], 12);
    let key = keys::node_get(PREFIX, NODE, "audit");
    for wrong in [
        "limit=0",
        "from_time=nan",
        "after=-1",
        "who=ada",
        "to_time=1e300",
        "before=x",
    ] {
        let error = client
            .query(&format!("{key}?{wrong}"), None)
            .await
            .unwrap_err();
        assert_eq!(json!(error.code), "invalid_argument", "{wrong}: {error:?}");
    }
}

/// The line is queued before what the command changes, so no kill leaves the one without the other.
#[tokio::test(flavor = "multi_thread")]
async fn a_kill_leaves_no_deletion_without_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    daemon.1.create("school", json!({"n": 3})).await;
    daemon.0.kill();
    let mut command = daemon_process::daemon(folder.path());
    command.env("FAILPOINTS", "swarm-ended=return");
    let mut process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    let key = keys::cmd(PREFIX, "school", "delete");
    let request = by("mallory", json!({})).to_string();
    let answers = client.query_all(&key, Some(request.as_bytes())).await;
    assert!(answers.is_empty(), "{answers:?}");
    assert_eq!(process.end(), None);
    let (_process, client) = start(folder.path()).await;
    assert_eq!(client.node("swarms").await["swarms"], json!([]));
    let lines = shorts(&client, "verb=delete").await;
    assert_eq!(lines, ["- mallory delete - school 1: "]);
}

#[tokio::test(flavor = "multi_thread")]
async fn many_equal_commands_of_a_minute_share_a_line() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("school", json!({"n": 3, "rate": null})).await;
    for _ in 0..300 {
        client.ok("school", "step", json!({})).await;
    }
    // A stop writes what is counted.
    let daemon = daemon.restart().await;
    let client = &daemon.client;
    assert_eq!(
        shorts(client, "verb=step").await,
        ["- - step - school 300: ok 300"]
    );
    client.ok("school", "step", json!({})).await;
    assert_eq!(lines(client, "verb=step").await.len(), 2);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_line_has_the_times_of_its_first_and_its_last_command() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("school", json!({"n": 3, "rate": null})).await;
    let began = Instant::now();
    for _ in 0..2 {
        client.ok("school", "step", json!({})).await;
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
    client.ok("school", "step", json!({})).await;
    let apart = began.elapsed().as_secs_f64();
    let daemon = daemon.restart().await;
    let [line] = &lines(&daemon.client, "verb=step").await[..] else {
        panic!("not one line");
    };
    let [first, last] = ["unix_secs", "last_unix_secs"].map(|it| line[it].as_f64().unwrap());
    assert!(
        (1.9..apart + 0.1).contains(&(last - first)),
        "{line}, {apart}"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn on_a_full_disk_the_log_of_the_daemon_has_the_lines_until_there_is_space() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = daemon_process::daemon(folder.path());
    command.env("FAILPOINTS", "store-full=20*off->40*return->off");
    let mut process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    client.create("school", json!({"n": 3})).await;
    let mut set = 0;
    until("the disk is full", async || {
        set += 1;
        let request = by("ada", json!({"pi3": 1.5}));
        client.cmd("school", "set", request).await.is_err()
    })
    .await;
    for k in 0..3 {
        let remove = json!({"select": {"count": 1}});
        let request = by(&format!("mallory-{k}"), remove);
        client.err("school", "remove", request).await;
    }
    let log = daemon_process::log(folder.path());
    let lines = log
        .lines()
        .filter(|line| line.contains("that the audit log lacks"));
    let lines: Vec<_> = lines.collect();
    for k in 0..3 {
        let name = format!("mallory-{k}");
        let is_it = |line: &&&str| line.contains(&name) && line.contains("remove");
        let found = lines.iter().find(is_it);
        assert!(
            found.is_some_and(|line| line.contains("school")),
            "{lines:#?}"
        );
    }
    let mut before = 0;
    until("there is space", async || {
        let remove = by("mallory-0", json!({"select": {"count": 1}}));
        let outcome = client.cmd("school", "remove", remove).await;
        before += u32::from(outcome.is_err());
        outcome.is_ok()
    })
    .await;
    assert!(before > 0, "the disk was full for no repeated command");
    // What happened meanwhile is written without another command.
    let (ok, full) = (set - 1, before + 1);
    let expected = [
        (
            "ada",
            format!("- ada set - school {set}: ok {ok}, storage_full 1"),
        ),
        (
            "mallory-0",
            format!(
                "- mallory-0 remove - school {}: ok 1, storage_full {full}",
                full + 1
            ),
        ),
        (
            "mallory-1",
            "- mallory-1 remove - school 1: storage_full 1".to_owned(),
        ),
        (
            "mallory-2",
            "- mallory-2 remove - school 1: storage_full 1".to_owned(),
        ),
    ];
    for (name, expected) in expected {
        until("the line is complete", async || {
            shorts(&client, &format!("client={name}")).await == [expected.clone()]
        })
        .await;
    }
    process.kill();
}
