//! Counts the instructions of a step. Unlike times, counts are reproducible, so that small
//! slowdowns are detected.
//!
//! `cargo bench --bench instructions` runs one step of each of five
//! groups under callgrind. It fails if a count differs by more than 3 % from `counts.txt`, in
//! either direction; `-- --write` updates the file, after a speed-up too. Only the step is counted,
//! after steps that warm up the stepper. `-- --states` generates the states of the five groups
//! again.
//!
//! It also counts one evaluation of each measure on groups of 50 and 1,000 individuals after such
//! steps, and fails if `order`, `drift` and `milling` together cost more than 5 % of a step at n = 50.
//! `-- --measures` prints the table of docs/measures.md.
//!
//! Counts depend on the compiler. They do not depend on the machine if it has AVX2: valgrind hides
//! later instruction sets.

mod measures;
#[path = "../physics/step/settled.rs"]
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

/// Maximum relative change of a count: above the effect of the memory layout, far below a relevant
/// change.
const TOLERANCE: f64 = 0.03;

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let has_flag = |name: &str| arguments.iter().any(|argument| argument == name);
    if let Some(index) = arguments.iter().position(|argument| argument == "--case") {
        run_case(arguments[index + 1].parse().expect("a case is a number"));
        return ExitCode::SUCCESS;
    }
    if let Some(index) = arguments
        .iter()
        .position(|argument| argument == "--measure")
    {
        let [n, names] = &arguments[index + 1..=index + 2] else {
            panic!("--measure N NAMES");
        };
        measures::run(n.parse().expect("n is a number"), names);
        return ExitCode::SUCCESS;
    }
    if has_flag("--measures") {
        measures::print_table();
        return ExitCode::SUCCESS;
    }
    if has_flag("--states") {
        let groups: Vec<Value> = CASES
            .iter()
            .map(|case| settled::written(&rounded(case.settled())))
            .collect();
        write(&data_file("states.json"), &Value::from(groups).to_string());
    }
    let counts: Vec<u64> = (0..CASES.len()).map(count).collect();
    if has_flag("--write") {
        let mut text = String::new();
        for (Case { pi1, n }, count) in CASES.iter().zip(&counts) {
            writeln!(text, "pi1 {pi1} n {n} {count}").expect("writing to a string succeeds");
        }
        write(&data_file("counts.txt"), &text);
    }
    let [steps, measures] = [compare(&counts), measures::compare(counts[1])];
    match steps && measures {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    }
}

/// Rounds a state to nine decimals, which halves its file and is exact enough for a start.
fn rounded(mut state: State) -> State {
    let configuration = &mut state.configuration;
    for column in [
        &mut configuration.x,
        &mut configuration.y,
        &mut configuration.alpha,
    ] {
        let round = |value: &mut f64| *value = (*value * 1e9).round() / 1e9;
        column.iter_mut().for_each(round);
    }
    state
}

/// Compares the counts with `counts.txt` and prints the changes. Returns whether all are within the
/// tolerance.
fn compare(counts: &[u64]) -> bool {
    let text = fs::read_to_string(data_file("counts.txt")).expect("counts.txt can be read");
    let expected = text.lines().map(|line| {
        let last = line.split(' ').next_back().expect("a line has a count");
        last.parse::<f64>().expect("a count is a number")
    });
    let mut is_ok = true;
    for ((Case { pi1, n }, &count), expected) in CASES.iter().zip(counts).zip(expected) {
        let change = count as f64 / expected - 1.0;
        let percent = 100.0 * change;
        let verdict = if change.abs() <= TOLERANCE {
            "ok"
        } else {
            is_ok = false;
            "changed by more than 3 %: find the cause, or update the counts with -- --write"
        };
        println!("pi1 = {pi1}, n = {n}: {count} instructions, {percent:+.2} %, {verdict}");
    }
    is_ok
}

/// Counts the instructions of one step.
fn count(case: usize) -> u64 {
    let case = case.to_string();
    count_instructions("counted_step", &["--case", &case], &case)
}

/// Counts the instructions of a function of this program, in a process under callgrind with these
/// arguments.
fn count_instructions(function: &str, arguments: &[&str], name: &str) -> u64 {
    fs::create_dir_all(target()).expect("target/ can be written");
    let out = target().join(format!("callgrind.{name}"));
    let status = Command::new("valgrind")
        .args(["--tool=callgrind", "--quiet", "--collect-atstart=no"])
        .arg(format!("--toggle-collect=*{function}*"))
        .arg(format!("--callgrind-out-file={}", out.display()))
        .arg(env::current_exe().expect("this program has a path"))
        .args(arguments)
        .status();
    let status = status.expect("valgrind is installed");
    assert!(status.success(), "valgrind: {status}");
    let text = fs::read_to_string(&out).expect("callgrind has written its counts");
    let totals = text.lines().find_map(|line| line.strip_prefix("totals: "));
    let count = totals.and_then(|count| count.trim().parse().ok());
    count
        .filter(|&count| count > 0)
        .expect("callgrind has counted the function")
}

/// Takes the steps of one case. The last one is counted.
fn run_case(case: usize) {
    let text = fs::read_to_string(data_file("states.json")).expect("states.json can be read");
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

/// The function that callgrind counts, selected by its name.
#[inline(never)]
fn counted_step(stepper: &mut Stepper, state: &mut State) -> StepReport {
    stepper.step(state).expect("every step is solved")
}

/// Returns the path of a file in the folder of this bench.
fn data_file(name: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    root.join("benches/instructions").join(name)
}

fn write(path: &Path, text: &str) {
    fs::write(path, text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}
