//! Recordings fetched over the network, piece by piece.

use std::fs;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{ErrorCode, RecordingPiece, keys};
use jostle_results::recording::parts;
use serde_json::{Value, json};

use crate::support::recording::{begin, folder_of, has, ok, run, start_daemon, stop};
use crate::support::{Client, NODE, PREFIX, QueryResult};

async fn query_recording(client: &Client, parameters: &str) -> QueryResult {
    let key = keys::node_get(PREFIX, NODE, "recording");
    client.query(&format!("{key}?{parameters}"), None).await
}

async fn read_piece(
    client: &Client,
    name: &str,
    part: u64,
    offset: u64,
) -> (RecordingPiece, Vec<u8>) {
    let parameters = format!("name={name};part={part};offset={offset}");
    let answer: Value = query_recording(client, &parameters).await.unwrap()["result"].take();
    let piece: RecordingPiece = serde_json::from_value(answer).unwrap();
    let bytes = STANDARD.decode(&piece.bytes).unwrap();
    (piece, bytes)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_is_read_piece_by_piece_while_it_runs_and_from_any_offset() {
    let data = tempfile::tempdir().unwrap();
    let (_process, client) = start_daemon(data.path(), "recording-part=return(2000)").await;
    run(&client, "school", 400).await;
    begin(&client, "school", "take").await;
    has(&client, "take", "parts", 2).await;
    let (first, _) = read_piece(&client, "take", 0, 0).await;
    assert!(first.parts >= 2);
    let stopped = stop(&client, "take").await;
    let files = parts(&folder_of(data.path(), "take")).unwrap();
    assert_eq!(stopped["parts"], files.len());
    let mut pieces = 0;
    for (part, file) in (0..).zip(&files) {
        let there = fs::read(file).unwrap();
        let mut fetched = Vec::new();
        while fetched.len() < there.len() {
            let (piece, bytes) = read_piece(&client, "take", part, fetched.len() as u64).await;
            assert_eq!(piece.length, there.len() as u64);
            assert_eq!((piece.part, piece.offset), (part, fetched.len() as u64));
            assert!(!bytes.is_empty() && bytes.len() <= 512 * 1024);
            fetched.extend(bytes);
            pieces += 1;
        }
        assert_eq!(fetched, there);
        // From the middle, as after a lost connection, and at its very end.
        let (_, tail) = read_piece(&client, "take", part, there.len() as u64 - 3).await;
        assert_eq!(tail, there[there.len() - 3..]);
        assert!(
            read_piece(&client, "take", part, there.len() as u64)
                .await
                .1
                .is_empty()
        );
    }
    assert!(pieces > files.len(), "one part takes several pieces");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unknown_part_is_rejected_with_those_that_exist() {
    let data = tempfile::tempdir().unwrap();
    let (_process, client) = start_daemon(data.path(), "").await;
    run(&client, "school", 5).await;
    begin(&client, "school", "take").await;
    has(&client, "take", "frames", 3).await;
    // No part is finished yet.
    let error = query_recording(&client, "name=take").await.unwrap_err();
    assert_eq!(error.code, ErrorCode::NotFound, "{error:?}");
    assert!(error.message.contains("0 finished parts"), "{error:?}");
    stop(&client, "take").await;
    for (parameters, code, word) in [
        ("", ErrorCode::InvalidArgument, "name"),
        ("name=..", ErrorCode::InvalidArgument, "name"),
        ("name=missing", ErrorCode::NotFound, "get/recordings"),
        ("name=take;part=1", ErrorCode::NotFound, "1 finished part"),
        (
            "name=take;part=99999999999999999999",
            ErrorCode::InvalidArgument,
            "part",
        ),
        ("name=take;part=-1", ErrorCode::InvalidArgument, "part"),
        ("name=take;offset=1e9", ErrorCode::InvalidArgument, "offset"),
        (
            "name=take;offset=18446744073709551615",
            ErrorCode::InvalidArgument,
            "offset",
        ),
        ("name=take;name=take", ErrorCode::InvalidArgument, "name"),
        ("name=take;length=5", ErrorCode::InvalidArgument, "length"),
    ] {
        let error = query_recording(&client, parameters).await.unwrap_err();
        assert_eq!(error.code, code, "{parameters}: {error:?}");
        assert!(error.message.contains(word), "{parameters}: {error:?}");
    }
    // A wildcard matches every get; `recording` and `audit` do not reply to it.
    let key = keys::node_get(PREFIX, NODE, "*");
    let answers = client.query_all(&key, None).await;
    assert_eq!(answers.len(), keys::NODE_GETS.len() - 2);
    assert!(answers.iter().all(Result::is_ok));
    ok(&client, json!({"delete": {"recording": "take"}})).await;
    let error = query_recording(&client, "name=take").await.unwrap_err();
    assert_eq!(error.code, ErrorCode::NotFound);
}
