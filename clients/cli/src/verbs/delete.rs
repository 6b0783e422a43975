//! `delete`: swarms by their names, or by patterns of names.

use std::io::{self, BufRead as _, IsTerminal as _, Write as _};

use jostle_proto::Reply;
use jostle_proto::verbs::{DeleteArgs, EmptyResult};

use crate::arguments::DeleteArguments;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::values::Names;
use crate::verbs::print_outcome;

/// Deletes swarms; if one cannot be deleted, continues with the others.
///
/// A pattern is matched once, before the first swarm is deleted.
///
/// # Errors
///
/// The reason why nothing was deleted, or the failure of the last swarm that could not be deleted;
/// earlier failures are printed.
pub async fn delete(bus: &Bus, output: Output, arguments: &DeleteArguments) -> Result<(), Failure> {
    let DeleteArguments {
        names,
        yes,
        sending,
    } = arguments;
    let swarms = resolve(bus, names).await?;
    if swarms.len() > 1 && sending.sender.request_id.is_some() {
        return Err(Failure::Argument {
            argument: "--request-id".into(),
            problem: "names one request, and each swarm is one of its own".into(),
        });
    }
    let is_late = [sending.at_step, sending.expect_epoch, sending.expect_step];
    if bus.named_node().is_some() && is_late.iter().any(Option::is_some) {
        return Err(Failure::Argument {
            argument: "--node".into(),
            problem: "deletes a daemon's swarm at once: leave out --at-step and --expect-…".into(),
        });
    }
    let has_pattern = names.iter().any(|it| matches!(it, Names::Matching(_)));
    if has_pattern && !yes {
        confirm(output, &swarms).await?;
    }
    let is_one = swarms.len() == 1;
    let mut last = None;
    for swarm in swarms {
        let deleted = match bus.named_node() {
            Some(_) => bus.discard(&swarm, &sending.sender).await,
            None => bus.command(&swarm, "delete", &DeleteArgs {}, sending).await,
        };
        match deleted {
            Ok(answer) => {
                print_outcome(output, &answer, "delete", |reply: &Reply<EmptyResult>| {
                    format!(
                        "deleted {} at step {}, time {}",
                        reply.swarm,
                        reply.step,
                        format::time(reply.time)
                    )
                })?;
            }
            Err(failure) if is_one => return Err(failure),
            Err(failure) => {
                let failure = Failure::NotDeleted {
                    swarm,
                    failure: Box::new(failure),
                };
                if let Some(earlier) = last.replace(failure) {
                    output.failure(&earlier);
                }
            }
        }
    }
    last.map_or(Ok(()), Err)
}

/// The names of the swarms that are meant, each once.
async fn resolve(bus: &Bus, names: &[Names]) -> Result<Vec<String>, Failure> {
    let mut there = None;
    let mut swarms = Vec::new();
    for one in names {
        let matching = match one {
            Names::One(name) => vec![name.clone()],
            Names::Matching(pattern) => {
                if there.is_none() {
                    there = Some(bus.swarms().await?);
                }
                let there = there.iter().flatten();
                let matching = there.filter(|name| pattern.matches(name));
                let matching: Vec<String> = matching.cloned().collect();
                if matching.is_empty() {
                    return Err(Failure::NoMatch {
                        pattern: pattern.to_string(),
                    });
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

/// Lists what is to be deleted and asks, on a terminal.
async fn confirm(output: Output, swarms: &[String]) -> Result<(), Failure> {
    let count = format::count(swarms.len() as u64, "swarm");
    let list = swarms.join(", ");
    if output.json || !io::stdin().is_terminal() || !io::stderr().is_terminal() {
        return Err(Failure::Argument {
            argument: "--yes".into(),
            problem: format!(
                "is required to delete by pattern when there is no terminal for a confirmation; it \
                 matches {count}: {list}"
            ),
        });
    }
    let question = format!("{}\ndelete {count}? [y/N] ", swarms.join("\n"));
    // A thread of its own: the runtime ends without waiting for it.
    let answer = tokio::task::spawn_blocking(move || {
        let mut stderr = io::stderr().lock();
        stderr.write_all(question.as_bytes())?;
        stderr.flush()?;
        let mut answer = String::new();
        io::stdin().lock().read_line(&mut answer)?;
        io::Result::Ok(answer)
    });
    let answer = answer.await.map_err(Failure::defect)?;
    match answer.map_err(Failure::Output)?.trim() {
        "y" | "Y" | "yes" => Ok(()),
        _ => Err(Failure::Declined),
    }
}
