//! A daemon that knows people, and two daemons that have a swarm of one name.

use jostle_proto::{Role, keys};
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use serde_json::json;
use zenoh::Session;

use super::documents::Recorded;
use super::lab::{LAB, Lab};
use crate::contested::fleet::{Place, Router};
use crate::support::{Client, PREFIX, until};

pub async fn play(recorded: &Recorded) {
    tokio::join!(people(recorded), contested(recorded));
}

/// A person's session.
async fn enter(endpoint: &str, person: &str, password: &str) -> Session {
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
    let folder = Folder::at(base.path().join("auth"));
    let people = [
        ("anna", Role::Controller),
        ("ben", Role::Viewer),
        ("olga", Role::Operator),
    ];
    let people = people.map(|(name, role)| (name.to_owned(), role));
    issue::init(&folder, &[], &people).unwrap();
    let auth = folder.path().to_str().unwrap();
    let (life, data) = Lab::life("", &["--auth-dir", auth]);
    // zenoh forwards no command of a session whose person may not send it: here the token says so.
    for (name, person, whose) in [
        ("node.whoami.reply", "anna", "anna"),
        ("node.whoami.reply.viewer", "ben", "ben"),
        ("error.permission_denied", "olga", "ben"),
    ] {
        let password = folder.credentials(person).unwrap().password;
        let session = enter(&life.endpoint, person, &password).await;
        let token = Some(folder.credentials(whose).unwrap().token);
        let data = data.path().to_owned();
        let lab = Lab::client(recorded, Client { session }, token, data);
        if name.starts_with("error.") {
            let create = json!({"name": "school", "spec": {"n": 4}});
            lab.node_cmd(name, "create", create).await;
        } else {
            lab.node_get(name, "whoami").await;
        }
        lab.stop().await;
    }
}

/// Two daemons behind a router, each with a swarm `school`.
async fn contested(recorded: &Recorded) {
    let (lab, attic) = (Place::new(LAB), Place::new("attic"));
    attic.prepare(&["school"]).await;
    let _lab = lab.start();
    let router = Router::to(&[&lab.endpoint, &attic.endpoint]);
    let client = Client::open(&router.1).await;
    let data = attic.folder.path().to_owned();
    let lab = Lab::client(recorded, client, None, data);
    until("the router is connected", async || {
        let hello = keys::node_get(PREFIX, LAB, "hello");
        !lab.client.ask(&hello, None).await.is_empty()
    })
    .await;
    lab.create("school", json!({"n": 4, "seed": 1})).await;
    let _attic = attic.start();
    let swarms = keys::node_get(PREFIX, "attic", "swarms");
    until("the daemons know of each other", async || {
        let answers = lab.client.ask(&swarms, None).await;
        matches!(&answers[..], [Ok(reply)]
            if reply["result"]["swarms"][0]["contested_by"] == LAB)
    })
    .await;
    let record = keys::node_cmd(PREFIX, "attic", "record");
    let begin = json!({"begin": {"swarm": "school"}});
    lab.ask("error.contested", &record, Some(&begin)).await;
    lab.stop().await;
}
