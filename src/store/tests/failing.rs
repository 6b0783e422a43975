//! Full disks, failed syncs, killed processes, and files that are rejected.

use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};

use parking_lot::MutexGuard;
use rusqlite::{ErrorCode, ffi};

use super::super::backlog::Backlog;
use super::*;

/// Failpoints are global to the process: one test at a time sets them.
static POINTS: Mutex<()> = parking_lot::const_mutex(());

/// The folder in which [`killed_anywhere_completed_writes_are_durable`] runs its child.
const CHILD: &str = "JOSTLE_STORE_TEST_FOLDER";

/// Makes every commit of the store in `folder` fail until the value is dropped.
struct Failing {
    point: &'static str,
    _alone: MutexGuard<'static, ()>,
}

fn failing(point: &'static str, folder: &Path) -> Failing {
    let _alone = POINTS.lock();
    let name = folder.file_name().unwrap().to_str().unwrap();
    fail::cfg(point, &format!("return({name})")).unwrap();
    Failing { point, _alone }
}

impl Drop for Failing {
    fn drop(&mut self) {
        fail::remove(self.point);
    }
}

#[test]
fn on_a_full_disk_sync_submits_fail_and_deferred_ones_are_written_later() {
    let (folder, store) = stored(vec![create("a"), append("a", 1)]);
    let full = failing("store-full", folder.path());
    for number in 2..=50 {
        store.submit(vec![append("a", number)], None);
    }
    let last = || vec![append("a", 51)];
    assert_eq!(durable(&store, last()), Err(StoreFault::Full));
    // The store retries once a second; replies do not wait for that.
    let began = Instant::now();
    for _ in 0..30 {
        assert_eq!(durable(&store, vec![create("b")]), Err(StoreFault::Full));
    }
    assert!(began.elapsed().as_secs() < 15, "{:?}", began.elapsed());
    let it = store.health();
    assert!(it.is_full && !it.is_overrun && it.waiting == 49, "{it:?}");
    assert_eq!(numbers(&store, "a"), [1]);

    drop(full);
    // The store retries without a submit.
    wait_until("the rows are written", || numbers(&store, "a").len() == 50);
    assert!(!store.health().is_full);
    durable(&store, last()).unwrap();
    durable(&store, vec![create("b")]).unwrap();
    assert_eq!(numbers(&store, "a"), (1..=51).collect::<Vec<_>>());
}

#[test]
fn the_backlog_is_written_before_later_submits() {
    let (folder, store) = stored(vec![create("a")]);
    let full = failing("store-full", folder.path());
    store.submit(vec![append("a", 1)], None);
    // The row is not there yet.
    assert_eq!(durable(&store, Vec::new()), Err(StoreFault::Full));
    drop(full);
    durable(&store, vec![append("a", 2)]).unwrap();
    assert_eq!(numbers(&store, "a"), [1, 2]);
}

/// A writer without a thread.
fn writer(folder: &Path) -> Writer {
    let lock = lock(folder).unwrap();
    let connection = schema::open(&folder.join(FILE), 0).unwrap();
    let shared = Arc::<Shared>::default();
    Writer::new((connection, folder.to_path_buf(), lock), UNLIMITED, shared).unwrap()
}

fn deferred(write: Write) -> Submit {
    Submit {
        writes: vec![write],
        durability: Durability::Deferred(None),
    }
}

fn process(writer: &mut Writer, writes: Vec<Write>) -> Result<(), StoreFault> {
    let (sender, receiver) = channel();
    let durability = Durability::Sync(Box::new(move |outcome| sender.send(outcome).unwrap()));
    let submit = Submit { writes, durability };
    writer.process(vec![submit]).unwrap();
    receiver.try_recv().unwrap()
}

fn limit_pages(writer: &Writer, pages: i64) {
    let pragma = format!("PRAGMA max_page_count = {pages}");
    writer.connection.execute_batch(&pragma).unwrap();
}

#[test]
fn without_a_free_page_nothing_is_lost_and_deletions_succeed() {
    let folder = folder();
    let mut writer = writer(folder.path());
    process(&mut writer, vec![create("a"), create("b")]).unwrap();
    limit_pages(&writer, 1);
    let mut kept = 0;
    for number in 1..=200 {
        let lazy = deferred(append("a", number));
        writer.process(vec![lazy]).unwrap();
        kept = writer.backlog.writes();
    }
    assert!(kept > 50, "the file was not full: {kept}");
    let of_b = vec![append("b", 1), save_checkpoint("b", 1, 9000)];
    assert_eq!(process(&mut writer, of_b), Err(StoreFault::Full));
    assert!(writer.connection.is_autocommit(), "rolled back");
    process(&mut writer, vec![delete("b"), Write::InsertReply(reply(1))]).unwrap();
    assert_eq!(writer.backlog.writes(), kept);
    // The backlog of the deleted swarm is dropped.
    let lazy = deferred(save_checkpoint("a", 200, 9000));
    writer.process(vec![lazy]).unwrap();
    assert_eq!(writer.backlog.writes(), kept + 1);

    limit_pages(&writer, 1_000_000);
    process(&mut writer, vec![append("a", 201)]).unwrap();
    assert!(writer.backlog.is_empty());
    drop(writer);
    let store = open(folder.path());
    assert_eq!(numbers(&store, "a"), (1..=201).collect::<Vec<_>>());
    assert_eq!(store.checkpoint("a", 200).unwrap(), state(200, 9000));
    assert_eq!(store.swarms().unwrap().len(), 1);
    assert_eq!(store.replies().unwrap(), [reply(1)]);
}

#[test]
fn deleting_a_swarm_on_a_full_disk_drops_its_backlog() {
    let folder = folder();
    let mut writer = writer(folder.path());
    process(&mut writer, vec![create("a"), create("b")]).unwrap();
    limit_pages(&writer, 1);
    for number in 1..=3 {
        for swarm in ["a", "b"] {
            let lazy = deferred(append_large(swarm, number, 9000));
            writer.process(vec![lazy]).unwrap();
        }
    }
    let kept = writer.backlog.writes();
    process(&mut writer, vec![delete("a")]).unwrap();
    assert!(writer.backlog.writes() < kept);
    limit_pages(&writer, 1_000_000);
    let later = vec![create("a"), append("a", 1), append("b", 4)];
    process(&mut writer, later).unwrap();
    drop(writer);
    let store = open(folder.path());
    assert_eq!(numbers(&store, "a"), [1]);
    assert_eq!(numbers(&store, "b"), [1, 2, 3, 4]);
}

#[test]
fn beyond_its_limits_the_backlog_drops_checkpoints_then_replies_and_never_rows() {
    let mut backlog = Backlog::new((4, usize::MAX));
    for (write, writes, is_overrun) in [
        (append("a", 1), 1, false),
        (save_checkpoint("a", 1, 10), 2, false),
        (Write::InsertReply(reply(1)), 3, false),
        (append("a", 2), 4, false),
        // The checkpoint is dropped, then the reply.
        (append("a", 3), 4, false),
        (append("a", 4), 4, false),
        (append("a", 5), 5, true),
    ] {
        backlog.push(deferred(write));
        let found = (backlog.writes(), backlog.is_overrun());
        assert_eq!(found, (writes, is_overrun));
    }
    let front = backlog.front().iter();
    let front: Vec<Write> = front.flat_map(|submit| submit.writes.clone()).collect();
    assert_eq!(front, appends("a", 1..=5));
    backlog.pop(5);
    assert!(backlog.is_empty() && !backlog.is_overrun());
}

#[test]
fn a_submit_without_writes_is_never_dropped() {
    let completed = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&completed);
    let mut backlog = Backlog::new((2, usize::MAX));
    let count = move |_: Result<(), StoreFault>| {
        counted.fetch_add(1, Ordering::Relaxed);
    };
    let waits = Submit {
        writes: Vec::new(),
        durability: Durability::Deferred(Some(Box::new(count))),
    };
    let saves = |number| deferred(save_checkpoint("a", number, 10));
    for submit in [saves(1), waits, saves(2)] {
        backlog.push(submit);
    }
    backlog.remove_swarm("a");
    let left = backlog.pop(1);
    assert!(backlog.is_empty());
    for submit in left {
        if let Durability::Deferred(Some(synced)) = submit.durability {
            synced.committed(Ok(()));
        }
    }
    assert_eq!(completed.load(Ordering::Relaxed), 1);
}

#[test]
fn after_a_failed_sync_every_submit_fails() {
    let folder = folder();
    let calls = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&calls);
    let on_fatal = Box::new(move |fault: &StoreFault| {
        assert!(matches!(fault, StoreFault::Fatal(_)));
        counted.fetch_add(1, Ordering::SeqCst);
    });
    let store = Store::open(folder.path(), UNLIMITED, on_fatal).unwrap();
    durable(&store, vec![create("a"), append("a", 1)]).unwrap();
    let failing = failing("store-fsync", folder.path());
    let is_fatal = |outcome| matches!(outcome, Err(StoreFault::Fatal(_)));
    let waiting = (2..=5).map(|number| pending(&store, vec![append("a", number)]));
    for outcome in waiting.collect::<Vec<_>>() {
        assert!(is_fatal(outcome.recv_timeout(TIMEOUT).unwrap()));
    }
    drop(failing);
    assert!(is_fatal(durable(&store, vec![append("a", 2)])));
    assert!(!store.stop(TIMEOUT));
    assert_eq!(calls.load(Ordering::SeqCst), 1);
    assert_eq!(numbers(&open(folder.path()), "a"), [1]);
}

#[test]
fn errors_of_sqlite_become_faults() {
    let sorted = |extended_code| {
        let error = rusqlite::Error::SqliteFailure(ffi::Error::new(extended_code), None);
        StoreFault::of_writing(Path::new("/"), &error)
    };
    assert_eq!(sorted(ffi::SQLITE_FULL), StoreFault::Full);
    for fatal in [
        ffi::SQLITE_IOERR_FSYNC,
        ffi::SQLITE_IOERR_DIR_FSYNC,
        ffi::SQLITE_CORRUPT,
        ffi::SQLITE_NOTADB,
    ] {
        assert!(matches!(sorted(fatal), StoreFault::Fatal(_)), "{fatal}");
    }
    for passing in [
        ffi::SQLITE_IOERR_WRITE,
        ffi::SQLITE_IOERR_SHMSIZE,
        ffi::SQLITE_BUSY,
        ffi::SQLITE_CANTOPEN,
    ] {
        assert!(matches!(sorted(passing), StoreFault::Io(_)), "{passing}");
    }
    assert_eq!(
        ffi::Error::new(ffi::SQLITE_IOERR_FSYNC).code,
        ErrorCode::SystemIoFailure
    );
}

#[test]
fn killed_anywhere_completed_writes_are_durable() {
    if let Ok(folder) = std::env::var(CHILD) {
        return be_killed(Path::new(&folder));
    }
    let (_, module) = module_path!().split_once("::").unwrap();
    let test = format!("{module}::killed_anywhere_completed_writes_are_durable");
    for (point, completed, is_there) in [
        ("store-begin", "1 ", false),
        ("store-written", "1 ", false),
        ("store-synced", "1 ", true),
        ("store-done", "1 2 ", true),
    ] {
        let folder = folder();
        let status = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", &test])
            .env(CHILD, folder.path())
            .env("JOSTLE_STORE_TEST_POINT", point)
            .output()
            .unwrap()
            .status;
        assert!(!status.success(), "it was not killed at {point}");
        let found = fs::read_to_string(folder.path().join("completed")).unwrap();
        assert_eq!(found, completed, "{point}");
        let expected = &[1, 2][..1 + usize::from(is_there)];
        assert_eq!(numbers(&open(folder.path()), "a"), expected, "{point}");
    }
}

/// Writes one row; is killed while it writes the second.
fn be_killed(folder: &Path) {
    let store = open(folder);
    arm_at_second_write(std::env::var("JOSTLE_STORE_TEST_POINT").unwrap());
    let mut completed = File::create(folder.join("completed")).unwrap();
    for number in 1..=2 {
        let mut writes = vec![append("a", number)];
        if number == 1 {
            writes.insert(0, create("a"));
        }
        let (sender, receiver) = channel();
        let mut completed = completed.try_clone().unwrap();
        submit_sync(&store, writes, move |outcome| {
            outcome.unwrap();
            io::Write::write_all(&mut completed, format!("{number} ").as_bytes()).unwrap();
            let _ = sender.send(());
        });
        let _ = receiver.recv_timeout(TIMEOUT);
    }
    io::Write::flush(&mut completed).unwrap();
    thread::sleep(TIMEOUT);
}

/// Arms `point` when the second write begins, on the writer thread, so that the first write and the
/// maintenance after it pass.
fn arm_at_second_write(point: String) {
    if point == "store-begin" {
        return fail::cfg(point, "1*off->return").unwrap();
    }
    let begun = AtomicUsize::new(0);
    fail::cfg_callback("store-begin", move || {
        if begun.fetch_add(1, Ordering::SeqCst) == 1 {
            fail::cfg(point.as_str(), "return").unwrap();
        }
    })
    .unwrap();
}

fn rejection(folder: &Path) -> StoreError {
    let opened = Store::open(folder, UNLIMITED, Box::new(|_| {}));
    opened.err().expect("it was opened")
}

#[test]
fn a_folder_is_open_once_at_a_time_and_accessible_to_its_owner_only() {
    use std::os::unix::fs::PermissionsExt;
    let folder = folder();
    let inner = folder.path().join("data/of one");
    let store = open(&inner);
    let mode = fs::metadata(&inner).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o700);
    let error = rejection(&inner);
    assert!(matches!(error, StoreError::InUse(_)));
    let expected = "another jostled uses this folder: stop it, or name another --data-dir";
    assert!(error.to_string().contains(expected), "{error}");
    assert!(store.stop(TIMEOUT));
    drop(open(&inner));
}

#[test]
fn foreign_and_newer_files_are_rejected() {
    let folder = folder();
    drop(open(folder.path()));
    for (newer, expected) in [
        (
            "UPDATE program SET version = '9.0.0', model = 900",
            "9.0.0 (model version 900, this one knows",
        ),
        (
            "PRAGMA user_version = 900",
            "9.0.0 (schema 900, this one knows",
        ),
        (
            "DROP TABLE program",
            "newer jostled (schema 900, this one knows",
        ),
    ] {
        alter(folder.path(), newer);
        let error = rejection(folder.path());
        assert!(matches!(error, StoreError::Newer { .. }));
        assert!(error.to_string().contains(expected), "{error}");
        let remedy = "): upgrade, or name another --data-dir";
        assert!(error.to_string().ends_with(remedy), "{error}");
    }

    let foreign = self::folder();
    alter(foreign.path(), "CREATE TABLE other (x)");
    let is_foreign = || matches!(rejection(foreign.path()), StoreError::Foreign(_));
    assert!(is_foreign());
    let text = "no database at all, but long enough to be looked at".repeat(100);
    fs::write(foreign.path().join(FILE), text).unwrap();
    assert!(is_foreign());

    let blocked = foreign.path().join("data");
    fs::write(&blocked, "").unwrap();
    assert!(matches!(rejection(&blocked), StoreError::Folder { .. }));
}
