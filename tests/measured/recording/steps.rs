//! Which swarms wait while the disk is slow.

use serde_json::json;

use crate::support::Client;
use crate::support::recording::{has, ok, run, start_daemon};

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_that_drops_when_behind_counts_what_it_leaves_out_and_no_swarm_waits() {
    let data = tempfile::tempdir().unwrap();
    let (_process, client) = start_daemon(data.path(), "recording-frame=sleep(250)").await;
    // A daemon without a recording shows how fast the swarm can step on this machine.
    let other = tempfile::tempdir().unwrap();
    let (_other, free) = start_daemon(other.path(), "").await;
    for client in [&client, &free] {
        run(client, "school", 10).await;
    }
    let step = async |client: &Client| {
        client.get("school", "status").await["step"]
            .as_u64()
            .unwrap()
    };
    let args =
        json!({"swarm": "school", "recording": "take", "every": 1, "drop_when_behind": true});
    let begun = ok(&client, json!({"begin": args})).await;
    assert_eq!(begun["drop_when_behind"], true, "{begun}");
    let first = [step(&client).await, step(&free).await];
    let taken = has(&client, "take", "missed", 200).await;
    assert!(taken["frames"].as_u64() >= Some(4), "{taken}");
    let steps = [step(&client).await - first[0], step(&free).await - first[1]];
    assert!(
        steps[0] * 20 > steps[1] * 19,
        "{steps:?} with and without the recording"
    );
}
