//! Retention, and files of earlier versions.

use super::*;

/// The folder to which [`a_file_of_version_1_opens`] writes a new fixture, if set.
const FIXTURE: &str = "JOSTLE_STORE_FIXTURE_TO";

/// Waits until the store has swept what exceeds the quota.
fn wait_until_swept(store: &Store, quota_bytes: u64) {
    wait_until("the swarm is within its quota", || {
        let read = |connection: &Connection| Ok(integrity::read_extent(connection, 1)?);
        store.read(read).unwrap().unwrap().bytes <= quota_bytes
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
            writes.push(save_checkpoint("a", number, 10_000));
        }
        store.submit(writes, None);
        let kept = checkpoints(&store, "a");
        let is_dense = kept.len() < 2 || kept[0] < 20 || kept[1] + 10 == kept[0];
        assert!(is_dense, "{kept:?}");
    }
    durable(&store, Vec::new()).unwrap();
    wait_until_swept(&store, quota);
    let kept = checkpoints(&store, "a");
    assert_eq!(kept[..2], [600, 590]);
    // Thinned: checkpoints reach back further than at their first density, and all rows are there.
    assert!(kept.len() < 40, "{kept:?}");
    assert_eq!(store.history_from("a").unwrap(), Some(state(0, 0).info()));
    assert_eq!(numbers(&store, "a").len(), 600);

    for number in 601..=8000 {
        store.submit(vec![append("a", number)], None);
    }
    durable(
        &store,
        vec![append("a", 8001), save_checkpoint("a", 8001, 10_000)],
    )
    .unwrap();
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
    let (_folder, store) = stored(vec![create("a")]);
    let begins = || store.history_from("a").unwrap().map(|mark| mark.step);
    let first = state(0, 0);
    assert_eq!(begins(), Some(first.step));
    // One of the same number replaces it.
    let checkpoint = Checkpoint { step: 77, ..first };
    let save_again = Write::SaveCheckpoint {
        swarm: "a".to_owned(),
        checkpoint,
    };
    durable(&store, vec![save_again]).unwrap();
    assert_eq!(begins(), Some(77));
    durable(&store, vec![append("a", 1), save_checkpoint("a", 1, 0)]).unwrap();
    assert_eq!(begins(), Some(77));
    durable(&store, vec![delete("a")]).unwrap();
    assert!(store.history_from("a").is_err());
    durable(&store, vec![create("a")]).unwrap();
    assert_eq!(begins(), Some(0));
}

#[test]
fn no_swarm_gets_the_number_of_an_earlier_one() {
    let folder = folder();
    let store = open(folder.path());
    let swept = || {
        wait_until("all is swept", || {
            count(&store, "SELECT count(*) FROM gone WHERE swarm > 0") == 0
        });
    };
    durable(&store, vec![create("a"), create("b"), create("c")]).unwrap();
    let ids = ["a", "b", "c"].map(|name| store.swarm_id(name).unwrap());
    assert_eq!(ids, [1, 2, 3]);
    assert!(store.swarm_id("d").is_err());
    // In any order, and at once.
    for deleted in [vec!["c"], vec!["b"], vec!["a"]] {
        durable(&store, deleted.into_iter().map(delete).collect()).unwrap();
        swept();
    }
    durable(&store, vec![create("a"), create("b")]).unwrap();
    assert_eq!(["a", "b"].map(|name| store.swarm_id(name).unwrap()), [4, 5]);
    durable(
        &store,
        vec![delete("a"), delete("b"), create("a"), delete("a")],
    )
    .unwrap();
    swept();
    drop(store);
    let store = open(folder.path());
    durable(&store, vec![create("a")]).unwrap();
    assert_eq!(store.swarm_id("a").unwrap(), 7);
    assert!(count(&store, "SELECT count(*) FROM gone") <= 1);
}

#[test]
fn the_two_newest_checkpoints_and_the_rows_after_them_stay_whatever_the_quota() {
    let folder = folder();
    let store = open_with(folder.path(), 1);
    durable(&store, vec![create("a")]).unwrap();
    let mut writes = appends("a", 1..=2000);
    writes.extend([500, 1000, 1500].map(|number| save_checkpoint("a", number, 5000)));
    for write in writes {
        store.submit(vec![write], None);
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
    let (_folder, store) = stored(vec![create("a")]);
    let later = Checkpoint {
        step: 777,
        ..state(0, 4000)
    };
    let save_later = Write::SaveCheckpoint {
        swarm: "a".to_string(),
        checkpoint: later.clone(),
    };
    durable(&store, vec![save_later]).unwrap();
    assert_eq!(store.checkpoints("a").unwrap(), [later.info()]);
    assert_eq!(store.checkpoint("a", 0).unwrap(), later);
}

#[test]
fn deleted_replies_do_not_count_as_damaged() {
    let delete_reply = |number| {
        let StoredReply {
            client, request_id, ..
        } = reply(number);
        Write::DeleteReply { client, request_id }
    };
    // The request of 7 has two replies; that of another client stays.
    let mut writes: Vec<Write> = (1..=2500).map(|it| Write::InsertReply(reply(it))).collect();
    let namesake = StoredReply {
        client: Some("someone else".to_string()),
        ..reply(7)
    };
    writes.push(Write::InsertReply(reply(7)));
    writes.push(Write::InsertReply(namesake.clone()));
    let (folder, store) = stored(writes);
    assert!(!store.has_evicted());
    // 9999 does not exist.
    durable(&store, vec![delete_reply(9999)]).unwrap();
    assert!(!store.has_evicted());
    let deleted = (1..=2500).filter(|it| it % 3 == 1);
    durable(&store, deleted.map(delete_reply).collect()).unwrap();
    assert!(store.has_evicted());
    let mut left: Vec<StoredReply> = (1..=2500).filter(|it| it % 3 != 1).map(reply).collect();
    left.push(namesake);
    assert_eq!(store.replies().unwrap(), left);
    assert_eq!(store.health().damaged, 0);
    // New replies do not fill the gaps, and a missing one is still counted.
    durable(&store, vec![Write::InsertReply(reply(2501))]).unwrap();
    left.push(reply(2501));
    assert!(store.stop(TIMEOUT));
    let store = open(folder.path());
    assert_eq!(store.replies().unwrap(), left);
    assert_eq!(store.health().damaged, 0);
    let store = altered(&store, &folder, "DELETE FROM answer WHERE id = 2");
    assert_eq!(store.replies().unwrap(), left[1..]);
    assert_eq!(store.health().damaged, 1);
}

#[test]
fn space_of_deleted_swarms_is_reused() {
    let folder = folder();
    let store = open(folder.path());
    let mut sizes = Vec::new();
    for _ in 0..6 {
        let large = vec![
            create("a"),
            append("a", 1),
            save_checkpoint("a", 1, 6_000_000),
        ];
        durable(&store, large).unwrap();
        durable(&store, vec![delete("a")]).unwrap();
        wait_until("all is swept", || {
            count(&store, "SELECT count(*) FROM gone WHERE swarm > 0") == 0
        });
        sizes.push(store.health().bytes_on_disk);
    }
    assert!(sizes[5] <= sizes[1] * 2, "{sizes:?}");
}

/// Writes the fixture: every kind of record.
fn fixture(folder: &Path) {
    let store = open(folder);
    let mut of_a = vec![create("a"), append("a", 1), append("a", 2)];
    of_a.push(save_checkpoint("a", 1, 5000));
    durable(&store, of_a).unwrap();
    let replies = [1, 2].map(|number| Write::InsertReply(reply(number)));
    let rest = [create("b")].into_iter().chain(replies);
    durable(&store, rest.collect()).unwrap();
    assert!(store.stop(TIMEOUT));
}

#[test]
fn a_file_of_version_1_opens() {
    if let Ok(folder) = std::env::var(FIXTURE) {
        return fixture(Path::new(&folder));
    }
    let folder = folder();
    let file = folder.path().join(FILE);
    fs::write(file, include_bytes!("../fixtures/v1.sqlite")).unwrap();
    let store = open(folder.path());
    assert_eq!(names(&store), ["a", "b"]);
    assert_eq!(store.rows("a", 0, 9).unwrap().rows, [row(1), row(2)]);
    assert_eq!(store.checkpoint("a", 1).unwrap(), state(1, 5000));
    assert_eq!(store.checkpoint("b", 0).unwrap(), state(0, 300));
    assert_eq!(store.replies().unwrap(), [reply(1), reply(2)]);
    durable(&store, vec![append("a", 3)]).unwrap();
}
