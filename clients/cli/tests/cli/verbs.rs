//! One request and its reply: JSON, text and exit code.

use std::fs;

use jostle_proto::{EarlierModel, Snapshot, to_cbor};
use serde_json::{Value, json};

use crate::support::{Daemon, Impostor, object};

#[tokio::test(flavor = "multi_thread")]
async fn with_json_every_verb_prints_the_reply_as_received() {
    let daemon = Daemon::start().await;
    let reply = async |line: &str| daemon.reply(line).await;

    assert_eq!(reply("list").await["result"]["swarms"], json!([]));
    let created = reply("create demo --n 20 --seed 3 --pi1 5 --rate max --radius 9").await;
    assert_eq!(created["result"]["created"], true);
    let spec = &created["result"]["spec"];
    assert_eq!(
        (&spec["seed"], &spec["pi1"], &spec["rate"]),
        (&json!(3), &json!(5.0), &Value::Null)
    );
    assert_eq!(spec["start"], json!({"kind": "disc", "radius": 9.0}));
    let again = reply("create demo --n 20 --seed 3 --pi1 5 --rate max --radius 9 --exist-ok").await;
    assert_eq!(again["result"]["created"], false);
    assert_eq!(reply("list").await["result"]["swarms"][0]["swarm"], "demo");
    assert_eq!(reply("status demo").await["result"]["n"], 20);
    assert_eq!(reply("spec demo").await["result"]["seed"], 3);

    assert_eq!(reply("step demo").await["step"], 1);
    assert_eq!(reply("step demo 4").await["step"], 5);
    let stepped = reply("step demo 2 --state").await;
    assert_eq!(stepped["step"], 7);
    assert_eq!(
        stepped["result"]["state"]["x"].as_array().unwrap().len(),
        20
    );

    let set = reply("set demo pi3=1.5 publish-every=2").await;
    assert_eq!(set["result"]["before"]["pi3"], 1.0);
    assert_eq!(set["result"]["now"]["publish_every"], 2);
    let set = reply("set demo pi1=6 --make-room").await;
    assert_eq!(set["result"]["now"]["pi1"], 6.0);

    let informed = reply("inform demo --ids 3,1 --direction -1.5 --weight 2").await;
    assert_eq!(informed["result"]["ids"], json!([1, 3]));
    let informed = reply("inform demo --foremost 2 --along -3.1 --degrees -90 --for-time 9").await;
    assert_eq!(informed["result"]["ids"].as_array().unwrap().len(), 2);
    let informed = reply("inform demo --fraction 0.5 --direction 0").await;
    assert_eq!(informed["result"]["ids"].as_array().unwrap().len(), 10);
    let informed = reply("inform demo --within -1,-1,1000 --direction 0").await;
    assert_eq!(informed["result"]["ids"].as_array().unwrap().len(), 20);
    let uninformed = reply("uninform demo --count 5").await;
    assert_eq!(uninformed["result"]["ids"].as_array().unwrap().len(), 5);

    let injected = reply("inject demo --at -300,2,0 --at -400,-2,-1e-3 --degrees 90").await;
    assert_eq!(injected["result"], json!({"ids": [20, 21], "n": 22}));
    let injected = reply("inject demo --count 1 --within -350,0,5").await;
    assert_eq!(injected["result"], json!({"ids": [22], "n": 23}));
    let removed = reply("remove demo --ids 0").await;
    assert_eq!(removed["result"], json!({"ids": [0], "n": 22}));

    let running = reply("run demo --rate 2").await;
    assert_eq!(
        (&running["phase"], &running["result"]["rate"]),
        (&json!("running"), &json!(2.0))
    );
    assert_eq!(reply("pause demo").await["phase"], "paused");
    let reset = reply("reset demo --seed 8").await;
    assert_eq!(
        (&reset["step"], &reset["result"]["seed"]),
        (&json!(0), &json!(8))
    );
    assert_eq!(reply("delete demo").await["swarm"], "demo");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn output_without_json_is_text_and_tables() {
    let daemon = Daemon::start().await;
    let nothing = daemon.jostle("list").await;
    assert_eq!((nothing.code, nothing.stdout.as_str()), (Some(0), ""));
    assert!(nothing.stderr.contains("jostle create"), "{nothing:?}");

    let said = async |line: &str| daemon.said(line).await;
    assert!(
        said("create demo --n 20")
            .await
            .starts_with("created demo of 20 individuals")
    );
    let list = said("list").await;
    let words: Vec<Vec<&str>> = list
        .lines()
        .map(|line| line.split_whitespace().collect())
        .collect();
    assert_eq!(words[0][..2], ["swarm", "phase"]);
    assert_eq!(words[1][..3], ["demo", "paused", "created"]);
    assert!(
        said("step demo 3")
            .await
            .starts_with("demo is paused at step 3, time 0.06\n")
    );
    assert!(said("set demo pi3=2").await.contains("pi3"));
    assert!(
        said("inform demo --ids 2 --direction 0")
            .await
            .starts_with("informed 1 (2) towards 0.00 rad (0°) at step 3")
    );
    let ended = daemon.jostle("inform demo --ids 2 --direction 90").await;
    ended.assert_stderr(0, "90 rad is 116.6°: did you mean --degrees 90?");
    assert!(
        ended.stdout.contains("towards 90.00 rad (116.6°)"),
        "{ended:?}"
    );
    assert!(
        said("status demo")
            .await
            .contains("n           20, 1 informed")
    );
    let state: Value = serde_json::from_str(&said("step demo --state").await).unwrap();
    assert_eq!(
        (&state["step"], &state["weight"][2]),
        (&json!(4), &json!(0.5))
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_ends_a_wait_says_that_the_swarm_continues_and_how_to_pause_it() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    let line = "run demo --until-step 100000000 --wait --timeout 3";
    let ended = daemon.jostle(line).await;
    ended.assert_stderr(6, "did not reach step 100000000 within 3 s (--timeout)");
    let left = "runs on until step 100000000; `jostle pause demo` pauses it";
    assert!(ended.stderr.contains(left), "{ended:?}");
    daemon.until_running("demo").await;
    daemon.said("pause demo").await;

    let stepping = daemon.begin("step demo 900000000 --timeout 60");
    daemon.until_running("demo").await;
    stepping.interrupt();
    let ended = stepping.end().await;
    ended.assert_stderr(130, "demo steps on; `jostle pause demo` pauses it");
    daemon.said("pause demo").await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_spec_that_was_printed_makes_the_same_swarm() {
    let daemon = Daemon::start().await;
    let first = object(
        &daemon
            .jostle("--json create a --n 12 --seed 5 --pi1 6")
            .await,
    );
    let spec = daemon.jostle("spec a").await.stdout;
    let copy = daemon.jostle_with("--json create b --spec -", &spec).await;
    let copy = object(&copy);
    assert_eq!(copy["result"]["state_hash"], first["result"]["state_hash"]);
    let other = daemon
        .jostle_with("--json create c --spec - --seed 6", &spec)
        .await;
    let other = object(&other);
    assert_ne!(other["result"]["state_hash"], first["result"]["state_hash"]);
    assert_eq!(other["result"]["spec"]["pi1"], 6.0);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn each_kind_of_error_has_its_exit_code_and_a_json_object() {
    let daemon = Daemon::start().await;
    for line in ["create demo --n 20", "create busy --n 20", "run busy"] {
        assert_eq!(daemon.jostle(line).await.code, Some(0), "{line}");
    }
    for (line, exit_code, code) in [
        ("pause *", 2, "invalid_argument"),
        ("no-such-verb", 2, "invalid_argument"),
        ("inform demo --count 3", 2, "invalid_argument"),
        ("create Demo --n 3", 2, "invalid_argument"),
        ("create other --n 3 --pi1 -3", 2, "invalid_argument"),
        (
            "create other --spec /nowhere/spec.json",
            2,
            "invalid_argument",
        ),
        ("set demo colour=3", 2, "invalid_argument"),
        ("set demo pi1=six", 2, "invalid_argument"),
        ("set demo pi1=3 pi1=4", 2, "invalid_argument"),
        ("inform demo --ids 999 --direction 0", 2, "invalid_argument"),
        ("status nobody", 3, "not_found"),
        ("step nobody", 3, "not_found"),
        ("watch nobody", 3, "not_found"),
        ("list --node nobody", 3, "not_found"),
        ("create demo --n 21", 4, "already_exists"),
        ("step busy", 4, "incorrect_state"),
        ("pause demo --expect-step 9", 4, "conflict"),
        ("pause demo --expect-epoch 9", 4, "conflict"),
        ("list --prefix other", 6, "unreachable"),
        ("list -e tcp/127.0.0.1:1 --timeout 0.3", 6, "unreachable"),
        ("create a --n 3 --spec /dev/null", 2, "invalid_argument"),
        (
            "inject demo --count 1 --within 0,0,0.01",
            7,
            "resource_exhausted",
        ),
        // Last, since the daemon continues to execute it.
        ("step demo 1000000000 --timeout 3", 6, "deadline_exceeded"),
    ] {
        let ended = daemon.jostle(&format!("--json {line}")).await;
        assert_eq!(
            (ended.code, ended.stdout.as_str()),
            (Some(exit_code), ""),
            "{ended:?}"
        );
        let error: Value = serde_json::from_str(&ended.stderr).unwrap();
        assert_eq!(error["code"], code, "{error}");
        assert!(
            error["message"]
                .as_str()
                .is_some_and(|message| !message.is_empty())
        );
    }
    for (line, range) in [
        ("create a --n many", "from 1 to 1e6"),
        ("step demo 1.5", "from 1 to 1e9"),
        ("reset demo --seed -1", "from 0 to 2^53-1"),
        ("watch demo --count 0", "from 1 to 2^53-1"),
    ] {
        let ended = daemon.jostle(line).await;
        ended.assert_stderr(2, &format!("give a whole number {range}"));
    }
    let words = daemon.jostle("status nobody").await;
    assert_eq!(words.code, Some(3));
    assert!(words.stderr.contains("`jostle list`"), "{words:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn deleting_several_deletes_those_that_exist() {
    let daemon = Daemon::start().await;
    for line in ["create a --n 3", "create b --n 3"] {
        assert_eq!(daemon.jostle(line).await.code, Some(0));
    }
    let ended = daemon.jostle("--json delete a nobody b").await;
    assert_eq!(ended.code, Some(3), "{ended:?}");
    let deleted: Vec<Value> = ended.json_lines();
    assert_eq!(
        (&deleted[0]["swarm"], &deleted[1]["swarm"]),
        (&json!("a"), &json!("b"))
    );
    assert_eq!(
        object(&daemon.jostle("--json list").await)["result"]["swarms"],
        json!([])
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_query_without_a_reply_is_explained_by_the_tokens() {
    let tokens = [
        "jostle/@node/a/alive",
        "jostle/@node/b/alive",
        "jostle/mute/alive/a",
    ];
    let (silent, nonsense) = ("jostle/slow/get/status", "jostle/odd/get/status");
    let impostor = Impostor::start(&tokens, silent, nonsense).await;
    for (line, exit_code, code, said) in [
        ("list", 2, "invalid_argument", "--node: a, b"),
        ("list --node c", 3, "not_found", "the nodes are: a, b"),
        ("list --node a", 5, "permission_denied", "node a exists"),
        ("pause mute", 5, "permission_denied", "mute exists"),
        ("pause nobody", 3, "not_found", "no swarm nobody"),
        ("status odd", 1, "internal", "unreadable reply"),
        ("status slow --timeout 3", 6, "timeout", "did not reply"),
    ] {
        let ended = impostor.jostle(&format!("--json {line}")).await;
        assert_eq!(ended.code, Some(exit_code), "{ended:?}");
        let error: Value = serde_json::from_str(&ended.stderr).unwrap();
        assert_eq!(error["code"], code, "{error}");
        assert!(error["message"].as_str().unwrap().contains(said), "{error}");
    }
    impostor.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn individuals_are_named_by_ranges_of_ids_and_shares_in_percent() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 20").await;
    let ids = async |line: &str| daemon.reply(line).await["result"]["ids"].clone();
    assert_eq!(
        ids("inform demo --ids 1-5 --direction 0").await,
        json!([1, 2, 3, 4, 5])
    );
    assert_eq!(ids("uninform demo --ids 1,4-5").await, json!([1, 4, 5]));
    let informed = ids("inform demo --fraction 10% --direction 0").await;
    assert_eq!(informed.as_array().unwrap().len(), 2);
    assert_eq!(ids("remove demo --ids 17-19").await, json!([17, 18, 19]));
    for line in [
        "inform demo --ids 5-1 --direction 0",
        "inform demo --ids 0-4294967295 --direction 0",
        "inform demo --ids 1-3,2 --direction 0",
        "inform demo --ids 10-30 --direction 0",
        "inform demo --fraction 110% --direction 0",
        "remove demo --fraction -10%",
    ] {
        let ended = daemon.jostle(line).await;
        assert_eq!(ended.code, Some(2), "{line}: {ended:?}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn uninform_without_informed_individuals_prints_a_note() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 20").await;
    for line in [
        "uninform demo --count 3",
        "uninform demo --foremost 1 --along 0",
        "uninform demo --ids 3",
    ] {
        let ended = daemon.jostle(line).await;
        assert_eq!(ended.code, Some(2), "{line}: {ended:?}");
        assert!(
            ended.stderr.contains("there is nothing to uninform"),
            "{line}: {ended:?}"
        );
    }
    let said = daemon.said("uninform demo --fraction 50%").await;
    assert!(
        said.starts_with("uninformed no individual at step 0"),
        "{said}"
    );
    daemon.said("inform demo --ids 4 --direction 0").await;
    let ended = daemon.jostle("uninform demo --count 3").await;
    assert!(
        ended.stderr.contains("only 1 individual is informed"),
        "{ended:?}"
    );
    let ended = daemon.jostle("inform demo --count 21 --direction 0").await;
    assert!(
        ended.stderr.contains("the swarm has 20 individuals"),
        "{ended:?}"
    );
    daemon.stop().await;
}

async fn names(daemon: &Daemon) -> Vec<String> {
    let list = daemon.reply("list").await;
    let swarms = list["result"]["swarms"].as_array().unwrap().clone();
    swarms
        .iter()
        .map(|it| it["swarm"].as_str().unwrap().to_owned())
        .collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pattern_deletes_only_its_matches_and_only_if_confirmed() {
    let daemon = Daemon::start().await;
    let all = ["latest-1", "test", "test-1", "test-2", "test-22", "testing"];
    for name in all {
        daemon.said(&format!("create {name} --n 3")).await;
    }
    for line in ["delete test-*", "--json delete test-*"] {
        let ended = daemon.jostle(line).await;
        assert_eq!(ended.code, Some(2), "{ended:?}");
        for word in ["--yes", "3 swarms", "test-1, test-2, test-22"] {
            assert!(ended.stderr.contains(word), "{ended:?}");
        }
        assert_eq!(names(&daemon).await, all);
    }
    let ended = daemon.jostle("delete none-* test-1 --yes").await;
    ended.assert_stderr(3, "no swarm matches none-*");
    assert_eq!(
        names(&daemon).await,
        all,
        "nothing is deleted if a pattern matches nothing"
    );
    for line in [
        "delete test/* --yes",
        "delete [a --yes",
        "delete *** --yes",
        "delete @* --yes",
    ] {
        assert_eq!(daemon.jostle(line).await.code, Some(2), "{line}");
    }

    let said = daemon.said("delete test-? --yes").await;
    assert_eq!(said.lines().count(), 2, "{said}");
    assert_eq!(
        names(&daemon).await,
        ["latest-1", "test", "test-22", "testing"]
    );
    // A name needs no confirmation, and a swarm given twice is deleted once.
    let said = daemon.said("delete test-22 test-2* --yes").await;
    assert_eq!(said.lines().count(), 1, "{said}");
    daemon.said("delete test").await;
    let said = daemon.said("delete * --yes").await;
    assert_eq!(said.lines().count(), 2, "{said}");
    assert_eq!(names(&daemon).await, [""; 0]);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn each_swarm_that_is_not_deleted_is_named_with_its_reason() {
    let daemon = Daemon::start().await;
    for name in ["a-1", "a-2", "a-3"] {
        daemon.said(&format!("create {name} --n 3")).await;
    }
    daemon.said("step a-2").await;
    let ended = daemon.jostle("delete a-* --yes --expect-step 0").await;
    ended.assert_stderr(4, "a-2 was not deleted: ");
    assert!(
        !ended.stderr.contains("a-1") && !ended.stderr.contains("a-3"),
        "{ended:?}"
    );
    assert_eq!(names(&daemon).await, ["a-2"]);
    let ended = daemon.jostle("--json delete b-1 b-2 a-2").await;
    assert_eq!(ended.code, Some(3), "{ended:?}");
    let errors: Vec<Value> = ended
        .stderr
        .lines()
        .map(|it| serde_json::from_str(it).unwrap())
        .collect();
    let swarms: Vec<&Value> = errors.iter().map(|it| &it["details"]["swarm"]).collect();
    assert_eq!(swarms, ["b-1", "b-2"]);
    assert_eq!(errors[0]["code"], "not_found");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_of_an_earlier_model_is_marked_and_so_is_an_experiment_that_starts_from_it() {
    let daemon = Daemon::start().await;
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    daemon.said("create grown --n 4").await;
    let snapshot = path("grown.snapshot");
    let shown = snapshot.display();
    daemon.said(&format!("snapshot grown -o {shown}")).await;
    let mut taken = Snapshot::from_file(&fs::read(&snapshot).unwrap()).unwrap();
    taken.earlier_models.push(EarlierModel {
        model_version: 1,
        epoch: 3,
        step: 700,
    });
    fs::write(&snapshot, to_cbor(&taken.sealed())).unwrap();
    daemon.said(&format!("restore {shown} old")).await;
    let list = daemon.said("list").await;
    assert_eq!(list.matches("from model 1").count(), 1, "{list}");
    let status = daemon.said("status old").await;
    assert!(
        status.contains("version 1 up to step 700 of epoch 3"),
        "{status}"
    );
    assert!(!daemon.said("status grown").await.contains("version 1"));

    let file = path("later.toml");
    fs::write(
        &file,
        "name = \"later\"\nstart = \"grown.snapshot\"\nduration = 1\n",
    )
    .unwrap();
    let file = file.display();
    let remark = "its runs start from a state that version 1 of the model computed";
    let plan = daemon
        .said(&format!("experiment run {file} --dry-run"))
        .await;
    assert!(plan.contains(remark), "{plan}");
    let ended = daemon.said(&format!("experiment run {file} --again")).await;
    assert!(ended.contains(remark), "{ended}");
    let status = daemon.said("experiment status later").await;
    assert!(status.contains(remark), "{status}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn protected_swarms_stay_and_are_shown() {
    let daemon = Daemon::start().await;
    for name in ["a-1", "a-2", "a-3"] {
        daemon.said(&format!("create {name} --n 3")).await;
    }
    let said = daemon.said("protect a-2 a-3").await;
    let line = "a-2 is protected from delete and reset (seq 1)";
    assert_eq!(said, format!("{line}\n{}", line.replace("a-2", "a-3")));
    let list = daemon.said("list").await;
    assert_eq!(list.matches("protected, created").count(), 2, "{list}");
    let status = daemon.said("status a-2").await;
    assert!(status.contains("protected"), "{status}");
    assert!(!daemon.said("status a-1").await.contains("protected"));
    let ended = daemon.jostle("reset a-2").await;
    ended.assert_stderr(4, "`jostle protect --off a-2`");
    let ended = daemon.jostle("delete a-2 --node test").await;
    ended.assert_stderr(4, "`jostle protect --off a-2`");

    let ended = daemon.jostle("delete a-* --yes").await;
    ended.assert_stderr(4, "a-2 was not deleted: ");
    assert!(ended.stderr.contains("a-3 was not deleted"), "{ended:?}");
    assert_eq!(names(&daemon).await, ["a-2", "a-3"]);
    let ended = daemon.jostle("protect --off a-*").await;
    assert_eq!(ended.code, Some(2), "{ended:?}");
    daemon.said("protect --off a-* --yes").await;
    daemon.said("delete a-* --yes").await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn files_of_other_programs_are_read_or_get_a_remedy() {
    let daemon = Daemon::start().await;
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path.display().to_string()
    };
    // A byte order mark.
    let spec = write("spec.json", "\u{feff}{\"n\": 3}");
    daemon.said(&format!("create demo --spec {spec}")).await;
    let changes = write(
        "changes.json",
        "\u{feff}[{\"verb\": \"set\", \"args\": {\"pi3\": 2}}]",
    );
    daemon.said(&format!("batch demo {changes}")).await;
    // Unknown keys and misplaced ones.
    let head = "name = \"e\"\nduration = 1\n";
    for (text, expected) in [
        (
            "replicate = 2\n[spec]\nn = 3\n",
            "did you mean `replicates`?",
        ),
        (
            "[spec]\nn = 3\ninformed = 4\n",
            "line 5, column 1: informed is not a field of [spec]: write it in a [[grid]], as \
             informed = 4",
        ),
        (
            "points = \"semicolons.csv\"\n[spec]\nn = 3\n",
            "separated by semicolons",
        ),
    ] {
        write("semicolons.csv", "pi1;pi3\n1,5;2\n");
        let file = write("e.toml", &format!("{head}{text}"));
        for line in [
            format!("experiment run {file}"),
            format!("experiment run {file} --dry-run"),
        ] {
            daemon.jostle(&line).await.assert_stderr(2, expected);
        }
    }
    // The header that NumPy's `savetxt` writes.
    write("numpy.csv", "# pi1,pi3\n1.5e+00,2e+00\n");
    let file = write(
        "e.toml",
        &format!("{head}points = \"numpy.csv\"\n[spec]\nn = 3\n"),
    );
    let plan = daemon
        .said(&format!("experiment run {file} --dry-run"))
        .await;
    assert!(plan.contains("1 condition"), "{plan}");

    let nobody = daemon.jostle("leave demo ada").await;
    nobody.assert_stderr(
        3,
        "no controller ada has joined: `jostle controllers` lists them",
    );
    let json = daemon.refusal("leave demo ada").await;
    assert!(
        json["message"]
            .as_str()
            .unwrap()
            .contains("`jostle controllers`"),
        "{json}"
    );
    assert_eq!(daemon.said("auth can wait").await.trim(), "you may wait");
    let listed = daemon.reply("schema").await;
    assert_eq!(listed[0].as_object().unwrap().len(), 3, "{listed}");
    daemon.stop().await;
}
