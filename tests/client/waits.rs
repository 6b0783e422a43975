//! Waits for conditions.

use std::time::Duration;

use jostle_client::{Client, ConnectOptions};
use jostle_proto::verbs::{CreateArgs, Return, StepArgs};
use jostle_proto::{Reply, Spec, Status};

use crate::daemon::Daemon;

#[tokio::test(flavor = "multi_thread")]
async fn the_next_query_continues_a_dropped_one() {
    const HELD: Duration = Duration::from_secs(20);
    let daemon = Daemon::start().await;
    let options = ConnectOptions::to(daemon.endpoint());
    let client = Client::connect(options).await.unwrap();
    let args = CreateArgs {
        name: "demo".into(),
        spec: Spec::new(10),
        exist_ok: false,
    };
    client.create(&args).await.unwrap();
    let wait = client.wait_for("demo", "order >= 0 for 1").await.unwrap();
    for _ in 0..2 {
        let dropped = tokio::time::timeout(Duration::from_millis(300), wait.query(HELD));
        assert!(dropped.await.is_err());
        let step = StepArgs {
            steps: 30,
            return_: Return::default(),
        };
        client.execute("demo", &step).await.unwrap();
    }
    // It has held from step 0 on, and the swarm is at step 60 now.
    let reply: Reply<Status> = wait.query(HELD).await.unwrap().read().unwrap();
    assert_eq!(reply.step, 50);
    client.close().await;
}
