//! `measures`: measures of a swarm, and the list of all measures.

use jostle_measures::{Definition, definitions};
use jostle_proto::{Histogram, MeasureValue, Measures, Reply};
use serde_json::{Value, json};

use crate::arguments::MeasuresArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::table::{self, Column};

/// The significant digits of the table; `--json` has all.
const DIGITS: usize = 6;

/// Prints measures of the newest state of a swarm; by default all that need no earlier state.
pub async fn measures(context: &Context, arguments: &MeasuresArguments) -> Result<(), Failure> {
    let MeasuresArguments { name, measures, .. } = arguments;
    if let (Some(swarm), Some(histogram)) = (name, &arguments.histogram) {
        return print_histogram(context, swarm, histogram, arguments).await;
    }
    let Some(swarm) = name else {
        return list_measures(context.output);
    };
    let noun = match measures.as_slice() {
        [] => "measures".to_owned(),
        measures => format!("measures?names={}", measures.join(",")),
    };
    let answer = context.client.get(swarm, &noun).await?;
    context.output.reply(&answer, |reply: &Reply<Measures>| {
        let columns: [Column<MeasureValue>; 3] = [
            ("measure", |it| it.name.clone()),
            ("value", |it| {
                format::or_none(it.value.map(|value| format::rounded(value, DIGITS)))
            }),
            ("unit", |it| it.unit.clone()),
        ];
        let table = table::of(&reply.result.measures, columns);
        format!("{}\n{table}", format::standing(reply))
    })
}

async fn print_histogram(
    context: &Context,
    swarm: &str,
    histogram: &str,
    arguments: &MeasuresArguments,
) -> Result<(), Failure> {
    let mut noun = format!("measures?histogram={histogram}");
    if let Some(bins) = arguments.bins {
        noun += &format!(";bins={bins}");
    }
    if let Some(max) = arguments.max {
        noun += &format!(";max={max}");
    }
    let answer = context.client.get(swarm, &noun).await?;
    context.output.reply(&answer, |reply: &Reply<Measures>| {
        let rows = reply.result.histogram.as_ref().map(rows);
        format!("{}\n{}", format::standing(reply), rows.unwrap_or_default())
    })
}

/// A row for each bin: the radial one has two edges, a square four.
fn rows(histogram: &Histogram) -> String {
    let bins = histogram.edges.len() - 1;
    let bin = |k: usize| [k, k + 1].map(|k| format::rounded(histogram.edges[k], DIGITS));
    let count_and_value = |k: usize| {
        let value = format::rounded(histogram.values[k], DIGITS);
        [histogram.counts[k].to_string(), value]
    };
    if histogram.values.len() == bins {
        let row = |k: usize| {
            let ([from, to], [count, value]) = (bin(k), count_and_value(k));
            [from, to, count, value]
        };
        return table::table(
            ["from", "to", "pairs", "value"],
            (0..bins).map(row).collect(),
        );
    }
    let row = |k: usize| {
        let ([back, front], [right, left]) = (bin(k / bins), bin(k % bins));
        let [count, value] = count_and_value(k);
        [back, front, right, left, count, value]
    };
    let header = ["back", "front", "right", "left", "pairs", "value"];
    table::table(header, (0..histogram.values.len()).map(row).collect())
}

/// Lists all measures, whether or not there is a daemon.
pub fn list_measures(output: Output) -> Result<(), Failure> {
    let columns: [Column<Definition>; 3] = [
        ("measure", form),
        ("unit", |it| it.unit.to_owned()),
        ("range", |it| it.range.to_owned()),
    ];
    let table = table::of(definitions(), columns);
    let docs: Vec<String> = definitions().iter().map(meaning).collect();
    let document: Vec<Value> = definitions().iter().map(describe).collect();
    output.print(
        &json!({ "measures": document }),
        &table::documented(&table, &docs),
    )
}

fn describe(definition: &Definition) -> Value {
    json!({
        "name": definition.name,
        "argument": definition.argument.map(|it| json!({
            "name": it.name, "unit": it.unit, "default": it.default, "range": it.range_text(),
        })),
        "unit": definition.unit,
        "range": definition.range,
        "formula": definition.formula,
        "source": definition.source,
        "cost": definition.cost,
        "is_of_informed": definition.is_of_informed,
        "needs_past": definition.needs_past(),
    })
}

/// A measure with its argument: `clusters.count(gap = 0.001)`.
fn form(definition: &Definition) -> String {
    let Some(argument) = definition.argument else {
        return definition.name.to_owned();
    };
    let default = argument.default.map(|value| format!(" = {value}"));
    let default = default.unwrap_or_default();
    format!("{}({}{default})", definition.name, argument.name)
}

fn meaning(definition: &Definition) -> String {
    match definition.needs_past() {
        true => format!("{} (conditions and experiments only)", definition.formula),
        false => definition.formula.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn the_list_says_which_measures_only_experiments_have() {
        let of = |name: &str| definitions().iter().find(|it| it.name == name).unwrap();
        assert_eq!(form(of("clusters.count")), "clusters.count(gap = 0.001)");
        assert_eq!(form(of("msd")), "msd(lag)");
        assert!(meaning(of("msd")).contains("conditions and experiments only"));
        assert!(!meaning(of("order")).contains("conditions and experiments only"));
    }
}
