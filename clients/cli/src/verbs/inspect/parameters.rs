//! `parameters`: the values, defaults and ranges of a swarm's parameters.

use jostle_proto::{Parameter, ParameterKind, Parameters, Reply};

use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::table;

pub async fn parameters(context: &Context, swarm: &str) -> Result<(), Failure> {
    let answer = context.client.get(swarm, "parameters").await?;
    context.output.reply(&answer, |reply: &Reply<Parameters>| {
        let parameters = &reply.result.parameters;
        let table = table::of(
            parameters,
            [
                ("parameter", |it| it.name.clone()),
                ("now", |it| format::value(&it.value, it.nullable)),
                ("default", |it| format::value(&it.default, it.nullable)),
                ("range", range),
                ("changed by", |it| match it.changed_by.as_slice() {
                    [] => format::NONE.into(),
                    verbs => verbs.join(", "),
                }),
            ],
        );
        let docs: Vec<String> = parameters.iter().map(meaning).collect();
        table::documented(&table, &docs)
    })
}

fn range(parameter: &Parameter) -> String {
    let Parameter {
        minimum,
        exclusive_minimum,
        maximum,
        choices,
        nullable,
        ..
    } = parameter;
    if parameter.kind == ParameterKind::Choice {
        let choices: Vec<String> = choices
            .iter()
            .map(|choice| format::value(choice, false))
            .collect();
        return choices.join(", ");
    }
    let mut text = match (minimum, exclusive_minimum, maximum) {
        (Some(least), _, Some(most)) if least.to_bits() == most.to_bits() => {
            format!("only {}", format::number(*least))
        }
        (Some(least), _, Some(most)) => {
            format!("{} to {}", format::number(*least), format::number(*most))
        }
        (Some(least), _, None) => format!("{} or more", format::number(*least)),
        (None, Some(least), Some(most)) => format!(
            "above {}, to {}",
            format::number(*least),
            format::number(*most)
        ),
        (None, Some(least), None) => format!("above {}", format::number(*least)),
        (None, None, Some(most)) => format!("0 to {}", format::number(*most)),
        (None, None, None) => format::NONE.into(),
    };
    if *nullable {
        text.push_str(", or max");
    }
    text
}

/// The description without the range, which has a column of its own, and with the unit.
fn meaning(parameter: &Parameter) -> String {
    let Parameter { doc, unit, .. } = parameter;
    let end = doc.find([':', ';', '.']).unwrap_or(doc.len());
    let counted = unit.split(" /").next().unwrap_or_default();
    let is_said = unit == "1" || doc.to_lowercase().contains(counted);
    let unit = if is_said {
        String::new()
    } else {
        format!(" [{unit}]")
    };
    format!("{}{unit}", &doc[..end])
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use jostle_proto::contract;

    use super::*;

    #[test]
    fn ranges_and_values_read_as_people_write_them() {
        let parameters = contract::parameters();
        let of = |name: &str| {
            let parameter = parameters.iter().find(|it| it.name == name).unwrap();
            let default = format::value(&parameter.default, parameter.nullable);
            format!("{} | {default}", range(parameter))
        };
        assert_eq!(of("n"), "1 or more | -");
        assert_eq!(of("pi1"), "1 to 32 | 4");
        assert_eq!(of("pi3"), "above 0, to 1e6 | 1");
        assert_eq!(of("contacts"), "endpoints, closest, clamped | endpoints");
        assert_eq!(
            of("attraction"),
            "all, voronoi, metric, topological, power | all"
        );
        assert_eq!(of("rate"), "above 0, to 1e6, or max | 1");
        assert_eq!(format::value(&serde_json::Value::Null, true), "max");
    }

    #[test]
    fn the_description_ends_before_the_range() {
        let parameters = contract::parameters();
        let of = |name: &str| meaning(parameters.iter().find(|it| it.name == name).unwrap());
        assert_eq!(of("pi1"), "Length over width of a body");
        assert_eq!(of("dt"), "The time step [body size / free speed]");
        assert_eq!(of("n"), "The number of individuals");
    }
}
