//! Retention, and files of earlier versions.

use super::*;

/// The folder to which [`a_file_of_version_1_opens`] writes a new fixture, if set.
const FIXTURE: &str = "JOSTLE_STORE_FIXTURE_TO";

/// Waits until the store has swept what exceeds the quota.
fn wait_until_swept(store: &Store, quota_bytes: u64) {
    wait_until("the swarm is within its quota", || {
        let read = |connection: &Connection| Ok(integrity::read_extent(connection, 1)?);
        store.read("a", read).unwrap().unwrap().bytes <= quota_bytes
    });
}

#[test]
fn beyond_the_quota_checkpoints_thin_out_then_the_oldest_history_goes() {
    let (folder, quota) = (folder(), 400_000);
    let store = open_with(folder.path(), quota);
    durable(&store, vec![create("a")]).unwrap();
    for number in 1..=600 {
        let mut writes = vec![append("a", number)];
        if number % 10 == 0 {
            writes.push(keep("a", number, 10_000));
        }
        store.submit(writes, None);
        let infos = store.checkpoints("a").unwrap();
        let newest = infos[0].number;
        assert!(
            infos.len() < 2 || newest < 20 || infos[1].number + 10 == newest,
            "{infos:?}"
        );
    }
    durable(&store, Vec::new()).unwrap();
    wait_until_swept(&store, quota);
    let infos = store.checkpoints("a").unwrap();
    assert_eq!((infos[0].number, infos[1].number), (600, 590));
    // Thinned: checkpoints reach back further than at their first density, and all rows are there.
    assert!(
        infos.len() < 40 && store.history_from("a").unwrap() == Some(state(0, 0).info()),
        "{infos:?}"
    );
    assert_eq!(numbers(&store, "a").len(), 600);

    for number in 601..=8000 {
        store.submit(vec![append("a", number)], None);
    }
    durable(&store, vec![append("a", 8001), keep("a", 8001, 10_000)]).unwrap();
    // The rows after the second newest checkpoint alone are over the quota, and stay.
    wait_until("the older history is gone", || {
        store.history_from("a").unwrap() == Some(state(600, 0).info())
    });
    assert_eq!(numbers(&store, "a"), (601..=8001).collect::<Vec<_>>());
    for mark in store.checkpoints("a").unwrap() {
        assert_eq!(store.checkpoint("a", mark.number).unwrap().info(), mark);
    }
    assert_eq!(store.health().damaged, 0);
}

#[test]
fn history_from_is_the_oldest_checkpoint_after_every_change() {
    let folder = folder();
    let store = open(folder.path());
    durable(&store, vec![create("a")]).unwrap();
    let begins = || store.history_from("a").unwrap().map(|mark| mark.step);
    let first = state(0, 0);
    assert_eq!(begins(), Some(first.step));
    // One of the same number replaces it.
    let checkpoint = Checkpoint { step: 77, ..first };
    let swarm = || "a".to_owned();
    let keep_again = Write::Keep {
        swarm: swarm(),
        checkpoint,
    };
    durable(&store, vec![keep_again]).unwrap();
    assert_eq!(begins(), Some(77));
    durable(&store, vec![append("a", 1), keep("a", 1, 0)]).unwrap();
    assert_eq!(begins(), Some(77));
    durable(&store, vec![Write::Delete { swarm: swarm() }]).unwrap();
    assert!(store.history_from("a").is_err());
    durable(&store, vec![create("a")]).unwrap();
    assert_eq!(begins(), Some(0));
}

#[test]
fn the_two_newest_checkpoints_and_the_rows_after_them_stay_whatever_the_quota() {
    let folder = folder();
    let store = open_with(folder.path(), 1);
    durable(&store, vec![create("a")]).unwrap();
    for number in 1..=2000 {
        store.submit(vec![append("a", number)], None);
    }
    for number in [500, 1000, 1500] {
        store.submit(vec![keep("a", number, 5000)], None);
    }
    durable(&store, Vec::new()).unwrap();
    wait_until("the rest is gone", || {
        store.history_from("a").unwrap().unwrap().number == 1000
    });
    wait_until("the rows are gone", || {
        count(&store, "SELECT min(number) FROM row") == 1001
    });
    assert_eq!(numbers(&store, "a"), (1001..=2000).collect::<Vec<_>>());
    assert_eq!(store.checkpoints("a").unwrap().len(), 2);
    drop(store);
    assert_eq!(numbers(&open_with(folder.path(), 1), "a").len(), 1000);
}

#[test]
fn a_checkpoint_of_the_same_row_replaces_the_one_before() {
    let folder = folder();
    let store = open(folder.path());
    durable(&store, vec![create("a")]).unwrap();
    let later = Checkpoint {
        step: 777,
        ..state(0, 4000)
    };
    durable(
        &store,
        vec![Write::Keep {
            swarm: "a".to_string(),
            checkpoint: later.clone(),
        }],
    )
    .unwrap();
    assert_eq!(store.checkpoints("a").unwrap(), [later.info()]);
    assert_eq!(store.checkpoint("a", 0).unwrap(), later);
}

#[test]
fn deleted_answers_do_not_count_as_damaged() {
    let folder = folder();
    let store = open(folder.path());
    let forget = |number| {
        let Answer {
            client, request_id, ..
        } = answer(number);
        Write::Forget { client, request_id }
    };
    // The request of 7 has two answers; that of another client stays.
    let mut writes: Vec<Write> = (1..=2500).map(|it| Write::Answer(answer(it))).collect();
    let namesake = Answer {
        client: Some("someone else".to_string()),
        ..answer(7)
    };
    writes.push(Write::Answer(answer(7)));
    writes.push(Write::Answer(namesake.clone()));
    durable(&store, writes).unwrap();
    assert!(!store.has_forgotten());
    // 9999 does not exist.
    durable(&store, vec![forget(9999)]).unwrap();
    assert!(!store.has_forgotten());
    let forgotten = (1..=2500).filter(|it| it % 3 == 1);
    durable(&store, forgotten.map(forget).collect()).unwrap();
    assert!(store.has_forgotten());
    let mut left: Vec<Answer> = (1..=2500).filter(|it| it % 3 != 1).map(answer).collect();
    left.push(namesake);
    assert_eq!(store.answers().unwrap(), left);
    assert_eq!(store.health().damaged, 0);
    // New answers do not fill the gaps, and a missing one is still counted.
    durable(&store, vec![Write::Answer(answer(2501))]).unwrap();
    left.push(answer(2501));
    assert!(store.stop(TIMEOUT));
    let store = open(folder.path());
    assert_eq!(store.answers().unwrap(), left);
    assert_eq!(store.health().damaged, 0);
    assert!(store.stop(TIMEOUT));
    alter(folder.path(), "DELETE FROM answer WHERE id = 2");
    let store = open(folder.path());
    assert_eq!(store.answers().unwrap(), left[1..]);
    assert_eq!(store.health().damaged, 1);
}

#[test]
fn space_of_deleted_swarms_is_reused() {
    let folder = folder();
    let store = open(folder.path());
    let mut sizes = Vec::new();
    for _ in 0..6 {
        durable(
            &store,
            vec![create("a"), append("a", 1), keep("a", 1, 6_000_000)],
        )
        .unwrap();
        durable(&store, vec![delete("a")]).unwrap();
        wait_until("all is swept", || {
            count(&store, "SELECT count(*) FROM gone") == 0
        });
        sizes.push(store.health().bytes_on_disk);
    }
    assert!(sizes[5] <= sizes[1] * 2, "{sizes:?}");
}

/// Writes the fixture: every kind of record.
fn fixture(folder: &Path) {
    let store = open(folder);
    durable(
        &store,
        vec![
            create("a"),
            append("a", 1),
            append("a", 2),
            keep("a", 1, 5000),
        ],
    )
    .unwrap();
    durable(
        &store,
        vec![
            create("b"),
            Write::Answer(answer(1)),
            Write::Answer(answer(2)),
        ],
    )
    .unwrap();
    assert!(store.stop(TIMEOUT));
}

#[test]
fn a_file_of_version_1_opens() {
    if let Ok(folder) = std::env::var(FIXTURE) {
        return fixture(Path::new(&folder));
    }
    let folder = folder();
    fs::write(
        folder.path().join(schema::FILE),
        include_bytes!("../fixtures/v1.sqlite"),
    )
    .unwrap();
    let store = open(folder.path());
    let names: Vec<String> = store
        .swarms()
        .unwrap()
        .into_iter()
        .map(|(name, _)| name)
        .collect();
    assert_eq!(names, ["a", "b"]);
    assert_eq!(store.rows("a", 0, 9).unwrap().rows, [row(1), row(2)]);
    assert_eq!(store.checkpoint("a", 1).unwrap(), state(1, 5000));
    assert_eq!(store.checkpoint("b", 0).unwrap(), state(0, 300));
    assert_eq!(store.answers().unwrap(), [answer(1), answer(2)]);
    durable(&store, vec![append("a", 3)]).unwrap();
}
