use jostle_convert::hexadecimal;
use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::{Change, Placement, Settings, Simulation};
use jostle_results::ResultRow;

use crate::plan::Plan;
use crate::run::{FinishedRun, RunCheckpoint, execute_run, execute_run_from};
use crate::{PlanError, PlannedRun};

const HEAD: &str = "name = \"a\"\nduration = 10\nspec = { n = 20, dt = 0.1 }\n";

fn plan(rest: &str) -> Plan {
    Plan::parse(&format!("{HEAD}{rest}")).unwrap()
}

fn finished(plan: &Plan, run: usize) -> FinishedRun {
    execute_run(plan, &plan.runs()[run], |_| true).unwrap()
}

fn row(plan: &Plan) -> ResultRow {
    let finished = finished(plan, 0);
    assert_eq!(finished.fault, None);
    finished.row.unwrap()
}

/// Returns the place and the reason of an error.
fn error(rest: &str) -> (usize, usize, String) {
    match Plan::parse(&format!("{HEAD}{rest}")).unwrap_err() {
        PlanError::Field {
            line,
            column,
            reason,
        } => (line, column, reason),
        other => panic!("{other}"),
    }
}

/// A simulation of a run that takes commands by hand.
struct ByHand {
    simulation: Simulation,
    next_draw: u64,
}

impl ByHand {
    fn new(plan: &Plan, run: &PlannedRun) -> Self {
        Self {
            simulation: Simulation::new(&plan.spec(run)).unwrap(),
            next_draw: 1,
        }
    }

    fn apply(&mut self, changes: &[Change]) {
        for change in changes {
            self.simulation.apply_at(self.next_draw, change).unwrap();
            self.next_draw += 1;
        }
    }

    fn step_to(&mut self, step: u64) {
        while self.simulation.state.step < step {
            self.simulation.step().unwrap();
        }
    }

    fn hash(&self) -> String {
        hexadecimal(&self.simulation.state.hash())
    }
}

fn noise(value: f64) -> Change {
    Change::Set(Settings {
        noise: Some(value),
        ..Settings::default()
    })
}

#[test]
fn commands_at_times_and_steps_are_those_of_a_swarm() {
    let plan = plan(
        "[[at]]\ntime = 2\ninform = { select = { fraction = 0.25 }, direction = 1.5 }\nset = { \
         noise = 0.1 }\n[[at]]\nstep = 40\ninject = { count = 3 }\nremove = [{ select = { count = \
         2 } }, { select = { ids = [0] } }]\n[[at]]\ntime = 4\nuninform = { select = { informed = \
         true } }\n",
    );
    let mut by_hand = ByHand::new(&plan, &plan.runs()[0]);
    by_hand.step_to(20);
    let five = Change::inform(Selection::Fraction(0.25), 1.5);
    by_hand.apply(&[five, noise(0.1)]);
    by_hand.step_to(40);
    by_hand.apply(&[
        Change::Inject {
            place: Placement::Border(3),
            informed: None,
        },
        Change::Remove(Selection::Count(2)),
        Change::Remove(Selection::Ids(vec![0])),
        Change::Uninform(Selection::Informed(true)),
    ]);
    by_hand.step_to(100);
    let row = row(&plan);
    assert_eq!(row.state_hash, by_hand.hash());
    // The row has the spec of the start.
    assert_eq!((row.n, row.informed, row.steps), (20, 0, 100));
}

#[test]
fn a_ramp_reaches_both_of_its_ends() {
    let plan =
        plan("[[at]]\nfrom = 2\nuntil = 6\nevery = 1\nset = { noise = { ramp = [0.1, 0.5] } }\n");
    let mut by_hand = ByHand::new(&plan, &plan.runs()[0]);
    for (step, value) in [(20, 0.1), (30, 0.2), (40, 0.3), (50, 0.4), (60, 0.5)] {
        by_hand.step_to(step);
        let middle = 0.1 + (0.5 - 0.1) * ((step - 20) as f64 / 40.0);
        by_hand.apply(&[noise(if step == 60 { value } else { middle })]);
        assert!((by_hand.simulation.state.parameters.noise - value).abs() < 1e-15);
    }
    by_hand.step_to(100);
    assert_eq!(row(&plan).state_hash, by_hand.hash());
}

#[test]
fn a_condition_fires_once_after_its_duration_and_before_the_commands_of_its_step() {
    // The first drift is that of the state after step 11: the individuals are informed at step 10.
    let plan = plan(
        "[[at]]\nstep = 10\ninform = { select = { count = 20 }, direction = 0 }\n[[at]]\nwhen = \
         \"drift > -2 for 3\"\nset = { noise = 0.3 }\n[[at]]\nstep = 41\nset = { noise = 0.2 }\n",
    );
    let mut by_hand = ByHand::new(&plan, &plan.runs()[0]);
    by_hand.step_to(10);
    by_hand.apply(&[Change::inform(Selection::Count(20), 0.0)]);
    // It holds from step 11, for 30 steps.
    by_hand.step_to(41);
    by_hand.apply(&[noise(0.3), noise(0.2)]);
    by_hand.step_to(100);
    assert_eq!(row(&plan).state_hash, by_hand.hash());
}

#[test]
fn stop_ends_a_run_and_its_time_is_a_column() {
    let text = "[[at]]\ntime = 3\nset = { pi2 = 0.7 }\n[stop]\nwhen = \"order > -1 for 5\"\n";
    let row = row(&plan(text));
    assert_eq!((row.steps, row.time), (50, 5.0));
    assert_eq!(row.extra("stopped_at"), Some(5.0));
    // At the last step, too.
    let late = Plan::parse(&format!("{HEAD}{}", text.replace("for 5", "for 10")));
    let row = self::row(&late.unwrap());
    assert_eq!((row.steps, row.extra("stopped_at")), (100, Some(10.0)));
    let never = Plan::parse(&format!(
        "{HEAD}{}",
        text.replace("order > -1", "order < 0")
    ));
    let row = self::row(&never.unwrap());
    assert_eq!((row.steps, row.extra("stopped_at")), (100, None));
    let from = text.replace("[stop]", "[stop]\nfrom = 2");
    let row = self::row(&plan(&from));
    assert_eq!(row.extra("stopped_at"), Some(7.0));
    // Without a step there is no row.
    let at_once = Plan::parse(&format!("{HEAD}[stop]\nwhen = \"order > -1\"\n")).unwrap();
    let finished = finished(&at_once, 0);
    assert_eq!(finished.row, None);
    assert!(finished.fault.unwrap().contains("give from"));
}

#[test]
fn variables_are_axes_and_columns() {
    let plan = plan(
        "replicates = 2\n[[grid]]\nshare = [0.1, 0.5]\npi1 = [2, 4]\nlimit = 0.9\n[[at]]\ntime = \
         1\ninform = { select = { fraction = \"$share\" }, direction = 0 }\n[stop]\nwhen = \"drift \
         > $limit\"\n",
    );
    let names: Vec<&str> = plan.runs().iter().map(|run| run.name.as_str()).collect();
    assert_eq!(names.len(), 8);
    assert_eq!(names[0], "pi1=2 limit=0.9 share=0.1 #0");
    assert_eq!(names[7], "pi1=4 limit=0.9 share=0.5 #1");
    let row = finished(&plan, 7).row.unwrap();
    assert_eq!(row.extra("share"), Some(0.5));
    let mut by_hand = ByHand::new(&plan, &plan.runs()[7]);
    by_hand.step_to(10);
    by_hand.apply(&[Change::inform(Selection::Fraction(0.5), 0.0)]);
    by_hand.step_to(row.steps);
    assert_eq!(row.state_hash, by_hand.hash());
}

#[test]
fn given_seeds_are_those_of_the_replicates() {
    let plan = plan("seeds = [17, 3]\n[[grid]]\npi1 = [2, 4]\n");
    let seeds: Vec<(&str, u64)> = plan.runs().iter().map(|it| (&*it.name, it.seed)).collect();
    assert_eq!(seeds[..2], [("pi1=2 #0", 17), ("pi1=2 #1", 3)]);
    assert_eq!((seeds.len(), seeds[3]), (4, ("pi1=4 #1", 3)));
    for (text, part) in [
        ("seeds = [1]\nreplicates = 2\n", "exclude each other"),
        (
            "seeds = [1]\n[[grid]]\nreplicates = 2\n",
            "exclude each other",
        ),
        ("seeds = []\n", "at least one"),
        ("seeds = [9007199254740992]\n", "seeds = 9007199254740992"),
    ] {
        assert!(error(text).2.contains(part), "{text}");
    }
}

#[test]
fn chosen_columns_are_means_from_a_time_on() {
    let plan =
        plan("[measure]\nfrom = 4\nevery = 10\ncolumns = [\"order\", \"drift\", \"msd(2)\"]\n");
    let mut by_hand = ByHand::new(&plan, &plan.runs()[0]);
    let mut orders = Vec::new();
    for step in (40..100).step_by(10) {
        by_hand.step_to(step);
        orders.push(by_hand.simulation.order().order);
    }
    let row = row(&plan);
    let mean = orders.iter().sum::<f64>() / 6.0;
    assert_eq!(row.extra("order"), Some(mean));
    assert_eq!(row.extra("drift"), None, "no individual is informed");
    match row.extra("msd(2)") {
        Some(msd) => assert!(msd > 0.0 && msd < 4.0, "{msd}"),
        None => panic!("no value"),
    }
    for (text, part) in [
        ("[measure]\ncolumns = [\"ordr\"]\n", "order"),
        ("[measure]\ncolumns = [\"order\", \"order\"]\n", "twice"),
        ("[measure]\nfrom = 10\n", "from = 10"),
        ("[measure]\ncolumns = [\"msd(1e9)\"]\n", "shorter lag"),
    ] {
        assert!(error(text).2.contains(part), "{text}: {:?}", error(text));
    }
}

#[test]
fn a_rejected_command_ends_the_run_and_changes_nothing() {
    // The individuals have no room in that disc.
    let plan = plan(
        "[[at]]\nstep = 5\nset = { noise = 0.1 }\ninject = { count = 9, within = { x = 0, y = 0, \
         radius = 0.1 } }\n",
    );
    let finished = finished(&plan, 0);
    let fault = finished.fault.unwrap();
    assert!(
        fault.starts_with("step 5: [[at]] of line 5: command 2: "),
        "{fault}"
    );
    let mut by_hand = ByHand::new(&plan, &plan.runs()[0]);
    by_hand.step_to(5);
    assert_eq!(finished.row.unwrap().state_hash, by_hand.hash());
}

#[test]
fn everything_is_checked_before_the_first_run_with_its_place() {
    let inform = "inform = { select = { count = 3 }, direction = 0 }";
    for (text, place, part) in [
        ("[[at]]\ntme = 3\n", (5, 1), "without a time"),
        ("[[at]]\ntime = 3\n", (5, 1), "without a command"),
        ("[[at]]\ntime = 3\ninfrom = {}\n", (6, 1), "infrom"),
        (
            &format!("[[at]]\ntime = 3\nstep = 4\n{inform}\n"),
            (5, 1),
            "time and step",
        ),
        (
            &format!("[[at]]\ntime = 3\nuntil = 4\n{inform}\n"),
            (6, 1),
            "requires every",
        ),
        (
            &format!("[[at]]\ntime = 10\n{inform}\n"),
            (5, 8),
            "not before the end",
        ),
        (&format!("[[at]]\ntime = -1\n{inform}\n"), (5, 8), "time"),
        (&format!("[[at]]\ntime = nan\n{inform}\n"), (5, 8), "time"),
        (
            &format!("[[at]]\nstep = 100\n{inform}\n"),
            (5, 8),
            "step 100",
        ),
        (
            &format!("[[at]]\nstep = 1.5\n{inform}\n"),
            (5, 8),
            "whole number",
        ),
        (
            &format!("[[at]]\nevery = 0.01\n{inform}\n"),
            (5, 9),
            "shorter than a step",
        ),
        (
            &format!("[[at]]\nevery = 1\nfrom = 5\nuntil = 4\n{inform}\n"),
            (7, 9),
            "before from",
        ),
        (
            &format!("[[at]]\nevery = 1\nuntil = 40\n{inform}\n"),
            (6, 9),
            "after the end",
        ),
        (
            &format!("[[at]]\nwhen = \"drfit > 1\"\n{inform}\n"),
            (5, 9),
            "drift",
        ),
        (
            &format!("[[at]]\nwhen = \"order > 1 fr 3\"\n{inform}\n"),
            (5, 19),
            "for",
        ),
        (&format!("[[at]]\nwhen = 3\n{inform}\n"), (5, 8), "as text"),
        (
            "[[at]]\ntime = 3\ninform = { select = { count = 3 } }\n",
            (6, 1),
            "direction",
        ),
        (
            "[[at]]\ntime = 3\ninform = { select = { count = \"$k\" }, direction = 0 }\n",
            (6, 32),
            "unknown variable",
        ),
        (
            "[[at]]\ntime = 3\nremove = { select = { ids = [1, 20] } }\n",
            (6, 1),
            "20 cannot exist",
        ),
        (
            "[[at]]\ntime = 3\nremove = { select = { count = 21 } }\n",
            (6, 1),
            "too many",
        ),
        ("[[at]]\ntime = 3\nset = { pi1 = 0.5 }\n", (6, 1), "pi1"),
        ("[[at]]\ntime = 3\nset = { pi5 = 0.5 }\n", (6, 1), "pi5"),
        (
            "[[at]]\ntime = 3\nset = { noise = \"loud\" }\n",
            (6, 1),
            "give a number",
        ),
        (
            "[[at]]\ntime = 3\nset = { noise = \"-$share\" }\n",
            (6, 1),
            "the name of a variable alone",
        ),
        (
            "[[at]]\ntime = 3\nremove = { select = { uninformed = true } }\n",
            (6, 1),
            "write { informed = false }",
        ),
        (
            "[[at]]\ntime = 3\nset = { noise = { ramp = [0, 1] } }\n",
            (6, 19),
            "requires every",
        ),
        (
            "[[at]]\nevery = 3\nset = { contacts = { ramp = [0, 1] } }\n",
            (6, 1),
            "set: ",
        ),
        (
            "[[at]]\nevery = 3\nset = { noise = { ramp = [0, \"x\"] } }\n",
            (6, 19),
            "between two numbers",
        ),
        (
            "[[at]]\nevery = 3\nset = { noise = { ramp = [0, -1] } }\n",
            (6, 1),
            "noise",
        ),
        ("[[at]]\ntime = 3\nremove = []\n", (5, 1), "are empty"),
        (
            "[[at]]\ntime = 3\ninject = { count = 4000000000 }\n",
            (6, 1),
            "above the limit",
        ),
        (
            "[[grid]]\norder = [1]\n[stop]\nwhen = \"order > $order\"\n",
            (5, 1),
            "rename",
        ),
        (
            "[[grid]]\nrate = [1]\n[[at]]\nevery = \"$rate\"\nset = { noise = 0 }\n",
            (5, 1),
            "rename",
        ),
        ("[[grid]]\n\"a-b\" = [1]\n", (5, 1), "invalid name"),
        ("seeds = [3, 3]\n", (4, 10), "twice"),
        ("[stop]\nwhen = \"order > \"\n", (5, 17), "a number"),
        ("[stop]\nif = \"order > 1\"\n", (5, 1), "when"),
        ("[stop]\nfrom = 3\n", (5, 1), "give when"),
        (
            "[stop]\nfrom = 10\nwhen = \"order > 1\"\n",
            (5, 8),
            "not before the end",
        ),
        (
            &format!("[[at]]\nstep = 3\nfrom = 1\n{inform}\n"),
            (6, 1),
            "from requires",
        ),
        ("[[grid]]\nshare = [0.1]\n", (5, 1), "unknown axis"),
        (
            "[[grid]]\nshare = [\"x\"]\n[[at]]\ntime = \"$share\"\nset = { noise = 0 }\n",
            (5, 9),
            "a variable is a number",
        ),
        (
            "[[grid]]\nseed = [1]\n[[at]]\ntime = \"$seed\"\nset = { noise = 0 }\n",
            (5, 1),
            "rename",
        ),
        (
            &format!("[[at]]\nwhen = \"msd(9) > 1\"\n{inform}\n[[grid]]\ndt = 1e-4\nn = 100\n"),
            (5, 1),
            "shorter lag",
        ),
        (
            &format!("[[at]]\ntime = 1\n{inform}\n[measure]\ntouch = true\n"),
            (5, 1),
            "touch",
        ),
    ] {
        let (line, column, reason) = error(text);
        assert!(reason.contains(part), "{text}{reason}");
        assert_eq!((line, column), place, "{text}{reason}");
    }
    // An id that an injection can bring is accepted.
    let later = "[[at]]\ntime = 1\ninject = { count = 2 }\n[[at]]\ntime = 2\nremove = { select = { \
                 ids = [21] } }\n";
    assert_eq!(finished(&plan(later), 0).fault, None);
}

#[test]
fn a_protocol_continues_from_a_checkpoint_in_the_middle_of_a_duration() {
    let plan = plan(
        "[[at]]\nevery = 1.5\nset = { pi3 = { ramp = [1, 2] } }\n[[at]]\nwhen = \"order > 0 for 4 \
         and msd(1) > 0\"\ninform = { select = { count = 5 }, direction = 1 }\n[[at]]\nwhen = \
         \"drift > -2 for 2\"\ninject = { count = 2 }\n[stop]\nwhen = \"drift > -2 for 3\"\n\
         [measure]\nevery = 3\ncolumns = [\"msd(1)\", \"speed.informed\"]\n",
    );
    let run = &plan.runs()[0];
    let expected = execute_run(&plan, run, |_| true).unwrap();
    let steps = expected.row.as_ref().unwrap().steps;
    assert!((60..100).contains(&steps), "stopped: {steps}");
    for kept in [1, 20, 39, 40, 41, 55, 61, steps - 1] {
        let mut bytes = Vec::new();
        execute_run_from(&plan, run, None, None, |current| {
            bytes = current.checkpoint().to_bytes();
            current.steps() < kept
        });
        let checkpoint = RunCheckpoint::from_bytes(&bytes).unwrap();
        let mut first = None;
        let finished = execute_run_from(&plan, run, Some(checkpoint), None, |current| {
            first.get_or_insert(current.steps());
            true
        });
        assert_eq!(finished.unwrap(), expected, "{kept}");
        assert_eq!(first, Some(kept + 1), "{kept}");
    }
}

#[test]
fn a_group_that_outgrows_the_limit_ends_the_run() {
    let plan = plan(
        "[[at]]\nevery = 1\ninject = { count = 100000, within = { x = 0, y = 0, radius = 1e5 } }\n",
    );
    let fault = finished(&plan, 0).fault.unwrap();
    assert!(
        fault.starts_with("step 0: ") && fault.contains("100000"),
        "{fault}"
    );
}

#[test]
fn a_series_with_an_undefined_drift_equals_itself() {
    let plan = plan(
        "[measure]\norder_every = 10\n[[at]]\ntime = 5\ninform = { select = { count = 3 }, direction \
         = 0 }\n",
    );
    let finished = [0; 2].map(|run| finished(&plan, run));
    let order = finished[0].order.as_ref().unwrap();
    assert_eq!(order.measures[1].values[0], None);
    assert_eq!(finished[0], finished[1]);
}

#[test]
fn the_series_of_a_stopped_run_ends_with_the_state_that_stopped_it() {
    let plan = plan(
        "[measure]\nfrom = 9\ncolumns = [\"order\", \"drift\"]\nseries_every = 10\norder_every = \
         10\n[[at]]\ntime = 3\ninform = { select = { count = 3 }, direction = 0 }\n[stop]\nwhen = \
         \"drift > -2 for 1\"\n",
    );
    let finished = finished(&plan, 0);
    let (row, series) = (finished.row.unwrap(), finished.series.unwrap());
    assert_eq!(series.times.last().copied(), Some(row.time));
    assert_eq!((series.steps[0], series.steps[1]), (0, 10));
    assert_eq!(series.steps.last().copied(), Some(row.steps));
    // The state at t = 3 is measured after the command.
    for (time, value) in series.times.iter().zip(&series.measures[1].values) {
        assert_eq!(value.is_some(), *time >= 2.999, "t = {time}");
    }
    let orders = &series.measures[0].values;
    let expected = &finished.order.unwrap().measures[0].values;
    assert_eq!(&orders[..expected.len()], expected);
}

mod checks;
mod limits;
mod random;
mod random_protocol;
