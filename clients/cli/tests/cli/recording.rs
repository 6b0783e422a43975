//! Recordings: files are complete however the recording ends.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::json;

use crate::support::{Daemon, object, until};

/// A folder, and the path of a file in it.
pub fn file(name: &str) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name).to_str().unwrap().to_owned();
    (folder, path)
}

/// Waits until this machine records to a file.
async fn begun(path: &str) {
    let partial = format!("{path}.partial");
    let exists = async || fs::exists(&partial).unwrap();
    until("the recording has begun", exists).await;
}

/// Checks that recordings with these options are rejected if they are impossible, and that existing
/// files stay.
pub async fn assert_impossible_is_rejected(daemon: &Daemon, options: &str) {
    let (folder, path) = file("take.mcap");
    fs::write(&path, "old").unwrap();
    let line = format!("record demo {options}-o {path} --for 0.1");
    let refusal = daemon.refusal(&line).await;
    assert_eq!(refusal["code"], "invalid_argument");
    assert!(refusal["message"].as_str().unwrap().contains("--force"));
    assert_eq!(fs::read(&path).unwrap(), b"old");

    fs::write(format!("{path}.partial"), "").unwrap();
    let refusal = daemon.refusal(&format!("{line} --force")).await;
    let message = refusal["message"].as_str().unwrap();
    assert!(message.contains(".partial exists"), "{message}");
    let remedy = format!("`jostle record --recover {path}`");
    assert!(message.contains(&remedy), "{message}");
    fs::remove_file(format!("{path}.partial")).unwrap();

    let ended = daemon.jostle(&format!("{line} --force")).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(is_whole(&path));

    let line = format!("record demo {options}-o take.csv");
    let refusal = daemon.refusal(&line).await;
    assert!(refusal["message"].as_str().unwrap().contains(".parquet"));
    let nowhere = folder.path().join("nowhere/take.mcap");
    let line = format!("record demo {options}-o {}", nowhere.display());
    assert_eq!(daemon.refusal(&line).await["code"], "internal");
    let line = format!("record missing {options}-o {path} --force");
    assert_eq!(daemon.refusal(&line).await["code"], "not_found");
    assert!(is_whole(&path));
}

/// Whether a file is complete.
pub fn is_whole(path: &str) -> bool {
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
        let recording = daemon.begin(&format!(
            "--json record demo --published -o {path} --steps 20"
        ));
        begun(&path).await;
        daemon.jostle("run demo").await;
        let text = object(&recording.end().await);
        daemon.jostle("pause demo").await;
        assert_eq!(
            (&text["swarm"], &text["file"]),
            (&json!("demo"), &json!(path))
        );
        assert!(text["frames"].as_u64() > Some(1), "{text}");
        assert_eq!(text["bytes"], fs::metadata(&path).unwrap().len());
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
        let recording = daemon.begin(&format!("record demo --published -o {path}"));
        begun(&path).await;
        recording.interrupt();
        let ended = recording.end().await;
        assert_eq!((ended.code, &*ended.stderr), (Some(0), ""), "{ended:?}");
        assert!(ended.stdout.contains("of demo to"), "{ended:?}");
        assert!(is_whole(&path));

        let recording = daemon.begin(&format!("record demo --published -o {path} --force"));
        begun(&path).await;
        daemon.jostle("delete demo").await;
        let ended = recording.end().await;
        ended.assert_stderr(0, "demo was deleted");
        assert!(is_whole(&path));
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_impossible_recording_is_rejected_and_existing_files_stay() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;
    assert_impossible_is_rejected(&daemon, "--published ").await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_is_played_under_a_name_and_can_be_sought() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10 --publish-every 1").await;
    let (folder, path) = file("Take.mcap");
    let recording = daemon.begin(&format!(
        "--json record demo --published -o {path} --steps 40"
    ));
    begun(&path).await;
    daemon.jostle("run demo").await;
    let frames = object(&recording.end().await)["frames"].clone();

    let text = object(
        &daemon
            .jostle(&format!("--json replay {path} --paused"))
            .await,
    );
    assert_eq!(text["result"]["replay"]["of"], "demo");
    assert_eq!(text["result"]["replay"]["frames"], frames);
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
    // A request that fails leaves nothing behind.
    let refused = daemon
        .refusal(&format!("replay {path} --as never --rate 0"))
        .await;
    assert_eq!(refused["code"], "invalid_argument");
    assert_eq!(daemon.refusal("status never").await["code"], "not_found");
    let refused = daemon.refusal("replay /dev/null --as never").await;
    assert!(
        refused["message"]
            .as_str()
            .unwrap()
            .contains("is not a file")
    );
    let last = object(&daemon.jostle("--json status take").await)["step"].clone();
    for beyond in ["--step 1000000", "--time 1e9"] {
        let ended = daemon.jostle(&format!("seek take {beyond}")).await;
        assert_eq!(ended.code, Some(2), "{ended:?}");
        assert!(
            ended
                .stderr
                .contains("is outside the run that was recorded"),
            "{ended:?}"
        );
        let range = format!("from 0 to {last}, or a fraction from 0 to 1");
        assert!(
            !beyond.contains("step") || ended.stderr.contains(&range),
            "{ended:?}"
        );
    }
    let half = object(&daemon.jostle("--json seek take --fraction 50%").await);
    assert!(
        half["step"].as_u64() > Some(0) && half["step"].as_u64() < last.as_u64(),
        "{half}"
    );
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
    assert!(
        refusal["message"]
            .as_str()
            .unwrap()
            .contains("does not exist")
    );
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
        ended.stderr.contains("--at-daemon` starts one"),
        "{ended:?}"
    );
    daemon.jostle("run demo").await;
    let ended = daemon.jostle("record demo --at-daemon").await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(ended.stdout.contains("--stop demo-1"), "{ended:?}");
    let line = "record demo --at-daemon --as table --every 10";
    let begun = daemon.reply(line).await;
    let result = &begun["result"];
    assert_eq!(
        (&result["format"], &result["every"]),
        (&json!("mcap"), &json!(10))
    );
    let refusal = daemon.refusal(line).await;
    assert_eq!(refusal["code"], "already_exists");
    let refusal = daemon.refusal("record missing --at-daemon").await;
    assert_eq!(refusal["code"], "not_found");

    until("some frames are recorded", async || {
        let list = daemon.reply("record --list").await;
        let recordings = list["result"]["recordings"].as_array().unwrap();
        let frames = recordings.iter().map(|it| it["frames"].as_u64().unwrap());
        frames.min() >= Some(3)
    })
    .await;
    let listed = daemon.jostle("record --list").await.stdout;
    for word in ["recording", "demo-1", "table", "mcap", "missed"] {
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
    for option in ["--stop", "--delete"] {
        let line = format!("record {option} table");
        assert_eq!(daemon.refusal(&line).await["code"], "not_found");
        let ended = daemon.jostle(&line).await;
        ended.assert_stderr(3, "`jostle record --list`");
    }
    let ended = daemon.jostle("record --stop demo-2").await;
    assert!(ended.stderr.contains("did you mean `demo-1`?"), "{ended:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_signal_completes_the_file() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;
    for signal in ["-TERM", "-HUP"] {
        let (_folder, path) = file("take.parquet");
        let recording = daemon.begin(&format!("record demo --published -o {path}"));
        begun(&path).await;
        recording.signal(signal);
        let ended = recording.end().await;
        assert_eq!(ended.code, Some(0), "{signal}: {ended:?}");
        assert!(is_whole(&path), "{signal}");
    }
    daemon.stop().await;
}

/// Runs the example of docs/recording.md; Ctrl-C ends its last command.
#[tokio::test(flavor = "multi_thread")]
async fn the_example_of_a_replay_in_the_docs_runs_as_it_is_written() {
    let daemon = Daemon::start().await;
    let folder = tempfile::tempdir().unwrap();
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/recording.md");
    let page = fs::read_to_string(page).unwrap();
    let mut blocks = page.split("```");
    let block = blocks.find(|block| block.starts_with("sh\n") && block.contains("jostle replay"));
    let block = block.unwrap().trim_start_matches("sh\n").trim();
    let (script, watch) = block.rsplit_once('\n').unwrap();
    assert!(script.contains("jostle seek tape"), "{script}");
    let programs = Path::new(env!("CARGO_BIN_EXE_jostle")).parent().unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let ran = Command::new("sh")
        .args(["-ec", script])
        .current_dir(folder.path())
        .env("PATH", path)
        .env("JOSTLE_ENDPOINT", &daemon.endpoint)
        .output()
        .unwrap();
    assert!(ran.status.success(), "{ran:?}");
    let tape = daemon.reply("status tape").await;
    assert_eq!(tape["result"]["replay"]["of"], "flock");
    let mut watching = daemon.begin(watch.trim_start_matches("jostle "));
    watching.lines(1);
    watching.interrupt();
    watching.end().await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_without_a_frame_says_why_and_is_not_played() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start().await;
    daemon.said("create school -n 3").await;
    daemon.said("step school 7").await;
    let file = folder.path().join("none.mcap").display().to_string();
    let said = daemon
        .said(&format!("record school -o {file} --for 0.2 --every 5"))
        .await;
    assert!(said.contains("recorded 0 frames of school"), "{said}");
    let hint = "school reached no step that is a multiple of 5: `jostle run school` runs one";
    assert!(said.contains(hint), "{said}");
    let played = daemon.jostle(&format!("replay {file} --as again")).await;
    assert_eq!(played.code, Some(2), "{played:?}");
    let reason = "it has no frame: while it was recorded the swarm reached no step that it records";
    assert!(played.stderr.contains(reason), "{played:?}");
}
