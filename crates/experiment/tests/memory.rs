//! The estimate of memory, compared with processes that execute the experiment.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::env;
use std::fs;
use std::process::Command;

use jostle_experiment::{Execution, ExecutionControl, Folder, Plan, Subset, execute};

/// The experiment of a process that executes one; others have none.
const EXPERIMENT: &str = "JOSTLE_TEST_EXPERIMENT";

/// A number of kB in the status of this process.
fn status(name: &str) -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix(name));
    let word = line.unwrap().split_whitespace().next().unwrap();
    word.parse().unwrap()
}

#[test]
fn execute_the_experiment_of_this_process() {
    let Ok(text) = env::var(EXPERIMENT) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let before = status("VmRSS:");
    let plan = Plan::parse(&text).unwrap();
    let mut results = Folder::open(folder.path(), &plan).unwrap();
    let execution = Execution {
        plan: &plan,
        subset: &Subset::all(&plan),
        threads: 1,
        checkpoint_every: None,
    };
    execute(execution, &mut results, &ExecutionControl::new()).unwrap();
    println!("took {} kB", status("VmHWM:") - before);
}

/// What a process takes that executes an experiment, in bytes.
fn measured(text: &str) -> u64 {
    let output = Command::new(env::current_exe().unwrap())
        .args([
            "execute_the_experiment_of_this_process",
            "--exact",
            "--nocapture",
        ])
        .env(EXPERIMENT, text)
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let (_, rest) = text.split_once("took ").unwrap();
    let number = rest.split_whitespace().next().unwrap();
    1024 * number.parse::<u64>().unwrap()
}

#[test]
fn an_experiment_takes_at_most_its_estimated_memory() {
    let cases = [
        // Rows of many runs, also with columns.
        "duration = 0.04\nreplicates = 15000\n[spec]\nn = 2\n",
        "duration = 0.04\nreplicates = 15000\n[measure]\ncolumns = [\"milling\", \"order\", \
         \"drift\"]\n[spec]\nn = 2\n",
        // A large group, and one that grows.
        "duration = 20\n[spec]\nn = 1000\n",
        "duration = 2\n[spec]\nn = 10\n[[at]]\ntime = 0.1\ninject = { count = 1500, within = \
         { x = 0, y = 0, radius = 60 } }\n",
        // States of earlier steps.
        "duration = 60\n[measure]\ncolumns = [\"msd(50)\"]\n[spec]\nn = 90\n",
        // Long time series.
        "duration = 4000\n[measure]\norder_every = 1\nseries_every = 1\ncolumns = [\"milling\"]\n\
         [spec]\nn = 2\n",
        // Trajectories.
        "duration = 40\n[measure]\nrecord_every = 1\n[spec]\nn = 100\n",
    ];
    let text = |case: &str| format!("name = \"a\"\n{case}");
    // What the program takes whatever it executes.
    let base = measured(&text("duration = 0.04\n[spec]\nn = 2\n"));
    for case in cases {
        let plan = Plan::parse(&text(case)).unwrap();
        let runs = plan.runs().iter().map(|run| plan.run_memory_bytes(run));
        let estimated = plan.memory_bytes() + runs.max().unwrap();
        let bytes = measured(&text(case)).saturating_sub(base);
        let ratio = bytes as f64 / estimated as f64;
        println!("{case:?}: {ratio:.2} of {} kB", estimated / 1024);
        // A group that grows has no contacts at first, and takes much less.
        let least = if case.contains("inject") { 0.0 } else { 0.25 };
        assert!((least..=1.0).contains(&ratio), "{case}: {ratio}");
    }
}
