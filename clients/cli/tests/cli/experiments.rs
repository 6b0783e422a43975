//! `experiment` and `plot`.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::json;

use crate::support::{Daemon, object, until};

const SMALL: &str = "name = \"small\"\nseed = 3\nreplicates = 2\nduration = 20\n\
                     grid = [{ n = [3, 8] }]\nmeasure = { order_every = 500, series_every = 400, record_every = 400, \
                     columns = [\"order\", \"milling\"] }\n";
const ENDLESS: &str = "name = \"endless\"\nreplicates = 4\nduration = 1e6\nspec = { n = 20 }\n";

fn file(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// With 3 individuals at the start, individual 3 does not exist yet at step 10.
const FAULTY: &str = "name = \"faulty\"\nseed = 3\nreplicates = 2\nduration = 5\nsetpoints = \"\"\"\n\
                      step,id,direction\n10,3,1\n\"\"\"\ngrid = [{ n = [3, 4, 8] }]\n\
                      spec = { dt = 0.05 }\nmeasure = { order_every = 5, series_every = 5, columns = [\"order\"] }\n\
                      [[at]]\nstep = 50\ninject = { count = 1 }\n";

#[tokio::test(flavor = "multi_thread")]
async fn faulted_runs_are_counted_and_left_out_of_charts() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let daemon = Daemon::with(&[("data_dir", data.to_str().unwrap())]).await;
    let faulty = file(folder.path(), "faulty.toml", FAULTY);
    daemon.jostle(&format!("experiment run {faulty}")).await;
    let summary = daemon.said("experiment results faulty").await;
    assert!(summary.contains("2 runs ended by a fault"), "{summary}");
    let out = folder.path().join("results").display().to_string();
    let fetched = format!("experiment results faulty -o {out}");
    daemon.said(&fetched).await;
    for what in [
        format!("plot {out} --y v --x n"),
        format!("plot {out} --y order --over-time"),
        format!("plot {out}/results.parquet --y v --x n"),
        format!("plot {out}/series.parquet --y order --over-time"),
        "plot faulty --y v --x n".to_owned(),
    ] {
        let picture = folder.path().join("a.svg");
        let ended = daemon
            .jostle(&format!("{what} -o {}", picture.display()))
            .await;
        assert_eq!(ended.code, Some(0), "{ended:?}");
        let note = "left out: 2 runs ended by a fault";
        assert!(ended.stderr.contains(note), "{what}: {ended:?}");
        let drawn = fs::read_to_string(&picture).unwrap();
        let note = "Left out: 2 runs ended by a fault.";
        assert!(drawn.contains(note), "{what}: {drawn}");
        fs::remove_file(&picture).unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn results_of_runs_that_all_ended_at_step_0_are_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start().await;
    let text = "name = \"none\"\nreplicates = 2\nduration = 5\nspec = { n = 3 }\n\
                [stop]\nwhen = \"order > -1\"\n";
    let none = file(folder.path(), "none.toml", text);
    daemon.jostle(&format!("experiment run {none}")).await;
    let out = folder.path().join("results");
    for options in ["", " --csv", &format!(" -o {}", out.display())] {
        let ended = daemon
            .jostle(&format!("experiment results none{options}"))
            .await;
        assert_eq!(ended.code, Some(4), "{options}: {ended:?}");
        let says = "2 runs of none ended by a fault at step 0 and without results";
        assert!(ended.stderr.contains(says), "{options}: {ended:?}");
    }
    assert!(!out.exists());
    // A condition of which no run has taken a step.
    let text = "name = \"some\"\nreplicates = 2\nduration = 1\nspec = { n = 3 }\n\
                [[grid]]\nlimit = [-1, 2]\n[stop]\nwhen = \"order > $limit\"\n";
    let some = file(folder.path(), "some.toml", text);
    let ran = daemon.jostle(&format!("experiment run {some}")).await;
    let ended = daemon.jostle("experiment results some").await;
    let says = "2 of 4 runs: some is finished; the others ended by a fault";
    assert_eq!(ended.code, Some(0), "{ended:?} after {ran:?}");
    assert!(ended.stderr.contains(says), "{ended:?} after {ran:?}");
    let endless = file(folder.path(), "endless.toml", ENDLESS);
    daemon
        .said(&format!("experiment run {endless} --detach"))
        .await;
    let so_far = daemon.jostle("experiment results endless").await;
    assert_eq!(so_far.code, Some(0));
    assert!(
        so_far
            .stderr
            .contains("no run of endless is finished so far"),
        "{so_far:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_from_a_snapshot_is_played() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let daemon = Daemon::with(&[("data_dir", data.to_str().unwrap())]).await;
    daemon.said("create grown --n 9 --noise 0.1 --seed 2").await;
    daemon.said("step grown 40").await;
    let snapshot = folder.path().join("grown.snapshot");
    daemon
        .said(&format!("snapshot grown -o {}", snapshot.display()))
        .await;
    let text = "name = \"later\"\nstart = \"grown.snapshot\"\nseeds = [6, 7]\nduration = 2\n[[at]]\n\
                step = 20\ninject = { count = 2 }\n";
    let later = file(folder.path(), "later.toml", text);
    daemon.said(&format!("experiment run {later}")).await;
    let out = folder.path().join("results");
    daemon
        .said(&format!("experiment results later -o {}", out.display()))
        .await;
    let table = fs::read_to_string(out.join("results.csv")).unwrap();
    for (number, row) in (1..).zip(table.lines().skip(1)) {
        let said = daemon
            .said(&format!("experiment play {later} --run {number} --as live"))
            .await;
        assert!(said.contains("scheduled 1 command:"), "{said}");
        daemon.said("step live 100").await;
        let status = object(&daemon.jostle("--json status live").await);
        let hash = status["result"]["state_hash"].as_str().unwrap();
        assert!(row.contains(hash), "{hash}\n{row}");
        let origin = &status["result"]["origin"];
        assert_eq!(
            (&origin["kind"], &origin["swarm"], &origin["step"]),
            (&json!("restore"), &json!(null), &json!(0)),
        );
        daemon.said("delete live --yes").await;
    }
    assert_eq!(table.lines().count(), 3);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_experiment_is_run_listed_and_its_tables_are_those_of_the_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let daemon = Daemon::with(&[("data_dir", data.to_str().unwrap())]).await;
    let small = file(folder.path(), "small.toml", SMALL);
    let empty = daemon.jostle("experiment list").await;
    assert!(
        empty.stderr.contains("jostle experiment run FILE"),
        "{empty:?}"
    );

    let ended = daemon.jostle(&format!("experiment run {small}")).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(
        ended
            .stdout
            .starts_with("small is finished, 4 of 4 runs finished"),
        "{ended:?}"
    );
    assert!(
        ended.stderr.starts_with("submitted small, 4 runs"),
        "{ended:?}"
    );
    let again = daemon
        .said(&format!("experiment run {small} --detach"))
        .await;
    assert!(again.starts_with("small already exists"), "{again}");
    let progress = daemon.reply("experiment status small").await;
    assert_eq!(
        (&progress["phase"], &progress["finished"]),
        (&json!("finished"), &json!(4))
    );
    let list = daemon.reply("experiment list").await;
    assert_eq!(list["result"]["experiments"], json!([progress]));
    assert!(daemon.said("experiment list").await.contains("100 %"));

    let summary = daemon.said("experiment results small").await;
    assert_eq!(summary.lines().count(), 3, "{summary}");
    let out = folder.path().join("results");
    let wrote = daemon
        .said(&format!("experiment results small -o {}", out.display()))
        .await;
    assert!(wrote.starts_with("wrote 4 runs to "), "{wrote}");
    for name in ["results.csv", "results.parquet"] {
        let theirs = fs::read(data.join("experiments/small").join(name)).unwrap();
        assert!(fs::read(out.join(name)).unwrap() == theirs, "{name}");
    }
    let again = format!("experiment results small -o {}", out.display());
    daemon.said(&again).await;
    let csv = fs::read_to_string(out.join("results.csv")).unwrap();
    let other = folder.path().join("other.csv");
    fs::write(&other, csv.replacen("n=8", "n=9", 1)).unwrap();
    let line = format!("experiment results small -o {}", other.display());
    let ended = daemon.jostle(&line).await;
    ended.assert_stderr(2, "has 1 run that these results do not have");
    daemon.said(&format!("{line} --force")).await;
    assert_eq!(fs::read_to_string(&other).unwrap(), csv);
    // The same runs by name, of another seed.
    let text = SMALL.replace("seed = 3", "seed = 4");
    let reseeded = file(
        folder.path(),
        "reseeded.toml",
        &text.replace("small", "reseeded"),
    );
    daemon.said(&format!("experiment run {reseeded}")).await;
    let instead = format!("experiment results reseeded -o {}", out.display());
    let ended = daemon.jostle(&instead).await;
    ended.assert_stderr(2, "has 4 runs that these results do not have");
    assert_eq!(fs::read_to_string(out.join("results.csv")).unwrap(), csv);
    fs::write(&other, "notes").unwrap();
    daemon
        .jostle(&line)
        .await
        .assert_stderr(2, "is no table of results");
    let csv = daemon.said("experiment results small --csv").await;
    assert_eq!(
        csv.trim(),
        fs::read_to_string(out.join("results.csv")).unwrap().trim()
    );
    let means = daemon.reply("experiment results small").await;
    assert_eq!((&means["runs"], &means["by"]), (&json!(4), &json!(["n"])));
    let [first, _] = &means["groups"].as_array().unwrap()[..] else {
        panic!("{means}");
    };
    assert_eq!(
        (&first["runs"], &first["means"]["v"]["n"]),
        (&json!(2), &json!(2))
    );
    assert!(first["means"]["v"]["error"].is_number(), "{first}");
    assert_eq!(means["units"]["v"], "v0");
    let by_run = daemon
        .reply("experiment results small --by run --limit 3")
        .await;
    assert_eq!(by_run["groups"].as_array().unwrap().len(), 3);
    assert_eq!(by_run["left_out"], 1);
    daemon
        .jostle("--json experiment results small --csv")
        .await
        .assert_stderr(2, "--csv");
    daemon
        .jostle("experiment results small --by pi5")
        .await
        .assert_stderr(2, "did you mean `pi");

    let refused = daemon
        .refusal("experiment results small --order nobody")
        .await;
    assert_eq!(refused["code"], "not_found");
    // Its name has a blank.
    let order = Command::new(env!("CARGO_BIN_EXE_jostle"))
        .args(["experiment", "results", "small", "--order", "n=8 #1"])
        .env("JOSTLE_ENDPOINT", &daemon.endpoint)
        .output()
        .unwrap();
    let order = String::from_utf8(order.stdout).unwrap();
    let lines: Vec<&str> = order.lines().collect();
    assert_eq!((lines.len(), lines[0]), (4, "time,order,drift"), "{order}");
    assert!(lines[2].starts_with("10,"), "{order}");

    let series = daemon.said("experiment results small --series").await;
    let lines: Vec<&str> = series.lines().collect();
    assert_eq!(lines[0], "run,step,time,order,milling");
    assert!(lines[1].starts_with("n=3 #0,0,0,"), "{series}");
    // 1000 steps: 0, 400, 800 and the last one, of each of four runs.
    assert_eq!(lines.len(), 1 + 4 * 4, "{series}");
    assert!(out.join("series.parquet").exists());
    let file = folder.path().join("n3.parquet");
    let trajectory = |more: &[&str]| {
        let arguments = ["experiment", "results", "small", "--trajectory", "n=3 #1"];
        Command::new(env!("CARGO_BIN_EXE_jostle"))
            .args([&arguments, more].concat())
            .env("JOSTLE_ENDPOINT", &daemon.endpoint)
            .output()
            .unwrap()
    };
    let written = trajectory(&["-o", file.to_str().unwrap()]);
    // Steps 0, 400, 800 and the last one, of three individuals.
    let text = String::from_utf8(written.stdout).unwrap();
    assert!(
        text.starts_with("wrote 12 rows of run \"n=3 #1\" to "),
        "{text}"
    );
    let about = jostle_results::table::trajectory::read_about(&file).unwrap();
    assert_eq!(about["run"], "n=3 #1");
    let rows = jostle_results::table::trajectory::read(&file).unwrap();
    assert_eq!(rows.step[9..], [1000, 1000, 1000]);
    assert_eq!(rows.id[9..], [0, 1, 2]);
    let again = trajectory(&["-o", file.to_str().unwrap()]);
    assert_eq!(again.status.code(), Some(2), "{again:?}");
    let printed = String::from_utf8(trajectory(&[]).stdout).unwrap();
    assert_eq!(printed, jostle_results::table::trajectory::csv(&rows));
    let folder_of = trajectory(&["-o", folder.path().to_str().unwrap()]);
    let text = String::from_utf8(folder_of.stderr).unwrap();
    assert!(text.contains("FILE.parquet or FILE.csv"), "{text}");

    for (line, picture) in [
        (format!("plot {} --y milling", out.display()), "milling.svg"),
        (
            format!("plot {} --y milling --over-time", out.display()),
            "over.png",
        ),
        ("plot small --y v --x n".to_owned(), "v.svg"),
        ("plot small --y order --over-time".to_owned(), "order.svg"),
    ] {
        let picture = folder.path().join(picture);
        daemon
            .said(&format!("{line} -o {}", picture.display()))
            .await;
        assert!(fs::metadata(&picture).unwrap().len() > 1000, "{line}");
    }
    let picture = fs::read_to_string(folder.path().join("v.svg")).unwrap();
    assert!(
        picture.contains("95 % interval") && picture.contains("2 runs each"),
        "{picture}"
    );
    for (line, part) in [
        (
            format!("plot {} --y miling -o a.svg", out.display()),
            "did you mean `milling`?",
        ),
        (
            format!("plot {} -o a.svg", out.display()),
            "name a column, one of ",
        ),
        (
            "plot small --y v --x m -o a.svg".to_owned(),
            "use one of n, ",
        ),
        (
            "plot small --y drift --over-time -o a.svg".to_owned(),
            "use one of order, milling",
        ),
        (
            format!("plot {} --y v -o a.gif", out.display()),
            "neither .svg nor .png",
        ),
    ] {
        let refused = daemon.refusal(&line).await;
        assert_eq!(refused["code"], "invalid_argument", "{line}");
        let message = refused["message"].as_str().unwrap();
        assert!(message.contains(part), "{line}: {message}");
    }

    for picture in ["figure.svg", "figure.png"] {
        let picture = folder.path().join(picture);
        daemon
            .said(&format!(
                "figure 2 {} -o {}",
                out.display(),
                picture.display()
            ))
            .await;
        assert!(fs::metadata(&picture).unwrap().len() > 1000);
    }
    let unsuitable = daemon
        .refusal(&format!("figure 6 {} -o a.svg", out.display()))
        .await;
    assert_eq!(unsuitable["code"], "invalid_argument");
    daemon.said("create demo --n 9").await;
    let picture = folder.path().join("now.svg");
    daemon
        .said(&format!("figure snapshot demo -o {}", picture.display()))
        .await;
    assert!(fs::read_to_string(&picture).unwrap().contains("demo"));
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_experiment_continues_without_the_command_line_until_it_is_cancelled() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start().await;
    let endless = file(folder.path(), "endless.toml", ENDLESS);
    let mut running = daemon.begin(&format!("experiment run {endless}"));
    assert!(running.complaint().starts_with("submitted endless"));
    assert!(running.complaint().starts_with("endless is running"));
    running.interrupt();
    let ended = running.end().await;
    assert_eq!(ended.code, Some(130));
    assert!(
        ended.stderr.contains("jostle experiment attach endless"),
        "{ended:?}"
    );

    let is = async |phase: &str| daemon.reply("experiment status endless").await["phase"] == phase;
    assert!(is("running").await);
    daemon.said("experiment pause endless").await;
    assert!(is("paused").await);
    daemon.said("experiment resume endless").await;
    until("it runs", async || is("running").await).await;
    let attached = daemon.begin("experiment attach endless");
    let cancelled = daemon.said("experiment cancel endless").await;
    assert!(
        cancelled.starts_with("endless is cancelled, 0 of 4"),
        "{cancelled}"
    );
    let ended = attached.end().await;
    ended.assert_stderr(4, "was cancelled");
    let tables = folder.path().join("tables");
    let line = format!("experiment results endless -o {}", tables.display());
    let wrote = daemon.said(&line).await;
    assert!(wrote.starts_with("wrote 0 of 4 runs to "), "{wrote}");
    assert!(
        wrote.trim_end().ends_with(": endless is cancelled"),
        "{wrote}"
    );

    let other = file(folder.path(), "other.toml", &ENDLESS.replace("1e6", "1e5"));
    let refused = daemon.refusal(&format!("experiment run {other}")).await;
    assert_eq!(refused["code"], "already_exists");
    daemon.said("experiment delete endless").await;
    let gone = daemon.refusal("experiment attach endless").await;
    assert_eq!(gone["code"], "not_found");
    let wrong = daemon
        .jostle_with("--json experiment run -", "name = \"a\"\nduration = -1\n")
        .await;
    wrong.assert_stderr(2, "line 2");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unknown_name_gets_the_command_that_lists_names() {
    let daemon = Daemon::start().await;
    let ended = daemon.jostle("experiment run nofile.toml").await;
    assert_eq!(ended.code, Some(2), "{ended:?}");
    for command in ["`jostle experiment run --help`", "`jostle experiment list`"] {
        assert!(ended.stderr.contains(command), "{ended:?}");
    }
    // The example of the help is accepted.
    let help = daemon.said("experiment run --help").await;
    let example = help.split_once("of 18 runs:\n").unwrap().1;
    let submitted = daemon
        .jostle_with("experiment run - --detach", example)
        .await;
    assert_eq!(submitted.code, Some(0), "{submitted:?}");
    assert!(
        submitted.stdout.contains("submitted order, 18 runs"),
        "{submitted:?}"
    );
    daemon.said("experiment cancel order").await;

    for line in [
        "results nope",
        "status nope",
        "pause nope",
        "attach nope",
        "delete nope",
    ] {
        let ended = daemon.jostle(&format!("experiment {line}")).await;
        assert_eq!(ended.code, Some(3), "{line}: {ended:?}");
        let list = "no experiment nope on this daemon: `jostle experiment list`";
        assert!(ended.stderr.contains(list), "{line}: {ended:?}");
        let refused = daemon.refusal(&format!("experiment {line}")).await;
        assert_eq!(refused["code"], "not_found", "{line}: {refused}");
    }
    let ended = daemon.jostle("experiment results oder").await;
    assert!(ended.stderr.contains("did you mean `order`?"), "{ended:?}");
    // An unknown run is another error.
    let ended = daemon.jostle("experiment results order --order nope").await;
    assert!(ended.stderr.contains("has no run"), "{ended:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_count_of_one_is_singular() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::with(&[("max_swarms", "1")]).await;
    let one = file(
        folder.path(),
        "one.toml",
        "name = \"one\"\nduration = 1\nspec = { n = 3 }\n",
    );
    let ended = daemon.jostle(&format!("experiment run {one}")).await;
    let said = ended.stdout + &ended.stderr;
    assert!(said.contains("submitted one, 1 run:"), "{said}");
    assert!(said.contains("1 of 1 run finished"), "{said}");
    daemon.said("create a --n 1").await;
    let refused = daemon.jostle("create b --n 1").await;
    refused.assert_stderr(7, "hosts 1 swarm already");
    let refused = daemon.jostle("remove a --count 1").await;
    assert!(
        refused.stderr.contains("1 individual, which is all"),
        "{refused:?}"
    );
    daemon.stop().await;
}

/// Axes that no group of older columns had, and weights without anyone informed.
const AXES: &str = "name = \"axes\"\nduration = 0.2\nreplicates = 2\nspec = { n = 2 }\n\
                    grid = [{ pi2 = [0.5, 0.75], pi3 = [1, 2], pi4 = [5, 10], dt = [0.02, 0.05], n = [2] }]\n";

#[tokio::test(flavor = "multi_thread")]
async fn axes_without_a_field_of_a_row_are_columns_of_the_table() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start().await;
    let grid = |duration: &str| {
        format!(
            "name = \"bare\"\nduration = {duration}\nspec = {{ n = 2 }}\n\
             grid = [{{ stepping = [\"velocity\"], noise = [0, 0.5], attraction = \
             [{{ kind = \"topological\", neighbours = 1 }}] }}]\n"
        )
    };
    let short = file(folder.path(), "short.toml", &grid("0.2"));
    let endless = file(folder.path(), "endless.toml", &grid("1e6"));
    daemon.said(&format!("experiment run {short}")).await;
    daemon
        .said(&format!("experiment run {endless} --name endless --detach"))
        .await;
    let last = |table: &str| -> Vec<String> {
        let line = |line: &str| line.split(',').rev().take(3).collect::<Vec<_>>().join(" ");
        table.lines().map(line).collect()
    };
    let names = "noise attraction stepping";
    let rows = ["0.0 topological:1 velocity", "0.5 topological:1 velocity"];
    let table = daemon.said("experiment results bare --csv").await;
    assert_eq!(last(&table), [&[names], &rows[..]].concat(), "{table}");
    let before = daemon.said("experiment results endless --csv").await;
    assert_eq!(last(&before), [names]);
    // The table that the daemon does not write is the same.
    let out = folder.path().join("out.csv");
    daemon
        .said(&format!("experiment results bare -o {}", out.display()))
        .await;
    assert_eq!(fs::read_to_string(&out).unwrap().trim_end(), table);
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn results_have_a_line_for_each_combination_of_exactly_the_axes_that_vary() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start().await;
    let axes = file(folder.path(), "axes.toml", AXES);
    daemon.said(&format!("experiment run {axes}")).await;
    let table = daemon.said("experiment results axes").await;
    let mut lines = table.lines();
    let header: Vec<&str> = lines.next().unwrap().split_whitespace().collect();
    let runs = header.iter().position(|it| *it == "runs").unwrap();
    let mut varying = header[..runs].to_vec();
    varying.sort_unstable();
    assert_eq!(varying, ["dt", "pi2", "pi3", "pi4"], "{table}");
    let values: Vec<Vec<&str>> = lines
        .map(|line| line.split_whitespace().take(runs + 1).collect())
        .collect();
    let distinct: std::collections::BTreeSet<_> = values.iter().collect();
    assert_eq!((values.len(), distinct.len()), (16, 16), "{table}");
    assert!(values.iter().all(|it| it[runs] == "2"), "{table}");
    // The weight is that of the table of runs, also where no one is informed.
    let pi2 = header.iter().position(|it| *it == "pi2").unwrap();
    assert!(
        values.iter().all(|it| ["0.5", "0.75"].contains(&it[pi2])),
        "{table}"
    );

    let by = daemon.said("experiment results axes --by pi3,n").await;
    let by: Vec<Vec<&str>> = by
        .lines()
        .map(|line| line.split_whitespace().take(3).collect())
        .collect();
    assert_eq!(
        by,
        [["pi3", "n", "runs"], ["1", "2", "16"], ["2", "2", "16"]]
    );
    let document = daemon
        .reply("experiment results axes --by pi3,pi4 --limit 3")
        .await;
    assert_eq!(document["groups"].as_array().unwrap().len(), 3);
    assert_eq!(
        document["groups"][0]["values"],
        json!({"pi3": 1.0, "pi4": 5.0})
    );
    assert_eq!(
        (&document["left_out"], &document["runs"]),
        (&json!(1), &json!(32))
    );
    daemon.stop().await;
}
