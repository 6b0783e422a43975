//! Experiments that need more disk space than there is.

use std::fs;
use std::path::{Path, PathBuf};

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use crate::experiments::{error_of, ok, progress, submit, wait_for_phase};
use crate::support::daemon_process::{DaemonProcess, daemon};
use crate::support::small_disk::SmallDisk;
use crate::support::{Client, NODE, PREFIX, until};

/// Three runs that record 29 MB each, of which none stops earlier.
const FILMS: &str = "name = 'films'\nreplicates = 3\nduration = 200\n[measure]\nrecord_every = \
                     1\n[spec]\nn = 100\n[stop]\nwhen = 'order > 2'\n";

/// Runs that record 15 MB each, without a condition: what they need is known.
fn films(name: &str, replicates: usize) -> String {
    format!(
        "name = '{name}'\nreplicates = {replicates}\nduration = 100\n[measure]\nrecord_every = \
         1\n[spec]\nn = 100\n"
    )
}

async fn start(folder: &Path, arguments: &[&str]) -> (DaemonProcess, Client) {
    let mut command = daemon(folder);
    command.args(arguments);
    let process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    (process, client)
}

fn folder(data: &Path, name: &str) -> PathBuf {
    data.join("experiments").join(name)
}

/// The files in a folder of an experiment that have one of these endings, in order.
fn files(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let paths = entries.map(|entry| entry.unwrap().path());
    let mut found: Vec<_> = paths
        .filter(|path| path.to_string_lossy().ends_with(ending))
        .collect();
    found.sort();
    found
}

/// The bytes of its results: the tables and each trajectory.
fn results(folder: &Path) -> Vec<Vec<u8>> {
    let mut paths = files(folder, ".parquet");
    paths.extend(files(folder, ".csv"));
    paths.extend(files(&folder.join("trajectories"), ".parquet"));
    paths.iter().map(|path| fs::read(path).unwrap()).collect()
}

/// The results of an experiment on a large disk.
async fn undisturbed(toml: &str, name: &str) -> Vec<Vec<u8>> {
    let data = tempfile::tempdir().unwrap();
    let (_process, client) = start(data.path(), &[]).await;
    submit(&client, toml).await;
    wait_for_phase(&client, name, "finished").await;
    let results = results(&folder(data.path(), name));
    assert_eq!(results.len(), 5, "two tables and three trajectories");
    results
}

fn message(progress: &Value) -> &str {
    progress["message"].as_str().unwrap_or_default()
}

/// Each run that has frames has a checkpoint from which it continues.
fn assert_frames_have_checkpoints(folder: &Path) {
    for path in files(&folder.join("trajectories"), ".partial") {
        let stem = path.file_stem().unwrap().to_str().unwrap();
        let number: usize = stem.trim_start_matches("run-").parse().unwrap();
        let checkpoint = folder.join(format!("checkpoints/{:06}.cbor", number - 1));
        assert!(checkpoint.exists(), "{} is of no use", path.display());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_experiment_stops_before_the_disk_is_full_and_continues_to_the_same_bytes() {
    let Some(disk) = SmallDisk::mount(100) else {
        return;
    };
    let (mut process, client) = start(disk.path(), &[]).await;
    client.create("school", json!({"n": 5})).await;
    let submitted = submit(&client, FILMS).await;
    assert!(
        message(&submitted["progress"]).contains("it may need less"),
        "{submitted}"
    );
    submit(&client, "name = 'next'\nduration = 1\n[spec]\nn = 3\n").await;
    let paused = wait_for_phase(&client, "films", "paused").await;
    // What the next run needs is named where that is what is lacking.
    let text = message(&paused);
    assert!(
        text.contains("64 stay free for the swarms") && text.contains(": free disk space"),
        "{paused}"
    );
    assert!(paused["finished"].as_u64() < Some(3), "{paused}");
    assert_frames_have_checkpoints(&folder(disk.path(), "films"));
    // The next one is not begun, and swarms are created and step.
    let next = wait_for_phase(&client, "next", "paused").await;
    assert!(message(&next).contains("free disk space"), "{next}");
    client.ok("school", "step", json!({"steps": 1000})).await;
    client.create("shoal", json!({"n": 5})).await;
    let warnings = client.node("metrics").await["warnings"].take();
    let warning = warnings[0].as_str().unwrap();
    assert!(
        warning.starts_with("experiments are paused: films ("),
        "{warnings}"
    );

    // A restart changes neither the phase nor the reason.
    process.stop();
    assert_eq!(process.end(), Some(0));
    let (_process, client) = start(disk.path(), &[]).await;
    let again = progress(&client, "films").await;
    assert_eq!(
        (&again["phase"], &again["message"]),
        (&paused["phase"], &paused["message"])
    );
    disk.resize(400);
    let resumed = ok(&client, json!({"resume": {"name": "films"}})).await;
    assert_eq!(resumed["progress"]["message"], Value::Null, "{resumed}");
    let finished = wait_for_phase(&client, "films", "finished").await;
    assert_eq!(finished["finished"], 3, "{finished}");
    let found = results(&folder(disk.path(), "films"));
    assert!(found == undisturbed(FILMS, "films").await, "other bytes");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_experiment_on_a_disk_that_others_fill_is_paused_and_continues_to_the_same_bytes() {
    let Some(disk) = SmallDisk::mount(300) else {
        return;
    };
    let (_process, client) = start(disk.path(), &[]).await;
    submit(&client, FILMS).await;
    let trajectories = folder(disk.path(), "films").join("trajectories");
    until("frames are recorded", async || {
        !files(&trajectories, ".partial").is_empty()
    })
    .await;
    disk.fill();
    let paused = wait_for_phase(&client, "films", "paused").await;
    assert!(message(&paused).contains("free disk space"), "{paused}");
    assert_frames_have_checkpoints(&folder(disk.path(), "films"));
    disk.make_room();
    ok(&client, json!({"resume": {"name": "films"}})).await;
    wait_for_phase(&client, "films", "finished").await;
    let found = results(&folder(disk.path(), "films"));
    assert!(found == undisturbed(FILMS, "films").await, "other bytes");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_experiment_that_needs_more_than_there_is_is_refused() {
    let Some(disk) = SmallDisk::mount(100) else {
        return;
    };
    let (_process, client) = start(disk.path(), &[]).await;
    let args = json!({"submit": {"toml": films("large", 3)}});
    let (code, message) = error_of(&client, args).await;
    assert_eq!(code, ErrorCode::StorageFull, "{message}");
    assert!(
        message.contains("MiB are free: free disk space"),
        "{message}"
    );
    assert!(!folder(disk.path(), "large").exists());
    disk.resize(200);
    submit(&client, &films("large", 3)).await;
    wait_for_phase(&client, "large", "finished").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_quota_counts_all_experiments_and_refuses_or_pauses_one() {
    let data = tempfile::tempdir().unwrap();
    // Two runs at once that write their trajectories at once may find no room where one would.
    let quota = ["--experiments-quota-mb", "60", "--experiment-threads", "1"];
    let (mut process, client) = start(data.path(), &quota).await;
    let refused = async |name: &str, replicates| {
        let args = json!({"submit": {"toml": films(name, replicates)}});
        let (code, message) = error_of(&client, args).await;
        assert_eq!(code, ErrorCode::ResourceExhausted, "{message}");
        message
    };
    let message_of_large = refused("large", 4).await;
    assert!(
        message_of_large
            .contains("of 60 MiB are left (experiments_quota_mb): delete one that is over"),
        "{message_of_large}"
    );
    submit(&client, &films("first", 1)).await;
    ok(&client, json!({"pause": {"name": "first"}})).await;
    let beside = refused("second", 2).await;
    assert!(beside.contains("that unfinished ones need"), "{beside}");
    ok(&client, json!({"resume": {"name": "first"}})).await;
    wait_for_phase(&client, "first", "finished").await;

    // What is stored is counted, also after a restart, and a deletion makes room.
    let bytes = async |client: &Client| client.node("metrics").await["experiments_bytes"].as_u64();
    let stored = bytes_in(&data.path().join("experiments"));
    until("the size is known", async || {
        bytes(&client).await == Some(stored)
    })
    .await;
    process.stop();
    assert_eq!(process.end(), Some(0));
    let (_process, client) = start(data.path(), &quota).await;
    until("the size is known", async || {
        bytes(&client).await == Some(stored)
    })
    .await;
    let short = FILMS.replace("duration = 200", "duration = 100");
    submit(&client, &short).await;
    let paused = wait_for_phase(&client, "films", "paused").await;
    assert!(
        message(&paused).contains("of 60 MiB (experiments_quota_mb)"),
        "{paused}"
    );
    assert!(bytes(&client).await <= Some(60 << 20));
    ok(&client, json!({"delete": {"name": "first"}})).await;
    ok(&client, json!({"resume": {"name": "films"}})).await;
    until("a run is finished", async || {
        progress(&client, "films").await["finished"].as_u64() > paused["finished"].as_u64()
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_without_a_checkpoint_are_removed_and_others_are_kept() {
    let data = tempfile::tempdir().unwrap();
    let (mut process, client) = start(data.path(), &["--experiment-threads", "1"]).await;
    let long = "name = 'films'\nduration = 1e4\n[measure]\nrecord_every = 1\n[spec]\nn = 100\n[stop]\nwhen \
                = 'order > 2'\n";
    submit(&client, long).await;
    let trajectories = folder(data.path(), "films").join("trajectories");
    let spools = || files(&trajectories, ".partial").len();
    until("frames are recorded", async || spools() == 1).await;
    // The runs of a paused experiment wait in memory.
    ok(&client, json!({"pause": {"name": "films"}})).await;
    process.kill();
    assert_eq!(spools(), 1, "a kill removes nothing");
    let (_process, client) = start(data.path(), &["--experiment-threads", "1"]).await;
    assert_eq!(progress(&client, "films").await["phase"], "paused");
    assert_eq!(spools(), 0, "frames without a checkpoint are left");
    ok(&client, json!({"resume": {"name": "films"}})).await;
    until("frames are recorded", async || spools() == 1).await;
    ok(&client, json!({"cancel": {"name": "films"}})).await;
    assert_eq!(spools(), 1, "its run has a checkpoint");
    assert_frames_have_checkpoints(&folder(data.path(), "films"));
}

/// The bytes of all files below a folder.
fn bytes_in(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).unwrap().map(Result::unwrap);
    let sizes = entries.map(|entry| match entry.metadata().unwrap() {
        it if it.is_dir() => bytes_in(&entry.path()),
        it => it.len(),
    });
    sizes.sum()
}

/// A run that takes 4 MB of memory, and another long one.
fn large(name: &str, n: usize, replicates: usize, duration: f64) -> String {
    format!("name = '{name}'\nreplicates = {replicates}\nduration = {duration}\n[spec]\nn = {n}\n")
}

#[tokio::test(flavor = "multi_thread")]
async fn an_experiment_without_memory_for_a_run_is_refused_and_fewer_runs_are_executed_at_a_time() {
    let data = tempfile::tempdir().unwrap();
    let limits = ["--max-memory-mb", "16", "--experiment-threads", "8"];
    let (_process, client) = start(data.path(), &limits).await;
    let args = json!({"submit": {"toml": large("huge", 5000, 1, 1.0)}});
    let (code, message) = error_of(&client, args).await;
    assert_eq!(code, ErrorCode::ResourceExhausted, "{message}");
    assert!(message.contains("raise max_memory_mb"), "{message}");
    assert!(!folder(data.path(), "huge").exists());

    // Each run takes 1 MiB and 3 MB.
    submit(&client, &large("some", 500, 12, 0.5)).await;
    let (mut most, mut reserved) = (0, 0);
    until("it is finished", async || {
        let progress = progress(&client, "some").await;
        most = usize::max(most, progress["running"].as_array().unwrap().len());
        let status = client.node("status").await;
        reserved = u64::max(
            reserved,
            status["experiments_memory_bytes"].as_u64().unwrap(),
        );
        progress["phase"] == "finished"
    })
    .await;
    assert!((1..=4).contains(&most), "{most} runs at a time");
    assert!((4 << 20..=16 << 20).contains(&reserved), "{reserved}");
    let status = client.node("status").await;
    assert_eq!(status["experiments_memory_bytes"], 0, "{status}");
}

#[tokio::test(flavor = "multi_thread")]
async fn swarms_and_an_experiment_share_the_memory() {
    let data = tempfile::tempdir().unwrap();
    let limits = ["--max-memory-mb", "16", "--experiment-threads", "1"];
    let (_process, client) = start(data.path(), &limits).await;
    submit(&client, &large("long", 500, 1, 1e6)).await;
    submit(&client, &large("next", 1500, 1, 0.5)).await;
    wait_for_phase(&client, "long", "running").await;
    until("its memory is reserved", async || {
        let status = client.node("status").await;
        status["experiments_memory_bytes"].as_u64() > Some(4_000_000)
    })
    .await;
    let create = async |n: usize| {
        let request = json!({"name": "school", "spec": {"n": n}}).to_string();
        let key = keys::node_cmd(PREFIX, NODE, "create");
        client.query(&key, Some(request.as_bytes())).await
    };
    let error = create(1700).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::ResourceExhausted, "{error:?}");
    create(1000).await.unwrap();
    // The swarm leaves 7 MiB: the next experiment needs 10.
    ok(&client, json!({"cancel": {"name": "long"}})).await;
    let paused = wait_for_phase(&client, "next", "paused").await;
    assert!(
        message(&paused).contains("delete swarms, or raise max_memory_mb"),
        "{paused}"
    );
    client.ok("school", "delete", json!({})).await;
    ok(&client, json!({"resume": {"name": "next"}})).await;
    wait_for_phase(&client, "next", "finished").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_experiment_is_accepted_if_it_fits_once_the_running_one_is_over() {
    let data = tempfile::tempdir().unwrap();
    let limits = ["--max-memory-mb", "16", "--experiment-threads", "1"];
    let (_process, client) = start(data.path(), &limits).await;
    // Each takes 10 MiB, and they run one after the other.
    submit(&client, &large("long", 1500, 1, 1e6)).await;
    until("its memory is reserved", async || {
        let status = client.node("status").await;
        status["experiments_memory_bytes"].as_u64() > Some(8 << 20)
    })
    .await;
    submit(&client, &large("next", 1500, 1, 0.5)).await;
    ok(&client, json!({"cancel": {"name": "long"}})).await;
    wait_for_phase(&client, "next", "finished").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_restart_an_experiment_gets_the_memory_that_the_recovered_swarms_leave() {
    let data = tempfile::tempdir().unwrap();
    let limits = ["--max-memory-mb", "16", "--experiment-threads", "8"];
    let (mut process, client) = start(data.path(), &limits).await;
    // Its checkpoint has 5 individuals: that it takes 9 MiB is known once its journal is replayed.
    client.create("school", json!({"n": 5})).await;
    client.ok("school", "inject", json!({"count": 995})).await;
    submit(&client, &large("long", 500, 12, 1e6)).await;
    let reserved = async |client: &Client| {
        let mut status = Value::Null;
        until("memory is reserved for runs", async || {
            status = client.node("status").await;
            status["experiments_memory_bytes"].as_u64() > Some(0)
        })
        .await;
        status["memory_bytes"].as_u64().unwrap()
    };
    let most = 16 << 20;
    assert!((12 << 20..=most).contains(&reserved(&client).await));
    process.kill();

    let mut command = daemon(data.path());
    command
        .args(limits)
        .env("FAILPOINTS", "command=sleep(1000)");
    let process = DaemonProcess::start(&mut command).unwrap();
    let client = Client::open(&process.endpoint).await;
    assert!((12 << 20..=most).contains(&reserved(&client).await));
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_paused_experiment_has_stored_counts_once() {
    let data = tempfile::tempdir().unwrap();
    let limits = ["--experiments-quota-mb", "50", "--experiment-threads", "1"];
    let (mut process, client) = start(data.path(), &limits).await;
    // 15 MB of each run, and as much for the one that is executed: 45 MB, of which a third is stored.
    submit(&client, &films("films", 2)).await;
    until("a run is finished", async || {
        progress(&client, "films").await["finished"] == 1
    })
    .await;
    ok(&client, json!({"pause": {"name": "films"}})).await;
    let short = |name: &str| films(name, 1).replace("duration = 100", "duration = 5");
    submit(&client, &short("second")).await;
    wait_for_phase(&client, "second", "finished").await;
    process.stop();
    assert_eq!(process.end(), Some(0));

    let (_process, client) = start(data.path(), &limits).await;
    let stored = bytes_in(&data.path().join("experiments"));
    until("the size is known", async || {
        client.node("metrics").await["experiments_bytes"].as_u64() == Some(stored)
    })
    .await;
    submit(&client, &short("third")).await;
    wait_for_phase(&client, "third", "finished").await;
}
