//! The recordings of a daemon: every k-th state of a swarm, in its data directory.
//!
//! Each has its own folder and its own thread, which writes what a subscriber of the swarm's output
//! enqueues. By default the swarm waits for that thread, never for a client. A running recording
//! resumes with its next part when the daemon restarts.

mod error;
mod queue;
mod source;
mod status;
mod writer;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, SystemTime};

use fail::fail_point;
use jostle_proto::keys;
pub use jostle_results::recording::Format;
use jostle_results::recording::{Recorder, RecordingError, parts, sweep};
use tracing::{info, warn};

pub use self::error::RecordError;
use self::queue::End;
pub use self::source::Source;
use self::status::Entry;
pub use self::status::{Phase, Status};
use self::writer::RecordingWriter;
use crate::convert::WordRefusal;
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

/// The maximum number of bytes of a part that one request reads.
const MAX_PIECE_BYTES: u64 = 512 * 1024;

/// How long `stop` waits for the writer, which waits for the disk.
const STOP_TIMEOUT: Duration = Duration::from_secs(3);

/// What to record. Further settings are in [`Source`].
#[derive(Clone, Debug)]
pub struct NewRecording {
    /// Its name; the swarm's name and a number if not given.
    pub name: Option<String>,
    /// The size at which it ends.
    pub max_bytes: u64,
    /// Whether a client deletes it after it has fetched it.
    pub temporary: bool,
}

/// A piece of a finished part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece {
    /// The number of finished parts.
    pub parts: u64,
    /// The length of the part in bytes.
    pub length: u64,
    /// Its bytes from the requested offset.
    pub bytes: Vec<u8>,
}

/// The bytes of all recordings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// The number of running recordings.
    pub recording: usize,
    /// The bytes of all recordings.
    pub bytes: u64,
    /// The maximum of these bytes.
    pub quota_bytes: u64,
}

/// The recordings of a daemon. Clones share them. Methods that change something must not be called
/// concurrently.
#[derive(Clone)]
pub struct Recordings(Arc<Shared>);

struct Shared {
    jobs: JobDirectory<Status>,
    word: WordRefusal,
    registry: Arc<SwarmRegistry>,
    quota_bytes: u64,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    entries: BTreeMap<String, Entry>,
    is_stopping: bool,
}

impl State {
    fn running(&self) -> usize {
        let entries = self.entries.values();
        entries.filter(|it| it.queue.is_some()).count()
    }
}

impl Recordings {
    /// Opens the recordings in a folder. Interrupted ones wait for [`Recordings::resume`]. A failed
    /// one becomes an event of its swarm.
    pub fn open(
        folder: &Path,
        word: WordRefusal,
        quota_bytes: u64,
        registry: Arc<SwarmRegistry>,
    ) -> io::Result<Self> {
        let jobs = JobDirectory::open(folder)?;
        let mut state = State::default();
        for (name, status) in jobs.list()? {
            match status {
                Ok(status) if keys::is_name(&name) => {
                    let queue = None;
                    state.entries.insert(name, Entry { status, queue });
                }
                Ok(_) => {}
                Err(error) => warn!(recording = name, %error, "unreadable status file"),
            }
        }
        Ok(Recordings(Arc::new(Shared {
            jobs,
            word,
            registry,
            quota_bytes,
            state: Mutex::new(state),
            changed: Condvar::new(),
        })))
    }

    /// Starts a recording. Returns its name, which is generated if it is not given.
    pub fn begin(
        &self,
        new: &NewRecording,
        source: Source,
    ) -> Result<(String, Status), RecordError> {
        let name = self.admit(new.name.as_deref(), &source.swarm)?;
        let began = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let status = Status {
            swarm: source.swarm.clone(),
            format: Format::Mcap,
            every: Some(source.choice.every),
            drop_when_behind: source.choice.drops,
            max_bytes: Some(new.max_bytes),
            steps_left: source.choice.steps,
            temporary: new.temporary,
            phase: Phase::Recording,
            reason: None,
            frames: 0,
            missed: 0,
            parts: 0,
            bytes: 0,
            began_unix_secs: began.unwrap_or_default().as_secs(),
        };
        let folder = self.0.jobs.folder(&name);
        let recorder = Recorder::to_folder(&folder, status.format, source.about(&status));
        let recorder = recorder.map_err(|error| match error {
            RecordingError::Exists { .. } => RecordError::Exists(name.clone()),
            error => error.into(),
        })?;
        let started = match self.0.jobs.write_status(&name, &status) {
            Ok(()) => self.start(&name, status, source, recorder),
            Err(error) => Err(error.into()),
        };
        if let Err(error) = started {
            let _ = self.0.jobs.remove(&name);
            return Err(error);
        }
        let status = self.find(&name)?;
        info!(recording = name, swarm = status.swarm, "started to record");
        Ok((name, status))
    }

    /// Stops a recording and keeps its files.
    pub fn stop(&self, name: &str) -> Result<Status, RecordError> {
        match self.find(name)?.phase {
            Phase::Ended => {}
            Phase::Failed => return Err(RecordError::Failed(name.to_owned())),
            Phase::Recording => self.end(name)?,
        }
        self.find(name)
    }

    /// Deletes a recording with its files, and stops it before. Returns its last status.
    pub fn delete(&self, name: &str) -> Result<Status, RecordError> {
        if self.find(name)?.phase == Phase::Recording {
            self.end(name)?;
        }
        let status = self.find(name)?;
        self.0.jobs.remove(name)?;
        self.lock().entries.remove(name);
        info!(recording = name, "deleted");
        Ok(status)
    }

    /// The recordings that were running when the daemon ended, and are to be resumed.
    pub fn interrupted(&self) -> Vec<(String, Status)> {
        let state = self.lock();
        let entries = state.entries.iter();
        let interrupted = entries.filter(|(_, it)| it.is_interrupted());
        let named = interrupted.map(|(name, it)| (name.clone(), it.status.clone()));
        named.collect()
    }

    /// Resumes an interrupted recording; without a source it is over.
    pub fn resume(&self, name: &str, source: Option<Source>) {
        let mut status = match self.lock() {
            state if state.is_stopping => return,
            state => match state.entries.get(name) {
                // It may have been stopped or deleted meanwhile.
                Some(entry) if entry.is_interrupted() => entry.status.clone(),
                _ => return,
            },
        };
        let folder = self.0.jobs.folder(name);
        let opened = sweep(&folder).and_then(|removed| {
            let about = source.as_ref().map(|source| source.about(&status));
            let recorder = Recorder::go_on(&folder, status.format, about.unwrap_or_default())?;
            Ok((removed.len(), recorder))
        });
        if let Ok((_, recorder)) = &opened {
            let missed = status.missed;
            status.count(recorder.written(), missed);
        }
        let (phase, reason) = match (opened, source) {
            (Ok((removed, recorder)), Some(source)) => {
                let part = status.parts;
                info!(recording = name, part, removed, "resumed with a new part");
                let queue = &source.queue;
                queue.set_progress(recorder.written(), recorder.size());
                match self.start(name, status.clone(), source, recorder) {
                    Ok(()) => return,
                    Err(error) => (Phase::Failed, error.to_string()),
                }
            }
            (Ok(_), None) => {
                let reason = "its swarm did not exist when the daemon restarted";
                (Phase::Ended, reason.to_owned())
            }
            (Err(error), _) => (Phase::Failed, error.to_string()),
        };
        self.finish(name, status, phase, Some(reason));
    }

    /// The finished parts of a recording, in order; none if it does not exist.
    pub fn parts(&self, name: &str) -> Vec<PathBuf> {
        parts(&self.0.jobs.folder(name)).unwrap_or_default()
    }

    /// Reads a piece of a finished part. Parts count from 0.
    pub fn piece(&self, name: &str, part: u64, offset: u64) -> Result<Piece, RecordError> {
        self.find(name)?;
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

    /// The bytes of all recordings.
    pub fn usage(&self) -> Usage {
        let state = self.lock();
        Usage {
            recording: state.running(),
            bytes: state.entries.values().map(Entry::size).sum(),
            quota_bytes: self.0.quota_bytes,
        }
    }

    /// The status of every recording, by name.
    pub fn list(&self) -> Vec<(String, Status)> {
        let state = self.lock();
        let entries = state.entries.iter();
        let named = entries.map(|(name, entry)| (name.clone(), entry.report()));
        named.collect()
    }

    /// Finishes the parts of the running recordings, which resume when the daemon restarts. Returns
    /// how many writers do not end within `timeout`: these lose a part.
    pub fn close(&self, timeout: Duration) -> usize {
        let mut state = self.lock();
        state.is_stopping = true;
        let queues = state.entries.values().filter_map(|it| it.queue.as_ref());
        queues.for_each(|queue| queue.end(End::Closing));
        let changed = &self.0.changed;
        let waited = changed.wait_timeout_while(state, timeout, |state| state.running() > 0);
        waited.unwrap_or_else(PoisonError::into_inner).0.running()
    }

    /// Checks the limits, and returns the name of a new recording.
    fn admit(&self, name: Option<&str>, swarm: &str) -> Result<String, RecordError> {
        let Usage {
            recording,
            bytes: used,
            quota_bytes: quota,
        } = self.usage();
        if used >= quota {
            return Err(RecordError::OverQuota { used, quota });
        }
        let state = self.lock();
        if state.is_stopping {
            return Err(RecordError::Stopping);
        }
        if recording >= MAX_RUNNING {
            return Err(RecordError::TooMany(recording));
        }
        let entries = &state.entries;
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

    /// Starts the thread that writes a recording.
    fn start(
        &self,
        name: &str,
        status: Status,
        source: Source,
        recorder: Recorder,
    ) -> Result<(), RecordError> {
        let Source {
            swarm,
            queue,
            subscriber,
            ..
        } = source;
        let writer = RecordingWriter {
            swarm,
            word: self.0.word,
            queue: queue.clone(),
            recorder,
            max_bytes: status.max_bytes,
        };
        let entry = Entry {
            status: status.clone(),
            queue: Some(queue),
        };
        // The thread replaces the entry when it ends.
        self.lock().entries.insert(name.to_owned(), entry);
        let (recordings, of) = (self.clone(), name.to_owned());
        let run = move || {
            if status.drop_when_behind {
                // `None` is the calling thread. Without the right to it, it keeps its priority.
                let _ = rustix::process::setpriority_process(None, NICENESS);
            }
            recordings.write(&of, status, writer);
            drop(subscriber);
        };
        let thread = thread::Builder::new().name(format!("record-{name}"));
        thread.spawn(run).map(drop).map_err(|error| {
            self.lock().entries.remove(name);
            RecordError::NoThread(error.to_string())
        })
    }

    /// Writes a recording to its end, on its own thread.
    fn write(&self, name: &str, mut status: Status, writer: RecordingWriter) {
        let queue = writer.queue.clone();
        let ended_part = |written, missed| {
            let mut status = status.clone();
            status.count(written, missed);
            status.steps_left = queue.steps_left();
            self.write_status(name, &status);
        };
        let over_quota = || {
            let usage = self.usage();
            let quota_bytes = usage.quota_bytes;
            (usage.bytes >= quota_bytes).then_some(End::OverQuota { quota_bytes })
        };
        let work = AssertUnwindSafe(|| writer.write(ended_part, over_quota));
        let (end, written) = match catch_unwind(work) {
            Ok((end, written)) => (end.map_err(|error| error.to_string()), written),
            Err(_) => {
                let defect = "a defect of the daemon".to_owned();
                (Err(defect), queue.progress().0)
            }
        };
        // After a panic the swarm still waits for the queue.
        queue.end(End::Stopped);
        status.count(written, queue.progress().1);
        status.steps_left = queue.steps_left();
        let (phase, reason) = match end {
            Ok(End::Closing) => (Phase::Recording, None),
            Ok(end) => (Phase::Ended, end.reason()),
            Err(reason) => (Phase::Failed, Some(reason)),
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
        let queue = None;
        let entry = Entry { status, queue };
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
        let queue = |state: &State| state.entries.get(name).and_then(|it| it.queue.clone());
        let running = queue(&self.lock());
        let Some(running) = running else {
            // It has not been resumed yet.
            let status = self.find(name)?;
            self.finish(name, status, Phase::Ended, End::Stopped.reason());
            return Ok(());
        };
        running.end(End::Stopped);
        let changed = &self.0.changed;
        let is_running = |state: &mut State| queue(state).is_some();
        let waited = changed.wait_timeout_while(self.lock(), STOP_TIMEOUT, is_running);
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        match queue(&state) {
            Some(_) => Err(RecordError::Ending(name.to_owned())),
            None => Ok(()),
        }
    }

    fn find(&self, name: &str) -> Result<Status, RecordError> {
        let state = self.lock();
        let entry = state.entries.get(name).map(Entry::report);
        entry.ok_or_else(|| RecordError::Unknown(name.to_owned()))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing between two changes can panic.
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A name made of a swarm's and a number.
fn numbered(swarm: &str, number: usize) -> String {
    let number = format!("-{number}");
    let length = swarm.len().min(keys::MAX_NAME_LENGTH - number.len());
    format!("{}{number}", &swarm[..length])
}
