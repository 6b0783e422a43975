use std::fs;

use super::*;
use crate::{
    Execution, ExecutionControl, Files, Folder, FolderError, MergeError, Parts, Plan, Subset,
    execute, missing,
};

const TOML: &str = "name = \"a\"\nseed = 7\nduration = 10\npoints = \"samples.csv\"\n[spec]\nn = \
                    20\n[[at]]\ntime = 1\ninform = { select = { count = \"$k\" }, direction = 0 }\n";

fn plan_of(toml: &str, csv: &str) -> Result<Plan, PlanError> {
    Plan::of(Files {
        points: Some(csv.to_owned()),
        ..Files::from(toml)
    })
}

fn error(csv: &str) -> String {
    plan_of(TOML, csv).unwrap_err().to_string()
}

#[test]
fn a_row_is_a_condition_and_its_runs_are_those_of_a_grid() {
    // A byte order mark, spaces, blank lines, quotes, and line breaks of Windows.
    let csv = "\u{feff}k, pi1 ,contacts,attraction\r\n3,2,endpoints,\"{ kind = \"\"metric\"\", \
               radius = 5 }\"\r\n\r\n5.0,1.5,\"closest\",\"{ kind = \"\"all\"\" }\"\r\n";
    let plan = plan_of(TOML, csv).unwrap();
    let names: Vec<&str> = plan.runs().iter().map(|it| it.name.as_str()).collect();
    assert_eq!(
        names,
        [
            "pi1=2 contacts=endpoints attraction=metric:5 k=3 #0",
            "pi1=1.5 contacts=closest attraction=all k=5 #0"
        ]
    );
    let grid =
        "[[grid]]\nk = 5\npi1 = 1.5\ncontacts = \"closest\"\nattraction = { kind = \"all\" }\n";
    let toml = TOML.replace("points = \"samples.csv\"\n", "");
    let same = Plan::parse(&format!("{toml}{grid}")).unwrap();
    let (row, cell) = (&plan.runs()[1], &same.runs()[0]);
    assert_eq!((&row.name, row.seed), (&cell.name, cell.seed));
    assert_eq!(plan.point(row).spec, same.point(cell).spec);
    assert_eq!(plan.point(row).variables, same.point(cell).variables);
}

/// A text that no error may contain.
const SECRET: &str = "root:x:0:0:root";

#[test]
fn errors_do_not_repeat_the_content_of_a_file_outside_the_folder() {
    let grid = TOML.replace("[[at]]", "pi3 = 1\n[[at]]");
    for name in ["/etc/passwd", "../samples.csv", "a/../samples.csv"] {
        let toml = grid.replace("samples.csv", name);
        for csv in [
            SECRET.to_owned(),
            format!("k\n{SECRET}\n"),
            format!("{SECRET},{SECRET}\n1,2\n"),
            format!("k,contacts\n1,{SECRET}\n"),
            format!("k,attraction\n1,\"{{ {SECRET} }}\"\n"),
        ] {
            let error = plan_of(&toml, &csv).unwrap_err().to_string();
            assert!(!error.contains("root"), "{name} {csv:?}: {error}");
            assert!(error.contains("copy it there"), "{name} {csv:?}: {error}");
            assert!(error.contains(name) && error.contains("line "), "{error}");
        }
        let toml =
            format!("name = \"a\"\nduration = 1\nspec = {{ n = 5 }}\nsetpoints = {name:?}\n");
        for csv in [
            SECRET.to_owned(),
            format!("step,id,direction\n0,{SECRET},1\n"),
        ] {
            let files = Files {
                setpoints: Some(csv),
                ..Files::from(toml.as_str())
            };
            let error = Plan::of(files).unwrap_err().to_string();
            assert!(!error.contains("root"), "{name}: {error}");
            assert!(error.contains("copy it there"), "{name}: {error}");
        }
        let toml = format!("name = \"a\"\nduration = 1\nstart = {name:?}\n");
        let files = Files {
            start: Some(SECRET.into()),
            ..Files::from(toml.as_str())
        };
        let error = Plan::of(files).unwrap_err().to_string();
        assert!(!error.contains("root"), "{name}: {error}");
        assert!(error.contains("copy it there"), "{name}: {error}");
    }
    // Within the folder the reason says what is wrong.
    let inside = error(&format!("k,{SECRET}\n1,2\n"));
    assert!(inside.contains(SECRET), "{inside}");
}

#[test]
fn a_file_outside_the_folder_has_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.toml");
    let warnings = |toml: &str| Files::from(toml).warnings(&path);
    for (field, name) in [
        ("points", "/etc/hosts"),
        ("points", "../a.csv"),
        ("start", "../a.snapshot"),
        ("setpoints", "a/../../b.csv"),
    ] {
        let all = warnings(&format!("name = \"a\"\n{field} = {name:?}\n"));
        assert_eq!(all.len(), 1, "{all:?}");
        let expected = format!("{field} = {name:?} is outside the folder of the experiment");
        assert!(all[0].starts_with(&expected), "{all:?}");
    }
    for toml in [
        "points = \"samples.csv\"",
        "points = \"data/samples..csv\"",
        "setpoints = \"\"\"\nstep,id,direction\n../0,0,1\n\"\"\"",
        "points = 3",
    ] {
        assert_eq!(warnings(toml), [""; 0], "{toml}");
    }
    // A folder of results has a copy, which is read.
    let stored = folder.path().join("experiment.toml");
    let files = Files::from("points = \"/etc/hosts\"");
    assert_eq!(files.warnings(&stored).len(), 1);
    fs::write(folder.path().join(crate::POINTS), "k\n1\n").unwrap();
    assert_eq!(files.warnings(&stored), [""; 0]);
}

#[test]
fn a_cell_that_is_wrong_is_named_with_its_place() {
    for (csv, place, part) in [
        ("", (1, 1), "no condition"),
        ("k,pi1\n", (2, 1), "no condition"),
        ("k,pi1\n3\n", (2, 2), "1 cell, but the header has 2 columns"),
        ("k,pi1\n3,2\n\n3,2,1\n", (4, 3), "3 cells"),
        ("k,pi1\n3,\n", (2, 2), "empty"),
        ("k,pi1\n\n\n3,2\n,2\n", (5, 1), "empty"),
        ("k,pi1\n3,NaN\n", (2, 2), "not a finite number"),
        ("k,pi1\n3,1e999\n", (2, 2), "not a finite number"),
        ("k,pi1\n3,-inf\n", (2, 2), "not a finite number"),
        ("k,pi1\n3,wide\n", (2, 2), "give a number"),
        ("k,pi1\nmany,2\n", (2, 1), "a variable is a number"),
        ("k,pi1,k\n3,2,3\n", (1, 3), "duplicate column \"k\""),
        (",k,pi1\n0,3,2\n", (1, 1), "no name"),
        ("k;pi1\n3;2\n", (1, 1), "separate them by commas"),
        ("k,pi5\n3,2\n", (1, 2), "unknown column \"pi5\""),
        ("k,seed\n3,2\n", (1, 2), "unknown column \"seed\""),
        ("k,replicates\n3,2\n", (1, 2), "unknown column"),
        ("k,n\n3,1.5\n", (2, 2), "whole number"),
        ("k,n\n3,20\n3,0\n", (3, 2), "n = 0 is outside"),
        ("k,n\n3,1e9\n", (2, 2), "n = 1000000000 is outside"),
        ("k,informed\n3,21\n", (2, 2), "more than n = 20"),
        (
            "k,informed,informed_fraction\n3,1,0.1\n",
            (2, 1),
            "exclude each other",
        ),
        ("k,contacts\n3,near\n", (2, 2), "near"),
        ("k,attraction\n3,{ kind }\n", (2, 2), "no table"),
        (
            "k,pi1\n3,2\n4,2\n3,2\n",
            (4, 1),
            "duplicate run \"pi1=2 k=3 #0\"",
        ),
        ("k,dt\n3,0.1\n3,50\n", (3, 1), "run \"dt=50 k=3 #0\""),
        ("k,pi1\n3,\"2\n4\"\nx,2\n", (2, 2), "give a number"),
    ] {
        let error = error(csv);
        let (line, column) = place;
        let start = format!("samples.csv, line {line}, column {column}: ");
        assert!(error.starts_with(&start), "{csv:?}: {error}");
        assert!(error.contains(part), "{csv:?}: {error}");
    }
    // A command that a value of a row makes wrong is at its place in the TOML.
    let error = error("k\n3\n21\n");
    assert!(error.starts_with("line 9, column 1: inform: "), "{error}");
    assert!(error.ends_with("(samples.csv, line 3)"), "{error}");
}

#[test]
fn points_and_a_grid_exclude_each_other_and_the_csv_belongs_to_the_file() {
    let both = plan_of(&format!("{TOML}[[grid]]\npi1 = 2\n"), "k\n3\n").unwrap_err();
    assert!(
        both.to_string()
            .starts_with("line 4, column 10: points and [[grid]]")
    );
    let missing = Plan::parse(TOML).unwrap_err().to_string();
    assert!(missing.contains("are missing"), "{missing}");
    let unnamed = TOML.replace("points = \"samples.csv\"\n", "");
    let unnamed = plan_of(&unnamed, "k\n3\n").unwrap_err().to_string();
    assert!(unnamed.contains("names none"), "{unnamed}");
    let repeated = "k\n3\n".to_owned() + &"4\n".repeat(100_000);
    let repeated = plan_of(TOML, &repeated).unwrap_err().to_string();
    assert!(
        repeated.contains("line 100002") && repeated.contains("more than 100000 conditions"),
        "{repeated}"
    );
}

#[test]
fn both_files_are_the_experiment_of_a_folder_and_of_its_parts() {
    let folder = tempfile::tempdir().unwrap();
    let (at, to) = (|name: &str| folder.path().join(name), folder.path());
    fs::create_dir(at("in")).unwrap();
    let toml = TOML.replace("samples.csv", "../samples.csv");
    fs::write(at("in/a.toml"), &toml).unwrap();
    fs::write(at("samples.csv"), "k\r\n3\r\n4\r\n").unwrap();
    let files = Files::read(&at("in/a.toml")).unwrap();
    assert_eq!(files.points.as_deref(), Some("k\r\n3\r\n4\r\n"));
    let plan = Plan::of(files.clone()).unwrap();
    let execute_part = |number: usize, folder: &mut Folder| {
        let execution = Execution {
            plan: &plan,
            subset: &Subset::part(&plan, number, 2).unwrap(),
            threads: 1,
            checkpoint_every: None,
        };
        execute(execution, folder, &ExecutionControl::new()).unwrap();
    };
    for number in [1, 2] {
        let mut part = Folder::open(&at(&format!("part-{number}")), &plan).unwrap();
        execute_part(number, &mut part);
    }
    let parts = [at("part-1"), at("part-2")];
    let one = missing(&plan, &parts[1..]).unwrap();
    assert_eq!(one, Subset::part(&plan, 1, 2).unwrap());
    let merged = Parts::read(&parts).unwrap().write(&at("merged")).unwrap();
    assert_eq!(merged.rows().len(), 2);
    drop(merged);
    // The copies are an experiment's files, and the same one.
    assert_eq!(Files::stored(&at("merged")).unwrap(), files);
    assert_eq!(Files::read(&at("merged/experiment.toml")).unwrap(), files);
    assert!(Folder::open(&at("merged"), &plan).is_ok());
    let other = Files {
        points: Some("k\n3\n5\n".to_owned()),
        ..files
    };
    let other = Plan::of(other).unwrap();
    assert!(matches!(
        Folder::open(&at("merged"), &other),
        Err(FolderError::OtherExperiment { .. })
    ));
    assert!(matches!(
        missing(&other, &parts),
        Err(MergeError::ForeignPart { .. })
    ));
    fs::write(at("part-2/experiment.points.csv"), "k\n3\n5\n").unwrap();
    assert!(matches!(
        Parts::read(&parts),
        Err(MergeError::OtherExperiment { .. })
    ));
    fs::remove_file(at("samples.csv")).unwrap();
    let error = Files::read(&at("in/a.toml")).unwrap_err().to_string();
    assert!(error.contains("in/../samples.csv"), "{error}");
    fs::write(to.join("samples.csv"), b"k\n\xff\n").unwrap();
    let error = Files::read(&at("in/a.toml")).unwrap_err().to_string();
    assert!(error.contains("not UTF-8"), "{error}");
}
