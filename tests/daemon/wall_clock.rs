//! Wall-clock times in the journal, in events and after a restart.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use jostle_proto::{Event, JournalEntry, keys};
use serde_json::{Value, json};

use crate::support::daemon_process::{DaemonProcess, daemon};
use crate::support::process::Process;
use crate::support::{Client, PREFIX};

fn now() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    since.as_secs_f64()
}

async fn journal(client: &Client) -> Vec<JournalEntry> {
    let entries = client.get("a", "journal").await["result"]["entries"].take();
    serde_json::from_value(entries).unwrap()
}

async fn events(client: &Client) -> Vec<Event> {
    let events = client.get("a", "events").await["result"]["events"].take();
    serde_json::from_value(events).unwrap()
}

/// The time of an entry that has one.
fn of(entry: &JournalEntry) -> (u64, f64) {
    let unix_secs = entry.unix_secs;
    (
        entry.seq,
        unix_secs.unwrap_or_else(|| panic!("{entry:?} has no time")),
    )
}

#[tokio::test(flavor = "multi_thread")]
async fn commands_and_events_have_the_time_at_which_they_were_applied() {
    let (_daemon, endpoint) = Process::serve();
    let client = Client::open(&endpoint).await;
    let before = now();
    client.create("a", json!({"n": 6, "seed": 2})).await;
    let published = client.session.declare_subscriber(keys::event(PREFIX, "a"));
    let published = published.await.unwrap();
    let select = json!({"ids": [1]});
    client
        .ok("a", "inform", json!({"select": select, "direction": 1}))
        .await;
    // Applied at step 3 by the `step`, which comes a second after the request.
    let later = json!({"at_step": 3, "args": {"select": select}});
    client.ok("a", "uninform", later).await;
    let scheduled = now();
    tokio::time::sleep(Duration::from_secs(1)).await;
    client.ok("a", "step", json!({"steps": 5})).await;
    let after = now();

    let entries = journal(&client).await;
    let verbs: Vec<&str> = entries.iter().map(|it| it.verb.as_str()).collect();
    assert_eq!(verbs, ["inform", "step", "uninform"]);
    let times: Vec<f64> = entries.iter().map(|entry| of(entry).1).collect();
    for time in &times {
        // To the millisecond.
        assert!((before - 0.001..=after).contains(time), "{time}");
        assert_eq!(*time, (time * 1e3).round() / 1e3);
    }
    assert!(
        times[0] <= scheduled && scheduled + 0.9 < times[2],
        "{times:?}"
    );
    // The events of queries and subscriptions have the same times.
    let events = events(&client).await;
    for entry in &entries {
        let event = events
            .iter()
            .find(|event| serde_json::to_value(&event.event).unwrap()["seq"] == entry.seq);
        assert_eq!(event.unwrap().unix_secs, entry.unix_secs);
    }
    let kinds = |kind: &str| {
        let of_kind = |event: &&Event| serde_json::to_value(&event.event).unwrap()["kind"] == kind;
        events.iter().filter(of_kind).collect::<Vec<_>>()
    };
    for event in [kinds("created"), kinds("scheduled")].concat() {
        let time = event.unix_secs.unwrap();
        assert!((before - 0.001..=scheduled).contains(&time), "{event:?}");
    }
    let mut from_stream = Vec::new();
    while let Ok(Some(sample)) = published.recv_timeout(Duration::from_millis(300)) {
        from_stream.push(serde_json::from_slice::<Event>(&sample.payload().to_bytes()).unwrap());
    }
    assert!(from_stream.len() >= 4, "{from_stream:?}");
    assert_eq!(from_stream, events[events.len() - from_stream.len()..]);
}

#[tokio::test(flavor = "multi_thread")]
async fn times_survive_stops_and_kills_and_change_no_hash() {
    let folder = tempfile::tempdir().unwrap();
    let mut times: Vec<(u64, f64)> = Vec::new();
    let mut hash = String::new();
    for round in 0..4 {
        let mut daemon = DaemonProcess::start(&mut daemon(folder.path())).unwrap();
        let client = Client::open(&daemon.endpoint).await;
        if round == 0 {
            client.create("a", json!({"n": 6, "seed": 2})).await;
        } else {
            let again: Vec<(u64, f64)> = journal(&client).await.iter().map(of).collect();
            assert_eq!(again, times, "round {round}");
            assert_eq!(client.hash("a").await, hash);
            let verified = client.get("a", "verify").await["result"].take();
            assert_eq!(verified["differs_at"], Value::Null);
        }
        // Replayed events have the time of their command or none; what was applied in this round is
        // no older.
        for event in events(&client).await {
            assert!(event.unix_secs.is_none_or(|it| it <= now()), "{event:?}");
        }
        let step = client.get("a", "status").await["step"].as_u64().unwrap();
        for (verb, request) in [
            ("set", json!({"pi3": 1.5})),
            ("set", json!({"at_step": step + 4, "args": {"pi3": 2.5}})),
            ("step", json!({"steps": 8})),
            ("inject", json!({"count": 1})),
        ] {
            client.ok("a", verb, request).await;
        }
        hash = client.hash("a").await;
        times = journal(&client).await.iter().map(of).collect();
        // `step` becomes durable within milliseconds.
        tokio::time::sleep(Duration::from_millis(500)).await;
        client.session.close().await.unwrap();
        if round % 2 == 0 {
            daemon.kill();
        } else {
            daemon.stop();
            assert_eq!(daemon.end(), Some(0));
        }
    }
    assert_eq!(times.len(), 16);
    assert!(times.is_sorted_by(|a, b| a.1 <= b.1), "{times:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_that_a_crash_took_back_has_the_time_at_which_it_was_applied_again() {
    let folder = tempfile::tempdir().unwrap();
    // `run` is applied, and the kill comes when `set` has been, before that is on the disk.
    let mut failing = daemon(folder.path());
    let points = "swarm-applied=1*off->return;store-begin=sleep(500)";
    failing.env("FAILPOINTS", points);
    let mut first = DaemonProcess::start(&mut failing).unwrap();
    let client = Client::open(&first.endpoint).await;
    client.create("a", json!({"n": 4})).await;
    let set = json!({"at_step": 2, "args": {"pi3": 2}});
    client.ok("a", "set", set).await;
    // The kill may come before the reply.
    let run = json!({"args": {"until_step": 2, "rate": null}}).to_string();
    let key = keys::cmd(PREFIX, "a", "run");
    let _ = client.query_all(&key, Some(run.as_bytes())).await;
    assert_eq!(first.end(), None, "it was killed");
    let restarted = now();
    let second = DaemonProcess::start(&mut daemon(folder.path())).unwrap();
    let client = Client::open(&second.endpoint).await;
    client.wait_for_step("a", 2).await;
    let entries = journal(&client).await;
    let verbs: Vec<&str> = entries.iter().map(|it| it.verb.as_str()).collect();
    assert_eq!(verbs, ["run", "set"]);
    let [run, set] = [0, 1].map(|index| of(&entries[index]).1);
    assert!(run < restarted && restarted - 0.001 <= set, "{entries:?}");
}
