//! `/healthz` and `/metrics`.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::time::Instant;

use jostle_proto::{Metrics, NodeReply, keys};
use serde_json::json;

use crate::support::http::{get, health, of_daemon, send};
use crate::support::process::{Process, jostled};
use crate::support::{Client, Daemon, NODE, PREFIX, until};

/// Every series of `/metrics` by its name and labels, parsed strictly.
pub fn series(address: &str) -> BTreeMap<String, f64> {
    let (status, head, body) = get(address, "/metrics");
    assert_eq!(status, 200);
    assert!(head.contains("content-type: application/openmetrics-text; version=1.0.0"));
    let text = body.strip_suffix("# EOF\n").expect("it is all there");
    let (mut series, mut families) = (BTreeMap::new(), BTreeMap::new());
    let mut family = String::new();
    for line in text.lines() {
        if let Some(comment) = line.strip_prefix("# ") {
            let mut words = comment.splitn(3, ' ');
            let mut word = || words.next().expect(line);
            match (word(), word(), word()) {
                ("HELP", name, _) => family = name.to_owned(),
                ("TYPE", name, kind) => {
                    assert_eq!(name, family, "{line}");
                    let twice = families.insert(family.clone(), kind.to_owned());
                    assert_eq!(twice, None, "{line}");
                }
                ("UNIT", name, unit) => assert!(name.ends_with(unit) && name == family, "{line}"),
                _ => panic!("{line}"),
            }
            continue;
        }
        let (name, value) = line.rsplit_once(' ').unwrap();
        let plain = name.split('{').next().unwrap();
        let suffix = plain.strip_prefix(family.as_str()).expect(line);
        let is_right = match families[&family].as_str() {
            "counter" => suffix == "_total",
            "gauge" => suffix.is_empty(),
            "histogram" => ["_bucket", "_sum", "_count"].contains(&suffix),
            _ => false,
        };
        assert!(is_right && plain.starts_with("jostle_"), "{line}");
        let value: f64 = value.parse().expect(line);
        assert!(value.is_finite() && value.is_sign_positive(), "{line}");
        assert_eq!(series.insert(name.to_owned(), value), None, "{line}");
    }
    for (family, kind) in families {
        if kind == "histogram" {
            let start = format!("{family}_bucket{{le=\"");
            let bound = |name: &str| {
                let bound = name.strip_prefix(&start)?.strip_suffix("\"}")?;
                Some(bound.replace("+Inf", "inf").parse::<f64>().unwrap())
            };
            let buckets = series.iter();
            let mut buckets: Vec<(f64, f64)> = buckets
                .filter_map(|(name, count)| Some((bound(name)?, *count)))
                .collect();
            buckets.sort_by(|(a, _), (b, _)| a.total_cmp(b));
            assert!(buckets.is_sorted_by_key(|(_, count)| *count), "{family}");
            let last = (f64::INFINITY, series[&format!("{family}_count")]);
            assert_eq!(buckets.last(), Some(&last), "{family}");
        }
    }
    series
}

/// A daemon that fails at these points, its endpoint and its HTTP address.
fn serve_failing(points: &str) -> (Process, String, String) {
    let folder = tempfile::tempdir().unwrap();
    let mut command = jostled(&["--listen", "tcp/127.0.0.1:0", "--node", NODE]);
    command
        .args(["--http", "127.0.0.1:0", "--data-dir"])
        .arg(folder.path())
        .env("FAILPOINTS", points)
        .stdout(Stdio::piped());
    let mut process = Process(command.spawn().unwrap(), folder);
    let mut lines = BufReader::new(process.0.stdout.take().unwrap()).lines();
    let mut line = |start: &str| {
        let line = lines.next().unwrap().unwrap();
        line.strip_prefix(start).expect(&line).to_owned()
    };
    let endpoint = line("listening on ");
    let http = line("http on http://");
    (process, endpoint, http)
}

/// Waits until the daemon is healthy or not. Returns the codes of the reasons.
async fn until_healthy(http: &str, well: bool) -> BTreeSet<String> {
    let mut codes = BTreeSet::new();
    let began = Instant::now();
    until("another state of health", async || {
        let (status, report) = health(http);
        assert_eq!(status == 200, report["healthy"] == true, "{report}");
        let reasons = report["reasons"].as_array().unwrap().iter();
        codes = reasons
            .map(|reason| reason["code"].as_str().unwrap().to_owned())
            .collect();
        assert_eq!(status == 200, codes.is_empty(), "{report}");
        (status == 200) == well
    })
    .await;
    println!("well {well} after {:?}: {codes:?}", began.elapsed());
    codes
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_stuck_in_a_step_turns_health_red_and_its_end_green() {
    let (_daemon, endpoint, http) = serve_failing("step=3*off->1*sleep(9000)->off");
    let client = Client::open(&endpoint).await;
    client.create("a", json!({"n": 5})).await;
    // A swarm with one step in a thousand seconds waits, and is not stuck.
    client.create("slow", json!({"n": 5, "rate": 1e-5})).await;
    client.ok("slow", "run", json!({})).await;
    assert_eq!(health(&http).0, 200);
    client.ok("a", "run", json!({"rate": null})).await;
    let codes = until_healthy(&http, false).await;
    assert_eq!(codes, BTreeSet::from(["swarm_stuck".to_owned()]));
    let (_, report) = health(&http);
    let message = report["reasons"][0]["message"].as_str().unwrap();
    assert!(message.starts_with("swarm a "), "{report}");
    assert_eq!(series(&http)["jostle_healthy"], 0.0);
    until_healthy(&http, true).await;
    assert_eq!(series(&http)["jostle_healthy"], 1.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stuck_thread_of_the_daemon_turns_health_red_and_its_end_green() {
    let (_daemon, endpoint, http) = serve_failing("query=1*sleep(9000)->off");
    let client = Client::open(&endpoint).await;
    let key = keys::node_get(PREFIX, NODE, "hello");
    let (answer, codes) = tokio::join!(client.query(&key, None), until_healthy(&http, false));
    assert_eq!(codes, BTreeSet::from(["thread_stuck".to_owned()]));
    assert!(answer.is_ok());
    until_healthy(&http, true).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deaf_listener_turns_health_red_and_its_answer_green() {
    // Two failures in a row of each of its two listeners.
    let (_daemon, _, http) = serve_failing("probe=4*return->off");
    let codes = until_healthy(&http, false).await;
    assert_eq!(codes, BTreeSet::from(["listener_deaf".to_owned()]));
    until_healthy(&http, true).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_real_listener_replies_to_the_probe_which_opens_no_session() {
    let folder = tempfile::tempdir().unwrap();
    let socket = format!("unixsock-stream/{}/socket", folder.path().display());
    let listen = format!("tcp/127.0.0.1:0,{socket}");
    let daemon = Daemon::with(&[("listen", &listen)]).await;
    let http = of_daemon(&daemon);
    until("the answers to the probe", async || {
        series(&http).contains_key("jostle_probe_seconds")
    })
    .await;
    let report = daemon.server.watch.metrics();
    assert!(report.probe_secs.unwrap() < 2.0, "{report:?}");
    assert_eq!(report.reasons, []);
    until("the sessions to be counted", async || {
        series(&http)["jostle_sessions"] == 1.0
    })
    .await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn counters_increase_and_the_series_of_a_swarm_end_with_it() {
    let daemon = Daemon::start().await;
    let (client, http) = (&daemon.client, of_daemon(&daemon));
    let before = series(&http);
    client
        .create("a", json!({"n": 20, "seed": 1, "rate": 9}))
        .await;
    client.ok("a", "step", json!({"steps": 100})).await;
    client.ok("a", "run", json!({"until_step": 150})).await;
    client.wait_for_step("a", 150).await;
    let now = series(&http);
    let grown = |name: &str| now[name] - before[name];
    for (name, by) in [
        ("jostle_steps_total", 150.0),
        ("jostle_step_seconds_count", 150.0),
        ("jostle_step_lateness_seconds_count", 50.0),
        ("jostle_individuals", 20.0),
        ("jostle_swarms{phase=\"paused\"}", 1.0),
        ("jostle_faults_total", 0.0),
    ] {
        assert_eq!(grown(name), by, "{name}");
    }
    for name in [
        "jostle_step_seconds_sum",
        "jostle_journal_commit_seconds_count",
        "jostle_journal_writes_total",
        "jostle_residual_max",
        "jostle_cpu_seconds_total",
        "jostle_uptime_seconds",
    ] {
        assert!(grown(name) > 0.0, "{name}: {}", grown(name));
    }
    assert_eq!(now["jostle_swarm_steps_total{swarm=\"a\"}"], 150.0);
    assert!(now["jostle_swarm_contacts{swarm=\"a\"}"] > 0.0);

    let reply = client
        .query(&keys::node_get(PREFIX, NODE, "metrics"), None)
        .await;
    let report: NodeReply<Metrics> = serde_json::from_value(reply.unwrap()).unwrap();
    let metrics = report.result;
    assert_eq!((metrics.steps, metrics.unwell.len()), (150, 0));
    let [swarm] = &metrics.swarms[..] else {
        panic!("{metrics:?}");
    };
    assert_eq!((swarm.steps, swarm.due_steps, swarm.n), (150, 50, 20));
    assert!(swarm.contacts > 0 && swarm.step_secs > 0.0 && swarm.late_secs > 0.0);
    // Each metric of the swarm is its field of `get/metrics`. No two of these values are equal.
    let told = [
        ("steps_total", swarm.steps as f64),
        ("step_seconds_total", swarm.step_secs),
        ("step_lateness_seconds_total", swarm.late_secs),
        ("rate", swarm.rate.unwrap()),
        ("individuals", swarm.n as f64),
        ("contacts", swarm.contacts as f64),
        ("residual", swarm.residual),
    ];
    for (number, (name, value)) in told.iter().enumerate() {
        let name = format!("jostle_swarm_{name}{{swarm=\"a\"}}");
        let shown = now[&name];
        // A text of a duration has fewer digits.
        assert!(
            (shown - value).abs() <= 1e-6 * value.abs(),
            "{name}: {shown}, {value}"
        );
        assert!(
            told[..number].iter().all(|it| it.1 != *value),
            "{name}: {told:?}"
        );
    }

    client.ok("a", "delete", json!({})).await;
    let gone = series(&http);
    let left: Vec<&String> = gone.keys().filter(|name| name.contains("swarm=")).collect();
    assert_eq!(left, [""; 0]);
    for name in ["jostle_steps_total", "jostle_step_seconds_sum"] {
        assert_eq!(gone[name], now[name], "what was counted stays");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn deleted_swarms_leave_no_series() {
    let daemon = Daemon::start().await;
    let (client, http) = (&daemon.client, of_daemon(&daemon));
    // The probe's series exists after its first reply.
    let names = || {
        let names = series(&http).into_keys();
        let names = names.filter(|name| name != "jostle_probe_seconds");
        names.collect::<Vec<_>>()
    };
    let before = names();
    for number in 0..200 {
        let name = format!("s{number}");
        client.create(&name, json!({"n": 2})).await;
        client.ok(&name, "step", json!({"steps": 1})).await;
        client.ok(&name, "delete", json!({})).await;
    }
    assert_eq!(names(), before);
    assert_eq!(series(&http)["jostle_steps_total"], 200.0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn only_this_machine_by_its_own_name_is_answered_and_only_to_a_bare_get() {
    let daemon = Daemon::start().await;
    let http = of_daemon(&daemon);
    let port = http.rsplit_once(':').unwrap().1;
    let ask = |line: &str, headers: &str| {
        let request = format!("{line} HTTP/1.1\r\n{headers}Connection: close\r\n\r\n");
        let (status, head, _) = send(&http, &request);
        assert!(!head.contains("access-control"), "{head}");
        status
    };
    for path in ["/healthz", "/metrics"] {
        let line = format!("GET {path}");
        for host in [
            "localhost",
            &format!("localhost:{port}"),
            "[::1]:9",
            "127.0.0.1",
        ] {
            assert_eq!(ask(&line, &format!("Host: {host}\r\n")), 200, "{host}");
        }
        for foreign in [
            format!("Host: evil.example:{port}\r\n"),
            "Host: 127.0.0.1.evil.example\r\n".into(),
            "Host: localhost\r\nHost: evil.example\r\n".into(),
            "Host:\r\n".into(),
            String::new(),
        ] {
            let status = ask(&line, &foreign);
            assert!([400, 421].contains(&status), "{foreign}: {status}");
        }
        let elsewhere = format!("GET http://evil.example{path}");
        assert_eq!(ask(&elsewhere, "Host: localhost\r\n"), 421);
        let body = "Host: localhost\r\nContent-Length: 1000000000\r\n";
        assert_eq!(ask(&line, body), 413);
        let chunks = "Host: localhost\r\nTransfer-Encoding: chunked\r\n";
        assert_eq!(ask(&line, chunks), 413);
        assert_eq!(ask(&format!("POST {path}"), "Host: localhost\r\n"), 405);
    }
    assert_eq!(ask("GET /nothing", "Host: localhost\r\n"), 404);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_that_cannot_be_bound_is_rejected_with_the_flag_to_change() {
    let (_daemon, _, http) = serve_failing("");
    for (address, code, named) in [
        (http.as_str(), 1, "`--http 127.0.0.1:0`"),
        ("0.0.0.0:8080", 2, "other machines"),
        ("8080", 2, "--http \"8080\""),
    ] {
        let mut command = jostled(&["--listen", "tcp/127.0.0.1:0", "--http", address]);
        let folder = tempfile::tempdir().unwrap();
        let command = command.arg("--data-dir").arg(folder.path());
        let output = command.stderr(Stdio::piped()).output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{address}: {text}");
        assert!(text.contains(named), "{address}: {text}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_metrics_on_the_bus_count_each_client_at_once() {
    let daemon = Daemon::start().await;
    let mut others = Vec::new();
    // The health thread, which counts once a second, cannot have counted each of them.
    for count in 2..8 {
        others.push(daemon.another_client().await);
        let metrics = daemon.client.node("metrics").await;
        let status = daemon.client.node("status").await;
        assert_eq!(
            (&metrics["sessions"], &status["clients"]),
            (&json!(count), &json!(count))
        );
    }
    daemon.stop().await;
}
