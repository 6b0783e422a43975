//! The limit of the notes of a user, whatever the names of the clients.

use jostle_proto::Role;
use serde_json::{Value, json};

use super::live::process::AuthProcess;

/// Writes a note whose arguments take some 60,000 bytes of the journal, which has them as they were sent.
fn write(daemon: &AuthProcess, user: &str, client: &str) -> (u16, Value) {
    let spaces = " ".repeat(60_000);
    let request = format!(r#"{{"client": "{client}", "args": {{"text": "long"{spaces}}}}}"#);
    daemon.http("POST /api/cmd/s/annotate", user, &request)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_notes_of_all_clients_of_a_user_take_a_mebibyte_also_after_a_kill() {
    let mut daemon = AuthProcess::start(&[("cleo", Role::Controller)]).await;
    // 2^20 bytes are 17.5 notes.
    for number in 0..17 {
        let client = ["notebook", "script"][number % 2];
        let (status, reply) = write(&daemon, "cleo", client);
        assert_eq!(status, 200, "note {number}: {reply}");
    }
    for is_killed in [false, true] {
        if is_killed {
            daemon = daemon.killed().await;
        }
        for client in ["notebook", "script", "other"] {
            let (status, reply) = write(&daemon, "cleo", client);
            let what = format!("of {client}, killed: {is_killed}: {reply}");
            assert_eq!(status, 429, "{what}");
            assert_eq!(reply["code"], json!("resource_exhausted"), "{what}");
            let message = reply["message"].as_str().unwrap();
            assert!(message.contains("take 1 MiB"), "{what}");
        }
        // Another user has a limit of their own.
        assert_eq!(write(&daemon, "olga", "notebook").0, 200);
    }
    daemon.end();
}
