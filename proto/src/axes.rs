//! The axes of the grids of experiments.

use std::sync::LazyLock;

use crate::ParameterKind;
use crate::contract::parameters;

/// What a `[[grid]]` of an experiment may vary.
#[derive(Debug)]
pub struct Axis {
    /// Its name.
    pub name: String,
    /// Whether its values are text, and not numbers.
    pub is_text: bool,
    /// Whether earlier versions lack it, so that their experiments may have a variable of its name.
    pub is_later: bool,
}

/// The first axes, in the order in which the names of runs contain them.
const FIRST: [&str; 13] = [
    "pi1",
    "pi2",
    "pi3",
    "pi4",
    "n",
    "informed",
    "informed_fraction",
    "contacts",
    "dt",
    "stepping",
    "relinearise",
    "attraction",
    "noise",
];

/// Parameters that no grid varies: they are no part of the physics, or other keys of a file give them.
const NO_AXES: [&str; 4] = ["seed", "publish_every", "measures", "rate"];

/// Every axis, in the order in which the names of runs contain them: a later parameter follows.
pub static AXES: LazyLock<Vec<Axis>> = LazyLock::new(|| {
    let parameters = parameters();
    let names = parameters.iter().map(|it| it.name.as_str());
    let later = names.filter(|name| !FIRST.contains(name) && !NO_AXES.contains(name));
    let all = FIRST.into_iter().chain(later);
    all.map(|name| Axis {
        name: name.to_owned(),
        is_text: parameters
            .iter()
            .any(|it| it.name == name && it.kind == ParameterKind::Choice),
        is_later: !FIRST.contains(&name),
    })
    .collect()
});

impl Axis {
    /// Returns the axis of a name.
    pub fn of(name: &str) -> Option<&'static Axis> {
        AXES.iter().find(|it| it.name == name)
    }
}
