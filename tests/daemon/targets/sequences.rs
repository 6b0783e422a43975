//! Sequences of commands to a swarm, compared with a model.
//!
//! Bytes become commands. Each is sent to a real swarm of at most four and to [`Model`], which has
//! steps, phases, numbers and scheduled commands, but no physics. Both must agree on
//! whether a command is executed or rejected and with which error, on the step, and on the journal
//! and events afterwards.

#[path = "sequences/model.rs"]
mod model;

use std::fmt::Debug;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, OnceLock, Weak};
use std::time::{Duration, Instant};

use jostle_conditions::Condition;
use jostle_physics::model::Parameters;
use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::{Change, ChangeError, Placement, Settings, Spec, Start};
use jostled::swarm::checkpoint::Checkpoint;
use jostled::swarm::command::{Command, Until, WaitCondition, When, Which};
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
use jostled::swarm::sender::{Creation, Sender};
use jostled::swarm::watch::{Action, Draws, Watch};

use model::{Effect, Expected, FAST, Input, LIMIT, Model, ModelPhase, SLOW, Step};

/// Maximum number of commands in one sequence.
const MAX_COMMANDS: usize = 24;

/// The timeout of a reply.
const TIMEOUT: Duration = Duration::from_secs(20);

/// Bytes as decisions; without further bytes every decision is the first.
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

    /// True for one byte in eight.
    fn one_in_eight(&mut self) -> bool {
        self.below(8) == 7
    }
}

/// An observer without clients, which releases a swarm when it ends.
struct ReleasingObserver(OnceLock<Weak<SwarmRegistry>>);

impl SwarmObserver for ReleasingObserver {
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
        _: Option<&Creation>,
        _: &Checkpoint,
        _: &Stamp,
        _: &Arc<Frame>,
    ) -> Result<Option<u64>, WriteFault> {
        Ok(None)
    }
}

/// The command for the swarm.
fn order(input: &Input) -> Command {
    match input {
        Input::Run { until, rate } => Command::Run {
            until: until.map(Until::Step),
            rate: Some(*rate),
        },
        Input::Pause => Command::Pause,
        Input::Step(steps) => Command::Step(*steps),
        Input::Change(step) => Command::Change(change(*step)),
        Input::Batch(steps) => Command::Batch {
            changes: steps.iter().map(|step| change(*step)).collect(),
            draws: Draws::Command,
        },
        Input::When(effect) => Command::Watch(Box::new(watch(*effect))),
        Input::Cancel => Command::Unwatch(Which::All),
        Input::Reset => Command::Reset(None),
        Input::Protect(on) => Command::Protect(*on),
        Input::Delete => Command::Delete,
    }
}

/// A condition that holds in every state.
fn watch(effect: Effect) -> Watch {
    Watch {
        condition: Condition::parse("order >= 0").expect("it is valid"),
        action: match effect {
            Effect::Pause => Action::Pause,
            Effect::Change => Action::Batch(vec![change(Step::Set(true))], Draws::Protocol),
            Effect::Event => Action::Event("mine".into()),
            Effect::Stop => Action::Stop,
        },
        from: None,
        before: None,
        is_protocol: false,
        fired: Arc::new(Sender::default()),
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

/// The next command, and its step.
fn next(bytes: &mut Bytes, model: &Model) -> (Input, When) {
    let step = |bytes: &mut Bytes| match bytes.below(6) {
        0 => Step::Set(true),
        1 => Step::Inform(bytes.count(LIMIT + 2)),
        2 => Step::Uninform,
        3 => Step::Inject(1 + bytes.count(3)),
        4 => Step::Remove(bytes.count(LIMIT + 2)),
        _ => Step::Set(false),
    };
    let input = match bytes.below(11) {
        0 | 1 => Input::Step(1 + bytes.below(6)),
        2 => Input::Run {
            // Without an end the swarm would run for ever.
            until: Some((model.step + bytes.below(8)).saturating_sub(1)),
            rate: FAST,
        },
        3 => Input::Run {
            until: bytes.one_in_eight().then(|| model.step + bytes.below(3)),
            rate: SLOW,
        },
        4 => Input::Pause,
        5 => Input::Change(step(bytes)),
        6 => Input::Batch((0..=bytes.below(3)).map(|_| step(bytes)).collect()),
        7 => Input::Reset,
        9 => Input::When(match bytes.below(4) {
            0 => Effect::Pause,
            1 => Effect::Change,
            2 => Effect::Event,
            _ => Effect::Stop,
        }),
        10 if bytes.one_in_eight() => Input::Cancel,
        10 if bytes.below(2) == 1 => Input::Protect(bytes.below(4) < 3),
        10 => Input::When(Effect::Pause),
        _ if bytes.one_in_eight() => Input::Delete,
        _ => Input::Change(step(bytes)),
    };
    let when = When {
        at_step: match bytes.below(4) {
            0 | 1 => None,
            2 => Some(model.step + bytes.below(6)),
            _ => Some(model.step.saturating_sub(1)),
        },
        expect_epoch: bytes.one_in_eight().then(|| model.epoch + bytes.below(2)),
        expect_step: bytes.one_in_eight().then(|| model.step + bytes.below(2)),
    };
    (input, when)
}

/// The name of an error's variant, and of its content where that matters.
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
        // After a failure of the sequence the receiver is gone.
        let _ = sender.send(answered);
    };
    (ReplyTo::new(answer), answers)
}

fn answer_from(answers: &Receiver<SwarmReply>) -> SwarmReply {
    answers
        .recv_timeout(TIMEOUT)
        .expect("every order is answered")
}

fn query_state(handle: &Handle) -> (Stamp, Arc<Frame>) {
    let (answer, seen) = answers();
    handle.send(Message::Query(answer));
    match answer_from(&seen) {
        Ok((stamp, Outcome::State(frame))) => (stamp, frame),
        other => panic!("{other:?}"),
    }
}

/// Waits until a swarm is in the phase of the model.
fn wait_until_idle(handle: &Handle, model: &Model) -> (Stamp, Arc<Frame>) {
    let awaited = match model.phase {
        // Gets a reply when the swarm is paused, at any step.
        ModelPhase::Paused => WaitCondition::Step(u64::MAX),
        ModelPhase::Running(_) | ModelPhase::Stepping(_) => WaitCondition::Reached(model.step),
    };
    loop {
        let (answer, arrived) = answers();
        handle.send(Message::Wait(Waiter {
            condition: awaited.clone(),
            is_abandoned: Box::new(|| false),
            reply_to: answer,
        }));
        assert!(answer_from(&arrived).is_ok());
        let (stamp, frame) = query_state(handle);
        // Of several commands for one step, an early one may find the swarm paused and a later one running.
        if model.phase != ModelPhase::Paused || !stamp.phase.is_moving() {
            return (stamp, frame);
        }
    }
}

/// Some individuals in a row, without contact.
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
        measures: Vec::new(),
    }
}

/// A swarm and its model agree for any sequence of commands.
pub fn check(data: &[u8]) {
    let mut bytes = Bytes(data);
    let n = 1 + bytes.count(3);
    let limits = Limits {
        max_individuals: LIMIT,
        max_swarms: 1,
        max_memory_bytes: 1 << 30,
        max_hz: 1000,
    };
    let herald = Arc::new(ReleasingObserver(OnceLock::new()));
    let host = Arc::new(SwarmRegistry::new(
        limits,
        herald.clone(),
        Box::new(NoStore),
    ));
    assert!(herald.0.set(Arc::downgrade(&host)).is_ok());
    let (answer, built) = answers();
    let created = host.create(
        "a",
        (recipe(n), Creation::default()),
        false,
        Box::new(NoStore),
        || answer,
    );
    assert!(matches!(created, Ok(Created::New)));
    assert!(answer_from(&built).is_ok());
    let handle = host.find("a").expect("it was created");

    let mut model = Model::new(n);
    let mut orders = 0;
    while !bytes.is_empty() && orders < MAX_COMMANDS && !model.deleted {
        orders += 1;
        let (input, when) = next(&mut bytes, &model);
        let expected = model.apply_input(&input, when);
        model.run_until_idle();
        let expected = expected.or_else(|| model.stepped.take());
        let (answer, answered) = answers();
        handle.send(Message::Command(CommandMessage {
            command: order(&input),
            when,
            sender: Arc::new(Sender::default()),
            user: None,
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
                Expected::Stepped {
                    step: stamp.step,
                    taken: steps,
                }
            }
            Ok((_, Outcome::Scheduled(at_step))) => Expected::Scheduled(at_step),
            Ok((stamp, _)) => Expected::Executed {
                step: stamp.step,
                seq: stamp.seq,
            },
            Err(rejection) => Expected::Rejected(name_of(&rejection.error)),
        };
        assert_eq!(
            Some(&came),
            expected.as_ref(),
            "{input:?} {when:?} {model:?}"
        );
        if !model.deleted {
            matches_model(&wait_until_idle(&handle, &model), &model);
        }
    }
    if model.deleted {
        // It may have to step to the step of its deletion.
        let deadline = Instant::now() + TIMEOUT;
        while host.find("a").is_some() {
            assert!(Instant::now() < deadline, "it is still there: {model:?}");
            std::thread::yield_now();
        }
        let (answer, answered) = answers();
        handle.send(Message::Query(answer));
        let rejection = answer_from(&answered).err();
        assert!(matches!(
            rejection.map(|it| it.error),
            Some(SwarmError::Gone)
        ));
    }
    has_its_history(&handle, &model);
    assert_eq!(host.stop(TIMEOUT), 0);
}

/// Whether a swarm agrees with the model.
fn matches_model((stamp, frame): &(Stamp, Arc<Frame>), model: &Model) {
    let phase = match &stamp.phase {
        Phase::Paused(_) => ModelPhase::Paused,
        Phase::Running { until } => ModelPhase::Running(*until),
        Phase::Stepping { until } => ModelPhase::Stepping(*until),
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
        phase,
        epoch,
        step,
        seq,
        n,
        ..
    } = *model;
    assert_eq!(real, (phase, epoch, step, seq, n), "{model:?}");
    assert_eq!(frame.scheduled, model.waiting.len(), "{model:?}");
    assert_eq!(frame.is_protected, model.is_protected, "{model:?}");
}

/// Whether the journal and the events of a swarm agree with the model.
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
        model.rejected_later
    );
    assert_eq!(
        count(|it| matches!(it, EventKind::Scheduled(..))),
        model.scheduled
    );
    assert_eq!(
        count(|it| matches!(it, EventKind::Deleted(_))),
        usize::from(model.deleted)
    );
}
