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
async fn a_command_that_gets_no_reply_before_the_connection_is_lost_may_be_executed_and_says_so() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    let link = Link::to(&daemon.endpoint);
    link.lose_answers();
    let stepping = Running::begin(&link.endpoint, "step demo 3 --timeout 3", "");
    until("the command is carried out", async || {
        daemon.reply("status demo").await["step"] == 3
    })
    .await;
    link.cut();
    let ended = stepping.end().await;
    ended.assert_stderr(6, "no daemon answers at");
    ended.assert_stderr(
        6,
        "it may still execute the request if it is only suspended",
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_to_a_busy_daemon_is_retried_unchanged() {
    let impostor = Impostor::start(&["jostle/demo/alive/a"], "jostle/x", "jostle/y").await;
    let hello = include_str!("../../../../proto/fixtures/node.hello.reply.json");
    let hello = vec![Ok(serde_json::from_str(hello).unwrap())];
    impostor.answer("jostle/@node/a/get/hello", hello).await;
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
    // The daemon has less time for a later one.
    let without_timeout = |request: &Vec<u8>| {
        let mut request: Value = serde_json::from_slice(request).unwrap();
        assert!(request["timeout_secs"].take().as_f64() <= Some(60.0));
        request
    };
    let request = without_timeout(&requests[0]);
    assert!(requests.iter().all(|it| without_timeout(it) == request));
    assert!(!request["request_id"].as_str().unwrap().is_empty());
    assert!(request["client"].as_str().unwrap().starts_with("tester@"));

    let never = impostor.answer("jostle/demo/cmd/reset", vec![busy()]).await;
    let ended = impostor.jostle("--json reset demo --timeout 3").await;
    assert_eq!(ended.code, Some(7), "{ended:?}");
    assert!(
        never.lock().unwrap().len() > 1,
        "it was asked again for three seconds"
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
async fn a_wait_for_a_condition_is_continued_under_its_id() {
    let mut status: Value =
        serde_json::from_str(include_str!("../../../../proto/fixtures/status.reply.json")).unwrap();
    status["swarm"] = json!("demo");
    let impostor = Impostor::start(&["jostle/demo/alive/a"], "jostle/x", "jostle/y").await;
    let there = vec![Ok(status.clone())];
    impostor.answer("jostle/demo/get/status", there).await;
    let error = |code: &str| Err(json!({"code": code, "message": "ask again", "details": {}}));
    let answers = vec![
        error("deadline_exceeded"),
        error("busy"),
        error("deadline_exceeded"),
        Ok(status),
    ];
    let asked = impostor.answer("jostle/demo/get/wait", answers).await;
    // The daemon lets a duration go on for the same id and condition.
    let line = "--json wait demo order>0.9 --timeout 60";
    object(&impostor.jostle(line).await);
    let asked = asked.lock().unwrap().clone().into_iter();
    let asked: Vec<String> = asked.map(|it| String::from_utf8(it).unwrap()).collect();
    let wait = &asked[0][..asked[0].find("timeout_secs").unwrap()];
    assert!(wait.contains("condition=order>0.9;id="), "{wait}");
    assert!(asked.iter().all(|it| it.starts_with(wait)), "{asked:?}");
    assert_eq!(asked.len(), 4);
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
    // The command line has the reply to `run` before another one has begun and ended.
    daemon.said("status demo").await;
    daemon.said("status demo").await;

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
    assert_eq!(waiting.complaint(), "the daemon is back");
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
async fn verbs_that_wait_print_each_outage_and_its_end() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    let link = Link::to(&daemon.endpoint);
    let mut waiting = [
        "run demo --until 1e6 --rate 1 --wait",
        "wait demo milling>0.999999",
    ]
    .map(|line| Running::begin(&link.endpoint, line, ""));
    until("both wait", async || {
        let status = daemon.reply("status demo").await["result"].clone();
        status["until_step"].is_u64() && status["waits"].is_array()
    })
    .await;
    // Each outage has a minute of its own.
    for _ in 0..3 {
        link.cut();
        for verb in &mut waiting {
            assert_eq!(
                verb.complaint(),
                "the daemon is gone; waiting up to 60 s for it to come back, Ctrl-C ends"
            );
        }
        link.mend();
        for verb in &mut waiting {
            assert_eq!(verb.complaint(), "the daemon is back");
        }
    }
    daemon.said("delete demo").await;
    for verb in waiting {
        let ended = verb.end().await;
        assert_eq!(ended.code, Some(3), "{ended:?}");
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
