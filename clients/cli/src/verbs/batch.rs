//! `batch`: several changes applied atomically.

use jostle_proto::Reply;
use jostle_proto::verbs::{BatchResult, Changed};
use serde_json::Value;
use serde_json::value::RawValue;

use crate::arguments::{BatchArguments, CommandArguments};
use crate::context::Context;
use crate::failure::Failure;
use crate::file;
use crate::format;
use crate::suggest::did_you_mean;
use crate::table;
use crate::verbs::individuals::individuals;
use crate::verbs::steer::advice_on_set;

/// The verbs that a batch may contain.
const CHANGES: [&str; 5] = ["set", "inform", "uninform", "inject", "remove"];

pub async fn batch(context: &Context, arguments: &BatchArguments) -> Result<(), Failure> {
    let BatchArguments { command, file } = arguments;
    let CommandArguments { name, sending } = command;
    let text = file::read(file).map_err(wrong)?;
    let args = args(&text).map_err(|problem| wrong(format!("{}: {problem}", file.display())))?;
    let meant: Value = serde_json::from_str(args.get()).unwrap_or_default();
    let answer = context.client.command(name, "batch", &args, sending).await;
    let answer = answer.map_err(|error| Failure::from(error).with_advice(advice(&meant)))?;
    let describe = |reply: &Reply<BatchResult>| {
        let results = &reply.result.results;
        let rows = results.iter().zip(1_u64..).map(|(changed, number)| {
            let (verb, outcome) = outcome(changed);
            [number.to_string(), verb.into(), outcome]
        });
        let table = table::table(["change", "verb", "outcome"], rows.collect());
        let count = format::count(results.len() as u64, "change");
        format!(
            "{count} applied to {} at step {}\n{table}",
            reply.swarm, reply.step
        )
    };
    context.output.outcome(&answer, "batch", describe)
}

/// The arguments on the wire: a list of changes, an object with it, or one change. The text is sent
/// unchanged, so that the daemon can reject a duplicate field.
fn args(text: &str) -> Result<Box<RawValue>, String> {
    let whole = match serde_json::from_str(text) {
        Ok(Value::Array(_)) => Ok(format!("{{\"commands\": {text}}}")),
        Ok(Value::Object(change)) if change.contains_key("verb") => {
            Ok(format!("{{\"commands\": [{text}]}}"))
        }
        Ok(Value::Object(_)) => Ok(text.to_owned()),
        Ok(_) => Err("is neither a JSON list nor {\"commands\": …}".into()),
        Err(error) => Err(format!("is not JSON: {error}")),
    };
    RawValue::from_string(whole?).map_err(|error| error.to_string())
}

/// A suggestion for an unknown verb or field.
fn advice(args: &Value) -> Option<String> {
    let commands = args["commands"].as_array()?;
    commands.iter().find_map(|command| {
        let verb = command["verb"].as_str()?;
        if !CHANGES.contains(&verb) {
            return did_you_mean(verb, CHANGES);
        }
        let fields = command["args"].as_object()?;
        (verb == "set").then(|| advice_on_set(fields.keys()))?
    })
}

/// The verb of a change, and its outcome.
fn outcome(changed: &Changed) -> (&'static str, String) {
    match changed {
        Changed::Set(result) => {
            let changes = table::changed(result);
            let changes: Vec<String> = changes
                .iter()
                .map(|[name, before, now]| format!("{name} {before} -> {now}"))
                .collect();
            match changes.as_slice() {
                [] => ("set", "as it was".into()),
                changes => ("set", changes.join(", ")),
            }
        }
        Changed::Inform(result) => ("inform", individuals(&result.ids)),
        Changed::Uninform(result) => ("uninform", individuals(&result.ids)),
        Changed::Inject(result) => ("inject", individuals(&result.ids)),
        Changed::Remove(result) => ("remove", individuals(&result.ids)),
    }
}

fn wrong(problem: String) -> Failure {
    Failure::argument("FILE", problem)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use jostle_proto::keys::SWARM_VERBS;
    use jostle_proto::verbs::Change;
    use serde_json::json;

    use super::*;

    #[test]
    fn a_list_and_an_object_around_it_are_sent_the_same_and_as_they_are() {
        let list = r#"[{"verb": "set", "args": {"pi3": 2}}]"#;
        let object = format!(r#"{{"commands": {list}}}"#);
        assert_eq!(args(list).unwrap().get(), object);
        assert_eq!(args(&object).unwrap().get(), object);
        let one = r#"{"verb": "set", "args": {"pi3": 2}}"#;
        assert_eq!(args(one).unwrap().get(), object);
        // The daemon rejects duplicate fields.
        let twice = r#"{"commands": [{"verb": "set", "args": {"pi3": 1, "pi3": 2}}]}"#;
        assert_eq!(args(twice).unwrap().get(), twice);
        for text in ["", "3", "\"set\"", "[", "null"] {
            assert!(args(text).is_err(), "{text:?}");
        }
    }

    #[test]
    fn a_typing_error_in_a_verb_or_a_field_is_recognised() {
        let advice = |commands: Value| advice(&json!({ "commands": commands })).unwrap_or_default();
        assert!(advice(json!([{"verb": "infrom", "args": {}}])).contains("`inform`"));
        let set = json!([{"verb": "inform", "args": {}}, {"verb": "set", "args": {"pi_1": 2}}]);
        assert!(advice(set).contains("`pi1`"));
        assert_eq!(advice(json!([{"verb": "set", "args": {"pi3": 2}}, 7])), "");
    }

    #[test]
    fn a_batch_holds_the_verbs_the_wire_allows() {
        for verb in SWARM_VERBS {
            let read = serde_json::from_value::<Change>(json!({"verb": verb, "args": {}}));
            let is_unknown =
                read.is_err_and(|error| error.to_string().starts_with("unknown variant"));
            assert_eq!(CHANGES.contains(&verb), !is_unknown, "{verb}");
        }
    }
}
