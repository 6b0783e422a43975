//! Recordings, experiments, and verbs without a daemon.

use jostle_proto::contract;
use serde_json::{Map, Value, json};

use crate::requests::row::{Row, row};

pub fn recordings() -> Vec<Row> {
    let fetched = |line, sends: &[&str]| {
        row(line, sends)
            .with(
                "get/recordings",
                "/result/recordings/2/phase",
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
        // The daemon records until the client stops it.
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
            "/result/recordings/2/phase",
            json!("ended"),
        )
        .writes("short.mcap"),
        row(
            "record <name>demo -o {}/published.mcap --published --for 0.2 --every 5",
            &["demo/state", "demo/get/status", "demo/get/spec"],
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

pub fn experiments() -> Vec<Row> {
    let submit = r#"@node/test/cmd/experiment {"submit": {"toml": "name = \"order\"\n"}}"#;
    let progress = "@node/test/experiment/small/progress";
    let results = "@node/test/experiment/small/results?after=0;limit=1000";
    // Each reply has three values and says that more follow.
    let series = [
        "@node/test/experiment/small/series?run=n=2 #0;after=0",
        "@node/test/experiment/small/series?run=n=2 #0;after=3",
        "@node/test/experiment/small/series?run=n=2 #1;after=0",
        "@node/test/experiment/small/series?run=n=2 #1;after=3",
        "@node/test/experiment/small/series?run=n=5 informed=1 #0;after=0",
        "@node/test/experiment/small/series?run=n=5 informed=1 #0;after=3",
        "@node/test/experiment/small/series?run=n=5 informed=1 #1;after=0",
        "@node/test/experiment/small/series?run=n=5 informed=1 #1;after=3",
    ];
    // The defaults are those of the documentation: `proto/contract/tests/contract/docs.rs` compares them.
    let parameters = contract::parameters().into_iter();
    let defaults = parameters.map(|it| (it.name, it.default));
    let mut spec: Map<String, Value> = defaults.filter(|(_, it)| !it.is_null()).collect();
    spec.extend([
        ("n".to_owned(), json!(3)),
        ("seed".to_owned(), json!(5_266_246_562_987_251_u64)),
        ("start".to_owned(), json!({"kind": "disc"})),
    ]);
    let created = json!({"name": "live", "exist_ok": false, "spec": spec});
    let created = format!("@node/test/cmd/create {created}");
    vec![
        row("experiment run <file>{}/order.toml --detach", &[submit]).says("submitted small"),
        row("experiment run <file>{}/order.toml", &[submit, progress]).says("; took 3"),
        row(
            "experiment run <file>{}/order.toml --again --detach",
            &[
                r#"@node/test/cmd/experiment {"submit": {"toml": "name = \"order\"\n",
                "again": true}}"#,
            ],
        ),
        row(
            "experiment run <file>{}/order.toml --name night --detach",
            &[
                r#"@node/test/cmd/experiment {"submit": {"toml": "name = \"order\"\n",
                "name": "night"}}"#,
            ],
        ),
        row(
            "experiment play <file>{}/grid.toml --run 2 --as live",
            &[&created],
        )
        .says("created live, the swarm of run \"#1\", and scheduled 0 commands"),
        row("experiment list", &["@node/test/get/experiments"]).says("small"),
        // Earlier daemons sent -0 for the share of an experiment without finished runs.
        row("experiment list", &["@node/test/get/experiments"])
            .with(
                "get/experiments",
                "/result/experiments/1/message",
                json!("too little memory"),
            )
            .with(
                "get/experiments",
                "/result/experiments/1/share",
                json!(-0.0),
            )
            .says("still is paused: too little memory")
            .says(" 0 %")
            .says_not("-0 %"),
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
        row("experiment results <name>small", &[results, progress])
            .says("v_pd")
            .says_not("n=5 informed=1 #0"),
        row(
            "experiment results <name>small --by run --limit 1",
            &[results, progress],
        )
        .says("n=2 #0"),
        row(
            "experiment results <name>small --by run --all",
            &[results, progress],
        )
        .says("n=2 #0"),
        row("experiment results <name>small --csv", &[results]).says("n=5 informed=1 #0,"),
        row(
            "experiment results <name>small --out {}/tables --force",
            &[&[results, progress][..], &series].concat(),
        )
        .writes("tables/results.csv")
        .writes("tables/results.parquet"),
        row(
            "experiment results <name>small -o {}/one.csv",
            &[results, progress],
        )
        .writes("one.csv"),
        row(
            "experiment results <name>small --order n=5",
            &["@node/test/experiment/small/order?run=n=5;after=0"],
        )
        .says("time,order,drift\n0,0.5821452720313459,-0.4931628207017643"),
        row(
            "experiment results <name>small --order n=5 --limit 50000",
            &["@node/test/experiment/small/order?run=n=5;after=0;limit=40000"],
        )
        .says("time,order,drift\n"),
        row(
            "experiment results <name>small --series n=5",
            &[
                "@node/test/experiment/small/series?run=n=5;after=0",
                "@node/test/experiment/small/series?run=n=5;after=3",
            ],
        )
        .says("run,step,time,order,drift\nn=5,0,0,0.5821452720313459,-0.4931628207017643"),
        row(
            "experiment results <name>small --trajectory n=5 -o {}/n5.parquet",
            &[
                "@node/test/experiment/small/series?run=n=5;after=0;of=individuals",
                "@node/test/experiment/small/series?run=n=5;after=3;of=individuals",
            ],
        )
        .writes("n5.parquet"),
        row(
            "plot <what>small --y order --over-time --out {}/over.svg",
            &[&[results, progress][..], &series].concat(),
        )
        .writes("over.svg"),
        row(
            "plot <what>snapshot <of>demo --out {}/demo.svg",
            &["demo/get/status", "demo/state"],
        )
        .writes("demo.svg"),
        row(
            "plot <what>snapshot <of>demo -o {}/demo.png",
            &["demo/get/status", "demo/state"],
        )
        .writes("demo.png"),
    ]
}

/// Verbs that need no daemon, and `doctor`.
pub fn local() -> Vec<Row> {
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
        row("man <verb>audit", &[]).says("Lists who sent which commands"),
        row("man --out {}/man", &[]).writes("man/jostle-run.1"),
        row("man -o {}/manual", &[]).writes("manual/jostle-run.1"),
        row("plot <what>2 <of>{}/results --out {}/two.svg", &[]).writes("two.svg"),
        row(
            "plot <what>{}/results --y v --x n --out {}/v.svg",
            &[],
        )
        .writes("v.svg"),
        row("experiment plan <file>{}/grid.toml", &[]).says("1/1"),
        row("experiment run <file>{}/grid.toml --dry-run", &[]).says("1 condition, 2 runs"),
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
