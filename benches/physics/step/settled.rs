//! Settled groups, made once and kept below `target/`.

use std::fs;
use std::path::{Path, PathBuf};

use jostle_physics::model::{MODEL_VERSION, Parameters, State, WarmStart, start};
use jostle_physics::stepper::Stepper;
use serde_json::{Value, json};

/// Where benches keep their files, below cargo's target directory.
pub fn target() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("bench-step")
}

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
        let file = fs::read_to_string(&path).ok();
        let group = file.and_then(|text| serde_json::from_str(&text).ok());
        let mut state = group
            .and_then(|group| read(&group, parameters))
            .unwrap_or_else(|| {
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
                    .and_then(|()| fs::write(&path, written(&state).to_string()))
                    .expect("target/ can be written");
                state
            });
        state.warm_start = WarmStart::default();
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
        target().join("settled").join(name)
    }
}

/// The positions and angles of a group, without what its solver remembers.
pub fn written(state: &State) -> Value {
    let configuration = &state.configuration;
    json!({
        "step": state.step,
        "origin": configuration.origin,
        "x": configuration.x,
        "y": configuration.y,
        "alpha": configuration.alpha,
    })
}

/// The group that `value` tells of; none if it tells of none.
pub fn read(value: &Value, parameters: Parameters) -> Option<State> {
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
