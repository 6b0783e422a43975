//! `delete`: deletes swarms by name or by pattern.

use std::io::{self, BufRead as _, IsTerminal as _, Write as _};

use jostle_client::Client;
use jostle_proto::Reply;
use jostle_proto::verbs::{DeleteArgs, EmptyResult};

use crate::arguments::DeleteArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::values::Names;

/// Deletes swarms; if one cannot be deleted, continues with the others.
///
/// A pattern is matched once, before the first swarm is deleted.
pub async fn delete(context: &Context, arguments: &DeleteArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let DeleteArguments {
        names,
        yes,
        sending,
    } = arguments;
    let swarms = resolve(client, names).await?;
    if swarms.len() > 1 && sending.sender.request_id.is_some() {
        return Err(Failure::argument(
            "--request-id",
            "is the id of one request, but each deletion is a request: delete one swarm at a time",
        ));
    }
    let is_late = [sending.at_step, sending.expect_epoch, sending.expect_step];
    if client.named_node().is_some() && is_late.iter().any(Option::is_some) {
        return Err(Failure::argument(
            "--node",
            "deletes a daemon's swarm at once: leave out --at-step and --expect-…",
        ));
    }
    let has_pattern = names.iter().any(|it| matches!(it, Names::Matching(_)));
    if has_pattern && !yes {
        confirm(*output, &swarms).await?;
    }
    let is_one = swarms.len() == 1;
    let mut last = None;
    for swarm in swarms {
        let deleted = match client.named_node() {
            Some(_) => client.discard(&swarm, &sending.sender).await,
            None => {
                client
                    .command(&swarm, "delete", &DeleteArgs {}, sending)
                    .await
            }
        };
        match deleted.map_err(Failure::from) {
            Ok(answer) => {
                output.outcome(&answer, "delete", |reply: &Reply<EmptyResult>| {
                    let (swarm, time) = (&reply.swarm, format::time(reply.time));
                    format!("deleted {swarm} at step {}, time {time}", reply.step)
                })?;
            }
            Err(failure) if is_one => return Err(failure),
            Err(failure) => {
                let failure = Failure::not_deleted(&swarm, failure);
                if let Some(earlier) = last.replace(failure) {
                    output.failure(&earlier);
                }
            }
        }
    }
    last.map_or(Ok(()), Err)
}

/// The names of the swarms to delete, without duplicates.
async fn resolve(client: &Client, names: &[Names]) -> Result<Vec<String>, Failure> {
    let mut there = None;
    let mut swarms = Vec::new();
    for one in names {
        let matching = match one {
            Names::One(name) => vec![name.clone()],
            Names::Matching(pattern) => {
                if there.is_none() {
                    there = Some(client.swarms().await?);
                }
                let there = there.iter().flatten();
                let matching = there.filter(|name| pattern.matches(name));
                let matching: Vec<String> = matching.cloned().collect();
                if matching.is_empty() {
                    let message = format!("no swarm matches {pattern}: `jostle list` lists them");
                    return Err(Failure::new("not_found", message));
                }
                matching
            }
        };
        for swarm in matching {
            if !swarms.contains(&swarm) {
                swarms.push(swarm);
            }
        }
    }
    Ok(swarms)
}

/// Lists the swarms and asks for confirmation on a terminal.
async fn confirm(output: Output, swarms: &[String]) -> Result<(), Failure> {
    let count = format::count(swarms.len() as u64, "swarm");
    let list = swarms.join(", ");
    if output.json || !io::stdin().is_terminal() || !io::stderr().is_terminal() {
        return Err(Failure::argument(
            "--yes",
            format!(
                "is required to delete by pattern when there is no terminal for a confirmation; it \
                 matches {count}: {list}"
            ),
        ));
    }
    let question = format!("{}\ndelete {count}? [y/N] ", swarms.join("\n"));
    // Reads on a separate thread, for which the runtime does not wait at its shutdown.
    let answer = tokio::task::spawn_blocking(move || {
        let mut stderr = io::stderr().lock();
        stderr.write_all(question.as_bytes())?;
        stderr.flush()?;
        let mut answer = String::new();
        io::stdin().lock().read_line(&mut answer)?;
        io::Result::Ok(answer)
    });
    let answer = answer.await.map_err(Failure::defect)?;
    match answer.map_err(Failure::output)?.trim() {
        "y" | "Y" | "yes" => Ok(()),
        _ => Err(Failure::new(
            "interrupted",
            "not confirmed: nothing was deleted",
        )),
    }
}
