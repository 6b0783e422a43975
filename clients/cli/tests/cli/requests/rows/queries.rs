//! The verbs that read swarms and daemons.

use serde_json::{Value, json};

use crate::requests::row::{Row, row};

pub fn inspecting() -> Vec<Row> {
    let mut rows =
        vec![
        row("list", &["@node/test/get/swarms"]).says("pair"),
        row("list <names>sch* --where n>3", &["@node/test/get/swarms"])
            .says("school")
            .says_not("pair"),
        row("status <name>demo", &["demo/get/status"]).says("school"),
        row("parameters <name>demo", &["demo/get/parameters"]).says("pi1"),
        row(
            "measures <name>demo --histogram pair_correlation --bins 50 --max 2.5",
            &["demo/get/measures?histogram=pair_correlation;bins=50;max=2.5"],
        ),
        row("measures --list", &[]).says("conditions and experiments only"),
        row("measures <name>demo", &["demo/get/measures"]).says("milling"),
        row(
            "measures <name>demo <measures>order <measures>clusters.count(0.1)",
            &["demo/get/measures?names=order,clusters.count(0.1)"],
        )
        .says("milling"),
        row("controllers <name>demo", &["demo/get/controllers"]).says("bob"),
        row("spec <name>demo", &["demo/get/spec"]).says("\"pi1\": "),
        row(
            "journal <name>demo",
            &["demo/get/journal?after=0;limit=1000"],
        )
        .says("steps=50")
        .says("inform"),
        row(
            "journal <name>demo --as-experiment",
            &["demo/get/experiment"],
        )
        .says("[spec]"),
        row(
            "journal <name>demo --as-experiment --replicates 20",
            &["demo/get/experiment?replicates=20"],
        )
        .says("[spec]"),
        row(
            "journal <name>demo --as-experiment --replicates 2 -o {}/found.toml",
            &["demo/get/experiment?replicates=2;setpoints=found.setpoints.csv"],
        )
        .says("found.toml"),
        row(
            "journal <name>demo --as-experiment --out {}/found.toml",
            &["demo/get/experiment?setpoints=found.setpoints.csv"],
        )
        .says("found.toml"),
        row(
            "journal <name>demo --after 1 --limit 1",
            &["demo/get/journal?after=1;limit=1000"],
        )
        .says("return=\"state\"")
        .says_not("inform"),
        row("journal <name>demo --all", &["demo/get/journal?after=0;limit=1000"]).says("inform"),
        row(
            "journal <name>demo --from-step 3 --to-step 90 --verb inform --client ada",
            &[
                "demo/get/journal?after=0;limit=1000;from_step=3;to_step=90;verb=inform;client=ada",
                "demo/get/journal?after=0;limit=1",
            ],
        )
        .says("inform"),
        // The reply has the same next line again, after which there is none.
        row(
            "journal <name>demo",
            &[
                "demo/get/journal?after=0;limit=1000",
                "demo/get/journal?after=0;limit=1000;line=5",
            ],
        )
        .with("get/journal", "/result/next", json!(5)),
        // The reply has the lines 1 to 4, and names an earlier one.
        row(
            "audit",
            &[
                "@node/test/get/audit?before=18446744073709551615;limit=100",
                "@node/test/get/audit?before=1;limit=96",
            ],
        )
        .with("get/audit", "/result/oldest", json!(0))
        .with("get/audit", "/result/lines/2/count", json!(60))
        .says("2026-11-24T14:40:01Z")
        .says("experiment cancel")
        .says("ok 1, conflict 1, unknown 58"),
        row(
            "audit --limit 3 --user olga --client ada --verb delete --name school \
             --since 2026-11-28T07:00 --until 2026-11-28T07:00:00.5Z",
            &[
                "@node/test/get/audit?before=18446744073709551615;limit=3;user=olga;client=ada;\
                 verb=delete;name=school;from_time=1795849200;to_time=1795849200.5",
            ],
        ),
        row(
            "audit --all",
            &[
                "@node/test/get/audit?before=18446744073709551615;limit=1000",
                "@node/test/get/audit?before=1;limit=1000",
            ],
        )
        .with("get/audit", "/result/oldest", json!(0))
        .says("permission_denied"),
        row("nodes", &["@node/test/get/hello", "@node/test/get/status"]).says("test"),
        row("events <name>demo", &["demo/get/events?after=0;limit=1000"])
            .says("step return=\"none\"")
            .says("seq 6"),
        row(
            "events <name>demo --after 5 --limit 1",
            &["demo/get/events?after=5;limit=1000"],
        )
        .says("seq 6")
        .says_not("seq 5"),
        row(
            "events <name>demo --follow",
            &["demo/get/events?after=0;limit=1000"],
        )
        .goes_on_after("seq 6"),
        row(
            "events <name>demo -f",
            &["demo/get/events?after=0;limit=1000"],
        )
        .goes_on_after("seq 6"),
        row("auth whoami", &["@node/test/get/whoami"]).says("anna, controller on lab"),
        row("auth can <verb>join", &["@node/test/get/whoami"]).says("you may join"),
        row("auth can <verb>pause", &["@node/test/get/whoami"]).ends_with(5),
        row("schema", &["@node/test/get/schema"])
            .says("pause.args")
            .says("reset.args"),
        row("schema <message>pause.args", &["@node/test/get/schema"])
            .says("PauseArgs")
            .says_not("reset.args"),
        row("top --count 1", &["@node/test/get/metrics"]).says("cores"),
        row(
            "top --count 1 <names>sch* --where n>3",
            &[
                "@node/test/get/metrics",
                "@node/test/get/swarms",
                "@node/test/get/metrics",
            ],
        )
        .says("school")
        .says_not("shoal"),
        row("top -n 2 --interval 2 --json", &["@node/test/get/metrics"]).lasts(1.5),
    ];
    // The first screen takes two queries.
    let sorted = [
        (
            "top -n 1 --sort cost",
            ["dogwood", "ash", "elm", "cedar", "birch"],
        ),
        (
            "top -n 1 --sort factor",
            ["elm", "cedar", "birch", "ash", "dogwood"],
        ),
        (
            "top -n 1 --sort name",
            ["ash", "birch", "cedar", "dogwood", "elm"],
        ),
    ];
    for (line, order) in sorted {
        let row = row(line, &["@node/test/get/metrics"]);
        rows.push(
            row.with("get/metrics", "/result/swarms", costs())
                .lists(&order),
        );
    }
    rows
}

/// Five swarms of which each key of `top --sort` gives another order, none the order they come in
/// or its reverse: name, computing in two seconds (in 0.1 s), rate, real-time factor.
fn costs() -> Value {
    let swarm = |(name, cost, rate, factor): (&str, u32, Option<f64>, Option<f64>)| {
        json!({
            "swarm": name, "phase": "running", "step": 9, "n": 5, "rate": rate,
            "real_time_factor": factor, "steps": 9, "step_secs": 1.5, "due_steps": 9,
            "late_secs": 0.5, "contacts": cost, "residual": 0.0, "degraded": 0, "faults": 0,
        })
    };
    let swarms = [
        ("birch", 1, Some(4.0), Some(4.0)),
        ("elm", 4, Some(1.0), Some(0.2)),
        ("ash", 5, None, Some(3.0)),
        ("dogwood", 7, Some(2.0), None),
        ("cedar", 3, Some(10.0), Some(5.0)),
    ];
    swarms.map(swarm).to_vec().into()
}

pub fn watching() -> Vec<Row> {
    let looks = ["demo/get/status", "demo/state"];
    vec![
        row("watch <name>demo --count 1", &looks[..1])
            .says("0.561")
            .says_not("\"x\":"),
        row("watch <name>demo --count 1 --frames", &looks)
            .says("\"x\":")
            .says("\"alpha\":"),
        row("watch <name>demo --for 0.2", &looks[..1]).says("0.561"),
    ]
}
