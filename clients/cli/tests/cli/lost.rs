//! Lost replies, busy daemons, lost connections: the daemon executes a command once.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::support::{Daemon, Impostor, Link, Running, object, until};

#[tokio::test(flavor = "multi_thread")]
async fn a_command_whose_reply_is_lost_is_executed_once() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    let link = Link::to(&daemon.endpoint);
    link.lose_answers();
    let stepping = Running::begin(&link.endpoint, "--json step demo 3 --timeout 60", "");
    until("the command is carried out", async || {
        daemon.reply("status demo").await["step"] == 3
    })
    .await;
    link.cut();
    link.mend();
    let answer = object(&stepping.end().await);
    assert_eq!((&answer["step"], &answer["seq"]), (&json!(3), &json!(1)));
    let status = daemon.reply("status demo").await;
    assert_eq!((&status["step"], &status["seq"]), (&json!(3), &json!(1)));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_to_a_busy_daemon_is_retried_unchanged() {
    let impostor = Impostor::start(&["jostle/demo/alive/a"], "jostle/x", "jostle/y").await;
    let busy = || Err(json!({"code": "busy", "message": "too much at once", "details": {}}));
    let reply = json!({
        "swarm": "demo", "epoch": 1, "step": 7, "time": 0.14, "phase": "paused", "seq": 1,
        "result": {},
    });
    let received = impostor
        .answer(
            "jostle/demo/cmd/pause",
            vec![busy(), Err(Value::Null), busy(), Ok(reply)],
        )
        .await;
    let answer = object(&impostor.jostle("--json pause demo --timeout 60").await);
    assert_eq!(answer["step"], 7);
    let requests = received.lock().unwrap().clone();
    assert_eq!(requests.len(), 4, "busy, silence, busy, done");
    assert!(requests.iter().all(|request| *request == requests[0]));
    let request: Value = serde_json::from_slice(&requests[0]).unwrap();
    assert!(!request["request_id"].as_str().unwrap().is_empty());
    assert!(request["client"].as_str().unwrap().starts_with("tester@"));

    let never = impostor.answer("jostle/demo/cmd/reset", vec![busy()]).await;
    let ended = impostor.jostle("--json reset demo --timeout 0.5").await;
    assert_eq!(ended.code, Some(7), "{ended:?}");
    assert!(
        never.lock().unwrap().len() > 1,
        "it was asked again for half a second"
    );
    impostor.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wait_with_an_early_reply_is_sent_again_after_a_delay() {
    let fixture = |text: &str| -> Value {
        let mut reply: Value = serde_json::from_str(text).unwrap();
        (reply["swarm"], reply["epoch"]) = (json!("demo"), json!(1));
        reply
    };
    let mut runs = fixture(include_str!("../../../../proto/fixtures/run.reply.json"));
    (runs["step"], runs["result"]["until_step"]) = (json!(0), json!(100));
    let mut there = fixture(include_str!("../../../../proto/fixtures/status.reply.json"));
    there["step"] = json!(100);
    let impostor = Impostor::start(&["jostle/demo/alive/a"], "jostle/x", "jostle/y").await;
    impostor.answer("jostle/demo/cmd/run", vec![Ok(runs)]).await;
    let early = || {
        let details = json!({"after_secs": 0.1, "limit": 1024});
        Err(json!({"code": "deadline_exceeded", "message": "ask again", "details": details}))
    };
    let asked = impostor
        .answer("jostle/demo/get/wait", vec![early(), early(), Ok(there)])
        .await;
    let began = Instant::now();
    let line = "--json run demo --until-step 100 --wait --timeout 60";
    let answer = object(&impostor.jostle(line).await);
    assert_eq!(answer["step"], 100);
    assert_eq!(asked.lock().unwrap().len(), 3, "early, early, there");
    // Two retry intervals of half a second.
    assert!(
        began.elapsed() >= Duration::from_secs(1),
        "{:?}",
        began.elapsed()
    );
    impostor.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn verbs_that_follow_print_once_that_the_daemon_is_gone() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    daemon.said("run demo").await;
    let link = Link::to(&daemon.endpoint);
    let begin = |line: &str| Running::begin(&link.endpoint, line, "");
    let mut watching = begin("watch demo");
    watching.lines(2);
    let mut following = begin("events demo --follow");
    following.lines(2);
    let mut looking = begin("top --interval 0.1");
    looking.lines(2);
    let mut waiting = begin("run demo --until 1e6 --wait");
    until("the run has an end", async || {
        daemon.reply("status demo").await["result"]["until_step"].is_u64()
    })
    .await;

    link.cut();
    let gone = "the daemon is gone; waiting for it to come back, Ctrl-C ends";
    assert_eq!(watching.complaint(), gone);
    assert_eq!(following.complaint(), gone);
    assert_eq!(looking.complaint(), gone);
    let said = waiting.complaint();
    assert!(
        said.starts_with("the daemon is gone; waiting up to 60 s"),
        "{said}"
    );

    link.mend();
    assert_eq!(watching.complaint(), "the daemon is back");
    assert_eq!(following.complaint(), "the daemon is back");
    watching.lines(1);
    looking.lines(1);
    daemon.said("delete demo").await;
    looking.interrupt();
    for (running, code) in [(watching, 0), (following, 0), (looking, 130), (waiting, 3)] {
        let ended = running.end().await;
        assert_eq!(ended.code, Some(code), "{ended:?}");
        assert!(!ended.stderr.contains("is gone"), "{ended:?}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wait_for_a_run_continues_when_its_daemon_is_restarted() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10 --seed 1").await;
    let waiting = daemon.begin("--json run demo --until-step 2000 --rate 10 --wait");
    until("the run is under way", async || {
        daemon.reply("status demo").await["step"].as_u64() > Some(100)
    })
    .await;
    let daemon = daemon.restart().await;
    let ended = waiting.end().await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let answer = ended.json_lines().pop().unwrap();
    assert_eq!(
        (&answer["step"], &answer["epoch"]),
        (&json!(2000), &json!(2))
    );
    daemon.stop().await;
}
