//! The daemon's durable memory: swarms with their rows and checkpoints, and answers to requests.
//!
//! It knows bytes. What they mean is for those who submit them; that they are there after the
//! submit is done, that they come back as they were or are told damaged, and that a swarm's rows
//! have no gap, is for this module.
//!
//! One thread writes, in the order of submission. Whatever waits when it comes round
//! becomes one transaction with one sync, so that many who wait share it. Readers have a
//! connection of their own and never hold it up.

mod error;
mod health;
mod record;

mod seal;

mod extent;

mod catalog;
mod schema;

mod draft;

mod mend;
mod read;
mod reserve;
mod retain;

mod aside;
mod backlog;
mod beginnings;
mod copy;
mod crash;
mod queue;

mod writer;

mod house;

#[cfg(test)]
#[expect(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    reason = "tests"
)]
mod tests;

use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rusqlite::Connection;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use tracing::warn;

pub use copy::copy;
pub use error::{StoreError, StoreFault};
pub use health::Health;
pub use record::{Answer, Checkpoint, Mark, Row, Rows, Write};

use beginnings::Beginnings;
use health::Meter;
use queue::{End, Queue, Submit};
use read::Trouble;
use writer::Writer;

/// How long the lock of a folder may be held on: whatever process its last holder has just started
/// has a share in it until it has become another program.
const PATIENCE_WITH_LOCK: Duration = Duration::from_millis(500);

/// How much lower than the rest of the daemon the thread that writes ranks: most of what it does in
/// a flood is for those who flood.
const NICENESS: i32 = 4;

/// Size up to which SQLite looks through the whole file when it is opened: milliseconds.
const MOST_CHECKED_BYTES: u64 = 8 * 1024 * 1024;

/// The database in a data folder.
pub const FILE: &str = schema::FILE;
/// The write-ahead log beside it.
pub const WAL: &str = "jostle.sqlite-wal";

/// The schema that this version writes, and the newest that it reads.
pub const SCHEMA: i64 = schema::KNOWN;

/// The file in a data folder whose lock the daemon holds.
pub const LOCK: &str = "lock";

/// The folder in a data folder in which a restoration writes, until it is complete.
pub const RESTORING: &str = ".restoring";

/// Called once with the outcome of a submit, on the store's thread or, where the store has ended,
/// on that of the submitter. It must not wait for the store.
pub type Done = Box<dyn FnOnce(Result<(), StoreFault>) + Send>;

/// When writes are to be written.
enum Wanted {
    /// At once or not at all; told either way.
    Now(Done),
    /// Within milliseconds, and where writing fails it is tried until it succeeds. Told, on the
    /// store's thread, only when they are synced.
    Soon(Option<Box<dyn FnOnce() + Send>>),
}

impl Wanted {
    fn is_now(&self) -> bool {
        matches!(self, Wanted::Now(_))
    }
}

/// Called once, on the store's thread, when the store can no longer be trusted.
type OnFatal = Box<dyn Fn(&StoreFault) + Send>;

/// What the store may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// What rows and checkpoints of one swarm may take, in bytes; the oldest go first.
    pub quota_bytes: u64,
}

/// The durable memory of one data folder. A clone reaches the same.
#[derive(Clone)]
pub struct Store(Arc<Inner>);

struct Inner {
    file: PathBuf,
    shared: Arc<Shared>,
    reader: Mutex<Option<Connection>>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

/// What submitters and the writer share.
#[derive(Default)]
struct Shared {
    queue: Queue,
    meter: Meter,
    beginnings: Beginnings,
}

impl Store {
    /// Opens the store in `folder`, which is created if need be and locked while it is open.
    ///
    /// `on_fatal` is called when what was written can no longer be trusted (a failed sync, a
    /// broken file). From then on every submit fails; the process should end and start again.
    ///
    /// # Errors
    ///
    /// [`StoreError::InUse`] when another has it open, [`StoreError::Newer`],
    /// [`StoreError::Foreign`] and [`StoreError::Corrupt`] when the file is not to be used,
    /// [`StoreError::Folder`] and [`StoreError::Io`] when the system refuses.
    pub fn open(
        folder: &Path,
        settings: Settings,
        on_fatal: Box<dyn Fn(&StoreFault) + Send>,
    ) -> Result<Store, StoreError> {
        Store::open_checking(folder, settings, on_fatal, MOST_CHECKED_BYTES)
    }

    fn open_checking(
        folder: &Path,
        settings: Settings,
        on_fatal: OnFatal,
        most_checked_bytes: u64,
    ) -> Result<Store, StoreError> {
        let lock = lock(folder)?;
        if folder.join(RESTORING).exists() {
            return Err(StoreError::Unrestored {
                folder: folder.to_path_buf(),
            });
        }
        let file = folder.join(schema::FILE);
        let mut connection = schema::open(&file, most_checked_bytes)?;
        let size = fs::metadata(&file).map_or(0, |file| file.len());
        if size <= most_checked_bytes {
            mend::open(folder, &mut connection)?;
        }
        let reader = schema::open_reader(&file)?;
        let shared = Arc::<Shared>::default();
        let writer = Writer::new(
            (connection, folder.to_path_buf(), lock),
            settings.quota_bytes,
            Arc::clone(&shared),
        )
        .map_err(|error| StoreError::of_reading(&file, &error))?;
        let for_thread = Arc::clone(&shared);
        let thread = thread::Builder::new()
            .name("store".to_string())
            .spawn(move || {
                // Zero names the calling thread. In a flood it lets those answer who answer.
                let _ = rustix::process::setpriority_process(None, NICENESS);
                house::run(writer, &for_thread, &on_fatal);
            })
            .map_err(StoreError::NoThread)?;
        let (reader, thread) = (Mutex::new(Some(reader)), Mutex::new(Some(thread)));
        Ok(Store(Arc::new(Inner {
            file,
            shared,
            reader,
            thread,
        })))
    }

    /// Queues `writes`: all of them are written, in this order and after everything submitted
    /// before, or none is. `done` is told once they are synced, or why they are not written.
    ///
    /// With `done` the commit comes at once; without, within milliseconds, and where writing
    /// fails it is tried until it succeeds. No writes at all, with `done`, waits for those before.
    ///
    /// Waits only while the queue is full. A row whose `done` was told a fault does not exist: the
    /// next one has its number. So a swarm submits nothing behind a row it waits for, or its later
    /// rows are refused as following a gap.
    pub fn submit(&self, writes: Vec<Write>, done: Option<Done>) {
        if writes.is_empty() && done.is_none() {
            return;
        }
        let wanted = done.map_or(Wanted::Soon(None), Wanted::Now);
        refused(self.0.shared.queue.push(Submit { writes, wanted }));
    }

    /// Queues `writes` as [`Store::submit`] does, and never waits: for whoever has no more than one
    /// such underway.
    pub fn submit_at_once(&self, writes: Vec<Write>, done: Done) {
        let wanted = Wanted::Now(done);
        refused(self.0.shared.queue.push_at_once(Submit { writes, wanted }));
    }

    /// Writes `writes` and waits until they are synced; none, until all that came before them is.
    ///
    /// # Errors
    ///
    /// [`StoreFault`]; nothing of them is written then.
    pub fn commit(&self, writes: Vec<Write>) -> Result<(), StoreFault> {
        let (done, is_done) = sync_channel(1);
        let told = Box::new(move |result| {
            // Whoever waited may be gone.
            let _ = done.send(result);
        });
        self.submit(writes, Some(told));
        is_done.recv().unwrap_or(Err(StoreFault::Stopped))
    }

    /// Queues `writes` as [`Store::submit`] does without anybody to wait; `told` is called, on the
    /// store's thread, once they are synced.
    pub fn submit_then(&self, writes: Vec<Write>, told: Box<dyn FnOnce() + Send>) {
        let wanted = Wanted::Soon(Some(told));
        // Once the store has ended nothing more is synced.
        let _ = self.0.shared.queue.push(Submit { writes, wanted });
    }

    /// The swarms: names, in order, with what each was created with.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] when a record is damaged or missing, and those of any read.
    pub fn swarms(&self) -> Result<Vec<(String, Vec<u8>)>, StoreError> {
        self.read("", read::swarms)
    }

    /// The checkpoints kept of `swarm`, newest first. Damaged ones are left out, with a warning
    /// and counted in [`Health::damaged`].
    ///
    /// # Errors
    ///
    /// [`StoreError::NoSwarm`], [`StoreError::Damaged`], and those of any read.
    pub fn checkpoints(&self, swarm: &str) -> Result<Vec<Mark>, StoreError> {
        let (marks, damaged) =
            self.read(swarm, |connection| read::checkpoints(connection, swarm))?;
        if damaged > 0 {
            warn!(
                swarm,
                damaged, "checkpoints are damaged or missing: older ones serve instead"
            );
            self.0
                .shared
                .meter
                .damaged
                .fetch_add(damaged, Ordering::Relaxed);
        }
        Ok(marks)
    }

    /// One checkpoint with its content.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] when it is not what was written, [`StoreError::NoCheckpoint`],
    /// [`StoreError::NoSwarm`], and those of any read.
    pub fn checkpoint(&self, swarm: &str, number: u64) -> Result<Checkpoint, StoreError> {
        self.read(swarm, |connection| {
            read::checkpoint(connection, swarm, number)
        })
    }

    /// At most `limit` rows after the row `after`, up to the first that is damaged or missing.
    /// Where the rows right after `after` are kept no longer, it begins with the first that is.
    ///
    /// # Errors
    ///
    /// [`StoreError::NoSwarm`], [`StoreError::Damaged`], and those of any read.
    pub fn rows(&self, swarm: &str, after: u64, limit: usize) -> Result<Rows, StoreError> {
        let rows = self.read(swarm, |connection| {
            read::rows(connection, swarm, after, limit)
        })?;
        if let Some(damaged_at) = rows.damaged_at {
            warn!(
                swarm,
                damaged_at, "a row of the journal is damaged or missing"
            );
            self.0.shared.meter.damaged.fetch_add(1, Ordering::Relaxed);
        }
        Ok(rows)
    }

    /// The answers kept, oldest first. Damaged ones are left out, with a warning and counted in
    /// [`Health::damaged`].
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] when nothing tells which there must be, and those of any read.
    pub fn answers(&self) -> Result<Vec<Answer>, StoreError> {
        let page = |after| self.read("", |connection| read::answer_page(connection, after));
        let (answers, damaged) = read::answers(page)?;
        if damaged > 0 {
            warn!(
                damaged,
                "answers are damaged or missing: these requests would be carried out again"
            );
            self.0
                .shared
                .meter
                .damaged
                .fetch_add(damaged, Ordering::Relaxed);
        }
        Ok(answers)
    }

    /// Whether an answer was ever deleted. False where that cannot be read.
    pub fn has_forgotten(&self) -> bool {
        self.read("", read::has_forgotten).unwrap_or(false)
    }

    /// The oldest checkpoint kept of `swarm`: from there on every row is there.
    ///
    /// The file is read only when the beginning of the history has moved since it was last asked
    /// for, so it may be asked for often.
    ///
    /// # Errors
    ///
    /// As [`Store::checkpoints`].
    pub fn history_from(&self, swarm: &str) -> Result<Option<Mark>, StoreError> {
        let beginnings = &self.0.shared.beginnings;
        let place = match beginnings.find(swarm) {
            Ok(mark) => return Ok(mark),
            Err(place) => place,
        };
        let mark = self.checkpoints(swarm)?.pop();
        if let Some(place) = place {
            beginnings.learn(swarm, place, mark);
        }
        Ok(mark)
    }

    /// How the store is doing.
    pub fn health(&self) -> Health {
        let size = |file: &Path| fs::metadata(file).map_or(0, |file| file.len());
        let mut wal = self.0.file.clone().into_os_string();
        wal.push("-wal");
        let bytes_on_disk = size(&self.0.file) + size(Path::new(&wal));
        self.0
            .shared
            .meter
            .read(self.0.shared.queue.waiting(), bytes_on_disk)
    }

    /// Writes what is queued, moves the WAL into the file, and ends; whether that was all done
    /// within `patience`. What is submitted from now on is refused, and nothing is read any more.
    pub fn stop(&self, patience: Duration) -> bool {
        let until = Instant::now() + patience;
        self.0.shared.queue.end(End::Stop);
        drop(
            self.0
                .reader
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .take(),
        );
        let patience = until.saturating_duration_since(Instant::now());
        self.0.shared.queue.wait_for_end(patience).unwrap_or(false)
    }

    fn read<T>(
        &self,
        swarm: &str,
        read: impl FnOnce(&Connection) -> Result<T, Trouble>,
    ) -> Result<T, StoreError> {
        let reader = self.0.reader.lock().unwrap_or_else(PoisonError::into_inner);
        let connection = reader.as_ref().ok_or(StoreError::Stopped)?;
        read(connection).map_err(|trouble| trouble.told(&self.0.file, swarm))
    }
}

impl Drop for Inner {
    /// Writes what is queued, however long it takes; [`Store::stop`] has patience.
    fn drop(&mut self) {
        self.shared.queue.end(End::Stop);
        drop(
            self.reader
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .take(),
        );
        let thread = self
            .thread
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some(thread) = thread.filter(|_| !self.shared.queue.is_writer()) {
            let _ = thread.join();
        }
    }
}

/// Tells whoever waits why the queue took nothing.
fn refused(pushed: Result<(), (Submit, End)>) {
    if let Err((submit, end)) = pushed
        && let Wanted::Now(done) = submit.wanted
    {
        done(Err(end.fault()));
    }
}

/// Creates `folder` for its owner alone, and locks it until the file returned is closed.
///
/// # Errors
///
/// [`StoreError::InUse`] and [`StoreError::Folder`].
pub fn lock(folder: &Path) -> Result<File, StoreError> {
    let fail = |source| StoreError::Folder {
        folder: folder.to_path_buf(),
        source,
    };
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(folder)
        .map_err(fail)?;
    // A new folder is there after a power cut only if its parent knows it.
    if let Some(parent) = folder
        .parent()
        .filter(|parent| !parent.as_os_str().is_empty())
    {
        let _ = File::open(parent).and_then(|parent| parent.sync_all());
    }
    let lock = OpenOptions::new()
        .create(true)
        .truncate(false)
        .write(true)
        .open(folder.join(LOCK))
        .map_err(fail)?;
    let began = Instant::now();
    loop {
        match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => return Ok(lock),
            Err(Errno::WOULDBLOCK) if began.elapsed() < PATIENCE_WITH_LOCK => {
                thread::sleep(PATIENCE_WITH_LOCK / 50);
            }
            Err(Errno::WOULDBLOCK) => {
                return Err(StoreError::InUse {
                    folder: folder.to_path_buf(),
                });
            }
            Err(error) => return Err(fail(io::Error::from(error))),
        }
    }
}
