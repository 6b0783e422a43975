//! Submits are durable and in order.

use super::*;

#[test]
fn done_is_called_after_the_data_is_durable() {
    let mut writes = vec![create("a"), append("a", 1), append("a", 2)];
    writes.push(save_checkpoint("a", 2, 5000));
    let (folder, store) = stored(writes);
    // The files as a crash would leave them: the WAL was never checkpointed.
    let crashed = self::folder();
    for name in [FILE, WAL] {
        fs::copy(folder.path().join(name), crashed.path().join(name)).unwrap();
    }
    for store in [store, open(crashed.path())] {
        let swarm = ("a".to_string(), b"about a".to_vec());
        assert_eq!(store.swarms().unwrap(), [swarm]);
        assert_eq!(store.rows("a", 0, 9).unwrap().rows, [row(1), row(2)]);
        assert_eq!(store.rows("a", 1, 9).unwrap().rows, [row(2)]);
        let kept = [2, 0].map(|number| state(number, 0).info());
        assert_eq!(store.checkpoints("a").unwrap(), kept);
        assert_eq!(store.checkpoint("a", 2).unwrap(), state(2, 5000));
        assert!(matches!(
            store.checkpoint("a", 1),
            Err(StoreError::NoCheckpoint { number: 1, .. })
        ));
    }
}

#[test]
fn groups_are_committed_and_completed_in_the_order_of_submission() {
    let (_folder, store) = stored(vec![create("a")]);
    let completed = Arc::new(Mutex::new(Vec::new()));
    for number in 1..=3000 {
        let completed = Arc::clone(&completed);
        let done = move |outcome: Result<(), StoreFault>| {
            outcome.unwrap();
            completed.lock().push(number);
        };
        // Every third is deferred, and is committed in the same order.
        match number % 3 {
            0 => store.submit(vec![append("a", number)], None),
            _ => submit_sync(&store, vec![append("a", number)], done),
        }
    }
    durable(&store, Vec::new()).unwrap();
    let expected: Vec<u64> = (1..=3000).filter(|number| number % 3 > 0).collect();
    assert_eq!(*completed.lock(), expected);
    assert_eq!(numbers(&store, "a"), (1..=3000).collect::<Vec<_>>());
    let commits = store.health().commits;
    assert!(commits < 1500, "no commit was shared: {commits}");
}

#[test]
fn deferred_writes_are_written_soon() {
    let (_folder, store) = stored(vec![create("a")]);
    store.submit(vec![append("a", 1)], None);
    wait_until("the row is there", || numbers(&store, "a") == [1]);
}

#[test]
fn all_writes_of_a_submit_are_written_or_none() {
    let (_folder, store) = stored(vec![create("a")]);
    for (write, problem) in [
        (append("a", 3), "a gap"),
        (append("b", 1), "no such swarm"),
        (create("a"), "it exists"),
        (
            save_checkpoint("a", 2, 9),
            "a checkpoint of what is not there",
        ),
        (delete("b"), "no such swarm to delete"),
    ] {
        assert!(
            is_rejected(&store, vec![append("a", 1), write]),
            "{problem}"
        );
    }
    assert_eq!(numbers(&store, "a"), [0; 0]);
    durable(&store, vec![append("a", 1)]).unwrap();
    assert_eq!(numbers(&store, "a"), [1]);
}

#[test]
fn a_deleted_swarm_leaves_nothing_to_the_next_of_its_name() {
    let (folder, store) = stored(vec![create("a")]);
    durable(&store, appends("a", 1..=2500)).unwrap();
    durable(&store, vec![save_checkpoint("a", 2500, 100_000)]).unwrap();
    let again = vec![delete("a"), create("a"), append("a", 1)];
    durable(&store, again).unwrap();
    assert_eq!(numbers(&store, "a"), [1]);
    assert_eq!(store.checkpoints("a").unwrap(), [state(0, 0).info()]);
    wait_until("its rows are gone from the file", || {
        let tables = ["row", "checkpoint", "gone"];
        let counts = tables.map(|table| count(&store, &format!("SELECT count(*) FROM {table}")));
        counts.iter().sum::<i64>() == 2
    });
    drop(store);
    assert_eq!(numbers(&open(folder.path()), "a"), [1]);
}

#[test]
fn any_text_is_a_name() {
    let folder = folder();
    let store = open(folder.path());
    let drop_table = "'; DROP TABLE row; --";
    // Sorted.
    let given = ["", "%_", drop_table, "a\0b", "ä/../*", "\u{202e}"];
    for name in given.into_iter().rev() {
        let writes = vec![create(name), append(name, 1), save_checkpoint(name, 1, 10)];
        durable(&store, writes).unwrap();
    }
    drop(store);
    let store = open(folder.path());
    assert_eq!(names(&store), given);
    for name in given {
        assert_eq!(numbers(&store, name), [1]);
    }
    let read = store.rows("a", 0, 1);
    assert!(matches!(read, Err(StoreError::NoSwarm(_))));
}

#[test]
fn replies_are_read_as_they_were_written() {
    let replies: Vec<StoredReply> = (1..=2500).map(reply).collect();
    let (folder, store) = stored(replies.iter().cloned().map(Write::InsertReply).collect());
    assert_eq!(store.replies().unwrap(), replies);
    drop(store);
    assert_eq!(open(folder.path()).replies().unwrap(), replies);
}

#[test]
fn after_stop_everything_is_in_the_file_and_submits_fail() {
    let folder = folder();
    let store = open(folder.path());
    let mut writes = appends("a", 1..=499);
    writes.insert(0, create("a"));
    store.submit(writes, None);
    assert!(store.stop(TIMEOUT));
    let later = durable(&store, vec![append("a", 500)]);
    assert_eq!(later, Err(StoreFault::Stopped));
    assert!(matches!(store.swarms(), Err(StoreError::Stopped)));
    assert!(!folder.path().join(WAL).exists());
    assert_eq!(numbers(&open(folder.path()), "a").len(), 499);
}

#[test]
fn a_callback_may_submit_and_may_own_the_last_clone() {
    let (folder, store) = stored(vec![create("a")]);
    let (sender, receiver) = channel();
    let clone = store.clone();
    submit_sync(&store, vec![append("a", 1)], move |_| {
        submit_sync(&clone, vec![append("a", 2)], move |outcome| {
            sender.send(outcome).unwrap();
        });
    });
    drop(store);
    receiver.recv_timeout(TIMEOUT).unwrap().unwrap();
    wait_until("the lock is free", || {
        Store::open(folder.path(), UNLIMITED, Box::new(|_| {})).is_ok()
    });
}

#[test]
fn durable_submits_a_second() {
    for (threads, each) in [(1_u32, 400_u32), (32, 100)] {
        let folder = folder();
        let store = open(folder.path());
        let began = Instant::now();
        thread::scope(|scope| {
            for thread in 0..threads {
                let store = &store;
                scope.spawn(move || {
                    let swarm = format!("swarm {thread}");
                    durable(store, vec![create(&swarm)]).unwrap();
                    for number in 1..u64::from(each) {
                        let reply = Write::InsertReply(reply(number));
                        durable(store, vec![append(&swarm, number), reply]).unwrap();
                    }
                });
            }
        });
        let rate = f64::from(threads * each) / began.elapsed().as_secs_f64();
        let commits = store.health().commits;
        println!("{threads} threads: {rate:.0} durable submits a second, in {commits} commits");
    }
}
