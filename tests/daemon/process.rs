//! The daemon as a process: its demo, its end, its exit codes, and panics.

use std::process::{Output, Stdio};

use jostle_proto::{ErrorCode, keys};
use serde_json::json;

use crate::support::process::{Process, jostled};
use crate::support::{Client, PREFIX};

#[tokio::test(flavor = "multi_thread")]
async fn sigterm_and_ctrl_c_end_it() {
    for signal in ["-TERM", "-INT"] {
        let (mut daemon, endpoint) = Process::serve();
        let client = Client::open(&endpoint).await;
        for i in 0..20 {
            let name = format!("s{i}");
            client.create(&name, json!({"n": 20, "rate": null})).await;
            client.ok(&name, "run", json!({})).await;
        }
        daemon.signal(signal);
        assert_eq!(daemon.end().0, Some(0), "{signal}");
    }
}

fn output(arguments: &[&str]) -> Output {
    let mut command = jostled(arguments);
    command.stderr(Stdio::piped()).output().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_demo_ends_by_itself_and_prints_its_result() {
    let demo = output(&["demo", "--for", "4s", "--listen", "tcp/127.0.0.1:0"]);
    let text = String::from_utf8(demo.stdout).unwrap();
    assert_eq!(demo.status.code(), Some(0), "{text}");
    let lines: Vec<&str> = text.lines().collect();
    assert!(
        lines.iter().any(|line| line.contains("real-time factor")),
        "{text}"
    );
    let last = lines.last().unwrap();
    assert!(last.starts_with("mean drift towards +x: "), "{last}");
    assert!(
        last.contains("(t = 0 to 50)") && last.contains("(t = 50 to 80)"),
        "{last}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_cannot_start_prints_the_remedy() {
    let (_daemon, endpoint) = Process::serve();
    let taken = output(&["--listen", &endpoint]);
    let text = String::from_utf8(taken.stderr).unwrap();
    assert_eq!(taken.status.code(), Some(1));
    assert!(text.contains("--listen tcp/127.0.0.1:0"), "{text}");

    for (arguments, named) in [
        (vec!["--listen", "tcp/0.0.0.0:7447"], "other machines"),
        (vec!["--node", "no/name"], "node"),
        (vec!["--max-hz", "often"], "--max-hz"),
        (vec!["--config", "/nowhere.toml"], "/nowhere.toml"),
        (vec!["--log", "=,="], "log"),
        (vec!["--wings"], "--wings"),
        (vec!["config", "explain", "--max-hz", "often"], "--max-hz"),
        (
            vec!["config", "explain", "--listen", "tcp/0.0.0.0:7447"],
            "other machines",
        ),
        (
            vec!["config", "explain", "--config", "/nowhere.toml"],
            "/nowhere.toml",
        ),
        (vec!["demo", "--for", "soon"], "soon"),
    ] {
        let output = output(&arguments);
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
        assert!(text.contains(named), "{arguments:?}: {text}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_in_a_command_is_an_internal_error_and_changes_nothing() {
    // The second and third change panic.
    let (_daemon, endpoint) = Process::serve_failing("command=1*off->2*panic->off");
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 5, "seed": 1})).await;
    client.ok("a", "inject", json!({"count": 1})).await;
    let before = client.get("a", "status").await;
    let inform = json!({"select": {"count": 2}, "direction": 1});
    let request = json!({"client": "me", "request_id": "1", "args": inform});
    for verb in ["inform", "batch"] {
        let request = match verb {
            "batch" => json!({"commands": [{"verb": "inform", "args": inform}]}),
            _ => request.clone(),
        };
        let error = client.cmd("a", verb, request).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::Internal, "{error:?}");
        assert_eq!(error.step, Some(0));
        assert_eq!(client.get("a", "status").await, before);
    }
    // The swarm continues as without these commands; their `request_id` may be used again.
    client.ok("a", "inform", request).await;
    client.create("b", json!({"n": 5, "seed": 1})).await;
    client.ok("b", "inject", json!({"count": 1})).await;
    client.ok("b", "inform", inform).await;
    assert_eq!(client.hash("a").await, client.hash("b").await);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_in_a_step_faults_its_swarm_and_no_other() {
    let (_daemon, endpoint) = Process::serve_failing("step=3*off->1*panic->off");
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 5})).await;
    client.create("b", json!({"n": 5})).await;
    let error = client.cmd("a", "step", json!({"steps": 9})).await;
    let error = error.unwrap_err();
    assert_eq!((error.code, error.step), (ErrorCode::Faulted, Some(3)));
    assert_eq!(client.get("a", "status").await["phase"], "faulted");
    let nine = client.ok("b", "step", json!({"steps": 9})).await;
    client.ok("a", "reset", json!({})).await;
    let again = client.ok("a", "step", json!({"steps": 9})).await;
    assert_eq!(again["result"]["state_hash"], nine["result"]["state_hash"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_in_reading_a_query_is_an_internal_error_and_the_daemon_continues() {
    let (_daemon, endpoint) = Process::serve_failing("query=1*panic->off");
    let client = Client::open(&endpoint).await;
    let key = keys::node_get(PREFIX, "test", "hello");
    let error = client.query(&key, None).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::Internal);
    assert!(client.query(&key, None).await.is_ok());
}

#[test]
fn the_manual_is_written_and_a_setting_without_effect_is_rejected() {
    let run = |line: &str| {
        let words: Vec<&str> = line.split(' ').collect();
        jostled(&words).stderr(Stdio::piped()).output().unwrap()
    };
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("pages");
    let written = run(&format!("man -o {}", pages.display()));
    assert!(written.status.success(), "{written:?}");
    let page = |name: &str| std::fs::read_to_string(pages.join(name)).unwrap();
    assert!(page("jostled.1").contains(r"\-\-listen"));
    assert!(page("jostled-demo.1").contains(r"\-\-listen"));
    let run_page = page("jostled-run.1");
    assert!(!run_page.contains(r"\-\-listen") && run_page.contains(r"\-\-threads"));
    for line in ["--listen tcp/127.0.0.1:0 man", "run a.toml -o b --log info"] {
        let output = run(line);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        let text = String::from_utf8(output.stderr).unwrap();
        assert!(text.contains("has no effect on `jostled "), "{text}");
    }
}
