use super::*;
use jostle_convert::hexadecimal;
use jostle_physics::model::body;
use jostle_physics::simulation::Change;
use jostle_results::{Cell, Measure};

fn plan(rest: &str) -> Plan {
    Plan::parse(&format!("name = \"a\"\n{rest}")).unwrap()
}

fn finished_run(plan: &Plan) -> FinishedRun {
    execute_run(plan, &plan.runs()[0], |_| true).unwrap()
}

#[test]
fn a_single_uninformed_individual_has_order_1_and_no_overlap() {
    let plan = plan("duration = 20\nspec = { n = 1, dt = 0.01 }\nmeasure = { order_every = 500 }");
    let FinishedRun {
        row, fault, order, ..
    } = finished_run(&plan);
    let row = row.unwrap();
    assert_eq!((fault, row.steps, row.time), (None, 2000, 20.0));
    assert!((row.number(Measure::V) - 1.0).abs() < 1e-12);
    for (measure, expected) in [
        (Measure::V_PD, Cell::Absent),
        (Measure::ORDERED_INTERVALS, Cell::Count(1)),
        (Measure::UNORDERED_INTERVALS, Cell::Count(0)),
        (Measure::ORDERED_TIME, Cell::Number(20.0)),
        (Measure::UNORDERED_TIME, Cell::Number(0.0)),
        (Measure::WORST_OVERLAP, Cell::Number(0.0)),
        (Measure::CROSSED_SHARE, Cell::Number(0.0)),
        (Measure::WORST_RESIDUAL, Cell::Number(0.0)),
        (Measure::DEGRADED, Cell::Count(0)),
        (Measure::FALLBACKS, Cell::Count(0)),
    ] {
        assert_eq!(row.value(measure), expected, "{measure:?}");
    }
    assert_eq!(row.state_hash.len(), 64);
    let series = order.unwrap();
    assert_eq!(series.steps, [0, 500, 1000, 1500, 2000]);
    assert_eq!(series.times, [0.0, 5.0, 10.0, 15.0, 20.0]);
    let mut orders = series.measures[0].values.iter();
    assert!(orders.all(|order| (order.unwrap() - 1.0).abs() < 1e-12));
}

#[test]
fn a_single_informed_individual_drifts_by_the_closed_form() {
    // a is the angle from the direction. tan(a/2) decays as exp(-c t) with c = π2 π3, so the
    // mean of cos a over [0, T] is ln((q + exp(2 c T)) / (q + 1)) / (c T) - 1, q = tan²(a₀/2).
    let start = "start = { kind = \"given\", x = [0], y = [0], alpha = [2] }";
    let text =
        format!("duration = 10\n[spec]\nn = 1\ndt = 0.0005\n{start}\n[[grid]]\ninformed = 1");
    let row = finished_run(&plan(&text)).row.unwrap();
    assert_eq!(
        ResultRow::from_cells(row.cells()),
        Some(row.clone()),
        "every measure"
    );
    let (c, q) = (0.5, libm::tan(1.0) * libm::tan(1.0));
    let mean = libm::log((q + libm::exp(2.0 * c * 10.0)) / (q + 1.0)) / (c * 10.0) - 1.0;
    let drift = row.number(Measure::V_PD);
    assert!((drift - mean).abs() < 2e-4, "{drift} {mean}");
    assert_eq!((row.informed, row.pi2), (1, 0.5));
}

#[test]
fn a_run_equals_a_simulation_with_its_seed_and_the_same_change() {
    for settings in [
        "relinearise = 1",
        "contacts = \"closest\"\ndt = 0.1",
        "noise = 0.1",
    ] {
        let text = format!("duration = 8\n[spec]\nn = 15\n{settings}\n[[grid]]\ninformed = 4");
        let plan = plan(&text);
        let row = finished_run(&plan).row.unwrap();
        let spec = plan.spec(&plan.runs()[0]);
        let mut swarm = Simulation::new(&spec).unwrap();
        let inform = Change::Inform {
            selection: Selection::Count(4),
            direction: 0.0,
            weight: None,
            for_time: None,
        };
        swarm.apply(&inform).unwrap();
        let mut worst_gap = f64::INFINITY;
        for _ in 0..row.steps {
            let now = body::worst_gap(&swarm.state.parameters, &swarm.state.configuration);
            worst_gap = worst_gap.min(now.unwrap_or(f64::INFINITY));
            swarm.step().unwrap();
        }
        assert_eq!(
            row.state_hash,
            hexadecimal(&swarm.state.hash()),
            "{settings}"
        );
        assert_eq!(row.optional_number(Measure::V), swarm.means.mean_order());
        assert_eq!(row.optional_number(Measure::V_PD), swarm.means.mean_drift());
        let overlap = row.number(Measure::WORST_OVERLAP);
        assert!(overlap > 0.0, "{settings}: no overlap");
        assert!((overlap + worst_gap).abs() < 1e-9, "{settings}");
    }
}

#[test]
fn a_stopped_run_has_no_result() {
    let plan = plan("duration = 8\nspec = { n = 3 }");
    let mut calls = Vec::new();
    let stopped = execute_run(&plan, &plan.runs()[0], |steps| {
        calls.push(steps);
        steps < 3
    });
    assert_eq!((stopped, calls), (None, vec![1, 2, 3]));
}

#[test]
fn a_run_without_room_has_a_fault_and_no_row() {
    // The disc is nearly too small: with some of the seeds the individuals do not fit.
    let crowded = (0..100).find_map(|k| {
        let radius = 2.2 - 0.01 * f64::from(k);
        let text = format!(
            "name = \"a\"\nduration = 8\nreplicates = 20\n[spec]\nn = 9\npi1 = 1\n\
             start = {{ kind = \"disc\", radius = {radius} }}"
        );
        let plan = Plan::parse(&text).ok()?;
        let finished = plan
            .runs()
            .iter()
            .map(|run| execute_run(&plan, run, |_| false));
        finished.flatten().next()
    });
    let finished = crowded.unwrap();
    assert_eq!((finished.row, finished.order), (None, None));
    assert!(finished.fault.unwrap().contains("fit in a disc"));
}

#[test]
fn a_run_that_a_caller_holds_gives_the_same_result_in_steps_of_any_number() {
    let text = "duration = 3\nspec = { n = 12, noise = 0.1 }\n[measure]\norder_every = 7\n\
                series_every = 9\ncolumns = [\"msd(0.5)\"]\n";
    let commands = "[[at]]\ntime = 1\nset = { noise = 0.2 }";
    for plan in ["touch = true", commands].map(|more| plan(&format!("{text}{more}"))) {
        let [run] = plan.runs() else { unreachable!() };
        let expected = finished_run(&plan);
        assert!(expected.fault.is_none() && expected.series.is_some());
        assert_eq!(expected.touch.is_some(), plan.touch);
        for steps in [1, 7, 150, 1000] {
            let mut current = CurrentRun::start(&plan, run).unwrap();
            let finished = loop {
                let before = current.steps();
                if let Some(finished) = current.advance(&plan, steps, None) {
                    break finished;
                }
                assert_eq!(current.steps(), before + steps);
            };
            assert_eq!(current.simulation().state.step, 150);
            assert_eq!(finished, expected, "{steps}");
        }
    }
}
