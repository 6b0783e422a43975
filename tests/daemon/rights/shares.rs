//! A user who fills the queue of a swarm takes no place of another.

use jostle_proto::keys;
use serde_json::json;
use tokio::time::Instant;

use super::{AuthDaemon, UserSession};
use crate::support::{PREFIX, TIMEOUT, until};

async fn join(cleo: &UserSession, swarm: &str, controller: &str) {
    let select = json!({"count": 1});
    let args = json!({"controller": controller, "deadline_secs": 60, "select": select});
    cleo.cmd(swarm, "join", args).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn commands_that_wait_do_not_reject_those_of_others() {
    let daemon = AuthDaemon::start().await;
    let (cleo, carl, olga) = (
        daemon.open_session("cleo").await,
        daemon.open_session("carl").await,
        daemon.open_session("olga").await,
    );
    olga.create("s").await;
    join(&cleo, "s", "cleo-a").await;
    join(&cleo, "s", "cleo-b").await;
    // Copies of a command that waits for the other controller.
    let advance = json!({"request_id": "one", "args": {"controller": "cleo-a", "steps": 1}});
    let (payload, key) = (advance.to_string(), keys::cmd(PREFIX, "s", "advance"));
    let mut waiting = Vec::new();
    for _ in 0..200 {
        let query = cleo.session.get(&key).timeout(2 * TIMEOUT);
        let query = query.payload(payload.clone());
        waiting.push(
            query
                .attachment(cleo.token.as_ref().unwrap())
                .await
                .unwrap(),
        );
    }
    // So many that further ones are rejected.
    let mut rejected = 0;
    until("the other commands are rejected", async || {
        for replies in &waiting {
            while let Ok(Some(reply)) = replies.try_recv() {
                let error = reply.into_result().unwrap_err();
                let text = error.payload().try_to_string().unwrap().into_owned();
                assert!(text.contains("\"busy\""), "{text}");
                rejected += 1;
            }
        }
        rejected == 200 - 128
    })
    .await;
    let began = Instant::now();
    let select = json!({"count": 1});
    carl.cmd("s", "annotate", json!({"text": "mine"})).await;
    olga.cmd("s", "inform", json!({"select": select, "direction": 1.0}))
        .await;
    olga.cmd("s", "leave", json!({"controller": "cleo-b"}))
        .await;
    assert!(began.elapsed() < TIMEOUT, "{:?}", began.elapsed());
    daemon.close(vec![cleo, carl, olga]).await;
}
