//! Hard states: every individual in contact, linearly dependent contacts, and parameters at the
//! ends of their ranges.

use std::f64::consts::PI;

use jostle_physics::model::{Parameters, State, start};
use jostle_physics::stepper::{StepError, Stepper, solve};

use crate::exact::StepTotals;
use crate::with;

/// Steps of each state.
const STEPS: u64 = 300;

/// Pose (x, y, alpha) of each individual.
type Poses = Vec<[f64; 3]>;

fn state(parameters: Parameters, poses: &[[f64; 3]]) -> State {
    let [x, y, alpha] = [0, 1, 2].map(|axis| poses.iter().map(|pose| pose[axis]).collect());
    let [x, y, alpha]: [Vec<f64>; 3] = [x, y, alpha];
    let configuration = start::given(&parameters, &x, &y, &alpha).unwrap();
    with(parameters, 0, configuration)
}

/// Returns `n` bodies in a line along x, each in contact with the next, with headings `alpha`.
fn line(parameters: &Parameters, n: usize, alpha: impl Fn(usize) -> f64) -> Poses {
    let length = 2.0 * (parameters.half_length() + parameters.radius());
    let middle = (n - 1) as f64 / 2.0;
    let pose = |k: usize| [length * (k as f64 - middle), 0.0, alpha(k)];
    (0..n).map(pose).collect()
}

/// Returns `n` bodies side by side, each flush with the next, with headings `alpha`.
fn stack(parameters: &Parameters, n: usize, alpha: impl Fn(usize) -> f64) -> Poses {
    let width = 2.0 * parameters.radius();
    (0..n).map(|k| [0.0, width * k as f64, alpha(k)]).collect()
}

/// Returns rows of bodies end to end. Every other row is shifted by `shifted` lengths. Bodies left
/// of the centre head right, the others left.
fn bricks(parameters: &Parameters, rows: usize, columns: usize, shifted: f64) -> Poses {
    let (width, length) = (
        2.0 * parameters.radius(),
        2.0 * (parameters.half_length() + parameters.radius()),
    );
    let pose = |k: usize| {
        let (row, column) = (k / columns, k % columns);
        let shift = shifted * length * (row % 2) as f64;
        let x = length * (column as f64 - (columns as f64 - 1.0) / 2.0) + shift;
        let is_left = 2 * column < columns;
        [x, width * row as f64, if is_left { 0.0 } else { PI }]
    };
    (0..rows * columns).map(pose).collect()
}

/// Returns the `n` discs nearest to the centre of a hexagonal packing in contact, all heading to
/// the centre.
fn hexagonal(n: usize) -> Poses {
    let half_height = 0.75f64.sqrt();
    let mut places: Vec<[f64; 2]> = (-20..=20)
        .flat_map(|row| (-20..=20).map(move |column| (row, column)))
        .map(|(row, column): (i32, i32)| {
            let (row, column) = (f64::from(row), f64::from(column));
            [column + 0.5 * row, half_height * row]
        })
        .collect();
    let distance = |[x, y]: &[f64; 2]| x * x + y * y;
    // Many distances are equal up to rounding: order these by angle.
    places.sort_by(|a, b| {
        let near = |place| (distance(place) * 1e6).round();
        let angle = |place: &[f64; 2]| place[1].atan2(place[0]);
        near(a)
            .total_cmp(&near(b))
            .then(angle(a).total_cmp(&angle(b)))
    });
    let pose = |&[x, y]: &[f64; 2]| [x, y, (-y).atan2(-x)];
    places[..n].iter().map(pose).collect()
}

/// Steps a state and asserts that every residual is at most the target. If `may_cross`, the run may
/// end with crossed axes.
fn step_and_check(name: &str, mut state: State, may_cross: bool) -> StepTotals {
    let (mut totals, mut stepper) = (StepTotals::default(), Stepper::new());
    let mut end = String::new();
    for step in 0..STEPS {
        match stepper.step(&mut state) {
            Ok(report) => totals += &report,
            Err(error @ StepError::CrossedBodies { .. }) if may_cross => {
                end = format!(", then {error}");
                break;
            }
            Err(error) => panic!("{name}, step {step}: {error}"),
        }
        assert!(
            totals.residual <= solve::TARGET,
            "{name}, step {step}: {:e}",
            totals.residual
        );
    }
    println!("{name}: {totals}{end}");
    totals
}

/// Returns parameters with `pi3` and `pi4` at the ends of their ranges and in the middle. `dt` is
/// 0.02, or the longest allowed step if that is shorter.
fn extremes(pi1: f64) -> impl Iterator<Item = Parameters> {
    let numbers = [
        (1.0, 10.0),
        (0.01, 1e-3),
        (0.01, 1e3),
        (10.0, 1e-3),
        (10.0, 1e3),
    ];
    numbers.into_iter().map(move |(pi3, pi4)| {
        let parameters = Parameters {
            pi1,
            pi3,
            pi4,
            ..Parameters::default()
        };
        Parameters {
            dt: parameters.longest_step(0.0).min(0.02),
            ..parameters
        }
    })
}

fn named(name: &str, parameters: &Parameters) -> String {
    let Parameters { pi1, pi3, pi4, .. } = parameters;
    format!("{name}, pi1 {pi1}, pi3 {pi3}, pi4 {pi4}")
}

/// Calls [`step_and_check`] on a formation for three aspect ratios and all [`extremes`].
fn settle_all(name: &str, poses: impl Fn(&Parameters) -> Poses) {
    for parameters in [1.5, 4.0, 32.0].into_iter().flat_map(extremes) {
        let name = named(name, &parameters);
        step_and_check(&name, state(parameters, &poses(&parameters)), true);
    }
}

#[test]
fn chains_pushed_together_from_both_ends() {
    let inwards = |k: usize| if k < 50 { 0.0 } else { PI };
    settle_all("chain", |parameters| line(parameters, 100, inwards));
    // With slightly different headings the chain buckles.
    settle_all("crooked chain", |parameters| {
        line(parameters, 100, |k| {
            inwards(k) + 1e-3 * (k % 3) as f64 - 1e-3
        })
    });
}

#[test]
fn chains_end_to_end_with_equal_headings() {
    settle_all("file", |parameters| line(parameters, 60, |_| 0.0));
    settle_all("file with one turned back", |parameters| {
        line(parameters, 60, |k| if k == 40 { PI } else { 0.0 })
    });
}

#[test]
fn stacks_side_by_side() {
    settle_all("stack", |parameters| stack(parameters, 60, |_| 0.0));
    settle_all("stack, every other turned back", |parameters| {
        stack(parameters, 60, |k| PI * (k % 2) as f64)
    });
}

#[test]
fn walls_of_bricks() {
    for (name, shifted) in [("wall", 0.0), ("wall with joints apart", 0.5)] {
        settle_all(name, |parameters| bricks(parameters, 10, 10, shifted));
    }
}

/// With all headings to the centre the packing is at rest. With headings that miss the centre on
/// either side, discs slide round each other.
#[test]
fn three_hundred_packed_discs_driven_to_the_centre() {
    for pi3 in [0.01, 1.0, 10.0] {
        for past in [0.0, 0.1, 1.5] {
            let parameters = Parameters {
                pi1: 1.0,
                pi3,
                ..Parameters::default()
            };
            let mut poses = hexagonal(300);
            for (k, pose) in poses.iter_mut().enumerate() {
                pose[2] += past * ((k % 7) as f64 - 3.0) / 3.0;
            }
            let name = format!("{}, off by {past}", named("packed discs", &parameters));
            let totals = step_and_check(&name, state(parameters, &poses), false);
            // 600 coordinates do not determine more than 600 multipliers.
            assert!(past > 1.0 || totals.max_active > 700, "{name}: {totals}");
        }
    }
}
