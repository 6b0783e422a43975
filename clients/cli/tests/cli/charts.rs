//! What `plot` writes into its pictures.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{Daemon, until};

const SMALL: &str = "name = \"my_small\"\nseed = 3\nreplicates = 2\nduration = 4\n\
                     grid = [{ n = 5, dt = [0.02, 0.04] }]\n\
                     measure = { series_every = 50, columns = [\"drift\", \"clusters.count\"] }\n\
                     [[at]]\ntime = 0\ninform = { select = { count = 2 }, direction = 0 }\n";

/// The text of a picture that a line draws.
async fn drawn(daemon: &Daemon, folder: &Path, line: &str) -> String {
    let picture = folder.join("drawn.svg");
    let line = format!("{line} -o {}", picture.display());
    daemon.said(&line).await;
    fs::read_to_string(&picture).unwrap()
}

/// The folder below `folder` that has the experiment's file.
fn stored(folder: &Path) -> Option<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|it| it.unwrap().path());
    let mut entries: Vec<PathBuf> = entries.collect();
    entries.sort();
    if entries.iter().any(|it| it.ends_with("experiment.toml")) {
        return Some(folder.to_owned());
    }
    entries
        .iter()
        .filter(|it| it.is_dir())
        .find_map(|it| stored(it))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_chart_has_the_name_of_the_experiment_and_the_units_of_its_columns() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let daemon = Daemon::with(&[("data_dir", data.to_str().unwrap())]).await;
    let file = folder.path().join("my.toml");
    fs::write(&file, SMALL).unwrap();
    daemon
        .jostle(&format!("experiment run {}", file.display()))
        .await;
    let results = folder.path().join("a.b");
    let fetched = format!("experiment results my_small -o {}", results.display());
    daemon.said(&fetched).await;
    let drawn = async |line: &str| drawn(&daemon, folder.path(), line).await;

    fs::create_dir(folder.path().join("merged")).unwrap();
    fs::copy(
        results.join("results.csv"),
        folder.path().join("merged/results.csv"),
    )
    .unwrap();
    let of_folder = Command::new(env!("CARGO_BIN_EXE_jostle"))
        .args(["experiment", "results", "merged"])
        .current_dir(folder.path())
        .env("JOSTLE_ENDPOINT", &daemon.endpoint)
        .output()
        .unwrap();
    let said = String::from_utf8(of_folder.stderr).unwrap();
    assert!(said.contains("`jostle plot merged` draws it"), "{said}");

    // A folder without the experiment's file has its own name, whole.
    let picture = drawn(&format!("plot {} --y v", results.display())).await;
    assert!(picture.contains(">a.b: v over dt<"), "{picture}");
    let original = stored(&data).unwrap();
    fs::copy(
        original.join("experiment.toml"),
        results.join("experiment.toml"),
    )
    .unwrap();
    let (whole, table) = (results.display(), results.join("results.csv"));
    let other = results.join("other.csv");
    fs::copy(&table, &other).unwrap();
    for (line, texts) in [
        (
            format!("plot {whole} --y v"),
            [">my_small: v over dt<", ">v (v0)<", ">dt (s/v0)<"],
        ),
        (
            format!("plot {} --y worst_overlap", table.display()),
            [
                ">my_small: worst_overlap over dt<",
                "body sizes)<",
                ">dt (s/v0)<",
            ],
        ),
        (
            format!("plot {} --y crossed_share", other.display()),
            [
                ">other: crossed_share over dt<",
                ">crossed_share<",
                ">dt (s/v0)<",
            ],
        ),
        (
            format!("plot {whole} --y drift --over-time"),
            [
                ">my_small: drift over time<",
                ">drift (v0)<",
                ">time (s/v0)<",
            ],
        ),
        (
            "plot my_small --y clusters.count --over-time".to_owned(),
            [
                ">my_small: clusters.count over time<",
                ">clusters.count (clusters)<",
                ">time (s/v0)<",
            ],
        ),
        (
            "plot my_small --y time --x dt".to_owned(),
            [">my_small: time over dt<", ">time (s/v0)<", ">dt (s/v0)<"],
        ),
    ] {
        let picture = drawn(&line).await;
        for text in texts {
            assert!(picture.contains(text), "{line}, {text}: {picture}");
        }
        for other in ["time units", "free speed"] {
            assert!(!picture.contains(other), "{line}, {other}: {picture}");
        }
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_chart_of_an_unfinished_experiment_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start().await;
    let file = folder.path().join("part.toml");
    // The last two of the six runs do not end.
    let text = "name = \"part\"\nreplicates = 2\nduration = 1e6\n\
                grid = [{ n = 5, limit = [-2, -1, 2] }]\n\
                [measure]\nseries_every = 50\ncolumns = [\"order\"]\n\
                [stop]\nwhen = \"order > $limit\"\nfrom = 2\n";
    fs::write(&file, text).unwrap();
    daemon
        .said(&format!("experiment run {} --detach", file.display()))
        .await;
    // A run counts as finished just before its row is stored.
    until("four runs have rows", async || {
        let table = daemon.jostle("experiment results part --csv").await;
        table.stdout.lines().count() == 5
    })
    .await;
    let note = |phase: &str| format!("4 of 6 runs: part is {phase}");
    for phase in ["running", "cancelled"] {
        for line in ["--y v --x limit", "--y order --over-time"] {
            let picture = folder.path().join("part.svg");
            let line = format!("plot part {line} -o {}", picture.display());
            let ended = daemon.jostle(&line).await;
            ended.assert_stderr(0, &note(phase));
            let picture = fs::read_to_string(&picture).unwrap();
            let note = format!(">{}.<", note(phase));
            assert!(picture.contains(&note), "{note}: {picture}");
        }
        daemon.jostle("experiment cancel part").await;
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_folder_and_no_name_of_an_experiment_is_described_as_such() {
    let daemon = Daemon::start().await;
    for (what, problem) in [
        (
            "AX_many",
            "no such folder or file, and no name of an experiment: ",
        ),
        ("./nope/", "no such folder or file"),
        ("nope/more", "no such folder or file"),
    ] {
        let ended = daemon.jostle(&format!("plot {what} --y v -o a.svg")).await;
        ended.assert_stderr(2, &format!("jostle: {what}: {problem}"));
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_picture_has_the_present_shape_of_the_bodies() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start().await;
    daemon.said("create one --n 9 --pi1 3").await;
    let mut slenderness = Vec::new();
    for pi1 in ["3", "9"] {
        daemon.said(&format!("set one pi1={pi1} --make-room")).await;
        let picture = drawn(&daemon, folder.path(), "plot snapshot one").await;
        let body = picture.lines().rfind(|it| it.starts_with("<rect")).unwrap();
        let number = |name: &str| -> f64 {
            let (_, after) = body.split_once(&format!(" {name}=\"")).unwrap();
            after.split('"').next().unwrap().parse().unwrap()
        };
        slenderness.push(number("width") / number("height"));
    }
    // Up to the width of the outline.
    assert!((2.7..3.5).contains(&slenderness[0]), "{slenderness:?}");
    assert!((8.0..13.0).contains(&slenderness[1]), "{slenderness:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn several_swarms_are_in_a_grid_with_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start().await;
    let names = ["one", "my_two", "three", "four", "five"];
    for name in names {
        daemon.said(&format!("create {name} --n 9")).await;
    }
    let line = format!("plot snapshot {}", names.join(" "));
    let picture = drawn(&daemon, folder.path(), &line).await;
    let places: Vec<[&str; 2]> = names
        .iter()
        .map(|name| {
            let title = format!(">{name}, time 0 s/v0<");
            let line = picture.lines().find(|it| it.contains(&title));
            let line = line.unwrap_or_else(|| panic!("{title}: {picture}"));
            let values: Vec<&str> = line.split('"').collect();
            [values[1], values[3]]
        })
        .collect();
    let [one, two, three, four, five] = places.try_into().unwrap();
    assert!(one[1] == two[1] && two[1] == three[1], "{picture}");
    assert!(four[1] == five[1] && four[1] != one[1], "{picture}");
    assert!(one[0] == four[0] && two[0] == five[0], "{picture}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn files_outside_the_folder_of_an_experiment_have_a_warning_and_are_not_quoted() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start().await;
    let experiment = folder.path().join("experiment");
    fs::create_dir(&experiment).unwrap();
    let (file, table) = (experiment.join("a.toml"), folder.path().join("secret.csv"));
    let warning = |name: &str| {
        format!("warning: points = {name:?} is outside the folder of the experiment: its content")
    };
    let absolute = table.to_str().unwrap();
    for name in ["../secret.csv", absolute] {
        let toml = format!("name = \"a\"\nduration = 1\nspec = {{ n = 5 }}\npoints = {name:?}\n");
        fs::write(&file, toml).unwrap();
        fs::write(&table, "marmot:x:0:0\n1\n").unwrap();
        let lines = [
            format!("experiment run {} --dry-run", file.display()),
            format!("experiment plan {} --parts 2", file.display()),
            format!("experiment play {}", file.display()),
            format!("experiment run {} --detach", file.display()),
        ];
        for line in &lines {
            let ended = daemon.jostle(line).await;
            ended.assert_stderr(2, &warning(name));
            ended.assert_stderr(2, "line 1, column 1: what is wrong is not shown");
            let said = format!("{}{}", ended.stdout, ended.stderr);
            assert!(!said.contains("marmot"), "{line}: {said}");
        }
        // It is read nevertheless.
        fs::write(&table, "pi1\n2\n3\n").unwrap();
        for line in [&lines[0], &lines[1], &lines[3]] {
            let ended = daemon.jostle(line).await;
            ended.assert_stderr(0, &warning(name));
        }
        let noted = daemon.jostle(&format!("--json {}", lines[0])).await;
        assert!(
            noted.stderr.contains("{\"note\":\"warning: points"),
            "{noted:?}"
        );
        daemon.jostle("experiment cancel a").await;
        daemon.said("experiment delete a").await;
    }
    daemon.stop().await;
}
