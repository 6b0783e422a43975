//! `run --wait` and `watch`.

use std::time::Duration;

use serde_json::{Value, json};

use crate::support::{Daemon, object, until};

#[tokio::test(flavor = "multi_thread")]
async fn a_wait_for_a_run_returns_at_its_end() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;
    let ended = daemon
        .jostle("--json run demo --until 2 --rate max --wait")
        .await;
    let reached = object(&ended);
    assert_eq!(
        (&reached["step"], &reached["phase"]),
        (&json!(100), &json!("paused"))
    );
    assert_eq!(ended.stderr, "", "no bar where there is no terminal");
    let ended = daemon.jostle("run demo --until-step 150 --wait").await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(
        ended
            .stdout
            .starts_with("demo is paused at step 150, time 3"),
        "{ended:?}"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wait_ends_when_another_client_ends_the_run() {
    for (verb, exit_code, code) in [
        ("pause demo", 4, "incorrect_state"),
        ("reset demo", 4, "conflict"),
        ("delete demo", 3, "not_found"),
    ] {
        let daemon = Daemon::start().await;
        daemon.jostle("create demo --n 10").await;
        let waiting = daemon.begin("--json run demo --until 1e6 --wait");
        daemon.until_running("demo").await;
        assert_eq!(daemon.jostle(verb).await.code, Some(0));
        let ended = waiting.end().await;
        assert_eq!(ended.code, Some(exit_code), "{verb}: {ended:?}");
        let error: Value = serde_json::from_str(&ended.stderr).unwrap();
        assert_eq!(error["code"], code);
        daemon.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wait_for_a_condition_ends_when_the_swarm_is_deleted() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;
    let waiting = daemon.begin("--json wait demo order>1");
    until("it waits", async || {
        let status = object(&daemon.jostle("--json status demo").await);
        status["result"]["waits"][0]["condition"] == "order > 1"
    })
    .await;
    assert_eq!(daemon.jostle("delete demo").await.code, Some(0));
    // Half of the time for which it tolerates an outage.
    let ended = tokio::time::timeout(Duration::from_secs(30), waiting.end()).await;
    let ended = ended.expect("it ends, as the swarm does not come back");
    assert_eq!(ended.code, Some(3), "{ended:?}");
    let error: Value = serde_json::from_str(&ended.stderr).unwrap();
    assert_eq!(error["code"], "not_found");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_ends_the_wait_and_not_the_swarm() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;
    let waiting = daemon.begin("run demo --until 1e6 --wait");
    daemon.until_running("demo").await;
    waiting.interrupt();
    let ended = waiting.end().await;
    ended.assert_stderr(130, "demo runs on");
    let status = object(&daemon.jostle("--json status demo").await);
    assert_eq!(status["phase"], "running");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watched_swarm_shows_its_states_and_its_order() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;

    let still = daemon.jostle("watch demo --frames --count 1").await;
    assert_eq!(object(&still)["step"], 0, "a paused swarm is shown at once");
    let still = daemon.jostle("--json watch demo --count 1").await;
    assert_eq!(object(&still)["phase"], "paused");

    daemon.jostle("run demo").await;
    let frames = daemon.jostle("watch demo --frames --count 3").await;
    assert_eq!(frames.code, Some(0), "{frames:?}");
    let frames = frames.json_lines();
    assert_eq!(frames.len(), 3);
    let steps: Vec<u64> = frames
        .iter()
        .map(|frame| frame["step"].as_u64().unwrap())
        .collect();
    assert!(steps.is_sorted() && steps[0] < steps[2], "{steps:?}");
    assert!(
        frames
            .iter()
            .all(|frame| frame["x"].as_array().unwrap().len() == 10)
    );

    let samples = daemon
        .jostle("--json watch demo --count 3")
        .await
        .json_lines();
    assert_eq!(samples.len(), 3);
    assert!(
        samples
            .iter()
            .all(|sample| sample["order"]["order"].is_number())
    );

    let lines = daemon.jostle("watch demo --count 2").await;
    let words: Vec<&str> = lines.stdout.lines().collect();
    assert_eq!(words.len(), 3, "a header and two lines: {lines:?}");
    assert!(words[0].trim_start().starts_with("step") && words[1].contains("running"));

    let ended = daemon.jostle("--json watch demo --for 0.2").await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watch_ends_with_the_swarm() {
    let daemon = Daemon::start().await;
    for (line, exit_code) in [("watch demo", 0), ("watch demo --count 99", 3)] {
        daemon.jostle("create demo --n 10").await;
        let mut watching = daemon.begin(line);
        watching.lines(2);
        assert_eq!(daemon.jostle("delete demo").await.code, Some(0));
        let ended = watching.end().await;
        ended.assert_stderr(exit_code, "demo was deleted");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watch_survives_a_restart_and_reports_a_swarm_that_was_not_recovered() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;
    let mut watching = daemon.begin("watch demo");
    watching.lines(2);
    let endpoint = daemon.endpoint.clone();
    daemon.stop().await;
    assert!(
        watching
            .complaint()
            .contains("the daemon is gone; waiting for it to come back, Ctrl-C ends")
    );
    let daemon = Daemon::with(&[("listen", &endpoint)]).await;
    let ended = watching.end().await;
    ended.assert_stderr(3, "back, but without demo");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_closed_pipe_ends_a_stream_without_an_error() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;
    daemon.jostle("run demo").await;
    for line in ["watch demo --frames", "--json watch demo", "watch demo"] {
        let mut watching = daemon.begin(line);
        watching.lines(1);
        watching.stop_reading();
        let ended = watching.end().await;
        assert_eq!((ended.code, ended.stderr.as_str()), (Some(0), ""), "{line}");
    }
    until("the daemon forgets them", async || {
        daemon.server.sessions() == 0
    })
    .await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_counts_the_states_of_a_paused_swarm_does_not_wait_for_ever() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    for line in [
        "watch demo --count 3",
        "--json watch demo --count 3",
        "watch demo --frames --count 3",
    ] {
        let ended = daemon.jostle(&format!("{line} --timeout 3")).await;
        ended.assert_stderr(4, "demo does not run: 1 of 3 came");
        assert!(
            ended.stderr.contains("`jostle run demo` runs it"),
            "{ended:?}"
        );
    }
    // Steps of another client count.
    let mut watching = daemon.begin("--json watch demo --count 2");
    watching.lines(1);
    daemon.said("step demo 5").await;
    assert_eq!(watching.end().await.code, Some(0));
    daemon.stop().await;
}
