//! A flood of commands from many clients: each gets a reply, the commands of others are executed and
//! the daemon's memory does not grow. Times are measured by `cargo bench --bench flood`.

#[path = "../../../benches/flood/clients.rs"]
mod clients;

use serde_json::json;

use crate::load::{find, helper};
use crate::support::Client;
use crate::support::process::Process;

use clients::Flooded;

/// The limit of the daemon's growth during a flood.
const GROWN_MB: u64 = 20;

/// Not a test: the clients that flood an endpoint, with so many replies of each outstanding.
#[tokio::test(flavor = "multi_thread")]
async fn a_flooding_process() {
    let Ok(asked) = std::env::var("JOSTLE_TEST_HELPER") else {
        return;
    };
    let (endpoint, unanswered) = asked.split_once(' ').unwrap();
    let open = async || Client::open(endpoint).await.session;
    clients::flood(open, unanswered.parse().unwrap()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_from_32_clients_is_answered_and_no_other_command_fails() {
    for unanswered in [64, 8, 1] {
        let (daemon, endpoint) = Process::serve();
        let client = Client::open(&endpoint).await;
        for name in ["other", "flooded"] {
            client.create(name, json!({"n": 20, "rate": 1})).await;
            client.ok(name, "run", json!({})).await;
        }
        let before = daemon.resident_bytes();
        let asked = format!("{endpoint} {unanswered}");
        let (_flooding, _, mut output) =
            helper("19", "flood::a_flooding_process", &asked, "flooding ");
        let flooded = tokio::task::spawn_blocking(move || find(&mut output, "flooded "));
        let mut others = 0;
        while !flooded.is_finished() {
            client.ok("other", "set", json!({"pi3": 1})).await;
            others += 1;
        }
        let flooded: Flooded = serde_json::from_str(&flooded.await.unwrap()).unwrap();
        let grown_mb = daemon.resident_bytes().saturating_sub(before) >> 20;
        println!("{unanswered} each: {flooded:?}, {others} commands of others, {grown_mb} MB more");
        assert_eq!(flooded.sent, flooded.executed + flooded.rejected);
        assert!(flooded.executed > 0 && others > 0, "{flooded:?}, {others}");
        // 128 commands wait at once: of 32 clients with 8 each, which are 256, some are rejected.
        assert!(unanswered < 8 || flooded.rejected > 0, "{flooded:?}");
        assert!(grown_mb < GROWN_MB, "{grown_mb} MB");
    }
}
