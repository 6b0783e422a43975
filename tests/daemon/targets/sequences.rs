//! Sequences of orders to a swarm, beside a plain model of what they may come to.
//!
//! Bytes become orders. Each goes to a real swarm of at most four and to [`Model`], which knows
//! steps, phases, numbers and what waits for its step, but no physics. Both must say the same:
//! allowed or refused and with which error, which step was reached, and what there is to read
//! about it afterwards.

#[path = "sequences/model.rs"]
mod model;

use std::fmt::Debug;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, OnceLock, Weak};
use std::time::{Duration, Instant};

use jostle_physics::model::Parameters;
use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::{Change, ChangeError, Placement, Settings, Spec, Start};
use jostled::swarm::checkpoint::Checkpoint;
use jostled::swarm::command::{Command, Until, WaitCondition, When};
use jostled::swarm::error::SwarmError;
use jostled::swarm::error::WriteFault;
use jostled::swarm::frame::{EventKind, Frame, Stamp};
use jostled::swarm::handle::{
    CommandMessage, DeferredReply, Handle, Message, Outcome, ReplyTo, SwarmReply, Waiter,
};
use jostled::swarm::journal::{JournalWriter, NoWriter};
use jostled::swarm::phase::Phase;
use jostled::swarm::registry::{Created, Limits, SwarmRegistry};
use jostled::swarm::runner::{JournalFactory, PersistNew, SwarmObserver};
use jostled::swarm::sender::Sender;

use model::{Came, Doing, FAST, LIMIT, Model, SLOW, Step, Told};

/// How many orders one sequence has at most.
const MOST_ORDERS: usize = 24;

/// How long any answer may take.
const PATIENCE: Duration = Duration::from_secs(20);

/// Bytes as decisions; when they have run out, every decision is the first.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// A number below `end`.
    fn below(&mut self, end: u64) -> u64 {
        match self.0 {
            [first, rest @ ..] => {
                self.0 = rest;
                u64::from(*first) % end
            }
            [] => 0,
        }
    }

    /// A number of individuals below `end`.
    fn count(&mut self, end: usize) -> usize {
        usize::try_from(self.below(end as u64)).expect("it is below a byte")
    }

    /// A choice that is rarely made.
    fn rarely(&mut self) -> bool {
        self.below(8) == 7
    }
}

/// Nobody listens to the swarm, and its end is known as soon as it ends.
struct Silence(OnceLock<Weak<SwarmRegistry>>);

impl SwarmObserver for Silence {
    fn started(&self, _: &str, reply: DeferredReply) {
        reply.send();
    }

    fn ended(&self, name: &str, reply: DeferredReply) {
        if let Some(host) = self.0.get().and_then(Weak::upgrade) {
            host.release(name);
        }
        reply.send();
    }
}

/// Nothing is written.
struct NoStore;

impl JournalFactory for NoStore {
    fn open(&self, _: &str) -> Arc<dyn JournalWriter> {
        Arc::new(NoWriter)
    }
}

impl PersistNew for NoStore {
    fn persist(
        self: Box<Self>,
        _: &Checkpoint,
        _: &Stamp,
        _: &Arc<Frame>,
    ) -> Result<(), WriteFault> {
        Ok(())
    }
}

/// The same order for the swarm.
fn order(told: &Told) -> Command {
    match told {
        Told::Run { until, rate } => Command::Run {
            until: until.map(Until::Step),
            rate: Some(*rate),
        },
        Told::Pause => Command::Pause,
        Told::Step(steps) => Command::Step(*steps),
        Told::Change(step) => Command::Change(change(*step)),
        Told::Batch(steps) => Command::Batch(steps.iter().map(|step| change(*step)).collect()),
        Told::Reset => Command::Reset(None),
        Told::Delete => Command::Delete,
    }
}

fn change(step: Step) -> Change {
    match step {
        Step::Set(is_right) => Change::Set(Settings {
            pi3: Some(if is_right { 0.5 } else { -1.0 }),
            ..Settings::default()
        }),
        Step::Inform(count) => Change::Inform {
            selection: Selection::Count(count),
            direction: 1.0,
            weight: None,
            for_time: Some(0.05),
        },
        Step::Uninform => Change::Uninform(Selection::Fraction(1.0)),
        Step::Inject(count) => Change::Inject {
            place: Placement::Border(count),
            informed: None,
        },
        Step::Remove(count) => Change::Remove(Selection::Count(count)),
    }
}

/// The next order, and when it is to be carried out.
fn next(bytes: &mut Bytes, model: &Model) -> (Told, When) {
    let step = |bytes: &mut Bytes| match bytes.below(6) {
        0 => Step::Set(true),
        1 => Step::Inform(bytes.count(LIMIT + 2)),
        2 => Step::Uninform,
        3 => Step::Inject(1 + bytes.count(3)),
        4 => Step::Remove(bytes.count(LIMIT + 2)),
        _ => Step::Set(false),
    };
    let told = match bytes.below(9) {
        0 | 1 => Told::Step(1 + bytes.below(6)),
        2 => Told::Run {
            // Without an end it would never settle.
            until: Some((model.step + bytes.below(8)).saturating_sub(1)),
            rate: FAST,
        },
        3 => Told::Run {
            until: bytes.rarely().then(|| model.step + bytes.below(3)),
            rate: SLOW,
        },
        4 => Told::Pause,
        5 => Told::Change(step(bytes)),
        6 => Told::Batch((0..=bytes.below(3)).map(|_| step(bytes)).collect()),
        7 => Told::Reset,
        _ if bytes.rarely() => Told::Delete,
        _ => Told::Change(step(bytes)),
    };
    let when = When {
        at_step: match bytes.below(4) {
            0 | 1 => None,
            2 => Some(model.step + bytes.below(6)),
            _ => Some(model.step.saturating_sub(1)),
        },
        expect_epoch: bytes.rarely().then(|| model.epoch + bytes.below(2)),
        expect_step: bytes.rarely().then(|| model.step + bytes.below(2)),
    };
    (told, when)
}

/// The name of an error's variant, and of what is in it where that matters.
fn name_of(error: &SwarmError) -> String {
    match error {
        SwarmError::InBatch { error, .. } => format!("InBatch({})", name_of(error)),
        SwarmError::Phase(error) => format!("Phase({error:?})"),
        SwarmError::Change(ChangeError::Reserve(error)) => variant(error),
        SwarmError::Change(error) => variant(error),
        other => variant(other),
    }
}

fn variant(error: &impl Debug) -> String {
    let text = format!("{error:?}");
    let end = text.find(|c: char| !c.is_alphanumeric());
    text[..end.unwrap_or(text.len())].to_owned()
}

fn answers() -> (ReplyTo, Receiver<SwarmReply>) {
    let (sender, answers) = channel();
    let answer = move |answered| {
        // Nobody waits any more when the sequence has failed.
        let _ = sender.send(answered);
    };
    (ReplyTo::new(answer), answers)
}

fn answer_from(answers: &Receiver<SwarmReply>) -> SwarmReply {
    answers
        .recv_timeout(PATIENCE)
        .expect("every order is answered")
}

fn look(handle: &Handle) -> (Stamp, Arc<Frame>) {
    let (answer, seen) = answers();
    handle.send(Message::Query(answer));
    match answer_from(&seen) {
        Ok((stamp, Outcome::State(frame))) => (stamp, frame),
        other => panic!("{other:?}"),
    }
}

/// Waits until a swarm does what the model does.
fn settled(handle: &Handle, model: &Model) -> (Stamp, Arc<Frame>) {
    let awaited = match model.doing {
        // Answered when it stands still, whatever its step.
        Doing::Paused => WaitCondition::Step(u64::MAX),
        Doing::Running(_) | Doing::Stepping(_) => WaitCondition::Reached(model.step),
    };
    loop {
        let (answer, arrived) = answers();
        handle.send(Message::Wait(Waiter {
            condition: awaited,
            is_abandoned: Box::new(|| false),
            reply_to: answer,
        }));
        assert!(answer_from(&arrived).is_ok());
        let (stamp, frame) = look(handle);
        // Of several orders for one step, an early one finds it standing and a later one does not.
        if model.doing != Doing::Paused || !stamp.phase.is_moving() {
            return (stamp, frame);
        }
    }
}

/// A few in a row, apart enough that nobody is in anybody's way.
fn recipe(n: usize) -> Spec {
    Spec {
        n,
        parameters: Parameters::default(),
        seed: 1,
        start: Start::Given {
            x: (0..n).map(|k| 3.0 * k as f64).collect(),
            y: vec![0.0; n],
            alpha: (0..n).map(|k| k as f64).collect(),
        },
        publish_every: 1,
        rate: SLOW,
    }
}

/// Whatever is ordered, a swarm and its model come to the same.
pub fn hold(data: &[u8]) {
    let mut bytes = Bytes(data);
    let n = 1 + bytes.count(3);
    let limits = Limits {
        max_individuals: LIMIT,
        max_swarms: 1,
        max_memory_bytes: 1 << 30,
        max_hz: 1000,
    };
    let herald = Arc::new(Silence(OnceLock::new()));
    let host = Arc::new(SwarmRegistry::new(
        limits,
        herald.clone(),
        Box::new(NoStore),
    ));
    assert!(herald.0.set(Arc::downgrade(&host)).is_ok());
    let (answer, built) = answers();
    let created = host.create("a", recipe(n), false, Box::new(NoStore), || answer);
    assert!(matches!(created, Ok(Created::New)));
    assert!(answer_from(&built).is_ok());
    let handle = host.find("a").expect("it was created");

    let mut model = Model::new(n);
    let mut orders = 0;
    while !bytes.is_empty() && orders < MOST_ORDERS && !model.deleted {
        orders += 1;
        let (told, when) = next(&mut bytes, &model);
        let expected = model.tell(&told, when);
        model.settle();
        let expected = expected.or_else(|| model.stepped.take());
        let (answer, answered) = answers();
        handle.send(Message::Command(CommandMessage {
            command: order(&told),
            when,
            sender: Arc::new(Sender::default()),
            reply_to: answer,
        }));
        let came = match answer_from(&answered) {
            Ok((
                stamp,
                Outcome::Stepped {
                    steps, frame: seen, ..
                },
            )) => {
                assert_eq!(seen.stamp.step, stamp.step);
                Came::Stepped {
                    step: stamp.step,
                    taken: steps,
                }
            }
            Ok((_, Outcome::Scheduled(at_step))) => Came::Scheduled(at_step),
            Ok((stamp, _)) => Came::Out {
                step: stamp.step,
                seq: stamp.seq,
            },
            Err(refusal) => Came::Refused(name_of(&refusal.error)),
        };
        assert_eq!(
            Some(&came),
            expected.as_ref(),
            "{told:?} {when:?} {model:?}"
        );
        if !model.deleted {
            is_as_told(&settled(&handle, &model), &model);
        }
    }
    if model.deleted {
        // It may yet have to step to where it is deleted.
        let deadline = Instant::now() + PATIENCE;
        while host.find("a").is_some() {
            assert!(Instant::now() < deadline, "it is still there: {model:?}");
            std::thread::yield_now();
        }
        let (answer, answered) = answers();
        handle.send(Message::Query(answer));
        let refusal = answer_from(&answered).err();
        assert!(matches!(refusal.map(|it| it.error), Some(SwarmError::Gone)));
    }
    has_its_history(&handle, &model);
    assert_eq!(host.stop(PATIENCE), 0);
}

/// Whether a swarm is where the model is.
fn is_as_told((stamp, frame): &(Stamp, Arc<Frame>), model: &Model) {
    let phase = match &stamp.phase {
        Phase::Paused(_) => Doing::Paused,
        Phase::Running { until } => Doing::Running(*until),
        Phase::Stepping { until } => Doing::Stepping(*until),
        Phase::Faulted(reason) => panic!("{reason}"),
    };
    let real = (
        phase,
        stamp.epoch,
        stamp.step,
        stamp.seq,
        frame.configuration.n(),
    );
    let Model {
        doing,
        epoch,
        step,
        seq,
        n,
        ..
    } = *model;
    assert_eq!(real, (doing, epoch, step, seq, n), "{model:?}");
    assert_eq!(frame.scheduled, model.waiting.len(), "{model:?}");
}

/// Whether what can be read of a swarm is what happened to it.
fn has_its_history(handle: &Handle, model: &Model) {
    let entries = handle.history.entries(0, 1000).records;
    let journal: Vec<_> = entries
        .iter()
        .map(|entry| (entry.stamp.seq, entry.stamp.epoch, entry.stamp.step))
        .collect();
    assert_eq!(journal, model.journal, "{model:?}");
    let events = handle.history.events(0, 1000).records;
    let numbers: Vec<u64> = events.iter().map(|event| event.number).collect();
    assert_eq!(numbers, (1..=events.len() as u64).collect::<Vec<_>>());
    let count = |is: fn(&EventKind) -> bool| events.iter().filter(|it| is(&it.kind)).count();
    assert_eq!(
        count(|it| matches!(it, EventKind::Rejected(..))),
        model.refused_later
    );
    assert_eq!(
        count(|it| matches!(it, EventKind::Scheduled(..))),
        model.scheduled
    );
    assert_eq!(
        count(|it| matches!(it, EventKind::Deleted)),
        usize::from(model.deleted)
    );
}
