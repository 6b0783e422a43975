//! Roles, verbs and keys: whoever may is answered, whoever may not changes nothing.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{ErrorCode, Reply, Role, Snapshot, keys};
use serde_json::{Value, json};

use super::{Lab, Visitor};
use crate::support::{Answer, NODE, PREFIX, until};

/// The cells that must at least be tried.
const CELLS: usize = 150;

/// A request that succeeds, once.
struct Deed {
    verb: &'static str,
    key: String,
    args: Value,
    /// The swarm whose number of applied commands it would raise, if it is one that is there.
    swarm: Option<String>,
}

/// Everything that changes something, each made ready to succeed by an operator.
async fn deeds(olga: &Visitor, cleo: &Visitor) -> Vec<Deed> {
    let anybody = json!({"select": {"count": 1}});
    let informed = json!({"select": {"count": 1}, "direction": 0.5});
    let mut deeds = Vec::new();
    for (verb, args) in [
        ("delete", json!({})),
        ("run", json!({"until_step": 3})),
        ("pause", json!({})),
        ("step", json!({"steps": 1})),
        ("reset", json!({})),
        ("set", json!({"pi3": 1.1})),
        ("inform", informed),
        ("uninform", anybody.clone()),
        ("inject", json!({"count": 1})),
        ("remove", anybody.clone()),
        (
            "batch",
            json!({"commands": [{"verb": "set", "args": {"pi3": 1.2}}]}),
        ),
        ("fork", json!({"name": "copy"})),
        (
            "join",
            json!({"controller": "cleo", "select": {"count": 1}}),
        ),
        ("advance", json!({"controller": "cleo", "steps": 1})),
        ("leave", json!({"controller": "cleo"})),
        ("seek", json!({"fraction": 0.0})),
    ] {
        let swarm = format!("for-{verb}");
        match verb {
            "seek" => record_and_open(olga, &swarm).await,
            _ => olga.create(&swarm).await,
        }
        if verb == "uninform" {
            let all = json!({"select": {"fraction": 1.0}, "direction": 0.5});
            olga.cmd(&swarm, "inform", all).await;
        }
        if ["advance", "leave"].contains(&verb) {
            let join = json!({"controller": "cleo", "select": {"count": 1}});
            cleo.cmd(&swarm, "join", join).await;
        }
        deeds.push(Deed {
            verb,
            key: keys::cmd(PREFIX, &swarm, verb),
            args,
            swarm: Some(swarm),
        });
    }
    olga.create("source").await;
    olga.create("discarded").await;
    let spec = json!({"n": 3});
    let toml = "name = \"small\"\nduration = 1\n[[grid]]\nn = [2]\n";
    for (verb, args) in [
        ("create", json!({"name": "created", "spec": spec})),
        ("experiment", json!({"submit": {"toml": toml}})),
        ("record", json!({"begin": {"swarm": "source"}})),
        (
            "replay",
            json!({"upload": {"name": "piece", "offset": 0, "length": 8, "bytes": "iU1DQVAwDQo="}}),
        ),
        ("discard", json!({"name": "discarded"})),
        (
            "restore",
            json!({"name": "restored", "snapshot": snapshot_of(olga, "source").await}),
        ),
    ] {
        deeds.push(Deed {
            verb,
            key: keys::node_cmd(PREFIX, NODE, verb),
            args,
            swarm: None,
        });
    }
    let verbs: Vec<_> = deeds.iter().map(|deed| deed.verb).collect();
    for verb in keys::SWARM_VERBS.iter().chain(&keys::NODE_VERBS) {
        assert!(verbs.contains(verb), "{verb} is not tried");
    }
    deeds
}

/// A snapshot as `restore` takes it.
async fn snapshot_of(olga: &Visitor, swarm: &str) -> String {
    let query = olga.session.get(keys::get(PREFIX, swarm, "snapshot"));
    let reply = query.await.unwrap().recv_async().await.unwrap();
    let sample = reply.into_result().unwrap();
    let reply: Reply<Snapshot> = ciborium::from_reader(&*sample.payload().to_bytes()).unwrap();
    STANDARD.encode(jostle_proto::to_cbor(&reply.result))
}

/// A swarm that is the replay of a recording.
async fn record_and_open(olga: &Visitor, swarm: &str) {
    olga.create("filmed").await;
    olga.node_cmd(
        "record",
        json!({"begin": {"swarm": "filmed", "recording": "film"}}),
    )
    .await;
    olga.cmd("filmed", "step", json!({"steps": 20})).await;
    olga.node_cmd("record", json!({"stop": {"recording": "film"}}))
        .await;
    let recordings = keys::node_get(PREFIX, NODE, "recordings");
    until("the recording ends", async || {
        let told = olga.ok(&recordings, None).await;
        told["result"]["recordings"][0]["phase"] == "ended"
    })
    .await;
    olga.node_cmd(
        "replay",
        json!({"open": {"name": swarm, "recording": "film"}}),
    )
    .await;
}

/// How many commands a swarm has applied; none that is not there.
async fn applied(olga: &Visitor, swarm: &str) -> Option<Value> {
    let status = olga.ask(&keys::get(PREFIX, swarm, "status"), None).await;
    let status = status.into_iter().next()?.ok()?;
    Some(json!([status["seq"], status["step"], status["phase"]]))
}

#[tokio::test(flavor = "multi_thread")]
async fn every_role_may_what_it_may_and_nothing_else() {
    let lab = Lab::open().await;
    let (vera, cleo, olga) = (
        lab.enter("vera").await,
        lab.enter("cleo").await,
        lab.enter("olga").await,
    );
    // Sessions that may more than the tokens that come over them: the daemon alone stands there.
    let tokens = ["vera", "cleo"].map(|name| lab.credentials(name).token);
    let lent = lab.enter_with("olga", Some(&tokens[0])).await;
    let lent_further = lab.enter_with("olga", Some(&tokens[1])).await;
    let silent = lab.enter_with("olga", None).await;
    let forged = lab.enter_with("olga", Some("0123456789abcdef")).await;
    // And one that may less: zenoh's access control stands there.
    let stolen = lab
        .enter_with("vera", Some(&lab.credentials("olga").token))
        .await;
    let mut cells = 0;
    for deed in deeds(&olga, &cleo).await {
        let before = match &deed.swarm {
            Some(swarm) => applied(&olga, swarm).await,
            None => None,
        };
        // By the session, by the token.
        for (who, link, token) in [
            (&vera, Role::Viewer, Some(Role::Viewer)),
            (&stolen, Role::Viewer, Some(Role::Operator)),
            (&cleo, Role::Controller, Some(Role::Controller)),
            (&lent, Role::Operator, Some(Role::Viewer)),
            (&lent_further, Role::Operator, Some(Role::Controller)),
            (&silent, Role::Operator, None),
            (&forged, Role::Operator, None),
        ] {
            if link.may(deed.verb) && token.is_some_and(|role| role.may(deed.verb)) {
                continue;
            }
            let answers = who.ask(&deed.key, Some(&deed.args)).await;
            let told = format!("{} by {link}, {token:?}: {answers:?}", deed.verb);
            if link.may(deed.verb) {
                let [Err(error)] = &answers[..] else {
                    panic!("{told}");
                };
                assert_eq!(error.code, ErrorCode::PermissionDenied, "{told}");
                let takes = format!("{} takes", deed.verb);
                assert!(error.message.contains(&takes), "{told}");
            } else {
                assert!(answers.is_empty(), "{told}");
            }
            cells += 1;
        }
        if let Some(swarm) = &deed.swarm {
            assert_eq!(applied(&olga, swarm).await, before, "{}", deed.verb);
        }
        // The very same call, by whoever has the least role that may, or the greatest.
        let who = match Role::Controller.may(deed.verb) {
            true => &cleo,
            false => &olga,
        };
        who.ok(&deed.key, Some(&deed.args)).await;
        cells += 1;
    }
    cells += gets(&[&vera, &cleo, &olga]).await;
    cells += wildcards(&[&vera, &cleo, &olga, &lent, &silent]).await;
    println!("{cells} cells");
    assert!(cells >= CELLS, "{cells}");
    let visitors = vec![vera, cleo, olga, lent, lent_further, silent, forged, stolen];
    lab.close(visitors).await;
}

/// Everybody may look at everything.
async fn gets(everybody: &[&Visitor]) -> usize {
    let mut gets = vec![
        keys::state(PREFIX, "source"),
        keys::get(PREFIX, "*", "status"),
    ];
    for noun in keys::SWARM_GETS {
        let parameters = if noun == "wait" { "?step=0" } else { "" };
        gets.push(keys::get(PREFIX, "source", noun) + parameters);
    }
    for noun in keys::NODE_GETS {
        // What operators alone may look at has a test of its own.
        if noun != "recording" {
            gets.push(keys::node_get(PREFIX, NODE, noun));
        }
    }
    gets.push(keys::experiment(PREFIX, NODE, "small", "progress"));
    for key in &gets {
        for who in everybody {
            let answers = who.ask(key, None).await;
            // One that was deleted a moment ago says that it is not there.
            let is_told = |answer: &Answer| match answer {
                Ok(_) => true,
                Err(error) => error.code == ErrorCode::NotFound && key.contains('*'),
            };
            assert!(
                answers.iter().any(Result::is_ok) && answers.iter().all(is_told),
                "{key}: {answers:?}"
            );
        }
    }
    gets.len() * everybody.len()
}

#[tokio::test(flavor = "multi_thread")]
async fn recordings_are_fetched_by_operators_alone() {
    let lab = Lab::open().await;
    let (vera, cleo, olga) = (
        lab.enter("vera").await,
        lab.enter("cleo").await,
        lab.enter("olga").await,
    );
    record_and_open(&olga, "tape").await;
    let key = keys::node_get(PREFIX, NODE, "recording");
    let film = format!("{key}?name=film");
    let piece = olga.ok(&film, None).await["result"].take();
    assert!(piece["length"].as_u64() > Some(1000), "{piece}");
    // zenoh stops the sessions of others, whatever token comes along.
    let stolen = lab
        .enter_with("vera", Some(&lab.credentials("olga").token))
        .await;
    for who in [&vera, &cleo, &stolen] {
        let answers = who.ask(&film, None).await;
        assert!(answers.is_empty(), "{answers:?}");
    }
    // The daemon stops what comes over an operator's session with another's token, or none.
    let vera_token = lab.credentials("vera").token;
    let lent = lab.enter_with("olga", Some(&vera_token)).await;
    let silent = lab.enter_with("olga", None).await;
    for who in [&lent, &silent] {
        let answers = who.ask(&film, None).await;
        let [Err(error)] = &answers[..] else {
            panic!("{answers:?}");
        };
        assert_eq!(error.code, ErrorCode::PermissionDenied, "{error:?}");
        assert!(error.message.contains("takes an operator"), "{error:?}");
    }
    // A wildcard does not reach it for anybody.
    for who in [&vera, &stolen, &olga] {
        for wild in ["*", "recording$*", "**"] {
            let key = keys::node_get(PREFIX, NODE, wild);
            let answers = who.ask(&format!("{key}?name=film"), None).await;
            let told = answers.iter().flatten();
            let has_piece = |answer: &Value| answer["result"].get("length").is_some();
            assert!(!told.into_iter().any(has_piece), "{wild}: {answers:?}");
        }
    }
    lab.close(vec![vera, cleo, olga, stolen, lent, silent])
        .await;
}

/// A wildcard executes nothing, whoever sends it.
async fn wildcards(everybody: &[&Visitor]) -> usize {
    let mut cells = 0;
    for key in [
        "jostle/**",
        "jostle/*/cmd/delete",
        "**",
        "jostle/source/cmd/*",
    ] {
        for who in everybody {
            who.ask(key, Some(&json!({}))).await;
            let status = keys::get(PREFIX, "source", "status");
            let there = everybody[0].ok(&status, None).await;
            assert_eq!(
                (&there["seq"], &there["phase"]),
                (&json!(0), &json!("paused")),
                "{key}"
            );
            cells += 1;
        }
    }
    cells
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_speaks_for_its_own_and_the_journal_says_who() {
    let lab = Lab::open().await;
    let (cleo, carl, olga) = (
        lab.enter("cleo").await,
        lab.enter("carl").await,
        lab.enter("olga").await,
    );
    olga.create("s").await;
    let join = |name: &str| json!({"controller": name, "select": {"count": 1}});
    let key = keys::cmd(PREFIX, "s", "join");
    for (who, name) in [
        (&cleo, "carl"),
        (&cleo, "cleo2"),
        (&carl, "cleo-arm"),
        (&carl, "olga"),
    ] {
        let answers = who.ask(&key, Some(&join(name))).await;
        let [Err(error)] = &answers[..] else {
            panic!("{name}: {answers:?}");
        };
        assert_eq!(error.code, ErrorCode::PermissionDenied);
        assert!(
            error.message.contains("a controller of yours is called"),
            "{error:?}"
        );
    }
    cleo.ok(&key, Some(&join("cleo-arm"))).await;
    let leave = keys::cmd(PREFIX, "s", "leave");
    let not_his = json!({"controller": "cleo-arm"});
    assert!(carl.ask(&leave, Some(&not_his)).await[0].is_err());
    let claimed = json!({"client": "olga", "args": {"controller": "cleo-arm"}});
    cleo.ok(&leave, Some(&claimed)).await;
    // Operators may speak for anybody.
    olga.ok(&key, Some(&join("carl"))).await;

    let journal = carl.ok(&keys::get(PREFIX, "s", "journal"), None).await;
    let entries = journal["result"]["entries"].as_array().unwrap().iter();
    let who: Vec<_> = entries
        .map(|entry| entry["client"].as_str().unwrap().to_owned())
        .collect();
    assert_eq!(who, ["cleo", "cleo:olga", "olga"]);
    lab.close(vec![cleo, carl, olga]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_asks_is_told_who_they_are_and_what_they_may() {
    let lab = Lab::open().await;
    let key = keys::node_get(PREFIX, NODE, "whoami");
    let mut visitors = Vec::new();
    for (name, role) in super::PEOPLE {
        let visitor = lab.enter(name).await;
        let told = visitor.ok(&key, None).await["result"].take();
        assert_eq!(
            (&told["person"], &told["role"]),
            (&json!(name), &json!(role))
        );
        for (field, verbs) in [
            ("verbs", &keys::SWARM_VERBS[..]),
            ("node_verbs", &keys::NODE_VERBS[..]),
        ] {
            let may = verbs.iter().filter(|verb| role.may(verb));
            assert_eq!(told[field], json!(may.collect::<Vec<_>>()));
        }
        visitors.push(visitor);
    }
    let nobody = lab.enter_with("vera", Some("no token")).await;
    let told = nobody.ok(&key, None).await["result"].take();
    assert_eq!(
        told,
        json!({"person": null, "role": null, "verbs": [], "node_verbs": []})
    );
    visitors.push(nobody);
    lab.close(visitors).await;
}
