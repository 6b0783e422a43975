//! Backups: taken while the daemon is at work, and restored elsewhere.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use jostle_proto::keys;
use jostle_results::recording::{About, Format, Recorder};
use serde_json::{Value, json};

use crate::apart::jostled;
use crate::crash::disk::Small;
use crate::crash::life::{Life, daemon, log};
use crate::support::{Client, NODE, PATIENCE, PREFIX, beside_others, until};

/// Runs that end within some seconds on an idle machine.
const EXPERIMENT: &str = "name = \"order\"\nseed = 3\nreplicates = 3\nduration = 100\n[[grid]]\n\
    pi1 = [1, 4]\nn = [10, 20]\ninformed = [0, 1]\n[measure]\norder_every = 10\n";

/// Swarms that step by themselves, each at its own rate, and one that stands still.
const RUNNING: [&str; 3] = ["slow", "fast", "fastest"];
const STANDING: &str = "standing";

fn arguments(verb: &str, folder: &Path, data: &Path) -> Command {
    let mut command = jostled(&[verb, "--json"]);
    command.arg(folder).arg("--data-dir").arg(data);
    command.stderr(Stdio::piped()).stdout(Stdio::piped());
    command
}

fn outcome(output: &Output) -> Result<Value, String> {
    let text = String::from_utf8(output.stderr.clone()).unwrap();
    match output.status.code() {
        Some(0) => Ok(serde_json::from_slice(&output.stdout).unwrap()),
        Some(1) => Err(text),
        code => panic!("{code:?}: {text}"),
    }
}

fn take(data: &Path, folder: &Path) -> Result<Value, String> {
    outcome(&arguments("backup", folder, data).output().unwrap())
}

fn restore(folder: &Path, data: &Path) -> Result<Value, String> {
    outcome(&arguments("restore", folder, data).output().unwrap())
}

/// Starts a backup that pauses at a point of the code for so many milliseconds each time.
fn take_pausing(data: &Path, folder: &Path, point: &str, millis: u32) -> Child {
    let mut command = arguments("backup", folder, data);
    command.env("FAILPOINTS", format!("{point}=sleep({millis})"));
    command.spawn().unwrap()
}

async fn begin(data: &Path, points: &str) -> (Life, Client) {
    let life = Life::begin(daemon(data).env("FAILPOINTS", points)).unwrap();
    let client = Client::open(&life.endpoint).await;
    (life, client)
}

async fn node(client: &Client, verb: &str, request: Value) -> Value {
    let key = keys::node_cmd(PREFIX, NODE, verb);
    let answer = client.one(&key, Some(request.to_string().as_bytes())).await;
    answer.unwrap_or_else(|error| panic!("{verb} {request}: {error:?}"))
}

async fn create_swarms(client: &Client) {
    for (k, name) in RUNNING.into_iter().enumerate() {
        let rates = [json!(1), json!(5), json!(null)];
        let spec = json!({"n": 12, "seed": k, "rate": rates[k], "publish_every": 1});
        client.create(name, spec).await;
        client.ok(name, "run", json!({})).await;
    }
    client.create(STANDING, json!({"n": 8, "seed": 9})).await;
}

/// Sends commands to all swarms for a while.
async fn send_commands_for(client: &Client, time: Duration) {
    let is_ended = AtomicBool::new(false);
    let ending = async {
        tokio::time::sleep(time).await;
        is_ended.store(true, Ordering::Relaxed);
    };
    tokio::join!(ending, send_commands(client, &is_ended));
}

/// Sends commands to all swarms until `is_ended`; returns how many were answered, and the longest
/// time that one took.
async fn send_commands(client: &Client, is_ended: &AtomicBool) -> (u64, Duration) {
    let (mut count, mut longest) = (0, Duration::ZERO);
    while !is_ended.load(Ordering::Relaxed) {
        for swarm in RUNNING.into_iter().chain([STANDING]) {
            let start = Instant::now();
            let pi2 = 0.5 + (count % 7) as f64 / 100.0;
            client.ok(swarm, "set", json!({"args": {"pi2": pi2}})).await;
            longest = longest.max(start.elapsed());
            count += 1;
        }
        client.ok(STANDING, "step", json!({"steps": 3})).await;
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    (count, longest)
}

async fn journal(client: &Client, swarm: &str) -> Vec<Value> {
    let mut all: Vec<Value> = Vec::new();
    loop {
        let after = all.last().map_or(json!(0), |entry| entry["seq"].clone());
        let page = client
            .get(swarm, &format!("journal?after={after};limit=500"))
            .await;
        let page = page["result"]["entries"].as_array().unwrap().clone();
        match page.is_empty() {
            true => return all,
            false => all.extend(page),
        }
    }
}

/// The hash of a swarm at a step of its past.
async fn hash_at(client: &Client, swarm: &str, step: u64) -> Value {
    let name = format!("{swarm}-at-{step}");
    client
        .ok(swarm, "fork", json!({"name": name, "step": step}))
        .await;
    let status = client.get(&name, "status").await;
    client.ok(&name, "delete", json!({})).await;
    assert_eq!(status["step"], step, "{status}");
    status["result"]["state_hash"].clone()
}

async fn experiment(client: &Client, phase: &str) -> Value {
    let key = keys::experiment(PREFIX, NODE, "order", "progress");
    let deadline = Instant::now() + 6 * PATIENCE;
    loop {
        let progress = client.one(&key, None).await.unwrap();
        if progress["phase"] == phase {
            return progress;
        }
        assert!(Instant::now() < deadline, "{progress} is not {phase}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

async fn recording(client: &Client) -> Value {
    let mut list = client.node("recordings").await;
    list["recordings"][0].take()
}

/// Every file below a folder with its content.
fn content(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => found.extend(content(&path)),
            false => _ = found.insert(path.clone(), fs::read(path).unwrap()),
        }
    }
    found
}

/// An entry of the journal without the wall-clock time.
fn without_time(entry: &Value) -> Value {
    let mut entry = entry.clone();
    entry.as_object_mut().unwrap().remove("unix_secs");
    entry
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_under_load_is_restored_with_every_swarm_at_a_state_that_it_had() {
    let _machine = beside_others().await;
    let base = tempfile::tempdir().unwrap();
    let [data, folder, elsewhere] =
        ["data", "backup", "elsewhere"].map(|name| base.path().join(name));
    fs::create_dir(&data).unwrap();
    let points = "recording-part=return(200)";
    let (mut life, client) = begin(&data, points).await;
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
        let progress = client.one(&key, None).await.unwrap();
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
    // What comes later is not in it.
    send_commands_for(&client, Duration::from_millis(300)).await;
    life.kill();

    let restored = restore(&folder, &elsewhere).unwrap();
    assert_eq!(restored["swarms"], 4);
    assert_eq!(restored["files"], taken["files"]);
    let (mut old, client) = begin(&data, points).await;
    let (mut new, again) = begin(&elsewhere, points).await;
    for swarm in RUNNING.into_iter().chain([STANDING]) {
        let [before, after] = [journal(&client, swarm).await, journal(&again, swarm).await];
        assert!(after.len() < before.len(), "{swarm}: {}", after.len());
        // The last command may have been applied again: at the time at which it was received.
        let last = after.len() - 1;
        assert_eq!(after[..last], before[..last], "{swarm}");
        assert_eq!(without_time(&after[last]), without_time(&before[last]));
        // At the step of the last command there may have been another one since.
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
    // The recording goes on, and all its parts can be read.
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
    let recorder = Recorder::go_on(&film, Format::Mcap, About::new()).unwrap();
    assert_eq!(stopped["parts"], recorder.written().parts, "{stopped}");
    // The experiment goes on from the runs that were finished, to the same results.
    let results = |folder: &Path| fs::read(folder.join("experiments/order/results.csv")).unwrap();
    experiment(&client, "finished").await;
    experiment(&again, "finished").await;
    assert_eq!(results(&data), results(&elsewhere));
    for life in [&mut old, &mut new] {
        life.stop();
        assert_eq!(life.end(), Some(0));
    }
    // And a backup of what does not run holds the same swarms.
    let second = base.path().join("second");
    assert_eq!(take(&elsewhere, &second).unwrap()["swarms"], 4);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_that_is_killed_is_refused_and_the_daemon_goes_on() {
    let _machine = beside_others().await;
    let base = tempfile::tempdir().unwrap();
    let [data, elsewhere] = ["data", "elsewhere"].map(|name| base.path().join(name));
    fs::create_dir(&data).unwrap();
    let (mut life, client) = begin(&data, "").await;
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
        let refused = restore(&folder, &elsewhere).unwrap_err();
        assert!(
            refused.contains("is not a finished backup"),
            "{point}: {refused}"
        );
        assert!(!elsewhere.exists(), "{point}");
        client.ok(STANDING, "step", json!({"steps": 1})).await;
        if folder.join("jostle.sqlite").exists() {
            let refused = take(&data, &folder).unwrap_err();
            assert!(refused.contains("name a new folder"), "{point}: {refused}");
        }
    }
    life.stop();
    assert_eq!(life.end(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_stops_while_a_backup_reads_has_written_all_of_it() {
    let _machine = beside_others().await;
    let base = tempfile::tempdir().unwrap();
    let [data, folder, elsewhere] =
        ["data", "backup", "elsewhere"].map(|name| base.path().join(name));
    fs::create_dir(&data).unwrap();
    let (mut life, client) = begin(&data, "").await;
    client.create("a", json!({"n": 5, "seed": 1})).await;
    let backup = take_pausing(&data, &folder, "backup-pages", 2000);
    let copy = folder.join("jostle.sqlite");
    until("the copy has begun", async || copy.exists()).await;
    client.ok("a", "step", json!({"steps": 7})).await;
    life.stop();
    assert_eq!(life.end(), Some(0), "{}", log(&data));
    outcome(&backup.wait_with_output().unwrap()).unwrap();
    let (_old, client) = begin(&data, "").await;
    assert_eq!(client.get("a", "status").await["step"], 7);
    restore(&folder, &elsewhere).unwrap();
    let (_new, client) = begin(&elsewhere, "").await;
    let step = client.get("a", "status").await["step"].as_u64();
    assert!(step <= Some(7), "{step:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_that_a_disk_has_no_room_for_leaves_nothing_and_the_daemon_goes_on() {
    let _machine = beside_others().await;
    let Some(disk) = Small::mount(8) else {
        return;
    };
    let data = tempfile::tempdir().unwrap();
    let (mut life, client) = begin(data.path(), "").await;
    create_swarms(&client).await;
    // Full before it begins.
    disk.fill();
    let folder = disk.path().join("backup");
    let refused = take(data.path(), &folder).unwrap_err();
    assert!(refused.contains("free some space"), "{refused}");
    assert!(!folder.exists());
    disk.make_room();
    // Full in the middle of it.
    let backup = take_pausing(data.path(), &folder, "backup-pages", 1000);
    let copy = folder.join("jostle.sqlite");
    until("the copy has begun", async || copy.exists()).await;
    disk.fill();
    let refused = outcome(&backup.wait_with_output().unwrap()).unwrap_err();
    assert!(refused.contains("full"), "{refused}");
    assert!(!folder.exists(), "{refused}");
    client.ok(STANDING, "step", json!({"steps": 1})).await;
    life.stop();
    assert_eq!(life.end(), Some(0));
    assert!(!log(data.path()).contains("full"));
}

#[tokio::test(flavor = "multi_thread")]
async fn one_of_two_concurrent_backups_into_a_folder_is_rejected_and_the_other_is_complete() {
    let _machine = beside_others().await;
    let base = tempfile::tempdir().unwrap();
    let data = base.path().join("data");
    fs::create_dir(&data).unwrap();
    let (mut life, client) = begin(&data, "").await;
    create_swarms(&client).await;
    let folder = base.path().join("backup");
    let first = take_pausing(&data, &folder, "backup-manifest", 1000);
    until("the first has begun", async || folder.exists()).await;
    let refused = take(&data, &folder).unwrap_err();
    assert!(refused.contains("name a new folder"), "{refused}");
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
    life.stop();
    assert_eq!(life.end(), Some(0));
    restore(&folder, &base.path().join("new")).unwrap();
    let (_life, client) = begin(&base.path().join("new"), "").await;
    client.ok(STANDING, "step", json!({"steps": 1})).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_would_be_overwritten_or_is_damaged_is_refused_with_the_remedy() {
    let _machine = beside_others().await;
    let base = tempfile::tempdir().unwrap();
    let path = |name: &str| base.path().join(name);
    let [data, folder, empty] = ["data", "backup", "empty"].map(path);
    fs::create_dir(&data).unwrap();
    fs::create_dir(&empty).unwrap();
    let (mut life, client) = begin(&data, "recording-part=return(200)").await;
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
    let has = |refused: Result<Value, String>, what: &str| {
        let refused = refused.unwrap_err();
        assert!(refused.contains(what), "{what}: {refused}");
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

    // Neither a folder in use nor one that holds anything.
    has(restore(&folder, &data), "another jostled uses this folder");
    life.stop();
    assert_eq!(life.end(), Some(0));
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

    // Whatever is damaged: each file once shorter, once with another byte, once gone.
    for (file, bytes) in &whole {
        let name = file.strip_prefix(&folder).unwrap();
        let mut other = bytes.clone();
        other[bytes.len() / 2] ^= 1;
        for damage in [Some(&bytes[..bytes.len() - 1]), Some(&other), None] {
            match damage {
                Some(bytes) => fs::write(file, bytes).unwrap(),
                None => fs::remove_file(file).unwrap(),
            }
            let refused = restore(&folder, &path("new")).unwrap_err();
            let is_named = refused.contains(&name.display().to_string());
            assert!(is_named && refused.contains("restore another"), "{refused}");
            if path("new").exists() {
                let left: Vec<_> = fs::read_dir(path("new")).unwrap().collect();
                assert_eq!(left.len(), 1, "its lock: {left:?}");
            }
        }
        fs::write(file, bytes).unwrap();
    }

    // Killed in the middle, neither a daemon nor another restoration takes the folder for whole.
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
    assert_eq!(Life::begin(&mut daemon(&path("cut"))).err(), Some(Some(2)));
    assert!(log(&path("cut")).contains("restore again"));

    restore(&folder, &empty).unwrap();
    let (_life, client) = begin(&empty, "").await;
    client.ok(STANDING, "step", json!({"steps": 1})).await;
}
