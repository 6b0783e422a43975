//! Time series of experiments: the memory of the daemon while they grow, and the processor time of their pages.

use std::collections::HashMap;
use std::ffi::OsString;
use std::time::{Duration, Instant};

use jostle_proto::{SeriesPage, keys};
use rustix::process::{Pid, Resource, Rlimit, prlimit};
use serde_json::{Value, json};

use crate::support::process::{Process, jostled};
use crate::support::{Client, NODE, PREFIX};

/// Steps of each of two runs with 20 measures, and the bytes that the daemon may take more than idle;
/// with `JOSTLE_LONG=1` the second.
const RUNS: [(u64, u64); 2] = [(500_000, 100_000_000), (2_500_000, 500_000_000)];

/// Most of the processor time of all pages of a series, over that of one half as long.
const MAX_RATIO: f64 = 2.2;

/// How often all pages are read.
const ROUNDS: usize = 12;

fn pid(daemon: &Process) -> Option<Pid> {
    Pid::from_raw(i32::try_from(daemon.0.id()).unwrap())
}

/// The bytes that RLIMIT_DATA limits.
fn data_bytes(daemon: &Process) -> u64 {
    let path = format!("/proc/{}/status", daemon.0.id());
    let status = std::fs::read_to_string(path).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmData:"));
    let kilobytes = line.unwrap().trim().trim_end_matches(" kB");
    kilobytes.parse::<u64>().unwrap() * 1024
}

async fn execute(client: &Client, name: &str, toml: &str) {
    let args = json!({"submit": {"toml": toml}}).to_string();
    let key = keys::node_cmd(PREFIX, NODE, "experiment");
    client.query(&key, Some(args.as_bytes())).await.unwrap();
    let key = keys::experiment(PREFIX, NODE, name, "progress");
    let deadline = Instant::now() + Duration::from_secs(600);
    loop {
        let progress: Value = client.query(&key, None).await.unwrap();
        match progress["phase"].as_str() {
            Some("queued" | "running") => assert!(Instant::now() < deadline, "{progress}"),
            phase => return assert_eq!(phase, Some("finished"), "{progress}"),
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

async fn page(client: &Client, name: &str, run: &str, after: u64) -> SeriesPage {
    let noun = format!("series?run={run};after={after}");
    let key = keys::experiment(PREFIX, NODE, name, &noun);
    let replies = client.session.get(&key).await.unwrap();
    let reply = replies.recv_async().await.unwrap();
    let bytes = reply.result().unwrap().payload().to_bytes();
    ciborium::from_reader(&bytes[..]).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn twenty_million_values_fit_100_mb() {
    let (steps, limit) = RUNS[usize::from(std::env::var_os("JOSTLE_LONG").is_some())];
    let arguments = ["serve", "--listen", "tcp/127.0.0.1:0", "--node", "test"];
    let folder = tempfile::tempdir().unwrap();
    let mut command = jostled(&arguments);
    let (mut daemon, endpoint) =
        Process::start(command.args(["--experiment-threads", "2"]), folder);
    let client = Client::open(&endpoint).await;
    client.node("status").await;
    let most = Some(data_bytes(&daemon) + limit);
    let limit = Rlimit {
        current: most,
        maximum: most,
    };
    prlimit(pid(&daemon), Resource::Data, limit).unwrap();

    let columns: Vec<String> = (1..=20)
        .map(|k| format!("\"msd({})\"", 0.02 * f64::from(k)))
        .collect();
    let toml = format!(
        "name = \"long\"\nduration = {}\nreplicates = 2\nspec = {{ n = 2, dt = 0.02 }}\n[measure]\n\
         series_every = 1\ncolumns = [{}]\n",
        steps as f64 * 0.02,
        columns.join(", ")
    );
    execute(&client, "long", &toml).await;
    for run in ["#0", "#1"] {
        let first = page(&client, "long", run, 0).await;
        assert_eq!((first.step[1], first.measures.len()), (1.0, 20));
        let last = page(&client, "long", run, steps - 10).await;
        assert_eq!((last.step.len(), last.next), (11, None));
        assert_eq!(last.step[10], steps as f64);
        assert!(last.measures.iter().all(|it| it.value[10] >= 0.0));
    }
    assert!(daemon.0.try_wait().unwrap().is_none());
}

/// The nanoseconds that each thread of the daemon has run.
fn nanoseconds_run(daemon: &Process) -> HashMap<OsString, u64> {
    let tasks = std::fs::read_dir(format!("/proc/{}/task", daemon.0.id())).unwrap();
    let times = tasks.filter_map(|task| {
        let task = task.unwrap();
        // A thread that has ended meanwhile has no file.
        let schedstat = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        let run = schedstat.split_whitespace().next().unwrap();
        Some((task.file_name(), run.parse().unwrap()))
    });
    times.collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_a_series_twice_as_long_take_twice_as_long() {
    let (daemon, endpoint) = Process::serve();
    let client = Client::open(&endpoint).await;
    let steps = [400_000_u32, 800_000];
    for steps in steps {
        let toml = format!(
            "name = \"of{steps}\"\nduration = {}\nspec = {{ n = 1, dt = 0.02 }}\n[measure]\n\
             series_every = 1\ncolumns = [\"order\"]\n",
            f64::from(steps) * 0.02
        );
        execute(&client, &format!("of{steps}"), &toml).await;
    }
    // The least processor time of a round: the host of a virtual machine takes time from some of them.
    let mut least = [u64::MAX; 2];
    for _ in 0..ROUNDS {
        for (steps, least) in steps.into_iter().zip(&mut least) {
            let (before, mut entries, mut after) = (nanoseconds_run(&daemon), 0, Some(0));
            while let Some(number) = after {
                let page = page(&client, &format!("of{steps}"), "#0", number).await;
                entries += page.step.len();
                after = page.next;
            }
            let run = nanoseconds_run(&daemon).into_iter();
            let run = run.map(|(task, run)| run - before.get(&task).unwrap_or(&0));
            *least = (*least).min(run.sum());
            assert_eq!(entries, steps as usize + 1);
        }
    }
    let ratio = least[1] as f64 / least[0] as f64;
    println!("pages: {least:?} ns, the least of {ROUNDS} rounds, ratio {ratio:.2}");
    assert!(least[0] >= 10_000_000, "{least:?}: too little to compare");
    assert!(ratio <= MAX_RATIO, "{least:?}");
}
