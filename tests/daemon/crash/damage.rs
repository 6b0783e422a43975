//! A damaged data folder is reported, and never leads to a wrong state.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use crate::support::daemon_process::{self, DaemonProcess, StoreCopy};
use crate::support::reference_model::{Answers, ReferenceModel};
use crate::support::{Client, PREFIX, QueryResult};

const FILE: &str = "jostle.sqlite";

/// Bytes flipped in `./check`, of every 64th; with `JOSTLE_LONG=1` all of those.
const FLIPS: usize = 40;

const SWARMS: [(&str, u64); 3] = [("a", 5), ("b", 20), ("c", 40)];

/// Creates swarms and sends them commands.
async fn fill(client: &Client) {
    for (name, n) in SWARMS {
        client.create(name, json!({"n": n, "seed": n})).await;
    }
    for round in 0..8 {
        for (name, _) in SWARMS {
            for (verb, args) in [
                (
                    "inform",
                    json!({"select": {"count": 2}, "direction": round}),
                ),
                ("step", json!({"steps": 25})),
                ("inject", json!({"count": 1})),
            ] {
                let id = format!("{name}-{verb}-{round}");
                let request = json!({"client": "me", "request_id": id, "args": args});
                client.ok(name, verb, request).await;
            }
        }
    }
    // Makes this command and all before it durable.
    for (name, _) in SWARMS {
        let request = json!({"client": "me", "request_id": format!("{name}-end")});
        client.ok(name, "pause", request).await;
    }
}

/// Every hash that the swarms had.
fn hashes(folder: &Path) -> Vec<(&'static str, BTreeSet<String>, String)> {
    let left = StoreCopy::of(folder);
    SWARMS
        .iter()
        .map(|(name, n)| {
            let mut model = ReferenceModel::new(name, &json!({"n": n, "seed": n}));
            model.record_hashes();
            model.replay(left.rows(name, 0), &Answers::new());
            let last = model.hash();
            (*name, model.recorded_hashes(), last)
        })
        .collect()
}

/// The outcomes of starts on damaged folders.
#[derive(Debug, Default)]
struct StartOutcomes {
    failed: usize,
    unharmed: usize,
    earlier: usize,
    left_out: usize,
    faulted: usize,
}

/// The status of a swarm, unless it could not be recovered.
fn recovered(answers: Vec<QueryResult>) -> Option<Value> {
    match answers.into_iter().next()? {
        Err(error) if error.code == ErrorCode::NotFound => None,
        status => Some(status.unwrap()),
    }
}

/// Starts a daemon on a damaged folder: it logs the damage, and every state that it serves existed.
async fn check_start(
    folder: &Path,
    expected: &[(&str, BTreeSet<String>, String)],
    must_report: bool,
    what: &str,
    outcomes: &mut StartOutcomes,
) {
    let _ = fs::remove_file(folder.join("log"));
    let process = match DaemonProcess::start(&mut daemon_process::daemon(folder)) {
        Ok(process) => process,
        Err(code) => {
            let log = daemon_process::log(folder);
            assert!(
                code.is_some_and(|code| code != 101),
                "{what}: {code:?}: {log}"
            );
            assert!(
                log.contains("--data-dir") || log.contains("restore a backup"),
                "{what}: {log}"
            );
            assert!(log.contains(FILE), "{what}: {log}");
            outcomes.failed += 1;
            return;
        }
    };
    let client = Client::open(&process.endpoint).await;
    let log = daemon_process::log(folder);
    let is_reported = log.contains("damaged") || log.contains("failed to recover");
    let (mut is_unharmed, mut is_faulted) = (true, false);
    for (name, passed, last) in expected {
        let answers = client
            .query_all(&keys::get(PREFIX, name, "status"), None)
            .await;
        let Some(status) = recovered(answers) else {
            let is_named = log.contains(&format!("swarm=\"{name}\""));
            assert!(is_named || !must_report, "{what}: {log}");
            outcomes.left_out += 1;
            is_unharmed = false;
            continue;
        };
        let hash = status["result"]["state_hash"].as_str().unwrap();
        if status["phase"] == "faulted" {
            is_faulted = true;
            reset_and_step(&client, name).await;
        }
        if hash == last {
            continue;
        }
        is_unharmed = false;
        assert!(passed.contains(hash), "{what}: never was {status}");
        assert!(
            is_reported || !must_report,
            "{what}: taken back unsaid: {status} {log}"
        );
        outcomes.earlier += 1;
    }
    outcomes.unharmed += usize::from(is_unharmed);
    outcomes.faulted += usize::from(is_faulted);
}

/// A faulted swarm rejects commands, and accepts them after a reset.
async fn reset_and_step(client: &Client, name: &str) {
    let (code, message) = client
        .err(
            name,
            "inform",
            json!({"select": {"count": 1}, "direction": 0}),
        )
        .await;
    assert_eq!(code, ErrorCode::IncorrectState, "{message}");
    client.ok(name, "reset", json!({})).await;
    let stepped = client.ok(name, "step", json!({"steps": 2})).await;
    assert_eq!(stepped["step"], 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn no_damaged_byte_leads_to_a_wrong_state() {
    let is_long = std::env::var_os("JOSTLE_LONG").is_some();
    let (killed, moved) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut process = DaemonProcess::start(&mut daemon_process::daemon(killed.path())).unwrap();
    fill(&Client::open(&process.endpoint).await).await;
    process.kill();
    // As the kill left it, but for the WAL, which is moved into the file.
    daemon_process::copy(killed.path(), moved.path());
    let database = rusqlite::Connection::open(moved.path().join(FILE)).unwrap();
    let moving = "PRAGMA wal_checkpoint(TRUNCATE)";
    database.query_row(moving, [], |_| Ok(())).unwrap();
    drop(database);
    let expected = hashes(killed.path());

    // A damaged WAL ends at its first invalid frame, as after a crash: the two cannot be distinguished.
    for (from, file, must_report) in [
        (moved.path(), FILE.to_owned(), true),
        (killed.path(), format!("{FILE}-wal"), false),
    ] {
        let bytes = fs::read(from.join(&file)).unwrap();
        let places: Vec<usize> = (0..bytes.len()).step_by(64).collect();
        let every = if is_long {
            1
        } else {
            places.len().div_ceil(FLIPS)
        };
        let mut outcomes = StartOutcomes::default();
        let places = places.into_iter().skip(every / 2).step_by(every);
        for place in places.clone() {
            let folder = tempfile::tempdir().unwrap();
            daemon_process::copy(from, folder.path());
            let mut flipped = bytes.clone();
            flipped[place] ^= 1 << (place / 64 % 8);
            fs::write(folder.path().join(&file), flipped).unwrap();
            let what = format!("{file}, byte {place}");
            check_start(folder.path(), &expected, must_report, &what, &mut outcomes).await;
        }
        let count = places.count();
        println!("{count} of {} bytes of {file}: {outcomes:?}", bytes.len());
        // Most pages of the file are free, or of one swarm. The WAL is valid up to its first damaged frame.
        let StartOutcomes {
            failed, left_out, ..
        } = outcomes;
        assert!(left_out <= count / 2, "{outcomes:?}");
        if must_report {
            assert!(
                failed <= count / 8 && outcomes.unharmed >= count / 4,
                "{outcomes:?}"
            );
            assert!(outcomes.faulted > 0 && outcomes.earlier > 0, "{outcomes:?}");
        } else {
            assert!(failed == 0 && outcomes.earlier >= count, "{outcomes:?}");
        }
    }
}

/// Flips a bit in the middle of a blob of the table that has this condition.
fn flip(folder: &Path, table: &str, column: &str, condition: &str) {
    let database = rusqlite::Connection::open(folder.join(FILE)).unwrap();
    let select = format!("SELECT {column} FROM {table} WHERE {condition}");
    let mut bytes: Vec<u8> = database
        .query_row(&select, [], |row| row.get(0))
        .unwrap_or_else(|error| panic!("{select}: {error}"));
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    let update = format!("UPDATE {table} SET {column} = ? WHERE {condition}");
    assert_eq!(database.execute(&update, [bytes]).unwrap(), 1);
}

/// The numbers of a swarm's records in a table.
fn numbers(folder: &Path, table: &str, swarm: &str) -> Vec<u64> {
    let database = rusqlite::Connection::open(folder.join(FILE)).unwrap();
    let select = format!(
        "SELECT number FROM {table} WHERE swarm = (SELECT id FROM swarm WHERE name = '{swarm}')
         ORDER BY number"
    );
    let mut select = database.prepare(&select).unwrap();
    let numbers = select.query_map([], |row| row.get::<_, i64>(0)).unwrap();
    numbers
        .map(|number| number.unwrap().cast_unsigned())
        .collect()
}

/// Damage to the journal or a checkpoint of a swarm costs at most that swarm.
#[tokio::test(flavor = "multi_thread")]
async fn damage_to_the_records_of_one_swarm_leaves_every_other_usable() {
    let killed = tempfile::tempdir().unwrap();
    let mut process = DaemonProcess::start(&mut daemon_process::daemon(killed.path())).unwrap();
    fill(&Client::open(&process.endpoint).await).await;
    process.kill();
    let expected = hashes(killed.path());
    let (mut faulted, mut left_out) = (0, 0);
    for (swarm, _) in SWARMS {
        let rows = numbers(killed.path(), "row", swarm);
        let few = rows.len() / 4;
        let rows = rows.into_iter().rev().step_by(few);
        let rows = rows.map(|number| ("row", number));
        let checkpoints = numbers(killed.path(), "checkpoint", swarm);
        let checkpoints = checkpoints.into_iter().map(|number| ("checkpoint", number));
        for (table, number) in rows.chain(checkpoints) {
            let folder = tempfile::tempdir().unwrap();
            daemon_process::copy(killed.path(), folder.path());
            let of_swarm = format!("swarm = (SELECT id FROM swarm WHERE name = '{swarm}')");
            let condition = format!("{of_swarm} AND number = {number}");
            flip(folder.path(), table, "body", &condition);
            let what = format!("{table} {number} of {swarm}");
            let started = DaemonProcess::start(&mut daemon_process::daemon(folder.path()));
            let process = started.unwrap_or_else(|code| panic!("{what}: exited with {code:?}"));
            let client = Client::open(&process.endpoint).await;
            for (name, passed, last) in &expected {
                let answers = client
                    .query_all(&keys::get(PREFIX, name, "status"), None)
                    .await;
                let status = recovered(answers);
                if *name == swarm {
                    match status {
                        Some(status) => {
                            let hash = status["result"]["state_hash"].as_str().unwrap();
                            assert!(passed.contains(hash), "{what}: {status}");
                            faulted += usize::from(status["phase"] == "faulted");
                        }
                        None => left_out += 1,
                    }
                    continue;
                }
                let status = status.unwrap_or_else(|| panic!("{what}: {name} is missing"));
                assert_eq!(status["result"]["state_hash"], *last, "{what}: {status}");
                assert_eq!(status["phase"], "paused", "{what}: {status}");
                client.ok(name, "inject", json!({"count": 1})).await;
                client.ok(name, "step", json!({"steps": 3})).await;
            }
        }
    }
    println!("{faulted} faulted, {left_out} left out");
    // At least the last row of each swarm is read when the swarm is restored.
    assert!(faulted >= SWARMS.len(), "{faulted}");

    // Damage to the list of swarms prevents the start, and is named.
    for (table, column, condition) in [
        ("swarm", "about", "name = 'b'"),
        (
            "extent",
            "seal",
            "id = (SELECT id FROM swarm WHERE name = 'b')",
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        daemon_process::copy(killed.path(), folder.path());
        flip(folder.path(), table, column, condition);
        let started = DaemonProcess::start(&mut daemon_process::daemon(folder.path()));
        let Err(code) = started else {
            panic!("{table}: the daemon starts");
        };
        let log = daemon_process::log(folder.path());
        assert_eq!(code, Some(1), "{table}: {log}");
        assert!(log.contains(FILE) && log.contains("swarm \"b\""), "{log}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_journal_damaged_in_the_middle_faults_its_swarm_which_goes_on_after_a_reset() {
    let folder = tempfile::tempdir().unwrap();
    let mut process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    fill(&Client::open(&process.endpoint).await).await;
    process.kill();
    let expected = hashes(folder.path());
    let (_, passed, last) = &expected[1];
    let database = rusqlite::Connection::open(folder.path().join(FILE)).unwrap();
    let damage = "UPDATE row SET body = x'00' WHERE number = 9
                  AND swarm = (SELECT id FROM swarm WHERE name = 'b')";
    assert_eq!(database.execute(damage, []).unwrap(), 1);
    drop(database);

    let place = |status: &Value| {
        let fields = [
            &status["step"],
            &status["seq"],
            &status["phase"],
            &status["result"]["state_hash"],
        ];
        json!(fields)
    };
    let mut before = None;
    // After another kill the state and the reason are the same.
    for _ in 0..2 {
        let mut process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
        let client = Client::open(&process.endpoint).await;
        let status = client.get("b", "status").await;
        assert_eq!(status["phase"], "faulted");
        let reason = status["result"]["reason"].as_str().unwrap();
        assert!(
            reason.contains("line 9") && reason.contains("reset"),
            "{reason}"
        );
        let hash = status["result"]["state_hash"].as_str().unwrap();
        assert!(passed.contains(hash) && hash != last, "{status}");
        // The first start has truncated the journal.
        if before.is_none() {
            let warnings = client.node("metrics").await["warnings"].to_string();
            for part in [
                "damaged or missing record",
                "check the disk",
                "jostle verify",
            ] {
                assert!(warnings.contains(part), "{part}: {warnings}");
            }
        }
        assert_eq!(*before.get_or_insert(place(&status)), place(&status));
        // The other swarms are unchanged.
        for (name, _, last) in [&expected[0], &expected[2]] {
            assert_eq!(client.hash(name).await, *last);
        }
        process.kill();
    }
    assert!(
        folder.path().join("damaged-1.sqlite").exists(),
        "the copy of the damaged file"
    );
    assert!(daemon_process::log(folder.path()).contains("damaged-1.sqlite"));

    let mut process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    reset_and_step(&client, "b").await;
    let stepped = client.ok("b", "inject", json!({"count": 2})).await;
    let hash = client.hash("b").await;
    process.kill();
    let process = DaemonProcess::start(&mut daemon_process::daemon(folder.path())).unwrap();
    let client = Client::open(&process.endpoint).await;
    let status = client.get("b", "status").await;
    assert_eq!(
        (&status["seq"], &status["phase"]),
        (&stepped["seq"], &json!("paused"))
    );
    assert_eq!(status["result"]["state_hash"], hash);
    let verified = client
        .query(&keys::get(PREFIX, "b", "verify"), None)
        .await
        .unwrap();
    assert_eq!(verified["result"]["differs_at"], Value::Null, "{verified}");
}
