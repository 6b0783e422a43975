//! What executes the requests.

use jostle_measures::{Past, View};
use jostle_physics::model::{CELL, MODEL_VERSION};
use jostle_physics::simulation::Simulation;
use jostle_proto::ErrorCode;

use crate::request::{Answer, Rejection, Reply, Request, Status, to_json};
use crate::runs::Experiment;
use crate::swarm::Swarm;

/// The instructions of the module, which a browser must have.
const TARGET: &str = if cfg!(all(target_arch = "wasm32", target_feature = "simd128")) {
    "wasm32 simd128"
} else {
    std::env::consts::ARCH
};

/// One swarm, or one experiment with at most one run; at first nothing.
#[derive(Default)]
pub struct Engine {
    held: Held,
}

#[derive(Default)]
enum Held {
    #[default]
    Nothing,
    Swarm(Box<Swarm>),
    Experiment(Box<Experiment>),
}

impl Engine {
    /// Creates an engine that holds nothing.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Executes a request; returns the reply.
    pub fn request(&mut self, request: &str) -> String {
        let reply = match serde_json::from_str(request) {
            Ok(request) => self.execute(request),
            Err(error) => Err(Rejection::invalid(&error)),
        };
        to_json(&reply)
    }

    fn execute(&mut self, request: Request) -> Reply {
        match request {
            Request::Version {} => Ok(Answer::Version {
                version: env!("CARGO_PKG_VERSION"),
                model_version: MODEL_VERSION,
                target: TARGET,
            }),
            Request::Create { spec } => self.hold(Swarm::create(&spec)?),
            Request::Restore { snapshot } => self.hold(Swarm::restore(&snapshot)?),
            Request::Snapshot {} => self.swarm().map(|it| it.snapshot()),
            Request::Apply { change, seq } => self.swarm()?.apply(change, seq),
            Request::Steer(set) => self.swarm()?.steer(set),
            Request::Step { steps } => self.swarm()?.step(steps),
            Request::Status {} => self.status(),
            Request::Measures { measures } => self.measures(&measures),
            Request::Plan(files) => {
                let experiment = Experiment::read(files)?;
                let answer = experiment.answer();
                self.held = Held::Experiment(Box::new(experiment));
                Ok(answer)
            }
            Request::Spec { run } => self.experiment()?.spec(run),
            Request::Run { run } => self.experiment()?.run(run),
            Request::Advance { steps } => self.experiment()?.advance(steps),
        }
    }

    fn hold(&mut self, swarm: Swarm) -> Reply {
        self.held = Held::Swarm(Box::new(swarm));
        self.status()
    }

    fn swarm(&mut self) -> Result<&mut Swarm, Rejection> {
        match &mut self.held {
            Held::Swarm(swarm) => Ok(swarm),
            _ => Err(missing("swarm: send create or restore first")),
        }
    }

    fn experiment(&mut self) -> Result<&mut Experiment, Rejection> {
        match &mut self.held {
            Held::Experiment(experiment) => Ok(experiment),
            _ => Err(missing("experiment: send plan first")),
        }
    }

    /// Returns the simulation of the swarm or of the run.
    pub fn simulation(&self) -> Option<&Simulation> {
        match &self.held {
            Held::Nothing => None,
            Held::Swarm(swarm) => Some(&swarm.simulation),
            Held::Experiment(experiment) => experiment.simulation(),
        }
    }

    fn present(&self) -> Result<&Simulation, Rejection> {
        let present = self.simulation();
        present.ok_or_else(|| missing("swarm and no run: send create, restore or run first"))
    }

    fn status(&self) -> Reply {
        let fault = match &self.held {
            Held::Nothing => None,
            Held::Swarm(swarm) => swarm.fault.clone(),
            Held::Experiment(experiment) => experiment.fault(),
        };
        Ok(Answer::Status(Status::of(self.present()?, fault)))
    }

    fn measures(&self, names: &[String]) -> Reply {
        let simulation = self.present()?;
        let measures =
            jostle_convert::measures::parse(names.iter().map(String::as_str), names.len())?;
        let n = simulation.state.configuration.n();
        for measure in &measures {
            measure
                .check_size(n)
                .map_err(jostle_convert::MeasuresError::from)?;
        }
        let past = Past::new(0);
        let view = View::new(&simulation.state, &past).under(simulation.definitions);
        let values = measures.iter().map(|it| it.evaluate(&view)).collect();
        Ok(Answer::Measures { values })
    }

    /// Returns a column of the present state: 0 `x` and 1 `y` in body sizes, 2 `alpha`, 3 `weight`,
    /// 4 `direction`, which is NaN for uninformed individuals; angles in radians.
    #[must_use]
    pub fn column(&self, index: usize) -> Vec<f64> {
        let Some(simulation) = self.simulation() else {
            return Vec::new();
        };
        let configuration = &simulation.state.configuration;
        let absolute = |column: &[f64], origin: i64| {
            #[expect(clippy::cast_precision_loss, reason = "far below 2^53 cells")]
            let origin = CELL * origin as f64;
            column.iter().map(|value| origin + value).collect()
        };
        let [x, y] = configuration.origin;
        match index {
            0 => absolute(&configuration.x, x),
            1 => absolute(&configuration.y, y),
            2 => configuration.alpha.clone(),
            3 => configuration.weight.clone(),
            4 => {
                let pairs = configuration.weight.iter().zip(&configuration.direction);
                pairs
                    .map(|(&weight, &direction)| if weight > 0.0 { direction } else { f64::NAN })
                    .collect()
            }
            _ => Vec::new(),
        }
    }

    /// Returns the ids of the individuals.
    #[must_use]
    pub fn ids(&self) -> &[u32] {
        let simulation = self.simulation();
        simulation.map_or(&[], |it| &it.state.configuration.id)
    }
}

fn missing(what: &str) -> Rejection {
    Rejection::of(ErrorCode::IncorrectState, &format!("there is no {what}"))
}
