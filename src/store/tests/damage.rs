//! Damaged bytes are reported, and no read returns anything else than what was written.

use super::*;

/// Everything that a store returns.
#[derive(Clone, Debug, PartialEq)]
struct Everything {
    swarms: Vec<(String, Vec<u8>)>,
    rows: Vec<Vec<Row>>,
    checkpoints: Vec<Vec<Checkpoint>>,
    answers: Vec<Answer>,
}

/// Reads everything; an error if damage was reported.
fn everything(folder: &Path, max_checked_bytes: u64) -> Result<Everything, String> {
    let settings = Settings {
        quota_bytes: u64::MAX,
    };
    let store = Store::open_checking(folder, settings, Box::new(|_| {}), max_checked_bytes)
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
        let infos = store.checkpoints(swarm)?;
        let read: Result<_, _> = infos
            .iter()
            .rev()
            .map(|info| store.checkpoint(swarm, info.number))
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

/// Copies the database and its WAL, to be damaged.
fn copy(from: &Path, to: &Path) {
    for name in ["jostle.sqlite", "jostle.sqlite-wal"] {
        let _ = fs::remove_file(to.join(name));
        if from.join(name).exists() {
            fs::copy(from.join(name), to.join(name)).unwrap();
        }
    }
    let _ = fs::remove_file(to.join("jostle.sqlite-shm"));
}

/// Swarms `a` and `b` with a tree of several pages and checkpoints larger than a page.
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

/// Flips a bit of every `step`-th byte of the file, one at a time. Returns how many were tried and how
/// many reported.
fn flip_file(step: usize, max_checked_bytes: u64) -> (usize, usize) {
    let (folder, damaged) = (folder(), folder());
    let store = open(folder.path());
    fill(&store);
    assert!(store.stop(TIMEOUT));
    let whole = everything(folder.path(), u64::MAX).unwrap();
    let bytes = fs::read(folder.path().join(schema::FILE)).unwrap();
    let (mut tried, mut reported) = (0, 0);
    for place in (0..bytes.len()).step_by(step) {
        let mut flipped = bytes.clone();
        flipped[place] ^= 1 << (place / step % 8);
        copy(folder.path(), damaged.path());
        fs::write(damaged.path().join(schema::FILE), flipped).unwrap();
        match everything(damaged.path(), max_checked_bytes) {
            Ok(read) => assert!(read == whole, "byte {place} changed what is read"),
            Err(_) => reported += 1,
        }
        tried += 1;
    }
    (tried, reported)
}

#[test]
fn a_flipped_byte_of_the_file_is_reported_or_changes_nothing() {
    let (tried, reported) = flip_file(64, u64::MAX);
    println!("{reported} of {tried} reported");
    assert!(
        tried > 1000 && reported > tried / 2,
        "{reported} of {tried}"
    );
}

#[test]
fn checksums_and_extents_suffice_without_a_check_of_the_pages() {
    let (tried, reported) = flip_file(64, 0);
    println!("{reported} of {tried} reported");
    assert!(reported > tried / 2, "{reported} of {tried}");
}

/// Whether `part` is a prefix of `whole`.
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
fn crashed(has_checkpointed: bool) -> (TempDir, Everything) {
    let (live, crashed) = (folder(), folder());
    let mut store = open(live.path());
    durable(&store, vec![create("a"), create("b")]).unwrap();
    for number in 1..=60 {
        if number == 25 {
            // From here on the WAL changes pages that the file has.
            assert!(store.stop(TIMEOUT));
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
    if has_checkpointed {
        let other = Connection::open(&file).unwrap();
        other
            .query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(()))
            .unwrap();
    }
    copy(live.path(), crashed.path());
    let whole = read_all(&store).unwrap();
    (crashed, whole)
}

/// Flips bytes of the WAL, and passes what each read returns.
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

/// SQLite reads a WAL up to the first wrong checksum: it cannot distinguish the torn last commit of a
/// crash from damage in the middle. So rows may be missing at the end, but none differs and there is
/// no gap.
#[test]
fn with_a_flipped_byte_of_the_wal_a_prefix_is_read() {
    let (crashed, whole) = crashed(false);
    let mut lengths = std::collections::BTreeSet::new();
    flip_wal(crashed.path(), 64 * 61, |place, read| {
        let read = read.unwrap_or_else(|error| panic!("byte {place}: {error}"));
        assert!(
            is_prefix(&read, &whole),
            "byte {place} changed what is read"
        );
        lengths.insert(read.answers.len());
    });
    assert!(lengths.len() > 30, "{lengths:?}");
}

/// After a checkpoint of the WAL, a truncated WAL hides new pages behind old ones. What does not fit
/// together is reported.
#[test]
fn damage_to_a_checkpointed_wal_leaves_a_prefix_or_is_reported() {
    let (crashed, whole) = crashed(true);
    let (mut reported, mut tried) = (0, 0);
    flip_wal(crashed.path(), 64 * 61, |place, read| {
        tried += 1;
        match read {
            Ok(read) => assert!(
                is_prefix(&read, &whole),
                "byte {place} changed what is read"
            ),
            Err(_) => reported += 1,
        }
    });
    println!("{reported} of {tried} reported");
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
    assert!(store.stop(TIMEOUT));
    alter(
        folder.path(),
        "UPDATE row SET step = step + 1 WHERE number = 5; DELETE FROM row WHERE number = 8",
    );
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
    assert!(store.stop(TIMEOUT));
    alter(
        folder.path(),
        "UPDATE checkpoint SET step = 0 WHERE number = 2;
         UPDATE checkpoint SET body = x'00' WHERE number = 1;
         UPDATE answer SET is_ok = 0 WHERE id = 2;
         DELETE FROM answer WHERE id = 5",
    );
    let store = open(folder.path());
    assert_eq!(checkpoints(&store, "a"), [1, 0], "the step of 2 is wrong");
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
    assert!(store.stop(TIMEOUT));
    alter(folder.path(), "UPDATE extent SET last = 7 WHERE id = 2");
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
    durable(&store, vec![delete("b"), create("b")]).unwrap();
    assert_eq!(store.swarms().unwrap().len(), 2);
    assert!(store.stop(TIMEOUT));
    alter(folder.path(), "DELETE FROM swarm WHERE name = 'a'");
    assert!(matches!(
        open(folder.path()).swarms(),
        Err(StoreError::Damaged { .. })
    ));
}

#[test]
fn rows_can_follow_a_cut_before_a_damaged_row() {
    let folder = folder();
    let store = open(folder.path());
    let rows = (1..=9).map(|number| append("a", number));
    let mut writes: Vec<Write> = std::iter::once(create("a")).chain(rows).collect();
    writes.extend([create("b"), append("b", 1)]);
    writes.insert(4, keep("a", 3, 50));
    writes.push(keep("a", 8, 50));
    durable(&store, writes).unwrap();
    assert!(store.stop(TIMEOUT));
    let file = folder.path().join(schema::FILE);
    alter(
        folder.path(),
        "UPDATE row SET step = step + 1 WHERE number = 5",
    );
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
    assert_eq!(checkpoints(&store, "a"), [3, 0]);
    durable(&store, vec![keep("a", 5, 50), append("b", 2)]).unwrap();
    assert!(store.stop(TIMEOUT));
    let copied = fs::read(folder.path().join("damaged-1.sqlite")).unwrap();
    assert!(copied == damaged, "a copy of the damaged file");
    let store = open(folder.path());
    assert_eq!(store.rows("a", 0, 99).unwrap(), expected);
    assert_eq!(store.checkpoints("a").unwrap().len(), 3);
    assert_eq!(store.health().damaged, 0);
}

#[test]
fn rows_after_a_cut_are_found_whichever_byte_was_damaged() {
    let (folder, damaged) = (folder(), folder());
    let store = open(folder.path());
    fill(&store);
    assert!(store.stop(TIMEOUT));
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
        let place = format!("byte {place}, row {lost}");
        let after = Write::Cut {
            swarm: "a".to_string(),
            after: lost - 1,
        };
        durable(&store, vec![after]).unwrap_or_else(|fault| panic!("{place}: {fault}"));
        for first in (lost..lost + 130).step_by(26) {
            let rows = (first..first + 26).map(|number| append("a", number));
            durable(&store, rows.collect())
                .unwrap_or_else(|fault| panic!("{place}, then row {first}: {fault}"));
        }
        assert!(store.stop(TIMEOUT));
        let store = open(damaged.path());
        let mut expected = whole.rows[0][..usize::try_from(lost).unwrap() - 1].to_vec();
        expected.extend((lost..lost + 130).map(row));
        let found = rows(&store, "a").unwrap();
        assert!(
            found.rows == expected && found.damaged_at.is_none(),
            "{place}"
        );
        assert_eq!(rows(&store, "b").unwrap(), of_b, "{place}");
    }
    println!("{cut} of {tried} damaged a row of a");
    assert!(cut > 100, "{cut} of {tried}");
}
