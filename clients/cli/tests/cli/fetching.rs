//! Recordings on the daemon, fetched into a file.

use std::fs;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::mpsc::channel;
use std::time::Duration;

use jostle_proto::{Role, State};
use jostle_results::recording::{self, About};
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use serde_json::{Value, json};

use crate::recording::{assert_impossible_is_rejected, file, is_whole};
use crate::support::{Daemon, Ended, Link, Running, TIMEOUT, object, until};

/// The names of the daemon's recordings.
async fn listed(daemon: &Daemon) -> Vec<String> {
    let list = daemon.reply("record --list").await;
    let recordings = list["result"]["recordings"].as_array().unwrap().iter();
    recordings
        .map(|it| it["recording"].as_str().unwrap().to_owned())
        .collect()
}

/// The steps and the metadata of a recording in MCAP.
fn read(path: &str) -> (Vec<u64>, About) {
    let mut steps = Vec::new();
    let about = recording::read(Path::new(path), |message| {
        if message.topic == "state" {
            steps.push(State::from_cbor(message.bytes).unwrap().step);
        }
        Ok(())
    });
    (steps, about.unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_of_so_many_steps_is_a_whole_file() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10 --publish-every 1").await;
    for name in ["take.parquet", "take.mcap"] {
        let (folder, path) = file(name);
        let recording = daemon.begin(&format!("--json record demo -o {path} --steps 20"));
        daemon.until_recording().await;
        daemon.jostle("run demo").await;
        let shown = object(&recording.end().await);
        daemon.jostle("pause demo").await;
        assert_eq!(
            (&shown["swarm"], &shown["file"]),
            (&json!("demo"), &json!(path))
        );
        assert_eq!(shown["frames"], 21, "{shown}");
        assert_eq!(shown["bytes"], fs::metadata(&path).unwrap().len());
        assert!(is_whole(&path));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_that_is_cut_keeps_its_spec() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10 --publish-every 1").await;
    for name in ["take.mcap", "take.parquet"] {
        let (_folder, path) = file(name);
        let line = format!("record demo -o {path} --every 1 --steps 3000");
        let recording = daemon.begin(&line);
        daemon.until_recording().await;
        daemon.said("step demo 3000 --timeout 60").await;
        assert_eq!(recording.end().await.code, Some(0));
        let whole = fs::OpenOptions::new().write(true).open(&path).unwrap();
        whole
            .set_len(whole.metadata().unwrap().len() * 2 / 3)
            .unwrap();
        let ended = daemon.jostle(&format!("record --recover {path}")).await;
        if name == "take.parquet" {
            ended.assert_stderr(2, "a Parquet file whose end is missing cannot be read");
            continue;
        }
        assert_eq!(ended.code, Some(0), "{ended:?}");
        let (steps, about) = read(&path);
        assert!(about.contains_key("spec"), "{about:?}");
        assert_eq!(about["frames"], steps.len().to_string());
        daemon.said(&format!("replay {path} --as shown")).await;
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
        daemon.until_recording().await;
        recording.interrupt();
        let ended = recording.end().await;
        ended.assert_stderr(0, "fetching the rest");
        assert!(ended.stdout.contains("of demo to"), "{ended:?}");
        assert!(is_whole(&path));

        let recording = daemon.begin(&format!("record demo -o {path} --force"));
        daemon.until_recording().await;
        daemon.jostle("delete demo").await;
        let ended = recording.end().await;
        assert_eq!(ended.code, Some(0), "{ended:?}");
        let reason = "the recording has ended: its swarm was deleted";
        assert!(ended.stderr.contains(reason), "{ended:?}");
        assert!(is_whole(&path));
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_impossible_recording_is_rejected_and_existing_files_stay() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;
    assert_impossible_is_rejected(&daemon, "").await;
    let (folder, path) = file("take.mcap");
    for missing in [
        "record nix --at-daemon".to_owned(),
        format!("record nix -o {path} --for 0.1 --force"),
    ] {
        let refusal = daemon.refusal(&missing).await;
        assert_eq!(refusal["code"], "not_found");
        let message = refusal["message"].as_str().unwrap();
        assert!(message.contains("`jostle list`"), "{missing}: {refusal}");
    }
    let live = folder.path().join("live.mcap");
    let (live, draft) = (live.display(), format!("{}.partial", live.display()));
    let recording = daemon.begin(&format!("record demo --published -o {live}"));
    until("it records", async || fs::exists(&draft).unwrap()).await;
    let refusal = daemon.refusal(&format!("record demo -o {live}")).await;
    let message = refusal["message"].as_str().unwrap();
    assert!(message.contains("another recording writes"), "{refusal}");
    recording.interrupt();
    assert_eq!(recording.end().await.code, Some(0));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_signal_completes_the_file() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10").await;
    for signal in ["-TERM", "-HUP"] {
        let (_folder, path) = file("take.parquet");
        let recording = daemon.begin(&format!("record demo -o {path}"));
        daemon.until_recording().await;
        recording.signal(signal);
        let ended = recording.end().await;
        assert_eq!(ended.code, Some(0), "{signal}: {ended:?}");
        assert!(is_whole(&path), "{signal}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn at_rate_max_every_state_is_in_the_file_and_the_daemon_keeps_no_copy() {
    let daemon = Daemon::start().await;
    for name in ["take.mcap", "take.parquet"] {
        daemon.jostle("create demo --n 10 --publish-every 1").await;
        let (folder, path) = file(name);
        let line = format!("--json record demo -o {path} --steps 2000");
        let recording = daemon.begin(&line);
        daemon.until_recording().await;
        daemon.said("run demo --rate max --until-step 2500").await;
        let shown = object(&recording.end().await);
        assert_eq!(
            (
                &shown["frames"],
                &shown["missed"],
                &shown["every"],
                &shown["source"]
            ),
            (&json!(2001), &json!(0), &json!(1), &json!("steps")),
            "{shown}"
        );
        assert_eq!(shown["kept"], false);
        assert!(is_whole(&path));
        assert_eq!(
            fs::read_dir(folder.path()).unwrap().count(),
            1,
            "no part is left"
        );
        assert!(listed(&daemon).await.is_empty());
        if name == "take.mcap" {
            let (steps, about) = read(&path);
            assert!(steps.iter().copied().eq(0..=2000));
            assert_eq!((&*about["source"], &*about["frames"]), ("steps", "2001"));
            assert!(about["spec"].contains("\"n\":10"), "{about:?}");
        }
        daemon.said("delete demo").await;
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_is_killed_leaves_its_recording_with_the_daemon() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10 --publish-every 1").await;
    let (folder, path) = file("take.mcap");
    let recording = daemon.begin(&format!("record demo -o {path}"));
    let name = daemon.until_recording().await;
    daemon.said("step demo 50").await;
    recording.signal("-KILL");
    recording.end().await;
    daemon.said("step demo 50").await;
    let fetch = format!("record --fetch {name} -o {path}");
    for asked in [format!("record --recover {path}"), format!("replay {path}")] {
        let ended = daemon.jostle(&asked).await;
        assert!(
            ended.stderr.contains(&format!("`jostle {fetch}`")),
            "{ended:?}"
        );
    }
    let refusal = daemon.refusal(&fetch).await;
    let message = refusal["message"].as_str().unwrap();
    assert!(message.contains(&format!("--stop {name}")), "{refusal}");
    daemon.said(&format!("record --stop {name}")).await;
    let shown = daemon.reply(&fetch).await;
    assert_eq!(
        (&shown["frames"], &shown["kept"]),
        (&json!(101), &json!(false))
    );
    assert!(read(&path).0.iter().copied().eq(0..=100));
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        1,
        "no part is left"
    );
    assert!(listed(&daemon).await.is_empty());
    let refusal = daemon.refusal(&format!("{fetch} --force")).await;
    assert!(
        refusal["message"].as_str().unwrap().contains("--list"),
        "{refusal}"
    );
    assert!(is_whole(&path));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_interrupted_fetch_resumes_and_a_permanent_recording_is_kept() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 50 --publish-every 1").await;
    daemon
        .said("record demo --at-daemon --as night --max-size 3MB")
        .await;
    daemon.said("step demo 1000").await;
    until("it has its size", async || {
        let list = daemon.reply("record --list").await;
        list["result"]["recordings"][0]["phase"] == "ended"
    })
    .await;
    let list = daemon.reply("record --list").await;
    let night = &list["result"]["recordings"][0];
    assert!(
        night["reason"]
            .as_str()
            .unwrap()
            .contains("max_bytes (3000000)"),
        "{night}"
    );
    assert_eq!(night["temporary"], false);
    let (folder, path) = file("night.mcap");
    // The part of an earlier client. It differs from the daemon's, to show that it is not fetched again.
    let parts = format!("{path}.night-{}.parts", night["began_unix_secs"]);
    fs::create_dir(&parts).unwrap();
    let whole = daemon.folder().join("recordings/night/part-00000.mcap");
    let whole = fs::read(whole).unwrap();
    fs::write(format!("{parts}/part-00000.mcap"), &whole[..700_000]).unwrap();
    let shown = daemon
        .reply(&format!("record --fetch night -o {path}"))
        .await;
    assert_eq!(
        (&shown["frames"], &shown["kept"]),
        (&night["frames"], &json!(true))
    );
    let (steps, _) = read(&path);
    assert!(
        steps
            .iter()
            .copied()
            .eq(0..night["frames"].as_u64().unwrap())
    );
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    assert_eq!(listed(&daemon).await, ["night"]);

    // A damaged part is rejected, and the daemon still has the recording.
    fs::create_dir(&parts).unwrap();
    let mut damaged = whole[..700_000].to_vec();
    damaged[350_000] ^= 1;
    fs::write(format!("{parts}/part-00000.mcap"), damaged).unwrap();
    let ended = daemon
        .jostle(&format!("record --fetch night -o {path} --force"))
        .await;
    assert_ne!(ended.code, Some(0), "{ended:?}");
    assert!(ended.stderr.contains("is damaged"), "{ended:?}");
    assert_eq!(read(&path).0, steps, "the file that was there stays");
    assert_eq!(listed(&daemon).await, ["night"]);
    daemon
        .said(&format!("record --fetch night -o {path} --force"))
        .await;

    // As an earlier version recorded it.
    daemon.said("record demo --at-daemon --as table").await;
    daemon.said("record --stop table").await;
    let status = daemon.folder().join("recordings/table/recording.json");
    let text = fs::read_to_string(&status).unwrap();
    fs::write(&status, text.replace("\"mcap\"", "\"parquet\"")).unwrap();
    let daemon = daemon.restart().await;
    let refusal = daemon
        .refusal(&format!("record --fetch table -o {path} --force"))
        .await;
    assert!(
        refusal["message"]
            .as_str()
            .unwrap()
            .contains("fetch_recording"),
        "{refusal}"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_continues_after_a_restart_of_the_daemon_and_is_fetched_completely() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 10 --publish-every 1").await;
    let (folder, path) = file("take.mcap");
    let recording = daemon.begin(&format!("record demo -o {path}"));
    daemon.until_recording().await;
    daemon.said("step demo 30").await;
    let daemon = daemon.restart().await;
    daemon.until_recording().await;
    daemon.said("step demo 30").await;
    // The part that `stop` completed is fetched while the daemon records.
    until("the first part is fetched", async || {
        let beside = fs::read_dir(folder.path()).unwrap();
        let mut beside = beside.map(|entry| entry.unwrap().path());
        beside.any(|path| path.join("part-00000.mcap").exists())
    })
    .await;
    recording.interrupt();
    let ended = recording.end().await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let (steps, _) = read(&path);
    let all: Vec<u64> = (0..=30).chain(30..=60).collect();
    assert_eq!(steps, all, "step 30 is in both epochs");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn without_permission_to_record_the_published_states_are_recorded_with_a_note() {
    let base = tempfile::tempdir().unwrap();
    let people = Folder::new(base.path().join("auth"));
    let roles = [("vera", Role::Viewer), ("olga", Role::Operator)];
    let named = roles.map(|(name, role)| (name.to_owned(), role));
    issue::init(&people, &[], &named).unwrap();
    let auth = people.path().to_str().unwrap().to_owned();
    let daemon = Daemon::with(&[("auth_dir", auth.as_str())]).await;
    let by = |person: &str, line: &str| {
        format!(
            "--credentials {} {line}",
            people.person_folder(person).display()
        )
    };
    daemon
        .said(&by("olga", "create demo --n 5 --publish-every 1"))
        .await;
    let (_folder, path) = file("take.mcap");
    for line in [
        by("vera", &format!("--json record demo -o {path} --for 0.3")),
        by(
            "olga",
            &format!("--json record demo -o {path} --for 0.3 --published --force"),
        ),
    ] {
        let ended = daemon.jostle(&line).await;
        assert_eq!(ended.code, Some(0), "{ended:?}");
        let shown: Value = serde_json::from_str(ended.stdout.trim()).unwrap();
        assert_eq!(
            (&shown["source"], &shown["frames"]),
            (&json!("published"), &json!(1))
        );
        assert_eq!(read(&path).1["source"], "published");
    }
    let line = by("vera", &format!("record demo -o {path} --for 0.1 --force"));
    let Ended { stdout, stderr, .. } = daemon.jostle(&line).await;
    assert!(
        stderr.contains("you are vera, a viewer, and record takes an operator"),
        "{stderr}"
    );
    assert!(
        stderr.contains("recording what is published instead"),
        "{stderr}"
    );
    assert!(stdout.contains("of those that it published"), "{stdout}");
    // An operator records on the daemon; a viewer may not fetch the recording.
    let line = by(
        "olga",
        &format!("--json record demo -o {path} --for 0.3 --force"),
    );
    assert_eq!(object(&daemon.jostle(&line).await)["source"], "steps");
    daemon
        .said(&by("olga", "record demo --at-daemon --as night"))
        .await;
    daemon.said(&by("olga", "record --stop night")).await;
    let line = by("vera", &format!("record --fetch night -o {path} --force"));
    let ended = daemon.jostle(&line).await;
    assert_eq!(ended.code, Some(5), "{ended:?}");
    assert_eq!(
        read(&path).1["source"],
        "steps",
        "the file that was there stays"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_that_lacks_a_part_is_fetched_without_it_and_the_exit_code_says_so() {
    let daemon = Daemon::start().await;
    daemon.jostle("create demo --n 5 --publish-every 1").await;
    daemon.jostle("record demo --at-daemon --as take").await;
    daemon.said("step demo 10").await;
    // Each restart begins another part.
    let daemon = daemon.restart().await;
    until("it goes on", async || {
        daemon.said("step demo 10").await;
        let list = daemon.reply("record --list").await;
        list["result"]["recordings"][0]["frames"].as_u64() > Some(12)
    })
    .await;
    daemon.said("record --stop take").await;
    let folder = daemon.folder().join("recordings/take");
    let [lost, kept] = [0, 1].map(|part| folder.join(format!("part-0000{part}.mcap")));
    fs::remove_file(lost).unwrap();
    let listed = daemon.said("record --list").await;
    assert!(
        listed.contains("failed") && listed.contains("part-00000.mcap"),
        "{listed}"
    );

    let (_folder, path) = file("take.mcap");
    let ended = daemon
        .jostle(&format!("record --fetch take -o {path}"))
        .await;
    ended.assert_stderr(3, "part-00000.mcap");
    let (steps, about) = read(&path);
    assert_eq!(steps, read(kept.to_str().unwrap()).0);
    assert_eq!(about["lost_parts"], "1");
    assert_eq!(
        self::listed(&daemon).await,
        ["take"],
        "the daemon keeps its copy"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_ctrl_c_says_what_the_daemon_may_go_on_with_and_how_to_end_it() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 10 --rate 1").await;
    daemon.said("run demo").await;
    let (_folder, path) = file("take.mcap");
    // A daemon that is suspended before it stops the recording, or before it has begun it.
    let link = Link::to(&daemon.endpoint);
    let mut recording = Running::begin(&link.endpoint, &format!("record demo -o {path}"), "");
    let name = daemon.until_recording().await;
    link.lose_answers();
    recording.interrupt();
    while !recording.complaint().contains("fetching the rest") {}
    recording.interrupt();
    let ended = recording.end().await;
    ended.assert_stderr(130, "interrupted: the daemon may record on: ");
    ended.assert_stderr(130, &format!("`jostle record --stop {name}` ends it"));
    let fetch = format!("`jostle record --fetch {name} -o {path}` fetches");
    ended.assert_stderr(130, &fetch);

    let link = Link::to(&daemon.endpoint);
    let (release, held) = channel();
    let is_sent = link.on(b"cmd/record", move || {
        let _ = held.recv_timeout(TIMEOUT);
    });
    let recording = Running::begin(&link.endpoint, &format!("record demo -o {path}"), "");
    until("it is sent", async || is_sent.load(Ordering::SeqCst)).await;
    recording.interrupt();
    // Signals that arrive at once count as one.
    tokio::time::sleep(Duration::from_millis(500)).await;
    recording.interrupt();
    let ended = recording.end().await;
    release.send(()).unwrap();
    ended.assert_stderr(130, "`jostle record --list` names");
    ended.assert_stderr(130, "`jostle record --stop NAME` ends it");
    daemon.stop().await;
}
