//! `watch` on a terminal: keys, drawings, and the restored terminal.

use crate::support::{Daemon, Terminal, object, until};

async fn is(daemon: &Daemon, phase: &str) {
    until(phase, async || {
        let status = object(&daemon.jostle("--json status demo").await);
        status["phase"] == phase
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn keys_steer_the_swarm_that_is_watched() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    daemon.said("run demo").await;
    let mut terminal = Terminal::begin(&daemon.endpoint, "watch");
    terminal.until_seen("running").await;
    terminal.press(" ");
    is(&daemon, "paused").await;
    terminal.until_seen("demo is paused at step").await;

    let step = object(&daemon.jostle("--json status demo").await)["step"].clone();
    terminal.press("S");
    until("a hundred steps", async || {
        let now = object(&daemon.jostle("--json status demo").await);
        now["step"].as_u64() == step.as_u64().map(|step| step + 100)
    })
    .await;

    // The first answer is 10%, of ten; the second is typed.
    terminal.press("i");
    terminal.until_seen("inform some of demo").await;
    terminal.press("\t\x7f\x7f90d\r\r");
    terminal.until_seen("informed 1 individual of demo").await;
    let status = object(&daemon.jostle("--json status demo").await);
    assert_eq!(status["result"]["informed"], 1);
    let direction = status["result"]["order"]["direction"].as_f64().unwrap();
    assert!((direction - std::f64::consts::FRAC_PI_2).abs() < 1e-9);

    terminal.press(" ");
    is(&daemon, "running").await;
    terminal.press("s");
    terminal
        .until_seen("the swarm is running: pause it first")
        .await;
    terminal.press("q");
    assert_eq!(terminal.end().await, "0");
    is(&daemon, "running").await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_terminal_is_restored_however_the_view_ends() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    for (how, code) in [
        ("-INT", "130"),
        ("-TERM", "130"),
        ("^C", "130"),
        ("for", "0"),
    ] {
        let line = if how == "for" {
            "watch demo --for 1"
        } else {
            "watch demo"
        };
        let mut terminal = Terminal::begin(&daemon.endpoint, line);
        terminal.until_seen("created").await;
        match how {
            "for" => {}
            "^C" => terminal.press("\x03"),
            signal => terminal.signal(signal),
        }
        assert_eq!(terminal.end().await, code, "{how}");
    }
    let missing = Terminal::begin(&daemon.endpoint, "watch dmeo");
    missing.until_seen("did you mean `demo`?").await;
    assert!(
        !missing.seen().contains("\x1b[?1049h"),
        "the screen was not taken"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_view_survives_the_daemon_and_its_swarms() {
    let daemon = Daemon::start().await;
    let mut terminal = Terminal::begin(&daemon.endpoint, "watch");
    terminal.until_seen("no swarms here").await;
    daemon.said("create demo --n 10").await;
    terminal.until_seen("created").await;
    let daemon = daemon.restart().await;
    terminal.until_seen("the daemon is back").await;
    daemon.said("create other --n 3").await;
    daemon.said("delete demo").await;
    terminal.until_seen("demo is no longer there").await;
    terminal.press("q");
    assert_eq!(terminal.end().await, "0");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn on_a_terminal_delete_lists_the_matches_of_a_pattern_and_requires_confirmation() {
    let daemon = Daemon::start().await;
    for name in ["test-1", "test-2", "demo"] {
        daemon.said(&format!("create {name} --n 3")).await;
    }
    let swarms = async || object(&daemon.jostle("--json list").await)["result"]["swarms"].clone();
    for (answer, code, left) in [
        ("n\r", "130", 3),
        ("\r", "130", 3),
        ("\x04", "130", 3),
        ("y\r", "0", 1),
    ] {
        let mut terminal = Terminal::begin(&daemon.endpoint, "delete test-*");
        terminal.until_seen("delete 2 swarms? [y/N]").await;
        let seen = terminal.seen();
        assert!(seen.contains("test-1") && seen.contains("test-2"), "{seen}");
        assert!(!seen.contains("demo"), "{seen}");
        terminal.press(answer);
        assert_eq!(terminal.code().await, code, "{answer:?}");
        assert_eq!(swarms().await.as_array().unwrap().len(), left, "{answer:?}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn verify_shows_its_progress_on_a_terminal_and_nowhere_else() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 100 --seed 2").await;
    // Long enough for some intervals of the progress: how many steps that are depends on the machine and
    // on what else runs on it, since a replay has a low priority.
    let mut percents: Vec<u32> = Vec::new();
    for _ in 0..5 {
        daemon.said("step demo 6000 --timeout 60").await;
        let terminal = Terminal::begin(&daemon.endpoint, "verify demo");
        terminal.until_seen("demo is the same").await;
        let seen = terminal.seen();
        let shown = seen
            .split('%')
            .filter_map(|it| it.split(' ').next_back()?.parse().ok());
        percents = shown.collect();
        assert!(percents.is_sorted(), "{percents:?}");
        assert_eq!(terminal.code().await, "0");
        if percents.iter().any(|it| (1..100).contains(it)) {
            break;
        }
    }
    assert!(
        percents.iter().any(|it| (1..100).contains(it)),
        "{percents:?}"
    );

    let terminal = Terminal::begin(&daemon.endpoint, "--json verify demo");
    terminal.until_seen("over.").await;
    assert!(!terminal.seen().contains('%'), "{}", terminal.seen());
    let ended = daemon.jostle("verify demo").await;
    assert_eq!(
        (ended.code, ended.stderr.as_str()),
        (Some(0), ""),
        "{ended:?}"
    );
    assert_eq!(
        object(&daemon.jostle("--json status demo").await)["result"]["verifying"],
        serde_json::Value::Null
    );
    daemon.stop().await;
}
