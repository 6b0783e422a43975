//! `when`: an action once a condition holds.

use jostle_client::Payload;
use jostle_proto::verbs::{WhenArgs, WhenResult};
use jostle_proto::{Reply, Status, WaitingCondition};
use serde_json::Value;
use serde_json::value::RawValue;

use crate::arguments::{CommandArguments, SendingArguments, WhenArguments};
use crate::context::Context;
use crate::failure::Failure;
use crate::file;
use crate::format::standing;
use crate::table::{self, Column};

pub async fn when(context: &Context, arguments: &WhenArguments) -> Result<(), Failure> {
    let WhenArguments {
        command,
        condition,
        commands,
        cancel,
        ..
    } = arguments;
    let CommandArguments { name, sending } = command;
    let Some(condition) = condition else {
        if cancel.is_none() {
            return list(context, name).await;
        }
        let id = cancel.clone().flatten();
        let args = WhenArgs {
            cancel: cancel.is_some(),
            id: id.clone(),
            ..WhenArgs::default()
        };
        let describe = |reply: &Reply<WhenResult>| {
            let swarm = &reply.swarm;
            let what = match &id {
                Some(id) => format!("{swarm} no longer waits for the condition {id}"),
                None => format!("{swarm} waits for no condition"),
            };
            format!("{what}; {}", standing(reply))
        };
        return context.execute(command, &args, describe).await;
    };
    let answer = match commands {
        None => pause_when(context, name, condition, sending).await?,
        Some(path) => {
            let wrong = |problem| Failure::argument("--commands", problem);
            let text = file::read(path).map_err(wrong)?;
            let args = with_commands(condition, &text)
                .map_err(|problem| wrong(format!("{}: {problem}", path.display())))?;
            context.client.command(name, "when", &args, sending).await?
        }
    };
    let describe = |reply: &Reply<WhenResult>| {
        format!("{} waits for {condition}; {}", reply.swarm, standing(reply))
    };
    context.output.outcome(&answer, "when", describe)
}

/// Lists the conditions that wait.
async fn list(context: &Context, swarm: &str) -> Result<(), Failure> {
    let answer = context.client.get(swarm, "status").await?;
    let reply: Reply<Status> = answer.read()?;
    let columns: [Column<WaitingCondition>; 4] = [
        ("id", |it| it.id.clone()),
        ("condition", |it| it.condition.clone()),
        ("action", table::action),
        ("client", table::client),
    ];
    let if_empty = format!("{swarm} waits for no condition");
    let conditions = &reply.result.conditions;
    context.output.list(&answer, conditions, columns, &if_empty)
}

/// Removes the condition of this id.
pub async fn cancel(context: &Context, swarm: &str, id: &str) -> Result<(), jostle_client::Error> {
    let args = WhenArgs {
        cancel: true,
        id: Some(id.to_owned()),
        ..WhenArgs::default()
    };
    let sending = &SendingArguments::default();
    let answer = context.client.command(swarm, "when", &args, sending);
    answer.await.map(|_| ())
}

/// Has a swarm pause once a condition holds.
pub async fn pause_when(
    context: &Context,
    swarm: &str,
    condition: &str,
    sending: &SendingArguments,
) -> Result<Payload, Failure> {
    let args = WhenArgs {
        condition: Some(condition.to_owned()),
        pause: true,
        ..WhenArgs::default()
    };
    Ok(context
        .client
        .command(swarm, "when", &args, sending)
        .await?)
}

/// The arguments on the wire. The changes are sent unchanged, so that the daemon can reject a duplicate
/// field.
fn with_commands(condition: &str, text: &str) -> Result<Box<RawValue>, String> {
    let error = |error: serde_json::Error| format!("is not JSON: {error}");
    let commands: &RawValue = match serde_json::from_str(text).map_err(error)? {
        Value::Array(_) => serde_json::from_str(text).map_err(error)?,
        Value::Object(fields) if fields.keys().eq(["commands"]) => {
            #[derive(serde::Deserialize)]
            struct Commands<'a> {
                #[serde(borrow)]
                commands: &'a RawValue,
            }
            let whole: Commands = serde_json::from_str(text).map_err(error)?;
            whole.commands
        }
        _ => return Err("is neither a JSON list nor {\"commands\": …} alone".into()),
    };
    let condition = Value::from(condition);
    let whole = format!("{{\"condition\": {condition}, \"commands\": {commands}}}");
    RawValue::from_string(whole).map_err(error)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn changes_are_sent_as_they_are() {
        let list = r#"[{"verb": "set", "args": {"pi3": 1, "pi3": 2}}]"#;
        let expected = format!(r#"{{"condition": "order > \"", "commands": {list}}}"#);
        for text in [list.to_owned(), format!(r#"{{"commands": {list}}}"#)] {
            assert_eq!(with_commands("order > \"", &text).unwrap().get(), expected);
        }
        for text in ["", "3", "[", r#"{"commands": [], "draw": 3}"#, "{}"] {
            assert!(with_commands("order > 0", text).is_err(), "{text:?}");
        }
    }
}
