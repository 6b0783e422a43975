//! Documents have a bound, and say how much they leave out; tables without rows have all columns.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use crate::support::Daemon;

/// 1,501 entries of order and measures of each of two runs, and a trajectory of 151 steps of 8 individuals.
const LONG: &str = "name = \"long\"\nseed = 3\nduration = 30\ngrid = [{ n = 8, pi3 = [1, 2] }]\n\
                    measure = { order_every = 1, series_every = 1, record_every = 10, columns = [\"milling\"] }\n";

/// A run with a variable, a measure and `[stop]`, of a duration of 0.2 or of one that it does not reach.
const ALL_COLUMNS: &str = "seed = 3\nreplicates = 2\nmeasure = { columns = [\"drift\", \"msd(5)\"] }\n\
                           grid = [{ n = 8, k = [1, 2] }]\nstop = { when = \"order > 0.9999 for 1e5\" }\n\
                           [[at]]\ntime = 0\ninform = { select = { count = \"$k\" }, direction = 0 }\n";

async fn submit(daemon: &Daemon, folder: &Path, toml: &str, options: &str) {
    let file = folder.join("file.toml");
    fs::write(&file, toml).unwrap();
    let line = format!("experiment run {} {options}", file.display());
    let ended = daemon.jostle(line.trim_end()).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
}

/// The stdout and the stderr of `experiment results long` with these arguments, which may have blanks.
fn results(daemon: &Daemon, arguments: &[&str]) -> (String, String) {
    let ended = Command::new(env!("CARGO_BIN_EXE_jostle"))
        .args([&["experiment", "results", "long"], arguments].concat())
        .env("JOSTLE_ENDPOINT", &daemon.endpoint)
        .output()
        .unwrap();
    let [stdout, stderr] = [ended.stdout, ended.stderr].map(|it| String::from_utf8(it).unwrap());
    assert!(ended.status.success(), "{arguments:?}: {stderr}");
    (stdout, stderr)
}

fn document(daemon: &Daemon, arguments: &[&str]) -> Value {
    let (stdout, _) = results(daemon, &[arguments, &["--json"]].concat());
    serde_json::from_str(&stdout).unwrap()
}

fn length(column: &Value) -> usize {
    column.as_array().unwrap().len()
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_run_has_over_time_is_bounded_in_a_document() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start().await;
    submit(&daemon, folder.path(), LONG, "").await;
    let runs = document(&daemon, &["--by", "run"]);
    let run = runs["groups"][0]["values"]["run"].as_str().unwrap();
    for (more, taken) in [
        (&[][..], 1000),
        (&["--limit", "3"], 3),
        (&["--limit", "1400"], 1400),
        (&["--limit", "90000"], 1501),
        (&["--all"], 1501),
    ] {
        let order = document(&daemon, &[&["--order", run], more].concat());
        assert_eq!(order["run"], run);
        let lengths = ["time", "order"].map(|it| length(&order[it]));
        assert_eq!(lengths, [taken; 2], "{more:?}");
        assert_eq!(order["left_out"], json!(1501 - taken), "{more:?}");
        let series = document(&daemon, &[&["--series", run], more].concat());
        assert_eq!(series["experiment"], "long");
        let [of_run] = &series["series"].as_array().unwrap()[..] else {
            panic!("{series}");
        };
        let columns = [&of_run["step"], &of_run["measures"]["milling"]];
        assert_eq!(columns.map(length), [taken; 2], "{more:?}");
        assert_eq!(series["left_out"], json!(1501 - taken), "{more:?}");
        let rows = taken.min(1208);
        let trajectory = document(&daemon, &[&["--trajectory", run], more].concat());
        assert_eq!(length(&trajectory["x"]), rows, "{more:?}");
        assert_eq!(trajectory["left_out"], json!(1208 - rows), "{more:?}");
        assert!(trajectory["about"]["seed"].is_string(), "{more:?}");
    }
    // Of all runs: those that are left out as a whole are counted, too.
    for (more, taken) in [
        (&[][..], &[1000][..]),
        (&["--limit", "1600"], &[1501, 99]),
        (&["--all"], &[1501, 1501]),
    ] {
        let series = document(&daemon, &[&["--series"], more].concat());
        let all = series["series"].as_array().unwrap().iter();
        let lengths: Vec<usize> = all.map(|it| length(&it["time"])).collect();
        assert_eq!(lengths, taken, "{more:?}");
        let left_out = 3002 - taken.iter().sum::<usize>();
        assert_eq!(series["left_out"], json!(left_out), "{more:?}");
    }
    // The text is whole, unless a limit is given.
    for what in ["--order", "--series", "--trajectory"] {
        let of = if what == "--trajectory" { 1208 } else { 1501 };
        let (whole, notes) = results(&daemon, &[what, run]);
        assert_eq!((whole.lines().count(), &*notes), (1 + of, ""), "{what}");
        let (part, notes) = results(&daemon, &[what, run, "--limit", "3"]);
        let expected: Vec<&str> = whole.lines().take(4).collect();
        assert_eq!(part.lines().collect::<Vec<_>>(), expected, "{what}");
        let note = format!("{} rows more", of - 3);
        assert!(notes.contains(&note), "{what}: {notes}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_table_before_the_first_result_has_all_columns() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start().await;
    for (name, duration, options) in [("short", 0.2, ""), ("endless", 1e6, "--detach")] {
        let toml = format!("name = \"{name}\"\nduration = {duration}\n{ALL_COLUMNS}");
        submit(&daemon, folder.path(), &toml, options).await;
    }
    let whole = daemon.said("experiment results short --csv").await;
    let header = whole.lines().next().unwrap();
    assert!(header.ends_with(",k,stopped_at,drift,msd(5)"), "{header}");
    let empty = daemon.said("experiment results endless --csv").await;
    assert_eq!(empty.lines().collect::<Vec<_>>(), [header]);
    let [out, file] = ["out", "one.csv"].map(|name| folder.path().join(name));
    for out in [&out, &file] {
        let line = format!("experiment results endless -o {}", out.display());
        daemon.said(&line).await;
    }
    for csv in [out.join("results.csv"), file] {
        let written = fs::read_to_string(csv).unwrap();
        assert_eq!(written.lines().collect::<Vec<_>>(), [header]);
    }
    daemon.said("experiment cancel endless").await;
    daemon.stop().await;
}
