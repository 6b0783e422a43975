//! `top`.

use serde_json::json;

use crate::support::{Daemon, object};

#[tokio::test(flavor = "multi_thread")]
async fn top_shows_the_load_of_each_swarm_and_ends_after_count_screens() {
    let daemon = Daemon::start().await;
    daemon.said("create small --n 5 --rate max").await;
    daemon.said("create large --n 50 --rate max").await;
    daemon.said("create still --n 3").await;
    for name in ["small", "large"] {
        daemon.said(&format!("step {name} 400")).await;
    }
    let first_words = |text: &str, title: &str| {
        let lines = text.lines().skip_while(|line| !line.starts_with(title));
        lines
            .map_while(|line| line.split_whitespace().next().map(str::to_owned))
            .collect::<Vec<_>>()
    };
    let once = daemon.said("top -n 1").await;
    assert_eq!(
        first_words(&once, "swarm "),
        ["swarm", "large", "small", "still"]
    );
    assert!(once.starts_with("test  up "), "{once}");
    // No swarm steps now, so the rates are 0.
    let row = once
        .lines()
        .find(|line| line.starts_with("large "))
        .unwrap();
    let row: Vec<&str> = row.split_whitespace().collect();
    assert_eq!(row[6].parse(), Ok(0.0), "{once}");
    assert!(once.contains("steps 0/s"), "{once}");
    for word in [
        "cores",
        "resident memory",
        "clients 1",
        "commits",
        "faults 0",
    ] {
        assert!(once.contains(word), "{word}: {once}");
    }
    let by_name = daemon.said("top --count 1 --sort name").await;
    assert_eq!(
        first_words(&by_name, "swarm "),
        ["swarm", "large", "small", "still"]
    );

    // A swarm that cannot reach its rate comes first by factor.
    daemon.said("run large --rate 1e6").await;
    daemon.until_running("large").await;
    let twice = daemon.said("top -n 2 --interval 0.3 --sort factor").await;
    assert_eq!(twice.matches("\nswarm ").count(), 2, "{twice}");
    let last = twice.rsplit("residual").next().unwrap();
    let row = last.trim_start().lines().next().unwrap();
    let row: Vec<&str> = row.split_whitespace().collect();
    assert_eq!(row[..2], ["large", "running"], "{twice}");
    let (cost, step_us): (f64, f64) = (row[6].parse().unwrap(), row[7].parse().unwrap());
    assert!(cost > 1.0 && step_us > 1.0, "{row:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn with_json_a_screen_is_a_reply_as_received() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 5").await;
    daemon.said("step demo 7").await;
    let shown = object(&daemon.jostle("--json top -n 1").await);
    assert_eq!(shown["node"], "test");
    assert_eq!(shown["result"]["steps"], 7);
    assert_eq!(shown["result"]["swarms"][0]["swarm"], "demo");
    for sort in ["cost", "factor", "name"] {
        let refused = daemon.refusal(&format!("top -n 1 --sort {sort}")).await;
        assert_eq!(refused["code"], "invalid_argument");
        let message = refused["message"].as_str().unwrap();
        assert!(
            message.contains("--sort") && message.contains("--json"),
            "{message}"
        );
    }
    let lines = daemon.jostle("--json top -n 3 --interval 0.05").await;
    assert_eq!(lines.code, Some(0), "{lines:?}");
    let uptimes: Vec<f64> = lines
        .json_lines()
        .iter()
        .map(|line| line["result"]["uptime_secs"].as_f64().unwrap())
        .collect();
    assert!(uptimes.len() == 3 && uptimes.is_sorted(), "{uptimes:?}");

    let once = daemon.jostle("--json top --interval 0.05").await;
    assert_eq!(
        (once.code, once.json_lines().len()),
        (Some(0), 1),
        "{once:?}"
    );
    let mut looking = daemon.begin("--json top --interval 0.05 --count 1000000");
    looking.lines(2);
    looking.interrupt();
    assert_eq!(looking.end().await.code, Some(130));
    let refused = daemon.jostle("top --count 0").await;
    assert_eq!(refused.code, Some(2), "{refused:?}");
    assert_eq!(shown["result"]["unwell"], json!([]));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn patterns_and_conditions_select_the_swarms_of_list_and_top() {
    let daemon = Daemon::start().await;
    for (name, n) in [("test-1", 5), ("test-2", 20), ("demo", 20)] {
        daemon.said(&format!("create {name} --n {n}")).await;
    }
    daemon.said("run test-2 --rate 0.5").await;
    daemon.until_running("test-2").await;
    for (filter, expected) in [
        ("", &["demo", "test-1", "test-2"][..]),
        ("test-*", &["test-1", "test-2"]),
        ("demo test-1", &["demo", "test-1"]),
        ("--where n>=20", &["demo", "test-2"]),
        ("test-* --where n>=20", &["test-2"]),
        ("--where n>=20andphase=running", &["test-2"]),
        ("--where phase!=running", &["demo", "test-1"]),
        ("no-*", &[]),
    ] {
        // The blanks of a condition, which the line would split, may be left out but around words.
        let filter = filter.replace("20and", "20\nand\n");
        for verb in ["list", "top -n 1"] {
            let line = format!("{verb} {filter}").trim_end().to_owned();
            let swarms = daemon.reply(&line).await["result"]["swarms"].clone();
            let names = swarms.as_array().unwrap().iter();
            let names: Vec<_> = names
                .map(|it| it["swarm"].as_str().unwrap().to_owned())
                .collect();
            assert_eq!(names, expected, "{line}");
            let shown = daemon.jostle(&line).await;
            for name in ["demo", "test-1", "test-2"] {
                let is_shown = shown.stdout.contains(name);
                assert_eq!(is_shown, expected.contains(&name), "{line}: {shown:?}");
            }
        }
    }
    let wrong = daemon.jostle("list --where m=3").await;
    wrong.assert_stderr(2, "use one of n, informed, order");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn swarms_are_paused_run_and_deleted_by_what_holds_for_them() {
    let daemon = Daemon::start().await;
    for (name, n) in [("test-1", 5), ("test-2", 20), ("demo", 20)] {
        daemon.said(&format!("create {name} --n {n}")).await;
    }
    let phases = async || {
        let swarms = daemon.reply("list").await["result"]["swarms"].clone();
        let swarms = swarms.as_array().unwrap().iter();
        let phases: Vec<_> = swarms
            .map(|it| format!("{} {}", it["swarm"], it["phase"]).replace('"', ""))
            .collect();
        phases.join(", ")
    };
    for verb in ["run", "pause", "delete"] {
        let asked = daemon.jostle(&format!("{verb} test-*")).await;
        asked.assert_stderr(2, "it matches 2 swarms: test-1, test-2");
        let asked = daemon.jostle(&format!("{verb} --where n>6")).await;
        asked.assert_stderr(2, "it matches 2 swarms: demo, test-2");
        let none = daemon.jostle(&format!("{verb} --where n>600")).await;
        none.assert_stderr(3, "holds for no swarm");
    }
    daemon.said("run --where n>6 --yes --rate 0.5").await;
    assert_eq!(
        phases().await,
        "demo running, test-1 paused, test-2 running"
    );
    daemon.said("pause test-* --where phase=running -y").await;
    assert_eq!(phases().await, "demo running, test-1 paused, test-2 paused");
    daemon.said("run test-1 test-2 --rate 0.5").await;
    assert_eq!(
        phases().await,
        "demo running, test-1 running, test-2 running"
    );
    let both = daemon.jostle("pause test-1 nobody").await;
    both.assert_stderr(3, "nobody");
    let listed = daemon.jostle("list test-1 nobody").await;
    listed.assert_stderr(3, "nobody");
    assert_eq!(listed.stdout, "");
    assert_eq!(
        phases().await,
        "demo running, test-1 paused, test-2 running"
    );
    daemon
        .jostle("run test-* -y --wait")
        .await
        .assert_stderr(2, "--wait");
    daemon.said("delete --where phase=running --yes").await;
    assert_eq!(phases().await, "test-1 paused");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_condition_selects_among_named_swarms_too() {
    let daemon = Daemon::start().await;
    for (name, n) in [("small", 5), ("large", 20)] {
        daemon.said(&format!("create {name} --n {n}")).await;
    }
    for verb in ["run", "pause", "delete"] {
        let asked = daemon
            .jostle(&format!("{verb} small large --where n>6"))
            .await;
        asked.assert_stderr(2, "it matches 1 swarm: large");
        let none = daemon
            .jostle(&format!("{verb} small --where n>6 --yes"))
            .await;
        none.assert_stderr(3, "holds for no swarm");
        let absent = daemon
            .jostle(&format!("{verb} large nobody --where n>6 --yes"))
            .await;
        absent.assert_stderr(3, "nobody");
    }
    daemon.said("delete small large --where n>6 --yes").await;
    let left = daemon.reply("list").await["result"]["swarms"].clone();
    let names = left.as_array().unwrap().iter();
    let names: Vec<_> = names.map(|it| it["swarm"].clone()).collect();
    assert_eq!(names, ["small"]);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_that_begins_to_match_has_the_rates_of_one_interval() {
    let daemon = Daemon::start().await;
    daemon.said("create busy --n 100 --seed 1").await;
    daemon.said("step busy 30000 --timeout 60").await;
    let mut top = daemon.begin("top --where phase=running --count 2 --interval 10");
    // The first screen, in which it is paused.
    top.lines(2);
    daemon.said("run busy --rate 0.1").await;
    let ended = top.end().await;
    let header = ended.stdout.lines().rfind(|it| it.contains("cpu_%"));
    let row = ended.stdout.lines().rfind(|it| it.starts_with("busy"));
    let (Some(header), Some(row)) = (header, row) else {
        panic!("{ended:?}")
    };
    let place = header.split_whitespace().position(|it| it == "cpu_%");
    let share = row.split_whitespace().nth(place.unwrap()).unwrap();
    // Its 30,000 steps before would be more than 5 %.
    assert!(share.parse::<f64>().unwrap() < 2.0, "{ended:?}");
    daemon.stop().await;
}
