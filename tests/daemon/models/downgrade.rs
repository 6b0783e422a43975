//! An older program leaves the folder of a newer one as it is, and says which program has written it.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use jostle_physics::model::MODEL_VERSION;
use rusqlite::Connection;
use rusqlite::config::DbConfig;
use serde_json::json;

use super::folders::killed;
use crate::support::Client;
use crate::support::process::jostled;

/// The exit code of a daemon that cannot open its data folder.
const CANNOT_OPEN: i32 = 2;

/// The version of the model of a later program.
const LATER: u32 = MODEL_VERSION + 1;

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

/// Makes a daemon of a later model the last one that has opened the folder. With `is_killed` its log of writes
/// is left, as after a kill.
fn written_by_later(folder: &Path, is_killed: bool) {
    let file = folder.join("jostle.sqlite");
    let database = Connection::open(&file).unwrap();
    let keeps = DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE;
    database.set_db_config(keeps, is_killed).unwrap();
    let write = "UPDATE program SET version = '9.9.9', model = ?";
    database.execute(write, [LATER]).unwrap();
    drop(database);
    assert_eq!(file.with_extension("sqlite-wal").exists(), is_killed);
}

/// Checks that this program does not start on a folder of a later one, says why, and changes nothing.
pub fn assert_refused(folder: &Path) {
    for is_killed in [true, false] {
        written_by_later(folder, is_killed);
        let before = bytes(folder);
        let mut command = jostled(&["serve", "--listen", "tcp/127.0.0.1:0", "--data-dir"]);
        let command = command.arg(folder).stderr(Stdio::piped());
        let output = command.output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(CANNOT_OPEN), "{message}");
        for part in [
            "written by a newer jostled, version 9.9.9",
            &format!("model version {LATER}, this one knows {MODEL_VERSION}"),
            "upgrade, or name another --data-dir",
        ] {
            assert!(message.contains(part), "{message}");
        }
        let after = bytes(folder);
        let names = |files: &BTreeMap<PathBuf, _>| files.keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(&after), names(&before), "{is_killed}");
        for (path, bytes) in &before {
            // SQLite writes this index of the log anew when it opens a file.
            let is_index = path.ends_with("jostle.sqlite-shm");
            assert!(
                is_index || after[path] == *bytes,
                "{is_killed}: {}",
                path.display()
            );
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_older_program_does_not_start_on_the_folder_of_a_newer_one_and_changes_nothing() {
    let folder = killed(async |client: &Client| {
        client.create("school", json!({"n": 12, "seed": 3})).await;
        client.ok("school", "set", json!({"pi3": 2.0})).await;
    })
    .await;
    assert_refused(folder.path());
}
