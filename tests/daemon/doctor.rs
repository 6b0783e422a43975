//! `jostled doctor`: what it says before an upgrade (docs/upgrade.md) is what then happens, and it changes
//! nothing.

mod asked;
mod results;

use std::fs;
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use jostle_physics::model::MODEL_VERSION;
use jostled::store::{Settings, Store, Write};
use rusqlite::Connection;
use serde_json::{Value, json};
use tempfile::TempDir;

use self::asked::{Said, ask, ask_unchanged, assert_happens, files, last_line, swarms};
use crate::models::{EARLIER, aged, killed};
use crate::stored;
use crate::support::daemon_process::{DaemonProcess, daemon};
use crate::support::process::jostled;
use crate::support::programs::ROOT;
use crate::support::{Client, TIMEOUT, until};

/// A folder of the earlier version: one swarm has commands after its checkpoint, one has none.
async fn earlier_folder() -> TempDir {
    let folder = killed(async |client: &Client| {
        client.create("school", json!({"n": 12, "seed": 3})).await;
        client.ok("school", "step", json!({"steps": 20})).await;
        let inform = json!({"select": {"ids": [1, 3]}, "direction": 1.0});
        client.ok("school", "inform", inform).await;
        client.ok("school", "step", json!({"steps": 20})).await;
        client.ok("school", "set", json!({"pi3": 2.0})).await;
        client.create("lake", json!({"n": 5, "seed": 4})).await;
    })
    .await;
    aged(folder.path(), |record| record)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_it_says_of_swarms_of_an_earlier_version_is_what_then_happens() {
    let folder = earlier_folder().await;
    let said = ask_unchanged(folder.path(), &[]);
    assert_eq!((said.code, said.errors.as_str()), (0, ""));
    assert_eq!(said.report["model_version"], MODEL_VERSION);
    let foretold = swarms(&said);
    let names: Vec<&str> = foretold.keys().map(String::as_str).collect();
    assert_eq!(names, ["lake", "school"]);
    assert_eq!(
        said.report["marked"],
        json!({"swarms": 2, "experiments": 0, "folders": 0})
    );
    for (name, later) in [("lake", 0), ("school", 4)] {
        let swarm = &foretold[name];
        assert_eq!(swarm["later_commands"], later, "{swarm}");
        assert_eq!(swarm["model_version"], EARLIER, "{swarm}");
        assert_eq!(swarm["marked"], true, "{swarm}");
    }
    let line = said
        .text
        .lines()
        .find(|it| it.starts_with("school"))
        .unwrap();
    let expected = "goes on from step 0, marked; 4 later commands are executed again";
    assert!(line.ends_with(expected), "{line}");
    assert!(
        last_line(&said.text).starts_with("2 of 2 swarms will be marked"),
        "{}",
        said.text
    );

    let mut process = DaemonProcess::start(&mut daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    until("the school is where it was", async || {
        client.get("school", "status").await["step"] == 40
    })
    .await;
    let mut steps = Vec::new();
    for (name, swarm) in &foretold {
        let status = client.get(name, "status").await;
        let mark = json!([{
            "model_version": swarm["model_version"],
            "epoch": swarm["epoch"],
            "step": swarm["step"],
        }]);
        assert_eq!(status["result"]["earlier_models"], mark, "{status}");
        // Commands after its checkpoint may have changed the phase of the school.
        let phase = (name == "lake").then(|| status["phase"].clone());
        assert_eq!(swarm.get("phase"), phase.as_ref(), "{status}");
        steps.push((name.clone(), status["step"].clone()));
    }
    process.stop();
    assert_eq!(process.end(), Some(0));
    // They are marked, and will not be marked again.
    let said = ask_unchanged(folder.path(), &[]);
    assert_eq!(said.code, 0, "{}", said.errors);
    for (name, step) in steps {
        let swarm = &swarms(&said)[&name];
        assert_eq!(swarm["marked"], false, "{swarm}");
        assert_eq!(swarm["message"], "goes on", "{swarm}");
        // A daemon that is stopped in order stores a checkpoint of each swarm.
        assert_eq!(swarm["later_commands"], 0, "{swarm}");
        assert_eq!(swarm["phase"], "paused", "{swarm}");
        assert_eq!(
            (&swarm["model_version"], &swarm["step"]),
            (&json!(MODEL_VERSION), &step)
        );
        assert_eq!(
            swarm["earlier_models"][0]["model_version"], EARLIER,
            "{swarm}"
        );
    }
    assert!(
        last_line(&said.text).starts_with("nothing will be marked"),
        "{}",
        said.text
    );
}

/// A folder in which a store has just created a swarm `later`, which is in its WAL alone.
fn with_wal(folder: &Path) -> Store {
    let store = Store::open(folder, Settings::default(), Box::new(|_| {})).unwrap();
    let (_, about) = store.swarms().unwrap().pop().unwrap();
    let number = store.checkpoints("school").unwrap()[0].number;
    let create = Write::Create {
        swarm: "later".to_owned(),
        about,
        first: store.checkpoint("school", number).unwrap(),
    };
    store.commit(vec![create]).unwrap();
    // Maintenance of the store.
    let (began, mut before) = (Instant::now(), files(folder));
    loop {
        sleep(Duration::from_millis(300));
        let now = files(folder);
        if now == before {
            return store;
        }
        assert!(began.elapsed() < TIMEOUT, "the store goes on writing");
        before = now;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_that_an_earlier_daemon_uses_or_left_behind_is_read_with_its_wal_and_stays_the_same()
 {
    let folder = earlier_folder().await;
    let store = with_wal(folder.path());
    let assert_read = |said: &Said| {
        assert_eq!((said.code, said.errors.as_str()), (0, ""), "{}", said.text);
        let names: Vec<String> = swarms(said).into_keys().collect();
        assert_eq!(names, ["lake", "later", "school"]);
        assert_eq!(said.report["marked"]["swarms"], 3);
    };
    // In use, also its index of the WAL stays the same.
    assert_read(&ask_unchanged(folder.path(), &[]));
    let delete = Write::Delete {
        swarm: "lake".to_owned(),
    };
    // As a crash and a copy without the index leave it.
    let left = tempfile::tempdir().unwrap();
    for (without, name) in [("", "crashed"), ("jostle.sqlite-shm", "copied")] {
        let copy = left.path().join(name);
        fs::create_dir(&copy).unwrap();
        for (path, bytes) in files(folder.path()) {
            let name = path.file_name().unwrap();
            if path.is_file() && name != without {
                fs::write(copy.join(name), bytes).unwrap();
            }
        }
        assert_eq!(copy.join("jostle.sqlite-shm").exists(), without.is_empty());
        assert_read(&ask_unchanged(&copy, &[]));
    }
    // The store goes on, and what it writes is read.
    store.commit(vec![delete]).unwrap();
    assert_eq!(ask(folder.path(), &[]).report["marked"]["swarms"], 2);
    assert!(store.stop(TIMEOUT));
    // The last connection has deleted the WAL.
    assert!(!folder.path().join("jostle.sqlite-wal").exists());
    let said = ask_unchanged(folder.path(), &[]);
    assert_eq!(said.report["marked"]["swarms"], 2, "{}", said.errors);

    let backup = left.path().join("backup");
    let mut take = jostled(&["backup", "--data-dir"]);
    let taken = take.arg(folder.path()).arg(&backup).output().unwrap();
    assert!(taken.status.success());
    let said = ask_unchanged(&backup, &[]);
    assert_eq!(
        said.report["swarms"],
        ask(folder.path(), &[]).report["swarms"]
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_goes_on_while_it_is_asked() {
    let folder = tempfile::tempdir().unwrap();
    let mut process = DaemonProcess::start(&mut daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    client.create("school", json!({"n": 12, "seed": 3})).await;
    client.ok("school", "run", json!({"rate": null})).await;
    for pi3 in 1..10 {
        client.ok("school", "set", json!({"pi3": pi3})).await;
        let before = client.get("school", "status").await["step"].clone();
        let said = ask(folder.path(), &[]);
        assert_eq!((said.code, said.errors.as_str()), (0, ""));
        let swarm = &swarms(&said)["school"];
        assert_eq!(swarm["message"], "goes on", "{swarm}");
        let now = client.get("school", "status").await["step"].clone();
        assert!(swarm["step"].as_u64() <= now.as_u64(), "{swarm}");
        until("the school goes on", async || {
            client.get("school", "status").await["step"].as_u64() > before.as_u64()
        })
        .await;
    }
    let verified = client.get("school", "verify").await;
    assert_eq!(verified["result"]["differs_at"], Value::Null, "{verified}");
    process.stop();
    assert_eq!(process.end(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn folders_of_all_builds_are_read_and_their_swarms_go_on_as_it_says() {
    let stored = Path::new(ROOT).join("tests/stored");
    let mut count = 0;
    for build in fs::read_dir(stored).unwrap() {
        let build = build.unwrap().path();
        if !build.join("data").is_dir() {
            continue;
        }
        count += 1;
        let data = stored::copy(&build, "data");
        let said = ask_unchanged(data.path(), &[]);
        assert_eq!(
            (said.code, said.errors.as_str()),
            (0, ""),
            "{}",
            build.display()
        );
        let foretold = swarms(&said);
        if let Ok(expected) = fs::read(build.join("expected.json")) {
            let expected: Value = serde_json::from_slice(&expected).unwrap();
            let names = expected["swarms"].as_object().unwrap().keys();
            assert!(names.eq(foretold.keys()), "{foretold:?}");
        }
        assert!(!foretold.is_empty());
        assert_happens(data.path(), &said).await;
        // As if the earlier version of the model had stored it.
        let aged = aged(data.path(), |record| record);
        let said = ask_unchanged(aged.path(), &[]);
        assert_eq!(
            said.report["marked"]["swarms"],
            foretold.len(),
            "{}",
            said.text
        );
        assert_happens(aged.path(), &said).await;
    }
    assert!(count >= 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_of_a_newer_version_is_rejected_with_the_version_that_wrote_it() {
    let folder = killed(async |client: &Client| {
        client.create("school", json!({"n": 5, "seed": 3})).await;
    })
    .await;
    let newer = "UPDATE program SET version = '9.9.9', model = 99";
    for (change, expected) in [
        (newer, ["version 9.9.9", "model version 99"]),
        ("PRAGMA user_version = 98", ["version 9.9.9", "schema 98"]),
    ] {
        let connection = Connection::open(folder.path().join("jostle.sqlite")).unwrap();
        connection.execute_batch(change).unwrap();
        connection.close().unwrap();
        let said = ask_unchanged(folder.path(), &[]);
        assert_eq!(said.code, 1, "{}", said.text);
        for text in expected {
            assert!(said.errors.contains(text), "{}", said.errors);
        }
        assert_eq!(said.report["problems"].as_array().unwrap().len(), 1);
        let last = "nothing that can be read will be marked (jostled ";
        assert!(last_line(&said.text).starts_with(last), "{}", said.text);
        assert_eq!(
            DaemonProcess::start(&mut daemon(folder.path())).err(),
            Some(Some(2))
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_data_folder_or_damaged_is_named() {
    let base = tempfile::tempdir().unwrap();
    let path = |name: &str| base.path().join(name);
    let good = earlier_folder().await;
    fs::create_dir(path("empty")).unwrap();
    fs::write(path("file"), "text").unwrap();
    let database = fs::read(good.path().join("jostle.sqlite")).unwrap();
    let with_database = |name: &str, bytes: &[u8]| {
        fs::create_dir(path(name)).unwrap();
        fs::write(path(name).join("jostle.sqlite"), bytes).unwrap();
    };
    with_database(
        "text",
        "not a database, but a text of some length"
            .repeat(99)
            .as_bytes(),
    );
    with_database("nothing", b"");
    with_database("half", &database[..database.len() / 2]);
    let mut holes = database.clone();
    holes[4096..12288].fill(0x5a);
    with_database("holes", &holes);
    with_database("restoring", &database);
    fs::create_dir(path("restoring/.restoring")).unwrap();
    fs::create_dir_all(path("rest/experiments/order")).unwrap();
    for (name, expected) in [
        ("absent", "no database of jostled"),
        ("empty", "no database of jostled"),
        ("file", "Not a directory"),
        ("nothing", "no database of jostled"),
        ("text", "not written by jostled"),
        ("half", "corrupt"),
        ("holes", "corrupt"),
        ("restoring", "was interrupted"),
        ("rest", "recordings or experiments but no database"),
    ] {
        let said = ask_unchanged(&path(name), &[]);
        assert_eq!(said.code, 1, "{name}: {}", said.text);
        assert!(said.errors.contains(expected), "{name}: {}", said.errors);
        assert!(
            said.errors.contains(path(name).to_str().unwrap()),
            "{}",
            said.errors
        );
        assert_eq!(said.report["swarms"], json!([]), "{name}");
    }
    assert!(!path("absent").exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_checkpoint_and_a_damaged_journal_are_said() {
    let folder = earlier_folder().await;
    let connection = Connection::open(folder.path().join("jostle.sqlite")).unwrap();
    let id = |name: &str| -> i64 {
        let select = "SELECT id FROM swarm WHERE name = ?";
        connection
            .query_row(select, [name], |row| row.get(0))
            .unwrap()
    };
    let (lake, school) = (id("lake"), id("school"));
    let body = "UPDATE checkpoint SET body = x'00' WHERE swarm = ?";
    assert!(connection.execute(body, [lake]).unwrap() > 0);
    let row = "UPDATE row SET body = x'00' WHERE swarm = ? AND number = 3";
    assert_eq!(connection.execute(row, [school]).unwrap(), 1);
    connection.close().unwrap();
    let said = ask_unchanged(folder.path(), &[]);
    assert_eq!(said.code, 1, "{}", said.text);
    let foretold = swarms(&said);
    let message = foretold["lake"]["message"].as_str().unwrap();
    assert!(
        message.starts_with("not recovered, and stays in the store"),
        "{message}"
    );
    assert_eq!(foretold["lake"]["marked"], false);
    assert_eq!(foretold["school"]["marked"], true);
    let damage = foretold["school"]["damage"].to_string();
    assert!(
        damage.contains("line 3 of its journal is damaged"),
        "{damage}"
    );
    for name in ["lake", "school"] {
        assert!(
            said.errors.contains(&format!("swarm {name:?}: ")),
            "{}",
            said.errors
        );
    }
    let mut process = DaemonProcess::start(&mut daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    until("the school has faulted", async || {
        client.get("school", "status").await["phase"] == "faulted"
    })
    .await;
    let listed = client.node("swarms").await["swarms"].clone();
    assert_eq!(listed.as_array().unwrap().len(), 1, "{listed}");
    process.kill();
}
