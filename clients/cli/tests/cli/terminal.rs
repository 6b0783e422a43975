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
    daemon.said("create test-3 --n 3").await;
    daemon.said("protect test-3").await;
    let swarms = async || object(&daemon.jostle("--json list").await)["result"]["swarms"].clone();
    for (answer, code, left) in [
        ("n\r", "130", 4),
        ("\r", "130", 4),
        ("\x04", "130", 4),
        ("y\r", "4", 2),
    ] {
        let mut terminal = Terminal::begin(&daemon.endpoint, "delete test-*");
        // The protected one is not counted.
        terminal.until_seen("delete 2 swarms? [y/N]").await;
        let seen = terminal.seen();
        assert!(seen.contains("test-1") && seen.contains("test-2"), "{seen}");
        assert_eq!(seen.matches("(protected: is not deleted)").count(), 1);
        assert!(seen.contains("test-3 (protected"), "{seen}");
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

#[tokio::test(flavor = "multi_thread")]
async fn top_scrolls_and_tables_fit_the_terminal() {
    let daemon = Daemon::start().await;
    for number in 10..40 {
        daemon.said(&format!("create s-{number} --n 2")).await;
    }
    let long = format!("z{}", "-long".repeat(12));
    daemon.said(&format!("create {long} --n 2")).await;
    daemon.said(&format!("when {long} order>=0 pause")).await;
    daemon.said(&format!("run {long}")).await;
    until("it has a reason", async || {
        !daemon.reply("list z*").await["result"]["swarms"][0]["reason"].is_null()
    })
    .await;
    let mut terminal = Terminal::begin(&daemon.endpoint, "top --sort name --interval 0.2");
    terminal.until_seen("1 to ").await;
    assert!(!terminal.seen().contains("z-long"), "{}", terminal.seen());
    terminal.press("\x1b[F");
    terminal.until_seen("of 31: ↑ ↓").await;
    terminal.until_seen("z-long").await;
    let seen = terminal.seen();
    assert!(seen.contains("cpu_%") && seen.contains('…'), "{seen}");
    terminal.press("q");
    assert_eq!(terminal.code().await, "0");

    let terminal = Terminal::begin(&daemon.endpoint, "list z* s-1*");
    terminal.until_seen("over.").await;
    let seen = terminal.seen();
    let lines = seen.lines().filter(|it| it.contains("paused"));
    let widths: Vec<usize> = lines.map(|it| it.trim_end().chars().count()).collect();
    assert!(
        widths.len() == 11 && widths.iter().all(|it| *it <= 80),
        "{seen}"
    );
    daemon.stop().await;
}

/// All characters that a keyboard types, and keys that send a sequence. Esc on its own is not among
/// them: what follows it at once makes a sequence with it.
fn keys() -> Vec<String> {
    let typed = (' '..='~').chain(['ä', '€']).map(String::from);
    let chords = ('a'..='z').filter(|it| !"cijmh".contains(*it));
    let controlled = chords.map(|it| char::from(it as u8 - b'a' + 1).to_string());
    let with_alt = [" ", "s", "S", "i", "q"].map(|it| format!("\x1b{it}"));
    let named = [
        "A", "B", "C", "D", "F", "H", "5~", "6~", "3~", "Z", "1;2A", "1;5B", "15~",
    ];
    let named = named.map(|it| format!("\x1b[{it}"));
    let backspace = "\x7f".to_owned();
    let all = typed.chain(controlled).chain(with_alt);
    all.chain(named).chain([backspace]).collect()
}

/// Waits until all that was pressed is handled, by a text in the filter, which it opens and closes: a
/// kilobyte at once is read in parts, the next one only after another key.
async fn settle(terminal: &mut Terminal, number: usize) {
    terminal.press(&format!("/{number}"));
    terminal.until_seen(&format!("/{number}▏")).await;
    terminal.press(&"\x7f".repeat(6));
}

#[tokio::test(flavor = "multi_thread")]
async fn no_key_of_any_mode_changes_a_swarm_that_it_is_not_meant_for() {
    let daemon = Daemon::start().await;
    for name in ["aaa", "mill", "school"] {
        daemon.said(&format!("create {name} --n 5")).await;
    }
    let names = ["aaa", "mill", "school"];
    let commands = async |name: &str| {
        let journal = daemon.reply(&format!("journal {name}")).await;
        journal["result"]["entries"].as_array().unwrap().len()
    };
    let mut terminal = Terminal::begin(&daemon.endpoint, "watch");
    terminal.until_seen("aaa ").await;
    terminal.until_seen("created").await;

    // What is typed into the filter is text, also before anything is drawn.
    terminal.press("/sch");
    terminal.until_seen("/sch▏ 1 of 3").await;
    terminal.press("\x7f\x7f\x7fmill");
    terminal.until_seen("/mill▏ 1 of 3").await;
    for (number, key) in keys().iter().enumerate() {
        // Emptied, which closes it, and opened again.
        terminal.press(&format!("{key}{}/", "\x7f".repeat(6)));
        if number % 30 == 29 {
            settle(&mut terminal, number).await;
            terminal.press("/");
        }
    }
    terminal.press(&format!("{}/nobody\r", "\x7f".repeat(6)));
    terminal.until_seen("no swarm matches nobody").await;
    terminal.press("sS i");
    terminal.until_seen("/nobodysS i▏ 0 of 3").await;
    terminal.press("\x1b");
    terminal.until_gone("nobody").await;

    settle(&mut terminal, 200).await;
    // The first key closes the list of keys, whatever else it does.
    for key in keys().iter().filter(|it| *it != "q") {
        terminal.press(&format!("?{key}"));
    }
    settle(&mut terminal, 201).await;
    // A paste is no keys.
    terminal.press("\x1b[200~ sSi\x1b[201~");
    terminal.until_seen("nothing was sent").await;
    // What is typed into the prompt is text.
    terminal.press("i");
    terminal.until_seen("inform some of").await;
    for key in keys() {
        terminal.press(&key);
    }
    terminal.press("\x1b");
    terminal.until_gone("inform some of").await;
    // Without a popup, only these keys steer.
    let steering = [" ", "s", "S", "i", "q", "?", "/"];
    for key in keys().iter().filter(|it| !steering.contains(&it.as_str())) {
        terminal.press(key);
    }
    settle(&mut terminal, 202).await;
    for name in names {
        assert_eq!(commands(name).await, 0, "{name}: {}", terminal.seen());
    }

    // A filter that is kept chooses the swarm that keys steer, and no other.
    terminal.press("/sch\r");
    terminal.until_seen("swarms /sch").await;
    terminal.press("s");
    terminal.until_seen("school is paused at step 1").await;
    assert_eq!([commands("aaa").await, commands("mill").await], [0, 0]);
    assert_eq!(commands("school").await, 1);
    terminal.press("q");
    assert_eq!(terminal.end().await, "0");
    daemon.stop().await;
}
