//! The runs that claims are asked of.

use crate::Run;
use crate::statistics::{Spread, Summary, summarise};
use crate::touch::Touch;

/// The paper's turning and drag numbers, for all but its animations.
const PI3: f64 = 1.0;
const PI4: f64 = 10.0;

/// A contact rule and a time step.
#[derive(Clone, Debug, PartialEq)]
pub struct Rule {
    /// The contact rule.
    pub contacts: String,
    /// The time step.
    pub dt: f64,
}

/// The runs of one rule.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    /// The conditions of both series.
    pub summaries: Vec<Summary>,
    /// What was seen of contacts in the animations.
    pub touches: Vec<Touch>,
}

/// Which rules there are runs of, `endpoints` first.
#[must_use]
pub fn rules(runs: &[Run]) -> Vec<Rule> {
    let mut rules = Vec::new();
    for summary in summarise(runs) {
        let condition = summary.condition;
        let rule = Rule {
            contacts: condition.contacts,
            dt: condition.dt,
        };
        if condition.pi3 == PI3 && condition.pi4 == PI4 && !rules.contains(&rule) {
            rules.push(rule);
        }
    }
    rules
}

impl Evidence {
    /// Takes the runs of `rule`. Those that ended early, by a fault, do not count.
    #[must_use]
    pub fn new(rule: &Rule, runs: &[Run], touches: &[Touch]) -> Self {
        let steps_of = |run: &&Run| run.contacts == rule.contacts && run.dt == rule.dt;
        let longest = |run: &Run| {
            let alike = runs.iter().filter(|it| it.n == run.n && it.dt == run.dt);
            alike.map(|it| it.time).fold(0.0, f64::max)
        };
        let whole = runs.iter().filter(steps_of);
        let whole = whole.filter(|run| run.time >= longest(run) * (1.0 - 1e-9));
        let paper = whole.filter(|run| run.pi3 == PI3 && run.pi4 == PI4);
        let runs: Vec<Run> = paper.cloned().collect();
        let touches = touches.iter().filter(|it| it.contacts == rule.contacts);
        Self {
            summaries: summarise(&runs),
            touches: touches.cloned().collect(),
        }
    }

    /// The conditions of the first series with bodies of `pi1`, by n.
    pub fn uninformed(&self, pi1: f64) -> Vec<&Summary> {
        let all = self.summaries.iter();
        all.filter(|it| it.condition.informed == 0 && it.condition.pi1 == pi1)
            .collect()
    }

    /// One condition of the first series.
    pub fn one(&self, pi1: f64, n: u64) -> Option<&Summary> {
        self.uninformed(pi1)
            .into_iter()
            .find(|it| it.condition.n == n)
    }

    /// The conditions of the second series.
    pub fn informed(&self) -> impl Iterator<Item = &Summary> {
        let all = self.summaries.iter();
        all.filter(|it| it.condition.informed > 0)
    }

    /// The drift of one condition of the second series.
    pub fn drift(&self, pi1: f64, n: u64, informed: u64) -> Option<Spread> {
        let mut all = self.informed();
        let found = all.find(|it| {
            let condition = &it.condition;
            condition.pi1 == pi1 && condition.n == n && condition.informed == informed
        });
        found?.v_pd
    }
}
