//! The runs on which claims are judged.

use crate::ResultRow;
use crate::contact_statistics::ContactStatistics;
use crate::statistics::{Spread, Summary, summarise};

/// The paper's π3 and π4, for all runs but its animations.
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
    /// The summaries of the conditions of both series.
    pub summaries: Vec<Summary>,
    /// The measurements of contacts in the animations.
    pub contact_rows: Vec<ContactStatistics>,
}

/// Lists the rules of `runs` at the paper's π3 and π4, `endpoints` first.
#[must_use]
pub fn rules(runs: &[ResultRow]) -> Vec<Rule> {
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
    /// Selects the runs of `rule`. Runs that a fault ended early are excluded.
    #[must_use]
    pub fn new(rule: &Rule, runs: &[ResultRow], contact_rows: &[ContactStatistics]) -> Self {
        let steps_of = |run: &&ResultRow| run.contacts == rule.contacts && run.dt == rule.dt;
        let longest = |run: &ResultRow| {
            let alike = runs.iter().filter(|it| it.n == run.n && it.dt == run.dt);
            alike.map(|it| it.time).fold(0.0, f64::max)
        };
        let whole = runs.iter().filter(steps_of);
        let whole = whole.filter(|run| run.time >= longest(run) * (1.0 - 1e-9));
        let paper = whole.filter(|run| run.pi3 == PI3 && run.pi4 == PI4);
        let runs: Vec<ResultRow> = paper.cloned().collect();
        let contact_rows = contact_rows
            .iter()
            .filter(|it| it.contacts == rule.contacts);
        Self {
            summaries: summarise(&runs),
            contact_rows: contact_rows.cloned().collect(),
        }
    }

    /// Returns the conditions of the first series with bodies of `pi1`, ordered by n.
    pub fn uninformed(&self, pi1: f64) -> Vec<&Summary> {
        let all = self.summaries.iter();
        all.filter(|it| it.condition.informed == 0 && it.condition.pi1 == pi1)
            .collect()
    }

    /// Returns one condition of the first series.
    pub fn one(&self, pi1: f64, n: u64) -> Option<&Summary> {
        self.uninformed(pi1)
            .into_iter()
            .find(|it| it.condition.n == n)
    }

    /// Returns the conditions of the second series.
    pub fn informed(&self) -> impl Iterator<Item = &Summary> {
        let all = self.summaries.iter();
        all.filter(|it| it.condition.informed > 0)
    }

    /// Returns the drift of one condition of the second series.
    pub fn drift(&self, pi1: f64, n: u64, informed: u64) -> Option<Spread> {
        let mut all = self.informed();
        let found = all.find(|it| {
            let condition = &it.condition;
            condition.pi1 == pi1 && condition.n == n && condition.informed == informed
        });
        found?.v_pd
    }
}
