//! Full disks, and a sync that fails.

use std::fs::{self, File};
use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use serde_json::json;

use crate::support::daemon_process::{self, DaemonProcess, StoreCopy};
use crate::support::process::jostled;
use crate::support::reference_model::{Answers, ReferenceModel};
use crate::support::small_disk::SmallDisk;
use crate::support::{Client, PREFIX, TIMEOUT, until};

#[tokio::test(flavor = "multi_thread")]
async fn after_a_failed_sync_the_daemon_exits_with_code_8_and_sends_no_reply() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = daemon_process::daemon(folder.path());
    command.env("FAILPOINTS", "store-fsync=20*off->return");
    let mut process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    client.create("a", json!({"n": 5})).await;
    let key = keys::cmd("jostle", "a", "set");
    for k in 0.. {
        let request = json!({"client": "me", "request_id": k.to_string(), "args": {"pi3": 1.1}});
        let answers = client
            .query_all(&key, Some(request.to_string().as_bytes()))
            .await;
        match answers.first() {
            Some(Ok(_)) => {}
            // Without a reply: the next daemon replies to a retry.
            None => break,
            Some(Err(error)) => panic!("{error:?}"),
        }
    }
    assert_eq!(process.end(), Some(8));
    let log = daemon_process::log(folder.path());
    assert!(log.contains("restart jostled"), "{log}");
}

/// Whether the daemon reports that its disk is full. Fails if it reports anything else.
async fn is_full(client: &Client) -> bool {
    let reasons = client.node("metrics").await["unwell"].take();
    let reasons: Vec<String> = serde_json::from_value(reasons).unwrap();
    let full = "the disk is full: free some space, and the journal goes on by itself";
    assert!(reasons.iter().all(|reason| reason == full), "{reasons:?}");
    !reasons.is_empty()
}

#[tokio::test(flavor = "multi_thread")]
async fn on_a_full_disk_swarms_step_on_and_commands_are_rejected_at_once() {
    let Some(disk) = SmallDisk::mount(8) else {
        return;
    };
    let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"]);
    command.arg("--data-dir").arg(disk.path());
    let mut process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    let (moving, still) = (
        json!({"n": 20, "seed": 1, "rate": 20}),
        json!({"n": 74, "seed": 2}),
    );
    client.create("moving", moving.clone()).await;
    client.create("still", still.clone()).await;
    let mut models = [
        ReferenceModel::new("moving", &moving),
        ReferenceModel::new("still", &still),
    ];
    let named =
        |id: &str, args: serde_json::Value| json!({"client": "me", "request_id": id, "args": args});
    client.ok("moving", "run", named("run", json!({}))).await;
    client
        .ok("still", "step", named("step", json!({"steps": 500})))
        .await;
    disk.fill();
    let inform = json!({"select": {"count": 2}, "direction": 1});
    let mut slowest = Duration::ZERO;
    let mut count = 0;
    // The reserve is used up first.
    until("the disk is full", async || {
        count += 1;
        let began = Instant::now();
        let answer = client
            .cmd(
                "still",
                "inform",
                named(&format!("fill-{count}"), inform.clone()),
            )
            .await;
        slowest = slowest.max(began.elapsed());
        answer.is_err_and(|error| error.code == ErrorCode::StorageFull)
    })
    .await;
    assert!(is_full(&client).await);
    // The store tries a full disk again once a second. Replies do not wait for that: these 40 would
    // take 40 s.
    let rejecting_since = Instant::now();
    for k in 0..20 {
        let began = Instant::now();
        for swarm in ["still", "moving"] {
            let request = named(&format!("full-{k}-{swarm}"), inform.clone());
            let (code, _) = client.err(swarm, "inform", request).await;
            assert_eq!(code, ErrorCode::StorageFull);
        }
        slowest = slowest.max(began.elapsed() / 2);
        let before = client.get("moving", "status").await["step"]
            .as_u64()
            .unwrap();
        let stepped = client
            .ok(
                "still",
                "step",
                named(&format!("lazy-{k}"), json!({"steps": 3})),
            )
            .await;
        assert!(stepped["result"]["durable_step"].as_u64() < stepped["step"].as_u64());
        client.wait_for_step("moving", before + 10).await;
    }
    assert!(
        rejecting_since.elapsed() < TIMEOUT,
        "{:?}",
        rejecting_since.elapsed()
    );
    // A `step` is executed before it is durable, but the number of those not yet durable is bounded.
    let mut ahead = 0;
    loop {
        let began = Instant::now();
        let request = named(&format!("ahead-{ahead}"), json!({"steps": 1}));
        let step = client.cmd("still", "step", request).await;
        slowest = slowest.max(began.elapsed());
        match step {
            Ok(_) => ahead += 1,
            Err(error) => {
                assert_eq!(error.code, ErrorCode::StorageFull);
                break;
            }
        }
        assert!(ahead < 2000, "{ahead}");
    }
    println!("{ahead} steps were taken ahead of a full disk");
    println!("the slowest reply took {slowest:?}");

    disk.make_room();
    let began = Instant::now();
    let mut count = 0;
    until("there is room", async || {
        count += 1;
        let request = named(&format!("room-{count}"), inform.clone());
        client.cmd("still", "inform", request).await.is_ok()
    })
    .await;
    println!("normal {:?} after there was room", began.elapsed());
    assert!(!is_full(&client).await);
    let last = client.get("still", "status").await;

    // Killed and started on the full disk, it recovers the same state.
    disk.fill();
    process.kill();
    let left = StoreCopy::of(disk.path());
    for (model, name) in models.iter_mut().zip(["moving", "still"]) {
        model.replay(left.rows(name, model.line), &Answers::new());
    }
    let started = DaemonProcess::start(&mut command);
    let mut process = started.unwrap_or_else(|code| panic!("ended with {code:?} on a full disk"));
    let client = Client::open(&process.endpoint).await;
    let status = client.get("still", "status").await;
    assert_eq!(status["result"]["state_hash"], last["result"]["state_hash"]);
    let (code, _) = client
        .err("still", "set", named("full-again", json!({"pi3": 1.0})))
        .await;
    assert_eq!(code, ErrorCode::StorageFull);
    assert!(is_full(&client).await);
    let before = client.get("moving", "status").await["step"]
        .as_u64()
        .unwrap();
    client.wait_for_step("moving", before + 10).await;
    disk.make_room();
    until("there is room", async || {
        let request = named("room", json!({"pi3": 1.0}));
        client.cmd("still", "set", request).await.is_ok()
    })
    .await;
    assert!(!is_full(&client).await);
    assert!(process.child.try_wait().unwrap().is_none());
    process.kill();
    let left = StoreCopy::of(disk.path());
    for (model, name) in models.iter_mut().zip(["moving", "still"]) {
        model.replay(left.rows(name, model.line), &Answers::new());
    }
    let process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    for (model, name) in models.iter_mut().zip(["moving", "still"]) {
        model.compare(&client.get(name, "status").await);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_on_a_full_disk_logs_that_the_store_is_incomplete_and_which_steps_are_lost() {
    let Some(disk) = SmallDisk::mount(8) else {
        return;
    };
    let logs = tempfile::tempdir().unwrap();
    let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"]);
    let log = File::create(logs.path().join("log")).unwrap();
    command.arg("--data-dir").arg(disk.path()).stderr(log);
    let mut process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    client.create("a", json!({"n": 20})).await;
    client.ok("a", "step", json!({"steps": 5})).await;
    client.ok("a", "set", json!({"noise": 1})).await;
    disk.fill();
    until("the disk is full", async || {
        let answer = client.cmd("a", "set", json!({"noise": 1})).await;
        answer.is_err_and(|error| error.code == ErrorCode::StorageFull)
    })
    .await;
    let step = client.ok("a", "step", json!({"steps": 7})).await;
    assert_eq!(step["result"]["durable_step"], 5);
    process.stop();
    assert_eq!(process.end(), Some(8));
    let log = daemon_process::log(logs.path());
    assert!(log.contains("the store is not completely written"), "{log}");
    assert!(log.contains("swarm=\"a\" step=12 durable_step=5"), "{log}");
    disk.make_room();
    let mut process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    assert_eq!(client.get("a", "status").await["step"], 5);
    process.stop();
    assert_eq!(process.end(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn on_a_full_disk_swarms_can_be_deleted_and_replays_are_rejected() {
    let Some(disk) = SmallDisk::mount(8) else {
        return;
    };
    let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"]);
    command.arg("--data-dir").arg(disk.path());
    let mut process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    let names = ["a", "b", "c", "d"];
    for name in names {
        client.create(name, json!({"n": 20, "rate": 5})).await;
        for number in 0..100 {
            let noise = json!({"noise": f64::from(number % 5)});
            client.ok(name, "set", noise).await;
        }
    }
    client.ok("b", "run", json!({})).await;
    until("room is kept", async || {
        disk.path().join("reserve").exists()
    })
    .await;
    disk.fill();
    until("the disk is full", async || {
        let answer = client.cmd("d", "set", json!({"noise": 1})).await;
        answer.is_err_and(|error| error.code == ErrorCode::StorageFull)
    })
    .await;
    // Commands that are not durable yet cannot be replayed: `verify` and `fork` are rejected.
    client.ok("d", "step", json!({"steps": 7})).await;
    let fork = json!({"name": "e", "step": 7});
    for answer in [
        client.query(&keys::get(PREFIX, "d", "verify"), None).await,
        client.cmd("d", "fork", fork).await,
    ] {
        let error = answer.unwrap_err();
        assert_eq!(error.code, ErrorCode::Conflict);
        assert!(error.message.contains("not on the disk yet"), "{error:?}");
    }
    for name in ["a", "b", "c"] {
        client.ok(name, "delete", json!({})).await;
    }
    process.kill();
    let mut process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    for name in ["a", "b", "c"] {
        let answers = client
            .query_all(&keys::get(PREFIX, name, "status"), None)
            .await;
        assert!(answers.is_empty(), "{name}: {answers:?}");
    }
    client.get("d", "status").await;
    disk.make_room();
    until("room is kept again", async || {
        let path = disk.path().join("reserve");
        fs::metadata(path).is_ok_and(|it| it.len() > 0)
    })
    .await;
    process.kill();
}
