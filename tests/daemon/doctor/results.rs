//! What it says of experiments and of folders of `jostled run`.

use std::fs;
use std::path::{Path, PathBuf};

use jostle_experiment::unfinished;
use jostle_physics::model::MODEL_VERSION;
use jostle_proto::to_cbor;
use serde_json::{Value, json};

use super::asked::{Said, ask_unchanged, assert_happens, last_line};
use crate::experiments::submit;
use crate::models::{EARLIER, earlier, killed};
use crate::states::swarms;
use crate::support::daemon_process::copy_all;
use crate::support::process::jostled;
use crate::support::{Client, until};

const EXPERIMENT: &str = "name = \"order\"\nseed = 3\nreplicates = 4\nduration = 1\n\
                          [spec]\nn = 4\n[measure]\norder_every = 2\n";

/// Lets the earlier version have executed the first runs in a folder, so many of them.
fn age(folder: &Path, finished: usize) {
    let path = folder.join("runs.jsonl");
    let text = fs::read_to_string(&path).unwrap();
    let mut lines = text.lines();
    let mut header: Value = serde_json::from_str(lines.next().unwrap()).unwrap();
    header["model_version"] = json!(EARLIER);
    let mut aged = format!("{header}\n");
    for _ in 0..finished {
        aged.push_str(lines.next().unwrap());
        aged.push('\n');
    }
    fs::write(path, aged).unwrap();
}

fn find<'a>(said: &'a Said, list: &str, name: &str) -> &'a Value {
    let all = said.report[list].as_array().unwrap();
    let found = all.iter().find(|it| it["name"] == name);
    found.unwrap_or_else(|| panic!("{name} is not in {all:?}"))
}

/// Submits an experiment and waits until it is finished.
async fn execute(client: &Client) {
    submit(client, EXPERIMENT).await;
    until("it is finished", async || {
        client.node("experiments").await["experiments"][0]["phase"] == "finished"
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn experiments_of_an_earlier_version_are_marked_if_they_have_runs_left() {
    let folder = killed(async |client: &Client| execute(client).await).await;
    let all = folder.path().join("experiments");
    // Its files, and how many of its runs are finished under which version.
    for (name, phase, finished) in [
        ("begun", "queued", Some(0)),
        ("half", "queued", Some(2)),
        ("paused", "paused", Some(3)),
        ("cancelled", "cancelled", Some(1)),
        ("whole", "finished", Some(4)),
        ("tables", "queued", Some(4)),
    ] {
        copy_all(&all.join("order"), &all.join(name));
        finished.inspect(|finished| age(&all.join(name), *finished));
        let status = all.join(name).join("standing.json");
        let mut content: Value = serde_json::from_slice(&fs::read(&status).unwrap()).unwrap();
        content["phase"] = json!(phase);
        fs::write(&status, content.to_string()).unwrap();
    }
    // Without a status a crash has interrupted `submit`.
    copy_all(&all.join("half"), &all.join("alone"));
    fs::remove_file(all.join("alone/standing.json")).unwrap();
    fs::create_dir_all(folder.path().join("recordings/film")).unwrap();
    let said = ask_unchanged(folder.path(), &[]);
    assert_eq!((said.code, said.errors.as_str()), (0, ""));
    let marked = "ends as failed";
    for (name, phase, finished, version, message) in [
        ("order", "finished", 4, MODEL_VERSION, "as before"),
        ("begun", "queued", 0, MODEL_VERSION, "as before"),
        ("half", "queued", 2, EARLIER, marked),
        ("alone", "queued", 2, EARLIER, marked),
        ("paused", "paused", 3, EARLIER, marked),
        ("cancelled", "cancelled", 1, EARLIER, "stays cancelled"),
        ("whole", "finished", 4, EARLIER, "readable"),
        ("tables", "queued", 4, EARLIER, marked),
    ] {
        let found = find(&said, "experiments", name);
        let is_marked = version == EARLIER && name != "whole";
        assert_eq!(found["phase"], phase, "{found}");
        assert_eq!(
            (&found["finished"], &found["runs"]),
            (&json!(finished), &json!(4))
        );
        assert_eq!(found["model_version"], version, "{found}");
        assert_eq!(found["marked"], is_marked, "{found}");
        let again = is_marked.then(|| format!("{name}-model{MODEL_VERSION}"));
        assert_eq!(found["again"], json!(again), "{found}");
        let text = found["message"].as_str().unwrap();
        assert!(text.starts_with(message), "{found}");
        assert_eq!(
            text.contains("`jostle experiment run --again FILE`"),
            is_marked,
            "{found}"
        );
    }
    assert_eq!(said.report["experiments"].as_array().unwrap().len(), 8);
    assert_eq!(
        said.report["marked"],
        json!({"swarms": 0, "experiments": 5, "folders": 0})
    );
    assert_eq!(said.report["recordings"], 1);
    assert!(
        said.text.contains("1 recording: not affected\n"),
        "{}",
        said.text
    );
    let last = last_line(&said.text);
    assert!(
        last.starts_with("5 of 8 experiments will be marked"),
        "{last}"
    );

    let copied = tempfile::tempdir().unwrap();
    copy_all(folder.path(), copied.path());
    assert_happens(copied.path(), &said).await;

    fs::write(all.join("half/runs.jsonl"), "{}\n{}\n").unwrap();
    let said = ask_unchanged(folder.path(), &[]);
    assert_eq!(said.code, 1);
    assert!(
        said.errors.contains("jostled: half: cannot be read: "),
        "{}",
        said.errors
    );
    assert_eq!(find(&said, "experiments", "half")["marked"], false);
}

/// Executes the experiment, or a part of it, into a folder.
fn run(file: &Path, output: &Path, more: &[&str]) {
    let mut command = jostled(&["run"]);
    let done = command
        .arg(file)
        .arg("-o")
        .arg(output)
        .args(more)
        .output()
        .unwrap();
    assert!(done.status.success(), "{done:?}");
}

#[test]
fn folders_of_results_and_unfinished_parts_beside_them_are_examined_without_a_data_folder() {
    let base = tempfile::tempdir().unwrap();
    let path = |name: &str| base.path().join(name);
    let (file, out) = (path("order.toml"), path("out"));
    fs::write(&file, EXPERIMENT).unwrap();
    fs::create_dir(&out).unwrap();
    run(&file, &out.join("present"), &[]);
    run(&file, &out.join("whole"), &[]);
    age(&out.join("whole"), 4);
    run(&file, &out.join("half"), &[]);
    age(&out.join("half"), 2);
    run(&file, &path("part"), &["--part", "1/2"]);
    let hidden = unfinished(&out.join("part"), "1-of-2");
    fs::rename(path("part"), &hidden).unwrap();
    age(&hidden, 1);
    let name = |path: &PathBuf| path.to_str().unwrap().to_owned();
    let asked = |folders: &[&PathBuf]| {
        let mut command = jostled(&["doctor", "--json"]);
        // Its default data folder has no data.
        command.env("HOME", base.path()).env_remove("XDG_DATA_HOME");
        command
            .env_remove("JOSTLED_DATA_DIR")
            .env_remove("XDG_STATE_HOME");
        let output = command.args(folders).output().unwrap();
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        (output.status.code(), report)
    };
    let (code, report) = asked(&[&out]);
    assert_eq!(code, Some(0), "{report}");
    assert_eq!(report["data_dir"], Value::Null);
    let folders = report["folders"].as_array().unwrap();
    let rows: Vec<_> = folders
        .iter()
        .map(|it| {
            let text = it["name"].as_str().unwrap();
            (
                text.to_owned(),
                it["model_version"].as_u64(),
                it["again"].as_str().map(str::to_owned),
            )
        })
        .collect();
    let again = |it: &str| Some(name(&out.join(format!("{it}-model{MODEL_VERSION}"))));
    assert_eq!(
        rows,
        [
            (name(&hidden), Some(EARLIER.into()), again("part")),
            (name(&out.join("half")), Some(EARLIER.into()), again("half")),
            (name(&out.join("present")), Some(MODEL_VERSION.into()), None),
            (name(&out.join("whole")), Some(EARLIER.into()), None),
        ]
    );
    assert_eq!(
        report["marked"],
        json!({"swarms": 0, "experiments": 0, "folders": 2})
    );
    // Each by itself.
    assert_eq!(asked(&[&hidden]).1["folders"][0], folders[0]);
    // A part has no folder of the name that it is going to have.
    assert_eq!(
        asked(&[&out.join("part")]).1["folders"],
        json!([folders[0]])
    );
    assert_eq!(
        asked(&[&out.join("present"), &out.join("half")]).1["folders"][1],
        folders[1]
    );
    assert_eq!(asked(&[&out.join("half")]).0, Some(0));
    // Without a folder, the data folder must have data.
    assert_eq!(asked(&[]).0, Some(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn folders_beside_a_data_folder_and_what_is_none() {
    let mut snapshot = None;
    let data = killed(async |client: &Client| {
        client.create("school", json!({"n": 5, "seed": 3})).await;
        snapshot = Some(swarms::snapshot(client, "school").await);
    })
    .await;
    let base = tempfile::tempdir().unwrap();
    let path = |name: &str| base.path().join(name);
    let old = earlier(snapshot.unwrap()).sealed();
    fs::write(path("old.snapshot"), to_cbor(&old)).unwrap();
    let file = path("grown.toml");
    let toml = "name = \"grown\"\nduration = 1\nstart = \"old.snapshot\"\nreplicates = 2\n";
    fs::write(&file, toml).unwrap();
    run(&file, &path("grown"), &[]);
    fs::create_dir(path("empty")).unwrap();
    let grown = path("grown");
    let said = ask_unchanged(data.path(), &[&grown]);
    assert_eq!((said.code, said.errors.as_str()), (0, ""));
    assert_eq!(said.report["swarms"].as_array().unwrap().len(), 1);
    let found = &said.report["folders"][0];
    assert_eq!(found["start_model_version"], EARLIER, "{found}");
    let message = found["message"].as_str().unwrap();
    assert!(
        message.contains("start from a state that version 1 of the model"),
        "{message}"
    );
    assert!(
        last_line(&said.text).starts_with("nothing will be marked"),
        "{}",
        said.text
    );
    for (folder, expected) in [
        (path("absent"), "No such file"),
        (path("empty"), "contains no results"),
        (file, "is a file"),
        (data.path().to_owned(), "is a data folder"),
    ] {
        let said = ask_unchanged(data.path(), &[&grown]);
        assert_eq!(said.code, 0);
        let mut command = jostled(&["doctor", "--data-dir"]);
        command.stderr(std::process::Stdio::piped());
        let output = command
            .arg(data.path())
            .arg(&grown)
            .arg(&folder)
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(1));
        let errors = String::from_utf8(output.stderr).unwrap();
        assert!(errors.contains(expected), "{errors}");
        assert!(errors.contains(folder.to_str().unwrap()), "{errors}");
        // What can be read is reported all the same.
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(text.contains("school") && text.contains("grown"), "{text}");
    }
}
