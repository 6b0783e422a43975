//! The selector of individuals.

use std::ops::RangeInclusive;

use clap::{ArgGroup, Args};
use jostle_proto::verbs::{Foremost, Region, Select};

use crate::values::{self, MAX_INDIVIDUALS};

/// The selector of individuals; exactly one option is given.
#[derive(Debug, Args)]
#[group(skip)]
#[command(
    next_help_heading = "Which individuals",
    group = ArgGroup::new("selection")
        .args(["ids", "count", "fraction", "within", "informed", "uninformed", "foremost"])
        .required(true)
)]
pub struct SelectionArguments {
    /// These ids and ranges of ids, such as 1,4-7
    #[arg(long, value_name = "IDS", value_delimiter = ',', value_parser = values::ids)]
    ids: Option<Vec<RangeInclusive<u32>>>,
    /// This many, drawn at random; of `uninform`: of the informed
    #[arg(long, value_name = "COUNT", value_parser = values::whole_in::<1, MAX_INDIVIDUALS>, allow_negative_numbers = true)]
    count: Option<u64>,
    /// This share of all, 0 to 1 or 0% to 100%, drawn at random; of `uninform`: of the informed
    #[arg(long, value_name = "SHARE", value_parser = values::share, allow_hyphen_values = true)]
    fraction: Option<f64>,
    /// All whose centre is in a disc
    #[arg(long, value_name = "X,Y,RADIUS", value_parser = values::region, allow_hyphen_values = true)]
    within: Option<Region>,
    /// All that have a direction of their own
    #[arg(long)]
    informed: bool,
    /// All that have no direction of their own
    #[arg(long)]
    uninformed: bool,
    /// The COUNT furthest in the direction of --along
    #[arg(
        long,
        value_name = "COUNT",
        requires = "along",
        value_parser = values::whole_in::<1, MAX_INDIVIDUALS>,
        allow_negative_numbers = true
    )]
    foremost: Option<u64>,
    /// With --foremost: the direction, counter-clockwise from +x
    #[arg(
        long,
        value_name = "RADIANS",
        requires = "foremost",
        value_parser = values::number,
        allow_hyphen_values = true
    )]
    along: Option<f64>,
}

impl SelectionArguments {
    /// The selection on the wire.
    pub fn select(&self) -> Select {
        if let Some(ids) = &self.ids {
            return Select::Ids(ids.iter().cloned().flatten().collect());
        }
        if let (Some(count), Some(along)) = (self.foremost, self.along) {
            return Select::Foremost(Foremost { count, along });
        }
        if self.informed || self.uninformed {
            return Select::Informed(self.informed);
        }
        let count = self.count.map(Select::Count);
        let fraction = self.fraction.map(Select::Fraction);
        let within = self.within.map(Select::Within);
        count
            .or(fraction)
            .or(within)
            .expect("clap lets none through")
    }
}

/// A direction in radians, from radians or degrees.
pub fn radians(direction: Option<f64>, degrees: Option<f64>) -> Option<f64> {
    direction.or(degrees.map(f64::to_radians))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        selection: SelectionArguments,
    }

    fn read(line: &str) -> Result<Select, clap::Error> {
        let line = ["x"].into_iter().chain(line.split(' '));
        Line::try_parse_from(line).map(|line| line.selection.select())
    }

    #[test]
    fn each_way_to_select_reads_as_on_the_wire() {
        let json = |line: &str| serde_json::to_string(&read(line).unwrap()).unwrap();
        assert_eq!(json("--ids 3,1,2"), r#"{"ids":[3,1,2]}"#);
        assert_eq!(json("--ids 1-5"), r#"{"ids":[1,2,3,4,5]}"#);
        assert_eq!(json("--ids 1,4-7 --ids 9"), r#"{"ids":[1,4,5,6,7,9]}"#);
        assert_eq!(json("--ids 4294967295"), r#"{"ids":[4294967295]}"#);
        assert_eq!(json("--count 5"), r#"{"count":5}"#);
        assert_eq!(json("--fraction 0.1"), r#"{"fraction":0.1}"#);
        assert_eq!(json("--fraction 10%"), r#"{"fraction":0.1}"#);
        assert_eq!(json("--fraction 12.5%"), r#"{"fraction":0.125}"#);
        assert_eq!(
            json("--within -1,2,0.5"),
            r#"{"within":{"x":-1.0,"y":2.0,"radius":0.5}}"#
        );
        assert_eq!(json("--informed"), r#"{"informed":true}"#);
        assert_eq!(json("--uninformed"), r#"{"informed":false}"#);
        assert_eq!(
            json("--foremost 3 --along -1.57"),
            r#"{"foremost":{"count":3,"along":-1.57}}"#
        );
    }

    #[test]
    fn no_selector_and_two_selectors_are_rejected() {
        for line in [
            "--count 3 --ids 1",
            "--foremost 3",
            "--informed --uninformed",
            "--informed --count 3",
            "--along 1",
            "--foremost 3 --along 1 --count 2",
            "--count -3",
            "--ids 1,x",
            "--ids 1,",
            "--ids 5-1",
            "--ids 1-",
            "--ids 1-2-3",
            "--ids 1--2",
            "--ids 0-4294967296",
            "--ids 0-4294967295",
            "--fraction ten%",
            "--fraction %",
            "--fraction 10%%",
            "--fraction nan%",
        ] {
            assert!(read(line).is_err(), "{line}");
        }
        assert!(Line::try_parse_from(["x"]).is_err());
    }

    #[test]
    fn degrees_are_turned_into_radians() {
        assert_eq!(radians(None, Some(180.0)), Some(std::f64::consts::PI));
        assert_eq!(radians(Some(-1.5), None), Some(-1.5));
        assert_eq!(radians(None, None), None);
    }
}
