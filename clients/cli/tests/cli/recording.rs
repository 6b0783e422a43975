//! Recordings: files that are whole however they end.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use jostle_results::recording::{self, partial};
use serde_json::{Value, json};

use crate::support::{Daemon, Running, object, until};

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
        let recording = daemon.begin(&format!(
            "--json record demo --published -o {path} --steps 20"
        ));
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
        let recording = daemon.begin(&format!("record demo --published -o {path}"));
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

        let recording = daemon.begin(&format!("record demo --published -o {path} --force"));
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
    let line = format!("record demo --published -o {path} --for 0.1");
    let refusal = daemon.refusal(&line).await;
    assert_eq!(refusal["code"], "invalid_argument");
    assert!(refusal["message"].as_str().unwrap().contains("--force"));
    assert_eq!(fs::read(&path).unwrap(), b"old");

    fs::write(format!("{path}.partial"), "").unwrap();
    let refusal = daemon.refusal(&format!("{line} --force")).await;
    let message = refusal["message"].as_str().unwrap();
    assert!(message.contains(".partial is there"), "{message}");
    let remedy = format!("`jostle record --recover {path}`");
    assert!(message.contains(&remedy), "{message}");
    fs::remove_file(format!("{path}.partial")).unwrap();

    let ended = daemon.jostle(&format!("{line} --force")).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(is_whole(&path));

    let refusal = daemon.refusal("record demo --published -o take.csv").await;
    assert!(refusal["message"].as_str().unwrap().contains(".parquet"));
    let nowhere = folder.path().join("nowhere/take.mcap");
    let refusal = daemon
        .refusal(&format!("record demo --published -o {}", nowhere.display()))
        .await;
    assert_eq!(refusal["code"], "internal");
    let refusal = daemon
        .refusal(&format!("record missing --published -o {path} --force"))
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
    let recording = daemon.begin(&format!(
        "--json record demo --published -o {path} --steps 40"
    ));
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
        assert_eq!(ended.code, Some(3), "{ended:?}");
        assert!(ended.stderr.contains("`jostle record --list`"), "{ended:?}");
    }
    let ended = daemon.jostle("record --stop demo-2").await;
    assert!(ended.stderr.contains("did you mean `demo-1`?"), "{ended:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_is_asked_to_end_ends_the_file_whole() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;
    for signal in ["-TERM", "-HUP"] {
        let (_folder, path) = file("take.parquet");
        let recording = daemon.begin(&format!("record demo --published -o {path}"));
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

/// A recording that is to be killed.
struct Killed {
    path: String,
    recorder: Option<Running>,
    begun: Instant,
    /// How long after that.
    after: Duration,
    /// The step that the swarm had 5 s before the kill, or 0.
    step_before: u64,
}

/// Kills a recording, makes a whole file of it, and checks that what is missing is 5 s at most.
async fn kill_and_recover(daemon: &Daemon, killed: &mut Killed) -> u64 {
    let recorder = killed.recorder.take().unwrap();
    recorder.signal("-KILL");
    assert_eq!(recorder.end().await.code, None);
    let path = &killed.path;
    assert!(!Path::new(path).exists());
    let line = format!("record --recover {path}");
    if killed.step_before == 0 && killed.after < Duration::from_secs(1) {
        // It may have been killed before its first state was there.
        let ended = daemon.jostle(&line).await;
        let has_none = ended.stderr.contains("holds no state");
        assert!(ended.code == Some(0) || has_none, "{ended:?}");
        return 0;
    }
    let told = daemon.reply(&line).await;
    assert_eq!(
        (&told["file"], &told["recovered"]),
        (&json!(path), &json!(true))
    );
    let last = told["last_step"].as_u64().unwrap();
    assert!(
        last >= killed.step_before,
        "{last} < {}",
        killed.step_before
    );
    assert!(is_whole(path));
    assert_eq!(told["bytes"], fs::metadata(path).unwrap().len());
    assert!(!partial(Path::new(path)).exists());
    if path.ends_with(".mcap") {
        let mut frames = 0;
        let about = recording::read(Path::new(path), |message| {
            frames += u64::from(message.topic == "state");
            Ok(())
        });
        let about = about.unwrap();
        assert_eq!(
            (&about["swarm"], &about["recovered"]),
            (&"demo".into(), &"true".into())
        );
        assert_eq!(told["frames"], frames);
        assert_eq!(about["frames"], frames.to_string());
        assert_eq!(about["missed"], "0");
    }
    last
}

#[tokio::test(flavor = "multi_thread")]
async fn killed_at_any_moment_a_recording_loses_five_seconds_at_most() {
    const KILLS: u32 = 10;
    let daemon = Daemon::start().await;
    daemon
        .jostle("create demo --n 10 --publish-every 1 --rate 1")
        .await;
    daemon.jostle("run demo").await;
    daemon.until_running("demo").await;
    let folder = tempfile::tempdir().unwrap();
    for format in ["mcap", "parquet"] {
        let mut recordings = Vec::new();
        for number in 0..KILLS {
            let path = folder.path().join(format!("take-{number}.{format}"));
            let path = path.to_str().unwrap().to_owned();
            let recorder = daemon.begin(&format!("record demo --published -o {path}"));
            until("the recording has begun", async || {
                fs::metadata(format!("{path}.partial")).is_ok_and(|it| it.len() > 1000)
            })
            .await;
            // From at once to far beyond what may be lost, at odd moments.
            let after = Duration::from_millis(u64::from(1 + 1237 * number));
            let begun = Instant::now();
            recordings.push(Killed {
                path,
                recorder: Some(recorder),
                begun,
                after,
                step_before: 0,
            });
        }
        let mut steps: Vec<(Instant, u64)> = Vec::new();
        let mut left = recordings.len();
        let mut recovered = Vec::new();
        while left > 0 {
            let status = daemon.reply("status demo").await;
            let now = Instant::now();
            steps.push((now, status["step"].as_u64().unwrap()));
            for killed in &mut recordings {
                if killed.recorder.is_none() || killed.begun.elapsed() < killed.after {
                    continue;
                }
                let known = steps.iter().rev();
                let mut known = known
                    .filter(|(at, _)| at.elapsed() >= Duration::from_secs(5) && *at > killed.begun);
                killed.step_before = known.next().map_or(0, |(_, step)| *step);
                recovered.push((kill_and_recover(&daemon, killed).await, killed.step_before));
                left -= 1;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        let checked = recovered.iter().filter(|(_, before)| *before > 0).count();
        assert!(checked >= 4, "{recovered:?}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_meets_an_unfinished_file_names_the_command_that_recovers_it() {
    let daemon = Daemon::start().await;
    daemon
        .jostle("create demo --n 10 --publish-every 1 --rate 1")
        .await;
    daemon.jostle("run demo").await;
    let (folder, path) = file("take.mcap");
    let recorder = daemon.begin(&format!("record demo --published -o {path}"));
    let partial = format!("{path}.partial");
    until("something is flushed", async || {
        fs::metadata(&partial).is_ok_and(|it| it.len() > 10_000)
    })
    .await;
    let message = |refusal: Value| refusal["message"].as_str().unwrap().to_owned();
    let said = message(daemon.refusal(&format!("record --recover {path}")).await);
    assert!(said.contains("another recording writes"), "{said}");
    let said = message(
        daemon
            .refusal(&format!("record demo --published -o {path}"))
            .await,
    );
    assert!(said.contains("another recording writes"), "{said}");
    recorder.signal("-KILL");
    recorder.end().await;

    let cut = folder.path().join("cut.mcap");
    fs::copy(&partial, &cut).unwrap();
    for (file, named) in [
        (&*path, &*partial),
        (&*partial, &*partial),
        (cut.to_str().unwrap(), cut.to_str().unwrap()),
    ] {
        let said = message(daemon.refusal(&format!("replay {file}")).await);
        let remedy = format!("`jostle record --recover {named}`");
        assert!(said.contains(&remedy), "{said}");
    }
    let said = message(
        daemon
            .refusal(&format!("record demo --published -o {path}"))
            .await,
    );
    assert!(
        said.contains(&format!("`jostle record --recover {path}`")),
        "{said}"
    );

    for file in [&partial, cut.to_str().unwrap()] {
        let said = daemon.said(&format!("record --recover {file}")).await;
        assert!(said.starts_with("recovered "), "{said}");
        assert!(said.contains(" up to step "), "{said}");
    }
    let again = daemon.said(&format!("record --recover {path}")).await;
    assert_eq!(again.trim(), format!("nothing to recover: {path} is whole"));
    for file in [&*path, cut.to_str().unwrap()] {
        let ended = daemon
            .jostle(&format!("replay {file} --as tape --paused"))
            .await;
        assert_eq!(ended.code, Some(0), "{ended:?}");
        daemon.said("delete tape").await;
    }

    let rubbish = folder.path().join("rubbish.mcap");
    fs::write(&rubbish, "no recording at all").unwrap();
    let line = format!("record --recover {}", rubbish.display());
    let said = message(daemon.refusal(&line).await);
    assert!(said.contains("it is no MCAP file"), "{said}");
    let nowhere = folder.path().join("nowhere.parquet");
    let refusal = daemon
        .refusal(&format!("record --recover {}", nowhere.display()))
        .await;
    assert!(message(refusal).contains("nowhere.parquet"));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_is_recovered_without_a_daemon() {
    let (_folder, path) = file("take.mcap");
    fs::write(format!("{path}.partial"), b"\x89MCAP0\r\n").unwrap();
    let line = format!("--json record --recover {path}");
    let ended = Running::begin("tcp/127.0.0.1:1", &line, "").end().await;
    assert!(ended.stderr.contains("holds no state"), "{ended:?}");
    for line in ["--for 1", "--list", "--out b.mcap", "demo"] {
        let line = format!("record --recover {path} {line}");
        let ended = Running::begin("tcp/127.0.0.1:1", &line, "").end().await;
        assert_eq!(ended.code, Some(2), "{line}: {ended:?}");
    }
}

/// The example of the README runs as it stands there, up to what goes on until Ctrl-C.
#[tokio::test(flavor = "multi_thread")]
async fn the_example_of_a_replay_in_the_readme_runs_as_it_is_written() {
    let daemon = Daemon::start().await;
    let folder = tempfile::tempdir().unwrap();
    let readme = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../README.md");
    let readme = fs::read_to_string(readme).unwrap();
    let mut blocks = readme.split("```");
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
