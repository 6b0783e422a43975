//! States and their measures for the tests of the page, which computes some measures itself.

use std::fs;
use std::path::Path;

use jostle_measures::{Measure, Past, View};
use jostle_physics::model::{Attraction, State};
use jostle_physics::simulation::{Simulation, Spec};
use serde_json::{Value, json};

/// Writes the fixture instead of comparing it.
const RECORD: &str = "JOSTLE_RECORD";

/// The command that a failure prints.
const COMMAND: &str = "JOSTLE_RECORD=1 cargo test --release -p jostle-measures fixture";

/// The measures that the page computes.
const MEASURES: [&str; 3] = ["clusters.count", "clusters.largest", "clusters.n_eff"];

/// Groups with many small clusters, with a large one, without contacts, and of one individual.
fn states() -> Vec<State> {
    let nearby = Attraction::Metric { radius: 1.5 };
    [
        (50, 4.0, None, 0),
        (50, 4.0, None, 400),
        (60, 1.0, None, 200),
        (40, 12.0, None, 150),
        (120, 4.0, Some(nearby), 300),
        (1, 4.0, None, 3),
    ]
    .map(|(n, pi1, attraction, steps)| {
        let mut spec = Spec::new(n, 7);
        spec.parameters.pi1 = pi1;
        spec.parameters.attraction = attraction.unwrap_or(spec.parameters.attraction);
        let mut simulation = Simulation::new(&spec).unwrap();
        for _ in 0..steps {
            simulation.step().unwrap();
        }
        simulation.state
    })
    .to_vec()
}

#[test]
fn the_page_has_the_fixture_of_these_states() {
    let past = Past::new(0);
    let groups = states().into_iter().map(|state| {
        let view = View::new(&state, &past);
        let value = |name: &&str| {
            let measure: Measure = name.parse().unwrap();
            ((*name).to_owned(), json!(measure.evaluate(&view)))
        };
        let configuration = &state.configuration;
        json!({
            "pi1": state.parameters.pi1,
            "x": configuration.x,
            "y": configuration.y,
            "alpha": configuration.alpha,
            "measures": MEASURES.iter().map(value).collect::<serde_json::Map<String, Value>>(),
        })
    });
    let groups: Vec<String> = groups.map(|group| group.to_string()).collect();
    let text = format!("[\n{}\n]\n", groups.join(",\n"));
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/states.json");
    if std::env::var_os(RECORD).is_some() {
        fs::write(&file, &text).unwrap();
    }
    let stored = fs::read_to_string(&file).unwrap_or_default();
    assert!(stored == text, "{} differs: {COMMAND}", file.display());
}
