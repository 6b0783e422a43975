//! The recordings of a daemon: every k-th state of a swarm, in its data directory.
//!
//! Each has its own folder and its own thread, which writes what a tap on the swarm's outlet
//! enqueues. By default the swarm waits for that thread, never for a client. A running recording
//! resumes with its next part when the daemon restarts.

mod error;
mod intake;
mod scribe;
mod shelf;
mod source;

use std::collections::BTreeMap;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, SystemTime};

use fail::fail_point;
use jostle_proto::keys;
pub use jostle_results::recording::Format;
use jostle_results::recording::{Recorder, RecordingError, Written, parts, sweep};
use serde::{Deserialize, Serialize};
use tracing::{info, warn};

pub use self::error::RecordError;
use self::intake::{End, Intake};
use self::scribe::Scribe;
use self::shelf::Shelf;
pub use self::shelf::Standing;
pub use self::source::Source;
use crate::convert::WordRefusal;

/// The most recordings that go on at once.
const MOST_GOING: usize = 64;

/// The most recordings that are kept: a list of them fits a message.
const MOST: usize = 1000;

/// The niceness of the writer thread of a recording for which no swarm waits: lower priority than
/// the swarms, which it must not delay.
const NICENESS: i32 = 10;

/// The longest piece of a part that is read at once, in bytes.
const MAX_PIECE: u64 = 512 * 1024;

/// How long the end of a recording is waited for, which is a matter of the disk.
const PATIENCE: Duration = Duration::from_secs(3);

/// What a recording is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// It goes on.
    Recording,
    /// It was stopped, or its swarm was deleted.
    Ended,
    /// It cannot go on.
    Failed,
}

/// What is to be recorded, and how.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// What to call it; the swarm's name and a number if not given.
    pub name: Option<String>,
    /// How it is written.
    pub format: Format,
    /// The bytes from which on it ends.
    pub max_bytes: u64,
    /// Whether a client that fetches it deletes it.
    pub temporary: bool,
}

/// A piece of a whole part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece {
    /// How many parts are whole.
    pub parts: u64,
    /// How long the part is, in bytes.
    pub length: u64,
    /// What it holds from the offset on.
    pub bytes: Vec<u8>,
}

/// The bytes of all recordings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// How many go on.
    pub recording: usize,
    /// Their bytes and those of the others.
    pub bytes: u64,
    /// The bytes that they may have.
    pub quota_bytes: u64,
}

/// The recordings of a daemon. Clones are the same ones. Whoever changes something is to do so in
/// turn.
#[derive(Clone)]
pub struct Recordings(Arc<Shared>);

/// Called when a recording has failed, with its swarm's name, its own and the reason.
pub type OnFailed = Box<dyn Fn(&str, &str, &str) + Send + Sync>;

struct Shared {
    shelf: Shelf,
    word: WordRefusal,
    on_failed: OnFailed,
    quota_bytes: u64,
    kept: Mutex<Kept>,
    changed: Condvar,
}

#[derive(Default)]
struct Kept {
    entries: BTreeMap<String, Entry>,
    is_stopping: bool,
}

struct Entry {
    standing: Standing,
    /// What is written, while it is.
    going: Option<Arc<Intake>>,
}

impl Entry {
    /// Whether it went on when the daemon ended, and does not yet again.
    fn is_interrupted(&self) -> bool {
        self.standing.phase == Phase::Recording && self.going.is_none()
    }

    fn report(&self) -> Standing {
        let mut standing = self.standing.clone();
        if let Some(intake) = &self.going {
            let (written, missed) = intake.progress();
            standing.take(written, missed);
        }
        standing
    }

    /// The bytes of its files, that of the part in hand included.
    fn size(&self) -> u64 {
        match &self.going {
            Some(intake) => intake.size(),
            None => self.standing.bytes,
        }
    }
}

impl Standing {
    fn take(&mut self, written: Written, missed: u64) {
        let Written {
            frames,
            parts,
            bytes,
        } = written;
        (self.frames, self.parts, self.bytes) = (frames, parts, bytes);
        self.missed = missed;
    }
}

impl Recordings {
    /// Opens the recordings in a folder. Those that went on wait for [`Recordings::go_on`].
    ///
    /// # Errors
    ///
    /// When the folder cannot be used.
    pub fn open(
        folder: &Path,
        word: WordRefusal,
        quota_bytes: u64,
        on_failed: OnFailed,
    ) -> io::Result<Self> {
        let shelf = Shelf::open(folder)?;
        let mut kept = Kept::default();
        for (name, standing) in shelf.list()? {
            match standing {
                Ok(standing) if keys::is_name(&name) => {
                    let going = None;
                    kept.entries.insert(name, Entry { standing, going });
                }
                Ok(_) => {}
                Err(error) => warn!(recording = name, %error, "cannot tell how it stands"),
            }
        }
        Ok(Recordings(Arc::new(Shared {
            shelf,
            word,
            on_failed,
            quota_bytes,
            kept: Mutex::new(kept),
            changed: Condvar::new(),
        })))
    }

    /// Begins a recording; without a name it is given one.
    ///
    /// # Errors
    ///
    /// [`RecordError`].
    pub fn begin(
        &self,
        wanted: &Wanted,
        source: Source,
    ) -> Result<(String, Standing), RecordError> {
        let format = wanted.format;
        let name = self.admit(wanted.name.as_deref(), &source.swarm)?;
        let began = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let standing = Standing {
            swarm: source.swarm.clone(),
            format,
            every: Some(source.choice.every),
            drop_when_behind: source.choice.drops,
            max_bytes: Some(wanted.max_bytes),
            steps_left: source.choice.steps,
            temporary: wanted.temporary,
            phase: Phase::Recording,
            reason: None,
            frames: 0,
            missed: 0,
            parts: 0,
            bytes: 0,
            began_unix_secs: began.unwrap_or_default().as_secs(),
        };
        let folder = self.0.shelf.folder(&name);
        let about = source.about(&standing);
        let recorder =
            Recorder::to_folder(&folder, format, about).map_err(|error| match error {
                RecordingError::Exists { .. } => RecordError::Exists(name.clone()),
                error => error.into(),
            })?;
        let begun = match self.0.shelf.note(&name, &standing) {
            Ok(()) => self.write(&name, standing, source, recorder),
            Err(error) => Err(error.into()),
        };
        if let Err(error) = begun {
            let _ = self.0.shelf.remove(&name);
            return Err(error);
        }
        let standing = self.find(&name)?;
        info!(recording = name, swarm = standing.swarm, "began to record");
        Ok((name, standing))
    }

    /// Ends a recording; what was recorded is kept.
    ///
    /// # Errors
    ///
    /// [`RecordError`].
    pub fn stop(&self, name: &str) -> Result<Standing, RecordError> {
        match self.find(name)?.phase {
            Phase::Ended => {}
            Phase::Failed => return Err(RecordError::Failed(name.to_owned())),
            Phase::Recording => self.end(name)?,
        }
        self.find(name)
    }

    /// Removes a recording with its files; how it stood.
    ///
    /// # Errors
    ///
    /// [`RecordError`].
    pub fn delete(&self, name: &str) -> Result<Standing, RecordError> {
        if self.find(name)?.phase == Phase::Recording {
            self.end(name)?;
        }
        let standing = self.find(name)?;
        self.0.shelf.remove(name)?;
        self.lock().entries.remove(name);
        info!(recording = name, "deleted");
        Ok(standing)
    }

    /// Those that went on when the daemon ended, and are to go on now: each with its name.
    pub fn interrupted(&self) -> Vec<(String, Standing)> {
        let kept = self.lock();
        let entries = kept.entries.iter();
        let interrupted = entries.filter(|(_, it)| it.is_interrupted());
        interrupted
            .map(|(name, it)| (name.clone(), it.standing.clone()))
            .collect()
    }

    /// Has a recording go on that went on when the daemon ended; without a source it is over.
    pub fn go_on(&self, name: &str, source: Option<Source>) {
        let standing = match self.lock() {
            kept if kept.is_stopping => return,
            kept => match kept.entries.get(name) {
                // It may have been stopped or deleted meanwhile.
                Some(entry) if entry.is_interrupted() => entry.standing.clone(),
                _ => return,
            },
        };
        let folder = self.0.shelf.folder(name);
        let mut counted = standing.clone();
        let opened = sweep(&folder).and_then(|removed| {
            let about = source.as_ref().map(|source| source.about(&standing));
            let recorder = Recorder::go_on(&folder, standing.format, about.unwrap_or_default())?;
            counted.take(recorder.written(), standing.missed);
            Ok((removed.len(), recorder))
        });
        let result = match (opened, source) {
            (Ok((removed, recorder)), Some(source)) => {
                let part = counted.parts;
                info!(recording = name, part, removed, "goes on, with a new part");
                source.intake.note(recorder.written(), recorder.size());
                let begun = self.write(name, counted.clone(), source, recorder);
                begun.map_err(|error| (Phase::Failed, error.to_string()))
            }
            (Ok(_), None) => {
                let reason = "its swarm was gone when the daemon came back";
                Err((Phase::Ended, reason.to_owned()))
            }
            (Err(error), _) => Err((Phase::Failed, error.to_string())),
        };
        if let Err((phase, reason)) = result {
            self.settle(name, counted, phase, reason);
        }
    }

    /// The whole parts of a recording, in order; none if there is no such recording.
    pub fn parts(&self, name: &str) -> Vec<PathBuf> {
        parts(&self.0.shelf.folder(name)).unwrap_or_default()
    }

    /// A piece of a whole part, which counts from 0.
    ///
    /// # Errors
    ///
    /// [`RecordError`].
    pub fn piece(&self, name: &str, part: u64, offset: u64) -> Result<Piece, RecordError> {
        self.find(name)?;
        let all = parts(&self.0.shelf.folder(name))?;
        let parts = all.len() as u64;
        let Some(path) = usize::try_from(part).ok().and_then(|part| all.get(part)) else {
            let name = name.to_owned();
            return Err(RecordError::NoPart { name, part, parts });
        };
        let (length, bytes) = shelf::piece(path, offset, MAX_PIECE)?;
        if offset > length {
            return Err(RecordError::NoOffset {
                name: name.to_owned(),
                part,
                offset,
                length,
            });
        }
        Ok(Piece {
            parts,
            length,
            bytes,
        })
    }

    /// The bytes of all recordings.
    pub fn usage(&self) -> Usage {
        let kept = self.lock();
        Usage {
            recording: kept
                .entries
                .values()
                .filter(|it| it.going.is_some())
                .count(),
            bytes: kept.entries.values().map(Entry::size).sum(),
            quota_bytes: self.0.quota_bytes,
        }
    }

    /// How all recordings stand, by name.
    pub fn list(&self) -> Vec<(String, Standing)> {
        let kept = self.lock();
        let entries = kept.entries.iter();
        entries
            .map(|(name, entry)| (name.clone(), entry.report()))
            .collect()
    }

    /// Ends the parts in hand; what goes on goes on when the daemon starts anew. The number of
    /// those that are not done in time: a part of theirs is lost.
    pub fn close(&self, patience: Duration) -> usize {
        let mut kept = self.lock();
        kept.is_stopping = true;
        for intake in kept.entries.values().filter_map(|it| it.going.as_ref()) {
            intake.end(End::Closing);
        }
        let going = |kept: &Kept| {
            kept.entries
                .values()
                .filter(|it| it.going.is_some())
                .count()
        };
        let changed = &self.0.changed;
        let waited = changed.wait_timeout_while(kept, patience, |kept| going(kept) > 0);
        going(&waited.unwrap_or_else(PoisonError::into_inner).0)
    }

    /// The name of a new recording, if there may be one.
    fn admit(&self, name: Option<&str>, swarm: &str) -> Result<String, RecordError> {
        let Usage {
            bytes, quota_bytes, ..
        } = self.usage();
        if bytes >= quota_bytes {
            let (used, quota) = (bytes, quota_bytes);
            return Err(RecordError::OverQuota { used, quota });
        }
        let kept = self.lock();
        let entries = &kept.entries;
        if kept.is_stopping {
            return Err(RecordError::Stopping);
        }
        let going = entries.values().filter(|it| it.going.is_some()).count();
        if going >= MOST_GOING {
            return Err(RecordError::TooMany(going));
        }
        if entries.len() >= MOST {
            return Err(RecordError::TooManyKept(entries.len()));
        }
        let is_there = |name: &str| entries.contains_key(name) || self.0.shelf.has(name);
        match name {
            Some(name) if is_there(name) => Err(RecordError::Exists(name.to_owned())),
            Some(name) => Ok(name.to_owned()),
            None => {
                let mut names = (1..).map(|number| numbered(swarm, number));
                Ok(names.find(|name| !is_there(name)).unwrap_or_default())
            }
        }
    }

    /// Starts the thread that writes a recording.
    fn write(
        &self,
        name: &str,
        standing: Standing,
        source: Source,
        recorder: Recorder,
    ) -> Result<(), RecordError> {
        let Source {
            swarm, intake, tap, ..
        } = source;
        let recordings = self.clone();
        let scribe = Scribe {
            swarm,
            format: standing.format,
            word: self.0.word,
            intake: intake.clone(),
            recorder,
            max_bytes: standing.max_bytes,
            over_quota: Box::new(move || {
                let Usage {
                    bytes, quota_bytes, ..
                } = recordings.usage();
                (bytes >= quota_bytes).then_some(End::OverQuota { quota_bytes })
            }),
        };
        let entry = Entry {
            standing: standing.clone(),
            going: Some(intake),
        };
        // It is there before its thread can say that it has ended.
        self.lock().entries.insert(name.to_owned(), entry);
        let (recordings, of) = (self.clone(), name.to_owned());
        let work = move || {
            if standing.drop_when_behind {
                // Zero names the calling thread. Where it is not permitted it ranks like the rest.
                let _ = rustix::process::setpriority_process(None, NICENESS);
            }
            recordings.record(&of, standing, scribe);
            drop(tap);
        };
        let thread = thread::Builder::new().name(format!("record-{name}"));
        let spawned = thread.spawn(work);
        spawned.map(drop).map_err(|error| {
            self.lock().entries.remove(name);
            RecordError::NoThread(error.to_string())
        })
    }

    /// A recording from its beginning to its end, on its own thread.
    fn record(&self, name: &str, mut standing: Standing, scribe: Scribe) {
        let intake = scribe.intake.clone();
        let noted = |written, missed| {
            let mut standing = standing.clone();
            standing.take(written, missed);
            standing.steps_left = intake.steps_left();
            // Its files tell how much there is.
            if let Err(error) = self.0.shelf.note(name, &standing) {
                warn!(recording = name, %error, "failed to write down how it stands");
            }
        };
        let outcome = catch_unwind(AssertUnwindSafe(|| scribe.write(noted)));
        // A swarm that waits for a writer that panicked steps on.
        intake.end(End::Stopped);
        let (_, missed) = intake.progress();
        let (outcome, written) = match outcome {
            Ok((outcome, written)) => (outcome.map_err(|error| error.to_string()), written),
            Err(_) => (
                Err("a defect of the daemon".to_owned()),
                intake.progress().0,
            ),
        };
        standing.take(written, missed);
        standing.steps_left = intake.steps_left();
        let (phase, reason) = match outcome {
            Ok(End::Closing) => (Phase::Recording, String::new()),
            Ok(End::Stopped) => (Phase::Ended, "stopped".to_owned()),
            Ok(End::Deleted) => (Phase::Ended, "its swarm was deleted".to_owned()),
            Ok(End::Complete) => (Phase::Ended, "all its steps are recorded".to_owned()),
            Ok(End::Full { max_bytes }) => (
                Phase::Ended,
                format!(
                    "its next states could exceed max_bytes ({max_bytes}): record again with a \
                     higher limit"
                ),
            ),
            Ok(End::OverQuota { quota_bytes }) => (
                Phase::Ended,
                format!(
                    "the daemon's recordings have reached their {} MiB (recordings_quota_mb)",
                    quota_bytes >> 20
                ),
            ),
            Err(reason) => (Phase::Failed, reason),
        };
        self.settle(name, standing, phase, reason);
    }

    /// Writes down how a recording stands that nothing more comes of.
    fn settle(&self, name: &str, mut standing: Standing, phase: Phase, reason: String) {
        match phase {
            Phase::Recording => {}
            Phase::Ended => info!(recording = name, reason, "ended"),
            Phase::Failed => warn!(recording = name, reason, "failed to record on"),
        }
        standing.phase = phase;
        standing.reason = Some(reason).filter(|it| !it.is_empty());
        fail_point!("recording-settled");
        if let Err(error) = self.0.shelf.note(name, &standing) {
            warn!(recording = name, %error, "failed to write down how it stands");
        }
        let going = None;
        let failed = (phase == Phase::Failed).then(|| standing.clone());
        let mut kept = self.lock();
        kept.entries
            .insert(name.to_owned(), Entry { standing, going });
        self.0.changed.notify_all();
        drop(kept);
        if let Some(Standing { swarm, reason, .. }) = failed {
            (self.0.on_failed)(&swarm, name, &reason.unwrap_or_default());
        }
    }

    /// Ends a recording that goes on, and waits for that.
    fn end(&self, name: &str) -> Result<(), RecordError> {
        let going = {
            let kept = self.lock();
            kept.entries.get(name).map(|entry| entry.going.clone())
        };
        let Some(Some(intake)) = going else {
            // It was about to go on again.
            let standing = self.find(name)?;
            self.settle(name, standing, Phase::Ended, "stopped".to_owned());
            return Ok(());
        };
        intake.end(End::Stopped);
        let is_going = |kept: &mut Kept| {
            let entry = kept.entries.get(name);
            entry.is_some_and(|entry| entry.going.is_some())
        };
        let changed = &self.0.changed;
        let waited = changed.wait_timeout_while(self.lock(), PATIENCE, is_going);
        let (mut kept, _) = waited.unwrap_or_else(PoisonError::into_inner);
        match is_going(&mut kept) {
            true => Err(RecordError::Ending(name.to_owned())),
            false => Ok(()),
        }
    }

    fn find(&self, name: &str) -> Result<Standing, RecordError> {
        let kept = self.lock();
        let entry = kept.entries.get(name);
        entry
            .map(Entry::report)
            .ok_or_else(|| RecordError::Unknown(name.to_owned()))
    }

    fn lock(&self) -> MutexGuard<'_, Kept> {
        // Nothing between two changes can panic.
        self.0.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A name made of a swarm's and a number.
fn numbered(swarm: &str, number: usize) -> String {
    let number = format!("-{number}");
    let length = swarm.len().min(keys::MAX_NAME_LENGTH - number.len());
    format!("{}{number}", &swarm[..length])
}
