//! Tests of the definitions of measures: an experiment goes on under those with which it began.

use std::fs;

use jostle_results::Measure;

use super::fixture::Fixture;
use super::*;
use crate::merge::{MergeError, Parts};
use crate::run::{RunCheckpoint, execute_run, execute_run_from};

/// Two individuals that disagree by π, but for a rounding of it.
const FILE: &str = "name = \"conflict\"\nduration = 1\nreplicates = 4\nspec = { n = 6 }\n\
                    measure = { columns = [\"front\"], every = 10, order_every = 10 }\n[[at]]\nstep = 0\n\
                    inform = [{ select = { ids = [0] }, direction = 0 }, { select = { ids = [1] }, \
                    direction = 3.1416 }]\n[stop]\nwhen = \"drift > -2 for 0.5\"\n";

impl Fixture {
    /// Makes the header that of an earlier or later version.
    fn set_definitions(&self, name: &str, number: Option<u32>) {
        let theirs = number.map_or_else(String::new, |it| format!(",\"definitions\":{it}"));
        self.edit(name, ",\"definitions\":2", &theirs);
    }
}

/// Whether the drift of each run was defined: its mean, a measure along the direction, a condition.
fn is_defined(folder: &Folder) -> Vec<[bool; 3]> {
    let rows = folder.rows();
    let defined = rows.iter().map(|row| {
        [
            row.optional_number(Measure::V_PD).is_some(),
            row.extra("front").is_some(),
            row.extra("stopped_at").is_some(),
        ]
    });
    defined.collect()
}

#[test]
fn an_experiment_goes_on_under_the_definitions_with_which_it_began() {
    let fixture = Fixture::new(FILE);
    let folder = fixture.execute("new", "1");
    assert_eq!(folder.definitions(), Definitions::Second);
    assert_eq!(is_defined(&folder), [[false; 3]]);
    drop(folder);

    fs::create_dir(fixture.path("old")).unwrap();
    drop(Folder::open(&fixture.path("old"), &fixture.plan).unwrap());
    fixture.set_definitions("old", None);
    drop(fixture.execute("old", "1-2"));
    let folder = fixture.execute("old", "1-4");
    assert_eq!(folder.definitions(), Definitions::First);
    assert_eq!(is_defined(&folder), [[true; 3]; 4]);
    let order = fs::read_to_string(fixture.path("old").join(RUNS)).unwrap();
    assert!(!order.contains("\"drift\":[null"), "{order}");
    drop(folder);

    // Of a later version: it is read, and no run is added.
    fixture.set_definitions("new", Some(3));
    let error = Folder::open(&fixture.path("new"), &fixture.plan).unwrap_err();
    assert!(
        matches!(error, FolderError::OtherDefinitions { theirs: 3, .. }),
        "{error}"
    );
    assert_eq!(
        Folder::read(&fixture.path("new"), &fixture.plan)
            .unwrap()
            .rows
            .len(),
        1
    );
}

#[test]
fn parts_of_the_same_definitions_are_merged_and_verified_under_them() {
    let fixture = Fixture::new(FILE);
    let parts = ["one", "other"].map(|name| fixture.path(name));
    for (name, runs) in [("one", "1-2"), ("other", "3-4")] {
        drop(Folder::open(&fixture.path(name), &fixture.plan).unwrap());
        fixture.set_definitions(name, None);
        drop(fixture.execute(name, runs));
    }
    let read = Parts::read(&parts).unwrap();
    let all = Subset::parse(&fixture.plan, "1-4").unwrap();
    read.verify(&all, 1, |_| ()).unwrap();
    let merged = read.write(&fixture.path("merged")).unwrap();
    assert_eq!(merged.definitions(), Definitions::First);
    assert_eq!(is_defined(&merged), [[true; 3]; 4]);
    drop(merged);
    let reopened = Folder::open(&fixture.path("merged"), &fixture.plan).unwrap();
    assert_eq!(reopened.definitions(), Definitions::First);

    fs::remove_dir_all(&parts[1]).unwrap();
    drop(fixture.execute("other", "3-4"));
    let Err(error) = Parts::read(&parts) else {
        panic!("definitions are mixed");
    };
    assert!(
        matches!(&error, MergeError::OtherDefinitions { others, .. } if *others == parts[1..]),
        "{error}"
    );
}

#[test]
fn a_run_goes_on_from_its_checkpoint_under_the_definitions_with_which_it_began() {
    let mut plan = Plan::parse(FILE).unwrap();
    for definitions in [Definitions::First, Definitions::Second] {
        plan.definitions = definitions;
        let run = &plan.runs()[0];
        let expected = execute_run(&plan, run, |_| true).unwrap();
        let row = expected.row.as_ref().unwrap();
        let is_first = definitions == Definitions::First;
        assert_eq!(row.extra("stopped_at").is_some(), is_first);
        for kept in [1, row.steps - 1] {
            let mut bytes = Vec::new();
            execute_run_from(&plan, run, None, None, |current| {
                bytes = current.checkpoint().to_bytes();
                current.steps() < kept
            });
            let checkpoint = RunCheckpoint::from_bytes(&bytes).unwrap();
            let finished = execute_run_from(&plan, run, Some(checkpoint), None, |_| true);
            assert_eq!(finished.unwrap(), expected, "{definitions:?} {kept}");
        }
    }
}
