//! What is checked before the first run.

use super::{ByHand, error, finished, noise, plan, row};
use crate::files::Files;
use crate::plan::Plan;

const INFORM: &str = "inform = { select = { count = 3 }, direction = 0 }";

/// A swarm whose limit of the step depends on weights: 0.1 is too long for a weight of 1000.
const STEPS: &str = "name = \"a\"\nduration = 10\n";

#[test]
fn numbers_that_no_swarm_accepts_are_rejected_at_their_command() {
    for (command, part) in [
        (
            "inform = { select = { fraction = 1.5 }, direction = 0 }",
            "select.fraction = 1.5 is outside [0, 1]: write 0.1 for 10 %",
        ),
        (
            "inform = { select = { fraction = -0.1 }, direction = 0 }",
            "select.fraction = -0.1",
        ),
        (
            "inform = { select = { fraction = nan }, direction = 0 }",
            "select.fraction = NaN",
        ),
        (
            "uninform = { select = { ids = [3, 1, 3] } }",
            "3 is given twice",
        ),
        (
            "remove = { select = { within = { x = 0, y = 0, radius = 0 } } }",
            "radius = 0",
        ),
        (
            "remove = { select = { within = { x = 0, y = 0, radius = -1 } } }",
            "radius",
        ),
        (
            "remove = { select = { within = { x = nan, y = 0, radius = 1 } } }",
            "within.x = NaN",
        ),
        (
            "remove = { select = { within = { x = 0, y = inf, radius = 1 } } }",
            "within.y = inf",
        ),
        (
            "remove = { select = { foremost = { count = 1, along = nan } } }",
            "along = NaN",
        ),
        (
            "inject = { count = 1, within = { x = 0, y = 0, radius = 0 } }",
            "within.radius = 0",
        ),
        (
            "inject = { count = 1, within = { x = nan, y = 0, radius = 2 } }",
            "within.x = NaN",
        ),
        (
            "inject = { at = [{ x = 90, y = 0, alpha = 0 }, { x = nan, y = 0, alpha = 0 }] }",
            "pose 1: x = NaN",
        ),
        (
            "inject = { at = [{ x = 90, y = 0, alpha = 1e7 }] }",
            "pose 0: alpha",
        ),
        ("inject = { count = 1, direction = nan }", "direction = NaN"),
        (
            "inform = { select = { count = 1 }, direction = 0, weight = -1 }",
            "weight",
        ),
    ] {
        let verb = command.split(' ').next().unwrap();
        for when in ["time = 3", "when = \"order > 2\"", "every = 2"] {
            let (line, column, reason) = error(&format!("[[at]]\n{when}\n{command}\n"));
            assert_eq!((line, column), (6, 1), "{command}: {reason}");
            assert!(reason.starts_with(&format!("{verb}: ")), "{reason}");
            assert!(reason.contains(part), "{command}: {reason}");
        }
    }
    // A ramp is checked at both of its ends.
    let ramp = "[[at]]\nevery = 2\ninform = { select = { fraction = { ramp = [0.5, 1.5] } }, \
                direction = 0 }\n";
    assert!(error(ramp).2.contains("select.fraction = 1.5"));
}

#[test]
fn an_error_is_at_the_block_or_the_variable_that_it_is_about() {
    let text = format!("[[at]]\ntime = 1\n{INFORM}\n\n[[at]]\n");
    let (line, _, reason) = error(&text);
    assert_eq!(
        (line, reason.contains("without a time")),
        (8, true),
        "{reason}"
    );
    let text = "[[grid]]\nk2 = 1\n[[at]]\ntime = 1\nset = { noise = \"$k2\", pi2 = \"$k\" }\n";
    let (line, column, reason) = error(text);
    assert!(reason.contains("unknown variable \"$k\""), "{reason}");
    assert_eq!((line, column), (8, 31), "{reason}");
}

#[test]
fn the_axis_of_a_parameter_is_no_variable() {
    let whens = [
        "every = \"$noise\"\nset = { pi2 = 3 }",
        "when = \"order > $noise\"\nset = { pi2 = 3 }",
    ];
    for when in whens {
        let (_, _, reason) = error(&format!("[[grid]]\nnoise = [0.1, 0.2]\n[[at]]\n{when}\n"));
        let expected = "\"$noise\" is no variable: noise is an axis, which gives a parameter its \
                        values; give a variable of another name the values in the [[grid]], such as \
                        my_noise = [0.1, 0.2], and the parameter its value with set = { noise = \
                        \"$my_noise\" }";
        assert!(reason.contains(expected), "{reason}");
    }
    let text =
        "[[grid]]\nn = [20, 30]\n[[at]]\ntime = 1\nremove = { select = { count = \"$n\" } }\n";
    let (_, _, reason) = error(text);
    assert!(reason.ends_with("such as my_n = [0.1, 0.2]"), "{reason}");
}

#[test]
fn a_selection_by_several_or_none_names_the_selectors() {
    for select in ["{ count = 1, informed = false }", "{}"] {
        for verb in ["remove", "uninform"] {
            let (_, _, reason) = error(&format!(
                "[[at]]\ntime = 1\n{verb} = {{ select = {select} }}\n"
            ));
            let expected = format!(
                "{verb}: select has one of `ids`, `count`, `fraction`, `within`, `informed`, `foremost`"
            );
            assert_eq!(reason, expected, "{select}");
        }
    }
    let other = "[[at]]\ntime = 1\nset = { contacts = { a = 1, b = 2 } }\n";
    assert!(!error(other).2.contains("select"));
}

#[test]
fn a_period_is_above_0() {
    for every in ["-5", "0", "nan", "\"x\""] {
        let (_, _, reason) = error(&format!("[[at]]\nevery = {every}\n{INFORM}\n"));
        assert_eq!(
            reason, "every: give a time in time units, above 0",
            "{every}"
        );
    }
    let (_, _, reason) = error(&format!("[[at]]\ntime = -5\n{INFORM}\n"));
    assert_eq!(reason, "time: give a time in time units, 0 or more");
}

#[test]
fn a_time_within_the_last_step_is_rejected() {
    // The last of 100 steps starts at 9.9.
    for (text, place) in [
        (
            format!("[[at]]\nevery = 1\nfrom = 9.95\n{INFORM}\n"),
            (6, 8),
        ),
        (
            format!("[[at]]\nwhen = \"order > 0\"\nfrom = 9.95\n{INFORM}\n"),
            (6, 8),
        ),
        (
            "[measure]\ncolumns = [\"order\"]\nfrom = 9.95\n".to_owned(),
            (6, 8),
        ),
        (
            "[stop]\nwhen = \"order > 0\"\nfrom = 9.95\n".to_owned(),
            (6, 8),
        ),
    ] {
        let (line, column, reason) = error(&text);
        assert!(reason.contains("from = 9.95"), "{reason}");
        assert_eq!((line, column), place, "{reason}");
    }
    let last = plan("[[at]]\nevery = 1\nfrom = 9.9\nset = { noise = 0.2 }\n");
    let mut by_hand = ByHand::new(&last, &last.runs()[0]);
    by_hand.step_to(99);
    by_hand.apply(&[noise(0.2)]);
    by_hand.step_to(100);
    assert_eq!(row(&last).state_hash, by_hand.hash());
}

/// Returns whether a file with this spec and these blocks is accepted, or the error.
fn check(spec: &str, blocks: &str) -> Result<Plan, String> {
    let text = format!("{STEPS}spec = {{ n = 5, dt = 0.1{spec} }}\n{blocks}");
    Plan::parse(&text).map_err(|error| error.to_string())
}

#[test]
fn parameters_that_earlier_blocks_change_are_those_of_later_blocks() {
    let velocity = ", stepping = \"velocity\"";
    let position = "[[at]]\ntime = TIME\nset = { stepping = \"position\" }\n";
    let relinearise = "[[at]]\ntime = TIME\nset = { relinearise = 1 }\n";
    let at = |block: &str, time: &str| block.replace("TIME", time);
    // In the order of their times, not of the file.
    for (first, second, is_valid) in [("1", "2", true), ("2", "1", false), ("1", "1", true)] {
        let blocks = at(position, first) + &at(relinearise, second);
        let found = check(velocity, &blocks);
        assert_eq!(found.is_ok(), is_valid, "{found:?}");
        if let Err(error) = found {
            assert!(error.starts_with("line 9, column 1: set: "), "{error}");
        }
        let blocks = at(relinearise, second) + &at(position, first);
        assert_eq!(
            check(velocity, &blocks).is_ok(),
            first < second,
            "{first} {second}"
        );
    }
    // And back again.
    let back = "[[at]]\ntime = 2\nset = { stepping = \"velocity\" }\n";
    let blocks = at(position, "1") + back + &at(relinearise, "3");
    assert!(
        check(velocity, &blocks)
            .unwrap_err()
            .starts_with("line 12, ")
    );

    let low = "[[at]]\ntime = 1\nset = { pi3 = 1e-3 }\n";
    let high =
        "[[at]]\ntime = 2\ninform = { select = { count = 2 }, direction = 0, weight = 100 }\n";
    let error = check("", high).unwrap_err();
    assert!(error.starts_with("line 6, column 1: inform: "), "{error}");
    let valid = check("", &format!("{low}{high}")).unwrap();
    assert_eq!(finished(&valid, 0).fault, None);
    // With that weight pi3 cannot grow again, but for the informed that are uninformed.
    let grow = "[[at]]\ntime = 4\nset = { pi3 = 1 }\n";
    let error = check("", &format!("{low}{high}{grow}")).unwrap_err();
    assert!(error.starts_with("line 12, column 1: set: "), "{error}");
    let uninform = "[[at]]\ntime = 3\nuninform = { select = { informed = true } }\n";
    let valid = check("", &format!("{low}{high}{uninform}{grow}")).unwrap();
    assert_eq!(finished(&valid, 0).fault, None);
}

#[test]
fn what_depends_on_a_condition_is_rejected_only_if_it_is_never_valid() {
    let velocity = ", stepping = \"velocity\"";
    let maybe = "[[at]]\nwhen = \"order > 0.5\"\nset = { stepping = \"position\" }\n";
    let relinearise = "set = { relinearise = 1 }\n";
    let timed = format!("[[at]]\ntime = 5\n{relinearise}");
    let when = format!("[[at]]\nwhen = \"order > 0.9\"\n{relinearise}");
    for blocks in [
        format!("{maybe}{timed}"),
        format!("{timed}{maybe}"),
        format!("{maybe}{when}"),
        format!("{when}{maybe}"),
        // The time is before the condition can hold for the first time.
        format!("{when}[[at]]\ntime = 9\nset = {{ stepping = \"position\" }}\n"),
        // Between two executions of a block.
        format!("[[at]]\nevery = 2\nfrom = 1\nset = {{ stepping = \"position\" }}\n{timed}"),
        // More possibilities than are compared.
        format!(
            "{}{maybe}{timed}",
            maybe
                .replace("stepping = \"position\"", "noise = 0.1")
                .repeat(20)
        ),
    ] {
        check(velocity, &blocks).unwrap_or_else(|error| panic!("{error}\n{blocks}"));
    }
    let other = maybe.replace("stepping = \"position\"", "noise = 0.1");
    let late = maybe.replace("order > 0.5\"", "order > 0.5\"\nfrom = 6");
    for blocks in [
        timed.clone(),
        when.clone(),
        format!("{other}{timed}"),
        format!("{late}{timed}"),
        format!("[[at]]\nevery = 1\nfrom = 6\nset = {{ stepping = \"position\" }}\n{timed}"),
    ] {
        let error = check(velocity, &blocks).expect_err(&blocks);
        assert!(error.contains("relinearise"), "{error}");
    }
    // A number outside its range is rejected with any number of possibilities.
    let wrong = format!(
        "{}[[at]]\ntime = 5\nset = {{ noise = -1 }}\n",
        other.repeat(20)
    );
    assert!(check("", &wrong).unwrap_err().contains("noise"));
}

#[test]
fn a_plan_with_many_conditions_is_checked_in_a_second() {
    let mut blocks = String::new();
    for k in 0..500 {
        blocks += &format!("[[at]]\nwhen = \"order > 0.{k}\"\nset = {{ noise = 0.{k} }}\n");
        blocks += &format!("[[at]]\nstep = {}\nset = {{ pi2 = 0.{k} }}\n", k % 100);
    }
    let began = std::time::Instant::now();
    check("", &blocks).unwrap();
    assert!(began.elapsed().as_secs_f64() < 30.0);
}

#[test]
fn informing_with_a_weight_of_0_is_rejected_in_a_new_file_and_executed_in_a_stored_one() {
    let weightless = "inform: a weight of 0 informs no individual: set pi2 above 0";
    let blocks = |first: &str, command: &str| {
        format!("[[at]]\ntime = 1\n{first}\n[[at]]\ntime = 2\n{command}\n")
    };
    let inject = "inject = { count = 1, direction = 0.5 }";
    for (spec, blocks, problem) in [
        (", pi2 = 0", blocks("set = { pi3 = 2 }", INFORM), weightless),
        ("", blocks("set = { pi2 = 0 }", INFORM), weightless),
        (", pi2 = 0", blocks("set = { pi2 = 1 }", INFORM), ""),
        (
            ", pi2 = 0",
            blocks("set = { pi3 = 2 }", inject),
            "inject: a weight of 0",
        ),
        (
            ", pi2 = 0",
            blocks("set = { pi3 = 2 }", "inject = { count = 1 }"),
            "",
        ),
    ] {
        let text = format!("{STEPS}spec = {{ n = 5, dt = 0.1{spec} }}\n{blocks}");
        let found = Plan::parse(&text).map_err(|error| error.to_string());
        match problem {
            "" => assert_eq!(found.err(), None),
            problem => assert!(found.unwrap_err().contains(problem), "{blocks}"),
        }
        let (stored, accepted) = Plan::new_or_stored(Files::from(&*text)).unwrap();
        assert_eq!(accepted.is_err(), !problem.is_empty());
        assert_eq!(stored.runs().len(), 1);
    }
}
