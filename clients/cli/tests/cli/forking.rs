//! Copies of swarms: forks and snapshots.

use std::fs;
use std::sync::atomic::Ordering;
use std::sync::mpsc::channel;

use serde_json::{Value, json};

use crate::support::{Daemon, Link, Running, TIMEOUT, until};

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
async fn a_fork_is_equal_until_changed_and_diff_shows_the_divergence() {
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
    let after = "no command differs after seq 3 (one of the journals begins there)";
    assert!(said.contains(after), "{said}");
    assert!(
        said.contains("both at step 150, the same to the bit"),
        "{said}"
    );

    let same = daemon.jostle("diff a a").await;
    same.assert_stderr(2, "two different swarms");

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
    // Its state is before the command of that step.
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
    again.assert_stderr(2, "--force replaces it");
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

    // A truncated file is no snapshot; a changed byte changes the digest.
    fs::write(&path, &bytes[..bytes.len() - 9]).unwrap();
    let ended = there.jostle(&format!("restore {file} c")).await;
    ended.assert_stderr(2, "not a snapshot, or not all of one");
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
async fn a_request_too_long_for_a_message_is_rejected_with_a_remedy() {
    let daemon = Daemon::with(&[("max_individuals", "20000")]).await;
    daemon
        .said("create large --n 19000 --radius 500 --timeout 60")
        .await;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("large.snapshot");
    let ended = daemon
        .jostle(&format!("snapshot large -o {}", path.display()))
        .await;
    ended.assert_stderr(7, "fork the swarm");
    assert!(!path.exists());
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_interrupted_fork_says_that_the_daemon_goes_on_and_how_to_remove_it() {
    let daemon = Daemon::start().await;
    crowd(&daemon, "a").await;
    let link = Link::to(&daemon.endpoint);
    let (release, held) = channel();
    // The daemon does not get the request before the client has ended.
    let is_sent = link.on(b"cmd/fork", move || {
        let _ = held.recv_timeout(TIMEOUT);
    });
    let running = Running::begin(&link.endpoint, "fork a b --at-step 50", "");
    until("the fork is sent", async || is_sent.load(Ordering::SeqCst)).await;
    running.interrupt();
    let ended = running.end().await;
    release.send(()).unwrap();
    ended.assert_stderr(130, "the daemon may still fork a");
    ended.assert_stderr(130, "`jostle status b` shows it");
    ended.assert_stderr(130, "`jostle delete b` removes it");
    daemon.stop().await;
}
