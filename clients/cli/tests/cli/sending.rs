//! The options of commands: schedule, preconditions, sender, batches.

use std::collections::BTreeSet;

use jostle_proto::verbs::SwarmVerb;
use serde_json::json;

use crate::requests::{bases, files, surface};
use crate::support::{Daemon, object};

#[tokio::test(flavor = "multi_thread")]
async fn a_command_for_a_step_to_come_is_acknowledged_and_applies_there() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    let said = daemon.said("set demo pi3=2 --at-step 4 --client ada").await;
    assert_eq!(
        said.trim(),
        "set will be applied at step 4; demo is paused at step 0, time 0"
    );
    let scheduled = daemon
        .reply("inform demo --ids 1 --direction 0 --at-step 5")
        .await;
    assert_eq!(scheduled["result"], json!({"applies_at_step": 5}));
    let said = daemon.said("step demo --state --at-step 6").await;
    assert!(said.starts_with("step will be applied at step 6"), "{said}");
    assert!(
        daemon
            .said("status demo")
            .await
            .contains("3 commands for a step to come")
    );

    daemon.said("step demo 5").await;
    let status = daemon.reply("status demo").await;
    assert_eq!(status["result"]["parameters"]["pi3"], 2.0);
    assert_eq!(status["result"]["informed"], 1);
    let journal = daemon.said("journal demo").await;
    assert!(journal.contains("ada"), "{journal}");
    let late = daemon.refusal("set demo pi3=3 --at-step 1").await;
    assert_eq!(late["code"], "conflict");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_expected_is_expected_of_every_change() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    let (folder, surface) = (files(), surface());
    let mut checked = BTreeSet::new();
    for (verb, row) in bases() {
        if !surface[&verb].contains("--expect-step") {
            continue;
        }
        for expected in ["--expect-step 7", "--expect-epoch 7"] {
            let line = format!("{} {expected}", row.typed(folder.path()));
            let ended = daemon.jostle(&line).await;
            assert_eq!(ended.code, Some(4), "{line}: {ended:?}");
        }
        checked.insert(verb);
    }
    let of_contract = SwarmVerb::DEFINITIONS.iter().filter(|it| it.at_step);
    let missing = of_contract.filter(|it| !checked.contains(it.name));
    let missing: Vec<&str> = missing.map(|it| it.name).collect();
    assert_eq!(missing, ["join"], "no command line sends it");
    let status = daemon.reply("status demo").await;
    assert_eq!(
        (&status["seq"], &status["phase"]),
        (&json!(0), &json!("paused"))
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_under_the_same_name_is_carried_out_once() {
    let daemon = Daemon::start().await;
    let created = daemon
        .reply("create demo --n 10 --request-id c --client me")
        .await;
    let again = daemon
        .reply("create demo --n 10 --request-id c --client me")
        .await;
    assert_eq!(created, again, "no `already_exists`");
    let first = daemon.reply("step demo 2 --request-id s").await;
    let again = daemon.reply("step demo 2 --request-id s").await;
    assert_eq!((&first["step"], &again), (&json!(2), &first));
    assert_eq!(daemon.reply("status demo").await["step"], 2);
    let other = daemon.refusal("step demo 3 --request-id s").await;
    assert_eq!(other["code"], "conflict");
    let other = daemon
        .reply("step demo 3 --request-id s --client somebody-else")
        .await;
    assert_eq!(other["step"], 5);
    let several = daemon.refusal("delete demo other --request-id d").await;
    assert_eq!(several["code"], "invalid_argument");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_batch_applies_as_a_whole_or_not_at_all() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10").await;
    let changes = r#"[
        {"verb": "set", "args": {"pi3": 1.5}},
        {"verb": "inform", "args": {"select": {"ids": [3, 1]}, "direction": 0}},
        {"verb": "inject", "args": {"count": 2}}
    ]"#;
    let ended = daemon.jostle_with("batch demo -", changes).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let lines: Vec<&str> = ended.stdout.lines().collect();
    assert_eq!(lines[0], "3 changes applied to demo at step 0");
    assert!(lines[2].ends_with("set     pi3 1 -> 1.5"), "{ended:?}");
    assert!(lines[3].ends_with("inform  2 (1,3)"), "{ended:?}");
    assert!(lines[4].ends_with("inject  2 (10,11)"), "{ended:?}");

    let path = std::env::temp_dir().join(format!("jostle-batch-{}.json", std::process::id()));
    let object = json!({"commands": [
        {"verb": "set", "args": {"pi3": 3}},
        {"verb": "remove", "args": {"select": {"ids": [99]}}},
    ]});
    std::fs::write(&path, object.to_string()).unwrap();
    let refused = daemon
        .refusal(&format!("batch demo {}", path.display()))
        .await;
    std::fs::remove_file(&path).unwrap();
    assert_eq!(refused["code"], "invalid_argument");
    let field = refused["details"]["field"].as_str().unwrap();
    assert!(field.starts_with("commands[1].args.select"), "{refused}");
    let status = daemon.reply("status demo").await;
    assert_eq!(
        status["result"]["parameters"]["pi3"], 1.5,
        "nothing of it was applied"
    );

    let slip = r#"[{"verb": "infrom", "args": {}}]"#;
    let ended = daemon.jostle_with("batch demo -", slip).await;
    assert_eq!(ended.code, Some(2));
    assert!(ended.stderr.contains("did you mean `inform`"), "{ended:?}");
    for nonsense in ["7", "[", "\"set\""] {
        let ended = daemon.jostle_with("batch demo -", nonsense).await;
        assert_eq!(ended.code, Some(2), "{ended:?}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_step_sent_again_prints_the_state_while_the_swarm_has_it() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 200").await;
    let step = "--json step demo 3 --state --client me --request-id 1";
    let first = object(&daemon.jostle(step).await);
    assert_eq!(first["result"]["state"]["step"], 3);
    // The cached reply has no state, so the client fetches it.
    assert_eq!(object(&daemon.jostle(step).await), first);
    let step = "step demo 3 --state --client me --request-id 1";
    assert_eq!(object(&daemon.jostle(step).await), first["result"]["state"]);
    daemon.said("inject demo --count 1").await;
    let refused = daemon.refusal(step).await;
    assert_eq!(
        (&refused["code"], &refused["step"]),
        (&json!("conflict"), &json!(3))
    );
    daemon.said("step demo").await;
    assert_eq!(daemon.refusal(step).await["step"], 4);
}
