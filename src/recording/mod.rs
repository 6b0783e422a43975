//! The recordings of a daemon: every k-th state of a swarm, in its data directory.
//!
//! Each has its own folder, its own subscription to the swarm's output, and its own thread, which writes
//! what the subscription receives. By default the swarm waits for that thread, never for a client. A
//! running recording resumes with its next part when the daemon restarts.

mod error;
mod gaps;
mod lost;
mod resume;
mod source;
mod status;
mod writer;

use std::cell::Cell;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use fail::fail_point;
pub use jostle_proto::RecordingPhase as Phase;
use jostle_proto::keys;
pub use jostle_results::recording::Format;
use jostle_results::recording::{Recorder, RecordingError, parts};
use parking_lot::{Condvar, Mutex, MutexGuard};
use tracing::{info, warn};

pub use self::error::RecordError;
pub use self::lost::lost_parts;
pub use self::source::Source;
use self::status::Entry;
pub use self::status::{Gap, Position, Status};
use self::writer::RecordingWriter;
use crate::jobs::JobDirectory;
use crate::swarm::handle::Message;
use crate::swarm::registry::SwarmRegistry;

/// Maximum number of running recordings.
const MAX_RUNNING: usize = 64;

/// Maximum number of recordings: a list of them fits a message.
const MAX_RECORDINGS: usize = 1000;

/// The niceness of the writer thread of a recording for which no swarm waits: lower priority than
/// the swarms, which it must not delay.
const NICENESS: i32 = 10;

/// The growth of a recording between two checks of the quota.
const QUOTA_CHECK_BYTES: u64 = 1024 * 1024;

/// The maximum number of bytes of a part that one request reads.
const MAX_PIECE_BYTES: u64 = 512 * 1024;

/// How long `stop` waits for the writer, which waits for the disk.
const STOP_TIMEOUT: Duration = Duration::from_secs(3);

/// The reason of a recording that a client has stopped.
const STOPPED: &str = "stopped";

/// The reason of a recording whose thread has panicked.
const DEFECT: &str = "a defect of the daemon";

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece {
    /// The number of finished parts.
    pub parts: u64,
    /// The length of the part in bytes.
    pub length: u64,
    /// Its bytes from the requested offset.
    pub bytes: Vec<u8>,
}

/// The recordings of a daemon. Clones share them. Methods that change something must not be called
/// concurrently.
#[derive(Clone)]
pub struct Recordings(Arc<Shared>);

struct Shared {
    jobs: JobDirectory<Status>,
    registry: Arc<SwarmRegistry>,
    quota_bytes: u64,
    /// Nothing between two changes can panic.
    state: Mutex<State>,
    changed: Condvar,
}

/// What the thread of a recording starts with.
enum Origin {
    /// The files of a new one.
    New(Box<Recorder>),
    /// The folder of one that the end of the daemon interrupted.
    Interrupted {
        /// Where its swarm was reset.
        resets: Vec<Position>,
    },
}

#[derive(Default)]
struct State {
    entries: BTreeMap<String, Entry>,
    is_stopping: bool,
}

impl State {
    fn running(&self) -> usize {
        let entries = self.entries.values();
        entries.filter(|it| it.subscription.is_some()).count()
    }

    fn bytes(&self) -> u64 {
        self.entries.values().map(|it| it.size).sum()
    }
}

impl Recordings {
    /// Opens the recordings in a folder. Interrupted ones wait for [`Recordings::resume`]. A failed
    /// one becomes an event of its swarm.
    pub fn open(folder: &Path, quota_bytes: u64, registry: Arc<SwarmRegistry>) -> io::Result<Self> {
        let jobs = JobDirectory::open(folder)?;
        let mut state = State::default();
        for (name, status) in jobs.list()? {
            match status {
                Ok(status) if keys::is_name(&name) => {
                    state.entries.insert(name, Entry::idle(status));
                }
                Ok(_) => {}
                Err(error) => warn!(recording = name, %error, "unreadable status file"),
            }
        }
        let recordings = Recordings(Arc::new(Shared {
            jobs,
            registry,
            quota_bytes,
            state: Mutex::new(state),
            changed: Condvar::new(),
        }));
        recordings.check_all();
        Ok(recordings)
    }

    /// Starts a recording. Returns its name, which is generated if it is not given.
    pub fn begin(
        &self,
        name: Option<&str>,
        mut status: Status,
        source: Source,
    ) -> Result<(String, Status), RecordError> {
        let name = self.admit(name, &status.swarm)?;
        status.every = Some(source.every);
        status.began_at = Some(source.began_at());
        let folder = self.0.jobs.folder(&name);
        let recorder = Recorder::to_folder(&folder, status.format, source.about(&status));
        let recorder = recorder.map_err(|error| match error {
            RecordingError::Exists { .. } => RecordError::Exists(name.clone()),
            error => error.into(),
        })?;
        let written = self.0.jobs.write_status(&name, &status);
        let written = written.map_err(RecordError::from);
        let origin = Origin::New(Box::new(recorder));
        if let Err(error) = written.and_then(|()| self.start(&name, status, source, origin)) {
            let _ = self.0.jobs.remove(&name);
            return Err(error);
        }
        let status = self.find(&name)?;
        Ok((name, status))
    }

    /// Stops a recording and keeps its files.
    pub fn stop(&self, name: &str) -> Result<Status, RecordError> {
        match self.find(name)?.phase {
            Phase::Ended => {}
            Phase::Failed => return Err(RecordError::Failed(name.to_owned())),
            Phase::Recording => self.end(name)?,
        }
        self.shown(name)
    }

    /// Deletes a recording with its files, and stops it before. Returns its last status.
    pub fn delete(&self, name: &str) -> Result<Status, RecordError> {
        if self.find(name)?.phase == Phase::Recording {
            self.end(name)?;
        }
        let status = self.shown(name)?;
        self.0.jobs.remove(name)?;
        self.lock().entries.remove(name);
        Ok(status)
    }

    /// The finished parts of a recording, in order; none if it does not exist.
    pub fn parts(&self, name: &str) -> Vec<PathBuf> {
        parts(&self.0.jobs.folder(name)).unwrap_or_default()
    }

    /// Reads a piece of a finished part. Parts count from 0.
    pub fn piece(&self, name: &str, part: u64, offset: u64) -> Result<Piece, RecordError> {
        self.find(name)?;
        self.check(name);
        let all = parts(&self.0.jobs.folder(name))?;
        let parts = all.len() as u64;
        let Some(path) = usize::try_from(part).ok().and_then(|part| all.get(part)) else {
            let name = name.to_owned();
            return Err(RecordError::NoPart { name, part, parts });
        };
        let mut file = File::open(path)?;
        let (length, mut bytes) = (file.metadata()?.len(), Vec::new());
        if offset > length {
            return Err(RecordError::NoOffset {
                name: name.to_owned(),
                part,
                offset,
                length,
            });
        }
        file.seek(SeekFrom::Start(offset))?;
        file.take(MAX_PIECE_BYTES).read_to_end(&mut bytes)?;
        Ok(Piece {
            parts,
            length,
            bytes,
        })
    }

    /// The bytes of all recordings, and their maximum.
    pub fn usage(&self) -> (u64, u64) {
        (self.lock().bytes(), self.0.quota_bytes)
    }

    /// Every recording as clients see it, ordered by name; what was missing at the last
    /// [`Recordings::check_all`] is not counted.
    pub fn list(&self) -> Vec<(String, Status)> {
        let state = self.lock();
        let entries = state.entries.iter();
        entries
            .map(|(name, it)| (name.clone(), it.shown()))
            .collect()
    }

    /// Finishes the parts of the running recordings, which resume when the daemon restarts. Returns
    /// how many writers do not end within `timeout`: these lose a part.
    pub fn close(&self, timeout: Duration) -> usize {
        let mut state = self.lock();
        state.is_stopping = true;
        let entries = state.entries.values();
        let subscriptions = entries.filter_map(|it| it.subscription.as_ref());
        subscriptions.for_each(|it| it.end(None));
        let changed = &self.0.changed;
        changed.wait_while_for(&mut state, |state| state.running() > 0, timeout);
        state.running()
    }

    /// Checks the limits, and returns the name of a new recording.
    fn admit(&self, name: Option<&str>, swarm: &str) -> Result<String, RecordError> {
        let state = self.lock();
        let (running, entries) = (state.running(), &state.entries);
        let (used, quota) = (state.bytes(), self.0.quota_bytes);
        if used >= quota {
            return Err(RecordError::OverQuota { used, quota });
        }
        if state.is_stopping {
            return Err(RecordError::Stopping);
        }
        if running >= MAX_RUNNING {
            return Err(RecordError::TooMany(running));
        }
        if entries.len() >= MAX_RECORDINGS {
            return Err(RecordError::TooManyKept(entries.len()));
        }
        let is_taken = |name: &str| entries.contains_key(name) || self.0.jobs.has(name);
        match name {
            Some(name) if is_taken(name) => Err(RecordError::Exists(name.to_owned())),
            Some(name) => Ok(name.to_owned()),
            None => {
                let mut names = (1..).map(|number| numbered(swarm, number));
                Ok(names.find(|name| !is_taken(name)).unwrap_or_default())
            }
        }
    }

    /// Starts the thread of a recording, which replaces the entry when it ends.
    fn start(
        &self,
        name: &str,
        status: Status,
        source: Source,
        origin: Origin,
    ) -> Result<(), RecordError> {
        fail_point!("recording-thread", |_| Err(RecordError::NoThread(
            "a failpoint".to_owned()
        )));
        let is_background = status.drop_when_behind;
        let entry = Entry {
            size: match &origin {
                Origin::New(recorder) => recorder.size(),
                Origin::Interrupted { .. } => status.bytes,
            },
            status: status.clone(),
            subscription: Some(source.subscription.clone()),
            lost: None,
            checked: None,
        };
        self.lock().entries.insert(name.to_owned(), entry);
        let (recordings, of) = (self.clone(), name.to_owned());
        let run = move || {
            if is_background {
                // `None` is the calling thread. Without the right to it, it keeps its priority.
                let _ = rustix::process::setpriority_process(None, NICENESS);
            }
            recordings.write(&of, &source, status, origin);
        };
        let thread = thread::Builder::new().name(format!("record-{name}"));
        thread.spawn(run).map(drop).map_err(|error| {
            self.lock().entries.remove(name);
            RecordError::NoThread(error.to_string())
        })
    }

    /// Writes a recording to its end, on its own thread.
    fn write(&self, name: &str, source: &Source, status: Status, origin: Origin) {
        let is_over_quota = Cell::new(false);
        let mut checked = 0;
        let progress = |recorder: &Recorder, has_ended: bool| {
            let mut state = self.lock();
            let entry = state.entries.get_mut(name)?;
            entry.status.count_progress(recorder);
            entry.size = recorder.size();
            let (size, status) = (entry.size, has_ended.then(|| entry.report()));
            if let Some(max_bytes) = entry.status.max_bytes.filter(|it| size >= *it) {
                return Some(format!(
                    "its next states could exceed max_bytes ({max_bytes}): record again with a \
                     higher limit"
                ));
            }
            if size >= checked + QUOTA_CHECK_BYTES {
                checked = size;
                if state.bytes() >= self.0.quota_bytes {
                    is_over_quota.set(true);
                    return Some(format!(
                        "the daemon's recordings have reached their {} MiB (recordings_quota_mb)",
                        self.0.quota_bytes >> 20
                    ));
                }
            }
            drop(state);
            self.write_status(name, &status?);
            None
        };
        let written = catch_unwind(AssertUnwindSafe(|| {
            let opened = match origin {
                Origin::New(recorder) => Ok(Ok((*recorder, status))),
                Origin::Interrupted { resets } => self.reopen(name, source, &resets),
            };
            match opened {
                Ok(Ok((recorder, status))) => {
                    let writer = RecordingWriter::new(recorder, source, &status);
                    let (end, written) = writer.write(progress);
                    (end, Some(written))
                }
                Ok(Err(reason)) => (Ok(Some(reason)), None),
                Err(error) => (Err(error), None),
            }
        }));
        // After an error or a panic the swarm still waits for the queue.
        source.subscription.end(None);
        let Ok(mut status) = self.find(name) else {
            return;
        };
        let (phase, reason) = match written {
            Ok((end, written)) => {
                written.into_iter().for_each(|it| status.count(it));
                match end {
                    Ok(None) => (Phase::Recording, None),
                    Ok(reason) if is_over_quota.get() => (Phase::Failed, reason),
                    Ok(reason) => (Phase::Ended, reason),
                    Err(error) => (Phase::Failed, Some(error.to_string())),
                }
            }
            Err(_) => (Phase::Failed, Some(DEFECT.to_owned())),
        };
        self.finish(name, status, phase, reason);
    }

    /// Writes the last status of a recording whose writer has ended.
    fn finish(&self, name: &str, mut status: Status, phase: Phase, reason: Option<String>) {
        match phase {
            Phase::Recording => {}
            Phase::Ended => info!(recording = name, reason, "ended"),
            Phase::Failed => warn!(recording = name, reason, "failed"),
        }
        (status.phase, status.reason) = (phase, reason);
        fail_point!("recording-settled");
        self.write_status(name, &status);
        let failed = (phase == Phase::Failed).then(|| status.clone());
        let entry = Entry::idle(status);
        self.lock().entries.insert(name.to_owned(), entry);
        self.0.changed.notify_all();
        if let Some(Status { swarm, reason, .. }) = failed
            && let Some(handle) = self.0.registry.find(&swarm)
        {
            let reason = reason.unwrap_or_default();
            handle.send(Message::RecordingFailed(name.into(), reason.into()));
        }
    }

    fn write_status(&self, name: &str, status: &Status) {
        // The next start counts what is in the files.
        if let Err(error) = self.0.jobs.write_status(name, status) {
            warn!(recording = name, %error, "failed to write the status file");
        }
    }

    /// Ends a running recording, and waits for its writer.
    fn end(&self, name: &str) -> Result<(), RecordError> {
        let running = |state: &State| state.entries.get(name)?.subscription.clone();
        let subscription = running(&self.lock());
        let Some(subscription) = subscription else {
            // It has not been resumed yet.
            let status = self.find(name)?;
            self.finish(name, status, Phase::Ended, Some(STOPPED.to_owned()));
            return Ok(());
        };
        subscription.end(Some(STOPPED.to_owned()));
        let changed = &self.0.changed;
        let is_running = |state: &mut State| running(state).is_some();
        let mut state = self.lock();
        changed.wait_while_for(&mut state, is_running, STOP_TIMEOUT);
        match is_running(&mut state) {
            true => Err(RecordError::Ending(name.to_owned())),
            false => Ok(()),
        }
    }

    fn find(&self, name: &str) -> Result<Status, RecordError> {
        let state = self.lock();
        let entry = state.entries.get(name).map(Entry::report);
        entry.ok_or_else(|| RecordError::Unknown(name.to_owned()))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.state.lock()
    }
}

/// A name made of a swarm's and a number.
fn numbered(swarm: &str, number: usize) -> String {
    let number = format!("-{number}");
    let length = swarm.len().min(keys::MAX_NAME_LENGTH - number.len());
    format!("{}{number}", &swarm[..length])
}
