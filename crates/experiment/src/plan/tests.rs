use super::*;
/// What each file is compared with that a test gives the parser.
pub use crate::schema::tests::compare;
use jostle_physics::model::ParametersError;
use jostle_physics::simulation::ChangeError;
use jostle_proto::{AXES, Axis, LARGEST_WHOLE};

const HEAD: &str = "name = \"a\"\nduration = 10\n";

fn plan(rest: &str) -> Plan {
    Plan::parse(&format!("{HEAD}{rest}")).unwrap()
}

fn error(rest: &str) -> PlanError {
    Plan::parse(&format!("{HEAD}{rest}")).unwrap_err()
}

/// Returns the line and the reason of a [`PlanError::Field`].
fn field_error(rest: &str) -> (usize, String) {
    match error(rest) {
        PlanError::Field { line, reason, .. } => (line, reason),
        other => panic!("{other}"),
    }
}

fn names(plan: &Plan) -> Vec<&str> {
    plan.runs().iter().map(|run| run.name.as_str()).collect()
}

#[test]
fn the_papers_series_are_planned_under_both_rules() {
    let files = [
        (
            include_str!("../../../../paper/series1.toml"),
            2 * 4 * 9 * 16,
        ),
        (include_str!("../../../../paper/series2.toml"), 2 * 35 * 40),
        (include_str!("../../../../paper/animations.toml"), 2 * 6 * 4),
    ];
    for (text, runs) in files {
        let plan = Plan::parse(text).unwrap();
        assert_eq!(plan.runs().len(), runs, "{}", plan.name);
    }
    let plan = Plan::parse(files[1].0).unwrap();
    let run = &plan.runs()[plan.runs().len() - 1];
    assert_eq!(
        run.name,
        "pi1=8 n=40 informed_fraction=0.5 contacts=closest dt=0.1 #7"
    );
    let point = plan.point(run);
    assert_eq!((point.informed, point.steps), (20, 10_000));
    assert_eq!(plan.spec(run).seed, run.seed);
}

#[test]
fn without_a_grid_there_is_one_point() {
    let plan = plan("replicates = 2\n[spec]\nn = 3\n");
    assert_eq!(names(&plan), ["#0", "#1"]);
    assert_eq!(plan.point(&plan.runs()[0]).steps, 500);
}

#[test]
fn axes_vary_in_one_order_and_grids_follow_each_other() {
    let both = plan(
        "replicates = 2\n[[grid]]\nn = [5, 3]\npi1 = [2, 1.5]\n[[grid]]\nreplicates = 1\n\
         pi3 = 0.5\nn = 4",
    );
    let expected = [
        "pi1=2 pi3=1 n=5 #0",
        "pi1=2 pi3=1 n=5 #1",
        "pi1=2 pi3=1 n=3 #0",
        "pi1=2 pi3=1 n=3 #1",
        "pi1=1.5 pi3=1 n=5 #0",
        "pi1=1.5 pi3=1 n=5 #1",
        "pi1=1.5 pi3=1 n=3 #0",
        "pi1=1.5 pi3=1 n=3 #1",
        "pi1=4 pi3=0.5 n=4 #0",
    ];
    assert_eq!(names(&both), expected);
    for (index, run) in both.runs().iter().enumerate() {
        assert_eq!(both.index(&run.name), Some(index));
    }
    assert_eq!(both.index("pi1=2 pi3=1 n=5 #2"), None);
    // A value that does not vary is that of [spec], or the default.
    assert_eq!(both.spec(&both.runs()[8]).parameters.pi3, 0.5);
    let laws = plan(
        "spec = { n = 9 }\ngrid = [{ attraction = [{ kind = \"all\" }, { kind = \
         \"topological\", neighbours = 7 }], relinearise = 1, informed = 2 }]",
    );
    let expected = [
        "informed=2 relinearise=1 attraction=all #0",
        "informed=2 relinearise=1 attraction=topological:7 #0",
    ];
    assert_eq!(names(&laws), expected);
}

#[test]
fn a_seed_depends_on_the_name_and_the_experiments_seed_alone() {
    let seeds = |plan: &Plan| -> Vec<(String, u64)> {
        let runs = plan.runs().iter();
        runs.map(|run| (run.name.clone(), run.seed)).collect()
    };
    let few = seeds(&plan("seed = 7\n[[grid]]\nn = [3]\npi1 = [4]"));
    // If the derivation of seeds changes, the results of all experiments change.
    assert_eq!(
        few,
        [("pi1=4 n=3 #0".to_owned(), derive_seed(7, "pi1=4 n=3 #0"))]
    );
    assert!(few[0].1 <= LARGEST_WHOLE);
    let many = plan("seed = 7\nreplicates = 3\n[[grid]]\nn = [50, 3]\npi1 = [1.5, 4.0]");
    assert!(seeds(&many).contains(&few[0]), "more values changed a seed");
    let other = seeds(&plan("seed = 8\n[[grid]]\nn = [3]\npi1 = [4]"));
    assert_ne!(few[0].1, other[0].1);
    let mut distinct: Vec<u64> = many.runs().iter().map(|run| run.seed).collect();
    distinct.sort_unstable();
    distinct.dedup();
    assert_eq!(distinct.len(), many.runs().len());
}

#[test]
fn invalid_fields_and_values_are_rejected_with_their_line() {
    for (rest, line, part) in [
        ("colour = 1\n", 3, "colour"),
        ("[spec]\nn = 3\npi5 = 2\n", 5, "pi5"),
        ("[spec]\nn = 3\npi1 = \"long\"\n", 5, "pi1"),
        ("[spec]\nseed = 3\n", 4, "seed"),
        ("[spec]\nstart = { kind = \"ring\" }\n", 4, "ring"),
        (
            "[[grid]]\nn = 3\n[[grid]]\nn = 4\n\nspeed = [1, 2]\n",
            8,
            "speed",
        ),
        ("[[grid]]\nn = [3,\n \"x\"]\n", 4, "n: "),
        (
            "[[grid]]\nn = 3\ncontacts = [\"endpoint\"]\n",
            5,
            "endpoint",
        ),
        ("[[grid]]\nn = []\n", 4, "no value"),
        ("[[grid]]\nn = 3\nreplicates = 0\n", 5, "replicates = 0"),
        ("[measure]\norder_each = 3\n", 4, "order_each"),
        ("[measure]\norder_every = 0\n", 4, "order_every = 0"),
        ("[measure]\nseries_every = 0\n", 4, "series_every = 0"),
        ("[measure]\nseries_every = 5\n", 4, "without columns"),
        ("replicates = -1\n", 3, "-1"),
        ("seed = 9007199254740992\n", 3, "seed = 9007199254740992"),
        ("[spec\n", 3, ""),
        ("[spec]\nn = 10.5\n", 4, "10.5`: give a whole number"),
        ("[[grid]]\nn = [10.5]\n", 4, "10.5`: give a whole number"),
        ("replicates = 1.5\n", 3, "1.5`: give a whole number"),
        ("[spec]\nn = 3\npi1 = \"4\"\n", 5, "\"4\": give a number"),
        ("[grid]\nn = [3]\n", 3, "write [[grid]]"),
        ("[at]\ntime = 3\n", 3, "write [[at]]"),
        ("[[grid]]\npi1 = 3\n", 4, "n is given neither"),
        ("[[grid]]\nn = 3\ninformed = 4\n", 5, "more than n = 3"),
        ("[[grid]]\nn = 3\ninformed = -1\n", 5, "informed"),
        (
            "[[grid]]\nn = 3\ninformed_fraction = 0.1\n",
            5,
            "selects no individual",
        ),
        (
            "[[grid]]\nn = 3\ninformed_fraction = 1.1\n",
            5,
            "within [0, 1]",
        ),
        ("[[grid]]\nn = 3\ninformed = 1\npi2 = 0\n", 5, "pi2"),
        (
            "[[grid]]\ninformed = 1\nn = 3\ninformed_fraction = 0.5\n",
            4,
            "exclude each other",
        ),
        ("[spec]\nn = 3\nrelinearise = 2\n", 1, "relinearise"),
    ] {
        let (at, reason) = field_error(rest);
        assert!(reason.contains(part), "{rest}: {reason}");
        assert_eq!(at, line, "{rest}: {reason}");
    }
    for head in ["duration = 1", "name = \"a\"", "name = \"A\"\nduration = 1"] {
        assert!(matches!(
            Plan::parse(head),
            Err(PlanError::Field { line: 1, .. })
        ));
    }
    let unnamed = Plan::parse("name = \"\"\nduration = 1").unwrap_err();
    let unnamed = unnamed.to_string();
    assert!(
        unnamed.contains("use 1 to 64 lowercase letters"),
        "{unnamed}"
    );
    assert!(!unnamed.contains('^'), "{unnamed}");
    for duration in ["0", "-1", "nan", "inf"] {
        let text = format!("name = \"a\"\nduration = {duration}\nspec = {{ n = 3 }}");
        assert!(matches!(
            Plan::parse(&text),
            Err(PlanError::Field { line: 2, .. })
        ));
    }
}

#[test]
fn excessive_sizes_are_rejected() {
    let list = (1..=1000)
        .map(|k| k.to_string())
        .collect::<Vec<_>>()
        .join(", ");
    let text = format!("[[grid]]\nn = [{list}]\npi3 = [{list}]\npi4 = [{list}]");
    match error(&text) {
        PlanError::TooManyRuns { runs } => assert_eq!(runs, 1_000_000_000),
        other => panic!("{other}"),
    }
    assert!(
        field_error("spec = { n = 1000000000 }")
            .1
            .contains("n = 1000000000")
    );
    let (_, reason) = field_error("replicates = 1000000000");
    assert!(reason.contains("replicates"), "{reason}");
    let (_, reason) = field_error("spec = { n = 2, dt = 1e-12 }");
    assert!(reason.contains("steps"), "{reason}");
    let text = "spec = { n = 2, dt = 1e-7 }\nreplicates = 20\nmeasure = { order_every = 1 }";
    match error(text) {
        PlanError::TooManyEntries { entries } => assert_eq!(entries, 2_000_000_020),
        other => panic!("{other}"),
    }
}

#[test]
fn the_parameters_of_a_run_are_checked_with_its_weights() {
    // dt (1 + h ω) <= 2 r: 0.12 is short enough only without informed individuals.
    let text = "[spec]\npi1 = 8\n[[grid]]\nn = 10\ndt = 0.12\ninformed = ";
    plan(&format!("{text}0"));
    match error(&format!("{text}[0, 1]")) {
        PlanError::Run {
            run,
            error: ChangeError::Parameters(ParametersError::StepTooLong { .. }),
        } => assert_eq!(run, "n=10 informed=1 dt=0.12 #0"),
        other => panic!("{other}"),
    }
    let start = "[spec]\nn = 2\nstart = { kind = \"given\", x = [0, 9], y = [0, 0], alpha = \
                 [0, 0] }\n";
    plan(start);
    assert!(
        field_error(&start.replace("n = 2", "n = 3"))
            .1
            .contains("n is 3")
    );
    let crossed = start.replace("[0, 9]", "[0, 0]");
    assert!(matches!(error(&crossed), PlanError::Run { .. }));
}

#[test]
fn a_repeated_run_is_rejected() {
    for text in [
        "[[grid]]\nn = [3, 3.0]",
        "[[grid]]\nn = [3, 4]\n[[grid]]\nn = 4",
        "[[grid]]\nn = 4\ninformed = 0\n[[grid]]\nn = [4, 3]\ninformed = [1, 0]",
    ] {
        match error(text) {
            PlanError::Repeated { .. } => {}
            PlanError::Field { reason, .. } => assert!(reason.contains("3.0"), "{reason}"),
            other => panic!("{other}"),
        }
    }
}

#[test]
fn informed_fractions_round_half_up() {
    let plan = plan("[[grid]]\nn = [10, 5]\ninformed_fraction = [0, 0.1, 0.25, 0.5, 1]");
    let counts: Vec<usize> = plan
        .runs()
        .iter()
        .map(|run| plan.point(run).informed)
        .collect();
    assert_eq!(counts, [0, 1, 3, 5, 10, 0, 1, 1, 3, 5]);
}

#[test]
fn each_axis_of_a_grid_is_a_column_of_the_results() {
    let columns = jostle_proto::OccasionalColumns {
        varied: AXES.iter().map(|it| it.name.clone()).collect(),
        extra: Vec::new(),
        series: Vec::new(),
    };
    let occasional = jostle_results::table::occasional(&columns);
    for Axis { name: axis, .. } in AXES.iter() {
        let mut always = jostle_results::COLUMNS.iter();
        let is_always = always.any(|column| column.name == *axis);
        assert_ne!(is_always, occasional.iter().any(|it| it == axis), "{axis}");
    }
}

#[test]
fn names_of_columns_and_minus_zero_are_rejected_in_new_experiments_and_read_in_stored_ones() {
    for (name, value, reason) in [
        ("step", "1", "rename the variable"),
        ("id", "1", "rename the variable"),
        ("x", "1", "rename the variable"),
        ("y", "1", "rename the variable"),
        ("alpha", "1", "rename the variable"),
        ("runs", "1", "rename the variable"),
        ("level", "-0.0", "write 0 for -0"),
    ] {
        let text = format!(
            "{HEAD}[[grid]]\nn = 3\n{name} = [{value}, 2]\n[[at]]\ntime = 1\nset = {{ noise = \"${name}\" }}\n"
        );
        let (plan, accepted) = Plan::new_or_stored(Files::from(&*text)).unwrap();
        assert_eq!(plan.runs().len(), 2, "{name}");
        let error = accepted.unwrap_err().to_string();
        assert!(error.contains(reason), "{name}: {error}");
    }
}
