//! Recordings whose process was killed.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use jostle_proto::State;
use jostle_results::recording::{self, partial};
use serde_json::{Value, json};

use crate::recording::{file, is_whole};
use crate::support::{Daemon, Running, until};

/// What a kill may cost at most.
const PERMITTED: Duration = Duration::from_secs(5);

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

/// Kills a recording, recovers the file, and checks that at most 5 s are missing.
async fn kill_and_recover(daemon: &Daemon, killed: &mut Killed) -> u64 {
    let recorder = killed.recorder.take().unwrap();
    recorder.signal("-KILL");
    assert_eq!(recorder.end().await.code, None);
    let path = &killed.path;
    assert!(!Path::new(path).exists());
    let line = format!("record --recover {path}");
    if killed.step_before == 0 && killed.after < Duration::from_secs(1) {
        // It may have been killed before its first state.
        let ended = daemon.jostle(&line).await;
        let has_none = ended.stderr.contains("holds no state");
        assert!(ended.code == Some(0) || has_none, "{ended:?}");
        return 0;
    }
    let text = daemon.reply(&line).await;
    assert_eq!(
        (&text["file"], &text["recovered"]),
        (&json!(path), &json!(true))
    );
    let last = text["last_step"].as_u64().unwrap();
    assert!(
        last >= killed.step_before,
        "{last} < {}",
        killed.step_before
    );
    assert!(is_whole(path));
    assert_eq!(text["bytes"], fs::metadata(path).unwrap().len());
    assert!(!partial(Path::new(path)).exists());
    if path.ends_with(".mcap") {
        let mut frames: Vec<(u64, u64)> = Vec::new();
        let about = recording::read(Path::new(path), |message| {
            if message.topic == "state" {
                let state = State::from_cbor(message.bytes).unwrap();
                frames.push((state.frame, state.step));
            }
            Ok(())
        });
        let about = about.unwrap();
        assert_eq!(
            (&about["swarm"], &about["recovered"]),
            (&"demo".into(), &"true".into())
        );
        assert_eq!(text["frames"], frames.len());
        assert_eq!(about["frames"], frames.len().to_string());
        assert_missed(about["missed"].parse().unwrap(), &frames);
    }
    last
}

/// Checks the number of missed states by the numbers and the steps of those in the file. A busy machine
/// may lose published states: those are counted.
fn assert_missed(missed: u64, frames: &[(u64, u64)]) {
    let lost = |pair: &[(u64, u64)]| pair[1].0 - pair[0].0 - 1;
    let Some((first, later)) = frames.split_at_checked(2) else {
        return assert_eq!(missed, 0, "{frames:?}");
    };
    let after: u64 = frames[1..].windows(2).map(lost).sum();
    // The first was queried. What was published before it was taken has numbers above its own, and is not
    // missed: only the steps between can be.
    let between = lost(first).min(first[1].1 - first[0].1 - 1);
    let is_right = (after..=after + between).contains(&missed);
    assert!(
        is_right,
        "{missed} of {between} and {after}: {first:?} {later:?}"
    );
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
            // From immediately to well above the permitted loss.
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
                let mut known =
                    known.filter(|(at, _)| at.elapsed() >= PERMITTED && *at > killed.begun);
                let known = known.next().map(|(_, step)| *step);
                // On a busy machine a status takes seconds.
                if known.is_none() && killed.after > PERMITTED + Duration::from_secs(2) {
                    continue;
                }
                killed.step_before = known.unwrap_or(0);
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
async fn an_error_about_an_unfinished_file_names_the_recover_command() {
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
