//! Damaged bytes are reported, and no read returns anything else than what was written.

use super::*;

/// Everything that a store returns.
#[derive(Clone, Debug, PartialEq)]
struct Everything {
    swarms: Vec<(String, Vec<u8>)>,
    rows: Vec<Vec<Row>>,
    checkpoints: Vec<Vec<Checkpoint>>,
    replies: Vec<StoredReply>,
    audit: Vec<AuditLine>,
}

/// Reads everything; an error if damage was reported.
fn read_everything(folder: &Path, max_checked_bytes: u64) -> Result<Everything, String> {
    let store = Store::open_checking(folder, UNLIMITED, Box::new(|_| {}), max_checked_bytes)
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
        let infos = store.checkpoints(swarm)?.into_iter().rev();
        let read = infos.map(|info| store.checkpoint(swarm, info.number));
        checkpoints.push(read.collect::<Result<_, _>>()?);
    }
    let all = AuditFilter {
        limit: usize::MAX,
        ..AuditFilter::default()
    };
    let audit = store.audit(&all)?;
    store.0.shared.meter.found_damaged(audit.damaged);
    Ok(Everything {
        swarms,
        rows,
        checkpoints,
        replies: store.replies()?,
        audit: audit.lines,
    })
}

/// Copies the database and its WAL, to be damaged.
fn copy(from: &Path, to: &Path) {
    for name in [FILE, WAL] {
        let _ = fs::remove_file(to.join(name));
        if from.join(name).exists() {
            fs::copy(from.join(name), to.join(name)).unwrap();
        }
    }
    let _ = fs::remove_file(to.join("jostle.sqlite-shm"));
}

/// Swarms `a` and `b` with a tree of several pages and checkpoints larger than a page.
fn filled() -> (TempDir, Everything) {
    let mut writes = vec![create("a"), create("b")];
    writes.extend((1..=120).map(|number| append_large("a", number, 300)));
    writes.extend(appends("b", 1..=2));
    writes.extend([
        save_checkpoint("b", 2, 10),
        save_checkpoint("a", 60, 9000),
        save_checkpoint("a", 120, 50),
    ]);
    writes.extend((1..=40).map(|number| Write::InsertReply(reply(number))));
    let lines = (1..=60).map(|number| audit::line(number, ["ada", "ben"][number as usize % 2]));
    writes.extend(lines.map(Write::Audit));
    let (folder, store) = stored(writes);
    assert!(store.stop(TIMEOUT));
    let whole = read_everything(folder.path(), u64::MAX).unwrap();
    (folder, whole)
}

/// Flips a bit of every `step`-th byte of the file `name`, one at a time, and passes the place and the
/// folder of the damaged copy. Returns how many were flipped.
fn flip(folder: &Path, name: &str, step: usize, mut judge: impl FnMut(usize, &Path)) -> usize {
    let damaged = self::folder();
    let bytes = fs::read(folder.join(name)).unwrap();
    let places = (0..bytes.len()).step_by(step);
    for place in places.clone() {
        let mut flipped = bytes.clone();
        flipped[place] ^= 1 << (place / step % 8);
        copy(folder, damaged.path());
        fs::write(damaged.path().join(name), flipped).unwrap();
        judge(place, damaged.path());
    }
    places.len()
}

/// Flips bytes of the file. Returns how many were tried and how many reported.
fn flip_file(max_checked_bytes: u64) -> (usize, usize) {
    let (folder, whole) = filled();
    let mut reported = 0;
    let tried = flip(
        folder.path(),
        FILE,
        64,
        |place, damaged| match read_everything(damaged, max_checked_bytes) {
            Ok(read) => assert!(read == whole, "byte {place} changed what is read"),
            Err(_) => reported += 1,
        },
    );
    println!("{reported} of {tried} reported");
    (tried, reported)
}

#[test]
fn a_flipped_byte_of_the_file_is_reported_or_changes_nothing() {
    let (tried, reported) = flip_file(u64::MAX);
    assert!(tried > 1000 && reported > tried / 2);
}

#[test]
fn checksums_and_extents_suffice_without_a_check_of_the_pages() {
    let (tried, reported) = flip_file(0);
    assert!(reported > tried / 2);
}

/// Whether `part` is a prefix of `whole`.
fn is_prefix(part: &Everything, whole: &Everything) -> bool {
    fn all<T: PartialEq>(parts: &[Vec<T>], wholes: &[Vec<T>]) -> bool {
        let mut pairs = parts.iter().zip(wholes);
        pairs.all(|(part, whole)| whole.starts_with(part))
    }
    whole.swarms.starts_with(&part.swarms)
        && whole.replies.starts_with(&part.replies)
        && all(&part.rows, &whole.rows)
        && all(&part.checkpoints, &whole.checkpoints)
}

/// Writes in many commits, and copies file and WAL as a crash would leave them.
fn crashed(has_checkpointed: bool) -> (TempDir, Everything) {
    let crashed = folder();
    let (live, mut store) = stored(vec![create("a"), create("b")]);
    for number in 1..=60 {
        if number == 25 {
            // From here on the WAL changes pages that the file has.
            assert!(store.stop(TIMEOUT));
            store = open(live.path());
        }
        let mut writes = vec![append("a", number), append("b", number)];
        writes.push(Write::InsertReply(reply(number)));
        if number % 20 == 0 {
            writes.push(save_checkpoint("a", number, 6000));
        }
        durable(&store, writes).unwrap();
    }
    if has_checkpointed {
        alter(live.path(), "PRAGMA wal_checkpoint(PASSIVE)");
    }
    copy(live.path(), crashed.path());
    let whole = read_all(&store).unwrap();
    (crashed, whole)
}

/// SQLite reads a WAL up to the first wrong checksum: it cannot distinguish the torn last commit of a
/// crash from damage in the middle. So rows may be missing at the end, but none differs and there is
/// no gap.
#[test]
fn with_a_flipped_byte_of_the_wal_a_prefix_is_read() {
    let (crashed, whole) = crashed(false);
    let mut lengths = std::collections::BTreeSet::new();
    flip(crashed.path(), WAL, 64 * 61, |place, damaged| {
        let read =
            read_everything(damaged, 0).unwrap_or_else(|error| panic!("byte {place}: {error}"));
        let is_prefix = is_prefix(&read, &whole);
        assert!(is_prefix, "byte {place} changed what is read");
        lengths.insert(read.replies.len());
    });
    assert!(lengths.len() > 30, "{lengths:?}");
}

/// After a checkpoint of the WAL, a truncated WAL hides new pages behind old ones. What does not fit
/// together is reported.
#[test]
fn damage_to_a_checkpointed_wal_leaves_a_prefix_or_is_reported() {
    let (crashed, whole) = crashed(true);
    let mut reported = 0;
    let tried = flip(
        crashed.path(),
        WAL,
        64 * 61,
        |place, damaged| match read_everything(damaged, 0) {
            Ok(read) => assert!(is_prefix(&read, &whole), "byte {place}"),
            Err(_) => reported += 1,
        },
    );
    println!("{reported} of {tried} reported");
}

#[test]
fn the_rows_before_a_damaged_one_are_read() {
    let (folder, store) = stored(vec![create("a")]);
    durable(&store, appends("a", 1..=9)).unwrap();
    let sql = "UPDATE row SET step = step + 1 WHERE number = 5; DELETE FROM row WHERE number = 8";
    let store = altered(&store, &folder, sql);
    for (after, until, damaged_at) in [(0, 4, 5), (5, 7, 8)] {
        let expected = Rows {
            rows: (after + 1..=until).map(row).collect(),
            damaged_at: Some(damaged_at),
        };
        assert_eq!(store.rows("a", after, 99).unwrap(), expected);
    }
    assert_eq!(store.rows("a", 5, 2).unwrap().damaged_at, None);
    assert_eq!(store.health().damaged, 2);
}

#[test]
fn damaged_checkpoints_and_replies_are_left_out_and_counted() {
    let mut writes = vec![create("a"), append("a", 1), append("a", 2)];
    writes.extend([save_checkpoint("a", 1, 100), save_checkpoint("a", 2, 100)]);
    writes.extend((1..=5).map(|number| Write::InsertReply(reply(number))));
    let (folder, store) = stored(writes);
    let sql = "UPDATE checkpoint SET step = 0 WHERE number = 2;
               UPDATE checkpoint SET body = x'00' WHERE number = 1;
               UPDATE answer SET is_ok = 0 WHERE id = 2;
               DELETE FROM answer WHERE id = 5";
    let store = altered(&store, &folder, sql);
    assert_eq!(checkpoints(&store, "a"), [1, 0], "the step of 2 is wrong");
    for number in [1, 2] {
        let read = store.checkpoint("a", number);
        assert!(matches!(read, Err(StoreError::Damaged { .. })), "{number}");
    }
    assert_eq!(store.health().damaged, 1);
    assert_eq!(store.replies().unwrap(), [reply(1), reply(3), reply(4)]);
    assert_eq!(store.health().damaged, 3);
}

#[test]
fn a_damaged_or_missing_swarm_is_named_and_can_only_be_deleted() {
    let (folder, store) = stored(vec![create("a"), create("b")]);
    let store = altered(&store, &folder, "UPDATE extent SET last = 7 WHERE id = 2");
    let error = store.swarms().unwrap_err();
    assert!(
        matches!(&error, StoreError::Damaged { swarm, .. } if swarm == "b"),
        "{error}"
    );
    assert!(is_rejected(&store, vec![append("b", 8)]));
    durable(&store, vec![append("a", 1)]).unwrap();
    durable(&store, vec![delete("b"), create("b")]).unwrap();
    assert_eq!(store.swarms().unwrap().len(), 2);
    let store = altered(&store, &folder, "DELETE FROM swarm WHERE name = 'a'");
    assert!(matches!(store.swarms(), Err(StoreError::Damaged { .. })));
}

#[test]
fn rows_can_follow_a_cut_before_a_damaged_row() {
    let mut writes = vec![create("a"), create("b"), append("b", 1)];
    writes.extend(appends("a", 1..=9));
    writes.insert(6, save_checkpoint("a", 3, 50));
    writes.push(save_checkpoint("a", 8, 50));
    let (folder, store) = stored(writes);
    assert!(store.stop(TIMEOUT));
    let sql = "UPDATE row SET step = step + 1 WHERE number = 5";
    alter(folder.path(), sql);
    let damaged = fs::read(folder.path().join(FILE)).unwrap();

    let store = open(folder.path());
    let cut = |after| Write::Truncate {
        swarm: "a".to_string(),
        after,
    };
    for outside in [10, u64::MAX] {
        assert!(is_rejected(&store, vec![cut(outside)]));
    }
    durable(&store, vec![cut(4), append("a", 5)]).unwrap();
    let expected = Rows {
        rows: (1..=5).map(row).collect(),
        damaged_at: None,
    };
    assert_eq!(store.rows("a", 0, 99).unwrap(), expected);
    assert_eq!(checkpoints(&store, "a"), [3, 0]);
    durable(&store, vec![save_checkpoint("a", 5, 50), append("b", 2)]).unwrap();
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
    let (folder, whole) = filled();
    let mut cut = 0;
    let tried = flip(folder.path(), FILE, 61, |place, damaged| {
        let Ok(store) = Store::open(damaged, UNLIMITED, Box::new(|_| {})) else {
            return;
        };
        let rows = |store: &Store, swarm| store.rows(swarm, 0, usize::MAX);
        let (Ok(of_a), Ok(of_b)) = (rows(&store, "a"), rows(&store, "b")) else {
            return;
        };
        let Some(lost) = of_a.damaged_at else {
            return;
        };
        cut += 1;
        let place = format!("byte {place}, row {lost}");
        let after = Write::Truncate {
            swarm: "a".to_string(),
            after: lost - 1,
        };
        durable(&store, vec![after]).unwrap_or_else(|fault| panic!("{place}: {fault}"));
        for first in (lost..lost + 130).step_by(26) {
            durable(&store, appends("a", first..=first + 25))
                .unwrap_or_else(|fault| panic!("{place}, then row {first}: {fault}"));
        }
        assert!(store.stop(TIMEOUT));
        let store = open(damaged);
        let mut expected = whole.rows[0][..usize::try_from(lost).unwrap() - 1].to_vec();
        expected.extend((lost..lost + 130).map(row));
        let found = rows(&store, "a").unwrap();
        let is_whole = found.rows == expected && found.damaged_at.is_none();
        assert!(is_whole, "{place}");
        assert_eq!(rows(&store, "b").unwrap(), of_b, "{place}");
    });
    println!("{cut} of {tried} damaged a row of a");
    assert!(cut > 100, "{cut} of {tried}");
}
