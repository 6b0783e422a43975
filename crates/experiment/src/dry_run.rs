//! What an experiment would do, without doing it: its conditions, the protocol of one run, and an
//! estimate of processor time and disk space.

use std::fmt::{self, Display};

use serde::Serialize;

use crate::error::PlanError;
use crate::plan::{Plan, PlannedRun, Point};
use crate::protocol::{Block, Trigger};
use crate::start::start_remark;
use crate::subset::Subset;

pub use self::estimate::{Estimate, Measured};
pub use self::need::DiskNeed;

mod estimate;
mod need;

/// How many conditions and blocks are listed.
const MAX_LISTED: usize = 20;

/// How many executions of a block are listed before the last one.
const MAX_EXECUTIONS: u64 = 3;

/// What an experiment would do. Its text is for a person.
#[derive(Clone, Debug, Serialize)]
pub struct DryRun {
    /// The number of selected runs.
    pub runs: usize,
    /// The number of their conditions.
    pub conditions: usize,
    /// The first conditions: the values that vary.
    pub listed_conditions: Vec<String>,
    /// The protocol of the first selected run; none if the file has none.
    pub protocol: Option<Outline>,
    /// The earliest version of the model that computed a part of the snapshot from which the runs start, if it
    /// is before this program's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_model_version: Option<u32>,
    /// What the runs would take.
    pub estimate: Estimate,
}

/// The protocol of one run.
#[derive(Clone, Debug, Serialize)]
pub struct Outline {
    /// The number of the run in the plan, from 1.
    pub number: usize,
    /// The name of the run.
    pub run: String,
    /// The number of its steps, at most.
    pub steps: u64,
    /// The number of its blocks.
    pub blocks: usize,
    /// The first blocks, in the order of the file.
    pub listed_blocks: Vec<BlockOutline>,
    /// The condition that ends the run.
    pub stop: Option<TriggerOutline>,
    /// The set-points of every run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub set_points: Option<SetPointsOutline>,
}

/// The set-points of every run.
#[derive(Clone, Debug, Serialize)]
pub struct SetPointsOutline {
    /// Their number.
    pub count: usize,
    /// The steps of the first and of the last one.
    pub steps: [u64; 2],
}

/// One `[[at]]`.
#[derive(Clone, Debug, Serialize)]
pub struct BlockOutline {
    /// Its first line in the file.
    pub line: usize,
    /// How often it is executed; at most once under a condition.
    pub executions: u64,
    /// Its condition.
    pub when: Option<TriggerOutline>,
    /// The first executions and the last one; one without a time under a condition.
    pub listed_executions: Vec<ExecutionOutline>,
}

/// A condition.
#[derive(Clone, Debug, Serialize)]
pub struct TriggerOutline {
    /// The condition in its normal form.
    pub condition: String,
    /// The step from which it is evaluated.
    pub from_step: u64,
    /// Why it never holds, if so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub never_holds: Option<String>,
}

/// One execution of a block.
#[derive(Clone, Debug, Serialize)]
pub struct ExecutionOutline {
    /// The step before which it is executed.
    pub step: Option<u64>,
    /// The time of that step.
    pub time: Option<f64>,
    /// The commands, as in the file, with the values of variables and ramps.
    pub commands: Vec<String>,
}

impl DryRun {
    /// Plans the runs of a subset, and takes steps of its cheapest and its costliest condition for
    /// about a second.
    ///
    /// # Errors
    ///
    /// [`PlanError`] if the plan's files are not its own.
    pub fn of(plan: &Plan, subset: &Subset) -> Result<Self, PlanError> {
        let runs = subset.indices().iter().map(|&index| &plan.runs()[index]);
        let mut conditions: Vec<&str> = runs.map(|run| condition(&run.name)).collect();
        conditions.dedup();
        let protocol = match subset.indices() {
            [first, ..] => Outline::of(plan, *first)?,
            [] => None,
        };
        let listed = conditions.iter().take(MAX_LISTED);
        Ok(Self {
            runs: subset.indices().len(),
            listed_conditions: listed.map(|&it| it.to_owned()).collect(),
            conditions: conditions.len(),
            protocol,
            start_model_version: plan.start_model_version(),
            estimate: Estimate::of(plan, subset),
        })
    }
}

/// Returns the name of a run without the number of its replicate.
fn condition(run: &str) -> &str {
    run.rsplit_once('#')
        .map_or(run, |(name, _)| name.trim_end())
}

impl Outline {
    fn of(plan: &Plan, index: usize) -> Result<Option<Self>, PlanError> {
        let run = &plan.runs()[index];
        let point = plan.point(run);
        let Some(protocol) = &point.protocol else {
            return Ok(None);
        };
        let blocks = plan.blocks(run)?;
        let listed = blocks.iter().take(MAX_LISTED);
        Ok(Some(Self {
            number: index + 1,
            run: run.name.clone(),
            steps: point.steps,
            blocks: blocks.len(),
            listed_blocks: listed.map(|it| BlockOutline::of(plan, run, it)).collect(),
            stop: protocol
                .stop
                .as_ref()
                .map(|it| TriggerOutline::of(it, point, point.steps)),
            set_points: protocol.set_points.as_ref().map(|table| {
                let (count, steps) = table.extent();
                SetPointsOutline { count, steps }
            }),
        }))
    }
}

impl BlockOutline {
    fn of(plan: &Plan, run: &PlannedRun, block: &Block) -> Self {
        let point = plan.point(run);
        let dt = point.spec.parameters.dt;
        let mut executions = block.executions();
        // No block is executed at the end.
        while executions > 0
            && let Some(last) = block.step(executions - 1, dt)
            && last >= point.steps
        {
            executions -= 1;
        }
        let listed = (0..executions).filter(|at| *at < MAX_EXECUTIONS);
        let last = executions.checked_sub(1).filter(|at| *at >= MAX_EXECUTIONS);
        let outline = |executed| {
            let step = block.step(executed, dt);
            ExecutionOutline {
                step,
                time: step.map(|step| step as f64 * dt),
                commands: block.commands(executed),
            }
        };
        Self {
            line: block.line,
            executions,
            when: block.trigger().map(|it| {
                // It is not evaluated on the last state.
                TriggerOutline::of(it, point, point.steps.saturating_sub(1))
            }),
            listed_executions: listed.take(3).chain(last).map(outline).collect(),
        }
    }
}

impl TriggerOutline {
    /// `last` is the last step at which it is evaluated.
    fn of(trigger: &Trigger, point: &Point, last: u64) -> Self {
        let left = last.saturating_sub(trigger.from);
        Self {
            condition: trigger.condition.to_string(),
            from_step: trigger.from,
            never_holds: trigger
                .condition
                .never_holds_within(left, point.spec.parameters.dt),
        }
    }
}

impl Display for DryRun {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            to,
            "{}, {}",
            counted(self.conditions, "condition"),
            counted(self.runs, "run")
        )?;
        for name in self.listed_conditions.iter().filter(|it| !it.is_empty()) {
            writeln!(to, "  {name}")?;
        }
        more(to, "  ", self.conditions, self.listed_conditions.len())?;
        if let Some(protocol) = &self.protocol {
            write!(to, "{protocol}")?;
        }
        if let Some(version) = self.start_model_version {
            writeln!(to, "{}", start_remark(version))?;
        }
        write!(to, "{}", self.estimate)
    }
}

impl Display for Outline {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            number, run, steps, ..
        } = self;
        writeln!(to, "protocol of run {number}, {run}, {steps} steps:")?;
        for block in &self.listed_blocks {
            write!(to, "{block}")?;
        }
        more(to, "  ", self.blocks, self.listed_blocks.len())?;
        if let Some(SetPointsOutline { count, steps }) = &self.set_points {
            let ([first, last], points) = (steps, counted(*count, "set-point"));
            writeln!(to, "  {points} from step {first} to step {last}")?;
        }
        match &self.stop {
            Some(stop) => writeln!(to, "  [stop] when {stop}"),
            None => Ok(()),
        }
    }
}

impl Display for BlockOutline {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = self.line;
        match &self.when {
            Some(when) => writeln!(to, "  line {line}, when {when}:")?,
            None => {
                let times = self.executions;
                let plural = if times == 1 { "" } else { "s" };
                writeln!(to, "  line {line}, {times} execution{plural}:")?;
            }
        }
        let listed = self.listed_executions.len();
        let executions = usize::try_from(self.executions).unwrap_or(usize::MAX);
        for (index, execution) in self.listed_executions.iter().enumerate() {
            if index + 1 == listed {
                more(to, "    ", executions, listed)?;
            }
            if let (Some(step), Some(time)) = (execution.step, execution.time) {
                writeln!(to, "    step {step}, t = {time}")?;
            }
            for command in &execution.commands {
                writeln!(to, "      {command}")?;
            }
        }
        Ok(())
    }
}

impl Display for TriggerOutline {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.from_step {
            0 => write!(to, "{}", self.condition)?,
            from => write!(to, "{}, from step {from}", self.condition)?,
        }
        match &self.never_holds {
            Some(reason) => write!(to, " ({reason})"),
            None => Ok(()),
        }
    }
}

/// Writes how many entries of a list are left out.
fn more(to: &mut fmt::Formatter<'_>, indent: &str, count: usize, listed: usize) -> fmt::Result {
    match count.saturating_sub(listed) {
        0 => Ok(()),
        left => writeln!(to, "{indent}… {left} more"),
    }
}

fn counted(count: usize, noun: &str) -> String {
    jostle_physics::plural::counted(count, noun)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
