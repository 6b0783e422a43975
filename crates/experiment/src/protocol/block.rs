//! One `[[at]]` block of a run: when it is executed, and its changes.

use jostle_conditions::{Condition, Held};
use jostle_measures::View;
use jostle_physics::simulation::{Change, steps_in};
use toml::Value;

use super::arguments::{ROUNDING, at_share, has_ramp, to_change};

/// A block of a protocol.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// Its first line in the file.
    pub line: usize,
    /// When it is executed.
    pub(super) timing: Timing,
    /// The key of the draws of its first change, together with the seed of the run. None continues
    /// the numbering of the changes.
    pub draw: Option<u64>,
    pub(super) changes: Changes,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Timing {
    /// Once, at this step.
    Step(u64),
    /// Repeatedly, in time units.
    Repeated { from: f64, until: f64, every: f64 },
    /// Once, when this holds.
    When(Trigger),
}

/// A condition that is evaluated from a step on.
#[derive(Clone, Debug, PartialEq)]
pub struct Trigger {
    /// The condition.
    pub condition: Condition,
    /// The first step at which it is evaluated.
    pub from: u64,
}

impl Trigger {
    /// Evaluates the condition on the state after `step` steps, as [`Condition::observe`].
    pub fn observe(&self, view: &View<'_>, step: u64, dt: f64, held: &mut Held) -> bool {
        step >= self.from && self.condition.observe(view, step, dt, held)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Changes {
    Fixed(Vec<Change>),
    /// Verbs with their arguments, which may contain ramps.
    Template(Vec<(String, Value)>),
}

impl Block {
    /// Returns the step at which the block is executed after `executed` executions; none if it is not
    /// executed again, or under a condition.
    pub fn step(&self, executed: u64, dt: f64) -> Option<u64> {
        match self.timing {
            Timing::Step(step) => (executed == 0).then_some(step),
            Timing::Repeated { from, until, every } => {
                let time = from + executed as f64 * every;
                (time <= until * (1.0 + ROUNDING)).then(|| steps_in(time, dt))
            }
            Timing::When(_) => None,
        }
    }

    /// Returns what triggers the block, once; none if it is executed at steps.
    pub fn trigger(&self) -> Option<&Trigger> {
        match &self.timing {
            Timing::When(trigger) => Some(trigger),
            Timing::Step(_) | Timing::Repeated { .. } => None,
        }
    }

    /// Returns the number of executions, at most.
    pub fn executions(&self) -> u64 {
        match self.timing {
            Timing::Step(_) | Timing::When(_) => 1,
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "positive, and saturates"
            )]
            Timing::Repeated { from, until, every } => {
                ((until - from) / every * (1.0 + ROUNDING)) as u64 + 1
            }
        }
    }

    /// Returns the changes of an execution, by the number of executions before it.
    ///
    /// # Errors
    ///
    /// The reason if a value of a ramp is invalid.
    pub fn changes(&self, executed: u64) -> Result<Vec<Change>, String> {
        let templates = match &self.changes {
            Changes::Fixed(changes) => return Ok(changes.clone()),
            Changes::Template(templates) => templates,
        };
        let share = self.share(executed);
        let changes = templates.iter();
        changes
            .map(|(verb, args)| to_change(verb, &at_share(args, share)))
            .collect()
    }

    /// Returns the verbs of an execution with their arguments as TOML; none if they are converted.
    pub fn commands(&self, executed: u64) -> Vec<String> {
        let templates = match &self.changes {
            Changes::Fixed(_) => return Vec::new(),
            Changes::Template(templates) => templates,
        };
        let share = self.share(executed);
        let commands = templates.iter();
        commands
            .map(|(verb, args)| format!("{verb} = {}", at_share(args, share)))
            .collect()
    }

    /// Returns whether its commands contain a ramp.
    pub(super) fn has_ramp(&self) -> bool {
        match &self.changes {
            Changes::Fixed(_) => false,
            Changes::Template(templates) => templates.iter().any(|(_, args)| has_ramp(args)),
        }
    }

    /// Returns the share of the time of its ramps at an execution.
    fn share(&self, executed: u64) -> f64 {
        match self.timing {
            Timing::Repeated { from, until, every } if until > from => {
                (executed as f64 * every / (until - from)).min(1.0)
            }
            _ => 0.0,
        }
    }
}
