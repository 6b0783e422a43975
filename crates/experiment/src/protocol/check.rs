//! Checks the changes of all blocks against the spec, in the order in which they are executed.
//!
//! The parameters at an execution are known, unless blocks with conditions or repeated ones change
//! them at some time before it. Then a change is rejected only if it is invalid with all parameters
//! that are possible there.

use jostle_physics::model::selection::{Selection, share};
use jostle_physics::model::{Parameters, ParametersError};
use jostle_physics::simulation::{
    Change, ChangeError, Placement, Simulation, Spec, Start, check_weights,
};
use toml::Spanned;

use super::block::Block;
use super::resolve::{Resolver, first_span};
use super::setting::Setting;
use crate::error::PlanError;
use crate::file::Table;
use crate::limits::MAX_INDIVIDUALS;

/// Maximum number of situations that are compared, and of blocks that may lead from one to another.
/// With more, changes are checked only by themselves.
const MAX_SITUATIONS: usize = 16;

/// Maximum number of situations in which a block with a condition is checked.
const MAX_SITUATIONS_OF_RUN: usize = 1000;

/// On what the validity of a change depends.
#[derive(Clone, Copy, PartialEq)]
struct Situation {
    parameters: Parameters,
    /// A lower bound of the largest weight of an individual.
    weight: f64,
}

impl Situation {
    fn of(setting: Setting<'_>) -> Self {
        let parameters = setting.spec.parameters;
        Self {
            parameters,
            weight: match setting.informed {
                0 => 0.0,
                _ => parameters.pi2,
            },
        }
    }

    /// Returns the situation after a change.
    fn after(mut self, change: &Change) -> Self {
        let weight_of = |weight: Option<f64>| weight.unwrap_or(self.parameters.pi2);
        match change {
            Change::Set(settings) => self.parameters = settings.of(self.parameters),
            Change::Inform {
                selection,
                weight,
                for_time,
                ..
            } => {
                let selects = match selection {
                    Selection::Ids(ids) => !ids.is_empty(),
                    Selection::Count(count) | Selection::Foremost { count, .. } => *count > 0,
                    Selection::Fraction(fraction) => share(1, *fraction) == Ok(1),
                    Selection::Within { .. } | Selection::Informed(_) => false,
                };
                let weight = weight_of(*weight);
                self.weight = match (for_time, selects) {
                    (Some(_), _) => 0.0,
                    (None, true) => weight,
                    (None, false) => self.weight.min(weight),
                };
            }
            Change::Uninform(_) | Change::Remove(_) => self.weight = 0.0,
            Change::Inject {
                informed: Some((_, weight)),
                ..
            } => self.weight = self.weight.max(weight_of(*weight)),
            Change::Inject { informed: None, .. } => {}
        }
        self
    }
}

/// A change that is invalid, and why.
type Rejected<'a> = (&'a Change, ChangeError);

/// The situations that are possible at one time of a run.
struct Possible {
    /// A swarm of one individual.
    checker: Simulation,
    situations: Vec<Situation>,
    /// Those of the whole run.
    of_run: Vec<Situation>,
    /// Whether there are more than were compared.
    is_open: bool,
    /// Whether the experiment is stored; see [`Source`](crate::file::Source).
    is_stored: bool,
}

impl Possible {
    /// Returns the situation after the changes of a block.
    fn after<'a>(
        &mut self,
        situation: Situation,
        changes: &'a [Change],
    ) -> Result<Situation, Rejected<'a>> {
        changes.iter().try_fold(situation, |now, change| {
            let state = &mut self.checker.state;
            state.parameters = now.parameters;
            state.configuration.inform(0, now.weight, 0.0, None);
            let mut checked = self.checker.check(change);
            if checked.is_ok() && !self.is_stored {
                let weights = check_weights(std::slice::from_ref(change), now.parameters.pi2);
                checked = weights.map_err(|(_, error)| error);
            }
            match checked {
                Ok(()) => Ok(now.after(change)),
                Err(error) => Err((change, error)),
            }
        })
    }

    /// Adds the situations to which changes lead that may be executed at this time.
    fn add(&mut self, maybe: &[&[Change]]) {
        if maybe.len() > MAX_SITUATIONS {
            self.is_open = true;
            return;
        }
        let mut next = 0;
        while let Some(&situation) = self.situations.get(next) {
            next += 1;
            for changes in maybe {
                if let Ok(after) = self.after(situation, changes)
                    && !self.situations.contains(&after)
                {
                    if self.situations.len() == MAX_SITUATIONS {
                        self.is_open = true;
                        return;
                    }
                    self.situations.push(after);
                }
            }
        }
    }

    /// Executes changes in every situation. The error is that of the first one if it is invalid in
    /// all of them.
    fn execute<'a>(&mut self, changes: &'a [Change]) -> Result<(), Rejected<'a>> {
        let situations = std::mem::take(&mut self.situations);
        let mut rejected = None;
        for &situation in &situations {
            match self.after(situation, changes) {
                Ok(after) if self.situations.contains(&after) => {}
                Ok(after) => self.situations.push(after),
                Err(error) => rejected = rejected.or(Some(error)),
            }
        }
        match rejected {
            Some(error) if self.situations.is_empty() => {
                self.situations = situations;
                self.unless_open(error)
            }
            _ => Ok(()),
        }
    }

    /// Checks changes that are executed at an unknown time.
    fn check_once<'a>(&mut self, changes: &'a [Change]) -> Result<(), Rejected<'a>> {
        let mut rejected = None;
        for situation in self.of_run.clone() {
            match self.after(situation, changes) {
                Ok(_) => return Ok(()),
                Err(error) => rejected = rejected.or(Some(error)),
            }
        }
        rejected.map_or(Ok(()), |error| self.unless_open(error))
    }

    /// Accepts what may be valid in a situation that was not compared.
    fn unless_open<'a>(&self, rejected: Rejected<'a>) -> Result<(), Rejected<'a>> {
        match rejected.1 {
            ChangeError::Parameters(
                ParametersError::Clash { .. } | ParametersError::StepTooLong { .. },
            )
            | ChangeError::Weightless
                if self.is_open =>
            {
                Ok(())
            }
            _ => Err(rejected),
        }
    }

    /// Adds the present situations to those of the run.
    fn keep(&mut self) {
        for situation in &self.situations {
            if self.of_run.len() == MAX_SITUATIONS_OF_RUN {
                self.is_open = true;
                return;
            }
            if !self.of_run.contains(situation) {
                self.of_run.push(*situation);
            }
        }
    }
}

/// The changes of a block at its first and its last execution, and when these are.
struct Ends {
    changes: [Vec<Change>; 2],
    /// The steps; none if it is executed under a condition.
    steps: Option<[u64; 2]>,
    is_repeated: bool,
}

impl Ends {
    fn of(block: &Block, dt: f64) -> Self {
        let ends = [0, block.executions() - 1];
        // A value of a ramp that is invalid was rejected before.
        let changes = ends.map(|executed| block.changes(executed).unwrap_or_default());
        let steps = ends.map(|executed| block.step(executed, dt));
        Self {
            changes,
            steps: match steps {
                [Some(first), Some(last)] => Some([first, last]),
                _ => None,
            },
            is_repeated: block.executions() > 1,
        }
    }

    /// Returns whether the block may have been executed once more before an execution at a step.
    fn is_possible(&self, step: u64, from: u64) -> bool {
        match self.steps {
            Some([first, last]) => self.is_repeated && first < step && step <= last,
            None => from <= step,
        }
    }
}

impl Resolver<'_> {
    /// Checks the changes of all blocks; `tables` are the blocks in the file.
    pub fn check(&self, blocks: &[Block], tables: &[Spanned<Table>]) -> Result<(), PlanError> {
        let dt = self.setting.spec.parameters.dt;
        let ends: Vec<Ends> = blocks.iter().map(|it| Ends::of(it, dt)).collect();
        self.check_numbers(blocks, &ends, tables)?;
        let Some(mut possible) = self.possible() else {
            return Ok(());
        };
        let mut events = Vec::new();
        for (index, end) in ends.iter().enumerate() {
            let [first, last] = end.steps.unwrap_or([u64::MAX; 2]);
            if end.steps.is_some() {
                events.push((first, index, 0));
            }
            if end.is_repeated {
                events.push((last, index, 1));
            }
        }
        events.sort_unstable();
        let from = |index: usize| blocks[index].trigger().map_or(0, |trigger| trigger.from);
        let maybe = |step: u64| -> Vec<&[Change]> {
            let others = ends.iter().enumerate();
            let others = others.filter(|(index, it)| it.is_possible(step, from(*index)));
            let both = others.flat_map(|(_, it)| &it.changes[..=usize::from(it.is_repeated)]);
            both.map(Vec::as_slice).collect()
        };
        let has_trigger = ends.iter().any(|it| it.steps.is_none());
        for (step, index, end) in events {
            possible.add(&maybe(step));
            let executed = possible.execute(&ends[index].changes[end]);
            executed.map_err(|rejected| self.rejected(&tables[index], rejected))?;
            if has_trigger {
                possible.keep();
            }
        }
        if has_trigger {
            possible.add(&maybe(u64::MAX));
            possible.keep();
        }
        for (index, end) in ends.iter().enumerate() {
            if end.steps.is_none() {
                let checked = possible.check_once(&end.changes[0]);
                checked.map_err(|rejected| self.rejected(&tables[index], rejected))?;
            }
        }
        Ok(())
    }

    /// Checks the numbers of all changes that no swarm accepts, and that their individuals can exist.
    fn check_numbers(
        &self,
        blocks: &[Block],
        ends: &[Ends],
        tables: &[Spanned<Table>],
    ) -> Result<(), PlanError> {
        let mut added = 0u64;
        for (block, end) in blocks.iter().zip(ends) {
            let count = injected(&end.changes[0]);
            added = added.saturating_add(count.saturating_mul(block.executions()));
        }
        let n = self.setting.spec.n as u64;
        if let Some(set_points) = self.setting.set_points {
            set_points.check(self.setting.steps(), n.saturating_add(added))?;
        }
        for (end, table) in ends.iter().zip(tables) {
            for change in end.changes.iter().flatten() {
                let checked = change.check().map_err(|error| error.to_string());
                let checked = checked.and_then(|()| check_selection(change, n, added));
                checked.map_err(|reason| self.reject_change(table, change, &reason))?;
            }
        }
        Ok(())
    }

    /// Returns the situation at the start; none if no swarm can have the spec, which the plan rejects.
    fn possible(&self) -> Option<Possible> {
        let spec = Spec {
            n: 1,
            start: Start::Disc(None),
            ..self.setting.spec.clone()
        };
        let start = Situation::of(self.setting);
        Some(Possible {
            checker: Simulation::new(&spec).ok()?,
            situations: vec![start],
            of_run: vec![start],
            is_open: false,
            is_stored: self.source.is_stored,
        })
    }

    fn rejected(&self, table: &Spanned<Table>, (change, error): Rejected<'_>) -> PlanError {
        self.reject_change(table, change, &error.to_string())
    }

    fn reject_change(&self, table: &Spanned<Table>, change: &Change, reason: &str) -> PlanError {
        let verb = verb_of(change);
        let mut keys = table.get_ref().keys();
        let key = keys.find(|key| key.get_ref() == verb);
        let span = key.map_or_else(|| first_span(table), Spanned::span);
        self.source.reject(&span, format!("{verb}: {reason}"))
    }
}

/// Returns the number of individuals that changes inject.
pub fn injected(changes: &[Change]) -> u64 {
    let counts = changes.iter().map(|change| match change {
        Change::Inject { place, .. } => match place {
            Placement::At(poses) => poses.len() as u64,
            Placement::Border(count) | Placement::Within(count, _) => *count as u64,
        },
        _ => 0,
    });
    counts.fold(0, u64::saturating_add)
}

/// Checks that the individuals of a selection can exist: `n` at the start, and at most `added`.
fn check_selection(change: &Change, n: u64, added: u64) -> Result<(), String> {
    let selection = match change {
        Change::Inject {
            place: Placement::Border(count) | Placement::Within(count, _),
            ..
        } if *count as u64 > MAX_INDIVIDUALS => {
            return Err(format!(
                "count = {count} is above the limit of {MAX_INDIVIDUALS}"
            ));
        }
        Change::Inform { selection, .. } => selection,
        Change::Uninform(selection) | Change::Remove(selection) => selection,
        Change::Set(_) | Change::Inject { .. } => return Ok(()),
    };
    let most = n.saturating_add(added);
    let group = match added {
        0 => format!("the group has {n} individuals"),
        _ => format!("the group has {n} individuals and at most {added} are added"),
    };
    match selection {
        Selection::Ids(ids) => match ids.iter().find(|&&id| u64::from(id) >= most) {
            Some(id) => Err(format!("select.ids: {id} cannot exist: {group}")),
            None => Ok(()),
        },
        Selection::Count(count) | Selection::Foremost { count, .. } if *count as u64 > most => {
            Err(format!("select: {count} individuals are too many: {group}"))
        }
        _ => Ok(()),
    }
}

fn verb_of(change: &Change) -> &'static str {
    match change {
        Change::Set(_) => "set",
        Change::Inform { .. } => "inform",
        Change::Uninform(_) => "uninform",
        Change::Inject { .. } => "inject",
        Change::Remove(_) => "remove",
    }
}
