//! Pages of the journal of a swarm, read from the store.

use std::time::Instant;

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use crate::support::daemon_process::{killed, start};
use crate::support::playback::{recorded_file, upload_and_open};
use crate::support::{Client, Daemon, PREFIX, result_of, until};

/// The entries on all pages that the parameters select, `limit` on each.
async fn entries(client: &Client, swarm: &str, parameters: &str, limit: usize) -> Vec<Value> {
    let (mut all, mut next) = (Vec::new(), None::<u64>);
    loop {
        let line = next.map_or(String::new(), |line| format!(";line={line}"));
        let noun = format!("journal?limit={limit}{line}{parameters}");
        let page = client.get(swarm, &noun).await["result"].take();
        let entries = page["entries"].as_array().unwrap();
        assert!(entries.len() <= limit, "{page}");
        all.extend(entries.iter().cloned());
        next = page["next"].as_u64();
        if next.is_none() {
            return all;
        }
    }
}

fn verbs(entries: &[Value]) -> Vec<&str> {
    entries
        .iter()
        .map(|it| it["verb"].as_str().unwrap())
        .collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn thousands_of_commands_push_none_out_and_each_is_found() {
    const EXCHANGES: usize = 3000;
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = start(folder.path()).await;
    let client = &daemon.1;
    client
        .create("school", json!({"n": 4, "seed": 1, "rate": null}))
        .await;
    let inform = json!({"client": "olga", "args": {"select": {"count": 1}, "direction": 1}});
    client.ok("school", "inform", inform).await;
    let later = json!({"at_step": 2000, "args": {"pi3": 1.5}, "client": "olga"});
    client.ok("school", "set", later).await;
    // Their texts alone take more than 256 KiB.
    let long = "x".repeat(100);
    for _ in 0..EXCHANGES {
        client.ok("school", "step", json!({"client": long})).await;
    }
    for epoch in 1..=2 {
        let client = &daemon.1;
        let all = entries(client, "school", "", 1000).await;
        let count = EXCHANGES + 2;
        let seqs: Vec<u64> = all.iter().map(|it| it["seq"].as_u64().unwrap()).collect();
        assert_eq!(seqs, (1..=3002).collect::<Vec<u64>>());
        assert_eq!(
            (&all[0]["verb"], &all[0]["client"]),
            (&json!("inform"), &json!("olga"))
        );
        let set = all.iter().find(|it| it["verb"] == "set").unwrap();
        assert_eq!(
            (&set["step"], &set["args"]),
            (&json!(2000), &json!({"pi3": 1.5}))
        );
        let of_olga = entries(client, "school", ";client=olga", 256).await;
        assert_eq!(verbs(&of_olga), ["inform", "set"], "epoch {epoch}");
        let steps = entries(client, "school", ";verb=step;from_step=10;to_step=19", 3).await;
        assert_eq!(steps.len(), 10);
        assert!(
            steps
                .iter()
                .all(|it| (10..20).contains(&it["step"].as_u64().unwrap()))
        );
        // As a client of an earlier version pages.
        let page = client.get("school", "journal?after=1500;limit=5").await["result"].take();
        let seqs: Vec<_> = page["entries"]
            .as_array()
            .unwrap()
            .iter()
            .map(|it| &it["seq"])
            .collect();
        assert_eq!(seqs, [1501, 1502, 1503, 1504, 1505]);
        assert_eq!(
            (&page["oldest"], &page["newest"]),
            (&json!(1), &json!(count))
        );
        if epoch == 1 {
            daemon = killed(folder.path(), daemon).await;
            daemon.1.get("school", "wait?phase=paused").await;
        }
    }
    for (wrong, field) in [
        ("line=-1", "line"),
        ("from_step=x", "from_step"),
        ("verb=fly", "verb"),
        ("from_step=3;to_step=2", "to_step"),
        ("limit=1001", "limit"),
    ] {
        let key = keys::get(PREFIX, "school", &format!("journal?{wrong}"));
        let error = daemon.1.query(&key, None).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::InvalidArgument, "{wrong}");
        assert!(error.message.contains(field), "{wrong}: {error:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_copy_has_the_commands_that_were_scheduled_before_it() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("school", json!({"n": 4, "seed": 1})).await;
    let later = json!({"at_step": 20, "args": {"pi3": 1.5}, "client": "olga"});
    client.ok("school", "set", later).await;
    client
        .ok("school", "annotate", json!({"text": "before"}))
        .await;
    client.ok("school", "fork", json!({"name": "copy"})).await;
    client.ok("copy", "step", json!({"steps": 30})).await;
    let all = entries(client, "copy", "", 1).await;
    assert_eq!(verbs(&all), ["step", "set"]);
    assert_eq!(
        (&all[1]["step"], &all[1]["client"]),
        (&json!(20), &json!("olga"))
    );
    let page = client.get("copy", "journal?after=2").await["result"].take();
    assert_eq!(page["entries"].as_array().unwrap().len(), 1, "{page}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn notes_beyond_their_limits_are_rejected_and_evict_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let settings = || {
        let mut command = crate::support::daemon_process::daemon(folder.path());
        command.args(["--quota-mb", "1"]);
        command
    };
    let open = async || {
        let process =
            crate::support::daemon_process::DaemonProcess::start(&mut settings()).unwrap();
        let client = Client::open(&process.endpoint).await;
        (process, client)
    };
    let (mut process, client) = open().await;
    client.create("school", json!({"n": 4, "seed": 1})).await;
    let inform = json!({"client": "olga", "args": {"select": {"count": 1}, "direction": 1}});
    client.ok("school", "inform", inform).await;
    // At most an eighth of the quota, and at most fifty at once.
    let text = json!({"text": "𝄞".repeat(750)});
    let write = async |client: &Client, text: &Value, count: usize| {
        let mut messages = Vec::new();
        for _ in 0..count {
            if let Err(error) = client.cmd("school", "annotate", text.clone()).await {
                assert_eq!(error.code, ErrorCode::ResourceExhausted, "{error:?}");
                messages.push(error.message);
            }
        }
        messages
    };
    let rejected = write(&client, &text, 45).await;
    assert!(
        rejected.len() >= 4 && rejected.len() < 15,
        "{}",
        rejected.len()
    );
    assert!(
        rejected[0].contains("128 KiB, an eighth of quota_mb"),
        "{}",
        rejected[0]
    );
    let notes = entries(&client, "school", ";verb=annotate", 100)
        .await
        .len();
    assert_eq!(notes, 45 - rejected.len());
    // A kill forgets nothing of them.
    process.kill();
    let (mut process, client) = open().await;
    let rejected = write(&client, &text, 3).await;
    assert_eq!(rejected.len(), 3);
    // Short ones are limited by their number, in each swarm.
    client.create("shoal", json!({"n": 4})).await;
    let (began, mut accepted, mut rejected) = (Instant::now(), 0, Vec::new());
    until("a note is one too many", async || {
        let key = keys::cmd(PREFIX, "shoal", "annotate");
        let mut sent = Vec::new();
        for _ in 0..70 {
            let note = json!({"text": "short"}).to_string();
            sent.push(client.session.get(&key).payload(note).await.unwrap());
        }
        for replies in sent {
            match result_of(replies.recv_async().await.unwrap()) {
                Ok(_) => accepted += 1,
                Err(error) => {
                    assert_eq!(error.code, ErrorCode::ResourceExhausted, "{error:?}");
                    rejected.push(error.message);
                }
            }
        }
        !rejected.is_empty()
    })
    .await;
    // Fifty at once, and ten a second.
    let most = 50.0 + 10.0 * began.elapsed().as_secs_f64();
    assert!(
        accepted >= 50 && f64::from(accepted) <= most,
        "{accepted} of at most {most}"
    );
    assert!(rejected[0].contains("write it again in"), "{}", rejected[0]);
    until("a note is accepted again", async || {
        let note = json!({"text": "short"});
        client.cmd("shoal", "annotate", note).await.is_ok()
    })
    .await;
    let all = entries(&client, "school", "", 1000).await;
    assert_eq!(verbs(&all)[0], "inform");
    let status = client.get("school", "status").await["result"].take();
    assert_eq!(status["history_from"]["step"], 0, "{status}");
    client.ok("school", "step", json!({"steps": 50})).await;
    let verified = client.get("school", "verify").await["result"].take();
    assert_eq!(verified["differs_at"], Value::Null, "{verified}");
    client.get("school", "experiment").await;
    process.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_a_playback_have_all_commands_that_are_selected() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let file = recorded_file(client).await;
    upload_and_open(client, "tape", &file).await.unwrap();
    for k in 0..9 {
        let fraction = json!({"fraction": f64::from(k) / 10.0});
        client.ok("tape", "seek", fraction).await;
        client.ok("tape", "run", json!({"rate": 1.0})).await;
    }
    let all = entries(client, "tape", "", 1000).await;
    let seeks: Vec<_> = all.iter().filter(|it| it["verb"] == "seek").collect();
    assert_eq!((all.len(), seeks.len()), (18, 9), "{all:?}");
    let paged = entries(client, "tape", ";verb=seek", 2).await;
    assert_eq!(paged.iter().collect::<Vec<_>>(), seeks);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_recovery_took_back_is_neither_listed_nor_exported() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = start(folder.path()).await;
    let client = &daemon.1;
    // 300 steps take 3 s, and too little computing for a checkpoint.
    let spec = json!({"n": 4, "seed": 1, "rate": 2});
    client.create("a", spec).await;
    let later = |step: u64, pi3| json!({"at_step": step, "args": {"pi3": pi3}});
    client.ok("a", "set", later(5, 2.0)).await;
    client.ok("a", "set", later(300, 3.0)).await;
    client.ok("a", "run", json!({})).await;
    let applied = ["run", "set", "set"];
    until("both are stored", async || {
        verbs(&entries(client, "a", "", 10).await) == applied
    })
    .await;
    // The daemon goes on from `run`, the last command: both steps are executed again.
    let (_process, client) = killed(folder.path(), daemon).await;
    client.ok("a", "pause", json!({})).await;
    let step = client.get("a", "status").await["step"].as_u64().unwrap();
    assert!(step < 300, "paused too late");
    for limit in [1, 2, 10] {
        let all = entries(&client, "a", "", limit).await;
        let verbs = verbs(&all);
        let rest = verbs.strip_prefix(&["run"]).unwrap();
        let rest = rest.strip_prefix(&["set"]).unwrap_or(rest);
        assert_eq!(rest, ["pause"], "{all:?}");
        assert_eq!(verbs.len() == 3, step >= 5, "{all:?}");
    }
    let export = client.get("a", "experiment").await["result"].take();
    let file = export["file"].as_str().unwrap();
    assert!(!file.contains("pi3 = 3"), "{file}");
    client.ok("a", "run", json!({})).await;
    client.wait_for_step("a", 300).await;
    let all = entries(&client, "a", "", 2).await;
    let expected = match step >= 5 {
        true => ["run", "set", "pause", "run", "set"],
        false => ["run", "pause", "run", "set", "set"],
    };
    assert_eq!(verbs(&all), expected, "{all:?}");
    let export = client.get("a", "experiment").await["result"].take();
    let file = export["file"].as_str().unwrap();
    assert_eq!(file.matches("pi3 = 3").count(), 1, "{file}");
}
