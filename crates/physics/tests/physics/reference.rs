//! Single steps compared with a slow dense reference implementation, for each law of attraction,
//! contact rule, stepping and option that the reference implements.
//!
//! `tests/reference/` contains the reference, in Python, and the cases that it computed; its README
//! describes them. The reference was written from the model's description, independently of this
//! implementation.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use jostle_physics::model::{
    Attraction, Configuration, ContactRule, Parameters, State, Stepping, body,
};
use jostle_physics::stepper::Stepper;
use jostle_physics::stepper::solve::Backend;
use serde_json::Value;

/// Largest difference between two exact implementations, in body sizes or radians.
const TOLERANCE: f64 = 1e-9;

struct Case {
    name: String,
    state: State,
    after: [Vec<f64>; 3],
    /// Pair (indices), code and multiplier of each contact that pushes. None if the multipliers are
    /// not unique.
    pushing: Option<BTreeMap<(u32, u32, u8), f64>>,
    crossed: usize,
}

fn numbers(value: &Value) -> Vec<f64> {
    let entries = value.as_array().unwrap().iter();
    entries.map(|entry| entry.as_f64().unwrap()).collect()
}

fn attraction(law: &Value) -> Attraction {
    let number = |key: &str| law[key].as_f64().unwrap();
    match law["kind"].as_str().unwrap() {
        "all" => Attraction::All { accuracy: None },
        "voronoi" => Attraction::Voronoi,
        "metric" => Attraction::Metric {
            radius: number("radius"),
        },
        "topological" => Attraction::Topological {
            neighbours: number("neighbours") as u32,
        },
        "power" => Attraction::Power {
            exponent: number("exponent"),
        },
        other => panic!("unknown law of attraction {other:?}"),
    }
}

fn parameters(spec: &Value) -> Parameters {
    let [pi1, pi3, pi4, dt, noise] =
        ["pi1", "pi3", "pi4", "dt", "noise"].map(|key| spec[key].as_f64().unwrap());
    Parameters {
        pi1,
        pi3,
        pi4,
        dt,
        noise,
        contacts: match spec["contacts"].as_str().unwrap() {
            "closest" => ContactRule::Closest,
            "endpoints" => ContactRule::Endpoints,
            "clamped" => ContactRule::Clamped,
            other => panic!("contact rule {other}"),
        },
        stepping: match spec["stepping"].as_str().unwrap() {
            "velocity" => Stepping::Velocity,
            "position" => Stepping::Position,
            other => panic!("stepping {other}"),
        },
        relinearise: spec["relinearise"] == 1,
        attraction: attraction(&spec["attraction"]),
        ..Parameters::default()
    }
}

fn read(path: &Path) -> Case {
    let file: Value = serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap();
    let before = &file["before"];
    let columns = |value: &Value| ["x", "y", "alpha"].map(|key| numbers(&value[key]));
    let [x, y, alpha] = columns(before);
    let mut configuration = Configuration::default();
    for ((x, y), alpha) in x.iter().zip(&y).zip(&alpha) {
        configuration.push(*x, *y, *alpha);
    }
    if before["id"].is_array() {
        let ids = numbers(&before["id"]).into_iter();
        configuration.id = ids.map(|id| id as u32).collect();
    }
    let [weight, direction] = ["weight", "direction"].map(|key| numbers(&before[key]));
    for (index, (weight, direction)) in weight.into_iter().zip(direction).enumerate() {
        if weight > 0.0 {
            configuration.inform(index, weight, direction, None);
        }
    }
    let pushing = file["contacts"].as_array().map(|contacts| {
        let pushing = contacts.iter().map(|contact| {
            let [i, j, code] = [0, 1, 2].map(|k| contact[k].as_f64().unwrap() as u32);
            ((i, j, code as u8), contact[8].as_f64().unwrap())
        });
        pushing.collect()
    });
    Case {
        name: path.file_stem().unwrap().to_str().unwrap().to_owned(),
        state: State {
            parameters: parameters(&file["spec"]),
            seed: file["seed"].as_u64().unwrap(),
            step: file["step"].as_u64().unwrap(),
            configuration,
            ..State::default()
        },
        after: columns(&file["after"]),
        pushing,
        crossed: file["crossed_before"].as_array().unwrap().len(),
    }
}

fn cases() -> Vec<Case> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reference/cases");
    let files = fs::read_dir(folder).unwrap();
    let mut paths: Vec<PathBuf> = files.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(paths.len() > 90, "{} cases", paths.len());
    paths.iter().map(|path| read(path)).collect()
}

#[test]
fn both_backends_match_the_reference() {
    for case in cases() {
        for backend in [Backend::Exact, Backend::Fallback] {
            let (name, mut state) = (&case.name, case.state.clone());
            let report = Stepper::with_backend(backend)
                .step(&mut state)
                .unwrap_or_else(|error| panic!("{name}: {error}"));
            let Configuration { x, y, alpha, .. } = &state.configuration;
            for (ours, theirs) in [x, y, alpha].into_iter().zip(&case.after) {
                assert_eq!(ours.len(), theirs.len());
                for (ours, theirs) in ours.iter().zip(theirs) {
                    let off = (ours - theirs).abs();
                    assert!(off < TOLERANCE, "{name}, {backend:?}: {ours} {theirs}");
                }
            }
            assert_eq!(report.crossed, case.crossed, "{name}");
            let Some(pushing) = &case.pushing else {
                continue;
            };
            let index_of = |id: u32| {
                let index = case.state.configuration.id.binary_search(&id).unwrap();
                u32::try_from(index).unwrap()
            };
            let contacts = state.warm_start.contacts.iter();
            let ours: BTreeMap<_, _> = contacts
                .map(|it| {
                    (
                        (index_of(it.first), index_of(it.second), it.code),
                        it.multiplier,
                    )
                })
                .collect();
            // A contact whose multiplier is rounding noise can be in one of the lists only.
            for key in ours.keys().chain(pushing.keys()) {
                let [one, other] =
                    [&ours, pushing].map(|side| side.get(key).copied().unwrap_or(0.0));
                assert!(
                    (one - other).abs() < TOLERANCE,
                    "{name}, {key:?}: {one} {other}"
                );
            }
        }
    }
}

#[test]
fn a_step_reports_the_overlap_that_parry_measures() {
    let mut compared = 0;
    for mut case in cases() {
        let State {
            parameters,
            configuration,
            ..
        } = &case.state;
        let gaps = body::gaps(parameters, configuration);
        let report = Stepper::new().step(&mut case.state).unwrap();
        // If axes cross, parry measures the distance of the axes, and a step the distances of their
        // ends.
        if let (Some(gap), 0) = (report.worst_gap, gaps.crossed) {
            let measured = gaps.worst_gap.unwrap();
            assert!(
                (gap - measured).abs() < 1e-12,
                "{}: {gap} {measured}",
                case.name
            );
            compared += 1;
        }
    }
    assert!(compared > 30, "{compared}");
}
