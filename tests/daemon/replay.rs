//! Playbacks: recordings shown as swarms.

use std::fs;
use std::os::unix::fs::FileExt as _;
use std::path::PathBuf;
use std::time::Duration;

use jostle_proto::{Error, ErrorCode, State, keys};
use jostle_results::recording::{self, About, Recorder};
use serde_json::{Value, json};

use crate::support::playback::{record, record_as, replay, state, upload_and_open, upload_piece};
use crate::support::recording::{ok, stop};
use crate::support::{Client, Daemon, PREFIX, QueryResult, until};

async fn seek_error(client: &Client, args: &Value) -> Error {
    let key = keys::cmd(PREFIX, "tape", "seek");
    let payload = json!({ "args": args }).to_string();
    client
        .query(&key, Some(payload.as_bytes()))
        .await
        .unwrap_err()
}

/// Fails unless a state equals a recorded one but for the swarm's name, epoch, frame and phase.
fn assert_shows(shown: &State, recorded: &State) {
    let as_recorded = State {
        swarm: recorded.swarm.clone(),
        epoch: recorded.epoch,
        frame: recorded.frame,
        phase: recorded.phase,
        ..shown.clone()
    };
    assert_eq!(&as_recorded, recorded);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_is_shown_to_the_bit_and_goes_wherever_it_is_sought() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    let recorded = record(client, &path).await;
    let shown = upload_and_open(client, "tape", &fs::read(&path).unwrap())
        .await
        .unwrap();
    let mut playback = shown["result"]["replay"].clone();
    let duration = playback["duration"].take().as_f64().unwrap();
    assert!((duration - 5.0).abs() < 1e-9, "{duration}");
    let expected =
        json!({"of": "live", "frame": 1, "frames": 52, "position": 0.0, "duration": null});
    assert_eq!(playback, expected);
    let status = client.get("tape", "status").await;
    assert_eq!(status["result"]["rate"], 20.0);

    assert_shows(&state(client, "tape").await, &recorded[0]);
    for (to, frame) in [
        (json!({"step": 52}), 10),
        (json!({"time": 2.0}), 20),
        (json!({"step": 200}), 40),
        (json!({"fraction": 1.0}), 51),
        (json!({"step": 0}), 41),
        (json!({"time": 0.55}), 46),
        (json!({"fraction": 0.0}), 0),
    ] {
        let before = client.get("tape", "status").await["epoch"].as_u64();
        let sought = client.ok("tape", "seek", to).await;
        assert!(sought["epoch"].as_u64() > before);
        assert_eq!(sought["step"], recorded[frame].step);
        assert_shows(&state(client, "tape").await, &recorded[frame]);
        let status = client.get("tape", "status").await;
        assert_eq!(status["result"]["replay"]["frame"], frame + 1);
        // The parameters are those of that time.
        let pi1 = if (20..41).contains(&frame) { 3.0 } else { 4.0 };
        assert_eq!(status["result"]["parameters"]["pi1"], pi1, "frame {frame}");
    }
    for (run, beyond, range) in [
        (0.0, json!({"step": 201}), "give a step from 0 to 200"),
        (
            0.0,
            json!({"step": 9_007_199_254_740_991_u64}),
            "give a step from 0 to 200",
        ),
        (0.0, json!({"time": 4.001}), "give a time from 0 to 4"),
        (0.0, json!({"time": 1e12}), "give a time from 0 to 4"),
        (1.0, json!({"step": 51}), "give a step from 0 to 50"),
        (1.0, json!({"time": 1.5}), "give a time from 0 to 1"),
    ] {
        client.ok("tape", "seek", json!({"fraction": run})).await;
        let before = client.get("tape", "status").await;
        let error = seek_error(client, &beyond).await;
        assert_eq!(
            error.code,
            ErrorCode::InvalidArgument,
            "{beyond}: {error:?}"
        );
        assert!(error.message.contains(range), "{beyond}: {error:?}");
        let field = beyond.as_object().unwrap().keys().next().unwrap();
        assert_eq!(error.details["field"], **field);
        assert!(error.details["range"].is_string(), "{error:?}");
        let after = client.get("tape", "status").await;
        assert_eq!(after, before, "{beyond}: it stays where it is");
    }
    let wait = keys::get(PREFIX, "tape", "wait?condition=order > 0.5;id=a");
    let error = client.query(&wait, None).await.unwrap_err();
    let expected = "one waits in it for a step or a phase, not for a condition";
    assert!(error.message.contains(expected), "{error:?}");
    client.ok("tape", "seek", json!({"fraction": 0})).await;
    // The last frame is not beyond the end, also by a rounded time.
    for last in [
        json!({"time": 4.0}),
        json!({"time": 3.999_999_999_9}),
        json!({"time": 4.000_000_000_1}),
    ] {
        let sought = client.ok("tape", "seek", last.clone()).await;
        assert_eq!(sought["step"], 200, "{last}");
    }
    client.ok("tape", "seek", json!({"step": 100})).await;
    for past in [json!({"until_step": 99}), json!({"until_time": 1.0})] {
        let (code, message) = client.err("tape", "run", past).await;
        assert_eq!(code, ErrorCode::Conflict, "{message}");
        assert!(message.contains("past"), "{message}");
    }
    client.ok("tape", "seek", json!({"fraction": 0})).await;
    let stepped = client.ok("tape", "step", json!({"steps": 5})).await;
    assert_eq!(stepped["result"]["steps"], 5);
    assert_shows(&state(client, "tape").await, &recorded[1]);
    client.ok("tape", "reset", json!({})).await;
    assert_shows(&state(client, "tape").await, &recorded[0]);
    let listed = client.node("swarms").await["swarms"].clone();
    let replays: Vec<&Value> = listed
        .as_array()
        .unwrap()
        .iter()
        .map(|it| &it["replay"])
        .collect();
    assert_eq!(replays, [false, true]);
    client.ok("tape", "delete", json!({})).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_playback_publishes_the_recorded_states_and_events() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    let recorded = record(client, &path).await;
    upload_and_open(client, "tape", &fs::read(&path).unwrap())
        .await
        .unwrap();
    let states = client
        .session
        .declare_subscriber(keys::state(PREFIX, "tape"))
        .with(zenoh::handlers::FifoChannel::new(1024))
        .await
        .unwrap();
    let began = std::time::Instant::now();
    client.ok("tape", "run", json!({"rate": 5.0})).await;
    let paused = client
        .get("tape", "wait?phase=paused;timeout_secs=20")
        .await;
    let took = began.elapsed();
    assert_eq!(paused["result"]["reason"], "finished");
    // Five time units at five a second.
    assert!(took > Duration::from_millis(900), "{took:?}");
    assert_eq!(paused["result"]["replay"]["frame"], 52);
    let mut epochs = Vec::new();
    let mut seen = 0;
    until("the last frame has come", async || {
        while let Ok(Some(sample)) = states.try_recv() {
            let shown = State::from_cbor(&sample.payload().to_bytes()).unwrap();
            let of = recorded
                .iter()
                .filter(|it| it.time == shown.time && it.x == shown.x);
            assert!(of.count() > 0, "step {}", shown.step);
            epochs.push(shown.epoch);
            seen = shown.step;
        }
        seen == 50 && epochs.len() > 10
    })
    .await;
    assert!(
        epochs.is_sorted() && epochs.first() < epochs.last(),
        "{epochs:?}"
    );
    // The verb and the wall-clock time of each command event.
    let changes_of = async |swarm: &str| -> Vec<(String, f64)> {
        let events = client.get(swarm, "events?limit=1000").await["result"]["events"].take();
        let changes = events.as_array().unwrap().iter().filter_map(|it| {
            let verb = it["event"]["verb"].as_str()?;
            let is_change = ["inform", "set", "reset"].contains(&verb);
            is_change.then(|| (verb.to_owned(), it["unix_secs"].as_f64().unwrap()))
        });
        changes.collect()
    };
    let changes = changes_of("tape").await;
    let verbs: Vec<&str> = changes.iter().map(|(verb, _)| verb.as_str()).collect();
    assert_eq!(verbs, ["inform", "set", "reset"]);
    assert_eq!(changes, changes_of("live").await);

    // At its end a run begins again in a new epoch, and the recorded reset is another one; as fast as
    // possible shows every frame.
    let ended_in = paused["epoch"].as_u64().unwrap();
    client.ok("tape", "run", json!({"rate": null})).await;
    let paused = client
        .get("tape", "wait?phase=paused;timeout_secs=20")
        .await;
    assert_eq!(
        (&paused["step"], paused["epoch"].as_u64()),
        (&json!(50), Some(ended_in + 2))
    );
    // After a seek backwards playback continues there, at this rate with a frame a second.
    let frame = async || {
        let status = client.get("tape", "status").await;
        status["result"]["replay"]["frame"].as_u64().unwrap()
    };
    client.ok("tape", "seek", json!({"fraction": 0.9})).await;
    client.ok("tape", "run", json!({"rate": 0.1})).await;
    client.ok("tape", "seek", json!({"fraction": 0})).await;
    let first = frame().await;
    until("another frame", async || frame().await != first).await;
    let next = frame().await;
    assert!(
        (first + 1..26).contains(&next),
        "{first}, then {next} of 52"
    );
    client.ok("tape", "pause", json!({})).await;
    client.ok("tape", "seek", json!({"fraction": 0})).await;
    client
        .ok("tape", "run", json!({"rate": 1000.0, "until_step": 77}))
        .await;
    let paused = client
        .get("tape", "wait?phase=paused;timeout_secs=20")
        .await;
    assert_eq!(paused["step"], 80);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_replay_rejects_what_would_change_it_and_a_swarm_to_be_sought_through() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    record(client, &path).await;
    let file = fs::read(&path).unwrap();
    upload_and_open(client, "tape", &file).await.unwrap();
    for (verb, args) in [
        ("set", json!({"pi1": 5})),
        ("inform", json!({"select": {"ids": [1]}, "direction": 0})),
        ("uninform", json!({"select": {"ids": [1]}})),
        ("inject", json!({"count": 1})),
        ("remove", json!({"select": {"ids": [1]}})),
        (
            "batch",
            json!({"commands": [{"verb": "set", "args": {"pi1": 5}}]}),
        ),
        ("reset", json!({"seed": 5})),
        ("fork", json!({"name": "other"})),
        ("join", json!({"controller": "bob"})),
        ("advance", json!({"controller": "bob", "steps": 1})),
        ("leave", json!({"controller": "bob"})),
        ("annotate", json!({"text": "note"})),
        ("protect", json!({"on": true})),
        ("when", json!({"condition": "order > 0.9", "pause": true})),
        ("pause", json!({"at_step": 100, "args": {}})),
    ] {
        let (code, message) = client.err("tape", verb, args).await;
        assert_eq!(code, ErrorCode::IncorrectState, "{verb}: {message}");
        assert!(message.contains("replay"), "{verb}: {message}");
    }
    let (code, message) = client.err("live", "seek", json!({"step": 1})).await;
    assert_eq!(code, ErrorCode::IncorrectState);
    assert!(message.contains("fork"), "{message}");
    for args in [
        json!({}),
        json!({"step": 1, "time": 2}),
        json!({"fraction": 1.1}),
        json!({"time": -1}),
        json!({"step": 1e300}),
    ] {
        let (code, message) = client.err("tape", "seek", args.clone()).await;
        assert_eq!(code, ErrorCode::InvalidArgument, "{args}: {message}");
    }
    let (code, _) = client
        .err("tape", "seek", json!({"at_step": 4, "args": {"step": 1}}))
        .await;
    assert_eq!(code, ErrorCode::InvalidArgument);
    // The name is in use, and the playback of that name continues.
    assert_eq!(
        upload_and_open(client, "tape", &file)
            .await
            .unwrap_err()
            .code,
        ErrorCode::AlreadyExists
    );
    assert_eq!(
        upload_and_open(client, "live", &file)
            .await
            .unwrap_err()
            .code,
        ErrorCode::AlreadyExists
    );
    client.ok("tape", "seek", json!({"step": 50})).await;
    for noun in ["snapshot", "verify"] {
        let rejected = client.query(&keys::get(PREFIX, "tape", noun), None).await;
        assert_eq!(
            rejected.unwrap_err().code,
            ErrorCode::IncorrectState,
            "{noun}"
        );
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pieces_that_do_not_fit_and_files_that_are_no_recordings_are_rejected() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    record(client, &path).await;
    let file = fs::read(&path).unwrap();

    let code = |answer: QueryResult| answer.unwrap_err().code;
    assert_eq!(
        code(upload_piece(client, "t", &file, 10, 20).await),
        ErrorCode::Conflict
    );
    upload_piece(client, "t", &file, 0, 1000).await.unwrap();
    assert_eq!(
        code(replay(client, json!({"open": {"name": "t"}})).await),
        ErrorCode::NotFound
    );
    assert_eq!(
        code(upload_piece(client, "t", &file, 2000, 3000).await),
        ErrorCode::Conflict
    );
    // A repeated piece is accepted, and the upload continues.
    for _ in 0..2 {
        let uploaded = upload_piece(client, "t", &file, 1000, 2000).await.unwrap();
        assert_eq!(uploaded["result"]["uploaded"], 2000);
    }
    let huge = json!({"upload": {"name": "h", "offset": 0, "length": 1u64 << 50, "bytes": ""}});
    assert_eq!(
        code(replay(client, huge).await),
        ErrorCode::ResourceExhausted
    );
    for args in [
        json!({}),
        json!({"open": {"name": "../etc"}}),
        json!({"open": {"name": "t", "recording": "../x"}}),
        json!({"open": {"name": "t"}, "upload": {}}),
        json!({"upload": {"name": "t", "offset": 0, "length": 4, "bytes": "%"}}),
        json!({"upload": {"name": "t", "offset": -1, "length": 4, "bytes": ""}}),
    ] {
        let answer = replay(client, args.clone()).await;
        assert_eq!(code(answer), ErrorCode::InvalidArgument, "{args}");
    }
    let answer = replay(client, json!({"open": {"name": "t", "recording": "none"}})).await;
    assert_eq!(code(answer), ErrorCode::NotFound);

    let mut damaged = file.clone();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    let without_spec = {
        let path = folder.path().join("other.mcap");
        let recorder = Recorder::to_file(&path, false, About::new(), |_, _| Ok(())).unwrap();
        recorder.finish(&About::new()).unwrap();
        fs::read(&path).unwrap()
    };
    for (why, bytes) in [
        ("cut short", &file[..file.len() / 2]),
        ("checksum", &damaged),
        ("no MCAP", &b"PAR1 and no more than that"[..]),
        ("has no spec", &without_spec),
    ] {
        let Error { code, message, .. } = upload_and_open(client, "t", bytes).await.unwrap_err();
        assert_eq!(code, ErrorCode::InvalidArgument, "{why}: {message}");
        assert!(message.contains(why), "{why}: {message}");
    }
    // The daemon has deleted the uploads.
    let left = fs::read_dir(daemon.data_dir().join("replays")).unwrap();
    assert_eq!(left.count(), 0);
    upload_and_open(client, "t", &file).await.unwrap();
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_changes_after_it_was_opened_is_not_shown() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    record(client, &path).await;
    let file = fs::read(&path).unwrap();
    upload_and_open(client, "tape", &file).await.unwrap();
    let mut last = (0, 0);
    let read = recording::read(&path, |message| {
        if message.topic == "state" {
            last = (message.offset, message.bytes.len());
        }
        Ok(())
    });
    read.unwrap();
    // The daemon, which is this process, has removed the name of the file.
    let uploads = daemon.data_dir().join("replays");
    let is_upload =
        |open: &PathBuf| fs::read_link(open).is_ok_and(|target| target.starts_with(&uploads));
    let open = fs::read_dir("/proc/self/fd").unwrap();
    let upload = open.map(|it| it.unwrap().path()).find(is_upload).unwrap();
    // A digit of a number in the middle of the last state.
    let middle = last.0 + last.1 as u64 / 2;
    let changed = [file[usize::try_from(middle).unwrap()] ^ 1];
    let upload = fs::OpenOptions::new().write(true).open(upload).unwrap();
    upload.write_all_at(&changed, middle).unwrap();

    let key = keys::cmd(PREFIX, "tape", "seek");
    let payload = json!({ "args": {"fraction": 1.0} }).to_string();
    let _ = client.query(&key, Some(payload.as_bytes())).await;
    let status = client.get("tape", "status").await;
    assert_eq!(status["phase"], "faulted", "{status}");
    let reason = status["result"]["reason"].as_str().unwrap();
    assert!(reason.contains("frame 52 is damaged"), "{reason}");
    let fault = json!({"kind": "other", "ids": [], "gap": null});
    assert_eq!(status["result"]["fault"], fault);
    let origin = &status["result"]["origin"];
    assert_eq!(
        (&origin["kind"], &origin["swarm_id"]),
        (&json!("play"), &Value::Null)
    );
    assert!(status["result"].get("swarm_id").is_none(), "{status}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_origin_of_a_playback_is_the_first_state_of_its_file() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    client.create("live", json!({"n": 3})).await;
    client.ok("live", "step", json!({"steps": 7})).await;
    let args = json!({"swarm": "live", "recording": "take", "every": 1});
    ok(client, json!({"begin": args})).await;
    client.ok("live", "step", json!({"steps": 4})).await;
    stop(client, "take").await;
    let open = json!({"open": {"name": "tape", "recording": "take"}});
    replay(client, open).await.unwrap();
    let expected = json!({
        "kind": "play", "swarm": "live", "swarm_id": null, "step": 7, "seq": null, "state_hash": null,
    });
    // Wherever it is.
    for to in [
        json!({"fraction": 0}),
        json!({"step": 9}),
        json!({"fraction": 1}),
    ] {
        client.ok("tape", "seek", to).await;
        let status = client.get("tape", "status").await;
        assert_eq!(status["result"]["origin"], expected);
        let listed = client.node("swarms").await["swarms"].take();
        let mut rows = listed.as_array().unwrap().iter();
        let row = rows.find(|row| row["swarm"] == "tape").unwrap();
        assert_eq!(row["origin"], expected);
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_playback_has_the_swarm_of_its_file_as_its_origin_if_that_is_a_name() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let folder = tempfile::tempdir().unwrap();
    let long = "a".repeat(1_000_000);
    for (number, (text, expected)) in [
        ("live", json!("live")),
        ("my swarm/**", Value::Null),
        (&long, Value::Null),
    ]
    .into_iter()
    .enumerate()
    {
        let path = folder.path().join(format!("{number}.mcap"));
        record_as(client, &path, text).await;
        let name = format!("tape-{number}");
        let file = fs::read(&path).unwrap();
        upload_and_open(client, &name, &file).await.unwrap();
        let status = client.get(&name, "status").await;
        assert_eq!(status["result"]["origin"]["swarm"], expected, "{number}");
        client.ok("live", "delete", json!({})).await;
    }
    daemon.stop().await;
}
