//! Settled groups, computed once and cached below `target/`.

use std::fs;
use std::path::{Path, PathBuf};

use jostle_physics::model::{MODEL_VERSION, Parameters, State, WarmStart, start};
use jostle_physics::stepper::Stepper;
use serde_json::{Value, json};

/// Returns the folder of the benches' files, below cargo's target directory.
pub fn target() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("bench-step")
}

/// A group to measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Length over width of a body.
    pub pi1: f64,
    /// Number of individuals.
    pub n: usize,
}

/// Seed of every start.
const SEED: u64 = 1;

/// Steps taken after a settled group is read from its file, which contains no warm start.
const WARMING: usize = 10;

impl Case {
    /// Returns the parameters: the defaults except for `pi1`. No individual is informed.
    pub fn parameters(self) -> Parameters {
        Parameters {
            pi1: self.pi1,
            ..Parameters::default()
        }
    }

    /// Returns the time after which a group counts as settled.
    fn settling_time(self) -> f64 {
        if self.n <= 120 { 100.0 } else { 40.0 }
    }

    /// Returns the settled group. It is read from its file below `target/`, or computed and written
    /// there.
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
                        .expect("the individuals fit in the disc"),
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

    /// Returns the path of the group's file. Its name contains a hash of the model version, the
    /// parameters, the seed and the time, which determine the content.
    fn file(self) -> PathBuf {
        let Self { pi1, n } = self;
        let time = self.settling_time();
        let key = format!("{MODEL_VERSION} {:?} {n} {SEED} {time}", self.parameters());
        let hash = blake3::hash(key.as_bytes()).to_hex();
        let name = format!("pi1-{pi1}-n-{n}-{}.json", &hash[..12]);
        target().join("settled").join(name)
    }
}

/// Returns the positions and angles of a group as JSON, without the warm start.
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

/// Returns the group in `value`; none if a field is missing or malformed.
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
