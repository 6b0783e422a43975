//! The named swarms: create, find and remove them, within the limits of the daemon.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZero;
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::{Duration, Instant};

use jostle_physics::plural::counted;
use jostle_physics::simulation::{Reservation, ReserveError, ReserveMemory, Simulation, Spec};
use parking_lot::{Mutex, MutexGuard};
use thiserror::Error;
use tracing::warn;

use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::error::SwarmError;
use crate::swarm::frame::{Frame, Summary};
use crate::swarm::handle::{DeferredReply, Handle, Message, Outcome, Record, Rejection, ReplyTo};
use crate::swarm::metrics::Totals;
use crate::swarm::output::Output;
use crate::swarm::runner::{Built, End, JournalFactory, PersistNew, Playback, SwarmObserver};
use crate::swarm::scheduler::{self, CpuScheduler};
use crate::swarm::sender::Creation;
use crate::swarm::waits::ReservePast;
use crate::swarm::worker::Worker;
use crate::swarm::worker::replay::ReplaySource;

/// Capacity of a swarm's queue; messages beyond it are rejected.
const MAX_MESSAGES: usize = 1024;

/// Memory per individual: its columns, contacts and share of the factor, with the copies that
/// frames and replies hold. Packed groups of 200 to 2000 take 3 to 6 kB an individual. Clarabel's
/// memory in the rare step that falls back to it is not included.
const BYTES_PER_INDIVIDUAL: u64 = 8192;

/// Memory per swarm whatever its size: the used stack of its thread, queues and buffers, its
/// history and scheduled commands. A swarm of 20 without commands takes a third of it.
const BYTES_PER_SWARM: u64 = 1024 * 1024;

/// The earlier states of waits take at most this part of the memory, a quarter: every role may wait.
const PAST_SHARE: u64 = 4;

/// The limits of the daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Individuals in one swarm.
    pub max_individuals: usize,
    /// Swarms at once.
    pub max_swarms: usize,
    /// Memory of all swarms and of the running experiment together, in bytes.
    pub max_memory_bytes: u64,
    /// States published per second and swarm.
    pub max_hz: u32,
}

/// Why a swarm was not created.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[expect(missing_docs, reason = "the messages say when each is returned")]
pub enum RegistryError {
    #[error("another swarm of this name exists: choose another name, or delete it")]
    OtherSpec,
    #[error("an equal swarm of this name exists: set exist_ok to use it")]
    SameSpec,
    #[error(
        "the daemon hosts {} already, its limit: delete one, or raise max_swarms",
        counted(*.0, "swarm")
    )]
    TooManySwarms(usize),
    #[error(
        "the swarm needs up to {needed} bytes, {free} of {limit} are free: make it smaller, \
         delete another, or raise max_memory_mb"
    )]
    TooMuchMemory {
        needed: u64,
        free: u64,
        /// `max_memory_mb` in bytes.
        limit: u64,
    },
    #[error("no thread can be started for the swarm: {0}")]
    NoThread(String),
    #[error("the daemon is stopping")]
    Stopping,
}

/// Called on the thread of a recovered swarm, with its state, before it continues. Returns the controllers of
/// this swarm whose liveliness tokens are declared.
pub type OnRecovered = Box<dyn FnOnce(&Handle, &Arc<Frame>) -> BTreeSet<String> + Send>;

enum StartFrom {
    Spec(Box<dyn PersistNew>),
    /// The checkpoint of another swarm, or a snapshot.
    Checkpoint(Box<Checkpoint>, Box<dyn PersistNew>),
    /// Its own stored checkpoint and journal.
    Journal(Box<ReplaySource>, OnRecovered),
    Recording(Box<dyn Playback>),
}

/// The named swarms of a daemon.
pub struct SwarmRegistry {
    limits: Limits,
    observer: Arc<dyn SwarmObserver>,
    journals: Box<dyn JournalFactory>,
    cores: Arc<CpuScheduler>,
    /// The map and the sum change together under the lock, and nothing in between can panic.
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    swarms: BTreeMap<String, Entry>,
    /// Of the swarms and the experiments.
    memory_bytes: u64,
    experiments_bytes: u64,
    is_stopping: bool,
    ended: Totals,
}

struct Entry {
    handle: Handle,
    memory_bytes: u64,
    /// Of it, that of the earlier states that waits need.
    past_bytes: u64,
    thread: Option<thread::JoinHandle<()>>,
}

/// Whether `create` found or made a swarm.
pub enum Created {
    /// A new one, whose thread replies once it is built.
    New,
    /// An equal one that existed before.
    Existing(Handle),
}

impl SwarmRegistry {
    /// An empty registry.
    pub fn new(
        limits: Limits,
        observer: Arc<dyn SwarmObserver>,
        journals: Box<dyn JournalFactory>,
    ) -> Self {
        let cores = thread::available_parallelism().map_or(1, NonZero::get);
        SwarmRegistry {
            limits,
            observer,
            journals,
            cores: Arc::new(CpuScheduler::new(cores)),
            state: Mutex::default(),
        }
    }

    /// The limits it enforces.
    pub fn limits(&self) -> Limits {
        self.limits
    }

    /// Creates a swarm. Its own thread builds it, and calls the `ReplyTo` that `reply_to` returns when
    /// clients can reach it, or when it could not be built. After an error, and for an existing
    /// swarm, `reply_to` is not called.
    pub fn create(
        self: &Arc<Self>,
        name: &str,
        (spec, creation): (Spec, Creation),
        exist_ok: bool,
        persist: Box<dyn PersistNew>,
        reply_to: impl FnOnce() -> ReplyTo,
    ) -> Result<Created, RegistryError> {
        let mut state = self.lock_running()?;
        if let Some(entry) = state.swarms.get(name) {
            return match (*entry.handle.spec == spec, exist_ok) {
                (true, true) => Ok(Created::Existing(entry.handle.clone())),
                (true, false) => Err(RegistryError::SameSpec),
                (false, _) => Err(RegistryError::OtherSpec),
            };
        }
        let memory_bytes = self.admit(&state, memory_of(spec.n))?;
        let from = StartFrom::Spec(persist);
        let about = (spec, Some(creation));
        self.start(&mut state, name, about, memory_bytes, from, reply_to)?;
        Ok(Created::New)
    }

    /// Creates a swarm from the checkpoint of another one. `reply_to` as in [`Self::create`].
    pub fn create_from_checkpoint(
        self: &Arc<Self>,
        name: &str,
        checkpoint: Checkpoint,
        creation: Creation,
        persist: Box<dyn PersistNew>,
        reply_to: impl FnOnce() -> ReplyTo,
    ) -> Result<(), RegistryError> {
        let mut state = self.lock_vacant(name)?;
        let n = checkpoint.simulation.state.configuration.n();
        let memory_bytes = self.admit(&state, memory_of(n))?;
        let creation = Creation {
            step: checkpoint.simulation.state.step,
            ..creation
        };
        let about = (checkpoint.simulation.spec.clone(), Some(creation));
        let from = StartFrom::Checkpoint(Box::new(checkpoint), persist);
        self.start(&mut state, name, about, memory_bytes, from, reply_to)
    }

    /// Recovers the swarm with this number in the store from its checkpoint and journal, whatever the limits
    /// are now. `reply_to` as
    /// in [`Self::create`].
    pub fn recover(
        self: &Arc<Self>,
        name: &str,
        (about, swarm_id): ((Spec, Option<Creation>), Option<u64>),
        past: ReplaySource,
        on_recovered: OnRecovered,
        reply_to: impl FnOnce() -> ReplyTo,
    ) -> Result<(), RegistryError> {
        let memory_bytes = memory_of(past.checkpoint.simulation.state.configuration.n());
        let from = StartFrom::Journal(Box::new(past), on_recovered);
        let mut state = self.state.lock();
        self.start(&mut state, name, about, memory_bytes, from, reply_to)?;
        if let (Some(entry), Some(id)) = (state.swarms.get(name), swarm_id) {
            let _ = entry.handle.record.swarm_id.set(id);
        }
        Ok(())
    }

    /// Plays a recording under the name of a swarm; it is not persisted. `reply_to` as in
    /// [`Self::create`].
    pub fn play(
        self: &Arc<Self>,
        name: &str,
        playback: Box<dyn Playback>,
        creation: Creation,
        reply_to: impl FnOnce() -> ReplyTo,
    ) -> Result<(), RegistryError> {
        let mut state = self.lock_vacant(name)?;
        let memory_bytes = self.admit(&state, playback.memory_bytes())?;
        let about = (playback.spec().clone(), Some(creation));
        let from = StartFrom::Recording(playback);
        self.start(&mut state, name, about, memory_bytes, from, reply_to)
    }

    fn start(
        self: &Arc<Self>,
        state: &mut State,
        name: &str,
        (spec, creation): (Spec, Option<Creation>),
        memory_bytes: u64,
        from: StartFrom,
        reply_to: impl FnOnce() -> ReplyTo,
    ) -> Result<(), RegistryError> {
        let (messages, taken) = sync_channel(MAX_MESSAGES);
        let handle = Handle {
            spec: Arc::new(spec),
            record: Arc::new(Record {
                creation: creation.map(Arc::new),
                swarm_id: OnceLock::new(),
            }),
            output: Arc::new(Output::new(name.to_owned())),
            history: Arc::default(),
            metrics: Arc::default(),
            messages: Arc::new(messages),
            cores: self.cores.clone(),
            summary: Arc::default(),
            progress: Arc::default(),
        };
        let (registry, swarm, reply_to) = (self.clone(), handle.clone(), reply_to());
        let thread = thread::Builder::new()
            .name(format!("swarm-{name}"))
            .spawn(move || registry.run(&swarm, taken, from, reply_to))
            .map_err(|error| RegistryError::NoThread(error.to_string()))?;
        state.memory_bytes += memory_bytes;
        state.swarms.insert(
            name.to_owned(),
            Entry {
                handle,
                memory_bytes,
                past_bytes: 0,
                thread: Some(thread),
            },
        );
        Ok(())
    }

    /// The swarm of that name.
    pub fn find(&self, name: &str) -> Option<Handle> {
        let state = self.state.lock();
        state.swarms.get(name).map(|entry| entry.handle.clone())
    }

    /// Every swarm that is built, ordered by name.
    pub fn list(&self) -> Vec<(String, Handle, Summary)> {
        let handles = self.handles().0.into_iter();
        let built = handles.filter_map(|(name, handle)| {
            let summary = handle.summary()?;
            Some((name, handle, summary))
        });
        built.collect()
    }

    /// Every swarm, built or not, ordered by name, and the totals of those that have ended.
    pub fn handles(&self) -> (Vec<(String, Handle)>, Totals) {
        let state = self.state.lock();
        let swarms = state.swarms.iter();
        let handles = swarms.map(|(name, entry)| (name.clone(), entry.handle.clone()));
        (handles.collect(), state.ended)
    }

    /// Memory reserved for the swarms and experiments, in bytes.
    pub fn memory_bytes(&self) -> u64 {
        self.state.lock().memory_bytes
    }

    /// Memory reserved for experiments, in bytes.
    pub fn experiments_memory_bytes(&self) -> u64 {
        self.state.lock().experiments_bytes
    }

    /// Memory reserved for the swarms, in bytes.
    pub fn swarms_memory_bytes(&self) -> u64 {
        let state = self.state.lock();
        state.memory_bytes - state.experiments_bytes
    }

    /// Reserves `shared` bytes for experiments, and `each` for as many as fit of `most` runs at a time.
    /// Returns the bytes and the number of runs.
    ///
    /// # Errors
    ///
    /// How many bytes are free, if not even one run fits.
    pub fn reserve_for_experiments(
        &self,
        shared: u64,
        each: u64,
        most: usize,
    ) -> Result<(u64, usize), u64> {
        let mut state = self.state.lock();
        let limit = self.limits.max_memory_bytes;
        let free = limit.saturating_sub(state.memory_bytes);
        let of_runs = free.checked_sub(shared).ok_or(free)?;
        let fit = usize::try_from(of_runs / each.max(1)).unwrap_or(usize::MAX);
        let runs = fit.min(most);
        if runs == 0 {
            return Err(free);
        }
        let bytes = shared + each * runs as u64;
        state.memory_bytes += bytes;
        state.experiments_bytes += bytes;
        Ok((bytes, runs))
    }

    /// Releases bytes that were reserved for experiments.
    pub fn release_of_experiments(&self, bytes: u64) {
        let mut state = self.state.lock();
        state.memory_bytes -= bytes;
        state.experiments_bytes -= bytes;
    }

    /// Releases the name of a swarm that has ended.
    pub fn release(&self, name: &str) {
        let mut state = self.state.lock();
        if let Some(entry) = state.swarms.remove(name) {
            state.memory_bytes -= entry.memory_bytes;
            state.ended.add(&entry.handle.totals());
        }
    }

    /// Ends every swarm between two steps and waits for their threads, at most `timeout`. Returns
    /// how many still run.
    pub fn stop(&self, timeout: Duration) -> usize {
        let mut running: Vec<thread::JoinHandle<()>> = {
            let mut state = self.state.lock();
            state.is_stopping = true;
            let entries = state.swarms.values_mut();
            entries
                .filter_map(|entry| {
                    // A swarm with a full queue ends too: the last handle goes with this registry.
                    entry.handle.send(Message::Stop);
                    entry.thread.take()
                })
                .collect()
        };
        let deadline = Instant::now() + timeout;
        loop {
            running.retain(|thread| !thread.is_finished());
            if running.is_empty() || Instant::now() >= deadline {
                return running.len();
            }
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// Admits one more swarm and its memory before any of it is allocated.
    fn admit(&self, state: &State, needed: u64) -> Result<u64, RegistryError> {
        let limits = &self.limits;
        if state.swarms.len() >= limits.max_swarms {
            return Err(RegistryError::TooManySwarms(limits.max_swarms));
        }
        let limit = limits.max_memory_bytes;
        let free = limit.saturating_sub(state.memory_bytes);
        if needed > free {
            return Err(RegistryError::TooMuchMemory {
                needed,
                free,
                limit,
            });
        }
        Ok(needed)
    }

    /// Reserves memory for a swarm whose size is to change.
    fn reserve(&self, name: &str, size: Reservation) -> Result<(), ReserveError> {
        let limit = self.limits.max_individuals;
        let n = match size {
            Reservation::Grow(n) if n > limit => return Err(ReserveError::TooMany { n, limit }),
            Reservation::Grow(n) | Reservation::Return(n) => n,
        };
        let mut state = self.state.lock();
        let Some(entry) = state.swarms.get(name) else {
            return Ok(());
        };
        let needed = memory_of(n).saturating_add(entry.past_bytes);
        let before = entry.memory_bytes;
        let others = state.memory_bytes - before;
        let free = self.limits.max_memory_bytes.saturating_sub(others);
        // A smaller size is always admitted, whatever memory the other swarms have reserved.
        if needed > free && needed > before {
            return Err(ReserveError::NoMemory { n, needed, free });
        }
        state.set_memory(name, needed);
        Ok(())
    }

    /// Reserves memory for the earlier states that the waits of a swarm need, in place of that before. Those of
    /// all swarms take at most a share of the memory, so that a user who may only wait does not prevent new swarms.
    fn reserve_past(&self, name: &str, bytes: u64) -> Result<(), SwarmError> {
        let mut state = self.state.lock();
        let max = self.limits.max_memory_bytes;
        let pasts: u64 = state.swarms.values().map(|it| it.past_bytes).sum();
        let free = max.saturating_sub(state.memory_bytes);
        let free = free.min((max / PAST_SHARE).saturating_sub(pasts));
        let Some(entry) = state.swarms.get_mut(name) else {
            return Ok(());
        };
        let before = entry.past_bytes;
        if bytes.saturating_sub(before) > free {
            let needed = bytes;
            return Err(SwarmError::NoMemoryOfPast { needed, free });
        }
        entry.past_bytes = bytes;
        let needed = entry.memory_bytes - before + bytes;
        state.set_memory(name, needed);
        Ok(())
    }

    fn run(
        self: &Arc<Self>,
        handle: &Handle,
        taken: Receiver<Message>,
        from: StartFrom,
        reply_to: ReplyTo,
    ) {
        let name = &handle.output.name;
        // Without the right to it, the thread keeps its priority.
        let _ = scheduler::lower_priority();
        let end = match self.build(handle, from) {
            Ok(Ok(((stamp, frame), runner))) => {
                let reply = DeferredReply::new(reply_to, Ok((stamp, Outcome::State(frame))));
                self.observer.started(name, reply);
                runner.run(&taken)
            }
            Ok(Err(end)) => end,
            Err(error) => {
                let answered = Err(Rejection { step: None, error });
                End::Deleted(DeferredReply::new(reply_to, answered))
            }
        };
        // From here on a sender gets `SwarmError::Gone`.
        drop(taken);
        if let End::Deleted(reply) = end {
            self.observer.ended(name, reply);
        }
    }

    /// Builds a swarm and persists it if it is new. Returns its end if its journal contains it.
    fn build(
        self: &Arc<Self>,
        handle: &Handle,
        from: StartFrom,
    ) -> Result<Result<Built, End>, SwarmError> {
        let name = &handle.output.name;
        let (registry, swarm) = (self.clone(), name.clone());
        let reserve: ReserveMemory = Box::new(move |size| registry.reserve(&swarm, size));
        let (registry, swarm) = (self.clone(), name.clone());
        let reserve_past: ReservePast = Box::new(move |bytes| registry.reserve_past(&swarm, bytes));
        let min_interval = Duration::from_secs(1) / self.limits.max_hz.max(1);
        let writer = self.journals.open(name);
        let (checkpoint, persist) = match from {
            StartFrom::Spec(persist) => {
                let simulation = Simulation::new(&handle.spec)?;
                (Checkpoint::start(simulation.checkpoint()), persist)
            }
            StartFrom::Checkpoint(checkpoint, persist) => (*checkpoint, persist),
            StartFrom::Journal(past, on_recovered) => {
                let (mut worker, _, end) = past.fold(handle, min_interval, writer);
                if let Some(end) = end {
                    return Ok(Err(end));
                }
                self.state.lock().set_memory(name, memory_of(worker.n()));
                worker.set_reserve_of_waits(reserve_past);
                if let Err(fault) = worker.resume(reserve) {
                    warn!(swarm = name, %fault, "failed to journal the restart");
                }
                let (stamp, frame) = worker.stamp_and_frame();
                // Later changes are messages to this swarm, which the registry contains by now.
                worker.await_tokens(&on_recovered(handle, &frame));
                return Ok(Ok(((stamp, frame), Box::new(worker))));
            }
            StartFrom::Recording(playback) => {
                let built = playback.start(handle, min_interval)?;
                handle.log_creation();
                return Ok(Ok(built));
            }
        };
        let writer = (writer, reserve);
        let ignored = &|_: &_| ReplyTo::ignored();
        let mut worker = Worker::restore(checkpoint, handle, min_interval, writer, ignored);
        worker.set_reserve_of_waits(reserve_past);
        worker.publish_created(handle.record.creation.clone());
        let (stamp, frame) = worker.stamp_and_frame();
        let creation = handle.record.creation.as_deref();
        let persisted = persist.persist(creation, &worker.checkpoint(), &stamp, &frame);
        if let Some(id) = persisted.map_err(SwarmError::NotDurable)? {
            let _ = handle.record.swarm_id.set(id);
        }
        handle.log_creation();
        Ok(Ok((worker.stamp_and_frame(), Box::new(worker))))
    }

    /// Locks the state to add a swarm.
    fn lock_running(&self) -> Result<MutexGuard<'_, State>, RegistryError> {
        let state = self.state.lock();
        match state.is_stopping {
            true => Err(RegistryError::Stopping),
            false => Ok(state),
        }
    }

    /// Locks the state to add a swarm whose name must not be taken.
    fn lock_vacant(&self, name: &str) -> Result<MutexGuard<'_, State>, RegistryError> {
        let state = self.lock_running()?;
        match state.swarms.contains_key(name) {
            true => Err(RegistryError::OtherSpec),
            false => Ok(state),
        }
    }
}

impl State {
    fn set_memory(&mut self, name: &str, needed: u64) {
        if let Some(entry) = self.swarms.get_mut(name) {
            let before = std::mem::replace(&mut entry.memory_bytes, needed);
            self.memory_bytes = self.memory_bytes - before + needed;
        }
    }
}

/// Memory that is reserved for a swarm of `n` individuals, in bytes.
pub fn memory_of(n: usize) -> u64 {
    (n as u64)
        .saturating_mul(BYTES_PER_INDIVIDUAL)
        .saturating_add(BYTES_PER_SWARM)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_memory_of_any_number_of_individuals_is_a_number() {
        assert!((BYTES_PER_SWARM..2 * BYTES_PER_SWARM).contains(&memory_of(50)));
        assert_eq!(memory_of(usize::MAX), u64::MAX);
    }
}
