//! The audit log, and the quota of notes.

use super::*;

/// A line of a user.
pub(super) fn line(number: u64, user: &str) -> AuditLine {
    AuditLine {
        number,
        user: user.to_owned(),
        client: number.is_multiple_of(2).then(|| "notebook".to_owned()),
        verb: ["inform", "delete", "create"][number as usize % 3].to_owned(),
        name: Some(format!("swarm-{}", number % 4)),
        first_ms: 1000 * number,
        last_ms: 1000 * number + 10,
        body: format!("body {number}").into_bytes(),
    }
}

fn open_audit(folder: &Path, audit_bytes: u64, audit_ms: u64) -> Store {
    let settings = Settings {
        audit_bytes,
        audit_ms,
        ..UNLIMITED
    };
    Store::open(folder, settings, Box::new(|_| {})).unwrap()
}

fn all() -> AuditFilter {
    AuditFilter {
        limit: usize::MAX,
        ..AuditFilter::default()
    }
}

/// The numbers of the lines that a filter selects.
fn lines(store: &Store, filter: &AuditFilter) -> Vec<u64> {
    let page = store.audit(filter).unwrap();
    assert_eq!(page.damaged, 0);
    page.lines.iter().map(|line| line.number).collect()
}

fn write(store: &Store, lines: impl IntoIterator<Item = AuditLine>) {
    let writes = lines.into_iter().map(Write::Audit).collect();
    durable(store, writes).unwrap();
}

#[test]
fn lines_are_read_as_they_were_written_and_by_each_filter() {
    let folder = folder();
    let store = open(folder.path());
    assert_eq!(store.audit(&all()).unwrap(), AuditPage::default());
    write(
        &store,
        (1..=20).map(|k| line(k, ["ada", "ben"][k as usize / 11])),
    );
    assert!(store.stop(TIMEOUT));
    let store = open(folder.path());
    let page = store.audit(&all()).unwrap();
    let expected: Vec<_> = (1..=20)
        .map(|k| line(k, ["ada", "ben"][k as usize / 11]))
        .collect();
    assert_eq!(page.lines, expected);
    assert_eq!((page.oldest, page.newest), (Some(1), 20));
    assert_eq!(store.newest_audit_line().unwrap(), 20);
    let of = |filter: AuditFilter| lines(&store, &filter);
    assert_eq!(
        of(AuditFilter {
            user: Some("ben".into()),
            ..all()
        }),
        (11..=20).collect::<Vec<_>>()
    );
    assert_eq!(
        of(AuditFilter {
            client: Some("notebook".into()),
            limit: 3,
            ..all()
        }),
        [2, 4, 6]
    );
    assert_eq!(
        of(AuditFilter {
            verb: Some("create".into()),
            after: 10,
            ..all()
        }),
        [11, 14, 17, 20]
    );
    assert_eq!(
        of(AuditFilter {
            name: Some("swarm-0".into()),
            ..all()
        }),
        [4, 8, 12, 16, 20]
    );
    assert_eq!(
        of(AuditFilter {
            from_ms: Some(18_010),
            ..all()
        }),
        [18, 19, 20]
    );
    assert_eq!(
        of(AuditFilter {
            from_ms: Some(18_011),
            ..all()
        }),
        [19, 20]
    );
    assert_eq!(
        of(AuditFilter {
            to_ms: Some(2000),
            ..all()
        }),
        [1, 2]
    );
    assert_eq!(
        of(AuditFilter {
            before: Some(9),
            limit: 2,
            ..all()
        }),
        [7, 8]
    );
    assert_eq!(
        of(AuditFilter {
            before: Some(u64::MAX),
            limit: 3,
            ..all()
        }),
        [18, 19, 20]
    );
    // A name is a value and no SQL.
    assert_eq!(
        of(AuditFilter {
            user: Some("' OR 1=1 --".into()),
            ..all()
        }),
        [0; 0]
    );
}

#[test]
fn a_line_is_replaced_by_its_number_and_not_once_it_is_deleted() {
    let folder = folder();
    let store = open_audit(folder.path(), u64::MAX, 5000);
    write(&store, [line(1, "ada")]);
    let more = AuditLine {
        last_ms: 1900,
        body: b"more".to_vec(),
        ..line(1, "ada")
    };
    write(&store, [more.clone()]);
    assert_eq!(store.audit(&all()).unwrap().lines[0], more);
    let size = store.audit_size().unwrap();
    assert_eq!(size.lines, 1);
    // It is more than five seconds younger.
    write(&store, [line(11, "ada")]);
    assert_eq!(lines(&store, &all()), [11]);
    write(&store, [more]);
    assert_eq!(lines(&store, &all()), [11]);
    assert_eq!(store.audit_size().unwrap(), size);
}

#[test]
fn the_user_with_most_loses_the_oldest_lines_and_nobody_else() {
    let folder = folder();
    // Some thirty lines.
    let max = 30 * 290;
    let store = open_audit(folder.path(), max, u64::MAX);
    write(&store, (1..=5).map(|k| line(k, "olga")));
    write(&store, (6..=400).map(|k| line(k, "mallory")));
    let olga = AuditFilter {
        user: Some("olga".into()),
        ..all()
    };
    assert_eq!(lines(&store, &olga), [1, 2, 3, 4, 5]);
    let kept = lines(&store, &all());
    assert!(
        kept.len() > 25 && kept[5..] == *(406 - kept.len() as u64..=400).collect::<Vec<_>>(),
        "{kept:?}"
    );
    let size = store.audit_size().unwrap();
    assert_eq!(size.lines, kept.len() as u64);
    assert!(size.bytes <= max && size.bytes > max - 600, "{size:?}");
    // Once olga has most, hers go.
    write(&store, (401..=440).map(|k| line(k, "olga")));
    let [of_olga, of_mallory] = ["olga", "mallory"].map(|user| {
        let filter = AuditFilter {
            user: Some(user.into()),
            ..all()
        };
        lines(&store, &filter).len()
    });
    assert!(of_olga.abs_diff(of_mallory) <= 1, "{of_olga} {of_mallory}");
}

#[test]
fn a_damaged_line_is_counted_and_not_returned() {
    for change in [
        "UPDATE audit SET user = 'mallory' WHERE number = 2",
        "UPDATE audit SET name = NULL WHERE number = 2",
        "UPDATE audit SET verb = 'createx' WHERE number = 2",
        "UPDATE audit SET client = NULL WHERE number = 2",
        "UPDATE audit SET first_ms = 1 WHERE number = 2",
        "UPDATE audit SET last_ms = 1 WHERE number = 2",
        "UPDATE audit SET body = x'00' WHERE number = 2",
        "UPDATE audit SET number = 4 WHERE number = 2",
    ] {
        let folder = folder();
        let store = open(folder.path());
        write(&store, (1..=3).map(|k| line(k, "ada")));
        let store = altered(&store, &folder, change);
        let page = store.audit(&all()).unwrap();
        let kept: Vec<u64> = page.lines.iter().map(|line| line.number).collect();
        assert_eq!((kept, page.damaged), (vec![1, 3], 1), "{change}");
        // It goes on after the newest one.
        write(&store, [line(9, "ada")]);
        assert_eq!(store.newest_audit_line().unwrap(), 9);
    }
}

#[test]
fn a_missing_line_is_counted() {
    let folder = folder();
    let store = open(folder.path());
    write(&store, (1..=3).map(|k| line(k, "ada")));
    let store = altered(&store, &folder, "DELETE FROM audit WHERE number = 2");
    assert_eq!(store.audit(&all()).unwrap().damaged, 1);
}

#[test]
fn the_size_is_counted_anew_if_lines_are_missing() {
    let folder = folder();
    let store = open(folder.path());
    write(&store, (1..=30).map(|k| line(k, "ada")));
    assert!(store.stop(TIMEOUT));
    alter(folder.path(), "DELETE FROM audit");
    let store = open_audit(folder.path(), 3000, u64::MAX);
    write(&store, [line(31, "ada")]);
    assert_eq!(lines(&store, &all()), [31]);
    assert_eq!(store.audit_size().unwrap().lines, 1);
}

/// A note with a body of so many bytes.
fn note(number: u64, bytes: usize) -> Write {
    let body = vec![7; bytes];
    Write::Append {
        swarm: "a".to_owned(),
        row: Row {
            kind: NOTE,
            body,
            ..row(number)
        },
    }
}

#[test]
fn notes_evict_nothing_and_go_with_their_part_of_the_history() {
    let quota = 200_000;
    let folder = folder();
    let store = open_with(folder.path(), quota);
    durable(&store, vec![create("a")]).unwrap();
    let bytes = |store: &Store| {
        let read = |connection: &Connection| Ok(integrity::read_extent(connection, 1)?);
        store.read(read).unwrap().unwrap().bytes
    };
    // Checkpoints and rows just within the quota.
    for k in 1..=19 {
        durable(
            &store,
            vec![append_large("a", k, 5000), save_checkpoint("a", k, 5000)],
        )
        .unwrap();
    }
    let before = (bytes(&store), checkpoints(&store, "a"));
    assert!(
        before.0 <= quota && before.0 > quota - 10_000,
        "{}",
        before.0
    );
    // Notes of a quarter of the quota, each with its outcome.
    for k in 10..60 {
        let outcome = append_large("a", 2 * k + 1, 50);
        durable(&store, vec![note(2 * k, 1000), outcome]).unwrap();
    }
    // The sweep comes after the commits.
    thread::sleep(Duration::from_millis(300));
    assert!(bytes(&store) > quota + 50_000);
    assert_eq!(checkpoints(&store, "a"), before.1);
    assert_eq!(store.notes("a").unwrap().len(), 50);
    let counted = store.read(|it| Ok(notes::bytes(it, 1)?)).unwrap();
    assert_eq!(counted, 50 * note_bytes(1000));
    // Anything else over the quota evicts as before, and notes with the rows around them.
    for k in 120..170 {
        durable(
            &store,
            vec![append_large("a", k, 5000), save_checkpoint("a", k, 5000)],
        )
        .unwrap();
    }
    wait_until("the oldest history with all notes is gone", || {
        store.notes("a").unwrap().is_empty()
    });
    wait_until("the swarm is within its quota", || bytes(&store) <= quota);
}

#[test]
fn the_notes_are_found_after_a_repair() {
    let folder = folder();
    let store = open(folder.path());
    durable(
        &store,
        vec![create("a"), note(1, 100), append("a", 2), note(3, 100)],
    )
    .unwrap();
    // An index that does not fit its tree.
    let store = altered(
        &store,
        &folder,
        "PRAGMA writable_schema = ON;
         UPDATE sqlite_schema SET sql = replace(sql, 'kind = 6', 'kind = 2') WHERE name = 'note'",
    );
    assert_eq!(numbers(&store, "a"), [1, 2, 3]);
    let index = "SELECT count(*) FROM sqlite_schema WHERE name = 'note' AND sql LIKE '%kind = 6%'";
    assert_eq!(count(&store, index), 1);
    assert_eq!(store.notes("a").unwrap().len(), 2);
}
