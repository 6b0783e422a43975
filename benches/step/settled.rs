//! Settled groups, and a record of successive steps of them.

use std::fs;
use std::path::PathBuf;

use jostled::model::{MODEL_VERSION, Parameters, SolverMemory, State, start};
use jostled::stepper::Stepper;
use jostled::stepper::qp::Qp;
use serde_json::{Value, json};

use super::phases::Phases;

/// Which group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Length over width of a body.
    pub pi1: f64,
    /// How many individuals.
    pub n: usize,
}

/// What every start is drawn with.
const SEED: u64 = 1;

/// Steps taken after a settled group is read from its file, which holds no solver's memory.
const WARMING: usize = 10;

/// One recorded step: the state before it and its program.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// The state that the step starts from, with the memory of the step before.
    pub state: State,
    /// The program of the step.
    pub qp: Qp,
    /// The multipliers guessed from the memory.
    pub guess: Vec<f64>,
}

impl Case {
    /// All other parameters are the defaults; nobody is informed.
    pub fn parameters(self) -> Parameters {
        Parameters {
            pi1: self.pi1,
            ..Parameters::default()
        }
    }

    /// For how long a group runs before it counts as settled.
    fn settling_time(self) -> f64 {
        if self.n <= 120 { 100.0 } else { 40.0 }
    }

    /// The settled group, from its file below `target/` or made and written there.
    pub fn settled(self) -> State {
        let parameters = self.parameters();
        let path = self.file();
        let mut state = read(&path, parameters).unwrap_or_else(|| {
            let mut state = State {
                parameters,
                seed: SEED,
                configuration: start::disc(&parameters, self.n, None, SEED)
                    .expect("the disc has room for everybody"),
                ..State::default()
            };
            let mut stepper = Stepper::new();
            while state.time() < self.settling_time() {
                stepper.step(&mut state).expect("every step is solved");
            }
            fs::create_dir_all(path.parent().expect("the file is in a directory"))
                .and_then(|()| fs::write(&path, written(&state)))
                .expect("target/ can be written");
            state
        });
        state.memory = SolverMemory::default();
        let mut stepper = Stepper::new();
        for _ in 0..WARMING {
            stepper.step(&mut state).expect("every step is solved");
        }
        state
    }

    /// The file is named by what decides its content, as far as anybody promises.
    fn file(self) -> PathBuf {
        let Self { pi1, n } = self;
        let time = self.settling_time();
        let key = format!("{MODEL_VERSION} {:?} {n} {SEED} {time}", self.parameters());
        let hash = blake3::hash(key.as_bytes()).to_hex();
        let name = format!("pi1-{pi1}-n-{n}-{}.json", &hash[..12]);
        super::measure::target().join("settled").join(name)
    }
}

fn written(state: &State) -> String {
    let configuration = &state.configuration;
    json!({
        "step": state.step,
        "origin": configuration.origin,
        "x": configuration.x,
        "y": configuration.y,
        "alpha": configuration.alpha,
    })
    .to_string()
}

fn read(path: &PathBuf, parameters: Parameters) -> Option<State> {
    let text = fs::read_to_string(path).ok()?;
    let value: Value = serde_json::from_str(&text).ok()?;
    let column = |name: &str| -> Option<Vec<f64>> {
        value[name].as_array()?.iter().map(Value::as_f64).collect()
    };
    let mut state = State {
        parameters,
        seed: SEED,
        step: value["step"].as_u64()?,
        ..State::default()
    };
    let columns = column("x")?
        .into_iter()
        .zip(column("y")?)
        .zip(column("alpha")?);
    for ((x, y), alpha) in columns {
        state.configuration.push(x, y, alpha);
    }
    state.configuration.origin = [value["origin"][0].as_i64()?, value["origin"][1].as_i64()?];
    Some(state)
}

/// Records `count` successive steps from `state`.
pub fn record(mut state: State, count: usize) -> Vec<Recorded> {
    let (mut stepper, mut phases) = (Stepper::new(), Phases::default());
    let mut records = Vec::with_capacity(count);
    for _ in 0..count {
        let qp = phases.program(&state);
        records.push(Recorded {
            state: state.clone(),
            qp,
            guess: phases.guess(),
        });
        stepper.step(&mut state).expect("every step is solved");
    }
    records
}
