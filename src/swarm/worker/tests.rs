#![expect(clippy::unwrap_used, reason = "tests")]

use std::sync::atomic::{AtomicU64, Ordering};

use jostle_physics::simulation::Spec;

use super::replay::{ReplaySource, ReplayTarget};
use super::*;
use crate::suspension::GRACE;
use crate::swarm::command::When;
use crate::swarm::handle::CommandMessage;
use crate::swarm::journal::{Entry, Line, NoWriter, PendingDurableStep};
use crate::swarm::membership::{ControllerSettings, JoinOptions, Mode, OnTimeout};
use crate::swarm::watch::{Action, Watch};

/// Counts checkpoints.
#[derive(Default)]
struct Counting(AtomicU64);

impl JournalWriter for Counting {
    fn commit(&self, entries: Vec<Entry>) -> Result<(), WriteFault> {
        self.append(entries, None);
        Ok(())
    }

    fn append(&self, entries: Vec<Entry>, pending: Option<PendingDurableStep>) {
        let checkpoints = entries
            .iter()
            .filter(|it| matches!(it, Entry::Checkpoint(_)));
        self.0
            .fetch_add(checkpoints.count() as u64, Ordering::Relaxed);
        if let Some(pending) = pending {
            pending.mark_durable();
        }
    }
}

#[test]
fn notes_cost_no_checkpoint_and_other_commands_do() {
    for (command, expected) in [(Command::Annotate, 0), (Command::Pause, 2)] {
        let handle = Handle::alone(Spec::new(6, 1));
        let start = Checkpoint::start(Simulation::new(&handle.spec).unwrap().checkpoint());
        let counting = Arc::new(Counting::default());
        let writer = (counting.clone() as _, Box::new(|_| Ok(())) as _);
        let ignored = &|_: &_| ReplyTo::ignored();
        let mut worker = Worker::restore(start, &handle, Duration::ZERO, writer, ignored);
        for _ in 0..=2 * CHECKPOINT_INPUTS {
            let message = CommandMessage {
                command: command.clone(),
                sender: Arc::default(),
                user: None,
                when: When::default(),
                reply_to: ReplyTo::ignored(),
            };
            assert!(worker.handle(Message::Command(message)).is_none());
            worker.checkpoint_if_due(Instant::now());
        }
        assert_eq!(counting.0.load(Ordering::Relaxed), expected, "{command:?}");
    }
}

fn start(handle: &Handle) -> Checkpoint {
    Checkpoint::start(Simulation::new(&handle.spec).unwrap().checkpoint())
}

fn worker(handle: &Handle) -> Worker {
    let writer = (Arc::new(NoWriter) as _, Box::new(|_| Ok(())) as _);
    let ignored = &|_: &_| ReplyTo::ignored();
    Worker::restore(start(handle), handle, Duration::ZERO, writer, ignored)
}

/// Sends a command, which must be accepted.
fn send(worker: &mut Worker, command: Command) {
    let (replied, reply) = std::sync::mpsc::channel();
    let message = CommandMessage {
        command,
        sender: Arc::default(),
        user: None,
        when: When::default(),
        reply_to: ReplyTo::new(move |it| replied.send(it.map(drop)).unwrap()),
    };
    assert!(worker.handle(Message::Command(message)).is_none());
    reply.try_recv().unwrap().unwrap();
}

fn join(controller: &str) -> Command {
    Command::Join(JoinOptions {
        controller: controller.to_owned(),
        selection: None,
        settings: ControllerSettings {
            mode: Mode::Lockstep,
            deadline: Duration::from_secs(60),
            on_timeout: OnTimeout::Hold,
            driving: false,
        },
        again: false,
    })
}

#[test]
fn a_faulted_swarm_waits_for_no_controller_and_loses_it_after_a_reset() {
    let handle = Handle::alone(Spec::new(6, 1));
    let mut worker = worker(&handle);
    assert_eq!(worker.controllers_due(), None);
    for controller in ["away", "gone", "stays"] {
        send(&mut worker, join(controller));
    }
    let away_since = Instant::now().checked_sub(GRACE).unwrap();
    worker.notify_controllers(Input::Away("away", away_since));
    assert!(worker.controllers_due().unwrap() <= Instant::now());
    worker.fault("a test".into());
    assert!(worker.token_lost("gone".into()).is_none());
    // A time that has passed already would end each wait of the thread for messages at once.
    assert_eq!(worker.controllers_due(), None);
    assert_eq!(worker.controllers.names().count(), 3);
    send(&mut worker, Command::Reset(None));
    assert!(worker.controllers_due().unwrap() <= Instant::now());
    assert!(worker.fire_deadlines().is_none());
    let left: Vec<&str> = worker.controllers.names().collect();
    assert_eq!(left, ["stays"]);
    assert_eq!(worker.controllers_due(), None);
}

/// A condition that does not hold.
fn watch(condition: &str) -> Watch {
    let fired = Sender {
        verb: "fired",
        args: condition.to_owned(),
        ..Sender::default()
    };
    Watch {
        condition: jostle_conditions::Condition::parse(condition).unwrap(),
        action: Action::Pause,
        from: None,
        before: None,
        is_protocol: false,
        fired: Arc::new(fired),
    }
}

#[test]
fn what_an_earlier_version_accepted_is_replayed_and_the_newest_are_not_evaluated() {
    let handle = Handle::alone(Spec::new(6, 1));
    let conditions: Vec<String> = (1..=4)
        .map(|k| format!("clusters.count(0.0{k}) > 99"))
        .chain(["order > 1".to_owned()])
        .collect();
    let lines: Vec<_> = (1..)
        .zip(&conditions)
        .flat_map(|(k, condition)| {
            let sender = Arc::<Sender>::default();
            let line = |number, record| Line {
                number,
                epoch: 1,
                step: 0,
                record,
            };
            // Every other one comes at a later step.
            let at_step = (k % 2 == 0).then_some(3);
            let input = Record::Input {
                at_step,
                sender,
                seq: None,
                unix_secs: None,
            };
            let command = Command::Watch(Box::new(watch(condition)));
            let outcome = Record::Outcome {
                input: 2 * k - 1,
                seq: Some(k),
                unix_secs: None,
            };
            let input = (line(2 * k - 1, input), Some(command));
            [Ok(input), Ok((line(2 * k, outcome), None))]
        })
        .collect();
    let source = ReplaySource {
        checkpoint: start(&handle),
        lines: Box::new(lines.into_iter()),
        entries: Vec::new(),
        reply_for: Box::new(|_| ReplyTo::ignored()),
        to: ReplayTarget::LastInput,
        on_progress: None,
        goes_on: None,
    };
    let (mut worker, replayed, _) = source.fold(&handle, Duration::ZERO, Arc::new(NoWriter));
    assert_eq!(replayed.problem, None);
    let (until, rate) = (None, None);
    send(&mut worker, Command::Run { until, rate });
    let statuses = |worker: &Worker| -> Vec<(String, bool)> {
        let all = worker.frame(true).conditions.clone();
        let status = |it: &crate::swarm::awaited::WatchStatus| {
            (it.summary.condition.clone(), it.is_evaluated)
        };
        all.iter().map(status).collect()
    };
    let expected = |order: [(usize, bool); 3]| -> Vec<(String, bool)> {
        let status = |(k, is_evaluated): (usize, bool)| (conditions[k].clone(), is_evaluated);
        order.map(status).to_vec()
    };
    let before = expected([(0, true), (2, false), (4, true)]);
    assert_eq!(statuses(&worker), before);
    assert!(worker.watches.take_omitted().is_empty());
    for _ in 0..5 {
        assert!(worker.step().is_none());
    }
    let after = [(0, true), (2, false), (4, true), (1, false), (3, false)];
    let after: Vec<(String, bool)> = after
        .iter()
        .map(|(k, is_evaluated)| (conditions[*k].clone(), *is_evaluated))
        .collect();
    assert_eq!(statuses(&worker), after);
    // They have been logged.
    assert!(worker.watches.take_omitted().is_empty());
}
