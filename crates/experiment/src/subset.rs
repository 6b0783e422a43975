//! Subsets of a plan's runs: the parts of an experiment that several machines execute.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};
use std::fmt::{self, Display};

use thiserror::Error;

use crate::limits::MAX_RUNS;
use crate::plan::{Plan, Point};
use jostle_physics::model::ContactRule;

/// Some of the runs of a plan, by their indices, in the plan's order.
///
/// Its text lists the numbers of the runs, which count from 1: `17,18,40-60`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Subset(Vec<usize>);

/// Why a subset is rejected.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum SubsetError {
    /// An entry of the list is neither a number nor an ascending range.
    #[error("invalid runs {text:?}: use a number or an ascending range such as 40-60")]
    Syntax {
        /// The entry.
        text: String,
    },
    /// A run does not exist.
    #[error("there is no run {number}: the experiment has runs 1 to {runs}")]
    NoRun {
        /// The number.
        number: usize,
        /// Number of runs of the plan.
        runs: usize,
    },
    /// A part does not exist.
    #[error("invalid part {number}/{of}: use K/N with 1 <= K <= N <= {MAX_RUNS}")]
    NoPart {
        /// The number of the part, from 1.
        number: usize,
        /// Number of parts.
        of: usize,
    },
}

impl Subset {
    /// Returns the subset of all runs.
    #[must_use]
    pub fn all(plan: &Plan) -> Self {
        Self((0..plan.runs().len()).collect())
    }

    /// Returns the subset of these indices.
    #[must_use]
    pub fn of(mut indices: Vec<usize>) -> Self {
        indices.sort_unstable();
        indices.dedup();
        Self(indices)
    }

    /// Returns part `number` of `of` parts, which count from 1; see [`Self::split`].
    ///
    /// # Errors
    ///
    /// [`SubsetError::NoPart`].
    pub fn part(plan: &Plan, number: usize, of: usize) -> Result<Self, SubsetError> {
        let is_valid = (1..=of).contains(&number) && of as u64 <= MAX_RUNS;
        match is_valid {
            true => Ok(Self::all(plan).split(plan, of).swap_remove(number - 1)),
            false => Err(SubsetError::NoPart { number, of }),
        }
    }

    /// Parses a list of numbers and ranges, such as `17,18,40-60`.
    ///
    /// # Errors
    ///
    /// [`SubsetError::Syntax`] and [`SubsetError::NoRun`].
    pub fn parse(plan: &Plan, text: &str) -> Result<Self, SubsetError> {
        let runs = plan.runs().len();
        let number = |text: &str| match text.trim().parse() {
            Ok(number) if (1..=runs).contains(&number) => Ok(number),
            Ok(number) => Err(SubsetError::NoRun { number, runs }),
            Err(_) => Err(SubsetError::Syntax { text: text.into() }),
        };
        let mut indices = BTreeSet::new();
        for entry in text.split(',') {
            let (first, last) = entry.split_once('-').unwrap_or((entry, entry));
            let syntax = || SubsetError::Syntax { text: entry.into() };
            let named = |error| match error {
                SubsetError::Syntax { .. } => syntax(),
                other => other,
            };
            let (first, last) = (number(first).map_err(named)?, number(last).map_err(named)?);
            if first > last {
                return Err(syntax());
            }
            indices.extend(first - 1..last);
        }
        Ok(Self(indices.into_iter().collect()))
    }

    /// Returns the indices of its runs in the plan, in ascending order.
    #[must_use]
    pub fn indices(&self) -> &[usize] {
        &self.0
    }

    /// Returns the runs that are in both.
    #[must_use]
    pub fn and(&self, other: &Self) -> Self {
        let both = self.0.iter().filter(|it| other.0.binary_search(it).is_ok());
        Self(both.copied().collect())
    }

    /// Returns the sum of the expected times of its runs, in seconds of one core.
    #[must_use]
    pub fn expected_secs(&self, plan: &Plan) -> f64 {
        // An empty sum of floats is -0.
        0.0 + self.points(plan).map(Point::expected_secs).sum::<f64>()
    }

    /// Returns the expected time of its longest run, in seconds of one core.
    #[must_use]
    pub fn longest_secs(&self, plan: &Plan) -> f64 {
        self.points(plan)
            .map(Point::expected_secs)
            .fold(0.0, f64::max)
    }

    /// Returns the settings of its runs, in the plan's order.
    pub(crate) fn points<'a>(&'a self, plan: &'a Plan) -> impl Iterator<Item = &'a Point> {
        let runs = self.0.iter().map(|&index| &plan.runs()[index]);
        runs.map(|run| plan.point(run))
    }

    /// Splits it into `parts` subsets of nearly equal expected time, by the rule "longest processing
    /// time first": assigns the runs in descending order of expected time, each to the part with the
    /// smallest total so far. The result depends only on the plan, so every machine splits it in the
    /// same way. With fewer runs than parts some are empty.
    #[must_use]
    pub fn split(&self, plan: &Plan, parts: usize) -> Vec<Self> {
        let cost = |index: usize| plan.point(&plan.runs()[index]).expected_secs();
        let mut runs: Vec<(f64, usize)> = self.0.iter().map(|&it| (cost(it), it)).collect();
        runs.sort_by(|one, other| other.0.total_cmp(&one.0).then(one.1.cmp(&other.1)));
        // The bit patterns of non-negative floats sort like the floats.
        let mut least: BinaryHeap<Reverse<(u64, usize)>> =
            (0..parts).map(|part| Reverse((0, part))).collect();
        let mut split = vec![Vec::new(); parts];
        for (cost, index) in runs {
            if let Some(Reverse((bits, part))) = least.pop() {
                split[part].push(index);
                let total = f64::from_bits(bits) + cost;
                least.push(Reverse((total.to_bits(), part)));
            }
        }
        split.into_iter().map(Self::of).collect()
    }
}

impl Display for Subset {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let chunks = self.0.chunk_by(|one, other| one + 1 == *other);
        for (place, chunk) in chunks.enumerate() {
            let comma = if place > 0 { "," } else { "" };
            let (first, last) = (chunk[0] + 1, chunk[chunk.len() - 1] + 1);
            match chunk.len() {
                1 => write!(to, "{comma}{first}")?,
                2 => write!(to, "{comma}{first},{last}")?,
                _ => write!(to, "{comma}{first}-{last}")?,
            }
        }
        Ok(())
    }
}

impl Point {
    /// Estimates the time of a run, in seconds of one core.
    ///
    /// No result depends on it. It determines the order of runs, how they are split into parts and
    /// tasks, the reported progress, and the time limit in Slurm scripts. Measured for n from 3 to 74, π1 from 1 to 8, and the rules `endpoints` and `closest`: correct
    /// within a factor of 2, and within 3 for small or round bodies under `closest`, whose longer
    /// steps have more contacts.
    #[must_use]
    pub fn expected_secs(&self) -> f64 {
        let n = self.spec.n as f64;
        let parameters = &self.spec.parameters;
        let step = 0.5 + 0.2 * n + 0.003 * n * n;
        let rule_factor = match parameters.contacts {
            ContactRule::Closest if parameters.pi1 > 1.0 => 1.0 + n / 20.0,
            _ => 1.0,
        };
        let programs = if parameters.relinearise { 2.0 } else { 1.0 };
        self.steps as f64 * 1e-6 * step * rule_factor * programs
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn plan() -> Plan {
        let text = "name = \"a\"\nduration = 20\nreplicates = 5\n[[grid]]\nn = [3, 40]\n\
                    pi1 = [1, 4]\n";
        Plan::parse(text).unwrap()
    }

    fn indices(text: &str) -> Vec<usize> {
        Subset::parse(&plan(), text).unwrap().indices().to_vec()
    }

    #[test]
    fn lists_and_ranges_count_from_one_and_are_printed_in_the_same_form() {
        assert_eq!(indices("1"), [0]);
        assert_eq!(indices("20,3-5, 4 ,1"), [0, 2, 3, 4, 19]);
        for text in ["1", "1,2", "1-3", "1,3,4,6-9,20"] {
            assert_eq!(Subset::parse(&plan(), text).unwrap().to_string(), text);
        }
        assert_eq!(Subset::all(&plan()).to_string(), "1-20");
        assert_eq!(Subset::of(vec![]).to_string(), "");
    }

    #[test]
    fn lists_that_name_no_run_are_rejected() {
        let rejected = |text| Subset::parse(&plan(), text).unwrap_err();
        for text in ["", ",", "a", "1-", "-1", "5-3", "1.5", "1-2-3", "٣"] {
            let is_syntax = matches!(rejected(text), SubsetError::Syntax { .. });
            assert!(is_syntax, "{text:?}: {}", rejected(text));
        }
        for (text, number) in [("0", 0), ("21", 21), ("3,19-22", 22)] {
            assert_eq!(rejected(text), SubsetError::NoRun { number, runs: 20 });
        }
    }

    #[test]
    fn parts_are_disjoint_complete_and_balanced() {
        let plan = plan();
        for of in [1, 2, 3, 7, 20, 25] {
            let parts: Vec<Subset> = (1..=of)
                .map(|number| Subset::part(&plan, number, of).unwrap())
                .collect();
            let mut union: Vec<usize> = parts.iter().flat_map(|it| it.0.clone()).collect();
            union.sort_unstable();
            assert_eq!(union, Subset::all(&plan).0, "{of} parts");
            let costs: Vec<f64> = parts.iter().map(|it| it.expected_secs(&plan)).collect();
            let (most, least) = (
                costs.iter().copied().fold(0.0, f64::max),
                costs.iter().copied().fold(f64::INFINITY, f64::min),
            );
            // By no more than the longest run.
            assert!(
                most - least <= Subset::all(&plan).longest_secs(&plan),
                "{costs:?}"
            );
        }
        for (number, of) in [(0, 3), (4, 3), (1, 0), (1, 100_001)] {
            let error = Subset::part(&plan, number, of).unwrap_err();
            assert_eq!(error, SubsetError::NoPart { number, of });
        }
    }

    #[test]
    fn a_plan_is_split_in_the_same_way_by_every_version() {
        // Machines with different versions of the program execute parts of one experiment. The ten
        // longer runs, 6 to 10 and 16 to 20, go to the parts in turn, and then the shorter ones.
        let parts = Subset::all(&plan()).split(&plan(), 3);
        let texts: Vec<String> = parts.iter().map(Subset::to_string).collect();
        let expected = ["6,9,17,20", "1,3,5,7,10,12,14,18", "2,4,8,11,13,15,16,19"];
        assert_eq!(texts, expected);
    }
}
