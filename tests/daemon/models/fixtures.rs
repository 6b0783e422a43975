//! The data folders and snapshots of all earlier builds go on, if their model is an earlier version.

use std::fs;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto::{Snapshot, keys, to_cbor};
use serde_json::json;

use super::folders::{EARLIER, aged, earlier};
use super::{assert_earlier, get};
use crate::experiments::{progress, rows};
use crate::stored::{self, accepted};
use crate::support::daemon_process::{StoreCopy, start};
use crate::support::{NODE, PREFIX};

#[tokio::test(flavor = "multi_thread")]
async fn the_folders_of_all_earlier_builds_go_on_marked() {
    for build in stored::builds() {
        let expected = stored::expected(&build);
        let aged = aged(stored::copy(&build, "data").path(), |record| record);
        let store = StoreCopy::of(aged.path());
        let (process, client) = start(aged.path()).await;
        stored::assert_recovered(&client, &expected).await;
        for name in expected["swarms"].as_object().unwrap().keys() {
            let (epoch, step) = store.newest_checkpoint(name);
            let mark = json!([{"model_version": EARLIER, "epoch": epoch, "step": step}]);
            let status = client.get(name, "status").await;
            assert_eq!(status["result"]["earlier_models"], mark, "{status}");
            assert_earlier(get(&client, name, "verify").await, name);
        }
        stored::assert_recorded(&client, &expected).await;
        // Its `join`, sent again, has declared its token.
        let advance = json!({"expect_step": 50, "args": {"controller": "ada", "steps": 5}});
        assert_eq!(client.ok("led", "advance", advance).await["step"], 55);

        let half = progress(&client, "half").await;
        assert_eq!(
            (&half["phase"], &half["model_version"]),
            (&json!("failed"), &json!(EARLIER)),
            "{half}"
        );
        let readable = rows(&client, "half", 100).await;
        for old in expected["experiment"]["rows"].as_array().unwrap() {
            let new = readable.iter().find(|new| new["run"] == old["run"]);
            stored::assert_has_all(new.unwrap(), old);
        }

        let snapshot = fs::read(build.join("school.snapshot")).unwrap();
        let snapshot = earlier(Snapshot::from_cbor(&snapshot).unwrap()).sealed();
        let request = json!({"name": "restored", "snapshot": STANDARD.encode(to_cbor(&snapshot))});
        let key = keys::node_cmd(PREFIX, NODE, "restore");
        let restored = client
            .query(&key, Some(request.to_string().as_bytes()))
            .await;
        restored.unwrap();
        for swarm in ["restored", "school"] {
            // Both hold a command that waits for step 2000.
            let reply = client
                .ok(
                    swarm,
                    "step",
                    json!({"steps": expected["snapshot"]["steps"]}),
                )
                .await;
            assert_eq!(reply["step"], expected["snapshot"]["step"], "{swarm}");
            // Here both versions compute the same steps.
            assert_eq!(
                client.hash(swarm).await,
                expected["snapshot"]["state_hash"],
                "{swarm}"
            );
        }
        drop(process);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_an_earlier_version_accepted_is_applied_again_and_not_rejected() {
    let data = stored::copy(&accepted::fixture(), "data");
    let aged = aged(data.path(), |record| record);
    let (_process, client) = start(aged.path()).await;
    let expected = accepted::replies()["school"].clone();
    accepted::assert_replayed(&client, &expected).await;
    let status = client.get("school", "status").await;
    assert_eq!(
        status["result"]["earlier_models"][0]["model_version"],
        EARLIER
    );
    assert!(accepted::rejected(&client, "school").await.is_empty());
    for (name, old) in accepted::replies()["experiments"].as_object().unwrap() {
        let now = progress(&client, name).await;
        assert_eq!(
            (&now["phase"], &now["model_version"]),
            (&json!("failed"), &json!(EARLIER)),
            "{now}"
        );
        let readable = rows(&client, name, 100).await;
        for old in old["rows"].as_array().unwrap() {
            assert!(
                readable
                    .iter()
                    .any(|new| new["state_hash"] == old["state_hash"]),
                "{name}"
            );
        }
    }
}
