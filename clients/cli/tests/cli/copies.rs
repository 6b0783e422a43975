//! Copies of swarms, and pasts told again.

use std::fs;

use serde_json::{Value, json};

use crate::support::{Daemon, object};

/// A dense group with commands behind it, in mid-contact.
async fn crowd(daemon: &Daemon, name: &str) {
    let create = format!("create {name} --n 74 --seed 3 --radius 7 --rate max");
    daemon.said(&create).await;
    daemon.said(&format!("step {name} 40 --timeout 60")).await;
    let inform = format!("inform {name} --count 5 --direction 0");
    daemon.said(&inform).await;
    daemon.said(&format!("step {name} 60 --timeout 60")).await;
}

async fn hash(daemon: &Daemon, swarm: &str) -> Value {
    let status = daemon.reply(&format!("status {swarm}")).await;
    status["result"]["state_hash"].clone()
}

#[tokio::test(flavor = "multi_thread")]
async fn two_futures_are_equal_until_treated_differently_and_diff_says_where_they_part() {
    let daemon = Daemon::start().await;
    crowd(&daemon, "a").await;
    let forked = daemon.reply("fork a b").await;
    assert_eq!(
        (&forked["swarm"], &forked["step"]),
        (&json!("b"), &json!(100))
    );
    assert_eq!(forked["result"]["state_hash"], hash(&daemon, "a").await);
    let status = daemon.reply("status b").await;
    assert_eq!(status["result"]["reason"], "forked");

    for swarm in ["a", "b"] {
        daemon.said(&format!("step {swarm} 50 --timeout 60")).await;
    }
    let difference = daemon.reply("diff a b").await;
    assert_eq!(difference["is_same_hash"], true, "{difference}");
    assert_eq!(difference["commands"], Value::Null);
    assert_eq!(difference["individuals"]["differ"], 0);
    let said = daemon.said("diff a b").await;
    assert!(said.contains("no command differs"), "{said}");
    assert!(
        said.contains("both at step 150, the same to the bit"),
        "{said}"
    );

    let same = daemon.jostle("diff a a").await;
    assert_eq!(same.code, Some(2), "{same:?}");
    assert!(same.stderr.contains("two different swarms"), "{same:?}");

    daemon.said("inform b --ids 0,1,2 --degrees 90").await;
    let said = daemon.said("diff a b").await;
    assert!(said.contains("3 informed otherwise"), "{said}");
    for swarm in ["a", "b"] {
        daemon.said(&format!("step {swarm} 50 --timeout 60")).await;
    }
    let difference = daemon.reply("diff a b").await;
    assert_eq!(difference["is_same_hash"], false);
    let commands = &difference["commands"];
    assert_eq!(commands["one"], Value::Null);
    assert_eq!(
        (&commands["other"]["verb"], &commands["other"]["step"]),
        (&json!("inform"), &json!(150))
    );
    let bodies = &difference["individuals"];
    assert_eq!(bodies["common"], 74);
    assert!(bodies["differ"].as_u64().unwrap() >= 3, "{bodies}");
    assert!(bodies["largest_distance"].as_f64().unwrap() > 0.0);
    let drift = &difference["drift"];
    let [one, other] = ["one", "other"].map(|it| drift[it].as_f64().unwrap());
    assert!((one - other).abs() > 0.0, "{drift}");
    let said = daemon.said("diff a b").await;
    assert!(said.contains("a: nothing more"), "{said}");
    assert!(said.contains("at step 150 (seq "), "{said}");
    for line in ["order", "drift", "direction"] {
        assert!(said.contains(line), "{said}");
    }

    daemon.said("step b").await;
    let difference = daemon.reply("diff a b").await;
    assert_eq!(difference["individuals"], Value::Null);
    assert_eq!(difference["is_same_hash"], Value::Null);
    daemon.said("create c --n 12 --seed 9").await;
    let difference = daemon.reply("diff a c").await;
    assert_eq!(difference["spec"], json!(["n", "seed", "start"]));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fork_of_an_earlier_step_has_the_same_future_again() {
    let daemon = Daemon::start().await;
    crowd(&daemon, "a").await;
    let forked = daemon.reply("fork a b --at-step 40 --timeout 60").await;
    assert_eq!(forked["step"], 40);
    // It stands before the command that was given there.
    assert_eq!(daemon.reply("status b").await["result"]["informed"], 0);
    daemon.said("inform b --count 5 --direction 0").await;
    daemon.said("step b 60 --timeout 60").await;
    assert_eq!(hash(&daemon, "b").await, hash(&daemon, "a").await);

    let refused = daemon.refusal("fork a d --at-step 101").await;
    assert_eq!(refused["code"], "conflict");
    assert!(refused["message"].as_str().unwrap().contains("step 100"));
    assert_eq!(daemon.refusal("fork a b").await["code"], "already_exists");
    assert_eq!(daemon.refusal("fork x y").await["code"], "not_found");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_snapshot_is_a_file_that_another_daemon_restores() {
    let (here, there) = (Daemon::start().await, Daemon::start().await);
    crowd(&here, "a").await;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.snapshot");
    let file = path.to_str().unwrap();
    let wrote = here.reply(&format!("snapshot a -o {file}")).await;
    let bytes = fs::read(&path).unwrap();
    assert_eq!(wrote["bytes"], bytes.len());
    assert_eq!((&wrote["step"], &wrote["n"]), (&json!(100), &json!(74)));
    assert_eq!(wrote["state_hash"], hash(&here, "a").await);

    here.said("step a 30 --timeout 60").await;
    let again = here.jostle(&format!("snapshot a -o {file}")).await;
    assert_eq!(again.code, Some(2), "{again:?}");
    assert!(again.stderr.contains("--force replaces it"), "{again:?}");
    assert_eq!(fs::read(&path).unwrap(), bytes);

    let restored = there.said(&format!("restore {file}")).await;
    assert!(
        restored.starts_with("restored a, paused at step 100"),
        "{restored}"
    );
    let restored = there.reply(&format!("restore {file} b")).await;
    assert_eq!(restored["result"]["state_hash"], wrote["state_hash"]);
    assert_eq!(
        there.reply("status b").await["result"]["reason"],
        "restored"
    );
    there.said("step b 30 --timeout 60").await;
    assert_eq!(hash(&there, "b").await, hash(&here, "a").await);
    let refused = there.refusal(&format!("restore {file} b")).await;
    assert_eq!(refused["code"], "already_exists");

    let forced = here.said(&format!("snapshot a -o {file} --force")).await;
    assert!(
        forced.contains("74 individuals, paused at step 130"),
        "{forced}"
    );
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);

    // Cut short it is none; with another byte its digest is another one.
    fs::write(&path, &bytes[..bytes.len() - 9]).unwrap();
    let ended = there.jostle(&format!("restore {file} c")).await;
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(
        ended.stderr.contains("not a snapshot, or not all of one"),
        "{ended:?}"
    );
    let mut flipped = bytes;
    let x = flipped.windows(2).position(|it| it == b"ax").unwrap() + 12;
    flipped[x] ^= 1;
    fs::write(&path, &flipped).unwrap();
    let refused = there.refusal(&format!("restore {file} c")).await;
    assert_eq!(refused["code"], "invalid_argument", "{refused}");
    assert!(
        refused["message"].to_string().contains("damaged"),
        "{refused}"
    );
    let refused = here.refusal("restore /no/such/file").await;
    assert_eq!(refused["code"], "invalid_argument");
    here.stop().await;
    there.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_one_message_does_not_carry_is_refused_with_a_remedy_and_not_lost() {
    let daemon = Daemon::with(&[("max_individuals", "20000")]).await;
    daemon
        .said("create large --n 19000 --radius 500 --timeout 60")
        .await;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.snapshot");
    let ended = daemon
        .jostle(&format!("snapshot large -o {}", path.display()))
        .await;
    assert_eq!(ended.code, Some(7), "{ended:?}");
    assert!(ended.stderr.contains("fork the swarm"), "{ended:?}");
    assert!(!path.exists());
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_past_that_comes_out_the_same_is_verified() {
    let daemon = Daemon::start().await;
    daemon.said("create a --n 10 --seed 2").await;
    // What stands still has its present hash.
    let fresh = daemon.said("verify a").await;
    assert!(fresh.contains("1 hash compared"), "{fresh}");
    daemon.said("step a 20000 --timeout 60").await;
    daemon.said("set a pi3=1.5").await;
    let verified = object(&daemon.jostle("--json verify a").await);
    let result = &verified["result"];
    assert_eq!(result["from_step"], 0);
    assert_eq!(result["differs_at"], Value::Null);
    assert!(result["hashes"].as_u64().unwrap() > 1, "{verified}");
    let said = daemon.said("verify a").await;
    assert!(
        said.starts_with("a is the same: told again from step 0 to step "),
        "{said}"
    );
    let status = daemon.said("status a").await;
    assert!(status.contains("kept from step 0 of epoch 1"), "{status}");
    assert_eq!(daemon.refusal("verify b").await["code"], "not_found");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_past_that_comes_out_otherwise_ends_with_nine() {
    use crate::support::Impostor;
    let impostor = Impostor::start(&["jostle/demo/alive/a"], "jostle/x", "jostle/y").await;
    let reply = json!({
        "swarm": "demo", "epoch": 1, "step": 900, "time": 18.0, "phase": "paused", "seq": 1,
        "result": {"from_step": 0, "to_step": 900, "hashes": 3, "differs_at": 700, "differs_in_epoch": 1},
    });
    let _received = impostor
        .answer("jostle/demo/get/verify", vec![Ok(reply.clone()), Ok(reply)])
        .await;
    let ended = impostor.jostle("verify demo").await;
    assert_eq!(ended.code, Some(9), "{ended:?}");
    assert!(
        ended
            .stdout
            .contains("demo differs first at step 700 of epoch 1"),
        "{ended:?}"
    );
    assert!(ended.stderr.contains("step 700"), "{ended:?}");
    let ended = impostor.jostle("--json verify demo").await;
    assert_eq!(ended.code, Some(9), "{ended:?}");
    let error: Value = serde_json::from_str(&ended.stderr).unwrap();
    assert_eq!(
        (&error["code"], &error["step"]),
        (&json!("mismatch"), &json!(700))
    );
    impostor.stop().await;
}
