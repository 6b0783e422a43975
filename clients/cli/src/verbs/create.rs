//! `create`: a spec from options, from a file, or from both.

use std::path::Path;

use jostle_proto::Reply;
use jostle_proto::verbs::CreateResult;
use serde_json::{Map, Value, json};

use crate::arguments::CreateArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::file;
use crate::format;
use crate::values::{self, Law, Rate};

pub async fn create(context: &Context, arguments: &CreateArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let args = json!({
        "name": arguments.name,
        "spec": spec(arguments)?,
        "exist_ok": arguments.exist_ok,
    });
    let answer = client
        .command_node("create", &args, &arguments.sender)
        .await?;
    output.reply(&answer, |reply: &Reply<CreateResult>| {
        let CreateResult {
            created,
            spec,
            state_hash,
        } = &reply.result;
        let (swarm, position) = (&reply.swarm, format::position(reply));
        if *created {
            let n = format::count(spec.n, "individual");
            format!("created {swarm} of {n}, {position}\nstate hash {state_hash}")
        } else {
            format!("{swarm} already exists with an equal spec, {position}")
        }
    })
}

/// The new swarm of a `fork` or a `restore`.
pub fn describe_copy(verb: &str, from: &str, reply: &Reply<CreateResult>) -> String {
    let (swarm, position) = (&reply.swarm, format::position(reply));
    let hash = &reply.result.state_hash;
    format!("{verb} {swarm}{from}, {position}\nstate hash {hash}")
}

/// The spec of the file, if given, overridden by the options; the daemon validates it.
fn spec(arguments: &CreateArguments) -> Result<Map<String, Value>, Failure> {
    let mut spec = match &arguments.spec {
        Some(path) => read(path)?,
        None => Map::new(),
    };
    spec.extend(arguments.numbers.0.clone());
    let mut put = |field: &str, value: Option<Value>| {
        if let Some(value) = value {
            spec.insert(field.into(), value);
        }
    };
    put("n", arguments.n.map(Value::from));
    put("contacts", arguments.contacts.clone().map(Value::from));
    put("stepping", arguments.stepping.clone().map(Value::from));
    put("relinearise", arguments.relinearise.map(Value::from));
    let law = arguments.attraction.clone();
    put("attraction", law.map(|Law(law)| law));
    let all = |accuracy| json!({"kind": "all", "accuracy": accuracy});
    put("attraction", arguments.accuracy.map(all));
    let measures = arguments.measures.as_deref().map(values::measures);
    put("measures", measures.map(Value::from));
    put("rate", arguments.rate.map(|Rate(rate)| Value::from(rate)));
    let disc = |radius| json!({"kind": "disc", "radius": radius});
    put("start", arguments.radius.map(disc));
    Ok(spec)
}

fn read(path: &Path) -> Result<Map<String, Value>, Failure> {
    let wrong = |problem: String| Failure::argument("--spec", problem);
    let text = file::read(path).map_err(wrong)?;
    serde_json::from_str(&text)
        .map_err(|error| wrong(format!("{} is not a JSON object: {error}", path.display())))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use clap::Parser;

    use super::*;
    use crate::arguments::{Arguments, Verb};

    fn spec_of(line: &str) -> Value {
        let line = ["jostle", "create", "demo"]
            .into_iter()
            .chain(line.split(' '));
        match Arguments::try_parse_from(line).unwrap().verb {
            Verb::Create(arguments) => Value::Object(spec(&arguments).unwrap()),
            verb => panic!("{verb:?}"),
        }
    }

    #[test]
    fn options_that_are_left_out_are_left_to_the_daemon() {
        assert_eq!(spec_of("--n 50"), json!({"n": 50}));
        assert_eq!(
            spec_of("--n 50 --rate max --radius 9 --seed 3"),
            json!({"n": 50, "rate": null, "seed": 3, "start": {"kind": "disc", "radius": 9.0}})
        );
        assert_eq!(
            spec_of("--n 50 --accuracy 1e-6"),
            json!({"n": 50, "attraction": {"kind": "all", "accuracy": 1e-6}})
        );
        assert_eq!(
            spec_of("--n 50 --attraction metric=3 --noise 0.1 --contacts closest --relinearise"),
            json!({"n": 50, "attraction": {"kind": "metric", "radius": 3}, "noise": 0.1,
                "contacts": "closest", "relinearise": 1})
        );
        assert_eq!(
            spec_of("--n 50 --stepping velocity --relinearise=0"),
            json!({"n": 50, "stepping": "velocity", "relinearise": 0})
        );
    }

    #[test]
    fn options_override_the_file() {
        let path = std::env::temp_dir().join(format!("jostle-spec-{}.json", std::process::id()));
        std::fs::write(&path, r#"{"n": 5, "pi1": 6, "rate": 2, "colour": "red"}"#).unwrap();
        let spec = spec_of(&format!("--spec {} --pi1 -3 --rate max", path.display()));
        std::fs::remove_file(&path).unwrap();
        assert_eq!(
            spec,
            json!({"n": 5, "pi1": -3.0, "rate": null, "colour": "red"}),
            "the daemon reports what is wrong with it"
        );
    }
}
