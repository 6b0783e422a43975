use jostle_measures::{Past, View};
use jostle_physics::model::State;
use jostle_physics::simulation::{Change, Simulation, Spec};

use super::*;

fn parse(text: &str) -> Condition {
    Condition::parse(text).unwrap()
}

fn error(text: &str) -> (usize, String) {
    let error = Condition::parse(text).unwrap_err();
    (error.column, error.problem.to_string())
}

/// A state whose order is `order`: 100 individuals, of which some head +x and the others -x.
fn state(order: f64) -> State {
    let mut simulation = Simulation::new(&Spec::new(100, 1)).unwrap();
    let ahead = 50.0 + 50.0 * order;
    for (index, alpha) in simulation.state.configuration.alpha.iter_mut().enumerate() {
        *alpha = match (index as f64) < ahead {
            true => 0.0,
            false => std::f64::consts::PI,
        };
    }
    simulation.state
}

/// Observes one state with each of these orders, 0.5 time units apart; returns where it holds.
fn observe(text: &str, orders: &[f64]) -> Vec<usize> {
    let (condition, mut held) = (parse(text), Held::default());
    let mut holding = Vec::new();
    for (step, &order) in orders.iter().enumerate() {
        let (state, past) = (state(order), Past::new(0));
        if condition.observe(&View::new(&state, &past), step as u64, 0.5, &mut held) {
            holding.push(step);
        }
    }
    holding
}

#[test]
fn texts_have_a_normal_form_that_is_read_again() {
    for (text, normal) in [
        ("order>0.9", "order > 0.9"),
        ("  order   <= .5 ", "order <= 0.5"),
        ("drift > 0.90 for 20.0", "drift > 0.9 for 20"),
        ("order >= -1e-9", "order >= -1e-9"),
        ("(((order < 1)))", "order < 1"),
        (
            "order > 0 and (drift > 0 and order < 1)",
            "order > 0 and drift > 0 and order < 1",
        ),
        (
            "order > 0 or (drift > 0 or order < 1)",
            "order > 0 or drift > 0 or order < 1",
        ),
        (
            "order > 0 and (drift > 0 or order < 1)",
            "order > 0 and (drift > 0 or order < 1)",
        ),
        (
            "(order > 0 and drift > 0) or order < 1",
            "order > 0 and drift > 0 or order < 1",
        ),
        (
            "order > 0 or drift > 0 and order < 1",
            "order > 0 or drift > 0 and order < 1",
        ),
        ("msd( 5 ) > 2\n and order<1", "msd(5) > 2 and order < 1"),
    ] {
        let condition = parse(text);
        assert_eq!(condition.to_string(), normal, "{text}");
        assert_eq!(parse(normal), condition, "{text}");
    }
}

#[test]
fn and_binds_more_tightly_than_or() {
    // Only order > 0.9 holds.
    let holds = |text| observe(text, &[1.0]) == [0];
    assert!(holds("order > 0.9 or order < 0.5 and order < 0.4"));
    assert!(!holds("(order > 0.9 or order < 0.5) and order < 0.4"));
}

#[test]
fn errors_have_the_column_and_the_remedy() {
    let mut wrong = Vec::new();
    for (text, column, part) in [
        ("", 1, "a condition"),
        ("ordr > 0.9", 1, "order"),
        ("order = 0.9", 7, "`<`, `<=`, `>` or `>=`"),
        ("order > ", 9, "a number"),
        ("order > x", 9, "a number"),
        ("order > 0.9 for", 16, "a duration"),
        ("order > 0.9 for 0", 17, "not above 0"),
        ("order > 0.9 for -2", 17, "not above 0"),
        ("order > 0.9 &", 13, "and"),
        ("order > 0.9 and", 16, "a measure"),
        ("(order > 0.9", 13, "and"),
        ("order > 1e999", 9, "finite"),
        ("order > nan", 9, "a number"),
        ("order > $share", 9, "$share"),
        ("order(3) > 1", 1, "order"),
        ("msd > 1", 1, "msd"),
        ("order > 0.9 and drfit > 0.5", 17, "drift"),
        ("ördnung > 1", 1, "a condition"),
        ("order > 0.9 för 3", 13, "for"),
    ] {
        let (at, problem) = error(text);
        if at != column || !problem.contains(part) {
            wrong.push(format!("{text}: {at}: {problem}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    let deep = format!("{}order > 0{}", "(".repeat(40), ")".repeat(40));
    assert!(error(&deep).1.contains("nested"));
    assert!(error(&"order > 0 and ".repeat(100)).1.contains("1000"));
    // The limit is one of characters: two bytes each.
    assert!(!error(&"ö".repeat(600)).1.contains("1000"));
}

#[test]
fn variables_are_replaced_by_their_values() {
    let value = |name: &str| (name == "share").then_some(0.25);
    let condition = Condition::parse_with("order > $share for $share", value).unwrap();
    assert_eq!(condition.to_string(), "order > 0.25 for 0.25");
    let error = Condition::parse_with("order > $shar", value).unwrap_err();
    assert_eq!(
        (error.column, error.problem.to_string().contains("$shar")),
        (9, true)
    );
    let negative = Condition::parse_with("order > 0 for $x", |_| Some(-1.0)).unwrap_err();
    assert!(matches!(negative.problem, Problem::Duration(_)));
}

#[test]
fn a_comparison_holds_once_it_was_fulfilled_for_its_duration() {
    // 1.5 time units are three steps of 0.5.
    let orders = [1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0];
    assert_eq!(observe("order > 0.9", &orders), [0, 1, 3, 4, 5, 6, 7]);
    assert_eq!(observe("order > 0.9 for 1.5", &orders), [6, 7]);
    // The durations of two comparisons are counted separately.
    let text = "order > 0.9 for 1.5 or order < 0.5";
    assert_eq!(observe(text, &orders), [2, 6, 7, 8]);
    let text = "order > 0.9 for 1.5 and order < 0.5";
    assert_eq!(observe(text, &orders), [] as [usize; 0]);
}

#[test]
fn an_undefined_measure_fulfils_nothing() {
    // Without informed individuals there is no drift.
    for text in ["drift < 2", "drift > -2"] {
        assert_eq!(observe(text, &[1.0]), [] as [usize; 0], "{text}");
    }
    let mut simulation = Simulation::new(&Spec::new(3, 1)).unwrap();
    let all = jostle_physics::model::selection::Selection::Count(3);
    simulation.apply(&Change::inform(all, 0.0)).unwrap();
    let (past, mut held) = (Past::new(0), Held::default());
    let view = View::new(&simulation.state, &past);
    assert!(parse("drift < 2").observe(&view, 0, 0.02, &mut held));
}

#[test]
fn a_stored_condition_continues_in_the_middle_of_a_duration() {
    let condition = parse("order > 0.9 for 1.5");
    let (state, past) = (state(1.0), Past::new(0));
    let mut held = Held::default();
    for step in 0..3 {
        let view = View::new(&state, &past);
        assert!(!condition.observe(&view, step, 0.5, &mut held));
    }
    assert_eq!(held.since(0), Some(0));
    let view = View::new(&state, &past);
    assert!(condition.observe(&view, 3, 0.5, &mut held.clone()));
    // Without what was stored the duration begins again.
    assert!(!condition.observe(&view, 3, 0.5, &mut Held::default()));
}

#[test]
fn a_comparison_beyond_the_range_of_its_measure_never_holds() {
    for (text, part) in [
        (
            "order > 1.5",
            Some("order > 1.5 never holds: the range of order is 0 to 1"),
        ),
        (
            "order > 1.5",
            Some("range of order is 0 to 1; give a number within it"),
        ),
        (
            "milling < 0.5 and drift >= 2 for 3",
            Some("drift >= 2 for 3"),
        ),
        // Of the parts of an `or` one may hold.
        ("milling < 0.5 and (drift >= 2 for 3 or order > 0)", None),
        ("order > 0 or order > 1.5", None),
        ("order > 0 or (order > 1.5 and drift > 0)", None),
        ("order > 1.5 or drift >= 2 for 3", Some("order > 1.5 never")),
        (
            "(drift > 0 or order > 0.5) and (drift >= 3 or order < -1)",
            Some("drift >= 3 never"),
        ),
        ("msd(2) <= -0.1", Some("at least 0")),
        ("clusters.count(0.1) < 0.5", Some("1 to n")),
        // Always or by rounding, or without limits.
        ("order < 1.5", None),
        ("order > 1", None),
        ("order < 0", None),
        ("drift > -2", None),
        ("clusters.largest > 1e6", None),
        ("neighbour_gap.median < -5", None),
    ] {
        let reason = Condition::parse(text).unwrap().never_holds();
        let is_expected = match (&reason, part) {
            (Some(reason), Some(part)) => reason.contains(part),
            (reason, part) => reason.is_none() && part.is_none(),
        };
        assert!(is_expected, "{text}: {reason:?}");
    }
}
