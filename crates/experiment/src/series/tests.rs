//! Tests of long series: their files, resumed and killed runs, lines of earlier versions, merges.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use jostle_physics::simulation::Simulation;
use jostle_results::table::series::read;
use serde_json::{Value, json};

use super::*;
use crate::disk::DiskWatch;
use crate::dry_run::DiskNeed;
use crate::execute::{Execution, RunRecorder, execute};
use crate::folder::{Folder, FolderError};
use crate::merge::Parts;
use crate::progress::ExecutionControl;
use crate::run::{RunCheckpoint, execute_run_from};
use crate::subset::Subset;

/// Four runs of 3000 steps: 72 kB of order, and 72 kB of measures.
const FILE: &str = "name = \"a\"\nduration = 60\nreplicates = 2\nspec = { n = 2, noise = 0.1 }\n\
                    [[grid]]\npi1 = [1, 4]\n[measure]\norder_every = 1\nseries_every = 1\n\
                    columns = [\"drift\", \"msd(0.2)\"]\n";

fn plan(text: &str) -> Plan {
    Plan::parse(text).unwrap()
}

fn execute_in(plan: &Plan, path: &Path, runs: &str) -> Folder {
    let mut folder = Folder::open(path, plan).unwrap();
    let execution = Execution {
        plan,
        subset: &Subset::parse(plan, runs).unwrap(),
        threads: 1,
        checkpoint_every: None,
    };
    execute(execution, &mut folder, &ExecutionControl::new()).unwrap();
    folder
}

/// The files below a folder with their bytes, without the lock.
fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    fn add(folder: &Path, below: &Path, files: &mut Vec<(PathBuf, Vec<u8>)>) {
        for entry in fs::read_dir(folder.join(below)).unwrap() {
            let below = below.join(entry.unwrap().file_name());
            let path = folder.join(&below);
            match path.is_dir() {
                true => add(folder, &below, files),
                false => files.push((below, fs::read(path).unwrap())),
            }
        }
    }
    let mut all = Vec::new();
    add(folder, Path::new(""), &mut all);
    all.retain(|(path, _)| path != Path::new("lock"));
    all.sort();
    all
}

fn names(folder: &Path) -> Vec<String> {
    let files = files(folder).into_iter();
    files.map(|(path, _)| path.display().to_string()).collect()
}

#[track_caller]
fn assert_same_files(one: &Path, other: &Path) {
    assert_eq!(names(one), names(other));
    for ((path, one), (_, other)) in files(one).into_iter().zip(files(other)) {
        assert!(one == other, "{}", path.display());
    }
}

#[test]
fn a_long_series_is_in_a_file_and_a_short_one_in_the_line() {
    let directory = tempfile::tempdir().unwrap();
    // An order takes 24 bytes, and a row of the measures as much: 2730 fit 64 KiB.
    for (steps, is_long) in [
        (2728_u64, [false, false]),
        (2730, [true, true]),
        (2729, [false, false]),
    ] {
        let text = format!(
            "name = \"a\"\nduration = {}\nspec = {{ n = 2, dt = 0.02 }}\n[measure]\norder_every = 1\n\
             series_every = 1\ncolumns = [\"drift\", \"msd(0.2)\"]\n",
            steps as f64 * 0.02
        );
        let plan = plan(&text);
        let path = directory.path().join(steps.to_string());
        execute_in(&plan, &path, "1");
        let line = fs::read_to_string(path.join("runs.jsonl")).unwrap();
        let line: Value = serde_json::from_str(line.lines().nth(1).unwrap()).unwrap();
        for ((key, folder), is_long) in [("order", "orders"), ("series", "series")]
            .into_iter()
            .zip(is_long)
        {
            let file = format!("{folder}/run-000001.parquet");
            assert_eq!(line.get(key).is_some(), !is_long, "{steps} {key}");
            assert_eq!(path.join(&file).exists(), is_long, "{steps} {key}");
            let length = is_long.then(|| path.join(&file).metadata().unwrap().len());
            assert_eq!(line["files"].get(&file).and_then(Value::as_u64), length);
        }
        // The states, by the library of the physics.
        let mut swarm = Simulation::new(&plan.spec(&plan.runs()[0])).unwrap();
        let mut orders = Vec::new();
        for step in 0..=steps {
            orders.push(Some(swarm.order().order));
            if step < steps {
                swarm.step().unwrap();
            }
        }
        let [table] = &read(&path.join("order.parquet")).unwrap()[..] else {
            panic!("one run");
        };
        assert!(table.measures[0].values == orders, "{steps}");
        assert!(table.steps.iter().copied().eq(0..=steps));
        assert_eq!(table.measures[1].values, vec![None; orders.len()]);
        let [table] = &read(&path.join("series.parquet")).unwrap()[..] else {
            panic!("one run");
        };
        assert!(table.steps.iter().copied().eq(0..=steps));
        assert_eq!(table.measures[1].values[9], None, "no earlier state");
        assert!(table.measures[1].values[10..].iter().all(Option::is_some));
        // A page of each is what the table has.
        let finished = Folder::read(&path, &plan).unwrap();
        for (kind, is_long) in SeriesKind::ALL.into_iter().zip(is_long) {
            let source = Folder::find_series(&path, &plan, &finished, (0, kind)).unwrap();
            let part = Folder::read_series_part(&source, 1000, 3).unwrap();
            assert_eq!(part.is_some(), is_long);
            let whole = Folder::read_series(&path, &plan, &finished, (0, kind)).unwrap();
            let expected = read(&path.join(kind.table())).unwrap();
            assert!(whole == expected[0]);
            if let Some(part) = part {
                assert_eq!(part.rows.steps, [1000, 1001, 1002]);
            }
        }
    }
}

/// Executes the first run until a step after which its process is killed; returns the checkpoint of
/// a step before.
fn killed(
    plan: &Plan,
    path: &Path,
    mut checkpoint: Option<RunCheckpoint>,
    [checkpoint_at, killed_at]: [u64; 2],
) -> Option<Vec<u8>> {
    let is_resumed = checkpoint.is_some();
    let recording = SeriesRecording::of(path, 0, &mut checkpoint);
    assert_eq!(checkpoint.is_some(), is_resumed);
    let recorder = RunRecorder {
        trajectory: None,
        series: &recording,
    };
    let mut last = None;
    let ended = execute_run_from(
        plan,
        &plan.runs()[0],
        checkpoint,
        Some(&recorder),
        |current| {
            if current.steps() == checkpoint_at {
                current.pass_rows(&recorder);
                recording.sync();
                let mut checkpoint = current.checkpoint();
                checkpoint.hashes.rows = recording.hashes();
                last = Some(checkpoint.to_bytes());
            }
            current.steps() < killed_at
        },
    );
    assert!(ended.is_none() && !recording.has_failed());
    last
}

#[test]
fn a_run_that_is_killed_and_resumed_has_the_same_files() {
    let plan = plan(FILE);
    let directory = tempfile::tempdir().unwrap();
    let whole = directory.path().join("whole");
    drop(execute_in(&plan, &whole, "1"));
    assert!(names(&whole).contains(&"orders/run-000001.parquet".to_owned()));
    for (number, kills) in [
        // Before and after the first rows leave memory, which is after step 2730.
        &[[10, 10], [2000, 2100], [2731, 2800]][..],
        &[[2729, 2999], [2900, 2950]],
        &[[2999, 2999]],
        &[[1, 2999]],
    ]
    .into_iter()
    .enumerate()
    {
        let path = directory.path().join(number.to_string());
        let folder = Folder::open(&path, &plan).unwrap();
        let mut bytes: Option<Vec<u8>> = None;
        for &kill in kills {
            let checkpoint = bytes.and_then(|bytes| RunCheckpoint::from_bytes(&bytes));
            bytes = killed(&plan, &path, checkpoint, kill);
        }
        // A checkpoint has the rows that are not in the spool: 64 KiB of each series at most.
        let bytes = bytes.unwrap();
        assert!(bytes.len() < 140_000, "{} bytes", bytes.len());
        let checkpoint = RunCheckpoint::from_bytes(&bytes).unwrap();
        folder.checkpoints().write(0, &checkpoint).unwrap();
        drop(folder);
        drop(execute_in(&plan, &path, "1"));
        assert_same_files(&path, &whole);
    }
}

#[test]
fn short_series_of_a_resumed_run_stay_in_its_line() {
    let plan = plan(&FILE.replace("duration = 60", "duration = 20"));
    let directory = tempfile::tempdir().unwrap();
    let [whole, path] = ["whole", "resumed"].map(|name| directory.path().join(name));
    drop(execute_in(&plan, &whole, "1"));
    let folder = Folder::open(&path, &plan).unwrap();
    let bytes = killed(&plan, &path, None, [500, 700]).unwrap();
    let checkpoint = RunCheckpoint::from_bytes(&bytes).unwrap();
    folder.checkpoints().write(0, &checkpoint).unwrap();
    drop(folder);
    drop(execute_in(&plan, &path, "1"));
    assert!(!names(&path).iter().any(|name| name.contains('/')));
    assert_same_files(&path, &whole);
}

#[test]
fn a_checkpoint_without_its_rows_is_dropped() {
    let plan = plan(FILE);
    let directory = tempfile::tempdir().unwrap();
    let whole = directory.path().join("whole");
    drop(execute_in(&plan, &whole, "1"));
    for damage in ["removed", "cut", "flipped"] {
        let path = directory.path().join(damage);
        let folder = Folder::open(&path, &plan).unwrap();
        let bytes = killed(&plan, &path, None, [2900, 2950]).unwrap();
        let spool = path.join("series/run-000001.partial");
        assert!(spool.metadata().unwrap().len() >= 2900 * 24);
        match damage {
            "removed" => fs::remove_file(&spool).unwrap(),
            "cut" => fs::write(&spool, "short").unwrap(),
            _ => flip(&spool),
        }
        let checkpoint = RunCheckpoint::from_bytes(&bytes).unwrap();
        folder.checkpoints().write(0, &checkpoint).unwrap();
        drop(folder);
        drop(execute_in(&plan, &path, "1"));
        assert_same_files(&path, &whole);
    }
}

/// Flips a bit in the middle of a file.
fn flip(path: &Path) {
    let mut bytes = fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    fs::write(path, bytes).unwrap();
}

#[test]
fn a_spool_that_is_damaged_before_its_run_ends_is_an_error_that_names_it() {
    let plan = plan(FILE);
    let directory = tempfile::tempdir().unwrap();
    let recording = SeriesRecording::of(directory.path(), 0, &mut None);
    recording.add(SeriesKind::Order, &[0; 24 * 3000], 0);
    let spool = directory.path().join("orders/run-000001.partial");
    flip(&spool);
    let finished = recording.finish(&plan, &plan.runs()[0], true, None);
    let error = finished.unwrap_err().to_string();
    assert!(error.contains(spool.to_str().unwrap()), "{error}");
    assert!(error.contains("it is damaged"), "{error}");
}

/// Rewrites the results of a folder as an earlier version stored them: all series in the lines.
fn as_earlier(plan: &Plan, path: &Path) {
    let finished = Folder::read(path, plan).unwrap();
    let list = fs::read_to_string(path.join("runs.jsonl")).unwrap();
    let mut lines = list.lines();
    let mut text = format!("{}\n", lines.next().unwrap());
    for line in lines {
        let mut line: serde_json::Map<String, Value> = serde_json::from_str(line).unwrap();
        let index = plan.index(line["run"].as_str().unwrap()).unwrap();
        let read = |kind| Folder::read_series(path, plan, &finished, (index, kind)).unwrap();
        let [order, series] = SeriesKind::ALL.map(read);
        let order: Vec<f64> = order.measures[0].values.iter().flatten().copied().collect();
        let values: Vec<_> = series.measures.iter().map(|it| &it.values).collect();
        line.remove("files");
        line.insert("order".to_owned(), json!({"order": order}));
        let series = json!({"step": series.steps, "values": values});
        line.insert("series".to_owned(), series);
        text.push_str(&serde_json::to_string(&line).unwrap());
        text.push('\n');
    }
    fs::write(path.join("runs.jsonl"), text).unwrap();
    let folders = ["orders", "series"].map(|folder| path.join(folder));
    for folder in folders.iter().filter(|folder| folder.exists()) {
        fs::remove_dir_all(folder).unwrap();
    }
}

#[test]
fn long_lines_of_earlier_versions_move_to_files_once() {
    let plan = plan(FILE);
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name);
    drop(execute_in(&plan, &path("whole"), "1-2"));
    for state in ["moved", "killed after the files", "killed amid the list"] {
        let path = path(state);
        drop(execute_in(&plan, &path, "1-2"));
        let list = path.join("runs.jsonl");
        as_earlier(&plan, &path);
        let earlier = fs::read(&list).unwrap();
        assert!(earlier.len() > 200_000);
        match state {
            "killed after the files" => {
                drop(Folder::open(&path, &plan).unwrap());
                fs::write(&list, &earlier).unwrap();
            }
            "killed amid the list" => fs::write(path.join(".jostle-runs.jsonl-x"), "{").unwrap(),
            _ => {}
        }
        drop(Folder::open(&path, &plan).unwrap());
        assert_same_files(&path, &directory.path().join("whole"));
        // Nothing is left to move.
        let file = || std::os::unix::fs::MetadataExt::ino(&fs::metadata(&list).unwrap());
        let moved = file();
        drop(Folder::open(&path, &plan).unwrap());
        assert_eq!(file(), moved, "the list is replaced again");
    }
    // If a file cannot be written, the list is as it was, and is read.
    let path = path("failed");
    drop(execute_in(&plan, &path, "1-2"));
    as_earlier(&plan, &path);
    let earlier = fs::read(path.join("runs.jsonl")).unwrap();
    fs::write(path.join("series"), "not a folder").unwrap();
    let error = Folder::open(&path, &plan).unwrap_err();
    assert!(matches!(error, FolderError::Io { .. }), "{error}");
    assert!(fs::read(path.join("runs.jsonl")).unwrap() == earlier);
    assert_eq!(Folder::read(&path, &plan).unwrap().rows.len(), 2);
}

#[test]
fn parts_that_are_stored_either_way_merge_to_the_same_bytes() {
    let plan = plan(FILE);
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name);
    drop(execute_in(&plan, &path("whole"), "1-4"));
    drop((
        execute_in(&plan, &path("one"), "1,4"),
        execute_in(&plan, &path("two"), "2-3"),
    ));
    as_earlier(&plan, &path("two"));
    let parts = Parts::read(&[path("one"), path("two")]).unwrap();
    parts.verify(&Subset::all(&plan), 1, |_| ()).unwrap();
    drop(parts.write(&path("merged")).unwrap());
    // Runs that ended one after the other are in the order of the plan.
    assert_same_files(&path("merged"), &path("whole"));
}

#[test]
fn a_short_series_stays_in_a_line_of_an_earlier_version_from_which_a_long_one_moves() {
    // The measures have 31 rows.
    let plan = plan(&FILE.replace("series_every = 1", "series_every = 100"));
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name);
    for (name, runs) in [
        ("whole", "1-4"),
        ("one", "1,4"),
        ("two", "2-3"),
        ("new", "2-3"),
    ] {
        drop(execute_in(&plan, &path(name), runs));
    }
    assert!(names(&path("new")).contains(&"orders/run-000002.parquet".to_owned()));
    assert!(!path("new").join("series").exists());
    as_earlier(&plan, &path("two"));
    let parts = Parts::read(&[path("one"), path("two")]).unwrap();
    parts.verify(&Subset::all(&plan), 1, |_| ()).unwrap();
    drop(parts.write(&path("merged")).unwrap());
    assert_same_files(&path("merged"), &path("whole"));
    drop(Folder::open(&path("two"), &plan).unwrap());
    assert_same_files(&path("two"), &path("new"));
}

#[test]
fn long_lines_that_an_earlier_build_stored_move_with_equal_values() {
    let stored = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/stored/caac7bb/long");
    let directory = tempfile::tempdir().unwrap();
    for (path, bytes) in files(&stored) {
        fs::write(directory.path().join(path), bytes).unwrap();
    }
    let earlier = fs::metadata(stored.join("runs.jsonl")).unwrap().len();
    assert!(earlier > 200_000);
    let plan = Plan::of(crate::Files::stored(directory.path()).unwrap()).unwrap();
    let folder = Folder::open(directory.path(), &plan).unwrap();
    let list = fs::read(directory.path().join("runs.jsonl")).unwrap();
    assert!(list.len() < 2_000, "{} bytes", list.len());
    folder.write_tables(&plan).unwrap();
    for table in ["order.parquet", "series.parquet"] {
        let [earlier, now] = [&stored, directory.path()].map(|it| read(&it.join(table)).unwrap());
        assert_eq!(earlier[0].steps.len(), 2801);
        assert!(earlier == now, "{table}");
    }
    // The run is the same if it is executed now.
    let again = directory.path().join("again");
    drop(execute_in(&plan, &again, "1"));
    let file = "series/run-000001.parquet";
    let [moved, now] = [directory.path(), &again].map(|it| fs::read(it.join(file)).unwrap());
    assert!(moved == now);
}

/// Writes a file of a run again after a change, with its length in the line of the run.
fn change(path: &Path, name: &str, write: impl FnOnce(&Path)) {
    let file = path.join(name);
    let length = |file: &Path| format!("\"{name}\":{}", fs::metadata(file).unwrap().len());
    let before = length(&file);
    write(&file);
    let list = fs::read_to_string(path.join("runs.jsonl")).unwrap();
    assert!(list.contains(&before), "{list}");
    let list = list.replace(&before, &length(&file));
    fs::write(path.join("runs.jsonl"), list).unwrap();
}

#[test]
fn verify_finds_other_values_in_files_of_series_and_of_trajectories() {
    let plan = plan(&FILE.replace("[measure]", "[measure]\nrecord_every = 100"));
    let directory = tempfile::tempdir().unwrap();
    let parts = || Parts::read(&[directory.path().to_owned()]).unwrap();
    let verified = || parts().verify(&Subset::all(&plan), 1, |_| ());
    drop(execute_in(&plan, directory.path(), "1-4"));
    verified().unwrap();
    type Change<'a> = (&'a str, &'a dyn Fn(&Path));
    let changes: [Change<'_>; 3] = [
        ("orders/run-000001.parquet", &|file| {
            let mut series = read(file).unwrap().pop().unwrap();
            series.measures[0].values[2999] = Some(0.5);
            let mut writer = SeriesKind::Order.begin(file, &plan).unwrap();
            writer.append(&series).unwrap();
            writer.finish().unwrap();
        }),
        ("series/run-000002.parquet", &|file| {
            let mut series = read(file).unwrap().pop().unwrap();
            series.measures[1].values[17] = None;
            let mut writer = SeriesKind::Measures.begin(file, &plan).unwrap();
            writer.append(&series).unwrap();
            writer.finish().unwrap();
        }),
        ("trajectories/run-000003.parquet", &|file| {
            let about = jostle_results::table::trajectory::read_about(file).unwrap();
            let mut rows = jostle_results::table::trajectory::read(file).unwrap();
            rows.alpha[5] += 1e-12;
            let mut writer = jostle_results::table::TrajectoryWriter::begin(file, &about).unwrap();
            writer.append(&rows).unwrap();
            writer.finish().unwrap();
        }),
    ];
    for (number, (name, write)) in changes.into_iter().enumerate() {
        change(directory.path(), name, write);
        let error = verified().unwrap_err().to_string();
        let count = format!("{} of 4 runs have another result", number + 1);
        assert!(error.starts_with(&count), "{name}: {error}");
        assert!(error.contains("other measurements"), "{error}");
    }
}

/// Bytes of the files of the first run, and of its line in the list.
fn bytes_of_first(path: &Path) -> u64 {
    let list = fs::read_to_string(path.join("runs.jsonl")).unwrap();
    let files = ["orders", "series"].map(|it| path.join(it).join("run-000001.parquet"));
    let files = files.map(|file| fs::metadata(file).unwrap().len());
    list.lines().nth(1).unwrap().len() as u64 + 1 + files.into_iter().sum::<u64>()
}

#[test]
fn an_execution_counts_the_bytes_of_long_series_and_ends_before_the_disk_is_full() {
    let plan = plan(FILE);
    let directory = tempfile::tempdir().unwrap();
    let [path, undisturbed] = ["limited", "undisturbed"].map(|name| directory.path().join(name));
    drop(execute_in(&plan, &undisturbed, "1"));
    let execute_limited = |checks: u64| {
        let left = AtomicU64::new(checks);
        let control = ExecutionControl::with_disk(DiskWatch::new(1 << 14, move |_| {
            match left.fetch_sub(1, Ordering::Relaxed) {
                0 => Err("full".to_owned()),
                _ => Ok(()),
            }
        }));
        let execution = Execution {
            plan: &plan,
            subset: &Subset::parse(&plan, "1").unwrap(),
            threads: 1,
            checkpoint_every: Some(Duration::from_secs(3600)),
        };
        let mut folder = Folder::open(&path, &plan).unwrap();
        let ended = execute(execution, &mut folder, &control);
        (ended, control.disk().unwrap().grown())
    };
    // The second check is that of the first 64 KiB of a spool.
    let (ended, grown) = execute_limited(1);
    assert!(ended.unwrap_err().is_disk_full());
    let spools = ["orders", "series"].map(|it| path.join(it).join("run-000001.partial"));
    let lengths = spools
        .clone()
        .map(|it| fs::metadata(it).map_or(0, |it| it.len()));
    assert!(lengths[0] > MAX_INLINE, "{lengths:?}");
    assert_eq!(u64::try_from(grown).unwrap(), lengths[0] + lengths[1]);
    // Rows of a run without a checkpoint are of no use.
    let unused = spools[1].with_file_name("run-000003.partial");
    fs::create_dir_all(unused.parent().unwrap()).unwrap();
    fs::write(&unused, "rows").unwrap();
    let (ended, more) = execute_limited(1000);
    assert!(!ended.unwrap().is_cancelled);
    assert!(!unused.exists() && spools.iter().all(|it| !it.exists()));
    let bytes = bytes_of_first(&path);
    assert_eq!(u64::try_from(grown + more).unwrap(), bytes);
    assert_same_files(&path, &undisturbed);
}

#[test]
fn the_disk_need_counts_the_spools_of_as_many_runs_as_are_executed_at_a_time() {
    // Both measures have values.
    let long = plan(&FILE.replace("\"drift\"", "\"order\""));
    let need = |plan: &Plan, threads| DiskNeed::of(plan, &Subset::all(plan), threads).bytes;
    // 24 bytes a row; the last step may be no multiple of `series_every`.
    let spools = 24.0 * (3001.0 + 3002.0);
    assert_eq!(need(&long, 3) - need(&long, 1), 2.0 * spools);
    let short = plan(&FILE.replace("duration = 60", "duration = 50"));
    assert_eq!(need(&short, 3), need(&short, 1));
    let directory = tempfile::tempdir().unwrap();
    drop(execute_in(&long, directory.path(), "1-4"));
    let files = files(directory.path()).into_iter();
    let bytes = files.map(|(_, bytes)| bytes.len() as f64).sum::<f64>();
    let needed = need(&long, 1) - spools;
    assert!((0.95..1.5).contains(&(needed / bytes)), "{needed} {bytes}");
}
