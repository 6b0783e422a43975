//! Groups with ties everywhere: lattices, rings and rows, whose neighbours are equally far and whose
//! contacts are equally deep.

use std::f64::consts::PI;

use serde_json::{Value, json};

use crate::scenario::Scenario;

/// A pose: x and y in body sizes, and the heading.
type Pose = [f64; 3];

const CONTACTS: [&str; 3] = ["endpoints", "closest", "clamped"];

/// Returns each arrangement under each law of attraction and a contact rule.
pub fn all() -> impl Iterator<Item = Scenario> {
    let laws = [
        json!({"kind": "all"}),
        json!({"kind": "voronoi"}),
        json!({"kind": "metric", "radius": 3.0}),
        json!({"kind": "topological", "neighbours": 3}),
    ];
    let numbered = arrangements().into_iter().enumerate();
    numbered.flat_map(move |(index, (pi1, poses))| {
        let laws = laws.clone().into_iter().enumerate();
        laws.map(move |(law, attraction)| {
            let contacts = CONTACTS[(index + law) % CONTACTS.len()];
            scenario(pi1, &poses, &attraction, contacts)
        })
    })
}

fn scenario(pi1: f64, poses: &[Pose], attraction: &Value, contacts: &str) -> Scenario {
    let column = |k: usize| poses.iter().map(|it| it[k]).collect::<Vec<_>>();
    let start = json!({"kind": "given", "x": column(0), "y": column(1), "alpha": column(2)});
    let mut scenario = Scenario::new(&json!({"create": {"spec": {
        "n": poses.len(), "pi1": pi1, "start": start, "attraction": attraction, "contacts": contacts,
    }}}));
    let foremost = json!({"foremost": {"count": 2, "along": 0.0}});
    let args = json!({"select": foremost, "direction": PI / 2.0});
    scenario.step(60, 10);
    scenario.send(&json!({"apply": {"change": {"verb": "inform", "args": args}}}));
    scenario.step(60, 10);
    scenario.send(&json!({"measures": {"measures": ["order", "milling", "radius_of_gyration"]}}));
    scenario
}

/// Returns the arrangements: `pi1` and the poses.
fn arrangements() -> Vec<(f64, Vec<Pose>)> {
    let mut found = Vec::new();
    // A body of pi1 = 4 is 1.6 long and 0.4 wide, a disc has the diameter 1.
    for (pi1, spacing) in [(1.0, 1.0), (1.0, 1.25), (4.0, 2.0)] {
        for side in [2, 4, 7] {
            found.push((pi1, lattice(side, spacing, |_, _| 0.0)));
            found.push((
                pi1,
                lattice(side, spacing, |i, j| f64::from((i + j) % 2) * PI),
            ));
        }
        // The angles of 12 and 16 poses on a circle are multiples of a fraction of a turn.
        for count in [12, 16] {
            let radius = spacing * f64::from(count) / 4.0;
            found.push((pi1, ring(count, radius, 0.0)));
            found.push((pi1, ring(count, radius, PI / 2.0)));
        }
    }
    found.push((
        4.0,
        (0..40).map(|i| [2.0 * f64::from(i), 0.0, 0.0]).collect(),
    ));
    found.push((
        4.0,
        (0..40).map(|i| [0.0, 0.4 * f64::from(i), 0.0]).collect(),
    ));
    found
}

fn lattice(side: u32, spacing: f64, heading: impl Fn(u32, u32) -> f64) -> Vec<Pose> {
    let at = |i: u32, j: u32| {
        [
            spacing * f64::from(i),
            spacing * f64::from(j),
            heading(i, j),
        ]
    };
    (0..side)
        .flat_map(|i| (0..side).map(move |j| (i, j)))
        .map(|(i, j)| at(i, j))
        .collect()
}

/// Returns poses on a circle, turned from the radius by an angle.
fn ring(count: u32, radius: f64, turned: f64) -> Vec<Pose> {
    let at = |k: u32| {
        let angle = 2.0 * PI * f64::from(k) / f64::from(count);
        let (sine, cosine) = libm::sincos(angle);
        [radius * cosine, radius * sine, angle + turned]
    };
    (0..count).map(at).collect()
}
