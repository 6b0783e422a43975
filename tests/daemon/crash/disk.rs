//! Disks that are full, and disks that fail.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use jostle_proto::{ErrorCode, keys};
use serde_json::json;

use crate::apart::jostled;
use crate::crash::life::{self, Left, Life};
use crate::crash::twin::{Answers, Twin};
use crate::crash::{Tally, World};
use crate::harness;
use crate::support::{Client, PATIENCE, PREFIX, alone, beside_others, until};

/// libfiu's libraries, of the Debian package fiu-utils.
const FIU: &str = "/usr/lib/fiu";

/// One in fifty writes, or syncs, of files fails with EIO; sockets are left alone.
const FAULTS: [&str; 3] = [
    "enable_random name=posix/io/rw/pwrite*,probability=0.02,failinfo=5",
    "enable_random name=posix/io/sync/fsync,probability=0.02,failinfo=5",
    "enable_random name=posix/io/rw/pwrite*,probability=0.02,failinfo=5\n\
     enable_random name=posix/io/sync/fsync,probability=0.02,failinfo=5",
];

/// Has the disk fail under a daemon.
pub fn fail(command: &mut Command, faults: &str) {
    let preload = format!("{FIU}/fiu_run_preload.so {FIU}/fiu_posix_preload.so");
    command.env("LD_PRELOAD", preload).env("FIU_ENABLE", faults);
}

#[tokio::test(flavor = "multi_thread")]
async fn writes_and_syncs_that_fail_are_never_taken_for_done() {
    let _alone = alone().await;
    if !Path::new(FIU).exists() {
        harness::LIBFIU.is_missing();
        return;
    }
    let lives = if std::env::var_os("JOSTLE_LONG").is_some() {
        60
    } else {
        5
    };
    let mut total = Tally::default();
    for (seed, faults) in (1000..).zip(FAULTS) {
        let mut world = World::begin(seed).await;
        world.faults = Some(faults.to_owned());
        for _ in 0..lives {
            world.live_and_die().await;
        }
        world.faults = None;
        world.live_on().await;
        println!("{faults}: {:#?}", world.tally);
        total.add(&world.tally);
    }
    println!("{total:#?}");
    assert!(total.ended > 0, "no sync failed");
    assert!(total.refused_as_full > 0, "no write failed");
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_failed_sync_it_ends_with_code_8_and_answers_nobody() {
    let _machine = beside_others().await;
    let folder = tempfile::tempdir().unwrap();
    let mut command = life::daemon(folder.path());
    command.env("FAILPOINTS", "store-fsync=4*off->return");
    let mut life = Life::begin(&mut command).unwrap();
    let client = Client::open(&life.endpoint).await;
    client.create("a", json!({"n": 5})).await;
    let key = keys::cmd("jostle", "a", "set");
    for k in 0.. {
        let request = json!({"client": "me", "request_id": k.to_string(), "args": {"pi3": 1.1}});
        let answers = client.ask(&key, Some(request.to_string().as_bytes())).await;
        match answers.first() {
            Some(Ok(_)) => {}
            // Neither done nor refused: the next daemon knows.
            None => break,
            Some(Err(error)) => panic!("{error:?}"),
        }
    }
    assert_eq!(life.end(), Some(8));
    let log = life::log(folder.path());
    assert!(log.contains("restart jostled"), "{log}");
}

/// A disk of its own, as small as this.
pub struct Small(
    PathBuf,
    #[expect(dead_code, reason = "held for its end")] tempfile::TempDir,
);

impl Small {
    /// A disk of this size. Where the machine permits no mount, the test fails or may be skipped.
    #[track_caller]
    pub fn mount(megabytes: u64) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let size = format!("size={megabytes}m");
        let path = folder.path().to_owned();
        let mount = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &size, "none"])
            .arg(&path)
            .output();
        if mount.is_ok_and(|mount| mount.status.success()) {
            return Some(Small(path, folder));
        }
        harness::MOUNT.is_missing();
        None
    }

    pub fn path(&self) -> &Path {
        &self.0
    }

    pub fn fill(&self) {
        File::create(self.0.join("ballast")).unwrap();
        self.fill_more();
    }

    /// Takes what others gave back, and keeps what it has.
    pub fn fill_more(&self) {
        let mut options = File::options();
        let ballast = options.append(true).create(true);
        let mut file = ballast.open(self.0.join("ballast")).unwrap();
        for size in [65536, 4096, 1] {
            while file.write_all(&vec![0; size]).is_ok() {}
        }
    }

    pub fn make_room(&self) {
        fs::remove_file(self.0.join("ballast")).unwrap();
    }
}

impl Drop for Small {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

/// Whether the daemon says that its disk is full, and nothing else that is wrong.
async fn is_full(client: &Client) -> bool {
    let reasons = client.node("metrics").await["unwell"].take();
    let reasons: Vec<String> = serde_json::from_value(reasons).unwrap();
    let full = "the disk is full: free some space, and the journal goes on by itself";
    assert!(reasons.iter().all(|reason| reason == full), "{reasons:?}");
    !reasons.is_empty()
}

#[tokio::test(flavor = "multi_thread")]
async fn on_a_full_disk_swarms_step_on_and_commands_hear_of_it_at_once() {
    let _alone = alone().await;
    let Some(disk) = Small::mount(8) else {
        return;
    };
    let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"]);
    command.arg("--data-dir").arg(&disk.0);
    let mut life = Life::begin(&mut command).unwrap();
    let client = Client::open(&life.endpoint).await;
    let (moving, still) = (
        json!({"n": 20, "seed": 1, "rate": 20}),
        json!({"n": 74, "seed": 2}),
    );
    client.create("moving", moving.clone()).await;
    client.create("still", still.clone()).await;
    let mut twins = [Twin::new("moving", &moving), Twin::new("still", &still)];
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
    // What was set aside is used up first.
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
    let refusing = Instant::now();
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
        client.reach("moving", before + 10).await;
    }
    assert!(refusing.elapsed() < PATIENCE, "{:?}", refusing.elapsed());
    // A `step` need not be safe before it is carried out, but what is held for later is bounded.
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

    // Killed on a full disk, and started on it, it is what it was.
    disk.fill();
    life.kill();
    let left = Left::on(&disk.0);
    for (twin, name) in twins.iter_mut().zip(["moving", "still"]) {
        twin.tell(left.rows(name, twin.line), &Answers::new());
    }
    let begun = Life::begin(&mut command);
    let mut life = begun.unwrap_or_else(|code| panic!("ended with {code:?} on a full disk"));
    let client = Client::open(&life.endpoint).await;
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
    client.reach("moving", before + 10).await;
    disk.make_room();
    until("there is room", async || {
        let request = named("room", json!({"pi3": 1.0}));
        client.cmd("still", "set", request).await.is_ok()
    })
    .await;
    assert!(!is_full(&client).await);
    assert!(life.child.try_wait().unwrap().is_none());
    life.kill();
    let left = Left::on(&disk.0);
    for (twin, name) in twins.iter_mut().zip(["moving", "still"]) {
        twin.tell(left.rows(name, twin.line), &Answers::new());
    }
    let life = Life::begin(&mut command).unwrap();
    let client = Client::open(&life.endpoint).await;
    for (twin, name) in twins.iter_mut().zip(["moving", "still"]) {
        twin.compare(&client.get(name, "status").await);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_orderly_end_on_a_full_disk_says_that_not_all_is_written() {
    let _alone = alone().await;
    let Some(disk) = Small::mount(8) else {
        return;
    };
    let logs = tempfile::tempdir().unwrap();
    let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"]);
    let log = File::create(logs.path().join("log")).unwrap();
    command.arg("--data-dir").arg(disk.path()).stderr(log);
    let mut life = Life::begin(&mut command).unwrap();
    let client = Client::open(&life.endpoint).await;
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
    life.stop();
    assert_eq!(life.end(), Some(8));
    let log = life::log(logs.path());
    assert!(log.contains("the store is not completely written"), "{log}");
    disk.make_room();
    let mut life = Life::begin(&mut command).unwrap();
    let client = Client::open(&life.endpoint).await;
    assert_eq!(client.get("a", "status").await["step"], 5);
    life.stop();
    assert_eq!(life.end(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn on_a_full_disk_swarms_can_be_deleted_and_what_cannot_be_told_yet_is_said() {
    let _alone = alone().await;
    let Some(disk) = Small::mount(8) else {
        return;
    };
    let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"]);
    command.arg("--data-dir").arg(&disk.0);
    let mut life = Life::begin(&mut command).unwrap();
    let client = Client::open(&life.endpoint).await;
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
    // What is not on the disk yet cannot be told again, and nothing else is made of that.
    client.ok("d", "step", json!({"steps": 7})).await;
    let fork = json!({"name": "e", "step": 7});
    for told in [
        client.one(&keys::get(PREFIX, "d", "verify"), None).await,
        client.cmd("d", "fork", fork).await,
    ] {
        let error = told.unwrap_err();
        assert_eq!(error.code, ErrorCode::Conflict);
        assert!(error.message.contains("not on the disk yet"), "{error:?}");
    }
    for name in ["a", "b", "c"] {
        client.ok(name, "delete", json!({})).await;
    }
    life.kill();
    let mut life = Life::begin(&mut command).unwrap();
    let client = Client::open(&life.endpoint).await;
    for name in ["a", "b", "c"] {
        let answers = client.ask(&keys::get(PREFIX, name, "status"), None).await;
        assert!(answers.is_empty(), "{name}: {answers:?}");
    }
    client.get("d", "status").await;
    disk.make_room();
    until("room is kept again", async || {
        let path = disk.path().join("reserve");
        fs::metadata(path).is_ok_and(|it| it.len() > 0)
    })
    .await;
    life.kill();
}
