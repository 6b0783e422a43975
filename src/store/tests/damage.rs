//! Flipped bytes are told, and nothing else is ever read.

use super::*;

/// All that can be read of a store.
#[derive(Clone, Debug, PartialEq)]
struct Everything {
    swarms: Vec<(String, Vec<u8>)>,
    rows: Vec<Vec<Row>>,
    checkpoints: Vec<Vec<Checkpoint>>,
    answers: Vec<Answer>,
}

/// Reads everything, or fails with what was told.
fn everything(folder: &Path, most_checked_bytes: u64) -> Result<Everything, String> {
    let settings = Settings {
        quota_bytes: u64::MAX,
    };
    let store = Store::open_checking(folder, settings, Box::new(|_| {}), most_checked_bytes)
        .map_err(|error| error.to_string())?;
    let read = read_all(&store).map_err(|error| error.to_string());
    let damaged = store.health().damaged;
    match read {
        Ok(_) if damaged > 0 => Err(format!("{damaged} damaged")),
        read => read,
    }
}

fn read_all(store: &Store) -> Result<Everything, StoreError> {
    let swarms = store.swarms()?;
    let (mut rows, mut checkpoints) = (Vec::new(), Vec::new());
    for (swarm, _) in &swarms {
        rows.push(store.rows(swarm, 0, usize::MAX)?.rows);
        let marks = store.checkpoints(swarm)?;
        let read: Result<_, _> = marks
            .iter()
            .rev()
            .map(|mark| store.checkpoint(swarm, mark.number))
            .collect();
        checkpoints.push(read?);
    }
    Ok(Everything {
        swarms,
        rows,
        checkpoints,
        answers: store.answers()?,
    })
}

/// Copies the database, with its WAL if it has one, to where it can be damaged.
fn copy(from: &Path, to: &Path) {
    for name in ["jostle.sqlite", "jostle.sqlite-wal"] {
        let _ = fs::remove_file(to.join(name));
        if from.join(name).exists() {
            fs::copy(from.join(name), to.join(name)).unwrap();
        }
    }
    let _ = fs::remove_file(to.join("jostle.sqlite-shm"));
}

/// Swarms `a` and `b`, rows enough for a tree of several pages, checkpoints that span pages.
fn fill(store: &Store) {
    let mut writes = vec![create("a"), create("b")];
    for number in 1..=120 {
        let body = vec![number as u8; 300];
        let row = Row {
            body,
            ..row(number)
        };
        writes.push(Write::Append {
            swarm: "a".to_string(),
            row,
        });
    }
    writes.extend([
        append("b", 1),
        append("b", 2),
        keep("b", 2, 10),
        keep("a", 60, 9000),
        keep("a", 120, 50),
    ]);
    writes.extend((1..=40).map(|number| Write::Answer(answer(number))));
    durable(store, writes).unwrap();
}

/// Flips bytes of the file one at a time, the first and every `step`-th; counts how often it was
/// told.
fn flip_file(step: usize, most_checked_bytes: u64) -> (usize, usize) {
    let (folder, damaged) = (folder(), folder());
    let store = open(folder.path());
    fill(&store);
    assert!(store.stop(PATIENCE));
    let whole = everything(folder.path(), u64::MAX).unwrap();
    let bytes = fs::read(folder.path().join(schema::FILE)).unwrap();
    let (mut tried, mut told) = (0, 0);
    for place in (0..bytes.len()).step_by(step) {
        let mut flipped = bytes.clone();
        flipped[place] ^= 1 << (place / step % 8);
        copy(folder.path(), damaged.path());
        fs::write(damaged.path().join(schema::FILE), flipped).unwrap();
        match everything(damaged.path(), most_checked_bytes) {
            Ok(read) => assert!(read == whole, "byte {place} changed what is read"),
            Err(_) => told += 1,
        }
        tried += 1;
    }
    (tried, told)
}

#[test]
fn a_flipped_byte_of_the_file_is_told_or_changes_nothing() {
    let (tried, told) = flip_file(64, u64::MAX);
    println!("{told} of {tried} told");
    assert!(tried > 1000 && told > tried / 2, "{told} of {tried}");
}

#[test]
fn seals_and_extents_suffice_where_sqlite_does_not_look_through_the_file() {
    let (tried, told) = flip_file(64, 0);
    println!("{told} of {tried} told");
    assert!(told > tried / 2, "{told} of {tried}");
}

/// Whether `part` is how `whole` began.
fn is_prefix(part: &Everything, whole: &Everything) -> bool {
    let lists = |store: &Everything| [store.swarms.len(), store.answers.len()];
    lists(part) <= lists(whole)
        && part.swarms == whole.swarms[..part.swarms.len()]
        && part.answers == whole.answers[..part.answers.len()]
        && part
            .rows
            .iter()
            .zip(&whole.rows)
            .all(|(part, whole)| whole.starts_with(part))
        && part
            .checkpoints
            .iter()
            .zip(&whole.checkpoints)
            .all(|(part, whole)| whole.starts_with(part))
}

/// Writes in many commits, and copies file and WAL as a crash would leave them.
fn crashed(is_moved: bool) -> (TempDir, Everything) {
    let (live, crashed) = (folder(), folder());
    let mut store = open(live.path());
    durable(&store, vec![create("a"), create("b")]).unwrap();
    for number in 1..=60 {
        if number == 25 {
            // From here on the WAL changes pages that the file has already.
            assert!(store.stop(PATIENCE));
            store = open(live.path());
        }
        let mut writes = vec![
            append("a", number),
            append("b", number),
            Write::Answer(answer(number)),
        ];
        if number % 20 == 0 {
            writes.push(keep("a", number, 6000));
        }
        durable(&store, writes).unwrap();
    }
    let file = live.path().join(schema::FILE);
    if is_moved {
        let other = Connection::open(&file).unwrap();
        other
            .query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(()))
            .unwrap();
    }
    copy(live.path(), crashed.path());
    let whole = read_all(&store).unwrap();
    (crashed, whole)
}

/// Flips bytes of the WAL; what each reading gives.
fn flip_wal(crashed: &Path, step: usize, mut judge: impl FnMut(usize, Result<Everything, String>)) {
    let damaged = folder();
    let bytes = fs::read(crashed.join("jostle.sqlite-wal")).unwrap();
    for place in (0..bytes.len()).step_by(step) {
        let mut flipped = bytes.clone();
        flipped[place] ^= 1 << (place / step % 8);
        copy(crashed, damaged.path());
        fs::write(damaged.path().join("jostle.sqlite-wal"), flipped).unwrap();
        judge(place, everything(damaged.path(), 0));
    }
}

/// A WAL ends where its checksums do: a torn last commit, which a crash leaves and which nobody
/// was told of, cannot be told from a damaged one in the middle. So fewer rows may be read, from
/// the end, and it is SQLite that decides; but never others, and never with a gap.
#[test]
fn with_a_flipped_byte_of_the_wal_what_is_read_is_how_it_began() {
    let (crashed, whole) = crashed(false);
    let mut lengths = std::collections::BTreeSet::new();
    flip_wal(crashed.path(), 64 * 61, |place, read| {
        let read = read.unwrap_or_else(|told| panic!("byte {place}: {told}"));
        assert!(
            is_prefix(&read, &whole),
            "byte {place} changed what is read"
        );
        lengths.insert(read.answers.len());
    });
    assert!(lengths.len() > 30, "{lengths:?}");
}

/// Once the WAL's pages have been moved into the file, a WAL cut short hides new pages behind old
/// ones. What then does not fit together is told.
#[test]
fn a_wal_that_was_moved_and_then_damaged_gives_what_was_or_is_told() {
    let (crashed, whole) = crashed(true);
    let (mut told, mut tried) = (0, 0);
    flip_wal(crashed.path(), 64 * 61, |place, read| {
        tried += 1;
        match read {
            Ok(read) => assert!(
                is_prefix(&read, &whole),
                "byte {place} changed what is read"
            ),
            Err(_) => told += 1,
        }
    });
    println!("{told} of {tried} told");
}

#[test]
fn the_rows_before_a_damaged_one_are_read() {
    let folder = folder();
    let store = open(folder.path());
    durable(
        &store,
        (0..=9)
            .map(|number| {
                if number == 0 {
                    create("a")
                } else {
                    append("a", number)
                }
            })
            .collect(),
    )
    .unwrap();
    assert!(store.stop(PATIENCE));
    let connection = Connection::open(folder.path().join(schema::FILE)).unwrap();
    connection
        .execute("UPDATE row SET step = step + 1 WHERE number = 5", [])
        .unwrap();
    connection
        .execute("DELETE FROM row WHERE number = 8", [])
        .unwrap();
    drop(connection);
    let store = open(folder.path());
    let expected: Vec<Row> = (1..=4).map(row).collect();
    assert_eq!(
        store.rows("a", 0, 99).unwrap(),
        Rows {
            rows: expected,
            damaged_at: Some(5)
        }
    );
    assert_eq!(
        store.rows("a", 5, 99).unwrap(),
        Rows {
            rows: vec![row(6), row(7)],
            damaged_at: Some(8)
        }
    );
    assert_eq!(store.rows("a", 5, 2).unwrap().damaged_at, None);
    assert_eq!(store.health().damaged, 2);
}

#[test]
fn damaged_checkpoints_and_answers_are_left_out_and_counted() {
    let folder = folder();
    let store = open(folder.path());
    let mut writes = vec![
        create("a"),
        append("a", 1),
        append("a", 2),
        keep("a", 1, 100),
        keep("a", 2, 100),
    ];
    writes.extend((1..=5).map(|number| Write::Answer(answer(number))));
    durable(&store, writes).unwrap();
    assert!(store.stop(PATIENCE));
    let connection = Connection::open(folder.path().join(schema::FILE)).unwrap();
    connection
        .execute("UPDATE checkpoint SET step = 0 WHERE number = 2", [])
        .unwrap();
    connection
        .execute("UPDATE checkpoint SET body = x'00' WHERE number = 1", [])
        .unwrap();
    connection
        .execute("UPDATE answer SET is_ok = 0 WHERE id = 2", [])
        .unwrap();
    connection
        .execute("DELETE FROM answer WHERE id = 5", [])
        .unwrap();
    drop(connection);
    let store = open(folder.path());
    let marks: Vec<u64> = store
        .checkpoints("a")
        .unwrap()
        .iter()
        .map(|mark| mark.number)
        .collect();
    assert_eq!(marks, [1, 0], "2 does not even say which step it is of");
    assert!(matches!(
        store.checkpoint("a", 1),
        Err(StoreError::Damaged { .. })
    ));
    assert!(matches!(
        store.checkpoint("a", 2),
        Err(StoreError::Damaged { .. })
    ));
    assert_eq!(store.health().damaged, 1);
    assert_eq!(store.answers().unwrap(), [answer(1), answer(3), answer(4)]);
    assert_eq!(store.health().damaged, 3);
}

#[test]
fn a_damaged_or_missing_swarm_is_named_and_can_only_be_deleted() {
    let folder = folder();
    let store = open(folder.path());
    durable(&store, vec![create("a"), create("b")]).unwrap();
    assert!(store.stop(PATIENCE));
    let alter = |sql| {
        Connection::open(folder.path().join(schema::FILE))
            .unwrap()
            .execute_batch(sql)
            .unwrap();
    };
    alter("UPDATE extent SET last = 7 WHERE id = 2");
    let store = open(folder.path());
    let error = store.swarms().unwrap_err();
    assert!(
        matches!(&error, StoreError::Damaged { swarm, .. } if swarm == "b"),
        "{error}"
    );
    assert!(matches!(
        durable(&store, vec![append("b", 8)]),
        Err(StoreFault::Refused(_))
    ));
    durable(&store, vec![append("a", 1)]).unwrap();
    durable(
        &store,
        vec![
            Write::Delete {
                swarm: "b".to_string(),
            },
            create("b"),
        ],
    )
    .unwrap();
    assert_eq!(store.swarms().unwrap().len(), 2);
    assert!(store.stop(PATIENCE));
    alter("DELETE FROM swarm WHERE name = 'a'");
    assert!(matches!(
        open(folder.path()).swarms(),
        Err(StoreError::Damaged { .. })
    ));
}

#[test]
fn a_swarm_is_cut_where_it_is_damaged_and_goes_on_from_there() {
    let folder = folder();
    let store = open(folder.path());
    let rows = (1..=9).map(|number| append("a", number));
    let mut writes: Vec<Write> = std::iter::once(create("a")).chain(rows).collect();
    writes.extend([create("b"), append("b", 1)]);
    writes.insert(4, keep("a", 3, 50));
    writes.push(keep("a", 8, 50));
    durable(&store, writes).unwrap();
    assert!(store.stop(PATIENCE));
    let file = folder.path().join(schema::FILE);
    let alter = "UPDATE row SET step = step + 1 WHERE number = 5";
    let connection = Connection::open(&file).unwrap();
    connection.execute(alter, []).unwrap();
    drop(connection);
    let damaged = fs::read(&file).unwrap();

    let store = open(folder.path());
    let cut = |after| Write::Cut {
        swarm: "a".to_string(),
        after,
    };
    for outside in [10, u64::MAX] {
        assert!(matches!(
            durable(&store, vec![cut(outside)]),
            Err(StoreFault::Refused(_))
        ));
    }
    durable(&store, vec![cut(4), append("a", 5)]).unwrap();
    let expected = Rows {
        rows: (1..=5).map(row).collect(),
        damaged_at: None,
    };
    assert_eq!(store.rows("a", 0, 99).unwrap(), expected);
    let marks = store.checkpoints("a").unwrap();
    let marks: Vec<u64> = marks.iter().map(|mark| mark.number).collect();
    assert_eq!(marks, [3, 0]);
    durable(&store, vec![keep("a", 5, 50), append("b", 2)]).unwrap();
    assert!(store.stop(PATIENCE));
    let aside = fs::read(folder.path().join("damaged-1.sqlite")).unwrap();
    assert!(aside == damaged, "what was there is kept aside");
    let store = open(folder.path());
    assert_eq!(store.rows("a", 0, 99).unwrap(), expected);
    assert_eq!(store.checkpoints("a").unwrap().len(), 3);
    assert_eq!(store.health().damaged, 0);
}

#[test]
fn what_follows_a_cut_is_found_again_whatever_byte_was_damaged() {
    let (folder, damaged) = (folder(), folder());
    let store = open(folder.path());
    fill(&store);
    assert!(store.stop(PATIENCE));
    let whole = everything(folder.path(), u64::MAX).unwrap();
    let bytes = fs::read(folder.path().join(schema::FILE)).unwrap();
    let (mut tried, mut cut) = (0, 0);
    for place in (0..bytes.len()).step_by(61) {
        let mut flipped = bytes.clone();
        flipped[place] ^= 1 << (place / 61 % 8);
        copy(folder.path(), damaged.path());
        fs::write(damaged.path().join(schema::FILE), flipped).unwrap();
        tried += 1;
        let settings = Settings {
            quota_bytes: u64::MAX,
        };
        let Ok(store) = Store::open(damaged.path(), settings, Box::new(|_| {})) else {
            continue;
        };
        let rows = |store: &Store, swarm| store.rows(swarm, 0, usize::MAX);
        let (Ok(of_a), Ok(of_b)) = (rows(&store, "a"), rows(&store, "b")) else {
            continue;
        };
        let Some(lost) = of_a.damaged_at else {
            continue;
        };
        cut += 1;
        let told = format!("byte {place}, row {lost}");
        let after = Write::Cut {
            swarm: "a".to_string(),
            after: lost - 1,
        };
        durable(&store, vec![after]).unwrap_or_else(|fault| panic!("{told}: {fault}"));
        for first in (lost..lost + 130).step_by(26) {
            let rows = (first..first + 26).map(|number| append("a", number));
            durable(&store, rows.collect())
                .unwrap_or_else(|fault| panic!("{told}, then row {first}: {fault}"));
        }
        assert!(store.stop(PATIENCE));
        let store = open(damaged.path());
        let mut expected = whole.rows[0][..usize::try_from(lost).unwrap() - 1].to_vec();
        expected.extend((lost..lost + 130).map(row));
        let found = rows(&store, "a").unwrap();
        assert!(
            found.rows == expected && found.damaged_at.is_none(),
            "{told}"
        );
        assert_eq!(rows(&store, "b").unwrap(), of_b, "{told}");
    }
    println!("{cut} of {tried} damaged a row of a");
    assert!(cut > 100, "{cut} of {tried}");
}
