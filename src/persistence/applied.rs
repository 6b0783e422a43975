//! The changes that were applied to a swarm since its start, read from the store.

use jostle_experiment::{AppliedChange, MAX_BLOCKS, SetPointLog};
use jostle_physics::simulation::{self, Spec};
use jostle_proto::verbs::{BatchArgs, Change, WhenArgs};
use serde_json::{Value, json};

use crate::convert::commands::CommandError;
use crate::persistence::journal_reader::{
    AppliedInput, AppliedInputs, JournalReader, parse_command,
};
use crate::persistence::recoveries::Recoveries;
use crate::persistence::replay::{first_readable, stored_checkpoints};
use crate::persistence::steering::Steering;
use crate::store::Store;
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::command::Command;

/// What was done to a swarm since its start.
pub struct ChangesSinceStart {
    /// Its first changes, at least as many as the file of an experiment can have.
    pub changes: Vec<AppliedChange>,
    /// The number of the changes after these.
    pub omitted: u64,
    /// What controllers did with individuals.
    pub set_points: SetPointLog,
}

/// Returns what was done to a swarm from its start, or its last reset, to `present`.
///
/// # Errors
///
/// [`CommandError::History`] if the journal since then is damaged or no longer stored, if the swarm
/// did not begin with its spec, or if it is unknown which individuals a controller released.
pub fn changes_since_start(
    store: &Store,
    swarm: &str,
    present: &Checkpoint,
) -> Result<ChangesSinceStart, CommandError> {
    let mut checkpoints = stored_checkpoints(store, swarm)?;
    checkpoints.reverse();
    let first = first_readable(store, swarm, checkpoints)?;
    let mut history = History::new(&first);
    let mut inputs = AppliedInputs::default();
    for (_, scheduled) in &first.scheduled {
        inputs.wait_for(scheduled.input, scheduled.sender.clone());
    }
    let mut recoveries = Recoveries::new(store, swarm);
    let mut read = first.lines;
    for line in JournalReader::new(store, swarm, first.lines, present.lines) {
        let (line, _) = line.map_err(|error| CommandError::History(error.to_string()))?;
        read = line.number;
        if recoveries
            .took_back(&line)
            .map_err(|error| CommandError::History(error.to_string()))?
        {
            continue;
        }
        if let Some(input) = inputs.read(line) {
            history.add(&input).map_err(CommandError::History)?;
        }
    }
    if read < present.lines {
        let problem = "its newest commands are not on the disk yet: retry in a moment, or once the \
                       disk has room";
        return Err(CommandError::History(problem.to_owned()));
    }
    match history.problem {
        Some(problem) => Err(CommandError::History(problem)),
        None => Ok(ChangesSinceStart {
            changes: history.changes,
            omitted: history.omitted,
            set_points: history.set_points,
        }),
    }
}

/// The changes of the present run, as far as it has been read.
struct History {
    changes: Vec<AppliedChange>,
    omitted: u64,
    set_points: SetPointLog,
    controllers: Steering,
    /// How many annotations were applied, which do not count for draws.
    annotations: u64,
    /// The number of changes by commands of a protocol.
    protocol_draws: u64,
    /// Why the changes do not determine the state.
    problem: Option<String>,
}

impl History {
    fn new(first: &Checkpoint) -> Self {
        let step = first.simulation.state.step;
        let problem = (!is_start(&first.simulation)).then(|| match step {
            0 => {
                "it was not created from its spec, but from a state with other commands: export the \
                 swarm that it is a copy of, or name a snapshot of it as start of a file"
                    .to_owned()
            }
            _ => format!(
                "its commands are stored from step {step} on, since it is a copy or older ones were removed \
                 (quota_mb): the run of a file begins with step 0. Export the swarm that it is a copy \
                 of, or name a snapshot of it as start of a file"
            ),
        });
        History {
            changes: Vec::new(),
            omitted: 0,
            set_points: SetPointLog::default(),
            controllers: Steering::of(&first.controllers),
            annotations: first.annotations,
            protocol_draws: first.protocol_draws,
            problem,
        }
    }

    /// Adds a command. The error is the reason if its arguments cannot be read.
    fn add(&mut self, input: &AppliedInput) -> Result<(), String> {
        let step = input.step;
        match parse_command(&input.sender)? {
            Command::Reset(_) => {
                self.changes.clear();
                self.omitted = 0;
                self.set_points.clear();
                self.controllers.reset();
                self.protocol_draws = 0;
                self.problem = None;
            }
            command if command.is_annotation() => self.annotations += 1,
            Command::Change(_) => {
                let args: Value = read(&input.sender.args)?;
                let verb = input.sender.verb;
                let change = serde_json::from_value(json!({"verb": verb, "args": args}));
                let change = change.map_err(|error| error.to_string())?;
                self.push(step, input.seq.saturating_sub(self.annotations), change);
            }
            Command::Batch { .. } => {
                let BatchArgs {
                    commands,
                    draw,
                    protocol,
                } = read(&input.sender.args)?;
                self.push_batch(input, commands, draw, protocol);
            }
            Command::Fired(_) => {
                let WhenArgs {
                    commands,
                    draw,
                    protocol,
                    ..
                } = read(&input.sender.args)?;
                self.push_batch(input, commands.unwrap_or_default(), draw, protocol);
            }
            Command::Run { .. }
            | Command::Pause
            | Command::Step(_)
            | Command::Watch(_)
            | Command::Unwatch(_)
            | Command::Annotate
            | Command::Protect(_)
            | Command::Delete => {}
            command => match self.controllers.on(command) {
                Ok(points) => {
                    for (id, point) in points {
                        let now = self.changes.iter().rev();
                        let after = now.take_while(|change| change.step == step).count();
                        self.set_points.push(step, after as u64, id, point);
                    }
                }
                // A later reset makes it irrelevant.
                Err(problem) => {
                    self.problem.get_or_insert(problem);
                }
            },
        }
        Ok(())
    }

    /// Adds the changes of a batch, whose draws have the numbers from `draw` on, those of a protocol, or
    /// those up to its `seq`.
    fn push_batch(
        &mut self,
        input: &AppliedInput,
        changes: Vec<Change>,
        draw: Option<u64>,
        is_of_protocol: bool,
    ) {
        let last = input.seq.saturating_sub(self.annotations);
        let count = changes.len() as u64;
        let first = match draw {
            Some(draw) => draw,
            None if is_of_protocol => {
                self.protocol_draws += count;
                self.protocol_draws + 1 - count
            }
            None => (last + 1).saturating_sub(count),
        };
        for (change, draw) in changes.into_iter().zip(first..) {
            self.push(input.step, draw, change);
        }
    }

    fn push(&mut self, step: u64, draw: u64, change: Change) {
        self.set_points.changed();
        // One more than a file can have, which is rejected: the others are only counted.
        match self.changes.len() <= MAX_BLOCKS {
            true => self.changes.push(AppliedChange { step, draw, change }),
            false => self.omitted += 1,
        }
    }
}

fn read<T: serde::de::DeserializeOwned>(args: &str) -> Result<T, String> {
    serde_json::from_str(args).map_err(|error| error.to_string())
}

/// Whether a simulation is at the start of its spec, with its present seed.
fn is_start(checkpoint: &simulation::Checkpoint) -> bool {
    let spec = Spec {
        seed: checkpoint.state.seed,
        ..checkpoint.spec.clone()
    };
    checkpoint.state.step == 0
        && simulation::begin(&spec).is_ok_and(|state| state.hash() == checkpoint.state.hash())
}
