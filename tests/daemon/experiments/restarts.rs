//! Experiments after restarts and kills of the daemon, and with files that are lost meanwhile.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use jostle_experiment::{Plan, execute_run};
use jostle_proto::ErrorCode;
use serde_json::{Value, json};

use super::{endless, error_of, get, ok, progress, rows, small, submit, wait_for_phase};
use crate::support::daemon_process::{DaemonProcess, daemon};
use crate::support::process::{Process, jostled};
use crate::support::{Client, Daemon, NODE, TIMEOUT, until};

#[tokio::test(flavor = "multi_thread")]
async fn what_is_unfinished_goes_on_in_another_daemon_and_what_is_paused_does_not() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    submit(client, &endless("still")).await;
    ok(client, json!({"pause": {"name": "still"}})).await;
    submit(client, &endless("going")).await;
    wait_for_phase(client, "going", "running").await;
    submit(client, &small("next")).await;
    let began = Instant::now();
    let daemon = daemon.restart().await;
    assert!(began.elapsed() < TIMEOUT);
    let client = &daemon.client;
    wait_for_phase(client, "going", "running").await;
    assert_eq!(progress(client, "still").await["phase"], "paused");
    assert_eq!(progress(client, "next").await["phase"], "queued");
    let list = client.node("experiments").await;
    let names: Vec<&str> = list["experiments"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| it["name"].as_str().unwrap())
        .collect();
    assert_eq!(
        names,
        ["still", "going", "next"],
        "in the order of submission"
    );
    ok(client, json!({"cancel": {"name": "going"}})).await;
    wait_for_phase(client, "next", "finished").await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_paused_stays_so_after_a_kill() {
    let folder = tempfile::tempdir().unwrap();
    let (mut process, client) = start_daemon(folder.path()).await;
    submit(&client, &endless("still")).await;
    wait_for_phase(&client, "still", "running").await;
    ok(&client, json!({"pause": {"name": "still"}})).await;
    process.kill();
    let (mut process, client) = start_daemon(folder.path()).await;
    assert_eq!(progress(&client, "still").await["phase"], "paused");
    process.kill();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_experiment_under_the_name_of_a_deleted_one_has_its_own_rows() {
    let folder = tempfile::tempdir().unwrap();
    let (mut process, client) = start_daemon(folder.path()).await;
    let list = folder.path().join("experiments/again/runs.jsonl");
    // Executes a run of this seed, checks its row, and returns the length of the list of runs.
    let length = async |seed: u64| {
        let toml =
            format!("name = \"again\"\nseeds = [{seed}]\nduration = 1\nspec = {{ n = 5 }}\n");
        submit(&client, &toml).await;
        wait_for_phase(&client, "again", "finished").await;
        let rows = rows(&client, "again", 10).await;
        let plan = Plan::parse(&toml).unwrap();
        let run = execute_run(&plan, &plan.runs()[0], |_| true).unwrap();
        assert_eq!(rows[0]["state_hash"], run.row.unwrap().state_hash);
        let length = fs::metadata(&list).unwrap().len();
        ok(&client, json!({"delete": {"name": "again"}})).await;
        length
    };
    // The daemon caches rows, and must not mistake one list for another of the same length.
    let mut seeds = BTreeMap::new();
    for seed in 10..60 {
        if let Some(same) = seeds.insert(length(seed).await, seed) {
            assert_eq!(length(same).await, length(seed).await);
            break;
        }
    }
    assert!(seeds.len() < 50, "{seeds:?}");
    process.kill();
}

/// A daemon in its own process, and a client of it.
async fn start_daemon(folder: &Path) -> (DaemonProcess, Client) {
    let process = DaemonProcess::start(&mut daemon(folder)).unwrap();
    let client = Client::open(&process.endpoint).await;
    (process, client)
}

#[tokio::test(flavor = "multi_thread")]
async fn repeated_kills_do_not_change_the_tables() {
    // Some seconds of one core: long enough to be killed during the execution.
    let toml = "name = \"small\"\nseed = 3\nreplicates = 4\nduration = 300\n[[grid]]\npi1 = [1, 4]\n\
                n = [20, 30]\ninformed = 3\n[measure]\norder_every = 100\nrecord_every = 500\n";
    let whole = tempfile::tempdir().unwrap();
    let (_process, client) = start_daemon(whole.path()).await;
    submit(&client, toml).await;
    wait_for_phase(&client, "small", "finished").await;
    let table =
        |folder: &Path, name: &str| fs::read(folder.join("experiments/small").join(name)).unwrap();

    let folder = tempfile::tempdir().unwrap();
    let (mut process, client) = start_daemon(folder.path()).await;
    submit(&client, toml).await;
    // Closes the client, then kills the daemon repeatedly.
    client.session.close().await.unwrap();
    let (mut kills, mut lines) = (0, String::new());
    loop {
        let list = folder.path().join("experiments/small/runs.jsonl");
        let known = fs::read_to_string(&list).unwrap_or_default();
        assert!(
            known.starts_with(&lines),
            "a finished run is never done again"
        );
        let whole_lines = known.rfind('\n').map_or(0, |end| end + 1);
        known[..whole_lines].clone_into(&mut lines);
        let client = Client::open(&process.endpoint).await;
        let progress = progress(&client, "small").await;
        if progress["phase"] == "finished" {
            break;
        }
        let before = progress["finished"].as_u64().unwrap();
        if before == 16 {
            // Two more kills, between which no run can finish, would pause it.
            wait_for_phase(&client, "small", "finished").await;
            break;
        }
        let deadline = Instant::now() + 6 * TIMEOUT;
        while crate::experiments::progress(&client, "small").await["finished"]
            .as_u64()
            .unwrap()
            < (before + 3).min(16)
        {
            assert!(Instant::now() < deadline);
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        process.kill();
        kills += 1;
        process = DaemonProcess::start(&mut daemon(folder.path())).unwrap();
    }
    assert!(kills >= 3, "{kills}");
    for name in ["results.csv", "results.parquet", "order.parquet"] {
        assert!(
            table(folder.path(), name) == table(whole.path(), name),
            "{name}"
        );
    }
    let trajectories = folder.path().join("experiments/small/trajectories");
    assert_eq!(
        fs::read_dir(&trajectories).unwrap().count(),
        16,
        "one a run"
    );
    for number in 1..=16 {
        let name = format!("trajectories/run-{number:06}.parquet");
        assert!(
            table(folder.path(), &name) == table(whole.path(), &name),
            "{name}"
        );
    }
    // A restart after the end does nothing.
    process.kill();
    let (_process, client) = start_daemon(folder.path()).await;
    let progress = progress(&client, "small").await;
    assert_eq!(
        (&progress["phase"], &progress["finished"]),
        (&json!("finished"), &json!(16))
    );
    assert_eq!(rows(&client, "small", 100).await.len(), 16);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_executes_a_long_run_ends() {
    let serve = ["serve", "--listen", "tcp/127.0.0.1:0", "--node", NODE];
    let (mut process, endpoint) =
        Process::start(&mut jostled(&serve), tempfile::tempdir().unwrap());
    let client = Client::open(&endpoint).await;
    submit(&client, &endless("long")).await;
    wait_for_phase(&client, "long", "running").await;
    process.signal("-TERM");
    assert_eq!(process.end().0, Some(0));
}

/// Restarts the daemon of a folder after `change`.
async fn restart_after(
    (mut process, client): (DaemonProcess, Client),
    folder: &Path,
    change: impl FnOnce(&Path),
) -> (DaemonProcess, Client) {
    client.session.close().await.unwrap();
    process.kill();
    change(&folder.join("experiments"));
    start_daemon(folder).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_finished_experiment_that_lacks_files_says_so_and_waits_for_a_client() {
    let toml = |name: &str| {
        format!(
            "name = \"{name}\"\nreplicates = 4\nduration = 1\nspec = {{ n = 4 }}\n\
             measure = {{ record_every = 10 }}\n"
        )
    };
    let folder = tempfile::tempdir().unwrap();
    let (process, client) = start_daemon(folder.path()).await;
    for name in ["over", "queued", "older"] {
        submit(&client, &toml(name)).await;
        wait_for_phase(&client, name, "finished").await;
    }
    let file = |name: &str, run: u32| format!("{name}/trajectories/run-{run:06}.parquet");
    let read = |path: String| fs::read(folder.path().join("experiments").join(path)).unwrap();
    // The metadata have the name of the experiment.
    let whole = ["over", "queued"].map(|name| read(file(name, 3)));
    let replace = |path: &Path, from: &str, to: &str| {
        let text = fs::read_to_string(path).unwrap();
        assert!(text.contains(from), "{text}");
        fs::write(path, text.replace(from, to)).unwrap();
    };
    let damage = |experiments: &Path| {
        for name in ["over", "queued", "older"] {
            fs::remove_file(experiments.join(file(name, 3))).unwrap();
            let second = experiments.join(file(name, 2));
            let bytes = fs::read(&second).unwrap();
            fs::write(&second, &bytes[1..]).unwrap();
        }
        // As if the daemon had been killed before this experiment ended.
        let status = experiments.join("queued/standing.json");
        replace(&status, "\"phase\":\"finished\"", "\"phase\":\"queued\"");
        let list = experiments.join("older/runs.jsonl");
        replace(&list, "\"model_version\":", "\"model_version\":9");
    };
    let (process, client) = restart_after((process, client), folder.path(), damage).await;

    let said = async |name: &str| {
        let deadline = Instant::now() + TIMEOUT;
        loop {
            let progress = progress(&client, name).await;
            if !progress["message"].is_null() {
                assert_eq!(progress["phase"], "finished");
                assert_eq!(
                    (&progress["runs"], &progress["finished"]),
                    (&json!(4), &json!(2))
                );
                return progress["message"].as_str().unwrap().to_owned();
            }
            assert!(Instant::now() < deadline, "{progress}");
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    let resume = |name: &str| json!({"resume": {"name": name}});
    // That of which the execution had not ended executes the two runs again.
    wait_for_phase(&client, "queued", "finished").await;
    assert!(read(file("queued", 3)) == whole[1] && read(file("queued", 2)).len() > 1000);
    assert_eq!(progress(&client, "queued").await["finished"], 4);

    let message = "2 runs lack files: `jostle experiment resume` executes them again";
    assert_eq!(said("over").await, message);
    assert_eq!(
        rows(&client, "over", 10).await.len(),
        4,
        "rows need no file"
    );
    assert!(
        !folder
            .path()
            .join("experiments")
            .join(file("over", 3))
            .exists()
    );
    let read_run = async |run: &str| {
        let series = format!("series?of=individuals;run={run}");
        get(&client, "over", &series).await
    };
    let error = read_run("#2").await.unwrap_err();
    assert_eq!(error.code, ErrorCode::IncorrectState);
    assert!(
        error
            .message
            .contains("run \"#2\" of experiment \"over\" is missing"),
        "{error:?}"
    );
    assert!(read_run("#0").await.is_ok());
    ok(&client, resume("over")).await;
    wait_for_phase(&client, "over", "finished").await;
    assert!(read(file("over", 3)) == whole[0]);
    assert!(read_run("#2").await.is_ok());
    let over = progress(&client, "over").await;
    assert_eq!(
        (&over["finished"], &over["message"]),
        (&json!(4), &Value::Null)
    );
    let (code, message) = error_of(&client, resume("over")).await;
    assert_eq!(code, ErrorCode::IncorrectState);
    assert!(message.contains("nothing left to do"), "{message}");

    // Runs of another version of the model can be read only.
    let message = said("older").await;
    assert!(
        message.starts_with("2 runs lack files, which cannot be executed again"),
        "{message}"
    );
    assert_eq!(rows(&client, "older", 10).await.len(), 4);
    let (code, message) = error_of(&client, resume("older")).await;
    assert_eq!(code, ErrorCode::Conflict);
    assert!(
        message.contains("of the model executed the finished runs"),
        "{message}"
    );
    drop(process);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_missing_or_damaged_is_an_incorrect_state_until_a_client_resumes() {
    let toml = "name = \"a\"\nreplicates = 3\nduration = 100\nspec = { n = 2 }\n\
                measure = { record_every = 100, order_every = 1 }\n";
    let folder = tempfile::tempdir().unwrap();
    let (process, client) = start_daemon(folder.path()).await;
    submit(&client, toml).await;
    wait_for_phase(&client, "a", "finished").await;
    let experiment = folder.path().join("experiments/a");
    let files = [
        "trajectories/run-000001.parquet",
        "orders/run-000002.parquet",
        "orders/run-000003.parquet",
    ]
    .map(|path| experiment.join(path));
    let read = |path: &Path| fs::read(path).unwrap();
    let whole = files.each_ref().map(|path| read(path));
    let table = read(&experiment.join("order.parquet"));
    let finish_again = async |client: &Client| {
        ok(client, json!({"resume": {"name": "a"}})).await;
        until("all runs are finished", async || {
            let progress = progress(client, "a").await;
            progress["phase"] == "finished" && progress["finished"] == 3
        })
        .await;
        for (path, whole) in files.iter().zip(&whole) {
            assert!(read(path) == *whole, "{path:?}");
        }
        assert!(read(&experiment.join("order.parquet")) == table);
    };

    fs::remove_file(&files[0]).unwrap();
    fs::write(&files[1], &whole[1][..1000]).unwrap();
    let mut flipped = whole[2].clone();
    flipped[whole[2].len() / 3] ^= 1;
    fs::write(&files[2], flipped).unwrap();
    for (noun, remedy) in [
        (
            "series?of=individuals;run=#0",
            "is missing: `jostle experiment resume`",
        ),
        ("order?run=#1", "is missing: `jostle experiment resume`"),
        (
            "order?run=#2",
            "delete the file, then `jostle experiment resume a`",
        ),
    ] {
        let error = get(&client, "a", noun).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::IncorrectState, "{noun}: {error:?}");
        assert!(error.message.contains(remedy), "{noun}: {error:?}");
    }
    fs::remove_file(&files[2]).unwrap();
    finish_again(&client).await;

    // Without its list of runs all of them lack it.
    let without_list =
        |experiments: &Path| fs::remove_file(experiments.join("a/runs.jsonl")).unwrap();
    let (process, client) = restart_after((process, client), folder.path(), without_list).await;
    until("it says so", async || {
        let progress = progress(&client, "a").await;
        progress["finished"] == 0
            && progress["message"]
                .as_str()
                .is_some_and(|it| it.starts_with("3 runs lack files"))
    })
    .await;
    finish_again(&client).await;
    drop(process);
}
