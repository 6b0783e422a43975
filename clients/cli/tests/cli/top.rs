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
    for word in ["cores", "memory", "sessions", "commits", "faults 0"] {
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
    let lines = daemon.jostle("--json top -n 3 --interval 0.05").await;
    assert_eq!(lines.code, Some(0), "{lines:?}");
    let uptimes: Vec<f64> = lines
        .json_lines()
        .iter()
        .map(|line| line["result"]["uptime_secs"].as_f64().unwrap())
        .collect();
    assert!(uptimes.len() == 3 && uptimes.is_sorted(), "{uptimes:?}");

    let mut looking = daemon.begin("--json top --interval 0.05");
    looking.lines(2);
    looking.interrupt();
    assert_eq!(looking.end().await.code, Some(130));
    let refused = daemon.jostle("top --count 0").await;
    assert_eq!(refused.code, Some(2), "{refused:?}");
    assert_eq!(shown["result"]["unwell"], json!([]));
    daemon.stop().await;
}
