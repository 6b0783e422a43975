//! The named swarms: create, find, remove, and what they may take.

use std::collections::BTreeMap;
use std::num::NonZero;
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use jostle_physics::plural::counted;
use jostle_physics::simulation::{Reservation, ReserveError, ReserveMemory, Simulation, Spec};
use thiserror::Error;
use tracing::warn;

use crate::playback::film::Film;
use crate::playback::player::Player;
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::cpu_scheduler::CpuScheduler;
use crate::swarm::error::OrderError;
use crate::swarm::error::WriteFault;
use crate::swarm::frame::{Frame, Place, Summary};
use crate::swarm::handle::{Handle, Ticket};
use crate::swarm::journal::{JournalWriter, NoWriter};
use crate::swarm::outcome::{Answer, Outcome, Refusal};
use crate::swarm::outlet::Outlet;
use crate::swarm::tally::Totals;
use crate::swarm::thread_priority;
use crate::swarm::worker::replay::{Past, Replay};
use crate::swarm::worker::{End, Worker};

/// Orders that may wait for one swarm; what comes on top is refused at once.
const MOST_TICKETS: usize = 1024;

/// How much lower than the rest of the daemon (its niceness) a thread ranks that tells a past again:
/// below the swarms that are there.
const RETELLING_NICENESS: i32 = 15;

/// Memory per individual: its columns, contacts and share of the factor, with the copies that
/// frames and replies hold. Packed groups of 200 to 2000 take 3 to 6 kB an individual. What
/// Clarabel takes in the rare step that is given to it comes on top.
const BYTES_PER_INDIVIDUAL: u64 = 8192;

/// Memory per swarm whatever its size: its thread's stack in use, queues and buffers, its history
/// and the commands that wait for their step. A swarm of 20 that nobody commands takes a third.
const BYTES_PER_SWARM: u64 = 1024 * 1024;

/// What the daemon refuses to go beyond.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Individuals in one swarm.
    pub max_individuals: usize,
    /// Swarms at once.
    pub max_swarms: usize,
    /// Memory of all swarms together, in bytes.
    pub max_memory_bytes: u64,
    /// States published per second and swarm.
    pub max_hz: u32,
}

/// Why a swarm was not created.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum HostError {
    /// The name is taken.
    #[error("another swarm of this name exists: choose another name, or delete it")]
    OtherSpec,
    /// The name is taken by an equal one.
    #[error("an equal swarm of this name exists: take it with exist_ok")]
    SameSpec,
    /// There are as many swarms as there may be.
    #[error(
        "the daemon hosts {} already, its limit: delete one, or raise max_swarms",
        counted(*.limit, "swarm")
    )]
    TooManySwarms {
        /// The limit.
        limit: usize,
    },
    /// The memory set aside for swarms does not allow it.
    #[error(
        "the swarm needs up to {needed} bytes, {free} of {limit} are free: make it smaller, \
         delete another, or raise max_memory_mb"
    )]
    TooMuchMemory {
        /// What it needs.
        needed: u64,
        /// What is free.
        free: u64,
        /// What there is.
        limit: u64,
    },
    /// No thread could be started.
    #[error("no thread can be started for the swarm: {0}")]
    NoThread(String),
    /// The daemon stops.
    #[error("the daemon is stopping")]
    Stopping,
}

/// Makes a new swarm safe before anyone is told of it: its name, what it is and where it is.
pub type Register =
    Box<dyn FnOnce(&Checkpoint, &Place, &Arc<Frame>) -> Result<(), WriteFault> + Send>;

/// What a swarm's journal is written by.
pub type Archive = Box<dyn Fn(&str) -> Arc<dyn JournalWriter> + Send + Sync>;

/// Where a swarm begins.
enum Beginning {
    /// From its recipe.
    Spec(Register),
    /// As another swarm was, or a snapshot.
    Copy(Box<Checkpoint>, Register),
    /// From what is left of it.
    Past(Box<Past>),
    /// It is a recording.
    Film(Box<dyn Film>),
}

/// What a thread hosts under a name.
enum Guest {
    Swarm(Box<Worker>),
    Film(Box<Player>),
}

/// A recording to be shown.
pub struct Showing {
    /// The recording.
    pub film: Box<dyn Film>,
    /// What the recorded swarm was made from.
    pub recipe: Spec,
    /// The size of the largest group in it.
    pub most_individuals: usize,
    /// What it takes in memory, beside a frame.
    pub bytes: u64,
}

/// What tells the world of a swarm's beginning and end. Called from the swarm's thread.
pub trait Herald: Send + Sync + 'static {
    /// Something was put in the swarm's outlet after it had been emptied.
    fn ring(&self, name: &str);
    /// Whether anyone reads the frames of a swarm that moves or does not: see
    /// [`Outlet::is_watched`].
    fn is_watched(&self, name: &str, is_moving: bool) -> bool;
    /// The swarm is built: `built` is to be called once it can be reached.
    fn begun(&self, name: &str, built: Box<dyn FnOnce() + Send>);
    /// The swarm has ended: `ended` is to be called once it can no longer be reached. Only then
    /// is the name to be released.
    fn ended(&self, name: &str, ended: Box<dyn FnOnce() + Send>);
}

/// The named swarms of a daemon.
pub struct Host {
    limits: Limits,
    herald: Arc<dyn Herald>,
    archive: Archive,
    cores: Arc<CpuScheduler>,
    hosted: Mutex<Hosted>,
}

#[derive(Default)]
struct Hosted {
    swarms: BTreeMap<String, Entry>,
    memory_bytes: u64,
    stopping: bool,
    /// What swarms counted that are gone.
    past: Totals,
}

struct Entry {
    handle: Handle,
    memory_bytes: u64,
    thread: Option<thread::JoinHandle<()>>,
}

/// Whether `create` found or made a swarm.
pub enum Created {
    /// A new one, whose thread answers once it is built.
    New,
    /// An equal one that was there already.
    Existing(Handle),
}

impl Host {
    /// An empty host.
    pub fn new(limits: Limits, herald: Arc<dyn Herald>, archive: Archive) -> Self {
        let cores = thread::available_parallelism().map_or(1, NonZero::get);
        Host {
            limits,
            herald,
            archive,
            cores: Arc::new(CpuScheduler::new(cores)),
            hosted: Mutex::default(),
        }
    }

    /// The limits it enforces.
    pub fn limits(&self) -> Limits {
        self.limits
    }

    /// Creates a swarm. Its own thread builds it, and gives the answer that `promise` makes when
    /// it can be reached, or when it could not be built.
    ///
    /// # Errors
    ///
    /// [`HostError`]; nothing is promised then, nor for an existing swarm.
    pub fn create(
        self: &Arc<Self>,
        name: &str,
        recipe: Spec,
        exist_ok: bool,
        register: Register,
        promise: impl FnOnce() -> Answer,
    ) -> Result<Created, HostError> {
        let mut hosted = self.lock();
        if hosted.stopping {
            return Err(HostError::Stopping);
        }
        if let Some(entry) = hosted.swarms.get(name) {
            return match (*entry.handle.recipe == recipe, exist_ok) {
                (true, true) => Ok(Created::Existing(entry.handle.clone())),
                (true, false) => Err(HostError::SameSpec),
                (false, _) => Err(HostError::OtherSpec),
            };
        }
        let memory_bytes = self.admit(&hosted, recipe.n)?;
        let beginning = Beginning::Spec(register);
        self.begin(&mut hosted, name, recipe, memory_bytes, beginning, promise)?;
        Ok(Created::New)
    }

    /// Creates a swarm that begins as another one was at a checkpoint.
    ///
    /// # Errors
    ///
    /// [`HostError`]; nothing is promised then.
    pub fn copy(
        self: &Arc<Self>,
        name: &str,
        checkpoint: Checkpoint,
        register: Register,
        promise: impl FnOnce() -> Answer,
    ) -> Result<(), HostError> {
        let mut hosted = self.lock();
        if hosted.stopping {
            return Err(HostError::Stopping);
        }
        if hosted.swarms.contains_key(name) {
            return Err(HostError::OtherSpec);
        }
        let memory_bytes = self.admit(&hosted, checkpoint.simulation.state.configuration.n())?;
        let recipe = checkpoint.simulation.spec.clone();
        let beginning = Beginning::Copy(Box::new(checkpoint), register);
        self.begin(&mut hosted, name, recipe, memory_bytes, beginning, promise)
    }

    /// Brings a swarm back from what is left of it, whatever the limits are now: what there was is
    /// not given up. `promise` is kept once it is as it was, and can be reached.
    ///
    /// # Errors
    ///
    /// [`HostError::NoThread`].
    pub fn recover(
        self: &Arc<Self>,
        name: &str,
        recipe: Spec,
        past: Past,
        promise: impl FnOnce() -> Answer,
    ) -> Result<(), HostError> {
        let mut hosted = self.lock();
        let memory_bytes = memory_of(past.checkpoint.simulation.state.configuration.n());
        let beginning = Beginning::Past(Box::new(past));
        self.begin(&mut hosted, name, recipe, memory_bytes, beginning, promise)
    }

    /// Shows a recording as if it were a swarm. Nothing of it outlives the daemon.
    ///
    /// # Errors
    ///
    /// [`HostError`]; nothing is promised then.
    pub fn show(
        self: &Arc<Self>,
        name: &str,
        showing: Showing,
        promise: impl FnOnce() -> Answer,
    ) -> Result<(), HostError> {
        let mut hosted = self.lock();
        if hosted.stopping {
            return Err(HostError::Stopping);
        }
        if hosted.swarms.contains_key(name) {
            return Err(HostError::OtherSpec);
        }
        let needed = memory_of(showing.most_individuals).saturating_add(showing.bytes);
        self.admit_bytes(&hosted, needed)?;
        let beginning = Beginning::Film(showing.film);
        self.begin(
            &mut hosted,
            name,
            showing.recipe,
            needed,
            beginning,
            promise,
        )
    }

    /// Starts a swarm's thread.
    fn begin(
        self: &Arc<Self>,
        hosted: &mut Hosted,
        name: &str,
        recipe: Spec,
        memory_bytes: u64,
        beginning: Beginning,
        promise: impl FnOnce() -> Answer,
    ) -> Result<(), HostError> {
        let (tickets, taken) = sync_channel(MOST_TICKETS);
        let bell = (self.herald.clone(), name.to_owned());
        let watch = bell.clone();
        let outlet = Outlet::new(
            name.to_owned(),
            move || bell.0.ring(&bell.1),
            move |is_moving| watch.0.is_watched(&watch.1, is_moving),
        );
        let handle = Handle {
            recipe: Arc::new(recipe),
            outlet: Arc::new(outlet),
            history: Arc::default(),
            tally: Arc::default(),
            tickets: Arc::new(tickets),
            cores: self.cores.clone(),
            summary: Arc::default(),
        };
        let thread = thread::Builder::new()
            .name(format!("swarm-{name}"))
            .spawn({
                let (host, handle, built) = (self.clone(), handle.clone(), promise());
                move || host.host(&handle, taken, beginning, built)
            })
            .map_err(|error| HostError::NoThread(error.to_string()))?;
        hosted.memory_bytes += memory_bytes;
        hosted.swarms.insert(
            name.to_owned(),
            Entry {
                handle,
                memory_bytes,
                thread: Some(thread),
            },
        );
        Ok(())
    }

    /// The swarm of that name.
    pub fn find(&self, name: &str) -> Option<Handle> {
        self.lock()
            .swarms
            .get(name)
            .map(|entry| entry.handle.clone())
    }

    /// Every swarm that is built, ordered by name.
    pub fn list(&self) -> Vec<(String, Summary)> {
        let (handles, _) = self.handles();
        handles
            .into_iter()
            .filter_map(|(name, handle)| Some((name, handle.summary()?)))
            .collect()
    }

    /// Every swarm, built or not, ordered by name; and what was counted of those that are gone.
    pub fn handles(&self) -> (Vec<(String, Handle)>, Totals) {
        let hosted = self.lock();
        let swarms = hosted.swarms.iter();
        let handles = swarms.map(|(name, entry)| (name.clone(), entry.handle.clone()));
        (handles.collect(), hosted.past)
    }

    /// Memory set aside for the swarms, in bytes.
    pub fn memory_bytes(&self) -> u64 {
        self.lock().memory_bytes
    }

    /// Releases the name of a swarm that has ended.
    pub fn release(&self, name: &str) {
        let mut hosted = self.lock();
        if let Some(entry) = hosted.swarms.remove(name) {
            hosted.memory_bytes -= entry.memory_bytes;
            hosted.past.add(&entry.handle.totals());
        }
    }

    /// Ends every swarm between two steps and waits for their threads, at most `patience`.
    ///
    /// Returns how many had not ended by then.
    pub fn stop(&self, patience: Duration) -> usize {
        let threads: Vec<thread::JoinHandle<()>> = {
            let mut hosted = self.lock();
            hosted.stopping = true;
            let entries = hosted.swarms.values_mut();
            entries
                .filter_map(|entry| {
                    // A full queue ends too: the last handle goes with this host.
                    entry.handle.send(Ticket::Stop);
                    entry.thread.take()
                })
                .collect()
        };
        let deadline = Instant::now() + patience;
        let mut running = threads;
        loop {
            running.retain(|thread| !thread.is_finished());
            if running.is_empty() || Instant::now() >= deadline {
                return running.len();
            }
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// Admits the memory of `n` individuals before anything of it is allocated.
    fn admit(&self, hosted: &Hosted, n: usize) -> Result<u64, HostError> {
        let needed = memory_of(n);
        self.admit_bytes(hosted, needed).map(|()| needed)
    }

    fn admit_bytes(&self, hosted: &Hosted, needed: u64) -> Result<(), HostError> {
        let limits = &self.limits;
        if hosted.swarms.len() >= limits.max_swarms {
            let limit = limits.max_swarms;
            return Err(HostError::TooManySwarms { limit });
        }
        let free = limits.max_memory_bytes.saturating_sub(hosted.memory_bytes);
        if needed > free {
            let limit = limits.max_memory_bytes;
            return Err(HostError::TooMuchMemory {
                needed,
                free,
                limit,
            });
        }
        Ok(())
    }

    /// Reserves memory for a swarm that is to have another size.
    fn reserve(&self, name: &str, size: Reservation) -> Result<(), ReserveError> {
        let limit = self.limits.max_individuals;
        let n = match size {
            Reservation::Grow(n) if n > limit => return Err(ReserveError::TooMany { n, limit }),
            Reservation::Grow(n) | Reservation::Return(n) => n,
        };
        let mut hosted = self.lock();
        let (total, needed) = (hosted.memory_bytes, memory_of(n));
        let Some(entry) = hosted.swarms.get_mut(name) else {
            return Ok(());
        };
        let others = total - entry.memory_bytes;
        let free = self.limits.max_memory_bytes.saturating_sub(others);
        // A smaller size is always admitted, whatever memory the other swarms have reserved.
        if needed > free && needed > entry.memory_bytes {
            return Err(ReserveError::NoMemory { n, needed, free });
        }
        entry.memory_bytes = needed;
        hosted.memory_bytes = others + needed;
        Ok(())
    }

    /// A swarm's life, on its own thread.
    fn host(
        self: &Arc<Self>,
        handle: &Handle,
        taken: Receiver<Ticket>,
        beginning: Beginning,
        built: Answer,
    ) {
        let name = &handle.outlet.name;
        // Without permission the thread keeps the default priority.
        let _ = thread_priority::short_slice();
        let guest = match self.build(handle, beginning) {
            Ok(Ok(guest)) => guest,
            // It had ended, though its end was not safe.
            Ok(Err(End::Deleted(ended))) => {
                drop(taken);
                return self.herald.ended(name, ended);
            }
            Ok(Err(End::Stopped)) => return,
            Err(error) => {
                drop(taken);
                let refused = move || built.send(Err(Refusal { step: None, error }));
                return self.herald.ended(name, Box::new(refused));
            }
        };
        let (place, frame) = match &guest {
            Guest::Swarm(worker) => worker.look(),
            Guest::Film(player) => player.look(),
        };
        self.herald.begun(
            name,
            Box::new(move || built.send(Ok((place, Outcome::Seen(frame))))),
        );
        let end = match guest {
            Guest::Swarm(worker) => worker.run(&taken),
            Guest::Film(player) => player.run(&taken),
        };
        // Whoever asks from here on hears that it is gone.
        drop(taken);
        match end {
            End::Deleted(ended) => self.herald.ended(name, ended),
            End::Stopped => {}
        }
    }

    /// Builds a swarm, and makes it safe.
    fn build(
        self: &Arc<Self>,
        handle: &Handle,
        beginning: Beginning,
    ) -> Result<Result<Guest, End>, OrderError> {
        let name = &handle.outlet.name;
        let (host, swarm) = (self.clone(), name.clone());
        let admit: ReserveMemory = Box::new(move |size| host.reserve(&swarm, size));
        let shortest = Duration::from_secs(1) / self.limits.max_hz.max(1);
        let writer = (self.archive)(name);
        match beginning {
            Beginning::Spec(register) => {
                let simulation = Simulation::with_reserve((*handle.recipe).clone(), admit)?;
                let worker = Worker::new(simulation, handle, shortest, writer);
                register_new(&worker, register)?;
                Ok(Ok(Guest::Swarm(Box::new(worker))))
            }
            Beginning::Copy(checkpoint, register) => {
                let worker = Worker::from_copy(*checkpoint, handle, shortest, (writer, admit));
                register_new(&worker, register)?;
                Ok(Ok(Guest::Swarm(Box::new(worker))))
            }
            Beginning::Past(past) => {
                let always: ReserveMemory = Box::new(|_| Ok(()));
                let (mut worker, end) =
                    Worker::from_past(*past, handle, shortest, (writer, always));
                if let Some(end) = end {
                    return Ok(Err(end));
                }
                self.set_aside(name, worker.n());
                if let Err(fault) = worker.resume(admit) {
                    warn!(swarm = name, %fault, "failed to write down that it goes on");
                }
                Ok(Ok(Guest::Swarm(Box::new(worker))))
            }
            Beginning::Film(film) => {
                let player = Player::new(film, handle, shortest)?;
                Ok(Ok(Guest::Film(Box::new(player))))
            }
        }
    }

    /// Sets memory aside for what is there already.
    fn set_aside(&self, name: &str, n: usize) {
        let mut hosted = self.lock();
        let needed = memory_of(n);
        if let Some(entry) = hosted.swarms.get_mut(name) {
            let before = std::mem::replace(&mut entry.memory_bytes, needed);
            hosted.memory_bytes = hosted.memory_bytes - before + needed;
        }
    }

    fn lock(&self) -> MutexGuard<'_, Hosted> {
        // The map and the sum change together under the lock and nothing in between can panic.
        self.hosted.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Tells a swarm's past again, apart from every swarm there is. Returns it as it then is, and how
/// the telling went.
pub fn tell_again(past: Past) -> (Checkpoint, Replay) {
    let _ = rustix::process::setpriority_process(None, RETELLING_NICENESS);
    let handle = Handle::alone(past.checkpoint.simulation.spec.clone());
    let always: ReserveMemory = Box::new(|_| Ok(()));
    let (worker, _) =
        Worker::from_past(past, &handle, Duration::ZERO, (Arc::new(NoWriter), always));
    (worker.checkpoint(), worker.into_replay())
}

fn register_new(worker: &Worker, register: Register) -> Result<(), OrderError> {
    let (place, frame) = worker.look();
    register(&worker.checkpoint(), &place, &frame).map_err(OrderError::Unsafe)
}

/// Memory that a swarm may come to need, in bytes.
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
