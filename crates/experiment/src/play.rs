//! The swarm of a run, with the commands of its protocol scheduled.

use jostle_convert::{change, spec};
use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::Change;
use jostle_proto::{Spec, verbs};
use thiserror::Error;

use crate::plan::{Plan, PlannedRun};
use crate::protocol::Block;
use crate::run::{DIRECTION, INFORMED_BY};

/// What a client sends to a daemon so that a swarm has the states of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct LiveRun {
    /// The spec of the swarm, with the seed of the run.
    pub spec: Spec,
    /// The number of steps of the run, at most.
    pub steps: u64,
    /// The commands, in the order in which the run executes them.
    pub commands: Vec<ScheduledBatch>,
    /// The condition that ends the run, but not the swarm.
    pub stop: Option<String>,
}

/// The commands of one execution of an `[[at]]` block.
#[derive(Clone, Debug, PartialEq)]
pub struct ScheduledBatch {
    /// The step before which they are executed.
    pub step: u64,
    /// The commands, with the key of their draws.
    pub args: verbs::BatchArgs,
}

/// Why a run cannot be scheduled.
#[derive(Debug, Error)]
pub enum PlayError {
    /// A block has a condition.
    #[error(
        "the [[at]] of line {0} is executed under a condition, which cannot be scheduled: give \
         it a time, or execute the run with `jostle experiment run`"
    )]
    Condition(usize),
    /// The run starts from a snapshot.
    #[error(
        "the run starts from a snapshot with another seed: `jostle restore` creates a swarm from a \
         snapshot"
    )]
    Start,
    /// The run has set-points.
    #[error(
        "the file has setpoints, which cannot be scheduled: execute the run with `jostle experiment \
         run`, or steer a swarm with a controller"
    )]
    SetPoints,
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
    /// [`PlayError::Start`] if the file has `start`, [`PlayError::SetPoints`] if it has
    /// `setpoints`, [`PlayError::Condition`] if a block has a
    /// condition.
    pub fn new(plan: &Plan, run: &PlannedRun) -> Result<Self, PlayError> {
        if plan.base.is_some() {
            return Err(PlayError::Start);
        }
        if plan.set_points.is_some() {
            return Err(PlayError::SetPoints);
        }
        let point = plan.point(run);
        let (dt, steps) = (point.spec.parameters.dt, point.steps);
        let (mut commands, mut draw) = (Vec::new(), INFORMED_BY);
        if point.informed > 0 {
            let inform = Change::inform(Selection::Count(point.informed), DIRECTION);
            commands.push(batch(0, draw, &[inform]));
            draw += 1;
        }
        let blocks = point.protocol.iter().flat_map(|it| &it.blocks);
        let mut executions = Vec::new();
        for (index, block) in blocks.enumerate() {
            if block.trigger().is_some() {
                return Err(PlayError::Condition(block.line));
            }
            for (executed, step) in steps_of(block, dt, steps) {
                executions.push((step, index, executed, block));
            }
        }
        executions.sort_by_key(|&(step, index, ..)| (step, index));
        for (step, _, executed, block) in executions {
            let changes = block.changes(executed);
            let changes = changes.map_err(|reason| PlayError::Invalid {
                line: block.line,
                step,
                reason,
            })?;
            let count = changes.len() as u64;
            match block.draw {
                Some(first) => commands.push(batch(step, first + executed * count, &changes)),
                None => {
                    commands.push(batch(step, draw, &changes));
                    draw += count;
                }
            }
        }
        let stop = point.protocol.as_ref().and_then(|it| it.stop.as_ref());
        Ok(Self {
            spec: spec::to_proto(&point.spec, run.seed),
            steps,
            commands,
            stop: stop.map(|stop| stop.condition.to_string()),
        })
    }
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

fn batch(step: u64, draw: u64, changes: &[Change]) -> ScheduledBatch {
    ScheduledBatch {
        step,
        args: verbs::BatchArgs {
            commands: changes.iter().map(change::to_proto).collect(),
            draw: Some(draw),
        },
    }
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
        let mut commands = live.commands.iter().peekable();
        for step in 0..live.steps {
            while let Some(command) = commands.next_if(|it| it.step == step) {
                let changes = command.args.commands.iter().cloned();
                let changes: Vec<Change> = changes.map(|it| change::change(it).unwrap()).collect();
                simulation.seq = command.args.draw.unwrap();
                simulation.apply_all(&changes).unwrap();
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

    #[test]
    fn a_block_with_a_condition_is_rejected_and_a_stop_is_reported() {
        let stop = format!("{FILE}[stop]\nwhen = \"order > 0.99  for 100\"\n");
        let plan = Plan::parse(&stop).unwrap();
        let live = LiveRun::new(&plan, &plan.runs()[0]).unwrap();
        assert_eq!(live.stop.as_deref(), Some("order > 0.99 for 100"));
        let when = format!("{FILE}[[at]]\nwhen = \"order > 0.9\"\nset = {{ pi2 = 1 }}\n");
        let line = when.lines().count() - 2;
        let plan = Plan::parse(&when).unwrap();
        let error = LiveRun::new(&plan, &plan.runs()[0]).unwrap_err();
        assert!(
            matches!(error, PlayError::Condition(at) if at == line + 1),
            "{error}"
        );
    }
}
