//! The verbs that only read: parameters, journal, events, nodes, schemas.

use std::time::{Duration, SystemTime};

use jostle_client::{Client, ConnectOptions};
use jostle_proto::verbs::{Return, StepArgs};
use serde_json::{Value, json};

use crate::support::{Daemon, TIMEOUT, object};

/// Asserts that the second column of a line is the wall-clock time of a moment ago, in UTC.
fn assert_is_of_now(line: &str) {
    let when = line.split_whitespace().nth(1).unwrap();
    assert!(when.ends_with('Z') && when.len() == 24, "{line}");
    let since = humantime::parse_rfc3339(when).unwrap();
    // A millisecond is rounded up, too.
    let now = SystemTime::now() + Duration::from_millis(1);
    assert!(now.duration_since(since).unwrap() < 2 * TIMEOUT, "{line}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_status_says_how_many_states_are_published_and_whether_the_informed_disagree() {
    let daemon = Daemon::with(&[("max_hz", "50")]).await;
    daemon.said("create demo --n 4 --rate 10 --dt 0.02").await;
    let line = async |name: &str| {
        let status = daemon.said("status demo").await;
        let line = status.lines().find(|it| it.starts_with(name));
        line.map(|it| it.split_whitespace().skip(1).collect::<Vec<_>>().join(" "))
    };
    let set = daemon.said("set demo publish-every=1").await;
    assert!(
        set.contains("publishes at most 50 states a second"),
        "{set}"
    );
    let capped = "50 states a second, the daemon's max_hz, of 500";
    assert_eq!(line("published").await.as_deref(), Some(capped));
    let set = daemon.said("set demo publish-every=20").await;
    assert!(
        set.contains("publishes at most 25 states a second"),
        "{set}"
    );
    assert_eq!(line("published").await, None);

    assert_eq!(line("drift").await, None);
    daemon.said("inform demo --ids 0 --direction 0.5").await;
    let drift = line("drift").await.unwrap();
    assert!(drift.ends_with(", along 0.5 rad"), "{drift}");
    daemon.said("inform demo --ids 1 --direction 1.5").await;
    let drift = line("drift").await.unwrap();
    let apart = ", along 1 rad, the informed disagree: strength 0.878";
    assert!(drift.ends_with(apart), "{drift}");
    daemon.said("inform demo --ids 1 --direction 3.6416").await;
    let none =
        "undefined, the informed disagree: strength 0.000, below 0.1 they have no common direction";
    assert_eq!(line("drift").await.as_deref(), Some(none));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn measures_are_evaluated_and_listed() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    let reply = daemon.reply("measures demo milling order").await;
    let measures = reply["result"]["measures"].as_array().unwrap();
    let names: Vec<&Value> = measures.iter().map(|it| &it["name"]).collect();
    assert_eq!(names, ["milling", "order"]);
    let status = daemon.reply("status demo").await;
    assert_eq!(measures[1]["value"], status["result"]["order"]["order"]);
    // No individual is informed.
    let table = daemon.said("measures demo drift order").await;
    let words: Vec<&str> = table.split_whitespace().collect();
    assert!(
        words.windows(3).any(|it| it == ["drift", "-", "v0"]),
        "{table}"
    );
    assert!(table.starts_with("demo is paused at step 0"), "{table}");
    assert!(daemon.said("measures demo").await.contains("spread"));
    for (measure, part) in [
        ("ordr", "did you mean `order`?"),
        ("msd(5)", "column of an experiment"),
    ] {
        let error = daemon.refusal(&format!("measures demo {measure}")).await;
        let message = error["message"].as_str().unwrap();
        assert!(message.contains(part), "{error}");
        assert_eq!(error["code"], "invalid_argument");
    }
    // The list needs no daemon.
    let list = daemon.reply("measures --list").await;
    let msd = list["measures"].as_array().unwrap().last().unwrap().clone();
    assert_eq!(
        (&msd["name"], &msd["needs_past"]),
        (&json!("msd"), &json!(true))
    );
    assert_eq!(msd["argument"]["default"], Value::Null);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn parameters_are_listed_with_their_ranges_and_verbs() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10 --pi1 6 --rate max").await;
    let reply = daemon.reply("parameters demo").await;
    let parameters = reply["result"]["parameters"].as_array().unwrap();
    let pi1 = parameters.iter().find(|it| it["name"] == "pi1").unwrap();
    assert_eq!(
        (&pi1["value"], &pi1["maximum"]),
        (&json!(6.0), &json!(32.0))
    );
    let table = daemon.said("parameters demo").await;
    let line = |name: &str| {
        let is_its = |line: &&str| line.split_whitespace().next() == Some(name);
        let line = table
            .lines()
            .find(is_its)
            .unwrap_or_else(|| panic!("{name}: {table}"));
        line.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    assert_eq!(
        line("pi1"),
        "pi1 6 4 1 to 32 set Length over width of a body"
    );
    assert!(line("n").contains("inject, remove"));
    assert!(line("rate").starts_with("rate max 1 "));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_journal_lists_applied_commands_and_can_be_limited() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    let nothing = daemon.jostle("journal demo").await;
    assert_eq!((nothing.code, nothing.stdout.as_str()), (Some(0), ""));
    assert!(nothing.stderr.contains("no command yet"), "{nothing:?}");
    for pi3 in ["2", "3", "4"] {
        daemon.said(&format!("set demo pi3={pi3}")).await;
    }
    let table = daemon.said("journal demo").await;
    let lines: Vec<&str> = table.lines().collect();
    assert_eq!(lines.len(), 4, "{table}");
    assert!(
        lines[3].contains("tester@") && lines[3].ends_with("set pi3=4"),
        "{table}"
    );
    assert_eq!(
        lines[0].split_whitespace().collect::<Vec<_>>(),
        ["seq", "when", "epoch", "step", "time", "client", "command"]
    );
    lines[1..].iter().for_each(|line| assert_is_of_now(line));
    let seqs = |journal: &Value| {
        let entries = journal["result"]["entries"].as_array().unwrap();
        entries
            .iter()
            .map(|entry| entry["seq"].clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(seqs(&daemon.reply("journal demo").await), [1, 2, 3]);
    assert_eq!(seqs(&daemon.reply("journal demo --after 1").await), [2, 3]);
    assert_eq!(seqs(&daemon.reply("journal demo --limit 1").await), [3]);
    daemon.said("annotate demo ready").await;
    for line in ["journal demo", "events demo"] {
        let table = daemon.said(line).await;
        assert!(table.contains(r#"annotate "ready""#), "{line}: {table}");
    }
    let ended = daemon.jostle_with("annotate demo \u{7}", "").await;
    assert_eq!(ended.code, Some(2), "{ended:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn commands_of_a_journal_are_selected_by_step_verb_and_client() {
    let daemon = Daemon::start().await;
    for line in [
        "create demo --n 3",
        "set demo pi3=2",
        "step demo 5",
        "set demo pi3=3 --client ada@desk",
        "step demo 5",
    ] {
        daemon.said(line).await;
    }
    let seqs = async |line: &str| -> Vec<u64> {
        let journal = daemon.reply(&format!("journal demo {line}")).await;
        let entries = journal["result"]["entries"].as_array().unwrap().iter();
        entries.map(|it| it["seq"].as_u64().unwrap()).collect()
    };
    for (line, expected) in [
        ("--verb set", vec![1, 3]),
        ("--verb set --limit 1", vec![3]),
        ("--verb set --after 1", vec![3]),
        ("--from-step 5", vec![3, 4]),
        ("--to-step 4", vec![1, 2]),
        ("--from-step 5 --to-step 5 --verb step", vec![4]),
        ("--client ada@desk", vec![3]),
        ("--client ada", vec![]),
    ] {
        assert_eq!(seqs(line).await, expected, "{line}");
    }
    let ended = daemon.jostle("journal demo --verb inform").await;
    ended.assert_stderr(0, "demo has applied no such command yet");
    let ended = daemon.jostle("journal demo --verb informs").await;
    ended.assert_stderr(2, "is no verb of a swarm");
    // The journal of a fork does not have the commands before it.
    daemon.said("fork demo later").await;
    daemon.said("set later pi3=2").await;
    let ended = daemon.jostle("journal later --client nobody").await;
    assert_eq!(
        ended.stderr,
        "the commands up to seq 4 are no longer kept\nlater has applied no such command after seq 4"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_journal_of_many_pages_is_fetched_completely_or_from_its_end() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 3").await;
    daemon.said("set demo pi3=2").await;
    let client = Client::connect(ConnectOptions::to(&daemon.endpoint))
        .await
        .unwrap();
    for _ in 0..1_100 {
        let args = StepArgs {
            steps: 1,
            return_: Return::None,
        };
        client.execute("demo", &args).await.unwrap();
    }
    client.close().await;
    daemon.said("set demo pi3=3").await;
    // A batch of five changes is one command of five seqs.
    let change = json!({"verb": "set", "args": {"pi3": 2}}).to_string();
    let changes = format!("[{}]", vec![change; 5].join(","));
    let ended = daemon.jostle_with("batch demo -", &changes).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let from = |seq: u64| (seq..=1_102).chain([1_107]).collect();
    for (line, expected, left_out) in [
        ("journal demo --all", from(1), 0),
        ("journal demo", from(104), 103),
        ("journal demo --limit 1050", from(54), 53),
        ("journal demo --limit 3", from(1_101), 1_100),
        ("journal demo --limit 1", vec![1_107], 1_102),
        ("journal demo --limit 1 --after 1000", vec![1_107], 102),
        ("journal demo --limit 5000", from(1), 0),
        ("journal demo --verb set", vec![1, 1_102], 0),
        ("journal demo --verb set --limit 1", vec![1_102], 1),
        (
            "journal demo --verb step",
            (2..=1_101).skip(100).collect(),
            100,
        ),
        ("journal demo --from-step 1099", from(1_101), 0),
    ] {
        let journal = daemon.reply(line).await;
        let entries = journal["result"]["entries"].as_array().unwrap().iter();
        let seqs: Vec<u64> = entries.map(|it| it["seq"].as_u64().unwrap()).collect();
        assert_eq!(seqs, expected, "{line}");
        assert_eq!(journal["result"]["next"], Value::Null, "{line}");
        assert_eq!(journal["result"]["left_out"], left_out, "{line}");
    }
    let whole = daemon.said("journal demo").await;
    assert_eq!(whole.lines().count(), 1 + 1_103, "the text is whole");
    let ended = daemon.jostle("journal demo --verb set").await;
    assert_eq!(ended.stdout.lines().count(), 3, "{ended:?}");
    assert_eq!(ended.stderr, "", "nothing is missing: {ended:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_is_found_behind_pages_that_have_none() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 1").await;
    let client = Client::connect(ConnectOptions::to(&daemon.endpoint))
        .await
        .unwrap();
    // A page reads 10,000 lines of the journal, and each of these is one.
    let args = StepArgs {
        steps: 1,
        return_: Return::None,
    };
    for _ in 0..10_100 {
        client.execute("demo", &args).await.unwrap();
    }
    client.close().await;
    daemon.said("set demo pi3=3").await;
    for line in [
        "--verb set",
        "--from-step 10100 --verb set",
        "--verb set --limit 1",
    ] {
        let journal = daemon.reply(&format!("journal demo {line}")).await;
        let entries = journal["result"]["entries"].as_array().unwrap().iter();
        let seqs: Vec<_> = entries.map(|it| it["seq"].as_u64()).collect();
        assert_eq!(seqs, [Some(10_101)], "{line}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_journal_longer_than_a_reply_is_fetched_completely() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 3").await;
    for _ in 0..5 {
        let change = json!({"verb": "set", "args": {"pi3": 2}}).to_string();
        let changes = format!("[{}]", vec![change; 256].join(","));
        let ended = daemon.jostle_with("batch demo -", &changes).await;
        assert_eq!(ended.code, Some(0), "{ended:?}");
    }
    let journal = daemon.reply("journal demo").await;
    let entries = journal["result"]["entries"].as_array().unwrap();
    assert_eq!(entries.len(), 5);
    assert_eq!(entries[4]["seq"], 5 * 256);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn events_are_listed_and_followed_until_the_swarm_is_deleted() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    daemon.said("set demo pi3=2").await;
    let table = daemon.said("events demo").await;
    assert!(
        table.contains("created") && table.contains("set pi3=2 (seq 1, by tester@"),
        "{table}"
    );
    assert!(table.starts_with(" number  when"), "{table}");
    table.lines().skip(1).for_each(assert_is_of_now);
    let ended = daemon.jostle("--json events demo --limit 1").await;
    assert_eq!(object(&ended)["event"]["verb"], "set");
    assert!(object(&ended)["unix_secs"].as_f64() > Some(1.7e9));
    let last = object(&ended)["number"].as_u64().unwrap();

    // Of the past events the newest, then the next ones.
    let mut following = daemon.begin("--json events demo --follow --limit 1");
    let newest: Value = serde_json::from_str(&following.lines(1)[0]).unwrap();
    assert_eq!(newest["number"], last);
    daemon.said("set demo pi3=2.5").await;
    let next: Value = serde_json::from_str(&following.lines(1)[0]).unwrap();
    assert_eq!(next["number"], last + 1);
    following.interrupt();
    following.end().await;
    let last = last + 1;

    let line = format!("--json events demo --follow --after {last}");
    let mut following = daemon.begin(&line);
    daemon.said("set demo pi3=3").await;
    let event: Value = serde_json::from_str(&following.lines(1)[0]).unwrap();
    assert_eq!(
        event["number"],
        last + 1,
        "past events are not printed again"
    );
    assert_eq!(event["event"]["args"], json!({"pi3": 3}));
    daemon.said("delete demo").await;
    let ended = following.end().await;
    assert_eq!(
        (ended.code, ended.stderr.as_str()),
        (Some(0), ""),
        "{ended:?}"
    );
    let numbers: Vec<Value> = ended.json_lines();
    assert_eq!(numbers.last().unwrap()["event"]["kind"], "deleted");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn daemons_and_messages_are_listed() {
    let daemon = Daemon::start().await;
    let table = daemon.said("nodes").await;
    let words: Vec<Vec<&str>> = table
        .lines()
        .map(|line| line.split_whitespace().collect())
        .collect();
    assert_eq!(words[0][..3], ["node", "version", "wire"]);
    assert_eq!(words[0][7..], ["reserved_memory", "clients"]);
    assert_eq!(words[1][..3], ["test", env!("CARGO_PKG_VERSION"), "1"]);
    let nodes = daemon.reply("nodes").await;
    assert_eq!(nodes["nodes"][0]["hello"]["wire_version"], 1);

    let list = daemon.said("schema").await;
    assert!(
        list.lines().any(|line| line.starts_with("step.args  ")),
        "{list}"
    );
    let schema: Value = serde_json::from_str(&daemon.said("schema step.args").await).unwrap();
    assert_eq!(schema["additionalProperties"], false);
    assert_eq!(daemon.reply("schema step.args").await, schema);
    let of_verb = daemon.reply("schema step").await;
    let reply = daemon.reply("schema step.reply").await;
    assert_eq!(of_verb, json!({"step.args": schema, "step.reply": reply}));
    let printed = daemon.said("schema step").await;
    assert_eq!(serde_json::from_str::<Value>(&printed).unwrap(), of_verb);
    assert!(list.contains("\nexperiment.file  "), "{list}");
    let of_file = daemon.reply("schema experiment.file").await;
    assert_eq!(of_file, jostle_experiment::schema());
    let printed = daemon.said("schema experiment.file").await;
    assert_eq!(serde_json::from_str::<Value>(&printed).unwrap(), of_file);
    let unknown = daemon.refusal("schema experiment.fil").await;
    assert_eq!(unknown["details"]["nearest"][0], "experiment.file");
    let unknown = daemon.refusal("schema step.arg").await;
    assert_eq!(unknown["code"], "not_found");
    assert_eq!(unknown["details"]["nearest"], json!(["step.args"]));
    daemon.stop().await;
}
