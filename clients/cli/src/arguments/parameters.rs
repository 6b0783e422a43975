//! The options of `create` for the parameters that are a plain number, and what `set` changes, from the
//! contract.

use std::sync::LazyLock;

use clap::builder::ValueParser;
use clap::{Arg, ArgMatches, Args, Command, Error, FromArgMatches};
use jostle_proto::contract::{parameters, schema};
use jostle_proto::{LARGEST_WHOLE, Parameter, ParameterKind};
use serde_json::{Map, Value};

use crate::{format, values};

/// Numbers with an option of their own form.
const OTHERS: [&str; 2] = ["n", "relinearise"];

/// The plain numbers: each with the name of its option.
static NUMBERS: LazyLock<Vec<(String, Parameter)>> = LazyLock::new(|| {
    let is_plain = |it: &Parameter| {
        let is_number = matches!(it.kind, ParameterKind::Number | ParameterKind::Integer);
        is_number && !it.nullable && !OTHERS.contains(&it.name.as_str())
    };
    let plain = parameters().into_iter().filter(is_plain);
    plain.map(|it| (it.name.replace('_', "-"), it)).collect()
});

/// The fields that an assignment of `set` can name, in the order of a spec: each with what it is.
pub static ASSIGNED: LazyLock<Vec<(String, String)>> = LazyLock::new(|| {
    let schema = schema("set.args").unwrap_or_default().to_value();
    let fields = schema["properties"].as_object().into_iter().flatten();
    let fields = fields.filter(|(name, _)| *name != "make_room");
    let doc = |field: &Value| field["description"].as_str().unwrap_or_default().to_owned();
    let mut fields: Vec<_> = fields.map(|(name, it)| (name.clone(), doc(it))).collect();
    let spec = parameters();
    let place = |name: &str| spec.iter().position(|it| it.name == name);
    fields.sort_by_key(|(name, _)| place(name).unwrap_or(spec.len()));
    fields
});

/// The help of the assignments of `set`.
pub fn help_of_assignments() -> String {
    let names: Vec<&str> = ASSIGNED.iter().map(|(name, _)| name.as_str()).collect();
    let (last, first) = names.split_last().unwrap_or((&"", &[]));
    format!(
        "{} or {last}, such as pi1=6, attraction=metric=3 or measures=drift,milling",
        first.join(", ")
    )
}

/// The given numbers, by the names of the parameters.
#[derive(Clone, Debug, Default)]
pub struct NumberArguments(pub Map<String, Value>);

impl FromArgMatches for NumberArguments {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        let mut given = NumberArguments::default();
        given.update_from_arg_matches(matches)?;
        Ok(given)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        for (option, parameter) in NUMBERS.iter() {
            let value = match parameter.kind {
                ParameterKind::Integer => matches.get_one::<u64>(option).copied().map(Value::from),
                _ => matches.get_one::<f64>(option).copied().map(Value::from),
            };
            self.0.extend(value.map(|it| (parameter.name.clone(), it)));
        }
        Ok(())
    }
}

impl Args for NumberArguments {
    fn augment_args(command: Command) -> Command {
        command.args(NUMBERS.iter().map(|(option, it)| argument(option, it)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

fn argument(option: &'static str, parameter: &'static Parameter) -> Arg {
    let doc = parameter.doc.trim_end_matches('.');
    let of = match parameter.name.as_str() {
        // Which is the default of a spec, and of a file that `--spec` names.
        "pi1" => "the daemon's default: ",
        _ => "default: ",
    };
    let default = parameter.default.as_f64().map(format::number);
    let help = format!("{doc} [{of}{}]", default.unwrap_or_default());
    let argument = Arg::new(option).long(option).help(help);
    match parameter.kind {
        ParameterKind::Integer => {
            let least = parameter.minimum.unwrap_or(0.0);
            let most = parameter.maximum.unwrap_or(LARGEST_WHOLE as f64);
            let whole = move |text: &str| values::whole_between(text, [least, most]);
            argument
                .value_name("WHOLE")
                .value_parser(ValueParser::new(whole))
                .allow_negative_numbers(true)
        }
        _ => argument
            .value_name("NUMBER")
            .value_parser(values::number)
            .allow_hyphen_values(true),
    }
}
