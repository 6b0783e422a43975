//! Recordings shown as if they were swarms.

use std::fs;
use std::path::Path;
use std::time::{Duration, SystemTime};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{Error, ErrorCode, State, keys};
use jostle_results::recording::{About, Frame, Moment, Recorder};
use serde_json::{Value, json};

use crate::support::{Answer, Client, Daemon, NODE, PREFIX, until};

/// A recording of a swarm that steps by fives, changes shape and is informed on the way, and is
/// reset once: 41 frames, and then 11.
async fn record(client: &Client, path: &Path) -> Vec<State> {
    let spec = json!({"n": 12, "seed": 3, "rate": null});
    client.create("live", spec).await;
    let (spec, status) = (
        client.get("live", "spec").await,
        client.get("live", "status").await,
    );
    let about = About::from([
        ("swarm".to_owned(), "live".to_owned()),
        ("spec".to_owned(), spec["result"].to_string()),
        ("rate".to_owned(), "20.0".to_owned()),
        (
            "parameters".to_owned(),
            status["result"]["parameters"].to_string(),
        ),
    ]);
    let mut recorder = Recorder::to_file(path, true, about, |_, _| Ok(())).unwrap();
    let (mut states, mut told) = (Vec::new(), 0);
    for number in 0..52 {
        match number {
            0 => {}
            41 => drop(client.ok("live", "reset", json!({})).await),
            _ => drop(client.ok("live", "step", json!({"steps": 5})).await),
        }
        match number {
            10 => {
                let select = json!({"select": {"ids": [1, 4]}, "direction": 1.5});
                client.ok("live", "inform", select).await;
            }
            20 => drop(
                client
                    .ok("live", "set", json!({"pi1": 3.0, "make_room": true}))
                    .await,
            ),
            _ => {}
        }
        let events = format!("events?after={told}");
        let events = client.get("live", &events).await["result"]["events"].clone();
        let published = state_bytes(client, "live").await;
        let state = State::from_cbor(&published).unwrap();
        for event in events.as_array().unwrap() {
            told = event["number"].as_u64().unwrap();
            let at = moment(told, &state);
            recorder.event(&at, event.to_string().as_bytes()).unwrap();
        }
        recorder
            .frame(&Frame {
                swarm: &state.swarm,
                moment: moment(number, &state),
                phase: state.phase.name(),
                step: state.step,
                origin: state.origin,
                id: &state.id,
                x: &state.x,
                y: &state.y,
                alpha: &state.alpha,
                weight: &state.weight,
                direction: &state.direction,
                order: state.order.order,
                drift: state.order.drift,
                worst_gap: state.certificate.worst_gap,
                residual: state.certificate.residual,
                contacts: state.certificate.contacts,
                published: &published,
            })
            .unwrap();
        states.push(state);
    }
    recorder.finish(&About::new()).unwrap();
    states
}

fn moment(number: u64, state: &State) -> Moment {
    Moment {
        epoch: state.epoch,
        number,
        time: state.time,
        taken: SystemTime::now(),
    }
}

async fn state_bytes(client: &Client, swarm: &str) -> Vec<u8> {
    let replies = client
        .session
        .get(keys::state(PREFIX, swarm))
        .await
        .unwrap();
    let sample = replies.recv_async().await.unwrap().into_result().unwrap();
    sample.payload().to_bytes().into_owned()
}

async fn state(client: &Client, swarm: &str) -> State {
    State::from_cbor(&state_bytes(client, swarm).await).unwrap()
}

async fn replay(client: &Client, args: Value) -> Answer {
    let key = keys::node_cmd(PREFIX, NODE, "replay");
    client.one(&key, Some(args.to_string().as_bytes())).await
}

/// A recording of a swarm that is there no more.
pub async fn take(client: &Client) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    record(client, &path).await;
    client.ok("live", "delete", json!({})).await;
    fs::read(path).unwrap()
}

pub async fn piece(client: &Client, name: &str, file: &[u8], from: usize, to: usize) -> Answer {
    let args = json!({"upload": {
        "name": name, "offset": from, "length": file.len(), "bytes": STANDARD.encode(&file[from..to]),
    }});
    replay(client, args).await
}

/// Uploads a file.
pub async fn upload(client: &Client, name: &str, file: &[u8]) {
    let mut from = 0;
    while from < file.len() {
        let to = file.len().min(from + 50_000);
        let uploaded = piece(client, name, file, from, to).await.unwrap();
        assert_eq!(uploaded["result"]["uploaded"], to);
        from = to;
    }
}

/// Uploads a file and opens it.
pub async fn show(client: &Client, name: &str, file: &[u8]) -> Answer {
    upload(client, name, file).await;
    replay(client, json!({"open": {"name": name}})).await
}

async fn seek_error(client: &Client, args: &Value) -> Error {
    let key = keys::cmd(PREFIX, "tape", "seek");
    let payload = json!({ "args": args }).to_string();
    client
        .one(&key, Some(payload.as_bytes()))
        .await
        .unwrap_err()
}

/// Whether a state shows what another one did, under another name.
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
    let shown = show(client, "tape", &fs::read(&path).unwrap())
        .await
        .unwrap();
    let mut told = shown["result"]["replay"].clone();
    let duration = told["duration"].take().as_f64().unwrap();
    assert!((duration - 5.0).abs() < 1e-9, "{duration}");
    let expected =
        json!({"of": "live", "frame": 1, "frames": 52, "position": 0.0, "duration": null});
    assert_eq!(told, expected);
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
        // The shape is the one it had then.
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
    client.ok("tape", "seek", json!({"fraction": 0})).await;
    // The last frame itself is not beyond the end, and a rounded time is as good.
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
async fn whoever_watches_a_replay_sees_and_hears_what_there_was() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    let recorded = record(client, &path).await;
    show(client, "tape", &fs::read(&path).unwrap())
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
    // Five of time at five a second.
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
    let told_by = async |swarm: &str| -> Vec<(String, f64)> {
        let events = client.get(swarm, "events?limit=1000").await["result"]["events"].take();
        let told = events.as_array().unwrap().iter().filter_map(|it| {
            let verb = it["event"]["verb"].as_str()?;
            let is_change = ["inform", "set", "reset"].contains(&verb);
            is_change.then(|| (verb.to_owned(), it["unix_secs"].as_f64().unwrap()))
        });
        told.collect()
    };
    let told = told_by("tape").await;
    let verbs: Vec<&str> = told.iter().map(|(verb, _)| verb.as_str()).collect();
    assert_eq!(verbs, ["inform", "set", "reset"]);
    assert_eq!(told, told_by("live").await);

    // At its end it begins anew, which is an epoch, and so is the reset on the way; as fast as
    // possible is a frame at a time.
    let ended_in = paused["epoch"].as_u64().unwrap();
    client.ok("tape", "run", json!({"rate": null})).await;
    let paused = client
        .get("tape", "wait?phase=paused;timeout_secs=20")
        .await;
    assert_eq!(
        (&paused["step"], paused["epoch"].as_u64()),
        (&json!(50), Some(ended_in + 2))
    );
    // After a seek backwards playback goes on from there, at this rate with a frame a second.
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
async fn a_replay_refuses_what_would_change_it_and_a_swarm_to_be_sought_through() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    record(client, &path).await;
    let file = fs::read(&path).unwrap();
    show(client, "tape", &file).await.unwrap();
    for (verb, args) in [
        ("set", json!({"pi1": 5})),
        ("inform", json!({"select": {"ids": [1]}, "direction": 0})),
        ("inject", json!({"count": 1})),
        ("remove", json!({"select": {"ids": [1]}})),
        ("reset", json!({"seed": 5})),
        ("fork", json!({"name": "other"})),
        ("join", json!({"controller": "bob"})),
        ("annotate", json!({"text": "note"})),
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
    // The name is taken, and what is there goes on.
    assert_eq!(
        show(client, "tape", &file).await.unwrap_err().code,
        ErrorCode::AlreadyExists
    );
    assert_eq!(
        show(client, "live", &file).await.unwrap_err().code,
        ErrorCode::AlreadyExists
    );
    client.ok("tape", "seek", json!({"step": 50})).await;
    for noun in ["snapshot", "verify"] {
        let refused = client.one(&keys::get(PREFIX, "tape", noun), None).await;
        assert_eq!(
            refused.unwrap_err().code,
            ErrorCode::IncorrectState,
            "{noun}"
        );
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pieces_that_do_not_fit_and_files_that_are_no_recordings_are_refused() {
    let daemon = Daemon::start().await;
    let client = &daemon.client;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    record(client, &path).await;
    let file = fs::read(&path).unwrap();

    let code = |answer: Answer| answer.unwrap_err().code;
    assert_eq!(
        code(piece(client, "t", &file, 10, 20).await),
        ErrorCode::Conflict
    );
    piece(client, "t", &file, 0, 1000).await.unwrap();
    assert_eq!(
        code(replay(client, json!({"open": {"name": "t"}})).await),
        ErrorCode::NotFound
    );
    assert_eq!(
        code(piece(client, "t", &file, 2000, 3000).await),
        ErrorCode::Conflict
    );
    // One that came twice is as good, and it goes on.
    for _ in 0..2 {
        let uploaded = piece(client, "t", &file, 1000, 2000).await.unwrap();
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
        let Error { code, message, .. } = show(client, "t", bytes).await.unwrap_err();
        assert_eq!(code, ErrorCode::InvalidArgument, "{why}: {message}");
        assert!(message.contains(why), "{why}: {message}");
    }
    // The daemon has kept nothing of it.
    let left = fs::read_dir(daemon.data_dir().join("replays")).unwrap();
    assert_eq!(left.count(), 0);
    show(client, "t", &file).await.unwrap();
    daemon.stop().await;
}
