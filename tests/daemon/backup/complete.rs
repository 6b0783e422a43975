//! A backup that is taken while runs and parts are finished contains all that it names.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Child, Output};
use std::time::Duration;

use jostle_proto::keys;
use serde_json::{Value, json};

use crate::support::{NODE, PREFIX, until};

use super::fixture::{
    STANDING, arguments, begin, create_swarms, experiment, node, outcome, restore,
    send_commands_for,
};

/// Short runs of one condition, each with a trajectory: run `#0` is the first of the plan.
const TRAJECTORIES: &str = "name = \"order\"\nseed = 3\nreplicates = 300\nduration = 40\n[[grid]]\n\
    pi1 = 1\nn = 6\n[measure]\nrecord_every = 40\n";

/// Experiments that are copied before it.
const EARLIER: &str = "name = \"earlier\"\nreplicates = 6\nduration = 1\n[[grid]]\npi1 = 1\nn = 3\n\
    [measure]\nrecord_every = 10\n";

/// Starts a backup that sleeps `millis` before each of the first 25 files: those of what is earlier in
/// the alphabet, and some of what is written meanwhile.
fn take_slowly(data: &Path, folder: &Path, millis: u32) -> Child {
    let mut command = arguments("backup", folder, data);
    command.env("FAILPOINTS", format!("backup-file=25*sleep({millis})->off"));
    command.spawn().unwrap()
}

/// The trajectories of an experiment, by name.
fn trajectories(experiment: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = fs::read_dir(experiment.join("trajectories")).unwrap();
    let files = files.map(|file| file.unwrap().path());
    let whole = files.filter(|path| path.extension().is_some_and(|it| it == "parquet"));
    let name = |path: &Path| path.file_name().unwrap().to_str().unwrap().to_owned();
    whole
        .map(|path| (name(&path), fs::read(path).unwrap()))
        .collect()
}

/// The names of the trajectories of the runs that the list of an experiment names.
fn listed(experiment: &Path) -> Vec<String> {
    let list = fs::read_to_string(experiment.join("runs.jsonl")).unwrap();
    let whole = &list[..list.rfind('\n').unwrap()];
    let names = whole.lines().skip(1).map(|line| {
        let line: Value = serde_json::from_str(line).unwrap();
        let run = line["run"].as_str().unwrap();
        let number: usize = run.rsplit('#').next().unwrap().parse().unwrap();
        format!("run-{:06}.parquet", number + 1)
    });
    names.collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_under_record_every_has_the_trajectory_of_every_run_that_it_lists() {
    let base = tempfile::tempdir().unwrap();
    let [data, folder, elsewhere] =
        ["data", "backup", "elsewhere"].map(|name| base.path().join(name));
    fs::create_dir(&data).unwrap();
    let (mut process, client) = begin(&data, "").await;
    create_swarms(&client).await;
    for toml in [EARLIER, TRAJECTORIES] {
        node(&client, "experiment", json!({"submit": {"toml": toml}})).await;
    }
    let [live, restored] = [&data, &elsewhere].map(|it| it.join("experiments/order"));
    let is_begun = || listed(&live).len() >= 3;
    until("a few runs", async || {
        live.join("runs.jsonl").exists() && is_begun()
    })
    .await;

    let backup = take_slowly(&data, &folder, 60);
    send_commands_for(&client, Duration::from_millis(500)).await;
    outcome(&backup.wait_with_output().unwrap()).unwrap();
    process.kill();
    restore(&folder, &elsewhere).unwrap();
    let (names, files) = (listed(&restored), trajectories(&restored));
    println!("{} runs, {} trajectories", names.len(), files.len());
    assert!((3..300).contains(&names.len()), "{}", names.len());
    let missing: Vec<&String> = names.iter().filter(|it| !files.contains_key(*it)).collect();
    assert!(missing.is_empty(), "{missing:?} of {} runs", names.len());

    // It continues, and the trajectories are those of the first daemon.
    let (_old, client) = begin(&data, "").await;
    let (_new, again) = begin(&elsewhere, "").await;
    experiment(&client, "finished").await;
    experiment(&again, "finished").await;
    let all = trajectories(&live);
    assert_eq!(all.len(), 300);
    assert!(trajectories(&restored) == all, "other trajectories");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_of_recordings_has_every_part_that_their_status_counts() {
    let base = tempfile::tempdir().unwrap();
    let [data, folder, elsewhere] =
        ["data", "backup", "elsewhere"].map(|name| base.path().join(name));
    fs::create_dir(&data).unwrap();
    let points = "recording-part=return(30)";
    let (mut process, client) = begin(&data, points).await;
    create_swarms(&client).await;
    let names = ["earlier", "film"];
    for name in names {
        let begin = json!({"begin": {"swarm": "fast", "recording": name}});
        node(&client, "record", begin).await;
    }
    let status = |data: &Path, name: &str| {
        let text = fs::read(data.join("recordings").join(name).join("recording.json")).unwrap();
        serde_json::from_slice::<Value>(&text).unwrap()
    };
    let has_part = |data: &Path, name: &str, part: u64| {
        let part = format!("recordings/{name}/part-{part:05}.mcap");
        data.join(part).exists()
    };
    until("a few parts", async || {
        names.iter().all(|name| has_part(&data, name, 4))
    })
    .await;
    let backup = take_slowly(&data, &folder, 40);
    send_commands_for(&client, Duration::from_millis(300)).await;
    outcome(&backup.wait_with_output().unwrap()).unwrap();
    process.kill();
    restore(&folder, &elsewhere).unwrap();
    for name in names {
        let parts = status(&elsewhere, name)["parts"].as_u64().unwrap();
        assert!(parts >= 4, "{name}: {parts}");
        let missing: Vec<u64> = (0..parts)
            .filter(|it| !has_part(&elsewhere, name, *it))
            .collect();
        assert!(missing.is_empty(), "{name}: {missing:?} of {parts}");
    }
    // Both resume after the parts that are there.
    let (_new, client) = begin(&elsewhere, points).await;
    for name in names {
        let before = status(&elsewhere, name)["parts"].as_u64();
        until("a new part", async || {
            let now = status(&elsewhere, name);
            assert_eq!(now["phase"], "recording", "{now}");
            now["parts"].as_u64() > before
        })
        .await;
    }
    drop(client);
}

/// Removes a file from a backup and its manifest: earlier versions took such backups.
fn remove_from_backup(folder: &Path, path: &str) {
    fs::remove_file(folder.join(path)).unwrap();
    let manifest = folder.join("backup.json");
    let checked: Value = serde_json::from_slice(&fs::read(&manifest).unwrap()).unwrap();
    let mut backup = checked["backup"].clone();
    let files = backup["files"].as_array_mut().unwrap();
    files.retain(|file| file["path"] != path);
    let text = backup.to_string();
    let hash = blake3::hash(text.as_bytes()).to_hex();
    let text = format!("{{\"blake3\":\"{hash}\",\"backup\":{text}}}");
    fs::write(manifest, text).unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_backup_lacks_is_named_and_the_rest_is_restored() {
    let base = tempfile::tempdir().unwrap();
    let path = |name: &str| base.path().join(name);
    let [data, folder] = ["data", "backup"].map(path);
    fs::create_dir(&data).unwrap();
    let (mut process, client) = begin(&data, "recording-part=return(100)").await;
    create_swarms(&client).await;
    for name in ["film", "whole"] {
        let begin = json!({"begin": {"swarm": "fast", "recording": name}});
        node(&client, "record", begin).await;
        until("two parts", async || {
            data.join(format!("recordings/{name}/part-00002.mcap"))
                .exists()
        })
        .await;
        node(&client, "record", json!({"stop": {"recording": name}})).await;
    }
    node(&client, "experiment", json!({"submit": {"toml": EARLIER}})).await;
    let trajectory = "experiments/earlier/trajectories/run-000002.parquet";
    let is_finished = async || {
        let key = keys::experiment(PREFIX, NODE, "earlier", "progress");
        client.query(&key, None).await.unwrap()["phase"] == "finished"
    };
    until("the experiment is finished", is_finished).await;
    let output = arguments("backup", &folder, &data).output().unwrap();
    assert_eq!(outcome(&output).unwrap()["incomplete"], json!([]));
    assert!(output.stderr.is_empty(), "{output:?}");

    let lost = "recordings/film/part-00001.mcap";
    for path in [lost, trajectory] {
        remove_from_backup(&folder, path);
    }
    let assert_named = |output: &Output| {
        let text = String::from_utf8(output.stderr.clone()).unwrap();
        let is_named =
            text.contains("recordings/film lacks files") && text.contains("part-00001.mcap");
        assert!(is_named && !text.contains("whole"), "{text}");
        let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
        let incomplete = summary["incomplete"].as_array().unwrap();
        let paths = ["experiments/earlier", "recordings/film"];
        let reasons = [
            "files of 1 of its 6 finished runs (run 2)",
            "(part-00001.mcap)",
        ];
        assert_eq!(incomplete.len(), 2, "{summary}");
        for ((path, reason), it) in paths.iter().zip(reasons).zip(incomplete) {
            assert_eq!(it["path"], *path);
            assert!(it["reason"].as_str().unwrap().contains(reason), "{it}");
        }
    };
    let output = arguments("restore", &folder, &path("new"))
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(9), "{output:?}");
    assert_named(&output);
    let (_new, again) = begin(&path("new"), "").await;
    again.ok(STANDING, "step", json!({"steps": 1})).await;
    let list = again.node("recordings").await;
    let [film, whole] = [0, 1].map(|index| &list["recordings"][index]);
    assert_eq!(
        (&film["recording"], &film["phase"]),
        (&json!("film"), &json!("failed"))
    );
    assert_eq!(
        (&film["lost_parts"], &whole["lost_parts"]),
        (&json!(1), &json!(0))
    );
    assert!(
        film["reason"].as_str().unwrap().contains("part-00001.mcap"),
        "{film}"
    );

    // A backup of a data folder that lacks a file names it.
    for path in [lost, trajectory] {
        fs::remove_file(data.join(path)).unwrap();
    }
    let output = arguments("backup", &path("second"), &data)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert_named(&output);

    // The list of runs: without it, and with a line that cannot be read.
    let list = data.join("experiments/earlier/runs.jsonl");
    let lines = fs::read_to_string(&list).unwrap();
    for (number, text, reason) in [
        (3, None, "files of 6 of its 6 finished runs"),
        (
            4,
            Some(lines.replacen("\n{", "\n", 1)),
            "its list of runs cannot be read",
        ),
    ] {
        match text {
            None => fs::remove_file(&list).unwrap(),
            Some(text) => fs::write(&list, text).unwrap(),
        }
        let output = arguments("backup", &path(&number.to_string()), &data).output();
        let summary = outcome(&output.unwrap()).unwrap();
        let reasons = summary["incomplete"][0]["reason"].as_str().unwrap();
        assert!(reasons.contains(reason), "{summary}");
    }
    process.stop();
    assert_eq!(process.end(), Some(0));
}
