//! The swarm of a run, with the commands of its protocol scheduled and its conditions waiting.

use jostle_conditions::{Condition, Held};
use jostle_convert::{change, spec};
use jostle_measures::{MAX_COSTLY_INDIVIDUALS, Past, View};
use jostle_physics::model::State;
use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::{Change, ChangeError};
use jostle_proto::{Spec, verbs};
use thiserror::Error;

use crate::plan::{Plan, PlannedRun};
use crate::protocol::{Block, Protocol, Trigger};
use crate::run::{self, DIRECTION, INFORMED_BY};

/// The most commands that a swarm schedules, and the most bytes of their arguments.
pub const MAX_COMMANDS: (usize, usize) = (1024, 256 * 1024);

/// What a client sends to a daemon so that a swarm has the states of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct LiveRun {
    /// The spec of the swarm, with the seed of the run.
    pub spec: Spec,
    /// The contents of the snapshot file from which the swarm is restored, with the seed of the run; none
    /// if the swarm is created from its spec.
    pub snapshot: Option<Vec<u8>>,
    /// The number of steps of the run, at most.
    pub steps: u64,
    /// The commands, in the order in which a client sends them.
    pub commands: Vec<LiveCommand>,
    /// The condition that ends the run, and pauses the swarm; none if it never holds.
    pub stop: Option<String>,
}

/// A command of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum LiveCommand {
    /// The changes of one execution of an `[[at]]` block, or of the individuals that are informed from
    /// the start.
    Batch {
        /// The step before which they are executed.
        step: u64,
        /// The changes, with the key of their draws.
        args: verbs::BatchArgs,
    },
    /// An `[[at]]` block with a condition, or `[stop]`.
    When(verbs::WhenArgs),
}

/// Why a run cannot be played.
#[derive(Debug, Error)]
pub enum PlayError {
    /// A condition has a measure that a daemon does not evaluate for so many individuals.
    #[error(
        "the condition {condition:?} has a measure with a cost above n, which a daemon evaluates for \
         at most {MAX_COSTLY_INDIVIDUALS} individuals: execute the run with `jostle experiment run`"
    )]
    Costly {
        /// The condition.
        condition: String,
    },
    /// The condition of `[stop]` holds at the start.
    #[error("the condition of [stop] holds at step 0, which is a fault of the run: give from")]
    StopsAtStart,
    /// The run has no start.
    #[error(transparent)]
    NoStart(#[from] ChangeError),
    /// The run has set-points.
    #[error(
        "the file has setpoints, which cannot be scheduled: execute the run with `jostle experiment \
         run`, or steer a swarm with a controller"
    )]
    SetPoints,
    /// The run has more commands than a swarm schedules.
    #[error(
        "the run has more commands after step 0 than a swarm schedules, which is {} with {} KiB of \
         arguments: execute it with `jostle experiment run`, or choose a larger `every`",
        MAX_COMMANDS.0, MAX_COMMANDS.1 / 1024
    )]
    TooMany,
    /// The values of a ramp are invalid.
    #[error("the [[at]] of line {line}, at step {step}: {reason}")]
    Invalid {
        /// The first line of the block.
        line: usize,
        /// The step.
        step: u64,
        /// The reason.
        reason: String,
    },
}

impl LiveRun {
    /// Returns the swarm of a run and its commands.
    ///
    /// # Errors
    ///
    /// [`PlayError::SetPoints`] if the file has `setpoints`, [`PlayError::StopsAtStart`] if the run ends
    /// with a fault at step 0, [`PlayError::Costly`] if a daemon does not evaluate a condition,
    /// [`PlayError::TooMany`] if a swarm does not schedule all commands, [`PlayError::NoStart`] if the
    /// parameters do not fit the start.
    pub fn new(plan: &Plan, run: &PlannedRun) -> Result<Self, PlayError> {
        if plan.set_points.is_some() {
            return Err(PlayError::SetPoints);
        }
        let point = plan.point(run);
        let empty = Protocol::default();
        let protocol = point.protocol.as_deref().unwrap_or(&empty);
        let mut player = Player {
            protocol,
            dt: point.spec.parameters.dt,
            steps: point.steps,
            has_conditions: protocol.blocks.iter().any(|it| it.trigger().is_some()),
            draw: INFORMED_BY,
            bytes: 0,
            commands: Vec::new(),
        };
        // In a snapshot they are informed already.
        if point.informed > 0 && plan.base.is_none() {
            let inform = Change::inform(Selection::Count(point.informed), DIRECTION);
            player.push(0, None, &[inform])?;
        }
        let at_once = player.push_conditions(&run::start(plan, run)?)?;
        player.push_executions(at_once)?;
        let base = plan.base.as_ref();
        let snapshot = base.map(|it| it.snapshot(&plan.spec(run), run::reserve()));
        Ok(Self {
            spec: spec::to_proto(&point.spec, run.seed),
            snapshot: snapshot.transpose()?,
            steps: point.steps,
            commands: player.commands,
            stop: stop_of(protocol).map(|it| it.condition.to_string()),
        })
    }
}

/// Collects the commands of a run.
struct Player<'a> {
    protocol: &'a Protocol,
    dt: f64,
    steps: u64,
    /// Whether blocks have conditions: the daemon counts the changes then, and otherwise they are counted
    /// here.
    has_conditions: bool,
    /// The key of the draws of the next change.
    draw: u64,
    /// The bytes of the arguments of the scheduled commands.
    bytes: usize,
    commands: Vec<LiveCommand>,
}

impl<'a> Player<'a> {
    /// Adds the conditions that do not hold at the start. Returns the blocks whose condition does.
    fn push_conditions(&mut self, start: &State) -> Result<Vec<(usize, &'a Block)>, PlayError> {
        let (protocol, steps) = (self.protocol, self.steps);
        let past = Past::default();
        let view = View::new(start, &past);
        let injected = usize::try_from(protocol.injected()).unwrap_or(usize::MAX);
        let most = start.configuration.n().saturating_add(injected);
        let holds = |trigger: &Trigger| {
            check_cost(&trigger.condition, most)?;
            Ok::<_, PlayError>(trigger.observe(&view, 0, self.dt, &mut Held::default()))
        };
        let mut at_once = Vec::new();
        let mut conditions = Vec::new();
        if let Some(stop) = stop_of(protocol) {
            if holds(stop)? {
                return Err(PlayError::StopsAtStart);
            }
            conditions.push(verbs::WhenArgs {
                pause: true,
                // It is evaluated on the last state too.
                ..when(stop, steps + 1)
            });
        }
        for (index, block) in protocol.blocks.iter().enumerate() {
            let Some(trigger) = block.trigger().filter(|it| can_hold(it)) else {
                continue;
            };
            if holds(trigger)? {
                at_once.push((index, block));
                continue;
            }
            let changes = changes(block, 0, 0)?;
            conditions.push(verbs::WhenArgs {
                commands: Some(changes.iter().map(change::to_proto).collect()),
                draw: block.draw,
                ..when(trigger, steps)
            });
        }
        self.commands
            .extend(conditions.into_iter().map(LiveCommand::When));
        Ok(at_once)
    }

    /// Adds the executions of the blocks without conditions, after those that are executed at once.
    fn push_executions(&mut self, at_once: Vec<(usize, &Block)>) -> Result<(), PlayError> {
        let mut executions = Vec::new();
        let mut scheduled = 0;
        for (index, block) in at_once {
            executions.push((0, false, index, 0, block));
        }
        for (index, block) in self.protocol.blocks.iter().enumerate() {
            for (executed, step) in steps_of(block, self.dt, self.steps) {
                scheduled += usize::from(step > 0);
                if scheduled > MAX_COMMANDS.0 {
                    return Err(PlayError::TooMany);
                }
                executions.push((step, true, index, executed, block));
            }
        }
        executions.sort_by_key(|&(step, is_scheduled, index, ..)| (step, is_scheduled, index));
        for (step, _, _, executed, block) in executions {
            let changes = changes(block, executed, step)?;
            let count = changes.len() as u64;
            self.push(step, block.draw.map(|it| it + executed * count), &changes)?;
        }
        Ok(())
    }

    fn push(&mut self, step: u64, draw: Option<u64>, changes: &[Change]) -> Result<(), PlayError> {
        let next = self.draw;
        if draw.is_none() {
            self.draw += changes.len() as u64;
        }
        let args = verbs::BatchArgs {
            commands: changes.iter().map(change::to_proto).collect(),
            draw: draw.or_else(|| (!self.has_conditions).then_some(next)),
            protocol: self.has_conditions,
        };
        // A daemon executes those of step 0 at once.
        if step > 0 {
            self.bytes += serde_json::to_vec(&args).map_or(0, |it| it.len());
            if self.bytes > MAX_COMMANDS.1 {
                return Err(PlayError::TooMany);
            }
        }
        self.commands.push(LiveCommand::Batch { step, args });
        Ok(())
    }
}

/// Returns the condition that ends the run; none if it never holds.
fn stop_of(protocol: &Protocol) -> Option<&Trigger> {
    protocol.stop.as_ref().filter(|it| can_hold(it))
}

/// Whether a daemon accepts the condition. The run has the same states without one that never holds.
fn can_hold(trigger: &Trigger) -> bool {
    trigger.condition.never_holds().is_none()
}

/// Returns a condition of a protocol, without its action. `before` is the first step at which it does
/// not wait.
fn when(trigger: &Trigger, before: u64) -> verbs::WhenArgs {
    verbs::WhenArgs {
        condition: Some(trigger.condition.to_string()),
        from_step: Some(trigger.from),
        before_step: Some(before),
        protocol: true,
        ..verbs::WhenArgs::default()
    }
}

fn check_cost(condition: &Condition, n: usize) -> Result<(), PlayError> {
    let mut comparisons = condition.comparisons().iter();
    match comparisons.any(|it| it.measure.is_too_costly(n)) {
        true => Err(PlayError::Costly {
            condition: condition.to_string(),
        }),
        false => Ok(()),
    }
}

fn changes(block: &Block, executed: u64, step: u64) -> Result<Vec<Change>, PlayError> {
    block
        .changes(executed)
        .map_err(|reason| PlayError::Invalid {
            line: block.line,
            step,
            reason,
        })
}

/// Returns the executions of a block, each with the number of executions before it and its step.
/// A run executes a block at most once between two steps.
fn steps_of(block: &Block, dt: f64, end: u64) -> impl Iterator<Item = (u64, u64)> {
    let mut earliest = 0;
    (0..).map_while(move |executed| {
        let step = block.step(executed, dt)?.max(earliest);
        earliest = step + 1;
        (step < end).then_some((executed, step))
    })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use jostle_convert::hexadecimal;
    use jostle_physics::simulation::Simulation;

    use super::*;
    use crate::run::execute_run;

    const FILE: &str = "
name = \"a\"
seed = 5
replicates = 2
duration = 6
[spec]
n = 14
dt = 0.05
[[grid]]
informed = [0, 3]
share = 0.3
[[at]]
every = 0.5
from = 1
until = 3
set = { noise = { ramp = [0, 0.4] } }
[[at]]
step = 40
inject = { count = 2, direction = 1 }
remove = { select = { count = 3 } }
[[at]]
time = 2
inform = { select = { fraction = \"$share\" }, direction = 2, weight = 0.4, for_time = 1 }
[[at]]
time = 4
draw = 77
uninform = { select = { fraction = 0.5 } }
";

    /// Executes the commands as a daemon does, and returns the last hash.
    fn played(live: &LiveRun) -> String {
        let n = usize::try_from(live.spec.n).unwrap();
        let spec = spec::from_proto(&live.spec, n).unwrap();
        let mut simulation = Simulation::new(&spec).unwrap();
        let commands = live.commands.iter().map(|command| match command {
            LiveCommand::Batch { step, args } => (*step, args),
            LiveCommand::When(args) => panic!("{args:?}"),
        });
        let mut commands = commands.peekable();
        for step in 0..live.steps {
            while let Some((_, args)) = commands.next_if(|it| it.0 == step) {
                assert!(!args.protocol);
                let changes = args.commands.iter().cloned();
                let changes: Vec<Change> = changes.map(|it| change::change(it).unwrap()).collect();
                let first = args.draw.unwrap();
                simulation.apply_all_at(first, &changes).unwrap();
            }
            simulation.step().unwrap();
        }
        assert_eq!(commands.next(), None);
        hexadecimal(&simulation.state.hash())
    }

    #[test]
    fn the_commands_give_the_states_of_the_run() {
        let plan = Plan::parse(FILE).unwrap();
        for run in plan.runs() {
            let live = LiveRun::new(&plan, run).unwrap();
            assert!(live.commands.len() >= 8, "{}", live.commands.len());
            let finished = execute_run(&plan, run, |_| true).unwrap();
            assert_eq!(finished.fault, None);
            assert_eq!(played(&live), finished.row.unwrap().state_hash, "{run:?}");
        }
    }

    /// The commands of the first run of the file with more blocks.
    fn commands(more: &str) -> Result<Vec<LiveCommand>, PlayError> {
        let plan = Plan::parse(&format!("{FILE}{more}")).unwrap();
        let live = LiveRun::new(&plan, &plan.runs()[0])?;
        assert_eq!(live.stop.is_some(), more.contains("[stop]"));
        Ok(live.commands)
    }

    /// The conditions among the commands before the first batch, and whether others follow.
    fn conditions(commands: &[LiveCommand]) -> Vec<verbs::WhenArgs> {
        let conditions = commands.iter().map_while(|it| match it {
            LiveCommand::When(args) => Some(args.clone()),
            LiveCommand::Batch { .. } => None,
        });
        conditions.collect()
    }

    #[test]
    fn conditions_are_sent_first_and_the_daemon_counts_the_changes() {
        let stop = "[stop]\nfrom = 1\nwhen = \"order > 0.99  for 100\"\n";
        let all = commands(stop).unwrap();
        let expected = verbs::WhenArgs {
            condition: Some("order > 0.99 for 100".to_owned()),
            pause: true,
            protocol: true,
            from_step: Some(20),
            before_step: Some(121),
            ..verbs::WhenArgs::default()
        };
        assert_eq!(conditions(&all), [expected]);
        let when = "[[at]]\ndraw = 9\nwhen = \"order > 0.99999\"\nset = { pi2 = 1 }\n";
        let all = commands(when).unwrap();
        let [condition] = &conditions(&all)[..] else {
            panic!("{all:?}")
        };
        assert_eq!(
            (condition.draw, condition.from_step, condition.before_step),
            (Some(9), Some(0), Some(120))
        );
        assert_eq!(condition.commands.as_ref().map(Vec::len), Some(1));
        let batches = all[1..].iter().map(|it| match it {
            LiveCommand::Batch { args, .. } => args,
            LiveCommand::When(args) => panic!("{args:?}"),
        });
        let draws: Vec<Option<u64>> = batches.map(|it| it.draw.filter(|_| it.protocol)).collect();
        assert_eq!(draws.iter().flatten().collect::<Vec<_>>(), [&77]);
    }

    #[test]
    fn what_holds_at_the_start_is_executed_before_the_blocks_of_step_0() {
        let more = "[[at]]\nstep = 0\nset = { pi3 = 2 }\n[[at]]\nwhen = \"order >= 0\"\nset = { pi2 = 1 }\n";
        let all = commands(more).unwrap();
        let at_start = all.iter().map_while(|it| match it {
            LiveCommand::Batch { step: 0, args } => Some(args.commands.len()),
            _ => None,
        });
        assert_eq!(at_start.collect::<Vec<_>>(), [1, 1]);
        let LiveCommand::Batch { args, .. } = &all[0] else {
            panic!("{all:?}")
        };
        assert!(matches!(&args.commands[0], verbs::Change::Set(set) if set.pi2 == Some(1.0)));
        let stops = commands("[stop]\nwhen = \"order >= 0\"\n").unwrap_err();
        assert!(matches!(stops, PlayError::StopsAtStart), "{stops}");
    }

    /// The result of the first run of a file with this duration, which has only these blocks.
    fn played_alone(duration: f64, blocks: &str) -> Result<LiveRun, PlayError> {
        let head =
            format!("name = \"a\"\nduration = {duration:?}\nspec = {{ n = 2, dt = 0.02 }}\n");
        let plan = Plan::parse(&format!("{head}{blocks}")).unwrap();
        LiveRun::new(&plan, &plan.runs()[0])
    }

    #[test]
    fn at_most_1024_commands_are_scheduled() {
        let set = "[[at]]\nevery = 0.02\nset = { pi2 = 1 }\n";
        // One at step 0, which is not scheduled, and one before each other step.
        let live = played_alone(20.5, set).unwrap();
        assert_eq!(live.commands.len(), 1025);
        for duration in [20.52, 2e7] {
            let error = played_alone(duration, set).unwrap_err();
            assert!(matches!(error, PlayError::TooMany), "{error}");
            assert!(error.to_string().contains("1024 with 256 KiB"), "{error}");
        }
    }

    #[test]
    fn the_bytes_of_the_scheduled_commands_are_limited() {
        let pose = |k: u32| format!("{{ x = {k}0, y = 100, alpha = 0.5 }}");
        let poses: Vec<String> = (10..310).map(pose).collect();
        let inject = format!(
            "[[at]]\nevery = 0.02\ninject = {{ at = [{}] }}\n",
            poses.join(", ")
        );
        // Of each, the poses alone have at least 9,000 bytes, and at most 12,000.
        assert!(played_alone(0.4, &inject).is_ok());
        let error = played_alone(0.64, &inject).unwrap_err();
        assert!(matches!(error, PlayError::TooMany), "{error}");
    }

    #[test]
    fn injected_individuals_count_for_the_cost_of_a_condition() {
        let costly = "[stop]\nwhen = \"clusters.largest > 1e6\"\n";
        let inject = |count: u64| {
            format!(
                "[[at]]\nevery = 0.02\nfrom = 0.02\nuntil = 0.04\ninject = {{ count = {count} }}\n{costly}"
            )
        };
        // Two executions, and 2 individuals at the start.
        assert!(played_alone(0.06, &inject(9_999)).is_ok());
        let error = played_alone(0.06, &inject(10_000)).unwrap_err();
        assert!(matches!(error, PlayError::Costly { .. }), "{error}");
    }

    #[test]
    fn conditions_that_never_hold_are_left_out() {
        let never =
            "[[at]]\nwhen = \"order > 1.5\"\nset = { pi2 = 1 }\n[stop]\nwhen = \"order < -1\"\n";
        let live = played_alone(2.0, never).unwrap();
        assert_eq!((live.commands, live.stop), (Vec::new(), None));
    }
}
