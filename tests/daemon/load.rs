//! Many clients at once.

mod clients;

use jostle_proto::{ErrorCode, keys};
use serde_json::json;

use crate::support::{Daemon, NODE, PREFIX};

#[tokio::test(flavor = "multi_thread")]
async fn one_name_created_and_deleted_by_many_at_once_is_one_swarm() {
    let daemon = Daemon::start().await;
    let mut tasks = Vec::new();
    for _ in 0..4 {
        let client = daemon.another_client().await;
        tasks.push(tokio::spawn(async move {
            let key = keys::node_cmd(PREFIX, NODE, "create");
            let request = json!({"name": "a", "spec": {"n": 5}}).to_string();
            let mut created = 0;
            for _ in 0..50 {
                match client.query(&key, Some(request.as_bytes())).await {
                    Ok(_) => created += 1,
                    Err(error) => assert_eq!(error.code, ErrorCode::AlreadyExists, "{error:?}"),
                }
                // Either it existed, or another client was faster; without a reply it is gone too.
                for answer in client.query_all("jostle/a/cmd/delete", Some(b"{}")).await {
                    if let Err(error) = answer {
                        assert_eq!(error.code, ErrorCode::NotFound, "{error:?}");
                    }
                }
            }
            created
        }));
    }
    let mut created = 0;
    for task in tasks {
        created += task.await.unwrap();
    }
    assert!(created >= 10, "{created}");
    daemon
        .client
        .query_all("jostle/a/cmd/delete", Some(b"{}"))
        .await;
    assert_eq!(daemon.client.node("status").await["swarms"], 0);
    daemon.stop().await;
}
