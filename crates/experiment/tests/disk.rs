//! An execution whose disk space ends.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use jostle_experiment::{DiskWatch, Execution, ExecutionControl, Folder, Plan, Subset, execute};

/// The number of files in a folder whose names end so.
fn count(folder: &Path, ending: &str) -> usize {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let names = entries.map(|it| it.unwrap().file_name().into_string().unwrap());
    names.filter(|it| it.ends_with(ending)).count()
}

#[test]
fn an_execution_without_disk_space_stops_and_continues_to_the_same_files() {
    let text = "name = \"a\"\nreplicates = 3\nduration = 8\n[measure]\nrecord_every = \
                1\n[spec]\nn = 20\n";
    let plan = Plan::parse(text).unwrap();
    let execution = Execution {
        plan: &plan,
        subset: &Subset::all(&plan),
        threads: 1,
        checkpoint_every: Some(Duration::from_secs(3600)),
    };
    let names = ["results.csv", "results.parquet"].map(str::to_owned);
    let runs = (1..=3).map(|number| format!("trajectories/run-{number:06}.parquet"));
    let names: Vec<String> = names.into_iter().chain(runs).collect();
    let files = |folder: &Path| {
        let read = names
            .iter()
            .map(|name| fs::read(folder.join(name)).unwrap());
        read.collect::<Vec<_>>()
    };
    let whole = tempfile::tempdir().unwrap();
    let mut folder = Folder::open(whole.path(), &plan).unwrap();
    execute(execution, &mut folder, &ExecutionControl::new()).unwrap();
    // A run has 401 frames of 604 bytes, which are copied at its end: the space ends at the start,
    // amid a run, where its frames are copied, and amid later runs.
    for (kilobytes, kept) in [(0, 1), (50, 1), (300, 0), (550, 1), (1100, 1)] {
        let directory = tempfile::tempdir().unwrap();
        let mut folder = Folder::open(directory.path(), &plan).unwrap();
        let (written, limit) = (AtomicUsize::new(0), kilobytes * 1000 / 5000);
        let watch = DiskWatch::new(5000, move |_| {
            let checks = written.fetch_add(1, Ordering::Relaxed);
            match checks <= limit {
                true => Ok(()),
                false => Err("the space ends".to_owned()),
            }
        });
        let control = ExecutionControl::with_disk(watch);
        let error = execute(execution, &mut folder, &control).unwrap_err();
        assert!(error.is_disk_full(), "{kilobytes} kB: {error}");
        assert_eq!(error.to_string(), "the space ends");
        let found = [("trajectories", ".partial"), ("checkpoints", ".cbor")]
            .map(|(name, ending)| count(&directory.path().join(name), ending));
        assert_eq!(found, [kept, kept], "{kilobytes} kB");
        let outcome = execute(execution, &mut folder, &ExecutionControl::new()).unwrap();
        assert!(!outcome.is_cancelled);
        assert!(
            files(directory.path()) == files(whole.path()),
            "{kilobytes} kB"
        );
    }
}
