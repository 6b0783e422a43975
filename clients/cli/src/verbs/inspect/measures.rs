//! `measures`: measures of a swarm, and the list of all measures.

use jostle_measures::{Definition, definitions};
use jostle_proto::{MeasureValue, Measures, Reply};
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
        true => format!("{} (experiments only)", definition.formula),
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
        assert!(meaning(of("msd")).contains("experiments only"));
        assert!(!meaning(of("order")).contains("experiments only"));
    }
}
