//! The table: what each argument of each verb changes in the requests, or in the output.

use serde_json::{Value, json};

use crate::requests::row::{Row, row};

/// Every row. The first of a verb has no option that another row leaves out.
pub fn rows() -> Vec<Row> {
    [
        creating(),
        steering(),
        individuals(),
        copies(),
        looking(),
        watching(),
        recordings(),
        experiments(),
        local(),
    ]
    .concat()
}

fn creating() -> Vec<Row> {
    vec![
        row(
            "create <name>other --n 3",
            &[r#"@node/test/cmd/create {"name": "other", "spec": {"n": 3}, "exist_ok": false}"#],
        )
        .says("created school of 4 individuals"),
        row(
            "create <name>other -n 7 --pi1 1.5 --pi2 0.25 --pi3 2.5 --pi4 12.5 --dt 0.01 \
             --contacts closest --stepping velocity --relinearise=3 --attraction metric=2.5 \
             --noise 0.125 --seed 11 --radius 9.5 --publish-every 13 --rate 3.5 --exist-ok",
            &[
                r#"@node/test/cmd/create {"name": "other", "exist_ok": true, "spec": {
                "n": 7, "pi1": 1.5, "pi2": 0.25, "pi3": 2.5, "pi4": 12.5, "dt": 0.01,
                "contacts": "closest", "stepping": "velocity", "relinearise": 3,
                "attraction": {"kind": "metric", "radius": 2.5}, "noise": 0.125, "seed": 11,
                "start": {"kind": "disc", "radius": 9.5}, "publish_every": 13, "rate": 3.5}}"#,
            ],
        ),
        row(
            "create <name>other -n 2 --relinearise --accuracy 1e-6 --rate max",
            &[
                r#"@node/test/cmd/create {"name": "other", "exist_ok": false, "spec": {
                "n": 2, "relinearise": 1, "attraction": {"kind": "all", "accuracy": 0.000001},
                "rate": null}}"#,
            ],
        ),
        row(
            "create <name>other --spec {}/spec.json --pi1 2.5",
            &[
                r#"@node/test/cmd/create {"name": "other", "exist_ok": false, "spec": {
                "n": 9, "pi1": 2.5, "seed": 4}}"#,
            ],
        ),
    ]
}

fn steering() -> Vec<Row> {
    vec![
        row("run <name>demo", &["demo/cmd/run {}"]).says_not("waited"),
        row(
            "run <name>demo --until 2.5 --rate 4.5",
            &[r#"demo/cmd/run {"until_time": 2.5, "rate": 4.5}"#],
        ),
        row(
            "run <name>demo --until-step 151 --rate max",
            &[r#"demo/cmd/run {"until_step": 151, "rate": null}"#],
        ),
        row(
            "run <name>demo --until-step 77 --wait",
            &[
                r#"demo/cmd/run {"until_step": 77}"#,
                "school/get/wait?step=78;timeout_secs=30",
            ],
        )
        .with("cmd/run", "/result/until_step", json!(78))
        .with("cmd/run", "/epoch", json!(1))
        .with("get/wait", "/step", json!(78))
        .with("get/wait", "/epoch", json!(1))
        .says("waited"),
        row("pause <name>demo", &["demo/cmd/pause {}"]).says("school is paused at step"),
        row(
            "step <name>demo",
            &[r#"demo/cmd/step {"steps": 1, "return": "none"}"#],
        )
        .says_not("\"state\""),
        row(
            "step <name>demo <steps>17 --state",
            &[r#"demo/cmd/step {"steps": 17, "return": "state"}"#],
        )
        .says("\"certificate\":"),
        row("reset <name>demo", &["demo/cmd/reset {}"]).says("school is paused at step"),
        row(
            "reset <name>demo --seed 12",
            &[r#"demo/cmd/reset {"seed": 12}"#],
        ),
        row(
            "set <name>demo <assignments>pi3=2",
            &[r#"demo/cmd/set {"pi3": 2}"#],
        ),
        row(
            "set <name>demo pi1=6.5 attraction=topological=7 publish-every=9 --make-room",
            &[
                r#"demo/cmd/set {"pi1": 6.5, "publish_every": 9, "make_room": true,
                "attraction": {"kind": "topological", "neighbours": 7}}"#,
            ],
        ),
        row(
            "leave <name>demo <controller>ada",
            &[r#"demo/cmd/leave {"controller": "ada"}"#],
        )
        .says("ada has left school"),
        row(
            "annotate <name>demo <text>ready",
            &[r#"demo/cmd/annotate {"text": "ready"}"#],
        )
        .says("crowd has the note (seq 4)"),
        row(
            "batch <name>demo <file>{}/batch.json",
            &[r#"demo/cmd/batch {"commands": [
                {"verb": "set", "args": {"pi3": 2}}, {"verb": "remove", "args": {"select": {"count": 1}}}]}"#],
        ),
        row(
            "seek <name>demo --step 31",
            &[r#"demo/cmd/seek {"step": 31}"#],
        ),
        row(
            "seek <name>demo --time 4.5",
            &[r#"demo/cmd/seek {"time": 4.5}"#],
        ),
        row(
            "seek <name>demo --fraction 25%",
            &[r#"demo/cmd/seek {"fraction": 0.25}"#],
        ),
        row("delete <names>demo", &["demo/cmd/delete {}"]).says("deleted school"),
        row(
            "delete <names>demo twin",
            &["demo/cmd/delete {}", "twin/cmd/delete {}"],
        ),
        row("delete <names>test-*", &[])
            .ends_with(2)
            .says("2 swarms: test-1, test-2"),
        row(
            "delete <names>test-* --yes",
            &["test-1/cmd/delete {}", "test-2/cmd/delete {}"],
        ),
        row(
            "delete <names>test-? -y",
            &["test-1/cmd/delete {}", "test-2/cmd/delete {}"],
        ),
        row(
            "delete <names>demo --node test",
            &[r#"@node/test/cmd/discard {"name": "demo"}"#],
        ),
    ]
}

fn individuals() -> Vec<Row> {
    vec![
        row(
            "inform <name>demo --count 3 --direction 0.5",
            &[r#"demo/cmd/inform {"select": {"count": 3}, "direction": 0.5}"#],
        )
        .says("informed"),
        row(
            "inform <name>demo --ids 1,4-6 --degrees 180 --weight 0.75 --for-time 8.5",
            &[
                r#"demo/cmd/inform {"select": {"ids": [1, 4, 5, 6]}, "direction": 3.141592653589793,
                "weight": 0.75, "for_time": 8.5}"#,
            ],
        ),
        row(
            "inform <name>demo --fraction 20% --direction -1.5",
            &[r#"demo/cmd/inform {"select": {"fraction": 0.2}, "direction": -1.5}"#],
        ),
        row(
            "inform <name>demo --within 1.5,-2.5,3.5 --direction 0.5",
            &[
                r#"demo/cmd/inform {"select": {"within": {"x": 1.5, "y": -2.5, "radius": 3.5}},
                "direction": 0.5}"#,
            ],
        ),
        row(
            "inform <name>demo --foremost 4 --along 1.25 --direction 0.5",
            &[
                r#"demo/cmd/inform {"select": {"foremost": {"count": 4, "along": 1.25}},
                "direction": 0.5}"#,
            ],
        ),
        row(
            "uninform <name>demo --count 3",
            &[r#"demo/cmd/uninform {"select": {"count": 3}}"#],
        )
        .says("uninformed"),
        row(
            "uninform <name>demo --ids 2,5-7",
            &[r#"demo/cmd/uninform {"select": {"ids": [2, 5, 6, 7]}}"#],
        ),
        row(
            "uninform <name>demo --fraction 0.3",
            &[r#"demo/cmd/uninform {"select": {"fraction": 0.3}}"#],
        ),
        row(
            "uninform <name>demo --within -1.5,2.5,4.5",
            &[r#"demo/cmd/uninform {"select": {"within": {"x": -1.5, "y": 2.5, "radius": 4.5}}}"#],
        ),
        row(
            "uninform <name>demo --foremost 2 --along -0.25",
            &[r#"demo/cmd/uninform {"select": {"foremost": {"count": 2, "along": -0.25}}}"#],
        ),
        row(
            "remove <name>demo --count 4",
            &[r#"demo/cmd/remove {"select": {"count": 4}}"#],
        )
        .says("removed"),
        row(
            "remove <name>demo --ids 3",
            &[r#"demo/cmd/remove {"select": {"ids": [3]}}"#],
        ),
        row(
            "remove <name>demo --fraction 40%",
            &[r#"demo/cmd/remove {"select": {"fraction": 0.4}}"#],
        ),
        row(
            "remove <name>demo --within 0.5,1.5,2.5",
            &[r#"demo/cmd/remove {"select": {"within": {"x": 0.5, "y": 1.5, "radius": 2.5}}}"#],
        ),
        row(
            "remove <name>demo --foremost 6 --along 2.25",
            &[r#"demo/cmd/remove {"select": {"foremost": {"count": 6, "along": 2.25}}}"#],
        ),
        row(
            "inject <name>demo --count 2",
            &[r#"demo/cmd/inject {"count": 2}"#],
        )
        .says("injected"),
        row(
            "inject <name>demo --count 5 --within 1.5,2.5,6.5 --direction -0.5 --weight 1.5",
            &[
                r#"demo/cmd/inject {"count": 5, "within": {"x": 1.5, "y": 2.5, "radius": 6.5},
                "direction": -0.5, "weight": 1.5}"#,
            ],
        ),
        row(
            "inject <name>demo --at 1.5,-2.5,0.5 --at 3.5,4.5,-0.25 --degrees -90",
            &[
                r#"demo/cmd/inject {"at": [{"x": 1.5, "y": -2.5, "alpha": 0.5},
                {"x": 3.5, "y": 4.5, "alpha": -0.25}], "direction": -1.5707963267948966}"#,
            ],
        ),
    ]
}

fn copies() -> Vec<Row> {
    vec![
        row(
            "fork <name>demo <copy>other",
            &[r#"demo/cmd/fork {"name": "other"}"#],
        )
        .says("forked school-2 from demo"),
        row(
            "fork <name>demo <copy>other --at-step 40",
            &[r#"demo/cmd/fork {"name": "other", "step": 40}"#],
        ),
        row(
            "snapshot <name>demo --out {}/first.snapshot",
            &["demo/get/snapshot"],
        )
        .writes("first.snapshot")
        .says("{}/first.snapshot"),
        row("snapshot <name>demo -o {}/present", &[])
            .ends_with(2)
            .says("--force replaces it"),
        row(
            "snapshot <name>demo -o {}/replaced --force",
            &["demo/get/snapshot"],
        )
        .writes("replaced")
        .says("{}/replaced"),
        row(
            "restore <file>{}/demo.snapshot",
            &[r#"@node/test/cmd/restore {"name": "crowd", "snapshot": "<snapshot>"}"#],
        )
        .says("restored"),
        row(
            "restore <file>{}/demo.snapshot <name>other",
            &[r#"@node/test/cmd/restore {"name": "other", "snapshot": "<snapshot>"}"#],
        ),
        row(
            "diff <one>demo <other>twin",
            &[
                "demo/get/spec",
                "demo/get/status",
                "demo/state",
                "demo/get/journal?after=0;limit=1000",
                "twin/get/spec",
                "twin/get/status",
                "twin/state",
                "twin/get/journal?after=0;limit=1000",
            ],
        )
        .says("no command differs"),
        row("verify <name>demo", &["demo/get/verify"]).says("school is the same"),
    ]
}

fn looking() -> Vec<Row> {
    let mut rows = vec![
        row("list", &["@node/test/get/swarms"]).says("pair"),
        row("list --watch", &["@node/test/get/swarms"]).again_after(2, 0.5),
        row("status <name>demo", &["demo/get/status"]).says("school"),
        row("parameters <name>demo", &["demo/get/parameters"]).says("pi1"),
        row("controllers <name>demo", &["demo/get/controllers"]).says("bob"),
        row("spec <name>demo", &["demo/get/spec"]).says("\"pi1\": "),
        row(
            "journal <name>demo",
            &["demo/get/journal?after=0;limit=1000"],
        )
        .says("steps=50")
        .says("inform"),
        row(
            "journal <name>demo --after 1 --limit 1",
            &["demo/get/journal?after=1;limit=1000"],
        )
        .says("return=\"state\"")
        .says_not("inform"),
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
        row("top -n 2 --interval 2 --json", &["@node/test/get/metrics"]).lasts(1.5),
    ];
    // Looks again after 1 s, unless another interval is given.
    let again = [
        ("list -w 2", "@node/test/get/swarms"),
        ("status <name>demo --watch 2", "demo/get/status"),
        ("status <name>demo -w 2", "demo/get/status"),
        ("parameters <name>demo --watch 2", "demo/get/parameters"),
        ("parameters <name>demo -w 2", "demo/get/parameters"),
        ("controllers <name>demo --watch 2", "demo/get/controllers"),
        ("controllers <name>demo -w 2", "demo/get/controllers"),
        ("spec <name>demo --watch 2", "demo/get/spec"),
        ("spec <name>demo -w 2", "demo/get/spec"),
        (
            "journal <name>demo --watch 2",
            "demo/get/journal?after=0;limit=1000",
        ),
        (
            "journal <name>demo -w 2",
            "demo/get/journal?after=0;limit=1000",
        ),
    ];
    for (line, sends) in again {
        rows.push(row(line, &[sends]).again_after(2, 1.5));
    }
    let node = ["hello", "status", "hello"].map(|noun| format!("@node/test/get/{noun}"));
    for line in ["nodes --watch 2", "nodes -w 2"] {
        let sends = node.each_ref().map(String::as_str);
        rows.push(row(line, &sends).again_after(3, 1.5));
    }
    // A look is two queries the first time.
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

fn watching() -> Vec<Row> {
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

fn recordings() -> Vec<Row> {
    let fetched = |line, sends: &[&str]| {
        row(line, sends)
            .with(
                "get/recordings",
                "/result/recordings/1/phase",
                json!("ended"),
            )
            .with("cmd/record", "/result/phase", json!("ended"))
            .with("cmd/record", "/result/temporary", json!(true))
    };
    vec![
        row(
            "record --stop take",
            &[r#"@node/test/cmd/record {"stop": {"recording": "take"}}"#],
        ),
        row(
            "record --delete take",
            &[r#"@node/test/cmd/record {"delete": {"recording": "take"}}"#],
        )
        .says("deleted"),
        row("record --list", &["@node/test/get/recordings"]).says("school-1"),
        row(
            "record <name>demo --at-daemon",
            &[r#"@node/test/cmd/record {"begin": {"swarm": "demo"}}"#],
        )
        .says("the daemon records"),
        row(
            "record <name>demo --at-daemon --as night --every 15 --steps 400 --drop-when-behind \
             --max-size 5MB",
            &[
                r#"@node/test/cmd/record {"begin": {"swarm": "demo", "recording": "night",
                "every": 15, "steps": 400, "drop_when_behind": true,
                "max_bytes": 5000000}}"#,
            ],
        ),
        fetched(
            "record <name>demo --out {}/fetched.mcap --every 10 --steps 99 --drop-when-behind \
             --max-size 2KiB",
            &[
                r#"@node/test/cmd/record {"begin": {"swarm": "demo", "every": 10,
                    "steps": 99, "drop_when_behind": true, "max_bytes": 2048, "temporary": true}}"#,
                r#"@node/test/cmd/record {"delete": {"recording": "school-1"}}"#,
            ],
        )
        .writes("fetched.mcap"),
        fetched("record <name>demo -o {}/present.mcap", &[])
            .ends_with(2)
            .says("--force replaces it"),
        fetched(
            "record <name>demo -o {}/replaced.mcap --force",
            &[
                r#"@node/test/cmd/record {"begin": {"swarm": "demo",
                    "temporary": true}}"#,
                r#"@node/test/cmd/record {"delete": {"recording": "school-1"}}"#,
            ],
        )
        .says("to {}/replaced.mcap"),
        // The recording goes on until the client stops it.
        row(
            "record <name>demo -o {}/short.mcap --for 0.1",
            &[
                r#"@node/test/cmd/record {"begin": {"swarm": "demo",
                    "temporary": true}}"#,
                r#"@node/test/cmd/record {"stop": {"recording": "school-1"}}"#,
                "@node/test/get/recordings",
                r#"@node/test/cmd/record {"delete": {"recording": "school-1"}}"#,
            ],
        )
        .with(
            "get/recordings",
            "/result/recordings/1/phase",
            json!("ended"),
        )
        .writes("short.mcap"),
        row(
            "record <name>demo -o {}/published.mcap --published --for 0.2 --every 5",
            &["demo/get/status", "demo/get/spec", "demo/state"],
        )
        .writes("published.mcap")
        .says("of those that it published"),
        fetched(
            "record --fetch school-1 -o {}/kept.mcap",
            &[
                "@node/test/get/recordings",
                r#"@node/test/cmd/record {"delete": {"recording": "school-1"}}"#,
            ],
        )
        .writes("kept.mcap"),
        row("record --recover {}/killed.mcap", &[])
            .ends_with(2)
            .says("holds no state"),
        row(
            "replay <file>{}/tape.mcap",
            &[
                r#"@node/test/cmd/replay {"upload": {"name": "tape", "offset": 0, "length": 5,
                    "bytes": "dGFwZQo="}}"#,
                r#"@node/test/cmd/replay {"open": {"name": "tape"}}"#,
                "tape/cmd/run {}",
            ],
        )
        .with_unnamed(&["upload", "tape/cmd/run"])
        .says("runs at rate"),
        row(
            "replay <file>{}/tape.mcap --as show --rate 2.5",
            &[
                r#"@node/test/cmd/replay {"upload": {"name": "show", "offset": 0, "length": 5,
                    "bytes": "dGFwZQo="}}"#,
                r#"@node/test/cmd/replay {"open": {"name": "show"}}"#,
                r#"show/cmd/run {"rate": 2.5}"#,
            ],
        ),
        row(
            "replay --recording take --paused",
            &[r#"@node/test/cmd/replay {"open": {"name": "take", "recording": "take"}}"#],
        )
        .says("is paused at its first frame"),
    ]
}

fn experiments() -> Vec<Row> {
    let submit = r#"@node/test/cmd/experiment {"submit": {"toml": "name = \"order\"\n"}}"#;
    let progress = "@node/test/experiment/small/progress";
    let results = "@node/test/experiment/small/results?after=0;limit=1000";
    vec![
        row("experiment run <file>{}/order.toml --detach", &[submit]).says("submitted small"),
        row("experiment run <file>{}/order.toml", &[submit, progress]).says("; took 3"),
        row(
            "experiment run <file>{}/order.toml --name night --detach",
            &[
                r#"@node/test/cmd/experiment {"submit": {"toml": "name = \"order\"\n",
                "name": "night"}}"#,
            ],
        ),
        row("experiment list", &["@node/test/get/experiments"]).says("small"),
        row("experiment status <name>small", &[progress]).says("small is finished, 4 of 4"),
        row("experiment attach <name>small", &[progress]).says("; took 3"),
        row(
            "experiment pause <name>small",
            &[r#"@node/test/cmd/experiment {"pause": {"name": "small"}}"#],
        ),
        row(
            "experiment resume <name>small",
            &[r#"@node/test/cmd/experiment {"resume": {"name": "small"}}"#],
        ),
        row(
            "experiment cancel <name>small",
            &[r#"@node/test/cmd/experiment {"cancel": {"name": "small"}}"#],
        ),
        row(
            "experiment delete <name>small",
            &[r#"@node/test/cmd/experiment {"delete": {"name": "small"}}"#],
        )
        .says("deleted small"),
        row("experiment results <name>small", &[results])
            .says("v_pd")
            .says_not("n=5 informed=1 #0"),
        row("experiment results <name>small --csv", &[results]).says("n=5 informed=1 #0,"),
        row("experiment results <name>small --out {}/tables", &[results])
            .writes("tables/results.csv")
            .writes("tables/results.parquet"),
        row("experiment results <name>small -o {}/one.csv", &[results]).writes("one.csv"),
        row(
            "experiment results <name>small --order n=5",
            &["@node/test/experiment/small/order?run=n=5;after=0"],
        )
        .says("time,order,drift\n0,0.5821452720313459,-0.4931628207017643"),
        row(
            "figure <kind>snapshot <of>demo --out {}/demo.svg",
            &["demo/get/status", "demo/state"],
        )
        .writes("demo.svg"),
        row(
            "figure <kind>snapshot <of>demo -o {}/demo.png",
            &["demo/get/status", "demo/state"],
        )
        .writes("demo.png"),
    ]
}

/// What is done without a daemon, and what is only looked at.
fn local() -> Vec<Row> {
    vec![
        row(
            "auth link --credentials {}/me --page http://page.example/",
            &[],
        )
        .says("http://page.example/#token=secret"),
        row("completions <shell>bash", &[]).says("JOSTLE_COMPLETE=bash"),
        row("completions <shell>zsh", &[]).says("JOSTLE_COMPLETE=zsh"),
        row("completions <shell>fish", &[]).says("JOSTLE_COMPLETE=fish"),
        row("completions <shell>elvish", &[]).says("JOSTLE_COMPLETE = elvish"),
        row("completions <shell>powershell", &[]).says("powershell"),
        row("man", &[]).says(".TH jostle"),
        row("man --out {}/man", &[]).writes("man/jostle-run.1"),
        row("man -o {}/manual", &[]).writes("manual/jostle-run.1"),
        row("figure <kind>2 <of>{}/results --out {}/two.svg", &[]).writes("two.svg"),
        row("experiment plan <file>{}/grid.toml", &[]).says("1/1"),
        row(
            "experiment plan <file>{}/grid.toml --parts 2 --emit slurm --out {}/parts",
            &[],
        )
        .says("#SBATCH --array=1,2\n")
        .says(" -o {}/parts/part-"),
        row(
            "experiment plan <file>{}/grid.toml --secs 60 --emit jsonl -o parts --missing {}/parts/one",
            &[],
        )
        .says(r#""runs":"2""#)
        .says(r#""parts/runs-2""#),
        row("results merge <parts>{}/parts --out {}/merged", &[])
            .says("merged 2 runs from 2 parts into")
            .writes("merged/results.csv")
            .writes("merged/results.parquet"),
        row(
            "results merge <parts>{}/parts -o {}/verified --verify 100% --threads 1",
            &[],
        )
        .says("executed 2 runs again, with the same results")
        .writes("verified/results.csv"),
        row("claims <results>{}/results", &[]),
        row("claims <results>{}/results --animations {}/results", &[]),
        row("claims <results>{}/results --page {}/page.md", &[]).writes("page.md"),
        row(
            "claims <results>{}/results --make-bands {}/bands.csv --runs 4",
            &[],
        )
        .writes("bands.csv"),
        row("claims <results>{}/results --bands {}/old-bands.csv", &[]),
        row("--version", &[]).says("jostle "),
        row("-V", &[]).says("jostle "),
        row(
            "doctor",
            &[
                "@node/test/get/hello",
                "@node/test/get/status",
                "@node/test/get/hello",
                "@node/test/get/metrics",
                "@node/test/get/swarms",
                "pair/get/status",
                "@node/test/cmd/no-such-verb-of-the-doctor",
                "pair/cmd/no-such-verb-of-the-doctor",
            ],
        )
        .ends_with(1)
        .says("connection"),
    ]
}
