//! Since when the comparisons of a condition hold.

use jostle_measures::View;
use serde::{Deserialize, Serialize};

use crate::condition::{Condition, Node};

/// The steps since which the comparisons of a condition hold without interruption.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct Held(Vec<Option<u64>>);

impl From<Vec<Option<u64>>> for Held {
    /// One step for each comparison, in the order of the text; `None` if it does not hold.
    fn from(since: Vec<Option<u64>>) -> Self {
        Held(since)
    }
}

impl Held {
    /// Returns the first of these steps for each observed comparison, in the order of the text.
    #[must_use]
    pub fn steps(&self) -> &[Option<u64>] {
        &self.0
    }

    /// Returns the first of these steps, by the index of the comparison; none if the comparison does
    /// not hold.
    #[must_use]
    pub fn since(&self, comparison: usize) -> Option<u64> {
        self.0.get(comparison).copied().flatten()
    }
}

impl Condition {
    /// Evaluates the condition on the state after `step` steps. Call it once for each step, in order,
    /// and with the same `held`.
    ///
    /// A comparison with a duration holds if it was fulfilled at each observed step since one that
    /// lies at least the duration back: `for 20` with `dt = 0.02` requires 1,001 states in a row.
    pub fn observe(&self, view: &View<'_>, step: u64, dt: f64, held: &mut Held) -> bool {
        if held.0.len() != self.comparisons.len() {
            held.0.resize(self.comparisons.len(), None);
        }
        for (comparison, since) in self.comparisons.iter().zip(&mut held.0) {
            *since = comparison
                .is_fulfilled_by(comparison.measure.value(view))
                .then(|| since.filter(|&first| first <= step).unwrap_or(step));
        }
        self.is_true(&self.root, step, dt, held)
    }

    fn is_true(&self, node: &Node, step: u64, dt: f64, held: &Held) -> bool {
        match node {
            Node::Comparison(index) => {
                let comparison = &self.comparisons[*index];
                let lasts = |first| step - first >= comparison.steps(dt);
                held.0[*index].is_some_and(lasts)
            }
            Node::All(nodes) => nodes.iter().all(|it| self.is_true(it, step, dt, held)),
            Node::Any(nodes) => nodes.iter().any(|it| self.is_true(it, step, dt, held)),
        }
    }
}
