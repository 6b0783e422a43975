//! An experiment whose runs are executed in slices.

use jostle_convert::spec;
use jostle_experiment::{CurrentRun, EncodedFiles, Files, FinishedRun, Plan, PlannedRun};
use jostle_physics::simulation::Simulation;
use jostle_proto::ErrorCode;
use jostle_results::table;

use crate::request::{Advanced, Answer, Rejection, Reply, RunEntry, Status};
use crate::swarm::no_base64;

/// An experiment, and one of its runs.
pub struct Experiment {
    plan: Plan,
    current: Option<Current>,
}

struct Current {
    run: CurrentRun,
    finished: Option<FinishedRun>,
}

impl Experiment {
    /// Reads an experiment's files.
    pub fn read(files: EncodedFiles) -> Result<Self, Rejection> {
        let files = Files::try_from(files).map_err(|error| no_base64(&error))?;
        Ok(Self {
            plan: Plan::of(files).map_err(|error| Rejection::from(&error))?,
            current: None,
        })
    }

    /// Returns its name and its runs.
    pub fn answer(&self) -> Answer {
        let entry = |run| {
            let point = self.plan.point(run);
            RunEntry {
                name: run.name.clone(),
                steps: point.steps,
                n: point.spec.n,
            }
        };
        Answer::Plan {
            name: self.plan.name.clone(),
            runs: self.plan.runs().iter().map(entry).collect(),
        }
    }

    /// Returns the spec of a run.
    pub fn spec(&self, index: usize) -> Reply {
        let run = self.planned(index)?;
        Ok(Answer::Spec {
            spec: Box::new(spec::to_proto(&self.plan.spec(run), run.seed)),
        })
    }

    /// Begins a run.
    pub fn run(&mut self, index: usize) -> Reply {
        let run = CurrentRun::start(&self.plan, self.planned(index)?)?;
        let status = Status::of(run.simulation(), None);
        self.current = Some(Current {
            run,
            finished: None,
        });
        Ok(Answer::Status(status))
    }

    fn planned(&self, index: usize) -> Result<&PlannedRun, Rejection> {
        let runs = self.plan.runs();
        runs.get(index).ok_or_else(|| {
            let message = format!("there is no run {index}: the experiment has {}", runs.len());
            Rejection::of(ErrorCode::NotFound, &message)
        })
    }

    /// Takes steps of the run, until it ends.
    pub fn advance(&mut self, steps: u64) -> Reply {
        let Some(current) = &mut self.current else {
            let message = "there is no run: send run first";
            return Err(Rejection::of(ErrorCode::IncorrectState, &message));
        };
        if current.finished.is_none() {
            current.finished = current.run.advance(&self.plan, steps, None);
        }
        let finished = current.finished.as_ref();
        let row = finished.and_then(|it| it.row.clone());
        let extra = self.plan.extra_columns();
        Ok(Answer::Advanced(Advanced {
            status: Status::of(
                current.run.simulation(),
                finished.and_then(|it| it.fault.clone()),
            ),
            finished: finished.is_some(),
            csv: row
                .as_ref()
                .map(|row| table::csv(std::slice::from_ref(row), &extra)),
            row: row.map(Box::new),
        }))
    }

    /// Returns the simulation of the run.
    pub fn simulation(&self) -> Option<&Simulation> {
        self.current.as_ref().map(|it| it.run.simulation())
    }

    /// Returns why the run ended early.
    pub fn fault(&self) -> Option<String> {
        self.current.as_ref()?.finished.as_ref()?.fault.clone()
    }
}
