//! Tests of trajectories: their rows, resumed and killed runs, faults, merges and limits.

use jostle_results::table::Trajectory;
use jostle_results::table::trajectory::{read, read_about};

use super::*;
use crate::execute::RunRecorder;
use crate::execute::{Execution, execute};
use crate::folder::Folder;
use crate::merge::Parts;
use crate::progress::ExecutionControl;
use crate::run::{CurrentRun, execute_run, execute_run_from};
use crate::series::SeriesRecording;
use crate::subset::Subset;

/// 50 steps, with individuals that enter at step 12 and leave at step 25.
const FILE: &str = "name = \"a\"\nduration = 1\nreplicates = 2\nspec = { n = 4, noise = 0.1 }\n\
                    [[grid]]\npi1 = [1, 4]\nshare = 0.5\n[measure]\nrecord_every = 10\n\
                    [[at]]\nstep = 12\ninject = { count = 3, direction = 1 }\n\
                    [[at]]\nstep = 25\nremove = { select = { fraction = \"$share\" } }\n";

fn plan(text: &str) -> Plan {
    Plan::parse(text).unwrap()
}

fn execute_in(plan: &Plan, path: &Path, runs: &str, threads: usize) -> Folder {
    let mut folder = Folder::open(path, plan).unwrap();
    let execution = Execution {
        plan,
        subset: &Subset::parse(plan, runs).unwrap(),
        threads,
        checkpoint_every: None,
    };
    execute(execution, &mut folder, &ExecutionControl::new()).unwrap();
    folder
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder.join(TRAJECTORIES)).unwrap();
    let names = entries.map(|it| it.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.collect();
    names.sort();
    names
}

/// The states of a run before the steps that are recorded, by the library itself.
fn expected(plan: &Plan, index: usize) -> Vec<(u64, usize)> {
    let finished = execute_run(plan, &plan.runs()[index], |_| true).unwrap();
    let last = finished.row.unwrap().steps;
    let n = |step| {
        if step < 12 {
            4
        } else if step < 25 {
            7
        } else {
            3
        }
    };
    let steps = (0..last).step_by(10).chain([last]);
    steps.map(|step| (step, n(step))).collect()
}

/// The steps of a trajectory, each with its number of individuals.
fn frames(rows: &Trajectory) -> Vec<(u64, usize)> {
    let mut frames: Vec<(u64, usize)> = Vec::new();
    for &step in &rows.step {
        match frames.last_mut() {
            Some((last, n)) if *last == step => *n += 1,
            _ => frames.push((step, 1)),
        }
    }
    frames
}

#[test]
fn every_run_has_a_file_with_all_individuals_of_each_recorded_step() {
    let plan = plan(FILE);
    let directory = tempfile::tempdir().unwrap();
    execute_in(&plan, directory.path(), "1-4", 2);
    let expected_names = [1, 2, 3, 4].map(|number| format!("run-{number:06}.parquet"));
    assert_eq!(names(directory.path()), expected_names);
    for index in 0..4 {
        let path = Folder::trajectory_path(directory.path(), index);
        let rows = read(&path).unwrap();
        // Half of 7 individuals is 4, rounded up, or 3.
        let found = frames(&rows);
        assert_eq!(found[..3], expected(&plan, index)[..3], "{index}");
        let steps: Vec<u64> = found.iter().map(|(step, _)| *step).collect();
        assert_eq!(steps, [0, 10, 20, 30, 40, 50]);
        assert!(
            found[3..]
                .iter()
                .all(|(_, n)| *n == found[3].1 && (3..5).contains(n))
        );
        assert_eq!(rows.time[4], 0.2);
        // The injected ones are informed and have new ids.
        assert_eq!(rows.id[8..15], [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(
            rows.informed[8..15],
            [false, false, false, false, true, true, true]
        );
        // The first frame is the start of the run.
        let state = crate::run::start(&plan, &plan.runs()[index]).unwrap();
        assert_eq!(rows.x[..4], state.configuration.x);
        assert_eq!(rows.alpha[..4], state.configuration.alpha);
    }
}

#[test]
fn the_metadata_has_the_spec_the_seed_the_variables_and_the_units() {
    let plan = plan(FILE);
    let directory = tempfile::tempdir().unwrap();
    execute_in(&plan, directory.path(), "3", 1);
    let about = read_about(&Folder::trajectory_path(directory.path(), 2)).unwrap();
    let run = &plan.runs()[2];
    let json = |key: &str| serde_json::from_str::<serde_json::Value>(&about[key]).unwrap();
    assert_eq!((&*about["run"], &*about["experiment"]), (&*run.name, "a"));
    assert_eq!(about["seed"], run.seed.to_string());
    let spec = json("spec");
    assert_eq!(
        (&spec["n"], &spec["pi1"], &spec["noise"]),
        (&4.into(), &4.0.into(), &0.1.into())
    );
    assert_eq!(spec["seed"], run.seed);
    assert_eq!(
        json("variables"),
        serde_json::json!({"pi1": 4, "share": 0.5})
    );
    assert_eq!(about["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(
        (json("units")["alpha"].clone(), &*about["every"]),
        ("radians".into(), "10")
    );
}

/// Executes a run with its recording, until a step after which it is killed; returns the checkpoint.
fn killed(
    plan: &Plan,
    files: &Trajectories,
    mut checkpoint: Option<RunCheckpoint>,
    [checkpoint_at, killed_at]: [u64; 2],
) -> Option<RunCheckpoint> {
    let recording = files.record(plan, 0, &mut checkpoint).unwrap().unwrap();
    let mut last = None;
    let on_step = |current: &mut CurrentRun| {
        if current.steps() == checkpoint_at {
            let mut checkpoint = current.checkpoint();
            checkpoint.recorded = recording.sync();
            checkpoint.hashes.frames = Some(recording.hash());
            last = RunCheckpoint::from_bytes(&checkpoint.to_bytes());
        }
        current.steps() < killed_at
    };
    let recorder = RunRecorder {
        trajectory: Some(&recording),
        series: &SeriesRecording::of(&files.0, 0, &mut None),
    };
    let ended = execute_run_from(plan, &plan.runs()[0], checkpoint, Some(&recorder), on_step);
    match ended {
        None => {
            // What was written after the checkpoint may be on disk or not.
            recording.sync();
            last
        }
        Some(ended) => {
            recording
                .finish(plan, &plan.runs()[0], ended.row.is_some(), None)
                .unwrap();
            None
        }
    }
}

#[test]
fn a_run_that_is_killed_and_resumed_has_the_same_file() {
    let plan = plan(FILE);
    let directory = tempfile::tempdir().unwrap();
    execute_in(&plan, &directory.path().join("whole"), "1", 1);
    let whole = Folder::trajectory_path(&directory.path().join("whole"), 0);
    let whole = fs::read(whole).unwrap();
    for (number, kills) in [
        &[[10, 10], [20, 35], [49, 50]][..],
        &[[11, 39], [12, 30]],
        &[[50, 50]],
        &[[99, 30]],
    ]
    .iter()
    .enumerate()
    {
        let files = Trajectories::of(&directory.path().join(number.to_string()));
        let mut checkpoint = None;
        for &kill in *kills {
            checkpoint = killed(&plan, &files, checkpoint, kill);
        }
        assert!(killed(&plan, &files, checkpoint, [99, 99]).is_none());
        assert!(fs::read(files.path(0)).unwrap() == whole, "{kills:?}");
        files.remove_spool(0);
        assert_eq!(fs::read_dir(&files.0).unwrap().count(), 1);
    }
}

#[test]
fn a_checkpoint_without_its_frames_is_dropped() {
    let plan = plan(FILE);
    let directory = tempfile::tempdir().unwrap();
    let files = Trajectories::of(directory.path());
    for damage in ["remove", "cut", "flip"] {
        let checkpoint = killed(&plan, &files, None, [30, 30]);
        assert!(checkpoint.as_ref().is_some_and(|it| it.recorded > Some(0)));
        match damage {
            "remove" => files.remove_spool(0),
            "cut" => fs::write(files.spool(0), "short").unwrap(),
            _ => {
                let mut bytes = fs::read(files.spool(0)).unwrap();
                bytes[100] ^= 4;
                fs::write(files.spool(0), bytes).unwrap();
            }
        }
        let mut checkpoint = checkpoint;
        files.record(&plan, 0, &mut checkpoint).unwrap().unwrap();
        assert!(checkpoint.is_none(), "{damage}");
    }
    killed(&plan, &files, None, [99, 99]);
    let steps: Vec<u64> = frames(&read(&files.path(0)).unwrap())
        .iter()
        .map(|it| it.0)
        .collect();
    assert_eq!(steps, [0, 10, 20, 30, 40, 50]);
}

#[test]
fn a_faulted_run_has_its_frames_until_the_fault_and_one_without_a_row_has_no_file() {
    let directory = tempfile::tempdir().unwrap();
    // There is no room for the injection.
    let full = "inject = { count = 40, within = { x = 0, y = 0, radius = 0.5 } }\n";
    for (step, expected) in [
        (25, Some(vec![0, 10, 20, 25])),
        (20, Some(vec![0, 10, 20])),
        (0, None),
    ] {
        let text = format!(
            "name = \"a\"\nduration = 1\nspec = {{ n = 4 }}\nmeasure = {{ record_every = 10 }}\n\
             [[at]]\nstep = {step}\n{full}"
        );
        let plan = plan(&text);
        let path = directory.path().join(step.to_string());
        let folder = execute_in(&plan, &path, "1", 1);
        assert_eq!(folder.faults(&Subset::all(&plan)).len(), 1);
        match expected {
            None => assert_eq!(names(&path), [""; 0]),
            Some(expected) => {
                let rows = read(&Folder::trajectory_path(&path, 0)).unwrap();
                let steps: Vec<u64> = frames(&rows).iter().map(|it| it.0).collect();
                assert_eq!(steps, expected);
                let [row] = &folder.rows()[..] else { panic!() };
                let fault = row.fault.as_ref().unwrap();
                assert!(
                    fault.starts_with(&format!("step {step}: [[at]]")),
                    "{fault}"
                );
            }
        }
    }
}

#[test]
fn merged_parts_have_all_trajectories() {
    let plan = plan(FILE);
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name);
    execute_in(&plan, &path("whole"), "1-4", 1);
    drop((
        execute_in(&plan, &path("one"), "1,4", 1),
        execute_in(&plan, &path("two"), "2-3", 1),
    ));
    let parts = Parts::read(&[path("one"), path("two")]).unwrap();
    parts.write(&path("merged")).unwrap();
    assert_eq!(names(&path("merged")), names(&path("whole")));
    for index in 0..4 {
        let [merged, whole] = ["merged", "whole"]
            .map(|name| fs::read(Folder::trajectory_path(&path(name), index)).unwrap());
        assert!(merged == whole, "{index}");
    }
    // A part that lost one is named.
    fs::remove_file(Folder::trajectory_path(&path("two"), 2)).unwrap();
    let error = parts.write(&path("again")).unwrap_err().to_string();
    assert!(
        error.contains("two/trajectories/run-000003.parquet"),
        "{error}"
    );
    assert!(!path("again").exists());
}

#[test]
fn too_many_rows_and_invalid_intervals_are_rejected_before_the_start() {
    let reject = |measure: &str, rest: &str| {
        let text = format!("name = \"a\"\nduration = 1e6\nmeasure = {{ {measure} }}\n{rest}");
        Plan::parse(&text).unwrap_err().to_string()
    };
    let error = reject("record_every = 1", "spec = { n = 100 }\n");
    // 50 million frames of 100 individuals.
    assert!(
        error.contains("up to 5000000200 rows, 136.0 GB; the limit is 100 GB"),
        "{error}"
    );
    assert!(error.contains("raise record_every"), "{error}");
    let inject = "[[at]]\nfrom = 0\nuntil = 9e5\nevery = 1e5\ninject = { count = 9 }\n";
    let error = reject(
        "record_every = 1",
        &format!("spec = {{ n = 10 }}\n{inject}"),
    );
    assert!(error.contains("up to 5000000200 rows"), "{error}");
    for (every, expected) in [
        ("0", "record_every = 0 is outside [1, "),
        ("1e9", "record_every"),
        ("-1", "record_every"),
        ("2000000000", "record_every = 2000000000 is outside"),
    ] {
        let error = reject(&format!("record_every = {every}"), "");
        assert!(
            error.contains(expected) || error.contains("whole number"),
            "{error}"
        );
    }
}

#[test]
fn results_of_a_plan_without_trajectories_have_no_folder_of_them() {
    let plan = plan(&FILE.replace("record_every = 10", "order_every = 10"));
    let directory = tempfile::tempdir().unwrap();
    execute_in(&plan, directory.path(), "1", 1);
    assert!(!directory.path().join(TRAJECTORIES).exists());
    let none = Trajectories::of(directory.path()).record(&plan, 0, &mut None);
    assert!(none.unwrap().is_none());
}
