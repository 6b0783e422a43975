//! Backups of a running daemon, and their restoration.

mod complete;
mod fixture;

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use jostle_proto::keys;
use jostle_results::recording::{About, Format, Recorder};
use serde_json::{Value, json};

use crate::support::daemon_process::{DaemonProcess, daemon, log};
use crate::support::small_disk::SmallDisk;
use crate::support::{Client, NODE, PREFIX, until};

use fixture::{
    EXPERIMENT, RUNNING, STANDING, arguments, begin, content, create_swarms, experiment, hash_at,
    journal, node, outcome, recording, restore, send_commands, send_commands_for, take,
    take_pausing, without_time,
};

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_under_load_is_restored_with_every_swarm_at_a_state_that_it_had() {
    let base = tempfile::tempdir().unwrap();
    let [data, folder, elsewhere] =
        ["data", "backup", "elsewhere"].map(|name| base.path().join(name));
    fs::create_dir(&data).unwrap();
    let points = "recording-part=return(200)";
    let (mut process, client) = begin(&data, points).await;
    create_swarms(&client).await;
    let begin_recording = json!({"begin": {"swarm": "slow", "recording": "film"}});
    node(&client, "record", begin_recording).await;
    node(
        &client,
        "experiment",
        json!({"submit": {"toml": EXPERIMENT}}),
    )
    .await;
    until("two parts, and a run", async || {
        let key = keys::experiment(PREFIX, NODE, "order", "progress");
        let progress = client.query(&key, None).await.unwrap();
        recording(&client).await["parts"].as_u64() >= Some(2)
            && progress["finished"].as_u64() >= Some(1)
    })
    .await;

    send_commands_for(&client, Duration::from_millis(300)).await;

    // The pause holds the snapshot of the database open.
    let is_ended = Arc::new(AtomicBool::new(false));
    let mut backup = take_pausing(&data, &folder, "backup-pages", 700);
    let commands = async {
        let waiting = async {
            while backup.try_wait().unwrap().is_none() {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
            is_ended.store(true, Ordering::Relaxed);
        };
        tokio::join!(waiting, send_commands(&client, &is_ended)).1
    };
    let (count, longest) = commands.await;
    let taken = outcome(&backup.wait_with_output().unwrap()).unwrap();
    println!("{taken}: {count} commands meanwhile, the longest {longest:?}");
    assert!(count >= 20, "{count} commands while the backup was taken");
    assert!(longest < Duration::from_secs(5), "{longest:?}");
    assert_eq!(taken["swarms"], 4);
    // The backup does not contain later commands.
    send_commands_for(&client, Duration::from_millis(300)).await;
    let data_id = async |client: &Client| {
        let key = keys::node_get(PREFIX, NODE, "hello");
        let hello = client.query(&key, None).await.unwrap();
        hello["result"]["data_id"].as_str().unwrap().to_owned()
    };
    let id = data_id(&client).await;
    process.kill();

    let restored = restore(&folder, &elsewhere).unwrap();
    assert_eq!(restored["swarms"], 4);
    assert_eq!(restored["files"], taken["files"]);
    let (mut old, client) = begin(&data, points).await;
    let (mut new, again) = begin(&elsewhere, points).await;
    // The backup lacks the replies to the later commands.
    assert_eq!(data_id(&client).await, id);
    assert_ne!(data_id(&again).await, id);
    // The audit log is there.
    let created = async |client: &Client| {
        let key = keys::node_get(PREFIX, NODE, "audit?verb=create");
        let page = client.query(&key, None).await.unwrap();
        page["result"]["lines"].clone()
    };
    let lines = created(&again).await;
    assert_eq!(lines.as_array().unwrap().len(), 4, "{lines}");
    assert_eq!(lines, created(&client).await);
    for swarm in RUNNING.into_iter().chain([STANDING]) {
        let [before, after] = [journal(&client, swarm).await, journal(&again, swarm).await];
        assert!(after.len() < before.len(), "{swarm}: {}", after.len());
        // The last command may have been applied again, at the time of its receipt.
        let last = after.len() - 1;
        assert_eq!(after[..last], before[..last], "{swarm}");
        assert_eq!(without_time(&after[last]), without_time(&before[last]));
        if swarm == "fastest" {
            // Otherwise the replays below compete with it for the processor, and `verify` follows it.
            for client in [&client, &again] {
                client.ok(swarm, "pause", json!({})).await;
            }
        }
        // Later commands may have been applied at the step of the last one.
        let step = after.last().unwrap()["step"].as_u64().unwrap() - 1;
        let hash = hash_at(&again, swarm, step).await;
        assert_eq!(
            hash,
            hash_at(&client, swarm, step).await,
            "{swarm} at {step}"
        );
        let verified = again.get(swarm, "verify").await["result"].take();
        assert_eq!(verified["differs_at"], Value::Null, "{swarm}: {verified}");
        assert!(verified["to_step"].as_u64() >= Some(step), "{verified}");
    }
    // The recording continues, and all its parts can be read.
    let parts = recording(&again).await["parts"].as_u64();
    until("a new part", async || {
        let now = recording(&again).await;
        assert_eq!(now["phase"], "recording", "{now}");
        now["parts"].as_u64() > parts
    })
    .await;
    let stop = json!({"stop": {"recording": "film"}});
    let stopped = node(&again, "record", stop).await["result"].take();
    let film = elsewhere.join("recordings/film");
    let recorder = Recorder::resume(&film, Format::Mcap, About::new()).unwrap();
    assert_eq!(stopped["parts"], recorder.written().parts, "{stopped}");
    // The experiment continues after the finished runs, with the same results.
    let results = |folder: &Path| fs::read(folder.join("experiments/order/results.csv")).unwrap();
    experiment(&client, "finished").await;
    experiment(&again, "finished").await;
    assert_eq!(results(&data), results(&elsewhere));
    for process in [&mut old, &mut new] {
        process.stop();
        assert_eq!(process.end(), Some(0));
    }
    // A backup of a stopped daemon contains the same swarms.
    let second = base.path().join("second");
    assert_eq!(take(&elsewhere, &second).unwrap()["swarms"], 4);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_that_is_killed_is_rejected_and_the_daemon_goes_on() {
    let base = tempfile::tempdir().unwrap();
    let [data, elsewhere] = ["data", "elsewhere"].map(|name| base.path().join(name));
    fs::create_dir(&data).unwrap();
    let (mut process, client) = begin(&data, "").await;
    create_swarms(&client).await;
    node(
        &client,
        "record",
        json!({"begin": {"swarm": "slow", "recording": "film"}}),
    )
    .await;
    for point in ["backup-file", "backup-pages", "backup-manifest"] {
        let folder = base.path().join(point);
        let mut backup = take_pausing(&data, &folder, point, 60_000);
        let begun = match point {
            "backup-file" => folder.clone(),
            _ => folder.join("jostle.sqlite"),
        };
        until("the backup has begun", async || begun.exists()).await;
        tokio::time::sleep(Duration::from_millis(300)).await;
        backup.kill().unwrap();
        backup.wait().unwrap();
        let error = restore(&folder, &elsewhere).unwrap_err();
        assert!(
            error.contains("is not a finished backup"),
            "{point}: {error}"
        );
        assert!(!elsewhere.exists(), "{point}");
        client.ok(STANDING, "step", json!({"steps": 1})).await;
        if folder.join("jostle.sqlite").exists() {
            let error = take(&data, &folder).unwrap_err();
            assert!(error.contains("name a new folder"), "{point}: {error}");
        }
    }
    process.stop();
    assert_eq!(process.end(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_stops_while_a_backup_reads_has_written_all_of_it() {
    let base = tempfile::tempdir().unwrap();
    let [data, folder, elsewhere] =
        ["data", "backup", "elsewhere"].map(|name| base.path().join(name));
    fs::create_dir(&data).unwrap();
    let (mut process, client) = begin(&data, "").await;
    client.create("a", json!({"n": 5, "seed": 1})).await;
    let backup = take_pausing(&data, &folder, "backup-pages", 2000);
    let copy = folder.join("jostle.sqlite");
    until("the copy has begun", async || copy.exists()).await;
    client.ok("a", "step", json!({"steps": 7})).await;
    process.stop();
    assert_eq!(process.end(), Some(0), "{}", log(&data));
    outcome(&backup.wait_with_output().unwrap()).unwrap();
    let (_old, client) = begin(&data, "").await;
    assert_eq!(client.get("a", "status").await["step"], 7);
    restore(&folder, &elsewhere).unwrap();
    let (_new, client) = begin(&elsewhere, "").await;
    let step = client.get("a", "status").await["step"].as_u64();
    assert!(step <= Some(7), "{step:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_on_a_full_disk_leaves_nothing_and_the_daemon_continues() {
    let Some(disk) = SmallDisk::mount(8) else {
        return;
    };
    let data = tempfile::tempdir().unwrap();
    let (mut process, client) = begin(data.path(), "").await;
    create_swarms(&client).await;
    // Full before it begins.
    disk.fill();
    let folder = disk.path().join("backup");
    let error = take(data.path(), &folder).unwrap_err();
    assert!(error.contains("free some space"), "{error}");
    assert!(!folder.exists());
    disk.make_room();
    // Full in the middle of it.
    let backup = take_pausing(data.path(), &folder, "backup-pages", 1000);
    let copy = folder.join("jostle.sqlite");
    until("the copy has begun", async || copy.exists()).await;
    disk.fill();
    let error = outcome(&backup.wait_with_output().unwrap()).unwrap_err();
    assert!(error.contains("full"), "{error}");
    assert!(!folder.exists(), "{error}");
    client.ok(STANDING, "step", json!({"steps": 1})).await;
    process.stop();
    assert_eq!(process.end(), Some(0));
    assert!(!log(data.path()).contains("full"));
}

#[tokio::test(flavor = "multi_thread")]
async fn one_of_two_concurrent_backups_into_a_folder_is_rejected_and_the_other_is_complete() {
    let base = tempfile::tempdir().unwrap();
    let data = base.path().join("data");
    fs::create_dir(&data).unwrap();
    let (mut process, client) = begin(&data, "").await;
    create_swarms(&client).await;
    let folder = base.path().join("backup");
    let first = take_pausing(&data, &folder, "backup-manifest", 1000);
    // Before that, the second could claim the folder, and the first would be rejected.
    let copy = folder.join("jostle.sqlite");
    until("the first has begun", async || copy.exists()).await;
    let error = take(&data, &folder).unwrap_err();
    assert!(error.contains("name a new folder"), "{error}");
    outcome(&first.wait_with_output().unwrap()).unwrap();
    // Both at the same moment.
    for round in 0..5 {
        let folder = base.path().join(format!("backup-{round}"));
        let both = [(); 2].map(|()| arguments("backup", &folder, &data).spawn().unwrap());
        let ended = both.map(|it| outcome(&it.wait_with_output().unwrap()));
        let taken = ended.iter().filter(|it| it.is_ok()).count();
        assert_eq!(taken, 1, "{ended:?}");
        restore(&folder, &base.path().join(format!("new-{round}"))).unwrap();
    }
    process.stop();
    assert_eq!(process.end(), Some(0));
    restore(&folder, &base.path().join("new")).unwrap();
    let (_process, client) = begin(&base.path().join("new"), "").await;
    client.ok(STANDING, "step", json!({"steps": 1})).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_would_be_overwritten_or_is_damaged_is_rejected_with_the_remedy() {
    let base = tempfile::tempdir().unwrap();
    let path = |name: &str| base.path().join(name);
    let [data, folder, empty] = ["data", "backup", "empty"].map(path);
    fs::create_dir(&data).unwrap();
    fs::create_dir(&empty).unwrap();
    let (mut process, client) = begin(&data, "recording-part=return(200)").await;
    create_swarms(&client).await;
    node(
        &client,
        "record",
        json!({"begin": {"swarm": "slow", "recording": "film"}}),
    )
    .await;
    until("a part", async || {
        recording(&client).await["parts"].as_u64() >= Some(1)
    })
    .await;
    let has = |error: Result<Value, String>, what: &str| {
        let error = error.unwrap_err();
        assert!(error.contains(what), "{what}: {error}");
    };
    fs::write(path("file"), "").unwrap();
    has(take(&empty, &path("x")), "--data-dir");
    has(take(&path("nowhere"), &path("x")), "--data-dir");
    has(take(&data, &data), "is the data folder");
    has(
        take(&data, &data.join("experiments/backup")),
        "the data folder or inside it",
    );
    assert!(!data.join("experiments/backup").exists());
    has(
        take(&data, &data.join("deep/er/backup")),
        "the data folder or inside it",
    );
    assert!(!data.join("deep").exists());
    has(take(&data, &base.path().join("file")), "use ");
    take(&data, &folder).unwrap();
    let whole = content(&folder);
    has(take(&data, &folder), "name a new folder");
    assert_eq!(content(&folder), whole);
    let names = whole
        .keys()
        .map(|path| path.strip_prefix(&folder).unwrap().to_str().unwrap());
    let names: Vec<&str> = names.collect();
    assert!(
        names.contains(&"recordings/film/recording.json"),
        "{names:?}"
    );
    let foreign = |name: &&str| {
        ["token", "lock", "partial", "-wal", "-shm"]
            .iter()
            .any(|it| name.contains(it))
    };
    assert_eq!(names.iter().find(|name| foreign(name)), None, "{names:?}");

    for path in whole.keys().flat_map(|file| file.ancestors()) {
        let mode = fs::metadata(path).unwrap().permissions().mode();
        let is_private = mode & 0o077 == 0 || !path.starts_with(&folder);
        assert!(is_private, "{}: {mode:o}", path.display());
    }

    // A folder in use or that is not empty is rejected.
    has(restore(&folder, &data), "another jostled uses this folder");
    process.stop();
    assert_eq!(process.end(), Some(0));
    has(restore(&folder, &data), "is not empty");
    let foreign = path("foreign");
    fs::create_dir(&foreign).unwrap();
    fs::write(foreign.join("notes"), "").unwrap();
    has(restore(&folder, &foreign), "is not empty");
    assert_eq!(fs::read_dir(&foreign).unwrap().count(), 1);
    has(restore(&empty, &path("new")), "not a finished backup");
    has(restore(&path("nowhere"), &path("new")), "use ");
    has(restore(&folder, &data.join("lock")), "use ");
    has(restore(&folder, &folder.join("data")), "inside the backup");
    assert_eq!(content(&folder), whole);

    // Damages each file in three ways: shorter, with another byte, missing.
    for (file, bytes) in &whole {
        let name = file.strip_prefix(&folder).unwrap();
        let mut other = bytes.clone();
        other[bytes.len() / 2] ^= 1;
        for damage in [Some(&bytes[..bytes.len() - 1]), Some(&other), None] {
            match damage {
                Some(bytes) => fs::write(file, bytes).unwrap(),
                None => fs::remove_file(file).unwrap(),
            }
            let error = restore(&folder, &path("new")).unwrap_err();
            let is_named = error.contains(&name.display().to_string());
            assert!(is_named && error.contains("restore another"), "{error}");
            if path("new").exists() {
                let left: Vec<_> = fs::read_dir(path("new")).unwrap().collect();
                assert_eq!(left.len(), 1, "its lock: {left:?}");
            }
        }
        fs::write(file, bytes).unwrap();
    }

    // After a kill neither a daemon nor another restoration accepts the folder.
    let mut command = arguments("restore", &folder, &path("cut"));
    let mut cut = command
        .env("FAILPOINTS", "restore-rename=sleep(60000)")
        .spawn()
        .unwrap();
    let draft = path("cut").join(".restoring/jostle.sqlite");
    until("the files are there", async || draft.exists()).await;
    has(
        restore(&folder, &path("cut")),
        "another jostled uses this folder",
    );
    cut.kill().unwrap();
    cut.wait().unwrap();
    has(restore(&folder, &path("cut")), "restore again");
    assert_eq!(
        DaemonProcess::start(&mut daemon(&path("cut"))).err(),
        Some(Some(2))
    );
    assert!(log(&path("cut")).contains("restore again"));

    restore(&folder, &empty).unwrap();
    let (_process, client) = begin(&empty, "").await;
    client.ok(STANDING, "step", json!({"steps": 1})).await;
}
