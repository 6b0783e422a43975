//! Limits, and executions at the ends of a run.

use jostle_physics::simulation::{Change, Placement};

use jostle_results::Measure;
use jostle_results::statistics::summarise;

use super::{ByHand, error, finished, plan};

const NOISE: &str = "[[at]]\ntime = 1\nset = { noise = 0 }\n";

#[test]
fn the_number_of_blocks_is_limited() {
    plan(&NOISE.repeat(1000));
    let (line, column, reason) = error(&NOISE.repeat(1001));
    assert!(reason.contains("at most 1000 [[at]]"), "{reason}");
    // The first line of the last block after four lines and a thousand blocks of three.
    assert_eq!((line, column), (4 + 3000 + 1, 1));
    let points = |count: usize| {
        let list: Vec<String> = (1..=count).map(|k| format!("{k}e-3")).collect();
        format!(
            "[[grid]]\npi2 = [{}]\n{}",
            list.join(", "),
            NOISE.repeat(1000)
        )
    };
    let (_, _, reason) = error(&points(1001));
    assert!(
        reason.contains("1001 points") && reason.contains("1000000"),
        "{reason}"
    );
}

#[test]
fn the_number_of_columns_is_limited() {
    let columns = |count: usize| {
        let list: Vec<String> = (1..=count).map(|k| format!("\"msd(0.{k:03})\"")).collect();
        format!("[measure]\ncolumns = [{}]\n", list.join(", "))
    };
    assert_eq!(plan(&columns(100)).columns.measures.len(), 100);
    let (line, _, reason) = error(&columns(101));
    assert_eq!(line, 5);
    assert!(reason.contains("at most 100 columns"), "{reason}");
}

#[test]
fn a_past_that_an_injection_makes_too_large_ends_the_run() {
    // 90 steps of 20 individuals are few; of 3,000 they are 90 times 3,008, above the limit of 250,000.
    let inject = |count: usize| {
        plan(&format!(
            "[[at]]\nstep = 3\ninject = {{ count = {count}, within = {{ x = 0, y = 0, radius = 500 }} \
             }}\n[[at]]\nwhen = \"msd(9) > 1e9\"\nset = {{ noise = 0 }}\n"
        ))
    };
    let fault = finished(&inject(2980), 0).fault.unwrap();
    assert!(fault.starts_with("step 3: "), "{fault}");
    assert!(fault.contains("270720 poses"), "{fault}");
    assert_eq!(finished(&inject(20), 0).fault, None);
}

#[test]
fn executions_whose_times_round_to_a_step_are_executed_in_turn() {
    // Due at 0, 3, 5, 8, 10, … of 100 steps: 40 times; the one at the end is not executed.
    let repeated = plan("[[at]]\nevery = 0.25\ninject = { count = 1 }\n");
    let mut by_hand = ByHand::new(&repeated, &repeated.runs()[0]);
    let one = Change::Inject {
        place: Placement::Border(1),
        informed: None,
    };
    let mut executions = 0;
    for step in 0..100u64 {
        by_hand.step_to(step);
        // The first step at or after k / 4.
        if (0..=40u64).any(|k| (5 * k).div_ceil(2) == step) {
            by_hand.apply(std::slice::from_ref(&one));
            executions += 1;
        }
    }
    by_hand.step_to(100);
    assert_eq!(executions, 40);
    let row = finished(&repeated, 0).row.unwrap();
    assert_eq!(row.state_hash, by_hand.hash());
}

#[test]
fn conditions_that_differ_in_pi2_only_differ_by_the_protocol() {
    let text = "seeds = [7]\n[[grid]]\npi2 = [0.2, 0.9]\n[[at]]\ntime = 1\ninform = { \
                select = { count = 5 }, direction = 1 }\n";
    let plan = plan(text);
    let rows = [0, 1].map(|run| finished(&plan, run).row.unwrap());
    let names = rows.each_ref().map(|row| row.run.as_str());
    assert_eq!(names, ["pi2=0.2 #0", "pi2=0.9 #0"]);
    assert_eq!(rows.each_ref().map(|row| row.pi2), [0.2, 0.9]);
    assert_eq!(rows.each_ref().map(|row| row.informed), [0, 0]);
    // The same seed: they differ by the weight of the informed alone.
    assert_ne!(rows[0].state_hash, rows[1].state_hash);
    for (run, weight) in [(0, 0.2), (1, 0.9)] {
        let mut by_hand = ByHand::new(&plan, &plan.runs()[run]);
        by_hand.step_to(10);
        by_hand.apply(&[Change::Inform {
            selection: jostle_physics::model::selection::Selection::Count(5),
            direction: 1.0,
            weight: Some(weight),
            for_time: None,
        }]);
        by_hand.step_to(100);
        assert_eq!(rows[run].state_hash, by_hand.hash());
    }
    // They have a drift, so a table of the results has a line for each.
    assert!(
        rows.iter()
            .all(|row| row.optional_number(Measure::V_PD).is_some())
    );
    assert_eq!(summarise(&rows).len(), 2);
    // Each condition is checked with its own weight.
    let (line, _, reason) = error(&text.replace("0.9", "1000"));
    assert_eq!(
        (line, reason.starts_with("inform: ")),
        (9, true),
        "{reason}"
    );
}
