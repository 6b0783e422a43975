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
        held.0.resize(self.comparisons.len(), None);
        let mut holds = Vec::with_capacity(self.comparisons.len());
        for (comparison, since) in self.comparisons.iter().zip(&mut held.0) {
            *since = comparison
                .is_fulfilled_by(comparison.measure.evaluate(view))
                .then(|| since.filter(|&first| first <= step).unwrap_or(step));
            holds.push(since.is_some_and(|first| step - first >= comparison.steps(dt)));
        }
        is_true(&self.root, &holds)
    }
}

fn is_true(node: &Node, holds: &[bool]) -> bool {
    match node {
        Node::Comparison(index) => holds[*index],
        Node::All(nodes) => nodes.iter().all(|node| is_true(node, holds)),
        Node::Any(nodes) => nodes.iter().any(|node| is_true(node, holds)),
    }
}
