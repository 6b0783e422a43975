//! Tests of finished runs whose files are missing: they count as unfinished, keep their rows, and are
//! executed again with the same bytes.

use std::path::PathBuf;

use jostle_physics::model::MODEL_VERSION;

use super::*;
use crate::folder::fixture::Fixture;
use crate::folder::{Folder, FolderError, MissingFiles};
use crate::merge::{MergeError, Parts, missing};
use crate::subset::Subset;

const FILE: &str = "name = \"a\"\nduration = 1\nreplicates = 4\nspec = { n = 4 }\n\
                    measure = { record_every = 10, order_every = 10 }\n";

impl Fixture {
    fn missing(&self, name: &str) -> MissingFiles {
        Folder::missing_files(&self.path(name), &self.plan).unwrap()
    }
}

/// All files of a folder but the list, which has a second line of a run that was executed again, and
/// the lock.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for below in [folder.to_owned(), folder.join("trajectories")] {
        for entry in fs::read_dir(below).unwrap() {
            let path = entry.unwrap().path();
            if path.is_file() && !path.ends_with("runs.jsonl") && !path.ends_with("lock") {
                let name = path.strip_prefix(folder).unwrap().to_owned();
                found.insert(name, fs::read(path).unwrap());
            }
        }
    }
    found
}

/// Removes the file of run 2, and shortens that of run 3.
fn damage(folder: &Path) {
    fs::remove_file(folder.join(trajectory_file(1))).unwrap();
    let third = folder.join(trajectory_file(2));
    let bytes = fs::read(&third).unwrap();
    fs::write(third, &bytes[..bytes.len() - 1]).unwrap();
}

#[test]
fn runs_that_lack_files_are_executed_again_with_the_same_bytes() {
    let fixture = Fixture::new(FILE);
    let (path, runs) = (fixture.path("a"), |text: &str| {
        Subset::parse(&fixture.plan, text).unwrap()
    });
    let rows = fixture.execute("a", "1-4").rows();
    let whole = contents(&path);
    assert_eq!(
        whole.len(),
        4 + 4,
        "four trajectories, the file, three tables"
    );
    assert_eq!(fixture.missing("a").finished, 4);
    assert!(fixture.missing("a").runs.indices().is_empty());

    damage(&path);
    let found = fixture.missing("a");
    assert_eq!((found.finished, found.runs), (2, runs("2-3")));
    assert_eq!(found.model_version, MODEL_VERSION);
    let folder = Folder::open(&path, &fixture.plan).unwrap();
    assert_eq!((folder.finished(), folder.lacking()), (2, runs("2-3")));
    let finished = (0..4).map(|index| folder.is_finished(index));
    assert_eq!(finished.collect::<Vec<_>>(), [true, false, false, true]);
    assert_eq!(folder.rows(), rows, "a row needs no file");
    drop(folder);

    let folder = fixture.execute("a", "1-4");
    assert_eq!(
        (folder.finished(), folder.lacking()),
        (4, runs("1").and(&runs("2")))
    );
    drop(folder);
    assert!(contents(&path) == whole);
    // So is the reopened folder.
    let folder = Folder::open(&path, &fixture.plan).unwrap();
    assert_eq!((folder.finished(), folder.rows()), (4, rows));
}

#[test]
fn lines_of_earlier_versions_name_no_files_which_must_exist() {
    let fixture = Fixture::new(FILE);
    drop(fixture.execute("a", "1-2"));
    let path = fixture.path("a").join("runs.jsonl");
    let lines = fs::read_to_string(&path).unwrap();
    let lines = lines.lines().map(|line| {
        let mut line: serde_json::Value = serde_json::from_str(line).unwrap();
        let object = line.as_object_mut().unwrap();
        assert!(object.remove("files").is_some() || object.contains_key("model_version"));
        format!("{line}\n")
    });
    fs::write(&path, lines.collect::<String>()).unwrap();
    assert_eq!(fixture.missing("a").finished, 2);
    fs::remove_file(fixture.path("a").join(trajectory_file(0))).unwrap();
    let found = fixture.missing("a");
    assert_eq!((found.finished, found.runs), (1, Subset::of(vec![0])));
}

#[test]
fn a_run_that_ended_before_its_first_step_has_no_file_by_design() {
    let full =
        "[[at]]\nstep = 0\ninject = { count = 40, within = { x = 0, y = 0, radius = 0.5 } }\n";
    let fixture = Fixture::new(&format!("{FILE}{full}"));
    let folder = fixture.execute("a", "1-4");
    assert_eq!((folder.finished(), folder.rows().len()), (4, 0));
    assert!(!fixture.path("a").join(trajectory_file(0)).exists());
    assert!(folder.lacking().indices().is_empty());
    assert!(fixture.missing("a").runs.indices().is_empty());
}

#[test]
fn merge_names_runs_that_lack_files_and_they_can_be_planned_as_new_parts() {
    let fixture = Fixture::new(FILE);
    drop((fixture.execute("one", "1,2,3"), fixture.execute("two", "4")));
    let parts = ["one", "two"].map(|name| fixture.path(name));
    damage(&parts[0]);
    let error = Parts::read(&parts).map(drop).unwrap_err();
    let is_named =
        matches!(&error, MergeError::MissingFiles { runs, of: 4 } if runs.to_string() == "2,3");
    assert!(is_named, "{error}");
    let planned = missing(&fixture.plan, &parts).unwrap();
    assert_eq!(planned.to_string(), "2,3");
    // A part with these runs alone completes the others.
    drop(fixture.execute("three", "2-3"));
    let all = [parts[0].clone(), parts[1].clone(), fixture.path("three")];
    Parts::read(&all)
        .unwrap()
        .write(&fixture.path("merged"))
        .unwrap();
    drop(fixture.execute("whole", "1-4"));
    assert!(contents(&fixture.path("merged")) == contents(&fixture.path("whole")));
    // The merged lines name the files.
    fs::remove_file(fixture.path("merged").join(trajectory_file(3))).unwrap();
    assert_eq!(fixture.missing("merged").runs.to_string(), "4");
}

#[test]
fn runs_of_another_version_of_the_model_are_read_and_not_executed() {
    let fixture = Fixture::new(FILE);
    let rows = fixture.execute("a", "1-4").rows();
    let version = |version: u32| format!("\"model_version\":{version}");
    let theirs = MODEL_VERSION + 1;
    fixture.edit("a", &version(MODEL_VERSION), &version(theirs));
    damage(&fixture.path("a"));
    let found = fixture.missing("a");
    assert_eq!((found.finished, found.model_version), (2, theirs));
    let read = Folder::read(&fixture.path("a"), &fixture.plan).unwrap();
    assert_eq!((read.rows, read.model_version), (rows, theirs));
    let error = Folder::open(&fixture.path("a"), &fixture.plan).unwrap_err();
    assert!(matches!(error, FolderError::OtherModel { .. }), "{error}");
}

#[test]
fn a_line_cannot_name_files_of_other_folders() {
    for name in ["../a", "/etc/passwd", "trajectories/../../a", ""] {
        let fixture = Fixture::new(FILE);
        drop(fixture.execute("a", "1"));
        fixture.edit("a", &trajectory_file(0), name);
        let error = Folder::missing_files(&fixture.path("a"), &fixture.plan).unwrap_err();
        assert!(
            matches!(error, FolderError::Damaged { line: 2, .. }),
            "{error}"
        );
    }
}
