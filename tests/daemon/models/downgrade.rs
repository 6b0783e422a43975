//! An older program leaves the folder of a newer one as it is, and says which program has written it.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use jostle_physics::model::MODEL_VERSION;
use rusqlite::Connection;
use rusqlite::config::DbConfig;
use serde_json::json;

use super::folders::killed;
use crate::support::Client;
use crate::support::process::jostled;

/// The exit code of a daemon that cannot open its data folder.
const CANNOT_OPEN: i32 = 2;

/// The files of a folder with their contents.
fn bytes(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        match path.is_dir() {
            true => found.extend(bytes(&path)),
            false => drop(found.insert(path.clone(), fs::read(&path).unwrap())),
        }
    }
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn an_older_program_does_not_start_on_the_folder_of_a_newer_one_and_changes_nothing() {
    let folder = killed(async |client: &Client| {
        client.create("school", json!({"n": 12, "seed": 3})).await;
        client.ok("school", "set", json!({"pi3": 2.0})).await;
        crate::experiments::submit(client, "name = 'e'\nduration = 1\nspec = { n = 3 }\n").await;
    })
    .await;
    let file = folder.path().join("jostle.sqlite");
    let later = MODEL_VERSION + 1;
    let wal = file.with_extension("sqlite-wal");
    // With a log of writes that a kill has left, and without, as after an orderly end.
    for is_killed in [true, false] {
        let database = Connection::open(&file).unwrap();
        let keeps = DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE;
        database.set_db_config(keeps, is_killed).unwrap();
        let write = "UPDATE program SET version = '9.9.9', model = ?";
        database.execute(write, [later]).unwrap();
        drop(database);
        assert_eq!(wal.exists(), is_killed);
        let before = bytes(folder.path());
        let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--data-dir"]);
        let output = command
            .arg(folder.path())
            .stderr(std::process::Stdio::piped())
            .output()
            .unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(CANNOT_OPEN), "{message}");
        for part in [
            "written by a newer jostled, version 9.9.9",
            &format!("model version {later}, this one knows {MODEL_VERSION}"),
            "upgrade, or name another --data-dir",
        ] {
            assert!(message.contains(part), "{message}");
        }
        let after = bytes(folder.path());
        let names = |files: &BTreeMap<PathBuf, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(&after), names(&before), "{is_killed}");
        for (path, bytes) in &before {
            // SQLite writes this index of the log anew when it opens a file.
            if path.ends_with("jostle.sqlite-shm") {
                continue;
            }
            assert!(after[path] == *bytes, "{is_killed}: {}", path.display());
        }
    }
}
