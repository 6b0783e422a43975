//! One run, from its start to its row in the table of results.

use std::collections::BTreeMap;

use jostle_convert::{past, snapshot};
use jostle_measures::{Past, View, check_past};
use jostle_physics::model::State;
use jostle_physics::model::selection::{Candidates, Selection, select};
use jostle_physics::simulation::{
    self, ChangeError, Checkpoint, Exactness, Reservation, ReserveError, ReserveMemory, Simulation,
};
use jostle_proto::snapshot::SnapshotPhase;
use jostle_results::ResultRow;
use jostle_results::contact_statistics::ContactStatistics;
use jostle_results::table::Series;

use crate::contact_events::ContactMeter;
use crate::limits::MAX_INDIVIDUALS;
use crate::plan::{Plan, PlannedRun};
use crate::protocol::{Boundary, ProtocolRun};

pub use self::checkpoint::{RecordedHashes, RunCheckpoint};
use self::measures::Measures;
pub use self::recorder::Recorder;

mod checkpoint;
mod measures;
mod recorder;

/// The number of the first command after `create`, which is part of the key of a selection's draw.
/// A swarm that is created with the seed of a run and whose first command is `inform` with the same
/// count therefore has the same future as the run.
pub const INFORMED_BY: u64 = 1;

/// The direction of the informed individuals, in radians: +x.
pub const DIRECTION: f64 = 0.0;

/// The result of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FinishedRun {
    /// The row of the run; none if it ended before its first step.
    pub row: Option<ResultRow>,
    /// Why the run ended early, if it did.
    pub fault: Option<String>,
    /// The order over time, if the plan has `order_every`: the measures `order` and `drift`. None if it
    /// is long and in a file.
    pub order: Option<Series>,
    /// The chosen measures over time, if the plan has `series_every`. None if they are long and in a
    /// file.
    pub series: Option<Series>,
    /// The measurements of contacts, if the plan has `touch`.
    pub touch: Option<ContactStatistics>,
    /// The files of the run in the folder of results, if it was executed for one: their paths in the
    /// folder, with `/`, and their lengths in bytes.
    pub files: BTreeMap<String, u64>,
}

/// A run between two steps.
///
/// A caller has it beside its plan, advances it as far as it wants, reads its state and stops when it
/// wants. [`execute_run`] is a loop over it.
pub struct CurrentRun {
    run: PlannedRun,
    simulation: Simulation,
    measures: Measures,
    meter: Option<ContactMeter>,
    /// The states of earlier steps, as far as measures need them.
    past: Past,
    protocol: Option<ProtocolRun>,
    /// The step of the last frame of the trajectory that this process recorded.
    recorded: Option<u64>,
    is_finished: bool,
}

/// Executes one run. The result depends only on the plan and the run.
///
/// After every step `on_step` is called with the number of steps taken. If it returns false, the run
/// stops and the result is none.
pub fn execute_run(
    plan: &Plan,
    run: &PlannedRun,
    mut on_step: impl FnMut(u64) -> bool,
) -> Option<FinishedRun> {
    execute_run_from(plan, run, None, None, |current| on_step(current.steps()))
}

/// As [`execute_run`], from a checkpoint of the run if there is one, with the same result as from the
/// start. Without a recorder, the result contains all series, however long they are.
pub fn execute_run_from(
    plan: &Plan,
    run: &PlannedRun,
    checkpoint: Option<RunCheckpoint>,
    recorder: Option<&dyn Recorder>,
    mut on_step: impl FnMut(&mut CurrentRun) -> bool,
) -> Option<FinishedRun> {
    let resumed = checkpoint.and_then(|checkpoint| CurrentRun::resume(plan, run, checkpoint));
    let current = match resumed {
        Some(current) => Ok(current),
        None => CurrentRun::start(plan, run),
    };
    let mut current = match current {
        Ok(current) => current,
        Err(error) => {
            return Some(FinishedRun {
                fault: Some(error.to_string()),
                ..FinishedRun::default()
            });
        }
    };
    loop {
        if let Some(finished) = current.advance(plan, 1, recorder) {
            return Some(finished);
        }
        if !on_step(&mut current) {
            return None;
        }
    }
}

impl CurrentRun {
    /// Begins a run of `plan` at its start.
    ///
    /// # Errors
    ///
    /// [`ChangeError::Start`] if the individuals do not fit in the disc.
    pub fn start(plan: &Plan, run: &PlannedRun) -> Result<Self, ChangeError> {
        let (mut simulation, informed) = match &plan.base {
            Some(base) => (base.simulation(&plan.spec(run), reserve())?, 0),
            None => {
                let mut simulation = Simulation::with_reserve(plan.spec(run), reserve())?;
                let informed = inform(plan, run, &mut simulation.state)?;
                (simulation, informed)
            }
        };
        simulation.definitions = plan.definitions;
        let protocol = plan.point(run).protocol.clone();
        let next_draw = INFORMED_BY + u64::from(informed > 0);
        Ok(Self {
            measures: Measures::new(plan),
            meter: plan.touch.then(|| ContactMeter::new(&simulation.state)),
            past: Past::new(plan.lag(run)),
            protocol: protocol.map(|protocol| ProtocolRun::new(protocol, next_draw)),
            recorded: None,
            is_finished: false,
            run: run.clone(),
            simulation,
        })
    }

    /// Takes at most `max_steps` steps. Returns the result of the run once it has ended, which is by
    /// the call after its last step. The plan is the one with which the run began.
    ///
    /// # Panics
    ///
    /// If the run has ended.
    pub fn advance(
        &mut self,
        plan: &Plan,
        max_steps: u64,
        recorder: Option<&dyn Recorder>,
    ) -> Option<FinishedRun> {
        assert!(!self.is_finished, "run {:?} has ended", self.run.name);
        for _ in 0..max_steps {
            if let Some((boundary, fault)) = self.step(plan, recorder) {
                self.is_finished = true;
                self.record_last(plan, recorder);
                return Some(self.finish(plan, boundary, fault, recorder));
            }
            if let Some(recorder) = recorder {
                self.measures.pass_rows(recorder, false);
            }
        }
        None
    }

    /// Takes a step, unless the run ends before it or by it: then returns how, and the reason of a fault.
    fn step(
        &mut self,
        plan: &Plan,
        recorder: Option<&dyn Recorder>,
    ) -> Option<(Boundary, Option<String>)> {
        let is_last = self.steps() >= plan.point(&self.run).steps;
        match self.boundary(plan, is_last) {
            Ok(Boundary::Continue) if !is_last => {
                self.record(plan, recorder);
                let stepped = self.simulate(plan);
                stepped.err().map(|fault| (Boundary::Continue, Some(fault)))
            }
            Ok(boundary) => Some((boundary, None)),
            Err(fault) => Some((Boundary::Continue, Some(fault))),
        }
    }

    /// Returns the checkpoint of the run at this step.
    #[must_use]
    pub fn checkpoint(&self) -> RunCheckpoint {
        let doing = SnapshotPhase::Paused {
            reason: String::new(),
        };
        let checkpoint = Checkpoint {
            seq: 0,
            exactness: Exactness::default(),
            ..self.simulation.checkpoint()
        };
        RunCheckpoint {
            run: self.run.name.clone(),
            snapshot: snapshot::to_proto("run", &checkpoint, doing),
            measures: self.measures.clone(),
            meter: self.meter.clone(),
            past: past::to_proto(&self.past),
            protocol: self.protocol.as_ref().map(|it| it.progress.clone()),
            recorded: None,
            hashes: RecordedHashes::default(),
        }
    }

    /// Continues a run of `plan` from a checkpoint; none if it is of another run or of another version.
    #[must_use]
    pub fn resume(plan: &Plan, run: &PlannedRun, checkpoint: RunCheckpoint) -> Option<Self> {
        let restored = snapshot::from_proto(&checkpoint.snapshot).ok()?;
        let point = plan.point(run);
        let is_of_run = checkpoint.run == run.name
            && restored.spec == plan.spec(run)
            && checkpoint.meter.is_some() == plan.touch
            && checkpoint.protocol.is_some() == point.protocol.is_some()
            && checkpoint.measures.is_of(plan)
            && restored.state.step <= point.steps;
        let protocol = match point.protocol.clone().zip(checkpoint.protocol) {
            Some((protocol, progress)) => Some(ProtocolRun::resume(protocol, progress)?),
            None => None,
        };
        let past = past::from_proto(plan.lag(run), checkpoint.past).ok()?;
        let mut simulation = Simulation::from_checkpoint(&restored, reserve());
        simulation.definitions = plan.definitions;
        is_of_run.then(|| Self {
            run: run.clone(),
            is_finished: false,
            measures: checkpoint.measures,
            meter: checkpoint.meter,
            past,
            protocol,
            recorded: None,
            simulation,
        })
    }

    /// Passes all rows of its long series to the recorder, before a checkpoint is written.
    pub fn pass_rows(&mut self, recorder: &dyn Recorder) {
        self.measures.pass_rows(recorder, true);
    }

    /// Returns the number of steps taken.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.simulation.state.step
    }

    /// Returns the simulation, with the present state.
    #[must_use]
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// Executes what the protocol has before the next step, and measures the state. The error is the
    /// reason of a fault.
    fn boundary(&mut self, plan: &Plan, is_last: bool) -> Result<Boundary, String> {
        self.past.observe(&self.simulation.state);
        if let Some(protocol) = &mut self.protocol {
            let boundary = protocol.boundary(&mut self.simulation, &self.past, is_last)?;
            if boundary == Boundary::Stop {
                return Ok(boundary);
            }
            // A command may have changed the state, or the size of the group.
            let n = self.simulation.state.configuration.n();
            let checked = check_past(self.past.lag_steps(), n);
            checked.map_err(|error| format!("step {}: {error}", self.steps()))?;
            self.past.observe(&self.simulation.state);
        }
        if !is_last {
            let view = view(&self.simulation, &self.past);
            self.measures.observe(plan, &view);
        }
        Ok(Boundary::Continue)
    }

    /// Adds the state before a step to the trajectory, if it is due.
    fn record(&mut self, plan: &Plan, recorder: Option<&dyn Recorder>) {
        let every = plan.record_every;
        if every.is_some_and(|every| self.steps().is_multiple_of(every)) {
            self.record_last(plan, recorder);
        }
    }

    /// Adds the last state to the trajectory, unless it has it.
    fn record_last(&mut self, plan: &Plan, recorder: Option<&dyn Recorder>) {
        if let Some(recorder) = recorder
            && plan.record_every.is_some()
            && self.recorded != Some(self.steps())
        {
            recorder.add_frame(&self.simulation.state);
            self.recorded = Some(self.steps());
        }
    }

    /// Takes a step of the simulation. The error is the reason of a fault.
    fn simulate(&mut self, plan: &Plan) -> Result<(), String> {
        let report = match self.simulation.step() {
            Ok(report) => report,
            Err(error) => return Err(format!("step {}: {error}", self.simulation.state.step)),
        };
        let count = self.simulation.means.count;
        self.measures
            .add(plan, count, &self.simulation.order_before, &report);
        if let Some(meter) = &mut self.meter {
            meter.add(self.simulation.stepper(), &report, &self.simulation.state);
        }
        Ok(())
    }

    fn finish(
        &mut self,
        plan: &Plan,
        boundary: Boundary,
        fault: Option<String>,
        recorder: Option<&dyn Recorder>,
    ) -> FinishedRun {
        let is_stopped = boundary == Boundary::Stop;
        let fault = match self.steps() {
            0 if is_stopped => Some("step 0: the condition of [stop] holds: give from".to_owned()),
            _ => fault,
        };
        // A command may have changed the state, or the size of the group.
        self.past.observe(&self.simulation.state);
        let view = view(&self.simulation, &self.past);
        self.measures.record_last(plan, &view);
        let of = (plan, &self.run);
        let finished = self
            .measures
            .finish(of, &self.simulation, is_stopped, recorder);
        let (row, [order, series]) = finished;
        let touch = row.as_ref().zip(self.meter.take());
        let touch = touch.and_then(|(row, meter)| {
            meter.finish(&self.run.name, &row.contacts, &self.simulation.state)
        });
        let row = row.map(|row| ResultRow {
            fault: fault.clone(),
            ..row
        });
        FinishedRun {
            fault,
            series: series.filter(|_| row.is_some()),
            order: order.filter(|_| row.is_some()),
            row,
            touch,
            files: BTreeMap::new(),
        }
    }
}

/// Returns the view of the present state of a run.
fn view<'a>(simulation: &'a Simulation, past: &'a Past) -> View<'a> {
    View::new(&simulation.state, past).under(simulation.definitions)
}

/// Returns the callback that limits the size of the group, as the plan limits it at the start.
pub fn reserve() -> ReserveMemory {
    Box::new(|reservation| match reservation {
        Reservation::Grow(n) if n as u64 > MAX_INDIVIDUALS => Err(ReserveError::TooMany {
            n,
            limit: usize::try_from(MAX_INDIVIDUALS).unwrap_or(usize::MAX),
        }),
        Reservation::Grow(_) | Reservation::Return(_) => Ok(()),
    })
}

/// Returns the initial state of a run, with its informed individuals.
///
/// # Errors
///
/// [`ChangeError::Start`] if the individuals do not fit in the disc.
pub fn start(plan: &Plan, run: &PlannedRun) -> Result<State, ChangeError> {
    if let Some(base) = &plan.base {
        return Ok(base.simulation(&plan.spec(run), reserve())?.state);
    }
    let mut state = simulation::begin(&plan.spec(run))?;
    inform(plan, run, &mut state)?;
    Ok(state)
}

/// Informs the individuals of a run that are informed from its start; returns their number.
///
/// These are drawn with the run's seed and not chosen by id: individuals that are placed first have
/// more room around them.
fn inform(plan: &Plan, run: &PlannedRun, state: &mut State) -> Result<usize, ChangeError> {
    let informed = plan.point(run).informed;
    let (configuration, weight) = (&mut state.configuration, state.parameters.pi2);
    let chosen = select(
        configuration,
        Candidates::All,
        &Selection::Count(informed),
        run.seed,
        INFORMED_BY,
    )?;
    for individual in chosen {
        configuration.inform(individual, weight, DIRECTION, None);
    }
    Ok(informed)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
