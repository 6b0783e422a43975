//! Cost of a step of a large group: thread CPU time by phase, and memory.
//!
//! `cargo bench -p jostle-physics-benches --bench large -- --help` lists the options. Each group is
//! drawn in its disc and stepped in a process of its own, so that memory is measured for it alone;
//! then more steps are measured. A drawn group contracts slowly: `active` shows how packed it is.
//! Memory is the resident memory of the process less that after stepping a small group.
//!
//! `-- --threads 2` measures the gain of two threads: the same group is stepped without and with
//! threads, in alternation, and the least wall-clock times are printed.

mod threads;

use std::process::Command;
use std::time::Duration;
use std::{env, fs};

use clap::Parser;
use jostle_physics::model::attraction::AttractionWorkspace;
use jostle_physics::model::{Attraction, Parameters, State, start};
use jostle_physics::stepper::{StepReport, Stepper};
use rustix::time::{ClockId, clock_gettime};
use serde_json::json;

/// Seed of every start.
const SEED: u64 = 1;

/// Size and steps of a small group that is stepped first, so that the program is loaded when memory
/// is read.
const SMALL: usize = 200;
const WARMING: u64 = 200;

/// Thread CPU time of a step of a large group in ms, and its memory
#[derive(Debug, Parser)]
#[command(bin_name = "cargo bench -p jostle-physics-benches --bench large --")]
struct Arguments {
    /// Print one JSON object per line instead of a table
    #[arg(long)]
    json: bool,
    /// Numbers of individuals, separated by commas
    #[arg(long, value_delimiter = ',', default_values_t = [10_000, 100_000])]
    n: Vec<usize>,
    /// Time units for which a group is stepped before it is measured
    #[arg(long, default_value_t = 20.0)]
    time: f64,
    /// Number of measured steps
    #[arg(long, default_value_t = 25)]
    steps: usize,
    /// Accuracy of the attraction
    #[arg(long, default_value_t = 1e-6)]
    accuracy: f64,
    /// Radius of the disc over the square root of n
    #[arg(long, default_value_t = 1.0)]
    radius: f64,
    /// Length of the bodies over their width
    #[arg(long, default_value_t = Parameters::default().pi1)]
    pi1: f64,
    /// Print the least wall-clock times without and with this number of threads instead
    #[arg(long, conflicts_with = "json")]
    threads: Option<usize>,
    /// Measures one group in this process.
    #[arg(long, hide = true)]
    alone: bool,
    /// Appended by cargo.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() {
    let arguments = Arguments::parse();
    if arguments.alone {
        let found = measure(arguments.n[0], &arguments);
        println!(
            "{}",
            if arguments.json {
                found.json()
            } else {
                found.text()
            }
        );
        return;
    }
    if let Some(count) = arguments.threads {
        println!("{}", threads::heading());
        for &n in &arguments.n {
            println!("{}", threads::measure(n, count, &arguments));
        }
        return;
    }
    if !arguments.json {
        println!("{}", heading());
    }
    for n in &arguments.n {
        let mut child = Command::new(env::current_exe().expect("this program has a path"));
        child.args(["--alone", "--n", &n.to_string()]);
        child.args(["--time", &arguments.time.to_string()]);
        child.args(["--steps", &arguments.steps.to_string()]);
        child.args(["--accuracy", &arguments.accuracy.to_string()]);
        child.args(["--radius", &arguments.radius.to_string()]);
        child.args(["--pi1", &arguments.pi1.to_string()]);
        child.args(arguments.json.then_some("--json"));
        let status = child.status().expect("this program starts");
        assert!(status.success(), "n = {n}: {status}");
    }
}

/// Measurements of one group. Times are in ms per step.
#[derive(Default)]
struct Found {
    n: usize,
    time: f64,
    attraction: f64,
    contacts: f64,
    solve: f64,
    slowest: f64,
    listed: f64,
    active: f64,
    iterations: f64,
    /// Calls of the fallback and largest residual, over all steps, also those before the measured
    /// ones.
    fallbacks: usize,
    worst_residual: f64,
    /// The first step, which has no warm start.
    first: f64,
    /// Bytes per individual, at the end and at the peak.
    resident: f64,
    peak: f64,
}

/// Draws, steps, and measures one group.
fn measure(n: usize, arguments: &Arguments) -> Found {
    let mut small = Group::new(SMALL, arguments);
    while small.state.step < WARMING {
        small.step(&mut Found::default());
    }
    drop(small);
    let [before, _] = memory();
    let mut group = Group::new(n, arguments);
    let mut found = Found {
        n,
        ..Found::default()
    };
    while group.state.time() < arguments.time {
        let began = cpu_time();
        let report = group.step(&mut Found::default());
        let took = milliseconds(cpu_time() - began);
        if group.state.step == 1 {
            found.first = took;
        }
        found.add_exactness(&report);
    }
    found.time = group.state.time();
    for _ in 0..arguments.steps {
        let before = found.whole();
        let report = group.step(&mut found);
        found.slowest = found.slowest.max(found.whole() - before);
        found.add_exactness(&report);
        found.listed += report.contacts as f64;
        found.active += report.active as f64;
        found.iterations += report.iterations as f64;
    }
    let steps = arguments.steps as f64;
    for sum in [
        &mut found.attraction,
        &mut found.contacts,
        &mut found.solve,
        &mut found.listed,
        &mut found.active,
        &mut found.iterations,
    ] {
        *sum /= steps;
    }
    [found.resident, found.peak] = memory().map(|bytes| (bytes - before) / n as f64);
    found
}

/// A group, its stepper, and the workspace of its attraction.
struct Group {
    state: State,
    attraction: AttractionWorkspace,
    pull: Vec<[f64; 2]>,
    stepper: Stepper,
}

/// Returns a group drawn in its disc.
fn drawn(n: usize, arguments: &Arguments) -> State {
    let parameters = Parameters {
        pi1: arguments.pi1,
        attraction: Attraction::All {
            accuracy: Some(arguments.accuracy),
        },
        ..Parameters::default()
    };
    let radius = arguments.radius * (n as f64).sqrt();
    State {
        parameters,
        seed: SEED,
        configuration: start::disc(&parameters, n, Some(radius), SEED)
            .expect("the individuals fit in the disc"),
        ..State::default()
    }
}

impl Group {
    fn new(n: usize, arguments: &Arguments) -> Self {
        Self {
            state: drawn(n, arguments),
            attraction: AttractionWorkspace::default(),
            pull: Vec::new(),
            stepper: Stepper::new(),
        }
    }

    /// Takes one step and adds the times of its phases. `advance` includes an assembly with a valid
    /// neighbour list; a second assembly measures that time, which is subtracted from `solve`.
    fn step(&mut self, found: &mut Found) -> StepReport {
        let Self {
            state,
            attraction,
            pull,
            stepper,
        } = self;
        let began = cpu_time();
        attraction.compute(state.parameters.attraction, &state.configuration, pull);
        let attracted = cpu_time();
        stepper.assemble(state, pull).expect("no axes cross");
        let assembled = cpu_time();
        stepper.assemble(state, pull).expect("no axes cross");
        let reassembled = cpu_time();
        let report = stepper.advance(state, pull).expect("every step is solved");
        let solved = cpu_time();
        found.attraction += milliseconds(attracted - began);
        found.contacts += milliseconds(assembled - attracted);
        found.solve += milliseconds(solved - reassembled) - milliseconds(reassembled - assembled);
        report
    }
}

impl Found {
    fn whole(&self) -> f64 {
        self.attraction + self.contacts + self.solve
    }

    fn add_exactness(&mut self, report: &StepReport) {
        self.fallbacks += report.fallback;
        self.worst_residual = self.worst_residual.max(report.residual);
    }

    fn text(&self) -> String {
        let times = [
            self.attraction,
            self.contacts,
            self.solve,
            self.whole(),
            self.slowest,
            self.first,
        ];
        let times: Vec<String> = times.iter().map(|time| format!("{time:>10.2}")).collect();
        format!(
            "{:>7} {:>5.1} {} {:>8.0} {:>8.0} {:>5.1} {:>5} {:>9.1e} {:>8.0} {:>8.0}",
            self.n,
            self.time,
            times.join(" "),
            self.listed,
            self.active,
            self.iterations,
            self.fallbacks,
            self.worst_residual,
            self.resident,
            self.peak,
        )
    }

    fn json(&self) -> String {
        json!({
            "n": self.n,
            "time": self.time,
            "attraction_ms": self.attraction,
            "contacts_ms": self.contacts,
            "solve_ms": self.solve,
            "step_ms": self.whole(),
            "slowest_ms": self.slowest,
            "first_ms": self.first,
            "contacts": self.listed,
            "active": self.active,
            "iterations": self.iterations,
            "fallbacks": self.fallbacks,
            "worst_residual": self.worst_residual,
            "bytes_an_individual": self.resident,
            "peak_bytes_an_individual": self.peak,
        })
        .to_string()
    }
}

fn heading() -> String {
    format!(
        "{:>7} {:>5} {:>10} {:>10} {:>10} {:>10} {:>10} {:>10} {:>8} {:>8} {:>5} {:>5} {:>9} {:>8} {:>8}",
        "n",
        "time",
        "attraction",
        "contacts",
        "solve",
        "step_ms",
        "slowest",
        "first",
        "contacts",
        "active",
        "iter",
        "falls",
        "residual",
        "bytes/n",
        "peak/n",
    )
}

/// Returns the CPU time of the thread.
fn cpu_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    let seconds = u64::try_from(now.tv_sec).expect("CPU time is positive");
    let nanoseconds = u32::try_from(now.tv_nsec).expect("nanoseconds are below a billion");
    Duration::new(seconds, nanoseconds)
}

fn milliseconds(duration: Duration) -> f64 {
    1e3 * duration.as_secs_f64()
}

/// Returns the resident memory of the process in bytes, current and peak.
fn memory() -> [f64; 2] {
    let status = fs::read_to_string("/proc/self/status").expect("/proc is mounted");
    ["VmRSS:", "VmHWM:"].map(|name| {
        let line = status.lines().find_map(|line| line.strip_prefix(name));
        let kibibytes = line.and_then(|line| line.trim().strip_suffix(" kB"));
        let kibibytes = kibibytes.and_then(|kibibytes| kibibytes.parse().ok());
        1024.0 * kibibytes.unwrap_or(f64::NAN)
    })
}
