//! `journal`: the commands that a swarm has applied.

use std::collections::VecDeque;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use jostle_client::Client;
use jostle_proto::{ExperimentFile, Journal, JournalEntry, Reply};
use serde_json::Value;

use crate::arguments::JournalArguments;
use crate::bound;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::table;

/// The most commands of a reply.
const MAX_PAGE_COMMANDS: usize = 1000;

pub async fn journal(context: &Context, arguments: &JournalArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    if arguments.as_experiment {
        return as_experiment(context, arguments).await;
    }
    let JournalArguments {
        name,
        after,
        limit,
        all,
        ..
    } = arguments;
    let most = bound::most(output.json, *limit, *all);
    let parameters = parameters(arguments);
    let mut pages = Pages {
        client,
        swarm: name,
        after: *after,
        parameters: &parameters,
    };
    let Newest {
        reply,
        mut lost,
        left_out,
    } = pages.newest(most).await.map_err(with_remedy)?;
    let Journal { entries, .. } = &reply.result;
    if output.json {
        // One document, however many replies it took.
        let mut document = serde_json::to_value(&reply)
            .map_err(|error| Failure::defect(format!("cannot print the journal: {error}")))?;
        document["result"]["left_out"] = left_out.into();
        return output.document(&document);
    }
    if !parameters.is_empty() {
        // Of all commands, not of those that were selected.
        pages.parameters = "";
        lost = self::lost(&pages.page(*after, 1, None).await?.result, *after);
    }
    if let Some(seq) = lost {
        output.note(&format!("the commands up to seq {seq} are no longer kept"));
    }
    if entries.is_empty() {
        let of = match parameters.is_empty() {
            true => "command",
            false => "such command",
        };
        let note = match (lost, after) {
            (Some(seq), _) => format!("{} has applied no {of} after seq {seq}", reply.swarm),
            (None, 0) => format!("{} has applied no {of} yet", reply.swarm),
            (None, after) => format!("{} has applied no {of} after seq {after}", reply.swarm),
        };
        output.note(&note);
        return Ok(());
    }
    output.data(&table::of(
        entries,
        [
            ("seq", |it| it.seq.to_string()),
            ("when", |it| format::when(it.unix_secs)),
            ("epoch", |it| it.epoch.to_string()),
            ("step", |it| it.step.to_string()),
            ("time", |it| format::time(it.time)),
            ("client", |it| format::or_none(it.client.as_ref())),
            ("command", |it| format::command(&it.verb, &it.args)),
        ],
    ))
}

/// Prints or writes the file of an experiment.
async fn as_experiment(context: &Context, arguments: &JournalArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let beside = arguments.out.as_deref().map(beside);
    let mut parameters = Vec::new();
    if let Some(number) = arguments.replicates {
        parameters.push(format!("replicates={number}"));
    }
    if let Some(name) = beside.as_ref().and_then(|it| it.file_name()) {
        parameters.push(format!("setpoints={}", name.to_string_lossy()));
    }
    let query = match parameters.is_empty() {
        true => "experiment".to_owned(),
        false => format!("experiment?{}", parameters.join(";")),
    };
    let answer = client.get(&arguments.name, &query).await?;
    let Some((path, beside)) = arguments.out.as_ref().zip(beside) else {
        return output.reply(&answer, |reply: &Reply<ExperimentFile>| {
            reply.result.file.trim_end().to_owned()
        });
    };
    let reply: Reply<ExperimentFile> = answer.read()?;
    let ExperimentFile {
        file, setpoints, ..
    } = reply.result;
    let mut written = format!("wrote {}", path.display());
    // The file that names the other one is the last.
    if let Some(csv) = setpoints {
        write(&beside, &csv)?;
        let _ = write!(written, " and {}", beside.display());
    }
    write(path, &file)?;
    output.note(&written);
    Ok(())
}

/// Returns the CSV of set-points beside a file: `found.setpoints.csv` of `found.toml`.
fn beside(path: &Path) -> PathBuf {
    path.with_extension("setpoints.csv")
}

fn write(path: &Path, text: &str) -> Result<(), Failure> {
    jostle_atomic_file::write(path, text.as_bytes())
        .map_err(|error| Failure::file(path.display(), error))
}

/// All commands that the journal of a swarm still has.
pub struct FullJournal {
    /// The number of commands applied.
    pub seq: u64,
    /// The seq up to which the journal no longer has commands.
    pub lost: u64,
    /// The commands after it.
    pub entries: Vec<JournalEntry>,
}

/// All commands that the journal of a swarm still has.
pub async fn full_journal(client: &Client, swarm: &str) -> Result<FullJournal, Failure> {
    let pages = Pages {
        client,
        swarm,
        after: 0,
        parameters: "",
    };
    let Newest { reply, lost, .. } = pages.newest(usize::MAX).await?;
    let Reply { seq, result, .. } = reply;
    let lost = match result.entries.first() {
        Some(_) => lost.unwrap_or(0),
        None => seq,
    };
    Ok(FullJournal {
        seq,
        lost,
        entries: result.entries,
    })
}

/// The parameters of the query that select commands, each after a `;`.
fn parameters(arguments: &JournalArguments) -> String {
    let JournalArguments {
        from_step,
        to_step,
        verb,
        client,
        ..
    } = arguments;
    let step = |step: &Option<u64>| step.map(|it| it.to_string());
    [
        ("from_step", step(from_step)),
        ("to_step", step(to_step)),
        ("verb", verb.clone()),
        ("client", client.clone()),
    ]
    .into_iter()
    .filter_map(|(name, value)| Some(format!(";{name}={}", value?)))
    .collect()
}

/// The error of a daemon that does not select commands, with the remedy.
fn with_remedy(failure: Failure) -> Failure {
    let parameters = ["from_step", "to_step", "verb", "client"];
    let is_older = failure.rejection().is_some_and(|error| {
        let field = error.details.get("field").and_then(Value::as_str);
        error.details.contains_key("known") && field.is_some_and(|it| parameters.contains(&it))
    });
    match is_older {
        true => failure.with_advice(Some(
            "the daemon is of an earlier version, which lists all commands only: upgrade it, or \
             search the output of --json"
                .into(),
        )),
        false => failure,
    }
}

/// The newest commands of a journal.
struct Newest {
    reply: Reply<Journal>,
    /// The last seq that is no longer kept; with parameters that is not known.
    lost: Option<u64>,
    /// How many commands come before those of the reply; each change of a batch counts, as in its seq.
    left_out: u64,
}

/// The commands after a seq, and the parameters that select some of them.
struct Pages<'a> {
    client: &'a Client,
    swarm: &'a str,
    after: u64,
    parameters: &'a str,
}

impl Pages<'_> {
    async fn page(
        &self,
        after: u64,
        limit: usize,
        line: Option<u64>,
    ) -> Result<Reply<Journal>, Failure> {
        let line = line.map_or_else(String::new, |line| format!(";line={line}"));
        let noun = format!(
            "journal?after={after};limit={limit}{}{line}",
            self.parameters
        );
        Ok(self.client.get(self.swarm, &noun).await?.read()?)
    }

    /// The newest `limit` commands.
    async fn newest(&self, limit: usize) -> Result<Newest, Failure> {
        let first = self.page(self.after, MAX_PAGE_COMMANDS, None).await?;
        let newest = first.result.newest;
        let (mut lost, mut span) = (None, u64::MAX);
        if self.parameters.is_empty() {
            lost = self::lost(&first.result, self.after);
            // Each command takes a seq, and a batch several.
            span = limit as u64;
        }
        let is_last = first
            .result
            .entries
            .last()
            .is_none_or(|it| it.seq >= newest);
        loop {
            let after = newest.saturating_sub(span).max(self.after);
            if after == self.after || is_last {
                let (reply, left_out) = self.with_the_rest(first, limit).await?;
                return Ok(Newest {
                    reply,
                    lost,
                    left_out,
                });
            }
            let pages = Pages { after, ..*self };
            let begin = pages.page(after, MAX_PAGE_COMMANDS, None).await?;
            let (reply, _) = pages.with_the_rest(begin, limit).await?;
            if reply.result.entries.len() == limit {
                let before = lost.unwrap_or(self.after);
                let first = reply.result.entries.first();
                let left_out = first.map_or(0, |it| seq_before(it).saturating_sub(before));
                return Ok(Newest {
                    reply,
                    lost,
                    left_out,
                });
            }
            span = span.saturating_mul(4);
        }
    }

    /// The newest `limit` commands of a page and all later ones, and how many there are before these.
    async fn with_the_rest(
        &self,
        first: Reply<Journal>,
        limit: usize,
    ) -> Result<(Reply<Journal>, u64), Failure> {
        let (mut reply, mut line, mut left_out) = (first, 0, 0);
        let mut newest = VecDeque::new();
        loop {
            let page = std::mem::take(&mut reply.result.entries);
            let last = page.last().map(|it| it.seq);
            newest.extend(page);
            let older = newest.drain(..newest.len().saturating_sub(limit));
            left_out += older.map(|it| changes(&it)).sum::<u64>();
            reply = match (reply.result.next, last) {
                (Some(next), _) if next > line => {
                    line = next;
                    self.page(self.after, MAX_PAGE_COMMANDS, Some(next)).await?
                }
                // An earlier version sends no next line.
                (None, Some(seq)) if self.parameters.is_empty() && seq < reply.result.newest => {
                    self.page(seq, MAX_PAGE_COMMANDS, None).await?
                }
                _ => break,
            };
        }
        reply.result.entries = newest.into();
        reply.result.next = None;
        Ok((reply, left_out))
    }
}

/// The last seq after `after` that is no longer kept.
fn lost(journal: &Journal, after: u64) -> Option<u64> {
    let before = seq_before(journal.entries.first()?);
    (before > after).then_some(before)
}

/// The seq before those of an entry.
fn seq_before(entry: &JournalEntry) -> u64 {
    entry.seq.saturating_sub(changes(entry))
}

/// How many seqs an entry takes.
fn changes(entry: &JournalEntry) -> u64 {
    let commands = entry.args.get("commands").and_then(Value::as_array);
    match commands {
        Some(commands) if ["batch", "fired"].contains(&entry.verb.as_str()) => {
            (commands.len() as u64).max(1)
        }
        _ => 1,
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use serde_json::json;

    use super::*;

    fn journal_from(seq: u64, verb: &str, args: &Value) -> Journal {
        serde_json::from_value(json!({
            "entries": [{
                "seq": seq, "epoch": 0, "step": 0, "time": 0.0, "verb": verb, "args": args,
                "client": null, "request_id": null,
            }],
            "oldest": seq, "newest": 9,
        }))
        .unwrap()
    }

    #[test]
    fn a_gap_before_the_oldest_entry_is_found_and_a_batch_is_no_gap() {
        let set = json!({"pi3": 2});
        assert_eq!(lost(&journal_from(1, "set", &set), 0), None);
        assert_eq!(lost(&journal_from(5, "set", &set), 0), Some(4));
        assert_eq!(lost(&journal_from(5, "set", &set), 4), None);
        let batch = json!({"commands": [{"verb": "set"}, {"verb": "set"}, {"verb": "set"}]});
        assert_eq!(lost(&journal_from(3, "batch", &batch), 0), None);
        assert_eq!(lost(&journal_from(4, "batch", &batch), 0), Some(1));
    }
}
