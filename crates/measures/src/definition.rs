//! What the registry says about a measure.

use std::ops::Bound;

use crate::view::View;

/// One entry of the registry.
#[derive(Clone, Copy, Debug)]
pub struct Definition {
    /// Its name, such as `clusters.count`.
    pub name: &'static str,
    /// Its unit; `1` if it has none. `v0` is the free speed, `s/v0` the unit of time.
    pub unit: &'static str,
    /// What it is, in one line.
    pub formula: &'static str,
    /// The equation or the publication that defines it.
    pub source: &'static str,
    /// The values that it can have.
    pub range: &'static str,
    /// How its cost grows with the number n of individuals in a group of given density: `n` or
    /// `n log n`.
    pub cost: &'static str,
    /// Whether it depends on which individuals are informed.
    pub is_of_informed: bool,
    /// Its argument, if it has one.
    pub argument: Option<Argument>,
    /// How far back its past reaches.
    pub(crate) lag: Lag,
    /// Evaluates it; the number is its argument, or 0 if it has none.
    pub(crate) evaluate: fn(&View<'_>, f64) -> Option<f64>,
}

/// The argument of a measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Argument {
    /// Its name.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Its value if it is left out; `None` if it is required.
    pub default: Option<f64>,
    /// The values that it can have; never infinite.
    pub range: (Bound<f64>, Bound<f64>),
}

/// How far back the past of a measure reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lag {
    /// It has none.
    None,
    /// To the step before.
    Step,
    /// By its argument, a time.
    Argument,
}

impl Definition {
    /// What the definitions share: no argument, no past, a cost of n.
    pub(crate) const PLAIN: Self = Self {
        name: "",
        unit: "",
        formula: "",
        source: "",
        range: "",
        cost: "n",
        is_of_informed: false,
        argument: None,
        lag: Lag::None,
        evaluate: |_, _| None,
    };
}

impl Definition {
    /// The least and the greatest value that [`Definition::range`] names for a group of any size; infinite
    /// where it names none.
    #[must_use]
    pub fn limits(&self) -> (f64, f64) {
        let number = |text: Option<&str>| text.and_then(|it| it.parse::<f64>().ok());
        let (least, greatest) = match self.range.split_once(" to ") {
            Some((least, greatest)) => (number(Some(least)), number(Some(greatest))),
            None => (number(self.range.strip_prefix("at least ")), None),
        };
        (
            least.unwrap_or(f64::NEG_INFINITY),
            greatest.unwrap_or(f64::INFINITY),
        )
    }

    /// Whether it needs states before the one of which it is a measure.
    #[must_use]
    pub fn needs_past(&self) -> bool {
        self.lag != Lag::None
    }
}

impl Argument {
    /// Describes the range: `above 0`, `0 to 2`.
    #[must_use]
    pub fn range_text(&self) -> String {
        let least = match self.range.0 {
            Bound::Included(least) => shortest(least),
            Bound::Excluded(least) => format!("above {}", shortest(least)),
            Bound::Unbounded => "any".to_owned(),
        };
        match self.range.1 {
            Bound::Included(most) => format!("{least} to {}", shortest(most)),
            Bound::Excluded(most) => format!("{least} to below {}", shortest(most)),
            Bound::Unbounded => least,
        }
    }
}

/// Returns the shortest text that is read as this number: `20`, `0.9`, `1e-9`.
pub(crate) fn shortest(number: f64) -> String {
    let text = format!("{number:?}");
    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use crate::definitions;

    #[test]
    fn the_limits_are_those_of_the_range() {
        let limits = |name: &str| {
            let mut all = definitions().iter();
            all.find(|it| it.name == name)
                .map(super::Definition::limits)
        };
        for (name, expected) in [
            ("order", (0.0, 1.0)),
            ("drift", (-1.0, 1.0)),
            ("clusters.largest", (1.0, f64::INFINITY)),
            ("contacts_per_body", (0.0, f64::INFINITY)),
            ("msd", (0.0, f64::INFINITY)),
            ("neighbour_gap.q05", (f64::NEG_INFINITY, f64::INFINITY)),
        ] {
            assert_eq!(limits(name), Some(expected), "{name}");
        }
    }
}
