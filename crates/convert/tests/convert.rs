//! Specs, changes and errors, compared with literals.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::collections::BTreeSet;
use std::{env, fs};

use jostle_convert::change::{change, set_points, to_proto};
use jostle_convert::value::{count, publish_every, rate, weight, whole};
use jostle_convert::{ArgsError, Place, WireCode, spec};
use jostle_physics::model::parameters::{Attraction, ContactRule, Parameters, Stepping};
use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::{
    Change, ChangeError, Placement, ReserveError, Settings, Simulation, Spec, Start,
};
use jostle_proto::ErrorCode;
use jostle_proto::contract::{CHANNELS, is_received, schemas};
use jostle_proto::verbs::SetPoints;
use serde_json::{Value, json};

/// The change of a message, and that of the message that is made from it.
fn read(value: Value) -> Change {
    let read = change(serde_json::from_value(value).unwrap()).unwrap();
    assert_eq!(change(to_proto(&read)).unwrap(), read);
    read
}

fn rejected(value: Value) -> String {
    change(serde_json::from_value(value).unwrap())
        .unwrap_err()
        .to_string()
}

#[test]
fn every_field_of_a_spec_is_read_and_written() {
    let laws = [
        (
            json!({"kind": "all", "accuracy": 1e-6}),
            Attraction::All {
                accuracy: Some(1e-6),
            },
        ),
        (json!({"kind": "voronoi"}), Attraction::Voronoi),
        (
            json!({"kind": "metric", "radius": 3.5}),
            Attraction::Metric { radius: 3.5 },
        ),
        (
            json!({"kind": "topological", "neighbours": 7}),
            Attraction::Topological { neighbours: 7 },
        ),
        (
            json!({"kind": "power", "exponent": -1.5}),
            Attraction::Power { exponent: -1.5 },
        ),
    ];
    let rules = [
        ("endpoints", ContactRule::Endpoints),
        ("closest", ContactRule::Closest),
        ("clamped", ContactRule::Clamped),
    ];
    let steppings = [
        ("position", Stepping::Position),
        ("velocity", Stepping::Velocity),
    ];
    for (index, (law, attraction)) in laws.into_iter().enumerate() {
        let ((rule, contacts), (kind, stepping)) = (rules[index % 3], steppings[index % 2]);
        let (disc, start) = match index % 2 {
            0 => (
                json!({"kind": "disc", "radius": 9.0}),
                Start::Disc(Some(9.0)),
            ),
            _ => {
                let columns =
                    json!({"kind": "given", "x": [0.0, 4.0], "y": [1.0, 5.0], "alpha": [2.0, 6.0]});
                let (x, y, alpha) = (vec![0.0, 4.0], vec![1.0, 5.0], vec![2.0, 6.0]);
                (columns, Start::Given { x, y, alpha })
            }
        };
        let message = json!({
            "n": 2, "pi1": 3.0, "pi2": 0.25, "pi3": 2.0, "pi4": 5.0, "dt": 0.01, "contacts": rule,
            "stepping": kind, "relinearise": 1, "seed": 9, "start": disc, "attraction": law,
            "noise": 0.5, "publish_every": 4, "rate": 2.5, "measures": ["milling", "drift"],
        });
        let expected = Spec {
            n: 2,
            parameters: Parameters {
                pi1: 3.0,
                pi2: 0.25,
                pi3: 2.0,
                pi4: 5.0,
                dt: 0.01,
                contacts,
                stepping,
                relinearise: true,
                attraction,
                noise: 0.5,
            },
            seed: 9,
            start,
            publish_every: 4,
            rate: Some(2.5),
            measures: vec!["milling".into(), "drift".into()],
        };
        let found = spec::from_proto(&serde_json::from_value(message.clone()).unwrap(), 2).unwrap();
        assert_eq!(found, expected);
        let written = serde_json::to_value(spec::to_proto(&expected, 11)).unwrap();
        let mut with_seed = message;
        with_seed["seed"] = json!(11);
        assert_eq!(written, with_seed);
    }
}

#[test]
fn a_spec_out_of_range_is_rejected_with_its_field() {
    let rejected = |field: &str, value: Value| {
        let mut message = json!({"n": 2});
        message[field] = value;
        let message = serde_json::from_value(message).unwrap();
        spec::from_proto(&message, 2).unwrap_err().to_string()
    };
    let large = 1_u64 << 53;
    for (field, value, part) in [
        ("seed", json!(large), "seed = 9007199254740992"),
        ("publish_every", json!(0), "publish_every = 0"),
        (
            "publish_every",
            json!(1_000_000_001),
            "publish_every = 1000000001",
        ),
        ("rate", json!(0.0), "rate = 0"),
        ("rate", json!(1.1e6), "rate = 1100000"),
        ("relinearise", json!(2), "relinearise = 2"),
        (
            "start",
            json!({"kind": "given", "x": [0.0], "y": [0.0, 1.0], "alpha": [0.0, 1.0]}),
            "start.x has 1 numbers, n is 2",
        ),
        (
            "start",
            json!({"kind": "given", "x": [0.0, 4.0], "y": [0.0], "alpha": [0.0, 1.0]}),
            "start.y has 1",
        ),
        (
            "start",
            json!({"kind": "given", "x": [0.0, 4.0], "y": [0.0, 1.0], "alpha": []}),
            "start.alpha has 0",
        ),
    ] {
        let error = rejected(field, value);
        assert!(error.contains(part), "{field}: {error}");
    }
    assert_eq!(whole("seed", large - 1).unwrap(), large - 1);
    assert_eq!(rate(Some(1e6)).unwrap(), Some(1e6));
    assert_eq!(rate(None).unwrap(), None);
    assert!(
        rate(Some(f64::NAN))
            .unwrap_err()
            .to_string()
            .contains("NaN")
    );
    assert_eq!(publish_every(1_000_000_000).unwrap(), 1_000_000_000);
    assert!(weight(0.0).is_err() && weight(f64::NAN).is_err());
    assert!(weight(1e-9).is_ok());
    assert_eq!(count(7), 7);
}

#[test]
fn every_change_is_read() {
    let settings = json!({
        "pi1": 3.0, "pi2": 0.25, "pi3": 2.0, "pi4": 5.0, "contacts": "closest", "stepping": "velocity",
        "relinearise": 0, "attraction": {"kind": "voronoi"}, "noise": 0.5, "publish_every": 4,
        "make_room": true, "measures": ["nematic"], "max_idle_secs": 60.0,
    });
    let expected = Settings {
        pi1: Some(3.0),
        pi2: Some(0.25),
        pi3: Some(2.0),
        pi4: Some(5.0),
        contacts: Some(ContactRule::Closest),
        stepping: Some(Stepping::Velocity),
        relinearise: Some(false),
        attraction: Some(Attraction::Voronoi),
        noise: Some(0.5),
        publish_every: Some(4),
        make_room: true,
        measures: Some(vec!["nematic".into()]),
        max_idle_secs: Some(Some(60.0)),
    };
    assert_eq!(
        read(json!({"verb": "set", "args": settings})),
        Change::Set(expected)
    );
    let selections = [
        (json!({"ids": [3, 1]}), Selection::Ids(vec![3, 1])),
        (json!({"count": 4}), Selection::Count(4)),
        (json!({"fraction": 0.25}), Selection::Fraction(0.25)),
        (
            json!({"within": {"x": 1.0, "y": 2.0, "radius": 3.0}}),
            Selection::Within {
                x: 1.0,
                y: 2.0,
                radius: 3.0,
            },
        ),
        (json!({"informed": true}), Selection::Informed(true)),
        (
            json!({"foremost": {"count": 2, "along": 0.5}}),
            Selection::Foremost {
                count: 2,
                along: 0.5,
            },
        ),
    ];
    for (select, selection) in selections {
        let args = json!({"select": select, "direction": 1.5, "weight": 0.75, "for_time": 8.0});
        let expected = Change::Inform {
            selection: selection.clone(),
            direction: 1.5,
            weight: Some(0.75),
            for_time: Some(8.0),
        };
        assert_eq!(read(json!({"verb": "inform", "args": args})), expected);
        let args = json!({"select": select});
        let uninform = read(json!({"verb": "uninform", "args": args}));
        assert_eq!(uninform, Change::Uninform(selection.clone()));
        let remove = read(json!({"verb": "remove", "args": args}));
        assert_eq!(remove, Change::Remove(selection));
    }
    let inject = |args: Value| match read(json!({"verb": "inject", "args": args})) {
        Change::Inject { place, informed } => (place, informed),
        other => panic!("{other:?}"),
    };
    assert_eq!(inject(json!({"count": 2})), (Placement::Border(2), None));
    let (place, informed) = inject(json!({
        "count": 2, "within": {"x": 1.0, "y": 2.0, "radius": 3.0}, "direction": 0.5, "weight": 2.0,
    }));
    assert!(
        matches!(place, Placement::Within(2, region) if (region.x, region.y, region.radius) == (1.0, 2.0, 3.0))
    );
    assert_eq!(informed, Some((0.5, Some(2.0))));
    let (place, informed) =
        inject(json!({"at": [{"x": 1.0, "y": 2.0, "alpha": 3.0}], "direction": 0.5}));
    assert!(
        matches!(&place, Placement::At(poses) if (poses[0].x, poses[0].y, poses[0].alpha) == (1.0, 2.0, 3.0))
    );
    assert_eq!(informed, Some((0.5, None)));
}

#[test]
fn arguments_that_do_not_fit_are_rejected_with_their_field() {
    let pose = json!({"x": 0.0, "y": 0.0, "alpha": 0.0});
    let disc = json!({"x": 0.0, "y": 0.0, "radius": 1.0});
    for (verb, args, part) in [
        ("set", json!({}), "args has no parameter"),
        (
            "set",
            json!({"make_room": true, "pi2": 1.0}),
            "make_room requires",
        ),
        ("set", json!({"relinearise": 2}), "relinearise = 2"),
        ("set", json!({"publish_every": 0}), "publish_every = 0"),
        ("set", json!({"max_idle_secs": -1.0}), "max_idle_secs = -1"),
        (
            "inform",
            json!({"select": {"count": 1}, "direction": 0.0, "for_time": 0.0}),
            "for_time = 0",
        ),
        (
            "inform",
            json!({"select": {"count": 1}, "direction": 0.0, "for_time": 1.1e9}),
            "for_time = 1100000000",
        ),
        (
            "inform",
            json!({"select": {"count": 1}, "direction": 0.0, "weight": 0.0}),
            "weight = 0",
        ),
        (
            "inform",
            json!({"select": {"within": {"x": 0.0, "y": 0.0, "radius": -1.0}}, "direction": 0.0}),
            "radius = -1",
        ),
        ("inject", json!({}), "count or at is missing"),
        ("inject", json!({"count": 0}), "count adds no"),
        ("inject", json!({"at": []}), "at adds no"),
        ("inject", json!({"count": 1, "at": [pose]}), "at and count"),
        (
            "inject",
            json!({"at": [pose], "within": disc}),
            "within requires count",
        ),
        (
            "inject",
            json!({"count": 1, "weight": 1.0}),
            "weight requires direction",
        ),
    ] {
        let error = rejected(json!({"verb": verb, "args": args}));
        assert!(error.contains(part), "{verb}: {error}");
    }
    let points =
        |ids: &[u32], direction: usize, weight: Option<usize>, turn: Option<usize>| SetPoints {
            ids: ids.to_vec(),
            direction: vec![0.5; direction],
            weight: weight.map(|length| vec![2.0; length]),
            turn: turn.map(|length| vec![Some(0.25); length]),
            speed: None,
        };
    for (set, part) in [
        (points(&[1, 2], 1, None, None), "set.direction"),
        (points(&[1, 2], 2, Some(1), None), "set.weight"),
        (points(&[1, 2], 2, None, Some(3)), "set.turn"),
        (points(&[2, 2], 2, None, None), "set.ids"),
    ] {
        let error = set_points(set).unwrap_err();
        assert!(
            matches!(error, ArgsError::Field { field, .. } if field == part),
            "{error}"
        );
    }
    let read = set_points(points(&[2, 1], 2, Some(2), Some(2))).unwrap();
    assert_eq!((read.ids, read.direction), (vec![2, 1], vec![0.5, 0.5]));
    assert_eq!(read.weight, Some(vec![2.0, 2.0]));
    let drives = read.drives.unwrap();
    assert!(
        drives
            .iter()
            .all(|drive| (drive.turn, drive.speed) == (Some(0.25), None))
    );
    assert_eq!(
        set_points(points(&[1], 1, None, None)).unwrap().drives,
        None
    );
}

#[test]
fn a_rejected_change_has_its_code_and_field() {
    let mut simulation = Simulation::new(&Spec::new(4, 1)).unwrap();
    let mut code_of = |value: Value| {
        let error = simulation.apply(&read(value)).unwrap_err();
        (
            error.code(),
            error.details(&Place::default())["field"].clone(),
        )
    };
    let all = json!({"fraction": 1.0});
    let at = json!([{"x": 1e7, "y": 0.0, "alpha": 0.0}]);
    let tiny = json!({"x": 900.0, "y": 0.0, "radius": 1e-3});
    for (value, code, field) in [
        (
            json!({"verb": "set", "args": {"pi1": 99.0}}),
            ErrorCode::InvalidArgument,
            json!("pi1"),
        ),
        (
            json!({"verb": "remove", "args": {"select": all}}),
            ErrorCode::InvalidArgument,
            json!("select"),
        ),
        (
            json!({"verb": "remove", "args": {"select": {"ids": [77]}}}),
            ErrorCode::InvalidArgument,
            json!("select.ids"),
        ),
        (
            json!({"verb": "remove", "args": {"select": {"count": 9}}}),
            ErrorCode::InvalidArgument,
            json!("select.count"),
        ),
        (
            json!({"verb": "inject", "args": {"at": at}}),
            ErrorCode::InvalidArgument,
            json!("at[0].x"),
        ),
        (
            json!({"verb": "inject", "args": {"count": 9, "within": tiny}}),
            ErrorCode::ResourceExhausted,
            json!("count"),
        ),
    ] {
        assert_eq!(code_of(value.clone()), (code, field), "{value}");
    }
    let reserve = ChangeError::from(ReserveError::NoMemory {
        n: 9,
        needed: 8,
        free: 7,
    });
    assert_eq!(reserve.code(), ErrorCode::ResourceExhausted);
    assert_eq!(
        Value::Object(reserve.details(&Place::default())),
        json!({"field": "n", "n": 9, "needed": 8, "free": 7})
    );
    let limit = ChangeError::from(ReserveError::TooMany { n: 9, limit: 8 });
    assert_eq!(
        Value::Object(limit.details(&Place::default())),
        json!({"field": "n", "n": 9, "limit": 8})
    );
    let cross = ChangeError::AxesCross { pairs: 3 };
    assert_eq!(cross.code(), ErrorCode::IncorrectState);
    assert_eq!(
        Value::Object(cross.details(&Place::default())),
        json!({"field": "contacts", "pairs": 3})
    );
    let mut spec = Spec::new(50, 1);
    spec.start = Start::Disc(Some(1.0));
    let full = Simulation::new(&spec).err().unwrap();
    assert_eq!(full.code(), ErrorCode::ResourceExhausted);
    assert_eq!(full.details(&Place::default())["field"], "start.radius");
}

#[test]
fn a_range_is_that_of_the_field_of_this_message_without_indices() {
    let of_verb = Place::of_verb;
    let of_key = |noun: &str| Place::of_key(&format!("jostle/{noun}"));
    for (place, field, range) in [
        (
            of_verb("inform"),
            "weight",
            Some("a number above 0, at most 1e6"),
        ),
        (
            of_verb("advance"),
            "set.weight[3]",
            Some("a number from 0 to 1e6"),
        ),
        (
            of_verb("control"),
            "set.weight",
            Some("a number from 0 to 1e6"),
        ),
        (
            of_verb("batch").within("commands[2].args"),
            "weight",
            Some("a number above 0, at most 1e6"),
        ),
        (
            of_verb("fired").within("commands[2].args"),
            "for_time",
            Some("a number above 0, at most 1e9"),
        ),
        (of_verb("inject"), "count", Some("a whole number from 1")),
        (
            of_verb("inject"),
            "at[7].alpha",
            Some("a number from -1e6 to 1e6"),
        ),
        (of_verb("inject"), "at[7].x", None),
        (
            of_verb("create").within("spec"),
            "start.alpha[1]",
            Some("a number from -1e6 to 1e6"),
        ),
        (
            of_verb("create").within("spec"),
            "n",
            Some("a whole number from 1 to the daemon's max_individuals"),
        ),
        (
            of_verb("record"),
            "begin.steps",
            Some("a whole number from 1 to 9007199254740991"),
        ),
        (of_verb("record"), "begin.format", Some("\"mcap\"")),
        (
            of_verb("step"),
            "steps",
            Some("a whole number from 1 to 1e9"),
        ),
        (
            of_verb("step"),
            "at_step",
            Some("a whole number from 0 to 9007199254740991"),
        ),
        (
            of_key("a/cmd/step"),
            "timeout_secs",
            Some("a number above 0, at most 3600"),
        ),
        (
            of_key("a/get/wait"),
            "timeout_secs",
            Some("a number above 0, at most 30"),
        ),
        (
            of_key("a/get/events"),
            "limit",
            Some("a whole number from 1 to 1000"),
        ),
        (
            of_key("@node/b/experiment/c/series"),
            "limit",
            Some("a whole number from 1 to 40000"),
        ),
        (
            of_key("@node/b/get/audit"),
            "limit",
            Some("a whole number from 1 to 1000"),
        ),
        (of_key("a/state"), "format", Some("`json` or `cbor`")),
        (of_key("a/get/events"), "weight", None),
        (of_key("a/get/journal"), "client", None),
        (of_verb("step"), "weight", None),
        (of_verb("step"), "", None),
        (of_verb("inform"), ".", None),
        (of_verb("inform"), "[", None),
        (of_verb("bake"), "steps", None),
        (Place::default(), "steps", None),
    ] {
        assert_eq!(place.range(field), range, "{place:?} {field}");
    }
}

/// So that the key of a query is that of one channel.
#[test]
fn the_nouns_of_queries_with_parameters_are_different() {
    let with = CHANNELS.iter().filter(|it| !it.parameters.is_empty());
    let nouns: Vec<_> = with.filter_map(|it| it.key.rsplit('/').next()).collect();
    let set: BTreeSet<_> = nouns.iter().collect();
    assert_eq!(set.len(), nouns.len());
}

/// Adds the paths of all fields of a value that `schema` describes, without indices.
fn add_paths(schema: &Value, root: &Value, path: &str, paths: &mut BTreeSet<String>) {
    if let Some(name) = schema["$ref"].as_str() {
        let definition = &root["$defs"][name.trim_start_matches("#/$defs/")];
        add_paths(definition, root, path, paths);
    }
    for kind in ["oneOf", "anyOf"] {
        for variant in schema[kind].as_array().into_iter().flatten() {
            add_paths(variant, root, path, paths);
        }
    }
    if schema["items"].is_object() {
        add_paths(&schema["items"], root, path, paths);
    }
    for (name, field) in schema["properties"].as_object().into_iter().flatten() {
        let dot = if path.is_empty() { "" } else { "." };
        let path = format!("{path}{dot}{name}");
        add_paths(field, root, &path, paths);
        paths.insert(path);
    }
}

/// `tests/ranges.txt` has the range of each field of each request, as errors give it: `JOSTLE_RECORD=1`
/// writes it.
#[test]
fn the_range_of_each_field_is_the_recorded_one() {
    let mut listed = String::new();
    for (message, schema) in schemas() {
        if !is_received(message) {
            continue;
        }
        let place = match message.strip_suffix(".args") {
            Some(verb) => Place::of_verb(verb),
            None => Place::of_key("a/cmd/pause"),
        };
        let (schema, mut paths) = (schema.to_value(), BTreeSet::new());
        add_paths(&schema, &schema, "", &mut paths);
        for path in paths {
            let range = place.range(&path).unwrap_or("-");
            listed += &format!("{message} {path}: {range}\n");
        }
    }
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/ranges.txt");
    if env::var_os("JOSTLE_RECORD").is_some() {
        fs::write(file, &listed).unwrap();
    }
    let recorded = fs::read_to_string(file).unwrap();
    for (now, before) in listed.lines().zip(recorded.lines()) {
        assert_eq!(now, before);
    }
    assert_eq!(listed.lines().count(), recorded.lines().count());
}
