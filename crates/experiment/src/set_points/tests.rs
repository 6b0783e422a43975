use std::time::Instant;

use jostle_convert::hexadecimal;
use jostle_physics::model::Drive;
use jostle_physics::simulation::{SetPoints, Simulation};

use super::*;
use crate::files::Files;
use crate::plan::Plan;
use crate::run::execute_run;

const HEAD: &str =
    "name = \"a\"\nseeds = [5]\nduration = 2\nsetpoints = \"a.csv\"\nspec = { n = 9, dt = 0.1 }\n";

fn files(csv: &str, more: &str) -> Files {
    Files {
        toml: format!("{HEAD}{more}"),
        setpoints: Some(csv.to_owned()),
        ..Files::default()
    }
}

fn hash_of(files: Files) -> String {
    let plan = Plan::of(files).unwrap();
    let finished = execute_run(&plan, &plan.runs()[0], |_| true).unwrap();
    assert_eq!(finished.fault, None);
    finished.row.unwrap().state_hash
}

/// The hash after the steps of the file, with set-points by hand.
fn expected(mut before: impl FnMut(u64, &mut Simulation)) -> String {
    let plan = Plan::of(files("step,id,direction\n", "")).unwrap();
    let mut simulation = Simulation::new(&plan.spec(&plan.runs()[0])).unwrap();
    for step in 0..20 {
        before(step, &mut simulation);
        simulation.step().unwrap();
    }
    hexadecimal(&simulation.state.hash())
}

fn steer(simulation: &mut Simulation, id: u32, direction: f64, weight: f64, drive: Option<Drive>) {
    let set = SetPoints {
        ids: vec![id],
        direction: vec![direction],
        weight: Some(vec![weight]),
        drives: drive.map(|drive| vec![drive]),
    };
    simulation.steer(&set).unwrap();
}

#[test]
fn set_points_are_applied_at_their_steps_between_the_blocks() {
    let csv = "step,id,direction,weight,turn,speed,after\n\
               3,0,0.5,2,,,0\n3,4,1,,0.25,model,0\n3,0,,,,,1\n7,4,-1,1.5,,,\n12,4,2,1,model,model,\n";
    let block = "[[at]]\nstep = 3\nset = { pi2 = 0.75 }\n\
                 [[at]]\nstep = 3\nuninform = { select = { ids = [4] } }\n";
    let hash = expected(|step, simulation| match step {
        3 => {
            let drive = Drive {
                turn: Some(0.25),
                speed: None,
            };
            // The default of pi2 before the first block.
            steer(simulation, 4, 1.0, 0.5, Some(drive));
            simulation.state.parameters.pi2 = 0.75;
            simulation.release(&[0].into());
            let k = simulation.state.configuration.id.binary_search(&4).unwrap();
            simulation.state.configuration.uninform(k);
        }
        7 => steer(simulation, 4, -1.0, 1.5, None),
        12 => {
            let none = Drive {
                turn: None,
                speed: None,
            };
            steer(simulation, 4, 2.0, 1.0, Some(none));
        }
        _ => {}
    });
    assert_eq!(hash_of(files(csv, block)), hash);
    assert_ne!(hash, expected(|_, _| {}));
    // The text of the CSV in the TOML is the same.
    let within = format!("{HEAD}{block}").replace("\"a.csv\"", &format!("'''\n{csv}'''"));
    assert_eq!(hash_of(Files::from(within.as_str())), hash);
}

#[test]
fn a_log_omits_what_changes_nothing_and_joins_what_is_at_one_step() {
    let point = |direction: f64, drive| SetPoint::Steer {
        direction,
        weight: None,
        drive,
    };
    let drive = Drive {
        turn: None,
        speed: Some(0.1 + 0.2),
    };
    let mut log = SetPointLog::default();
    assert!(log.is_empty());
    log.push(1, 0, 7, point(0.1, None));
    log.push(2, 0, 7, point(0.1, None));
    log.changed();
    log.push(2, 1, 7, point(0.1, None));
    log.push(5, 0, 7, point(0.1, Some(drive)));
    log.push(5, 0, 7, point(0.3, None));
    log.push(5, 0, 2, point(-1.0, None));
    log.push(6, 0, 7, SetPoint::Release);
    log.push(6, 0, 7, point(1.0, None));
    log.push(8, 0, 7, SetPoint::Release);
    // The hash of a state contains the sign of zero.
    for (step, direction) in [(9, 0.0), (10, -0.0), (11, -0.0), (12, 0.0)] {
        log.push(step, 0, 4, point(direction, None));
    }
    let csv = log.csv(|step| u64::from(step == 2));
    assert_eq!(
        csv,
        "step,id,direction,weight,turn,speed\n1,7,0.1,,,\n2,7,0.1,,,\n5,2,-1,,,\n\
         5,7,0.3,,model,0.30000000000000004\n6,7,1,,model,model\n8,7,,,,\n\
         9,4,0,,,\n10,4,-0,,,\n12,4,0,,,\n"
    );
    let csv = log.csv(|step| 2 * u64::from(step == 2));
    assert_eq!(csv.lines().nth(2), Some("2,7,0.1,,,,1"), "{csv}");
    assert_eq!(csv.lines().last(), Some("12,4,0,,,,"), "{csv}");
    assert_eq!(log.last_step(), Some(12));
    for step in 0..=crate::limits::MAX_SET_POINTS {
        assert!(step < 90_000 || !log.is_too_long() || step > 99_990);
        log.push(step, 0, 1, point(step as f64, None));
    }
    assert!(log.is_too_long());
    log.clear();
    assert!(log.is_empty() && !log.is_too_long());
}

#[test]
fn a_zero_has_its_sign_in_the_hash() {
    let [hash, negative] = ["0", "-0"].map(|direction| {
        let csv = format!("step,id,direction\n19,4,{direction}\n");
        hash_of(files(&csv, ""))
    });
    assert_ne!(hash, negative);
}

#[test]
fn many_rows_are_checked_quickly_and_the_line_of_the_first_wrong_one_is_found() {
    let mut csv = "step,id,direction\n".to_owned();
    for k in 0..crate::limits::MAX_SET_POINTS {
        csv += &format!("{},{},0\n", k / 1000, k % 1000);
    }
    let began = Instant::now();
    let table = SetPointTable::read(Place::File("a.csv".to_owned()), &csv).unwrap();
    let read = began.elapsed();
    // If each check visited every row, they would take far longer.
    let began = Instant::now();
    for _ in 0..90_000 {
        table.check(100, 1000).unwrap();
    }
    let checked = began.elapsed();
    assert!(checked < 50 * read, "{checked:?}, read in {read:?}");
    for (steps, most, line) in [(99, 1000, 99_002), (100, 999, 1001), (99, 999, 1001)] {
        let rejected = table.check(steps, most).unwrap_err().to_string();
        assert!(rejected.contains(&format!("line {line},")), "{rejected}");
    }
    let none = SetPointTable::read(Place::Within(0), "step,id,direction\n").unwrap();
    none.check(0, 0).unwrap();
}

#[test]
fn wrong_rows_are_rejected_with_their_place() {
    let rejected = |csv: &str| Plan::of(files(csv, "")).unwrap_err().to_string();
    for (csv, place, reason) in [
        ("", "line 1, column 1", "\"step\" is missing"),
        ("step,direction\n", "line 1, column 3", "\"id\" is missing"),
        (
            "step,id,direction,x\n",
            "line 1, column 4",
            "unknown column \"x\"",
        ),
        ("step,id,id,direction\n", "line 1, column 3", "given twice"),
        (
            "step,id,direction\n1,2\n",
            "line 2, column 3",
            "2 cells, but the header has 3",
        ),
        (
            "step,id,direction\n1,2,NaN\n",
            "line 2, column 3",
            "direction",
        ),
        (
            "step,id,direction\n1,2,1e9\n",
            "line 2, column 3",
            "direction",
        ),
        (
            "step,id,direction\n1,2,north\n",
            "line 2, column 3",
            "no number",
        ),
        (
            "step,id,direction,weight\n1,2,0,-1\n",
            "line 2, column 4",
            "weight",
        ),
        (
            "step,id,direction,weight\n1,2,,1\n",
            "line 2, column 3",
            "no direction",
        ),
        (
            "step,id,direction,turn,speed\n1,2,0,,1\n",
            "line 2, column 4",
            "or neither",
        ),
        (
            "step,id,direction,turn,speed\n1,2,0,model,2\n",
            "line 2, column 5",
            "speed",
        ),
        (
            "step,id,direction,speed\n1,2,0,1\n",
            "line 2, column 4",
            "or neither",
        ),
        (
            "step,id,direction\n-1,2,0\n",
            "line 2, column 1",
            "whole number",
        ),
        (
            "step,id,direction\n1.5,2,0\n",
            "line 2, column 1",
            "whole number",
        ),
        (
            "step,id,direction\n1,5000000000,0\n",
            "line 2, column 2",
            "whole number",
        ),
        (
            "id,step,direction\n2,4,0\n\n2,3,0\n",
            "line 4, column 2",
            "below that of line 2",
        ),
        (
            "step,id,direction,after\n4,1,0,\n4,2,0,1\n",
            "line 3, column 4",
            "below that of line 2",
        ),
        (
            "step,id,direction\n4,1,0\n4,2,0\n4,1,0\n",
            "line 4, column 2",
            "also in line 2",
        ),
        (
            "step,id,direction\n4,9,0\n",
            "line 2, column 2",
            "cannot exist",
        ),
        (
            "step,id,direction\n19,1,0\n20,1,0\n",
            "line 3, column 1",
            "before the end, step 20",
        ),
    ] {
        let error = rejected(csv);
        assert!(
            error.starts_with(&format!("a.csv, {place}: ")),
            "{csv}: {error}"
        );
        assert!(error.contains(reason), "{csv}: {error}");
    }
    let many = "step,id,direction\n".to_owned() + &"1,1,0\n".repeat(100_001);
    assert!(
        rejected(&many).contains("line 100002"),
        "{}",
        rejected(&many)
    );
    let within = HEAD.replace("\"a.csv\"", "'''\nstep,id,direction\n1,2,x'''");
    let error = Plan::parse(&within).unwrap_err().to_string();
    assert!(
        error.starts_with("line 6, column 1: setpoints, column 3: "),
        "{error}"
    );
    let error = Plan::parse(HEAD).unwrap_err().to_string();
    assert!(
        error.starts_with("line 4") && error.contains("contents of this file are missing"),
        "{error}"
    );
    let unnamed = Files {
        toml: HEAD.replace("setpoints = \"a.csv\"\n", ""),
        ..files("step,id,direction\n", "")
    };
    let error = Plan::of(unnamed).unwrap_err().to_string();
    assert!(error.contains("give setpoints"), "{error}");
}

#[test]
fn a_set_point_of_an_individual_that_was_removed_ends_the_run_with_its_line() {
    let csv = "step,id,direction\n5,2,\n5,3,1\n";
    let block = "[[at]]\nstep = 4\nremove = { select = { ids = [2, 3] } }\n";
    let plan = Plan::of(files(csv, block)).unwrap();
    let finished = execute_run(&plan, &plan.runs()[0], |_| true).unwrap();
    let fault = finished.fault.unwrap();
    assert!(fault.starts_with("step 5: a.csv, line 3: "), "{fault}");
}

#[test]
fn the_copies_in_a_folder_contain_the_csv() {
    let folder = tempfile::tempdir().unwrap();
    let files = files("step,id,direction\n1,2,0\n", "");
    files.store(folder.path()).unwrap();
    assert_eq!(Files::stored(folder.path()).unwrap(), files);
    let copy = folder.path().join("experiment.toml");
    assert_eq!(Files::read(&copy).unwrap(), files);
    let text = HEAD.replace("\"a.csv\"", "'''\nstep,id,direction\n'''");
    std::fs::write(&copy, &text).unwrap();
    assert_eq!(Files::read(&copy).unwrap().setpoints, None);
}
