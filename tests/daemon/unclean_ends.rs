//! An experiment whose execution ends the daemon is not executed again for ever.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::experiments::{ok, progress, rows, submit, wait_for_phase};
use crate::support::daemon_process::{DaemonProcess, daemon};
use crate::support::{Client, TIMEOUT, until};

const NAME: &str = "steps";

/// An experiment of so many runs; a duration of 600 takes about a second.
fn steps(runs: u32, duration: u32) -> String {
    let sizes = format!("replicates = {runs}\nduration = {duration}\nspec = {{ n = 30 }}\n");
    format!("name = \"{NAME}\"\n{sizes}")
}

/// The daemon on a folder, which executes one run at a time.
struct Restarted<'a> {
    folder: &'a Path,
    failpoints: &'a str,
    process: DaemonProcess,
    client: Client,
}

impl<'a> Restarted<'a> {
    async fn start(folder: &'a Path, failpoints: &'a str) -> Self {
        let (process, client) = Self::launch(folder, failpoints).await;
        Restarted {
            folder,
            failpoints,
            process,
            client,
        }
    }

    async fn launch(folder: &Path, failpoints: &str) -> (DaemonProcess, Client) {
        let mut command = daemon(folder);
        command.args(["--experiment-threads", "1"]);
        if !failpoints.is_empty() {
            command.env("FAILPOINTS", failpoints);
        }
        let process = DaemonProcess::start(&mut command).unwrap();
        let client = Client::open(&process.endpoint).await;
        (process, client)
    }

    /// Waits until a run has taken a step after `since`, and returns the progress.
    async fn steps(&self, since: &Value) -> Value {
        let mut now = Value::Null;
        until("a step is taken", async || {
            now = progress(&self.client, NAME).await;
            now["phase"] == "running" && share(&now) > share(since)
        })
        .await;
        now
    }

    /// Waits until so many starts are counted on the disk.
    async fn counted(&self, starts: u32) {
        let file = self
            .folder
            .join("experiments")
            .join(NAME)
            .join("standing.json");
        let count = format!("\"count\":{starts}");
        until("the starts are counted", async || {
            fs::read_to_string(&file).unwrap().contains(&count)
        })
        .await;
    }

    /// Kills it after another step, before a run is finished, and starts it again.
    async fn kill_in_a_run(&mut self) {
        let before = progress(&self.client, NAME).await;
        self.steps(&before).await;
        self.kill().await;
        assert_eq!(
            finished(self.folder),
            before["finished"],
            "the run was too short"
        );
    }

    /// Kills it after a run is finished, and starts it again.
    async fn kill_after_a_run(&mut self) {
        let before = finished(self.folder);
        let deadline = Instant::now() + 6 * TIMEOUT;
        while finished(self.folder) == before {
            assert!(Instant::now() < deadline);
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        self.kill().await;
    }

    async fn kill(&mut self) {
        self.process.kill();
        self.restart().await;
    }

    async fn restart(&mut self) {
        (self.process, self.client) = Self::launch(self.folder, self.failpoints).await;
    }
}

fn share(progress: &Value) -> f64 {
    progress["share"].as_f64().unwrap_or(-1.0)
}

/// The number of finished runs: lines after the header.
fn finished(folder: &Path) -> u64 {
    let list = fs::read_to_string(folder.join("experiments").join(NAME).join("runs.jsonl"));
    (list.unwrap_or_default().matches('\n').count() as u64).saturating_sub(1)
}

#[tokio::test(flavor = "multi_thread")]
async fn an_experiment_that_ended_the_daemon_twice_waits_for_resume_and_the_next_one_is_executed() {
    let whole = tempfile::tempdir().unwrap();
    let uninterrupted = Restarted::start(whole.path(), "").await;
    submit(&uninterrupted.client, &steps(1, 1000)).await;

    let folder = tempfile::tempdir().unwrap();
    let mut daemon = Restarted::start(folder.path(), "").await;
    submit(&daemon.client, &steps(1, 1000)).await;
    let next = "name = \"next\"\nduration = 1\nspec = { n = 5 }\n";
    submit(&daemon.client, next).await;
    // A pause is an orderly end, and `resume` a start.
    daemon.steps(&Value::Null).await;
    let pause = json!({"pause": {"name": NAME}});
    let paused = ok(&daemon.client, pause).await["progress"].take();
    assert!(paused["message"].is_null(), "{paused}");
    wait_for_phase(&daemon.client, "next", "finished").await;
    ok(&daemon.client, json!({"resume": {"name": NAME}})).await;
    // The progress of before the pause may be reported later.
    daemon.counted(1).await;
    daemon.kill_in_a_run().await;
    let again = "name = \"again\"\nduration = 1\nspec = { n = 5 }\n";
    submit(&daemon.client, again).await;
    daemon.kill_in_a_run().await;

    // Both ends were those of `steps`, although `again` was queued.
    wait_for_phase(&daemon.client, "again", "finished").await;
    for _ in 0..2 {
        let paused = progress(&daemon.client, NAME).await;
        assert_eq!(paused["phase"], "paused");
        let message = paused["message"].as_str().unwrap();
        assert!(
            message.contains("crashed 2 times in a row within 60 s"),
            "{message}"
        );
        assert!(
            message.contains("`jostle experiment resume steps`"),
            "{message}"
        );
        daemon.kill().await;
    }
    let resumed = ok(&daemon.client, json!({"resume": {"name": NAME}})).await;
    assert!(resumed["progress"]["message"].is_null(), "{resumed}");
    // One unclean end is not yet two.
    daemon.kill_in_a_run().await;
    let finished = wait_for_phase(&daemon.client, NAME, "finished").await;
    assert!(finished["message"].is_null(), "{finished}");
    wait_for_phase(&uninterrupted.client, NAME, "finished").await;
    let expected = rows(&uninterrupted.client, NAME, 10).await;
    assert_eq!(rows(&daemon.client, NAME, 10).await, expected);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_experiment_continues_after_kills_between_which_a_run_finished() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = Restarted::start(folder.path(), "").await;
    submit(&daemon.client, &steps(5, 600)).await;
    for _ in 0..3 {
        daemon.kill_after_a_run().await;
    }
    daemon.kill_in_a_run().await;
    daemon.kill_after_a_run().await;
    daemon.kill_in_a_run().await;
    let finished = wait_for_phase(&daemon.client, NAME, "finished").await;
    assert_eq!(finished["finished"], 5, "{finished}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_experiment_continues_after_kills_that_are_later_and_after_orderly_ends() {
    let folder = tempfile::tempdir().unwrap();
    let mut daemon = Restarted::start(folder.path(), "experiment-settled=return(1)").await;
    submit(&daemon.client, &steps(1, 1_000_000)).await;
    for _ in 0..3 {
        daemon.steps(&Value::Null).await;
        daemon.counted(0).await;
        daemon.kill().await;
    }
    daemon.failpoints = "";
    daemon.kill().await;
    for _ in 0..3 {
        daemon.steps(&Value::Null).await;
        daemon.process.stop();
        assert_eq!(daemon.process.end(), Some(0));
        daemon.restart().await;
    }
    daemon.steps(&Value::Null).await;
}
