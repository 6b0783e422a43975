//! Which swarms a verb lists or changes, and the confirmation of those that were not named.

use std::io::{self, BufRead as _, IsTerminal as _, Write as _};

use jostle_client::{Client, Error};
use jostle_conditions::{Selection, Value};
use jostle_proto::SwarmSummary;

use crate::arguments::{FilterArguments, SwarmsArguments};
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::values::Names;

/// The swarms of all reachable daemons, or of the named one, by name.
pub async fn summaries(client: &Client) -> Result<Vec<SwarmSummary>, Error> {
    let mut swarms = Vec::new();
    for node in client.nodes_to_query().await? {
        swarms.extend(client.swarms_of(&node).await?);
    }
    swarms.sort_by(|a, b| a.swarm.cmp(&b.swarm));
    swarms.dedup_by(|a, b| a.swarm == b.swarm);
    Ok(swarms)
}

impl FilterArguments {
    /// Whether it leaves nothing out.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty() && self.condition.is_none()
    }

    /// Checks that the swarms that are named, not matched, exist.
    pub fn check_named(&self, there: &[SwarmSummary]) -> Result<(), Failure> {
        let missing = self.names.iter().find_map(|names| match names {
            Names::One(name) if !there.iter().any(|it| it.swarm == *name) => Some(name.clone()),
            Names::One(_) | Names::Matching(_) => None,
        });
        missing.map_or(Ok(()), |swarm| {
            let there = there.iter().map(|it| it.swarm.clone()).collect();
            Err(Error::NoSwarm { swarm, there }.into())
        })
    }

    /// Whether it lists a swarm.
    pub fn lists(&self, swarm: &SwarmSummary) -> bool {
        let is_named = |names: &Names| match names {
            Names::One(name) => *name == swarm.swarm,
            Names::Matching(pattern) => pattern.matches(&swarm.swarm),
        };
        let condition = self.condition.as_ref();
        (self.names.is_empty() || self.names.iter().any(is_named))
            && condition.is_none_or(|it| selects(it, swarm))
    }
}

/// Whether a selection holds for a swarm; its fields are those of `values::selection`.
fn selects(condition: &Selection, swarm: &SwarmSummary) -> bool {
    condition.selects(|field| {
        let number = match field {
            "phase" => return Some(Value::Word(swarm.phase.name().into())),
            "n" => Some(swarm.n as f64),
            "informed" => Some(swarm.informed as f64),
            "order" => Some(swarm.order),
            "step" => Some(swarm.step as f64),
            "time" => Some(swarm.time),
            "rate" => swarm.rate,
            "actual" => swarm.real_time_factor,
            _ => None,
        };
        number.map(Value::Number)
    })
}

/// The names of the swarms that `verb` is sent to, without duplicates, confirmed unless each was
/// named. They are chosen once, before the first command.
pub async fn chosen(
    context: &Context,
    verb: &str,
    arguments: &SwarmsArguments,
) -> Result<Vec<String>, Failure> {
    let swarms = resolve(&context.client, arguments).await?;
    if swarms.len() > 1 && arguments.sending.sender.request_id.is_some() {
        return Err(Failure::argument(
            "--request-id",
            format!(
                "is the id of one request, but each {verb} is a request: {verb} one swarm at a time"
            ),
        ));
    }
    let has_pattern = |names: &Names| matches!(names, Names::Matching(_));
    if !arguments.yes && (arguments.condition.is_some() || arguments.names.iter().any(has_pattern))
    {
        confirm(context, verb, &swarms).await?;
    }
    Ok(swarms)
}

/// The names of the protected swarms, which `delete` leaves.
async fn protected(client: &Client) -> Result<Vec<String>, Failure> {
    let there = summaries(client).await?.into_iter();
    let protected = there.filter(|it| it.protected);
    Ok(protected.map(|it| it.swarm).collect())
}

async fn resolve(client: &Client, arguments: &SwarmsArguments) -> Result<Vec<String>, Failure> {
    let SwarmsArguments {
        names, condition, ..
    } = arguments;
    let is_one = |names: &Names| matches!(names, Names::One(_));
    // All swarms, and those of them for which the condition holds.
    let (there, held): (Vec<String>, Vec<String>) = match condition {
        None if names.iter().all(is_one) => (Vec::new(), Vec::new()),
        None => {
            let there = client.swarms().await?;
            (there.clone(), there)
        }
        Some(condition) => {
            let there = summaries(client).await?;
            let held = there.iter().filter(|it| selects(condition, it));
            let held = held.map(|it| it.swarm.clone()).collect();
            (there.into_iter().map(|it| it.swarm).collect(), held)
        }
    };
    let mut swarms = Vec::new();
    if names.is_empty() {
        swarms.clone_from(&held);
    }
    for one in names {
        let matching: Vec<String> = match one {
            Names::One(name) if condition.is_none() => vec![name.clone()],
            Names::One(name) if !there.contains(name) => {
                let swarm = name.clone();
                return Err(Error::NoSwarm { swarm, there }.into());
            }
            Names::One(name) => held.iter().filter(|it| *it == name).cloned().collect(),
            Names::Matching(pattern) if !there.iter().any(|it| pattern.matches(it)) => {
                let message = format!("no swarm matches {pattern}: `jostle list` lists them");
                return Err(Failure::new("not_found", message));
            }
            Names::Matching(pattern) => {
                let matching = held.iter().filter(|it| pattern.matches(it));
                matching.cloned().collect()
            }
        };
        for swarm in matching {
            if !swarms.contains(&swarm) {
                swarms.push(swarm);
            }
        }
    }
    match swarms.is_empty() {
        true => Err(Failure::new(
            "not_found",
            "the condition of --where holds for no swarm: `jostle list` lists them",
        )),
        false => Ok(swarms),
    }
}

/// Lists the swarms and asks for confirmation on a terminal.
async fn confirm(context: &Context, verb: &str, swarms: &[String]) -> Result<(), Failure> {
    let count = format::count(swarms.len() as u64, "swarm");
    let list = swarms.join(", ");
    if context.output.json || !io::stdin().is_terminal() || !io::stderr().is_terminal() {
        return Err(Failure::argument(
            "--yes",
            format!(
                "is required to {verb} by pattern or --where when there is no terminal for a \
                 confirmation; it matches {count}: {list}"
            ),
        ));
    }
    let protected = match verb {
        "delete" => protected(&context.client).await?,
        _ => Vec::new(),
    };
    let lines = swarms.iter().map(|swarm| match protected.contains(swarm) {
        true => format!("{swarm} (protected: is not deleted)\n"),
        false => format!("{swarm}\n"),
    });
    let left = swarms.iter().filter(|it| !protected.contains(it)).count();
    let left = format::count(left as u64, "swarm");
    let question = format!("{}{verb} {left}? [y/N] ", lines.collect::<String>());
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
            format!("not confirmed: no swarm was {}", participle(verb)),
        )),
    }
}

fn participle(verb: &str) -> &'static str {
    match verb {
        "delete" => "deleted",
        "pause" => "paused",
        "protect" => "protected",
        "unprotect" => "unprotected",
        _ => "run",
    }
}

/// Sends a verb to each swarm; if it fails for one, continues with the others.
pub async fn each(
    output: Output,
    verb: &str,
    swarms: &[String],
    mut send: impl AsyncFnMut(&str) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let mut last = None;
    for swarm in swarms {
        match send(swarm).await {
            Ok(()) => {}
            Err(failure) if swarms.len() == 1 || failure.code() == "interrupted" => {
                return Err(failure);
            }
            Err(failure) => {
                let failure = Failure::not_done(swarm, participle(verb), failure);
                if let Some(earlier) = last.replace(failure) {
                    output.failure(&earlier);
                }
            }
        }
    }
    last.map_or(Ok(()), Err)
}
