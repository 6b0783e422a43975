//! Twenty exact single steps, computed by two independent implementations.

use std::fs;
use std::path::{Path, PathBuf};

use jostle_physics::model::{Parameters, State, start};
use jostle_physics::stepper::Stepper;
use jostle_physics::stepper::qp::Qp;
use jostle_physics::stepper::solve::{self, Backend, Hints, Solution, Workspace};
use serde_json::Value;

/// Largest difference between two exact implementations, in body sizes or radians.
const TOLERANCE: f64 = 1e-9;

/// Pair, code and multiplier.
type Push = ((u64, u64, u64), f64);

struct Case {
    name: String,
    state: State,
    after: [Vec<f64>; 3],
    /// The contacts that push.
    pushing: Vec<Push>,
}

fn key(i: u32, j: u32, code: u8) -> (u64, u64, u64) {
    (i.into(), j.into(), code.into())
}

fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|entry| entry.as_f64().unwrap())
        .collect()
}

fn read(path: &Path) -> Case {
    let file: Value = serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap();
    let (given, before, after) = (&file["params"], &file["before"], &file["after_exact"]);
    let number = |key: &str| given[key].as_f64().unwrap();
    let [pi1, pi3, pi4, dt] = ["pi1", "pi3", "pi4", "dt"].map(number);
    let parameters = Parameters {
        pi1,
        pi3,
        pi4,
        dt,
        ..Parameters::default()
    };
    let columns = |value: &Value| ["x", "y", "alpha"].map(|key| numbers(&value[key]));
    let [x, y, alpha] = columns(before);
    let mut configuration = start::given(&parameters, &x, &y, &alpha).unwrap();
    let preferred = numbers(&given["p_pref"]);
    let informed = usize::try_from(given["informed"].as_u64().unwrap()).unwrap();
    for index in 0..informed {
        let weight = number("c_p_informed") / number("c_s");
        configuration.inform(index, weight, preferred[1].atan2(preferred[0]), None);
    }
    let pushing = file["contacts_i_j_code_gap_nx_ny_ri_rj_lambda"]
        .as_array()
        .unwrap()
        .iter();
    let pushing = pushing.map(|contact| {
        let key = [0, 1, 2].map(|k| contact[k].as_f64().unwrap() as u64);
        ((key[0], key[1], key[2]), contact[8].as_f64().unwrap())
    });
    Case {
        name: path.file_name().unwrap().to_str().unwrap().to_owned(),
        state: State {
            parameters,
            configuration,
            ..State::default()
        },
        after: columns(after),
        pushing: pushing
            .filter(|(_, multiplier)| *multiplier > 0.0)
            .collect(),
    }
}

fn all() -> Vec<Case> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cases");
    let files = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut paths: Vec<PathBuf> = files
        .filter(|path| path.extension().is_some_and(|end| end == "json"))
        .collect();
    paths.sort();
    assert_eq!(paths.len(), 20);
    paths.iter().map(|path| read(path)).collect()
}

/// Returns the largest difference from the exact result. A shift of the origin is undone.
fn error(case: &Case, after: &State) -> f64 {
    let configuration = &after.configuration;
    let [cell_x, cell_y] = configuration.origin.map(|cell| 1024.0 * cell as f64);
    let columns = [
        (&configuration.x, cell_x),
        (&configuration.y, cell_y),
        (&configuration.alpha, 0.0),
    ];
    let pairs = columns
        .iter()
        .zip(&case.after)
        .flat_map(|((column, shift), exact)| {
            column
                .iter()
                .zip(exact)
                .map(move |(value, exact)| (value + shift - exact).abs())
        });
    pairs.fold(0.0, f64::max)
}

/// Asserts that the multipliers in `found` and in the case are equal. A contact that is missing
/// from one of the lists counts as 0.
fn compare_pushes(case: &Case, found: &[Push], route: &str) {
    let of = |list: &[Push], key| {
        list.iter()
            .find(|(other, _)| *other == key)
            .map_or(0.0, |(_, multiplier)| *multiplier)
    };
    let keys = case.pushing.iter().chain(found).map(|(key, _)| *key);
    for key in keys {
        let (exact, ours) = (of(&case.pushing, key), of(found, key));
        // Contacts of packed discs are linearly dependent: only the displacements are unique.
        let unique = case.state.parameters.pi1 > 1.0 || case.state.configuration.n() < 10;
        assert!(
            !unique || (exact - ours).abs() < 1e-7,
            "{} {route} {key:?}: {ours} for {exact}",
            case.name
        );
    }
}

#[test]
fn every_case_is_reproduced_cold_and_warm_started() {
    let mut worst: f64 = 0.0;
    for case in all() {
        let mut after = case.state.clone();
        let report = Stepper::new().step(&mut after).unwrap();
        let cold = error(&case, &after);
        // The multipliers of the same step are the best warm start.
        let mut started = State {
            warm_start: after.warm_start.clone(),
            ..case.state.clone()
        };
        let warm_report = Stepper::new().step(&mut started).unwrap();
        let warm = error(&case, &started);
        assert!(
            cold <= TOLERANCE && warm <= TOLERANCE,
            "{}: cold {cold:e}, warm {warm:e}",
            case.name
        );
        assert_eq!(
            warm_report.fallback, 0,
            "{}: fallback in spite of the exact warm start",
            case.name
        );
        assert!(report.residual <= solve::TARGET && warm_report.residual <= solve::TARGET);
        assert_eq!(report.active, after.warm_start.contacts.len());
        let pushes = after.warm_start.contacts.iter();
        let found: Vec<_> = pushes
            .map(|c| (key(c.first, c.second, c.code), c.multiplier))
            .collect();
        compare_pushes(&case, &found, "exact solver");
        worst = worst.max(cold).max(warm);
    }
    println!("worst difference from the exact step, exact solver: {worst:e}");
}

#[test]
fn every_case_is_reproduced_by_the_fallback_alone() {
    let (mut worst, mut contacts): (f64, usize) = (0.0, 0);
    for case in all() {
        let qp = program(&case.state);
        contacts += qp.contacts.len();
        if qp.contacts.is_empty() {
            continue;
        }
        let hints = Hints {
            multipliers: &vec![1.0; qp.contacts.len()],
            x: &case.state.configuration.x,
            y: &case.state.configuration.y,
        };
        let (mut workspace, mut solution) = (Workspace::default(), Solution::default());
        solve::solve(
            Backend::Fallback,
            &qp,
            &hints,
            &mut workspace,
            &mut solution,
        );
        assert!(
            solution.residual <= solve::TARGET,
            "{}: {:e}",
            case.name,
            solution.residual
        );
        assert!(solution.fallback > 0);
        let mut after = case.state.clone();
        for (index, displacement) in solution.displacement.iter().enumerate() {
            after.configuration.x[index] += displacement[0];
            after.configuration.y[index] += displacement[1];
            after.configuration.alpha[index] += displacement[2];
        }
        let error = error(&case, &after);
        assert!(error <= TOLERANCE, "{}: {error:e}", case.name);
        let pushes = qp.contacts.iter().zip(&solution.multipliers);
        let found: Vec<_> = pushes
            .map(|(c, &value)| (key(c.i, c.j, c.code), value))
            .collect();
        compare_pushes(&case, &found, "fallback");
        worst = worst.max(error);
    }
    assert!(contacts > 500, "too few contacts in the cases: {contacts}");
    println!("worst difference from the exact step, fallback: {worst:e}");
}

/// Returns the program of one step with all contacts within the reach of the stepper's first list.
fn program(state: &State) -> Qp {
    let reach = state.parameters.reach(state.configuration.largest_weight());
    crate::program(state, reach)
}
