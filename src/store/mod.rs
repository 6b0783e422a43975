//! The database of the daemon: swarms with their journal rows and checkpoints, and replies to requests.
//!
//! Bodies are opaque bytes. The store guarantees that committed writes are durable, that a record is
//! returned as it was written or reported as damaged, and that the rows of a swarm have no gap.
//!
//! One thread writes, in the order of submission. It commits what is queued in one transaction with
//! one sync, which all submitters share. Reads use a connection of their own and do not block it.

mod audit;
mod backlog;
mod copy;
mod damaged_copy;
mod data_id;
mod error;
mod examined;
mod failpoint;
mod health;
mod integrity;
mod maintenance;
mod notes;
mod queue;
mod read;
mod record;
mod repair;
mod reserve;
mod retention;
mod schema;
mod transaction;
mod writer;

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
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use rusqlite::Connection;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;

pub use audit::{AuditFilter, AuditPage, AuditSize};
pub use copy::copy;
pub use error::{StoreError, StoreFault};
pub use health::Health;
pub use notes::note_bytes;
pub use record::{AuditLine, Checkpoint, CheckpointInfo, Row, Rows, StoredReply, Write};
pub use schema::{FILE, KNOWN as SCHEMA, NOTE};

use health::Meter;
use queue::{Queue, Submit};
use writer::Writer;

/// How long the lock of a folder is retried: a child that its last holder has just forked holds it until
/// it calls exec.
const LOCK_TIMEOUT: Duration = Duration::from_millis(500);

/// Niceness of the writer thread: in a flood of commands most of its work is for the flood.
const NICENESS: i32 = 4;

/// Size up to which all pages are checked when the file is opened, which takes milliseconds.
const MAX_CHECKED_BYTES: u64 = 8 * 1024 * 1024;

/// The file name of the write-ahead log of [`FILE`].
pub const WAL: &str = "jostle.sqlite-wal";

/// The file in a data folder that the daemon locks.
pub const LOCK: &str = "lock";

/// The folder in a data folder into which a restoration writes until it is complete.
pub const RESTORING: &str = ".restoring";

/// Receives the outcome of a submit.
pub trait OnCommit: Send {
    /// Called once: on the writer thread, or on the thread of the submitter if the store has ended. It
    /// must not block on the store.
    fn committed(self: Box<Self>, outcome: Result<(), StoreFault>);
}

impl OnCommit for SyncSender<Result<(), StoreFault>> {
    fn committed(self: Box<Self>, outcome: Result<(), StoreFault>) {
        // An error means that the submitter no longer waits.
        let _ = self.send(outcome);
    }
}

/// When writes are committed, and what receives the outcome.
enum Durability {
    /// At once or not at all.
    Sync(Box<dyn OnCommit>),
    /// Within milliseconds, and retried until it succeeds. Only the success is reported.
    Deferred(Option<Box<dyn OnCommit>>),
}

impl Durability {
    fn is_sync(&self) -> bool {
        matches!(self, Durability::Sync(_))
    }
}

/// Called once, on the writer thread, with a fatal fault.
type OnFatal = Box<dyn Fn(&StoreFault) + Send>;

/// Settings of the store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Maximum size of the rows and checkpoints of one swarm, without notes; the oldest are deleted
    /// first.
    pub quota_bytes: u64,
    /// Maximum size of the audit log.
    pub audit_bytes: u64,
    /// Maximum age of its lines, in milliseconds.
    pub audit_ms: u64,
}

impl Default for Settings {
    /// Those without a limit.
    fn default() -> Self {
        Settings {
            quota_bytes: u64::MAX,
            audit_bytes: u64::MAX,
            audit_ms: u64::MAX,
        }
    }
}

/// The database of one data folder. Clones share it.
#[derive(Clone)]
pub struct Store(Arc<Inner>);

struct Inner {
    file: PathBuf,
    data_id: Option<String>,
    shared: Arc<Shared>,
    reader: Mutex<Option<Connection>>,
    thread: Option<JoinHandle<()>>,
}

/// State shared by submitters and the writer thread.
#[derive(Default)]
struct Shared {
    queue: Queue,
    meter: Meter,
}

impl Store {
    /// Opens the store in `folder`, which is created if missing, and locked while it is open.
    ///
    /// `on_fatal` is called on a fatal fault (a failed sync, a damaged file). From then on every
    /// submit fails; the process should exit and be restarted.
    ///
    /// # Errors
    ///
    /// [`StoreError::InUse`] if another process has it open, [`StoreError::Newer`],
    /// [`StoreError::Foreign`], [`StoreError::Corrupt`] and [`StoreError::Unrestored`] if the file
    /// cannot be used, [`StoreError::Folder`] and [`StoreError::Io`] for an error of the system.
    pub fn open(
        folder: &Path,
        settings: Settings,
        on_fatal: Box<dyn Fn(&StoreFault) + Send>,
    ) -> Result<Store, StoreError> {
        Store::open_checking(folder, settings, on_fatal, MAX_CHECKED_BYTES)
    }

    fn open_checking(
        folder: &Path,
        settings: Settings,
        on_fatal: OnFatal,
        max_checked_bytes: u64,
    ) -> Result<Store, StoreError> {
        let lock = lock(folder)?;
        if folder.join(RESTORING).exists() {
            return Err(StoreError::Unrestored(folder.to_path_buf()));
        }
        let file = folder.join(FILE);
        let is_new = !file.exists();
        let mut connection = schema::open(&file, max_checked_bytes)?;
        let data_id = data_id::of(folder, is_new);
        let size = fs::metadata(&file).map_or(0, |file| file.len());
        if size <= max_checked_bytes {
            repair::on_open(folder, &mut connection)?;
        }
        let reader = schema::open_reader(&file)?;
        let shared = Arc::<Shared>::default();
        let writer = Writer::new(
            (connection, folder.to_path_buf(), lock),
            settings,
            Arc::clone(&shared),
        )
        .map_err(|error| StoreError::of_reading(&file, &error))?;
        let for_thread = Arc::clone(&shared);
        let thread = thread::Builder::new()
            .name("store".to_string())
            .spawn(move || {
                // `None` is the calling thread. Threads that reply take precedence.
                let _ = rustix::process::setpriority_process(None, NICENESS);
                maintenance::run(writer, &for_thread, &on_fatal);
            })
            .map_err(StoreError::NoThread)?;
        let (reader, thread) = (Mutex::new(Some(reader)), Some(thread));
        Ok(Store(Arc::new(Inner {
            file,
            data_id,
            shared,
            reader,
            thread,
        })))
    }

    /// Enqueues `writes`, and blocks only while the queue is full: all of them are written, in this
    /// order and after all earlier submits, or none is. They are committed within milliseconds, and
    /// retried until that succeeds. `synced` is called once they and all earlier ones are.
    pub fn submit(&self, writes: Vec<Write>, synced: Option<Box<dyn OnCommit>>) {
        if !writes.is_empty() || synced.is_some() {
            self.push(writes, Durability::Deferred(synced));
        }
    }

    /// Writes `writes` as [`Self::submit`] does, but at once or not at all, and blocks until they are
    /// synced; if empty, until all earlier submits are. After a fault the next row of a swarm has the
    /// number of the first one that was not written.
    ///
    /// # Errors
    ///
    /// [`StoreFault`]: none of them is written, or with [`StoreFault::Fatal`] it is unknown.
    pub fn commit(&self, writes: Vec<Write>) -> Result<(), StoreFault> {
        let (done, is_done) = sync_channel(1);
        self.push(writes, Durability::Sync(Box::new(done)));
        is_done.recv().unwrap_or(Err(StoreFault::Stopped))
    }

    /// The id of the data, which stays the same while they have all replies that were sent; `None` if it
    /// could not be stored.
    pub fn data_id(&self) -> Option<&str> {
        self.0.data_id.as_deref()
    }

    /// Whether the last write succeeded.
    pub fn is_writable(&self) -> bool {
        let meter = &self.0.shared.meter;
        !meter.is_full.load(Ordering::Relaxed) && !meter.is_failing.load(Ordering::Relaxed)
    }

    /// Condition and counters of the store.
    pub fn health(&self) -> Health {
        let size = |file: &Path| fs::metadata(file).map_or(0, |file| file.len());
        let bytes_on_disk = size(&self.0.file) + size(&self.0.file.with_file_name(WAL));
        let Shared { queue, meter } = &*self.0.shared;
        meter.read(queue.waiting(), bytes_on_disk)
    }

    /// Writes what is queued, checkpoints the WAL, and ends; whether all of that completed within
    /// `timeout`. Later submits and reads fail.
    pub fn stop(&self, timeout: Duration) -> bool {
        let until = Instant::now() + timeout;
        self.0.shared.queue.end(StoreFault::Stopped);
        drop(self.0.reader.lock().take());
        let timeout = until.saturating_duration_since(Instant::now());
        self.0.shared.queue.wait_for_end(timeout).unwrap_or(false)
    }

    fn push(&self, writes: Vec<Write>, durability: Durability) {
        self.0.shared.queue.push(Submit { writes, durability });
    }
}

impl Drop for Inner {
    /// Writes what is queued, however long it takes; [`Store::stop`] has a timeout.
    fn drop(&mut self) {
        self.shared.queue.end(StoreFault::Stopped);
        // The writer deletes the WAL if its connection is the last.
        drop(self.reader.get_mut().take());
        let thread = self.thread.take();
        if let Some(thread) = thread.filter(|_| !self.shared.queue.is_writer()) {
            let _ = thread.join();
        }
    }
}

/// Creates `folder`, accessible to its owner only, and locks it until the returned file is closed.
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
    // Without this sync of its parent a new folder may be lost in a power failure.
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
            Err(Errno::WOULDBLOCK) if began.elapsed() < LOCK_TIMEOUT => {
                thread::sleep(LOCK_TIMEOUT / 50);
            }
            Err(Errno::WOULDBLOCK) => {
                return Err(StoreError::InUse(folder.to_path_buf()));
            }
            Err(error) => return Err(fail(io::Error::from(error))),
        }
    }
}
