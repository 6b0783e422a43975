//! Users take turns in a lane, whatever their requests are about.

use std::time::Duration;

use jostle_proto::{Role, keys};

use super::UserSession;
use super::live::process::AuthProcess;
use crate::support::{NODE, PREFIX};

/// The results of an experiment. There need not be one of this name: the lane finds that out.
fn results(number: usize) -> String {
    keys::experiment(PREFIX, NODE, &format!("study-{number}"), "results")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_who_reads_many_experiments_has_one_turn_for_each_of_an_operator() {
    const READS: usize = 60;
    let points = "lane-files=sleep(100)";
    let daemon = AuthProcess::start_failing(&[("vera", Role::Viewer)], points).await;
    let (vera, olga) = (
        daemon.open_session("vera").await,
        daemon.open_session("olga").await,
    );
    let get = async |user: &UserSession, key: String| {
        let query = user.session.get(key).timeout(Duration::from_secs(100));
        query.attachment(user.token.clone().unwrap()).await.unwrap()
    };
    let mut reads = Vec::new();
    for number in 0..READS {
        reads.push(get(&vera, results(number)).await);
    }
    // A query sent after the reads arrives after them.
    vera.ok(&keys::node_get(PREFIX, NODE, "status"), None).await;
    let read = get(&olga, results(READS)).await;
    read.recv_async().await.unwrap();
    // Each thread of the lane executes one of vera's, then olga's, and the machine may be busy.
    let waiting = reads.iter().filter(|it| it.is_empty()).count();
    assert!(waiting > READS / 2, "{waiting} of vera's wait");
    for user in [vera, olga] {
        user.session.close().await.unwrap();
    }
    daemon.end();
}
