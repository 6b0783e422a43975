//! How many instructions a step takes: exact where times are not, so that a slowdown shows.
//!
//! `cargo bench --bench instructions` runs five fixed steps under callgrind and fails where a
//! count is more than 3 % off `counts.txt`, in either direction: who makes a step quicker says so
//! with `-- --write`, which renews the file. Each step is counted alone, after steps from the
//! same state that warm the stepper; nothing else is. `-- --states` makes the five states anew.
//!
//! Counts belong to a compiler. They do not depend on the machine, as long as it has AVX2:
//! valgrind hides what is newer.

#[path = "../step/settled.rs"]
mod settled;

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::{env, fs};

use jostle_physics::model::State;
use jostle_physics::stepper::{StepReport, Stepper};
use serde_json::Value;
use settled::{Case, target};

/// The groups whose steps are counted.
const CASES: [Case; 5] = [
    Case { pi1: 4.0, n: 10 },
    Case { pi1: 4.0, n: 50 },
    Case { pi1: 4.0, n: 74 },
    Case { pi1: 4.0, n: 200 },
    Case { pi1: 1.0, n: 200 },
];

/// Steps taken before the one that is counted.
const WARMING: usize = 20;

/// How far a count may be off: more than another layout of memory makes, far less than a change
/// worth knowing.
const TOLERANCE: f64 = 0.03;

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let asked = |name: &str| arguments.iter().any(|argument| argument == name);
    if let Some(place) = arguments.iter().position(|argument| argument == "--case") {
        take(arguments[place + 1].parse().expect("a case is a number"));
        return ExitCode::SUCCESS;
    }
    if asked("--states") {
        let groups: Vec<Value> = CASES
            .iter()
            .map(|case| settled::written(&rounded(case.settled())))
            .collect();
        write(&beside("states.json"), &Value::from(groups).to_string());
    }
    let counts: Vec<u64> = (0..CASES.len()).map(count).collect();
    if asked("--write") {
        let mut text = String::new();
        for (Case { pi1, n }, count) in CASES.iter().zip(&counts) {
            writeln!(text, "pi1 {pi1} n {n} {count}").expect("a string takes all");
        }
        write(&beside("counts.txt"), &text);
    }
    hold(&counts)
}

/// Keeps nine decimals, enough for a start and half as long to read.
fn rounded(mut state: State) -> State {
    let configuration = &mut state.configuration;
    for column in [
        &mut configuration.x,
        &mut configuration.y,
        &mut configuration.alpha,
    ] {
        let round = |value: &mut f64| *value = libm::round(*value * 1e9) / 1e9;
        column.iter_mut().for_each(round);
    }
    state
}

/// Compares with the file.
fn hold(counts: &[u64]) -> ExitCode {
    let held = fs::read_to_string(beside("counts.txt")).expect("counts.txt can be read");
    let held = held.lines().map(|line| {
        let last = line.split(' ').next_back().expect("a line has a count");
        last.parse::<f64>().expect("a count is a number")
    });
    let mut code = ExitCode::SUCCESS;
    for ((Case { pi1, n }, &count), held) in CASES.iter().zip(counts).zip(held) {
        let change = count as f64 / held - 1.0;
        let percent = 100.0 * change;
        let verdict = if change.abs() <= TOLERANCE {
            "holds"
        } else {
            code = ExitCode::FAILURE;
            "is off by more than 3 %: find out why, or renew it with -- --write"
        };
        println!("pi1 = {pi1}, n = {n}: {count} instructions, {percent:+.2} %, {verdict}");
    }
    code
}

/// Counts one step's instructions, in another process under callgrind.
fn count(case: usize) -> u64 {
    fs::create_dir_all(target()).expect("target/ can be written");
    let out = target().join(format!("callgrind.{case}"));
    let status = Command::new("valgrind")
        .args(["--tool=callgrind", "--quiet", "--collect-atstart=no"])
        .arg("--toggle-collect=*counted_step*")
        .arg(format!("--callgrind-out-file={}", out.display()))
        .arg(env::current_exe().expect("this program has a path"))
        .args(["--case", &case.to_string()])
        .status();
    let status = status.expect("valgrind is installed");
    assert!(status.success(), "valgrind: {status}");
    let text = fs::read_to_string(&out).expect("callgrind has written its counts");
    let totals = text.lines().find_map(|line| line.strip_prefix("totals: "));
    let count = totals.and_then(|count| count.trim().parse().ok());
    count
        .filter(|&count| count > 0)
        .expect("callgrind has seen the step")
}

/// Takes the steps of one case, the last of them counted.
fn take(case: usize) {
    let text = fs::read_to_string(beside("states.json")).expect("states.json can be read");
    let groups: Value = serde_json::from_str(&text).expect("states.json is JSON");
    let parameters = CASES[case].parameters();
    let mut state = settled::read(&groups[case], parameters).expect("states.json has the case");
    let mut stepper = Stepper::new();
    for _ in 0..WARMING {
        stepper.step(&mut state).expect("every step is solved");
    }
    let report = counted_step(&mut stepper, &mut state);
    assert!(report.residual <= 1e-9, "residual {}", report.residual);
}

/// What callgrind looks for by name.
#[inline(never)]
fn counted_step(stepper: &mut Stepper, state: &mut State) -> StepReport {
    stepper.step(state).expect("every step is solved")
}

/// A file of this bench in the sources.
fn beside(name: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    root.join("instructions").join(name)
}

fn write(path: &Path, text: &str) {
    fs::write(path, text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}
