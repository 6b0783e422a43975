//! `audit`: who sent which commands to a daemon.

use std::collections::VecDeque;

use jostle_client::Client;
use jostle_proto::{Audit, AuditLine, ErrorCode, NodeReply, keys};

use crate::arguments::AuditArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::suggest::did_you_mean;
use crate::table;

/// The lines that are listed by default.
const DEFAULT_LIMIT: usize = 100;

/// The most lines of a reply.
const MAX_PAGE_LINES: usize = 1000;

pub async fn audit(context: &Context, arguments: &AuditArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    if let (Some(since), Some(until)) = (arguments.since, arguments.until)
        && since > until
    {
        let problem = "it is before --since; a duration is that long ago, so --since 3h --until 2h \
                       is an hour";
        return Err(Failure::argument("--until", problem));
    }
    let limit = match arguments.all {
        true => usize::MAX,
        false => arguments.limit.unwrap_or(DEFAULT_LIMIT),
    };
    let parameters = parameters(arguments);
    let reply = fetch(client, &parameters, limit)
        .await
        .map_err(with_remedy)?;
    let Audit {
        lines,
        oldest,
        damaged,
        ..
    } = &reply.result;
    if *damaged > 0 {
        let lines = format::count(*damaged, "line");
        output.note(&format!(
            "{lines} of the audit log cannot be read and are left out: check the disk of {}",
            reply.node
        ));
    }
    if output.json {
        // One document, however many replies it took.
        return output.document(&reply);
    }
    let is_first = |line: &AuditLine| oldest.is_none_or(|oldest| line.number <= oldest);
    if lines.is_empty() {
        output.note(&nothing(&reply.node, arguments, !parameters.is_empty()));
        return Ok(());
    }
    if lines.len() < limit
        && let Some(oldest) = oldest.filter(|oldest| *oldest > 1)
    {
        output.note(&format!(
            "the lines before number {oldest} are no longer kept"
        ));
    }
    if arguments.limit.is_none() && lines.len() == limit && !lines.first().is_some_and(is_first) {
        output.note(&format!(
            "the newest {limit} lines; --limit or --all lists more"
        ));
    }
    output.data(&table::fitted(
        lines,
        [
            ("when", |it| format::when_secs(it.unix_secs)),
            ("user", |it| format::or_none(it.user.as_ref())),
            ("client", |it| format::or_none(it.client.as_ref())),
            ("command", command),
            ("name", |it| format::or_none(it.name.as_ref())),
            ("count", |it| it.count.to_string()),
            ("outcome", outcome),
        ],
    ))
}

/// The parameters of the query that select lines, each after a `;`.
fn parameters(arguments: &AuditArguments) -> String {
    let AuditArguments {
        user,
        client,
        verb,
        name,
        since,
        until,
        limit: _,
        all: _,
    } = arguments;
    let secs = |secs: &Option<f64>| secs.map(|it| it.to_string());
    // As the table prints it.
    let is_unknown = |user: &String| user == format::NONE;
    let user = user.clone();
    let user = user.map(|it| if is_unknown(&it) { String::new() } else { it });
    [
        ("user", user),
        ("client", client.clone()),
        ("verb", verb.clone()),
        ("name", name.clone()),
        ("from_time", secs(since)),
        ("to_time", secs(until)),
    ]
    .into_iter()
    .filter_map(|(name, value)| Some(format!(";{name}={}", value?)))
    .collect()
}

/// Fetches the newest `limit` lines, page by page from the newest one.
async fn fetch(
    client: &Client,
    parameters: &str,
    limit: usize,
) -> Result<NodeReply<Audit>, Failure> {
    let page = async |before: u64, lines: usize| -> Result<NodeReply<Audit>, Failure> {
        let lines = lines.min(MAX_PAGE_LINES);
        let noun = format!("audit?before={before};limit={lines}{parameters}");
        Ok(client.get_node(&noun).await?.read()?)
    };
    let mut whole = page(u64::MAX, limit).await?;
    let mut lines = VecDeque::from(std::mem::take(&mut whole.result.lines));
    while lines.len() < limit
        && let Some(first) = lines.front().map(|line| line.number)
        && whole.result.oldest.is_some_and(|oldest| oldest < first)
    {
        let earlier = page(first, limit - lines.len()).await?.result;
        whole.result.damaged += earlier.damaged;
        let earlier = earlier.lines.into_iter();
        let count = earlier
            .filter(|line| line.number < first)
            .rev()
            .map(|line| lines.push_front(line))
            .count();
        if count == 0 {
            break;
        }
    }
    whole.result.lines = lines.into();
    Ok(whole)
}

/// That there is no line, and the verb that may have been meant.
fn nothing(node: &str, arguments: &AuditArguments, is_selected: bool) -> String {
    let verbs = || keys::SWARM_VERBS.iter().chain(&keys::NODE_VERBS);
    let verb = arguments.verb.as_deref();
    if let Some(verb) = verb.filter(|verb| !verbs().any(|it| it == verb)) {
        let question = did_you_mean(verb, verbs());
        let question = question.map_or_else(String::new, |it| format!(": {it}"));
        return format!("no command of {node} has the verb {verb}{question}");
    }
    match is_selected {
        true => format!("no such command in the audit log of {node}"),
        false => format!("the audit log of {node} is empty"),
    }
}

/// The error of a daemon without an audit log, with the remedy.
fn with_remedy(failure: Failure) -> Failure {
    let is_older = failure.rejection().is_some_and(|error| {
        error.code == ErrorCode::NotFound && error.details.contains_key("known")
    });
    match is_older {
        true => failure.with_advice(Some(
            "the daemon is of an earlier version, which has no audit log: upgrade it".into(),
        )),
        false => failure,
    }
}

/// The verb with its action.
fn command(line: &AuditLine) -> String {
    let action = line.action.iter().map(|action| format!(" {action}"));
    format!("{}{}", line.verb, action.collect::<String>())
}

/// How the commands ended; with the numbers if there are several outcomes.
fn outcome(line: &AuditLine) -> String {
    let outcomes = line.outcomes.iter();
    let mut outcomes: Vec<(&str, u64)> =
        outcomes.map(|it| (it.outcome.as_str(), it.count)).collect();
    // What succeeded is first.
    outcomes.sort_by_key(|(outcome, _)| *outcome != "ok");
    let known = outcomes.iter().map(|(_, count)| count).sum();
    if line.count > known {
        outcomes.push(("unknown", line.count - known));
    }
    if let [(outcome, _)] = outcomes[..] {
        return outcome.into();
    }
    let numbered = outcomes.iter();
    let numbered = numbered.map(|(outcome, count)| format!("{outcome} {count}"));
    numbered.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use serde_json::{Value, json};

    use super::*;

    fn line(count: u64, outcomes: &Value) -> AuditLine {
        serde_json::from_value(json!({
            "number": 7, "unix_secs": 1_795_531_201.25, "last_unix_secs": 1_795_531_240.75,
            "count": count, "user": "olga", "client": null, "verb": "experiment",
            "action": "cancel", "name": "noise", "outcomes": outcomes,
        }))
        .unwrap()
    }

    #[test]
    fn the_text_for_a_missing_user_selects_lines_without_one() {
        let of = |user: &str| {
            parameters(&AuditArguments {
                user: Some(user.into()),
                client: None,
                verb: None,
                name: None,
                since: None,
                until: None,
                limit: None,
                all: false,
            })
        };
        assert_eq!(of("olga"), ";user=olga");
        assert_eq!(of("-"), ";user=");
    }

    #[test]
    fn outcomes_have_numbers_if_they_differ_and_missing_ones_are_unknown() {
        let of = |count, outcomes: &[(&str, u64)]| {
            let outcomes = outcomes.iter();
            let outcomes: Vec<Value> = outcomes
                .map(|(outcome, count)| json!({"outcome": outcome, "count": count}))
                .collect();
            outcome(&line(count, &outcomes.into()))
        };
        assert_eq!(of(1, &[("ok", 1)]), "ok");
        assert_eq!(of(60, &[("ok", 60)]), "ok");
        assert_eq!(of(1, &[("permission_denied", 1)]), "permission_denied");
        assert_eq!(of(59, &[("conflict", 2), ("ok", 57)]), "ok 57, conflict 2");
        assert_eq!(
            of(60, &[("conflict", 2), ("ok", 57)]),
            "ok 57, conflict 2, unknown 1"
        );
        assert_eq!(of(3, &[]), "unknown");
        assert_eq!(of(3, &[("ok", 1)]), "ok 1, unknown 2");
        assert_eq!(command(&line(1, &json!([]))), "experiment cancel");
    }
}
