//! Tests of folders whose runs another version of the model executed: runs of two versions are never in one
//! table.

use std::fs;

use super::fixture::Fixture;
use super::*;
use crate::merge::{MergeError, Parts, missing};
use crate::run::execute_run_from;

const FILE: &str = "name = \"a\"\nduration = 1\nreplicates = 4\nspec = { n = 4 }\n\
                    measure = { record_every = 10, order_every = 10 }\n";

/// The version of the model that is said to have executed runs.
const EARLIER: u32 = 1;

impl Fixture {
    /// Executes runs in a folder that is then one of the earlier version.
    fn execute_earlier(&self, name: &str, runs: &str) {
        drop(self.execute(name, runs));
        self.age(name);
    }

    fn age(&self, name: &str) {
        let version = |number: u32| format!("\"model_version\":{number}");
        self.edit(name, &version(MODEL_VERSION), &version(EARLIER));
    }
}

#[test]
fn an_experiment_without_a_finished_run_starts_over_and_uses_no_checkpoint_of_the_other_version() {
    let fixture = Fixture::new(FILE);
    let expected = fixture.execute("expected", "1-4").rows();
    let path = fixture.path("a");
    let folder = Folder::open(&path, &fixture.plan).unwrap();
    let run = &fixture.plan.runs()[0];
    execute_run_from(&fixture.plan, run, None, None, |current| {
        folder
            .checkpoints()
            .write(0, &current.checkpoint())
            .unwrap();
        current.steps() < 3
    });
    drop(folder);
    fixture.age("a");
    assert_eq!(Folder::model_version(&path), Some(EARLIER));
    let folder = Folder::open(&path, &fixture.plan).unwrap();
    assert!(!folder.checkpoints().has(0));
    drop(folder);
    assert_eq!(Folder::model_version(&path), Some(MODEL_VERSION));
    assert_eq!(fixture.execute("a", "1-4").rows(), expected);
    assert_eq!(fixture.list("a"), fixture.list("expected"));
}

#[test]
fn no_run_is_added_to_finished_ones_of_another_version_which_remain_readable() {
    let fixture = Fixture::new(FILE);
    fixture.execute_earlier("a", "1-2");
    let (path, before) = (fixture.path("a"), fixture.list("a"));
    let error = Folder::open(&path, &fixture.plan).unwrap_err();
    let FolderError::OtherModel { theirs, .. } = error else {
        panic!("{error}");
    };
    assert_eq!(theirs, EARLIER);
    assert_eq!(fixture.list("a"), before);
    let read = Folder::read(&path, &fixture.plan).unwrap();
    assert_eq!((read.rows.len(), read.model_version), (2, EARLIER));
}

#[test]
fn parts_of_one_earlier_version_are_merged_and_keep_it() {
    let fixture = Fixture::new(FILE);
    let whole = fixture.execute("whole", "1-4").rows();
    let parts = ["one", "two"].map(|name| fixture.path(name));
    fixture.execute_earlier("one", "1-2");
    fixture.execute_earlier("two", "3-4");
    let read = Parts::read(&parts).unwrap();
    let all = Subset::parse(&fixture.plan, "1-4").unwrap();
    let error = read.verify(&all, 1, |_| ()).unwrap_err();
    assert!(
        matches!(error, MergeError::Unverifiable { theirs: EARLIER }),
        "{error}"
    );
    let merged = read.write(&fixture.path("merged")).unwrap();
    assert_eq!(merged.rows(), whole);
    drop(merged);
    assert_eq!(
        Folder::model_version(&fixture.path("merged")),
        Some(EARLIER)
    );
    assert!(Folder::open(&fixture.path("merged"), &fixture.plan).is_err());
    let csv = |name: &str| fs::read(fixture.path(name).join(CSV_NAME)).unwrap();
    assert_eq!(csv("merged"), csv("whole"));
}

#[test]
fn parts_of_two_versions_are_not_merged_and_missing_runs_not_planned() {
    let fixture = Fixture::new(FILE);
    fixture.execute_earlier("one", "1-2");
    drop(fixture.execute("two", "3-4"));
    let parts = ["one", "two"].map(|name| fixture.path(name));
    let error = Parts::read(&parts).map(drop).unwrap_err();
    assert!(matches!(error, MergeError::OtherModel { .. }), "{error}");
    assert_eq!(error.other_model(), Some(EARLIER));
    for part in &parts {
        let path = part.display().to_string();
        assert!(error.to_string().contains(&path), "{error}");
    }
    let error = Parts::read(&parts[..1]).map(drop).unwrap_err();
    assert!(
        matches!(
            error,
            MergeError::Unfinishable {
                theirs: EARLIER,
                ..
            }
        ),
        "{error}"
    );
    assert_eq!(error.other_model(), Some(EARLIER));
    let error = missing(&fixture.plan, &parts).unwrap_err();
    assert_eq!(error.other_model(), Some(EARLIER), "{error}");
    // A part that has only begun is of no version.
    drop(Folder::open(&fixture.path("three"), &fixture.plan).unwrap());
    fixture.age("three");
    drop(fixture.execute("one-again", "1-2"));
    let parts = ["one-again", "two", "three"].map(|name| fixture.path(name));
    assert_eq!(Parts::read(&parts).unwrap().plan().runs().len(), 4);
    assert!(missing(&fixture.plan, &parts).unwrap().indices().is_empty());
}
