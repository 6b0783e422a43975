use std::fs;

use jostle_convert::hexadecimal;
use jostle_physics::model::Parameters;
use jostle_physics::model::selection::Selection;
use jostle_proto::snapshot::SnapshotPhase;
use jostle_proto::to_cbor;

use super::*;
use crate::run::{RunCheckpoint, execute_run, execute_run_from};
use crate::{Files, Folder, FolderError, Plan};

const TOML: &str = "name = \"a\"\nduration = 6\nstart = \"before.snapshot\"\nseeds = [17, 18]\n";

/// A swarm at step 50 whose parameters were changed. One informed individual is uninformed at step 80.
fn swarm() -> Simulation {
    let spec = Spec {
        n: 12,
        parameters: Parameters {
            dt: 0.1,
            ..Parameters::default()
        },
        seed: 3,
        start: Start::Disc(None),
        publish_every: 1,
        measures: Vec::new(),
        rate: None,
    };
    let mut swarm = Simulation::new(&spec).unwrap();
    let inform = |ids: Vec<u32>, for_time| Change::Inform {
        selection: Selection::Ids(ids),
        direction: 1.0,
        weight: Some(0.7),
        for_time,
    };
    swarm.apply(&inform(vec![0, 1], None)).unwrap();
    swarm.apply(&inform(vec![2], Some(8.0))).unwrap();
    swarm
        .apply(&Change::Remove(Selection::Ids(vec![5])))
        .unwrap();
    let noise = Settings {
        noise: Some(0.05),
        ..Settings::default()
    };
    swarm.apply(&Change::Set(noise)).unwrap();
    for _ in 0..50 {
        swarm.step().unwrap();
    }
    swarm
}

/// The file that `jostle snapshot` writes.
fn file(swarm: &Simulation) -> Snapshot {
    let paused = SnapshotPhase::Paused {
        reason: String::new(),
    };
    snapshot::to_proto("before", &swarm.checkpoint(), paused).sealed()
}

fn plan_of(toml: &str, snapshot: &Snapshot) -> Result<Plan, String> {
    let files = Files {
        start: Some(to_cbor(snapshot)),
        ..Files::from(toml)
    };
    Plan::of(files).map_err(|error| error.to_string())
}

#[test]
fn a_run_is_the_swarm_of_the_snapshot_with_the_seed_of_the_run() {
    let snapshot = file(&swarm());
    let plan = plan_of(TOML, &snapshot).unwrap();
    let mut hashes = Vec::new();
    for run in plan.runs() {
        let row = execute_run(&plan, run, |_| true).unwrap().row.unwrap();
        let mut by_hand = swarm();
        by_hand.state.seed = run.seed;
        by_hand.state.step = 0;
        for lapses_at in by_hand.state.configuration.lapses_at.iter_mut().flatten() {
            assert_eq!(*lapses_at, 80);
            *lapses_at = 30;
        }
        while by_hand.state.step < 60 {
            by_hand.step().unwrap();
        }
        assert_eq!(row.state_hash, hexadecimal(&by_hand.state_hash()));
        assert_eq!((row.seed, row.steps, row.time), (run.seed, 60, 6.0));
        assert_eq!((row.n, row.informed), (11, 3));
        hashes.push(row.state_hash);
    }
    assert_ne!(hashes[0], hashes[1], "the noise of the seeds is the same");
}

#[test]
fn parameters_of_the_file_replace_those_of_the_snapshot() {
    let snapshot = file(&swarm());
    let text = format!(
        "{TOML}[spec]\nn = 11\ndt = 0.1\nnoise = 0.2\n[[grid]]\npi3 = [1, 0.5]\n[[at]]\ntime = \
         1\ninform = {{ select = {{ count = 2 }}, direction = 0 }}\n"
    );
    let plan = plan_of(&text, &snapshot).unwrap();
    assert_eq!(plan.runs()[2].name, "pi3=0.5 #0");
    let row = execute_run(&plan, &plan.runs()[2], |_| true)
        .unwrap()
        .row
        .unwrap();
    let mut by_hand = swarm();
    by_hand.state.seed = 17;
    by_hand.state.step = 0;
    by_hand.state.parameters.noise = 0.2;
    by_hand.state.parameters.pi3 = 0.5;
    let lapses_at = by_hand.state.configuration.lapses_at.iter_mut();
    lapses_at.flatten().for_each(|it| *it = 30);
    while by_hand.state.step < 60 {
        if by_hand.state.step == 10 {
            // The first command of the run.
            let inform = Change::inform(Selection::Count(2), 0.0);
            by_hand.apply_at(1, &inform).unwrap();
        }
        by_hand.step().unwrap();
    }
    assert_eq!(row.state_hash, hexadecimal(&by_hand.state_hash()));
    assert_eq!(row.pi3, 0.5);
}

#[test]
fn fields_that_contradict_the_snapshot_are_rejected_at_their_place() {
    let snapshot = file(&swarm());
    for (text, place, part) in [
        ("[spec]\nn = 12\n", "line 6, column 5: ", "whose n is 11"),
        (
            "[spec]\ndt = 0.05\n",
            "line 6, column 6: ",
            "whose dt is 0.1",
        ),
        ("[spec]\npi1 = 2\n", "line 6, column 7: ", "whose pi1 is 4"),
        (
            "[spec]\nstart = { kind = \"disc\" }\n",
            "line 6, column 9: ",
            "leave it out",
        ),
        (
            "[[grid]]\nn = [11, 12]\n",
            "line 6, column 5: ",
            "determines n",
        ),
        (
            "[[grid]]\npi1 = 4\n",
            "line 6, column 7: ",
            "determines pi1",
        ),
        (
            "[[grid]]\ninformed = 2\n",
            "line 6, column 12: ",
            "determines informed",
        ),
        ("[spec]\npi3 = 1e6\n", "run \"#0\": ", "dt"),
        (
            "[[at]]\ntime = 1\nremove = { select = { ids = [11] } }\n[x]\n",
            "line 8",
            "x",
        ),
    ] {
        let error = plan_of(&format!("{TOML}{text}"), &snapshot).unwrap_err();
        assert!(
            error.starts_with(place) && error.contains(part),
            "{text}: {error}"
        );
    }
}

#[test]
fn a_snapshot_that_is_no_start_is_rejected() {
    let snapshot = file(&swarm());
    let mut damaged = to_cbor(&snapshot);
    damaged.truncate(100);
    let mut other = snapshot.clone();
    other.model_version += 1;
    let other = to_cbor(&other.sealed());
    for (bytes, part) in [
        (damaged, "not a snapshot"),
        (Vec::new(), "not a snapshot"),
        (other, "version"),
    ] {
        let files = Files {
            start: Some(bytes),
            ..Files::from(TOML)
        };
        let error = Plan::of(files).unwrap_err().to_string();
        assert!(
            error.starts_with("line 3, column 9: before.snapshot: "),
            "{error}"
        );
        assert!(error.contains(part), "{error}");
    }
    let missing = Plan::parse(TOML).unwrap_err().to_string();
    assert!(
        missing.starts_with("line 3, ") && missing.contains("are missing"),
        "{missing}"
    );
    let unnamed = plan_of(
        &TOML.replace("start = \"before.snapshot\"\n", ""),
        &snapshot,
    );
    assert!(unnamed.unwrap_err().contains("names none"));
}

#[test]
fn a_run_from_a_snapshot_continues_from_its_checkpoint() {
    let plan = plan_of(TOML, &file(&swarm())).unwrap();
    let run = &plan.runs()[0];
    let expected = execute_run(&plan, run, |_| true).unwrap();
    let mut bytes = Vec::new();
    execute_run_from(&plan, run, None, None, |current| {
        bytes = current.checkpoint().to_bytes();
        current.steps() < 29
    });
    let mut first = None;
    let continued = execute_run_from(
        &plan,
        run,
        RunCheckpoint::from_bytes(&bytes),
        None,
        |current| {
            first.get_or_insert(current.steps());
            true
        },
    );
    assert_eq!((first, continued), (Some(30), Some(expected)));
}

#[test]
fn the_snapshot_is_a_part_of_the_experiment() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("a.toml"), TOML).unwrap();
    fs::write(at("before.snapshot"), to_cbor(&file(&swarm()))).unwrap();
    let files = Files::read(&at("a.toml")).unwrap();
    let plan = Plan::of(files.clone()).unwrap();
    drop(Folder::open(&at("results"), &plan).unwrap());
    assert_eq!(Files::stored(&at("results")).unwrap(), files);
    assert_eq!(Files::read(&at("results/experiment.toml")).unwrap(), files);
    let mut later = swarm();
    later.step().unwrap();
    let other = plan_of(TOML, &file(&later)).unwrap();
    assert!(matches!(
        Folder::open(&at("results"), &other),
        Err(FolderError::OtherExperiment { .. })
    ));
    assert!(Folder::open(&at("results"), &plan).is_ok());
}
