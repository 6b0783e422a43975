//! A damaged data folder: told, and never taken for what was written.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use crate::crash::life::{self, Left, Life};
use crate::crash::twin::{Answers, Twin};
use crate::support::{Client, PREFIX, alone, beside_others};

const FILE: &str = "jostle.sqlite";

/// Bytes flipped in `./check`, of every 64th; with `JOSTLE_LONG=1` all of those.
const FLIPS: usize = 40;

const SWARMS: [(&str, u64); 3] = [("a", 5), ("b", 20), ("c", 40)];

/// Creates swarms and gives them a past.
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
    // Safe, and all before it.
    for (name, _) in SWARMS {
        let request = json!({"client": "me", "request_id": format!("{name}-end")});
        client.ok(name, "pause", request).await;
    }
}

/// Every hash that the swarms ever had.
fn hashes(folder: &Path) -> Vec<(&'static str, BTreeSet<String>, String)> {
    let left = Left::on(folder);
    SWARMS
        .iter()
        .map(|(name, n)| {
            let mut twin = Twin::new(name, &json!({"n": n, "seed": n}));
            twin.remember_all();
            twin.tell(left.rows(name, 0), &Answers::new());
            let last = twin.hash();
            (*name, twin.passed(), last)
        })
        .collect()
}

/// What came of a damaged folder.
#[derive(Debug, Default)]
struct Tally {
    refused: usize,
    unharmed: usize,
    earlier: usize,
    left_out: usize,
    faulted: usize,
}

/// Starts a daemon on a damaged folder: it says what is wrong, and what it has is true.
async fn judge(
    folder: &Path,
    expected: &[(&str, BTreeSet<String>, String)],
    must_tell: bool,
    what: &str,
    tally: &mut Tally,
) {
    let _ = fs::remove_file(folder.join("log"));
    let life = match Life::begin(&mut life::daemon(folder)) {
        Ok(life) => life,
        Err(code) => {
            let log = life::log(folder);
            assert!(
                code.is_some_and(|code| code != 101),
                "{what}: {code:?}: {log}"
            );
            assert!(
                log.contains("--data-dir") || log.contains("restore a backup"),
                "{what}: {log}"
            );
            assert!(log.contains(FILE), "{what}: {log}");
            tally.refused += 1;
            return;
        }
    };
    let client = Client::open(&life.endpoint).await;
    let log = life::log(folder);
    let is_told = log.contains("damaged") || log.contains("failed to recover");
    let (mut is_unharmed, mut is_faulted) = (true, false);
    for (name, passed, last) in expected {
        let answers = client.ask(&keys::get(PREFIX, name, "status"), None).await;
        let Some(status) = answers.into_iter().next() else {
            let is_named = log.contains(&format!("swarm=\"{name}\""));
            assert!(is_named || !must_tell, "{what}: {log}");
            tally.left_out += 1;
            is_unharmed = false;
            continue;
        };
        let status = status.unwrap();
        let hash = status["result"]["state_hash"].as_str().unwrap();
        if status["phase"] == "faulted" {
            is_faulted = true;
            go_on(&client, name).await;
        }
        if hash == last {
            continue;
        }
        is_unharmed = false;
        assert!(passed.contains(hash), "{what}: never was {status}");
        assert!(
            is_told || !must_tell,
            "{what}: taken back unsaid: {status} {log}"
        );
        tally.earlier += 1;
    }
    tally.unharmed += usize::from(is_unharmed);
    tally.faulted += usize::from(is_faulted);
}

/// A faulted swarm says why, and can be used again once it is reset.
async fn go_on(client: &Client, name: &str) {
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
async fn whatever_byte_is_damaged_no_state_is_a_wrong_one() {
    let _alone = alone().await;
    let is_long = std::env::var_os("JOSTLE_LONG").is_some();
    let (killed, moved) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut life = Life::begin(&mut life::daemon(killed.path())).unwrap();
    fill(&Client::open(&life.endpoint).await).await;
    life.kill();
    // As the kill left it, but for the WAL, which is moved into the file.
    life::copy(killed.path(), moved.path());
    let database = rusqlite::Connection::open(moved.path().join(FILE)).unwrap();
    let moving = "PRAGMA wal_checkpoint(TRUNCATE)";
    database.query_row(moving, [], |_| Ok(())).unwrap();
    drop(database);
    let expected = hashes(killed.path());

    // The WAL ends where it no longer fits together, as after a crash: that cannot be told.
    for (from, file, must_tell) in [
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
        let mut tally = Tally::default();
        let places = places.into_iter().skip(every / 2).step_by(every);
        for place in places.clone() {
            let folder = tempfile::tempdir().unwrap();
            life::copy(from, folder.path());
            let mut flipped = bytes.clone();
            flipped[place] ^= 1 << (place / 64 % 8);
            fs::write(folder.path().join(&file), flipped).unwrap();
            let what = format!("{file}, byte {place}");
            judge(folder.path(), &expected, must_tell, &what, &mut tally).await;
        }
        let count = places.count();
        println!("{count} of {} bytes of {file}: {tally:?}", bytes.len());
        // Most of the file is free, or of one swarm. The WAL counts up to its first damaged frame.
        let Tally {
            refused, left_out, ..
        } = tally;
        assert!(left_out <= count / 2, "{tally:?}");
        if must_tell {
            assert!(
                refused <= count / 8 && tally.unharmed >= count / 4,
                "{tally:?}"
            );
            assert!(tally.faulted > 0 && tally.earlier > 0, "{tally:?}");
        } else {
            assert!(refused == 0 && tally.earlier >= count, "{tally:?}");
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
    let _machine = beside_others().await;
    let killed = tempfile::tempdir().unwrap();
    let mut life = Life::begin(&mut life::daemon(killed.path())).unwrap();
    fill(&Client::open(&life.endpoint).await).await;
    life.kill();
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
            life::copy(killed.path(), folder.path());
            let of_swarm = format!("swarm = (SELECT id FROM swarm WHERE name = '{swarm}')");
            let condition = format!("{of_swarm} AND number = {number}");
            flip(folder.path(), table, "body", &condition);
            let what = format!("{table} {number} of {swarm}");
            let begun = Life::begin(&mut life::daemon(folder.path()));
            let life = begun.unwrap_or_else(|code| panic!("{what}: refused with {code:?}"));
            let client = Client::open(&life.endpoint).await;
            for (name, passed, last) in &expected {
                let answers = client.ask(&keys::get(PREFIX, name, "status"), None).await;
                let status = answers.into_iter().next().map(Result::unwrap);
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

    // Which swarms there are must be known: damage to that is refused, and named.
    for (table, column, condition) in [
        ("swarm", "about", "name = 'b'"),
        (
            "extent",
            "seal",
            "id = (SELECT id FROM swarm WHERE name = 'b')",
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        life::copy(killed.path(), folder.path());
        flip(folder.path(), table, column, condition);
        let begun = Life::begin(&mut life::daemon(folder.path()));
        let Err(code) = begun else {
            panic!("{table}: the daemon starts");
        };
        let log = life::log(folder.path());
        assert_eq!(code, Some(1), "{table}: {log}");
        assert!(log.contains(FILE) && log.contains("swarm \"b\""), "{log}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_journal_damaged_in_the_middle_faults_its_swarm_which_goes_on_after_a_reset() {
    let _machine = beside_others().await;
    let folder = tempfile::tempdir().unwrap();
    let mut life = Life::begin(&mut life::daemon(folder.path())).unwrap();
    fill(&Client::open(&life.endpoint).await).await;
    life.kill();
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
    // Also after one more kill it has the same state, and says the same.
    for _ in 0..2 {
        let mut life = Life::begin(&mut life::daemon(folder.path())).unwrap();
        let client = Client::open(&life.endpoint).await;
        let status = client.get("b", "status").await;
        assert_eq!(status["phase"], "faulted");
        let reason = status["result"]["reason"].as_str().unwrap();
        assert!(
            reason.contains("line 9") && reason.contains("reset"),
            "{reason}"
        );
        let hash = status["result"]["state_hash"].as_str().unwrap();
        assert!(passed.contains(hash) && hash != last, "{status}");
        assert_eq!(*before.get_or_insert(place(&status)), place(&status));
        // The others are what they were.
        for (name, _, last) in [&expected[0], &expected[2]] {
            assert_eq!(client.hash(name).await, *last);
        }
        life.kill();
    }
    assert!(
        folder.path().join("damaged-1.sqlite").exists(),
        "the copy of the damaged file"
    );
    assert!(life::log(folder.path()).contains("damaged-1.sqlite"));

    let mut life = Life::begin(&mut life::daemon(folder.path())).unwrap();
    let client = Client::open(&life.endpoint).await;
    go_on(&client, "b").await;
    let stepped = client.ok("b", "inject", json!({"count": 2})).await;
    let hash = client.hash("b").await;
    life.kill();
    let life = Life::begin(&mut life::daemon(folder.path())).unwrap();
    let client = Client::open(&life.endpoint).await;
    let status = client.get("b", "status").await;
    assert_eq!(
        (&status["seq"], &status["phase"]),
        (&stepped["seq"], &json!("paused"))
    );
    assert_eq!(status["result"]["state_hash"], hash);
    let verified = client
        .one(&keys::get(PREFIX, "b", "verify"), None)
        .await
        .unwrap();
    assert_eq!(verified["result"]["differs_at"], Value::Null, "{verified}");
}
