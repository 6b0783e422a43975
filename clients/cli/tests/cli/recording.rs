//! Recordings: files that are whole however they end.

use std::fs;

use serde_json::json;

use crate::support::{Daemon, object, until};

/// A folder, and the path of a file in it.
fn file(name: &str) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name).to_str().unwrap().to_owned();
    (folder, path)
}

/// Whether a file of that kind was ended.
fn is_whole(path: &str) -> bool {
    let bytes = fs::read(path).unwrap();
    let end: &[u8] = if path.ends_with(".mcap") {
        b"\x89MCAP0\r\n"
    } else {
        b"PAR1"
    };
    bytes.starts_with(end) && bytes.ends_with(end) && bytes.len() > 100
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_of_so_many_steps_is_a_whole_file() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10 --publish-every 1").await;
    for name in ["take.parquet", "take.mcap"] {
        let (folder, path) = file(name);
        let recording = daemon.begin(&format!("--json record demo -o {path} --steps 20"));
        until("the recording has begun", async || {
            fs::exists(format!("{path}.partial")).unwrap()
        })
        .await;
        daemon.jostle("run demo").await;
        let told = object(&recording.end().await);
        daemon.jostle("pause demo").await;
        assert_eq!(
            (&told["swarm"], &told["file"]),
            (&json!("demo"), &json!(path))
        );
        assert!(told["frames"].as_u64() > Some(1), "{told}");
        assert_eq!(told["bytes"], fs::metadata(&path).unwrap().len());
        assert!(is_whole(&path));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn ctrl_c_and_the_swarms_deletion_end_a_recording_whole() {
    let daemon = Daemon::start().await;
    for name in ["take.parquet", "take.mcap"] {
        let (_folder, path) = file(name);
        daemon.jostle("create demo --n 10").await;
        let recording = daemon.begin(&format!("record demo -o {path}"));
        let partial = format!("{path}.partial");
        until("the recording has begun", async || {
            fs::exists(&partial).unwrap()
        })
        .await;
        recording.interrupt();
        let ended = recording.end().await;
        assert_eq!((ended.code, &*ended.stderr), (Some(0), ""), "{ended:?}");
        assert!(ended.stdout.contains("of demo to"), "{ended:?}");
        assert!(is_whole(&path));

        let recording = daemon.begin(&format!("record demo -o {path} --force"));
        until("the recording has begun", async || {
            fs::exists(&partial).unwrap()
        })
        .await;
        daemon.jostle("delete demo").await;
        let ended = recording.end().await;
        assert_eq!(ended.code, Some(0), "{ended:?}");
        assert!(ended.stderr.contains("demo was deleted"), "{ended:?}");
        assert!(is_whole(&path));
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_recorded_is_said_and_what_is_there_stays() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;
    let (folder, path) = file("take.mcap");
    fs::write(&path, "old").unwrap();
    let line = format!("record demo -o {path} --for 0.1");
    let refusal = daemon.refusal(&line).await;
    assert_eq!(refusal["code"], "invalid_argument");
    assert!(refusal["message"].as_str().unwrap().contains("--force"));
    assert_eq!(fs::read(&path).unwrap(), b"old");

    fs::write(format!("{path}.partial"), "").unwrap();
    let refusal = daemon.refusal(&format!("{line} --force")).await;
    assert!(
        refusal["message"]
            .as_str()
            .unwrap()
            .contains(".partial is there")
    );
    fs::remove_file(format!("{path}.partial")).unwrap();

    let ended = daemon.jostle(&format!("{line} --force")).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(is_whole(&path));

    let refusal = daemon.refusal("record demo -o take.csv").await;
    assert!(refusal["message"].as_str().unwrap().contains(".parquet"));
    let nowhere = folder.path().join("nowhere/take.mcap");
    let refusal = daemon
        .refusal(&format!("record demo -o {}", nowhere.display()))
        .await;
    assert_eq!(refusal["code"], "internal");
    let refusal = daemon
        .refusal(&format!("record nobody -o {path} --force"))
        .await;
    assert_eq!(refusal["code"], "not_found");
    assert!(is_whole(&path));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_recorded_is_replayed_under_a_name_and_sought_through() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10 --publish-every 1").await;
    let (folder, path) = file("Take.mcap");
    let recording = daemon.begin(&format!("--json record demo -o {path} --steps 40"));
    until("the recording has begun", async || {
        fs::exists(format!("{path}.partial")).unwrap()
    })
    .await;
    daemon.jostle("run demo").await;
    let frames = object(&recording.end().await)["frames"].clone();

    let told = object(
        &daemon
            .jostle(&format!("--json replay {path} --paused"))
            .await,
    );
    assert_eq!(told["result"]["replay"]["of"], "demo");
    assert_eq!(told["result"]["replay"]["frames"], frames);
    let status = object(&daemon.jostle("--json status take").await);
    assert_eq!(
        (&status["phase"], &status["step"]),
        (&json!("paused"), &json!(0))
    );
    let sought = daemon.jostle("seek take --fraction 1").await;
    assert_eq!(sought.code, Some(0), "{sought:?}");
    let shown = daemon.jostle("status take").await.stdout;
    assert!(shown.contains("replay"), "{shown}");
    assert!(
        shown.contains(&format!("frame {frames} of {frames}")),
        "{shown}"
    );
    assert!(!shown.contains("state hash"), "{shown}");
    let listed = daemon.jostle("list").await.stdout;
    assert!(listed.contains("replay, "), "{listed}");

    let again = daemon.refusal(&format!("replay {path}")).await;
    assert_eq!(again["code"], "already_exists");
    let tape = daemon
        .jostle(&format!("replay {path} --as tape --rate max"))
        .await;
    assert!(tape.stdout.contains("tape replays demo"), "{tape:?}");
    // What cannot be done to its end leaves nothing behind.
    let refused = daemon
        .refusal(&format!("replay {path} --as never --rate 0"))
        .await;
    assert_eq!(refused["code"], "invalid_argument");
    assert_eq!(daemon.refusal("status never").await["code"], "not_found");
    let refused = daemon.refusal("replay /dev/null --as never").await;
    assert!(refused["message"].as_str().unwrap().contains("is no file"));
    let live = daemon.refusal("seek demo --step 3").await;
    assert_eq!(live["code"], "incorrect_state");
    for line in [
        "seek take",
        "seek take --step 1 --time 1",
        "replay",
        "replay a --recording b",
    ] {
        let ended = daemon.jostle(line).await;
        assert_eq!(ended.code, Some(2), "{line}: {ended:?}");
    }
    let table = folder.path().join("take.parquet");
    fs::write(&table, "PAR1").unwrap();
    let refusal = daemon.refusal(&format!("replay {}", table.display())).await;
    assert!(refusal["message"].as_str().unwrap().contains(".mcap"));
    let refusal = daemon.refusal("replay nowhere.mcap").await;
    assert!(refusal["message"].as_str().unwrap().contains("not there"));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_daemon_records_lists_stops_and_deletes() {
    let daemon = Daemon::start().await;
    daemon
        .jostle("create demo --n 10 --publish-every 1 --rate 1")
        .await;
    let ended = daemon.jostle("record --list").await;
    assert!(
        ended.stderr.contains("--at-daemon` begins one"),
        "{ended:?}"
    );
    daemon.jostle("run demo").await;
    let ended = daemon.jostle("record demo --at-daemon").await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(ended.stdout.contains("--stop demo-1"), "{ended:?}");
    let line = "record demo --at-daemon --as table --format parquet --every 10";
    let begun = daemon.reply(line).await;
    let result = &begun["result"];
    assert_eq!(
        (&result["format"], &result["every"]),
        (&json!("parquet"), &json!(10))
    );
    let refusal = daemon.refusal(line).await;
    assert_eq!(refusal["code"], "already_exists");
    let refusal = daemon.refusal("record nobody --at-daemon").await;
    assert_eq!(refusal["code"], "not_found");

    until("some frames are recorded", async || {
        let list = daemon.reply("record --list").await;
        let recordings = list["result"]["recordings"].as_array().unwrap();
        let frames = recordings.iter().map(|it| it["frames"].as_u64().unwrap());
        frames.min() >= Some(3)
    })
    .await;
    let listed = daemon.jostle("record --list").await.stdout;
    for word in ["recording", "demo-1", "table", "parquet", "missed"] {
        assert!(listed.contains(word), "{listed}");
    }
    let ended = daemon.jostle("record --stop demo-1").await;
    assert!(
        ended.stdout.contains("demo-1 is ended (stopped): "),
        "{ended:?}"
    );
    assert!(ended.stdout.contains("in 1 part"), "{ended:?}");
    let deleted = daemon.jostle("record --delete table").await;
    assert_eq!(deleted.stdout.trim(), "deleted table");
    let refusal = daemon.refusal("record --stop table").await;
    assert_eq!(refusal["code"], "not_found");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_is_asked_to_end_ends_the_file_whole() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;
    for signal in ["-TERM", "-HUP"] {
        let (_folder, path) = file("take.parquet");
        let recording = daemon.begin(&format!("record demo -o {path}"));
        until("the recording has begun", async || {
            fs::exists(format!("{path}.partial")).unwrap()
        })
        .await;
        recording.signal(signal);
        let ended = recording.end().await;
        assert_eq!(ended.code, Some(0), "{signal}: {ended:?}");
        assert!(is_whole(&path), "{signal}");
    }
    daemon.stop().await;
}
