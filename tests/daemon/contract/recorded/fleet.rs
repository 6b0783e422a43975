//! A daemon with roles, and two daemons with a swarm of the same name.

use std::time::Duration;

use jostle_proto::{Role, keys};
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use serde_json::json;
use zenoh::Session;

use super::documents::Recorded;
use super::recording_client::{FIXTURE_NODE, RecordingClient};
use crate::contested::fleet::{RestartableDaemon, Router};
use crate::support::{Client, PREFIX, until};

pub async fn record_fixtures(recorded: &Recorded) {
    tokio::join!(people(recorded), contested(recorded));
}

/// A person's session.
async fn open_session(endpoint: &str, person: &str, password: &str) -> Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", json!("client")),
        ("connect/endpoints", json!([endpoint])),
        ("scouting/multicast/enabled", json!(false)),
        (
            "transport/auth/usrpwd",
            json!({"user": person, "password": password}),
        ),
    ] {
        config.insert_json5(key, &value.to_string()).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

async fn people(recorded: &Recorded) {
    let base = tempfile::tempdir().unwrap();
    let folder = Folder::new(base.path().join("auth"));
    let people = [
        ("anna", Role::Controller),
        ("ben", Role::Viewer),
        ("olga", Role::Operator),
    ];
    let people = people.map(|(name, role)| (name.to_owned(), role));
    issue::init(&folder, &[], &people).unwrap();
    let auth = folder.path().to_str().unwrap();
    let (process, data) = RecordingClient::start_daemon("", &["--auth-dir", auth]);
    // zenoh forwards no command of a session whose person may not send it: here the token says so.
    for (name, person, whose) in [
        ("node.whoami.reply", "anna", "anna"),
        ("node.whoami.reply.viewer", "ben", "ben"),
        ("error.permission_denied", "olga", "ben"),
        ("node.audit.reply", "olga", "olga"),
    ] {
        let password = folder.credentials(person).unwrap().password;
        let session = open_session(&process.endpoint, person, &password).await;
        let token = Some(folder.credentials(whose).unwrap().token);
        let data = data.path().to_owned();
        let recorder = RecordingClient::client(recorded, Client { session }, token, data);
        let create = json!({"name": "school", "spec": {"n": 4}});
        match name {
            "error.permission_denied" => drop(recorder.node_cmd(name, "create", create).await),
            "node.audit.reply" => {
                let create = json!({"client": "jostle-4711", "args": create});
                recorder.node_cmd("", "create", create).await;
                recorder
                    .cmd("", "school", "step", json!({"steps": 2}))
                    .await;
                for (key, request) in [
                    (
                        keys::cmd(PREFIX, "school", "step"),
                        json!({"expect_step": 9}),
                    ),
                    (
                        keys::node_cmd(PREFIX, FIXTURE_NODE, "experiment"),
                        json!({"cancel": {"name": "noise"}}),
                    ),
                ] {
                    let pending = recorder.send(&key, Some(&request)).await;
                    recorder.receive("error.not_recorded", &pending).await;
                }
                // A line of several commands is written again within a second.
                tokio::time::sleep(Duration::from_millis(2500)).await;
                recorder.node_get(name, "audit?limit=4").await;
            }
            _ => drop(recorder.node_get(name, "whoami").await),
        }
        recorder.stop().await;
    }
}

/// Two daemons behind a router, each with a swarm `school`.
async fn contested(recorded: &Recorded) {
    let (first, attic) = (
        RestartableDaemon::new(FIXTURE_NODE),
        RestartableDaemon::new("attic"),
    );
    attic.prepare(&["school"]).await;
    let _first = first.start();
    let router = Router::connected_to(&[&first.endpoint, &attic.endpoint]);
    let client = Client::open(&router.1).await;
    let data = attic.folder.path().to_owned();
    let recorder = RecordingClient::client(recorded, client, None, data);
    until("the router is connected", async || {
        let hello = keys::node_get(PREFIX, FIXTURE_NODE, "hello");
        !recorder.client.query_all(&hello, None).await.is_empty()
    })
    .await;
    recorder.create("school", json!({"n": 4, "seed": 1})).await;
    let _attic = attic.start();
    let swarms = keys::node_get(PREFIX, "attic", "swarms");
    until("the daemons know of each other", async || {
        let answers = recorder.client.query_all(&swarms, None).await;
        matches!(&answers[..], [Ok(reply)]
            if reply["result"]["swarms"][0]["contested_by"] == FIXTURE_NODE)
    })
    .await;
    let record = keys::node_cmd(PREFIX, "attic", "record");
    let begin = json!({"begin": {"swarm": "school"}});
    recorder
        .query("error.contested", &record, Some(&begin))
        .await;
    recorder.stop().await;
}
