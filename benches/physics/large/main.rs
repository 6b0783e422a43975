//! What a step of a large group costs: thread CPU time by phase, and memory.
//!
//! `cargo bench --bench large -- --help` says what can be asked. Each group is drawn in its disc
//! and stepped in a process of its own, so that memory is its alone; then some more steps are
//! measured. A drawn disc falls together slowly: how packed a group is, `active` tells. Memory
//! is what the process holds beyond what it held after stepping a small group.
//!
//! With `-- --threads 2`, what two threads save: the same group is stepped without and with
//! them by turns, and the least wall-clock times are told.

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

/// What every start is drawn with.
const SEED: u64 = 1;

/// A group stepped first, and how often, so that the program is in memory when that is read.
const SMALL: usize = 200;
const WARMING: u64 = 200;

/// Milliseconds a step of a large group costs, in thread CPU time, and its memory
#[derive(Debug, Parser)]
#[command(bin_name = "cargo bench --bench large --")]
struct Arguments {
    /// One JSON object a line instead of a table
    #[arg(long)]
    json: bool,
    /// Numbers of individuals, separated by commas
    #[arg(long, value_delimiter = ',', default_values_t = [10_000, 100_000])]
    n: Vec<usize>,
    /// For how many time units a group is stepped before it is measured
    #[arg(long, default_value_t = 20.0)]
    time: f64,
    /// How many steps are measured
    #[arg(long, default_value_t = 25)]
    steps: usize,
    /// Accuracy of attraction
    #[arg(long, default_value_t = 1e-6)]
    accuracy: f64,
    /// Radius of the disc in roots of n
    #[arg(long, default_value_t = 1.0)]
    radius: f64,
    /// Tells the least wall-clock times without and with as many threads instead
    #[arg(long, conflicts_with = "json")]
    threads: Option<usize>,
    /// Measures one group in this process.
    #[arg(long, hide = true)]
    alone: bool,
    /// What cargo appends.
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
        let mut again = Command::new(env::current_exe().expect("this program has a path"));
        again.args(["--alone", "--n", &n.to_string()]);
        again.args(["--time", &arguments.time.to_string()]);
        again.args(["--steps", &arguments.steps.to_string()]);
        again.args(["--accuracy", &arguments.accuracy.to_string()]);
        again.args(["--radius", &arguments.radius.to_string()]);
        again.args(arguments.json.then_some("--json"));
        let status = again.status().expect("this program starts");
        assert!(status.success(), "n = {n}: {status}");
    }
}

/// What was measured. Times are ms a step.
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
    /// Over all steps, like the next: how often the fallback was asked.
    fallbacks: usize,
    worst_residual: f64,
    /// The first step, solved without memory of any before.
    first: f64,
    /// Bytes an individual, at the end and at most.
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
        found.judge(&report);
    }
    found.time = group.state.time();
    for _ in 0..arguments.steps {
        let before = found.whole();
        let report = group.step(&mut found);
        found.slowest = found.slowest.max(found.whole() - before);
        found.judge(&report);
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

/// A group, and what steps it.
struct Group {
    state: State,
    social: AttractionWorkspace,
    pull: Vec<[f64; 2]>,
    stepper: Stepper,
}

/// A group drawn in its disc.
fn drawn(n: usize, arguments: &Arguments) -> State {
    let parameters = Parameters {
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
            .expect("the disc has room for everybody"),
        ..State::default()
    }
}

impl Group {
    fn new(n: usize, arguments: &Arguments) -> Self {
        Self {
            state: drawn(n, arguments),
            social: AttractionWorkspace::default(),
            pull: Vec::new(),
            stepper: Stepper::new(),
        }
    }

    /// Takes one step, and adds what its phases took. The program is assembled again, now from
    /// the neighbours listed: the solution is what a step takes beyond that.
    fn step(&mut self, found: &mut Found) -> StepReport {
        let Self {
            state,
            social,
            pull,
            stepper,
        } = self;
        let began = cpu_time();
        social.compute(state.parameters.attraction, &state.configuration, pull);
        let attracted = cpu_time();
        stepper.assemble(state, pull).expect("no axes cross");
        let assembled = cpu_time();
        stepper.assemble(state, pull).expect("no axes cross");
        let again = cpu_time();
        let report = stepper.advance(state, pull).expect("every step is solved");
        let solved = cpu_time();
        found.attraction += milliseconds(attracted - began);
        found.contacts += milliseconds(assembled - attracted);
        found.solve += milliseconds(solved - again) - milliseconds(again - assembled);
        report
    }
}

impl Found {
    fn whole(&self) -> f64 {
        self.attraction + self.contacts + self.solve
    }

    fn judge(&mut self, report: &StepReport) {
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

/// The thread's CPU time.
fn cpu_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    let seconds = u64::try_from(now.tv_sec).expect("CPU time is positive");
    let nanoseconds = u32::try_from(now.tv_nsec).expect("nanoseconds are below a billion");
    Duration::new(seconds, nanoseconds)
}

fn milliseconds(duration: Duration) -> f64 {
    1e3 * duration.as_secs_f64()
}

/// The process's resident memory in bytes, now and at most.
fn memory() -> [f64; 2] {
    let status = fs::read_to_string("/proc/self/status").expect("Linux tells of its processes");
    ["VmRSS:", "VmHWM:"].map(|name| {
        let line = status.lines().find_map(|line| line.strip_prefix(name));
        let kibibytes = line.and_then(|line| line.trim().strip_suffix(" kB"));
        let kibibytes = kibibytes.and_then(|kibibytes| kibibytes.parse().ok());
        1024.0 * kibibytes.unwrap_or(f64::NAN)
    })
}
