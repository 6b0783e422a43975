//! The verbs that create and change swarms.

use serde_json::{Map, Value, json};

use crate::requests::row::{Row, row};
use crate::support::canned;

/// The parameters that are a plain number: the name of each, the name of its option, and a value in its
/// range that is not the default and, of a real number, not that of another. `is_wanted` selects some.
fn numbers(is_wanted: impl Fn(&Value) -> bool) -> Vec<(String, String, Value)> {
    let reply = canned::read("parameters.reply");
    let parameters = reply["result"]["parameters"].as_array().unwrap().iter();
    let mut numbers = Vec::new();
    for (it, distinct) in parameters.zip(1_u32..) {
        let name = it["name"].as_str().unwrap();
        let bounds = [&it["minimum"], &it["exclusive_minimum"]];
        let least = bounds.into_iter().find_map(Value::as_f64).unwrap_or(0.0);
        let span = it["maximum"].as_f64().unwrap_or(f64::INFINITY) - least;
        let value = match it["kind"].as_str() {
            Some("integer") => {
                let whole = (least + span.min(f64::from(distinct))).to_string();
                json!(whole.parse::<u64>().unwrap())
            }
            Some("number") => json!(least + span.min(1.0) * f64::from(distinct) / 64.0),
            _ => continue,
        };
        if name != "n" && it["nullable"] == false && is_wanted(it) {
            assert_ne!(value, it["default"], "{name}");
            numbers.push((name.to_owned(), name.replace('_', "-"), value));
        }
    }
    numbers
}

/// Every option of `create` at once.
fn creating_with_everything() -> Row {
    let numbers = numbers(|it| it["name"] != "relinearise");
    let given = numbers
        .iter()
        .map(|(_, option, value)| format!("--{option} {value}"));
    let given: Vec<String> = given.collect();
    let mut spec = json!({
        "n": 7, "contacts": "closest", "stepping": "velocity", "relinearise": 3,
        "attraction": {"kind": "metric", "radius": 2.5}, "start": {"kind": "disc", "radius": 9.5},
        "rate": 3.5,
    });
    for (name, _, value) in numbers {
        spec[name] = value;
    }
    let args = json!({"name": "other", "exist_ok": true, "spec": spec});
    row(
        format!(
            "create <name>other -n 7 {} --contacts closest --stepping velocity --relinearise=3 \
             --attraction metric=2.5 --radius 9.5 --rate 3.5 --exist-ok",
            given.join(" ")
        ),
        &[&format!("@node/test/cmd/create {args}")],
    )
}

/// Every number that `set` changes at once.
fn setting_everything() -> Row {
    let of_set = |it: &Value| it["changed_by"].as_array().unwrap().contains(&json!("set"));
    let numbers = numbers(of_set);
    let given = numbers
        .iter()
        .map(|(_, option, value)| format!("{option}={value}"));
    let given: Vec<String> = given.collect();
    let mut args: Map<String, Value> = numbers
        .into_iter()
        .map(|(name, _, value)| (name, value))
        .collect();
    args.insert("make_room".to_owned(), json!(true));
    args.insert(
        "attraction".to_owned(),
        json!({"kind": "topological", "neighbours": 7}),
    );
    row(
        format!(
            "set <name>demo {} attraction=topological=7 --make-room",
            given.join(" ")
        ),
        &[&format!("demo/cmd/set {}", Value::Object(args))],
    )
}

pub fn creating() -> Vec<Row> {
    vec![
        row(
            "create <name>other --n 3",
            &[r#"@node/test/cmd/create {"name": "other", "spec": {"n": 3}, "exist_ok": false}"#],
        )
        .says("created school of 4 individuals"),
        creating_with_everything(),
        row(
            "create <name>other -n 2 --measures drift,milling --relinearise --accuracy 1e-6 --rate max",
            &[
                r#"@node/test/cmd/create {"name": "other", "exist_ok": false, "spec": {
                "n": 2, "measures": ["drift", "milling"], "relinearise": 1, "attraction": {"kind": "all", "accuracy": 0.000001},
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

pub fn steering() -> Vec<Row> {
    vec![
        row("run <names>demo", &["demo/cmd/run {}"]).says_not("waited"),
        row(
            "run <names>demo --until 2.5 --rate 4.5",
            &[r#"demo/cmd/run {"until_time": 2.5, "rate": 4.5}"#],
        ),
        row(
            "run <names>demo --until-step 151 --rate max",
            &[r#"demo/cmd/run {"until_step": 151, "rate": null}"#],
        ),
        row(
            "run <names>demo --until-step 77 --wait",
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
        row(
            "run <names>test-* --yes",
            &["test-1/cmd/run {}", "test-2/cmd/run {}"],
        ),
        row(
            "run --where n>3 -y",
            &["@node/test/get/swarms", "school/cmd/run {}"],
        ),
        row("pause <names>demo", &["demo/cmd/pause {}"]).says("school is paused at step"),
        row(
            "pause <names>test-* --yes",
            &["test-1/cmd/pause {}", "test-2/cmd/pause {}"],
        ),
        row(
            "pause --where phase=paused -y",
            &[
                "@node/test/get/swarms",
                "pair/cmd/pause {}",
                "school/cmd/pause {}",
            ],
        ),
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
        setting_everything(),
        row(
            "leave <name>demo <controller>ada",
            &[r#"demo/cmd/leave {"controller": "ada"}"#],
        )
        .says("ada has left school"),
        row(
            "when <name>demo <condition>order>0.9 <action>pause",
            &[r#"demo/cmd/when {"condition": "order>0.9", "pause": true}"#],
        ),
        row(
            "when <name>demo <condition>order>0.9 --commands {}/batch.json",
            &[r#"demo/cmd/when {"condition": "order>0.9", "commands": [
                {"verb": "set", "args": {"pi3": 2}}, {"verb": "remove", "args": {"select": {"count": 1}}}]}"#],
        ),
        row(
            "when <name>demo --cancel",
            &[r#"demo/cmd/when {"cancel": true}"#],
        ),
        row(
            "when <name>demo --cancel 3f9c01be",
            &[r#"demo/cmd/when {"cancel": true, "id": "3f9c01be"}"#],
        )
        .says("no longer waits for the condition 3f9c01be"),
        row("when <name>demo", &["demo/get/status"]),
        row(
            "run <names>demo --until order>0.9",
            &[
                r#"demo/cmd/when {"condition": "order>0.9", "pause": true}"#,
                "demo/cmd/run {}",
            ],
        ),
        row(
            "wait <name>demo <condition>order>0.9",
            &[
                "demo/get/status",
                "demo/get/wait?condition=order>0.9;id=ID;timeout_secs=30",
            ],
        )
        .says("order>0.9 holds"),
        row(
            "annotate <name>demo <text>ready",
            &[r#"demo/cmd/annotate {"text": "ready"}"#],
        )
        .says("crowd has the note (seq 8)"),
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
        row("protect <names>demo", &[r#"demo/cmd/protect {"on": true}"#])
            .says("kept is protected from delete and reset"),
        row(
            "protect <names>demo --off",
            &[r#"demo/cmd/protect {"on": false}"#],
        )
        .says("kept is no longer protected"),
        row(
            "protect <names>test-* --yes",
            &[
                r#"test-1/cmd/protect {"on": true}"#,
                r#"test-2/cmd/protect {"on": true}"#,
            ],
        ),
        row(
            "protect --where n<3 -y",
            &["@node/test/get/swarms", r#"pair/cmd/protect {"on": true}"#],
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
            "delete --where n<3 --yes",
            &["@node/test/get/swarms", "pair/cmd/delete {}"],
        ),
        row(
            "delete <names>demo --node test",
            &[r#"@node/test/cmd/discard {"name": "demo"}"#],
        ),
    ]
}

pub fn individuals() -> Vec<Row> {
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
            "inform <name>demo --informed --direction 2.5",
            &[r#"demo/cmd/inform {"select": {"informed": true}, "direction": 2.5}"#],
        ),
        row(
            "inform <name>demo --uninformed --direction 2.5",
            &[r#"demo/cmd/inform {"select": {"informed": false}, "direction": 2.5}"#],
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
            "uninform <name>demo --informed",
            &[r#"demo/cmd/uninform {"select": {"informed": true}}"#],
        ),
        row(
            "uninform <name>demo --uninformed",
            &[r#"demo/cmd/uninform {"select": {"informed": false}}"#],
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
            "remove <name>demo --informed",
            &[r#"demo/cmd/remove {"select": {"informed": true}}"#],
        ),
        row(
            "remove <name>demo --uninformed",
            &[r#"demo/cmd/remove {"select": {"informed": false}}"#],
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

pub fn copies() -> Vec<Row> {
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
            "export <what>demo -o {}/demo.html --wasm {}/jostle.wasm.gz",
            &["demo/get/experiment"],
        )
        .writes("demo.html")
        .says("{}/demo.html"),
        row("export <what>demo -o {}/present", &[])
            .ends_with(2)
            .says("--force replaces it"),
        row(
            "export <what>demo --out {}/replaced --force --wasm {}/jostle.wasm.gz",
            &["demo/get/experiment"],
        )
        .writes("replaced")
        .says("{}/replaced"),
        row(
            "export <what>{}/grid.toml --run 2 --no-engine -o {}/grid.html",
            &[],
        )
        .writes("grid.html")
        .says("#1"),
        row("check <file>{}/claimed.html", &[]).says("equal"),
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
        row("verify <name>demo", &["demo/get/verify?timeout_secs=3600"]).says("school is the same"),
    ]
}
