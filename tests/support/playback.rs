//! Recordings, uploaded and opened as playbacks.

use std::fs;
use std::path::Path;
use std::time::SystemTime;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{State, keys};
use jostle_results::recording::{About, Frame, Moment, Recorder};
use serde_json::{Value, json};

use super::{Client, NODE, PREFIX, QueryResult};

/// Records a swarm that takes five steps between frames, is informed, changes its shape and is reset
/// once: 41 frames, then 11.
pub async fn record(client: &Client, path: &Path) -> Vec<State> {
    record_as(client, path, "live").await
}

/// As [`record`]; the file gives this text as the name of the swarm.
pub async fn record_as(client: &Client, path: &Path, swarm: &str) -> Vec<State> {
    let spec = json!({"n": 12, "seed": 3, "rate": null});
    client.create("live", spec).await;
    let (spec, status) = (
        client.get("live", "spec").await,
        client.get("live", "status").await,
    );
    let about = About::from([
        ("swarm".to_owned(), swarm.to_owned()),
        ("spec".to_owned(), spec["result"].to_string()),
        ("rate".to_owned(), "20.0".to_owned()),
        (
            "parameters".to_owned(),
            status["result"]["parameters"].to_string(),
        ),
    ]);
    let mut recorder = Recorder::to_file(path, true, about, |_, _| Ok(())).unwrap();
    let (mut states, mut newest) = (Vec::new(), 0);
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
        let events = format!("events?after={newest}");
        let events = client.get("live", &events).await["result"]["events"].clone();
        let published = state_bytes(client, "live").await;
        let state = State::from_cbor(&published).unwrap();
        for event in events.as_array().unwrap() {
            newest = event["number"].as_u64().unwrap();
            let at = moment(newest, &state);
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
                attachment: None,
            })
            .unwrap();
        states.push(state);
    }
    recorder.finish(&About::new()).unwrap();
    states
}

pub fn moment(number: u64, state: &State) -> Moment {
    Moment {
        epoch: state.epoch,
        number,
        time: state.time,
        taken: SystemTime::now(),
    }
}

pub async fn state_bytes(client: &Client, swarm: &str) -> Vec<u8> {
    let replies = client
        .session
        .get(keys::state(PREFIX, swarm))
        .await
        .unwrap();
    let sample = replies.recv_async().await.unwrap().into_result().unwrap();
    sample.payload().to_bytes().into_owned()
}

pub async fn state(client: &Client, swarm: &str) -> State {
    State::from_cbor(&state_bytes(client, swarm).await).unwrap()
}

pub async fn replay(client: &Client, args: Value) -> QueryResult {
    let key = keys::node_cmd(PREFIX, NODE, "replay");
    client.query(&key, Some(args.to_string().as_bytes())).await
}

/// A recording of a swarm that was deleted.
pub async fn recorded_file(client: &Client) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    record(client, &path).await;
    client.ok("live", "delete", json!({})).await;
    fs::read(path).unwrap()
}

pub async fn upload_piece(
    client: &Client,
    name: &str,
    file: &[u8],
    from: usize,
    to: usize,
) -> QueryResult {
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
        let uploaded = upload_piece(client, name, file, from, to).await.unwrap();
        assert_eq!(uploaded["result"]["uploaded"], to);
        from = to;
    }
}

/// Uploads a file and opens it.
pub async fn upload_and_open(client: &Client, name: &str, file: &[u8]) -> QueryResult {
    upload(client, name, file).await;
    replay(client, json!({"open": {"name": name}})).await
}
