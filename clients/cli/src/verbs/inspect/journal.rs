//! `journal`: the commands that a swarm has applied.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use jostle_client::Client;
use jostle_proto::{ExperimentFile, Journal, JournalEntry, Reply};
use serde_json::Value;

use crate::arguments::JournalArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::table;

pub async fn journal(context: &Context, arguments: &JournalArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    if arguments.as_experiment {
        return as_experiment(context, arguments).await;
    }
    let mut reply = fetch(client, &arguments.name, arguments.after).await?;
    let lost = lost(&reply.result, arguments.after);
    let entries = &mut reply.result.entries;
    if let Some(limit) = arguments.limit {
        entries.drain(..entries.len().saturating_sub(limit));
    }
    if output.json {
        // One document, however many replies it took.
        return output.document(&reply);
    }
    if entries.is_empty() {
        let note = match arguments.after {
            0 => format!("{} has applied no command yet", reply.swarm),
            after => format!("{} has applied no command after seq {after}", reply.swarm),
        };
        output.note(&note);
        return Ok(());
    }
    if let Some(seq) = lost {
        output.note(&format!("the commands up to seq {seq} are no longer kept"));
    }
    output.data(&table::of(
        &reply.result.entries,
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
    let Reply { seq, result, .. } = fetch(client, swarm, 0).await?;
    let lost = match result.entries.first() {
        Some(_) => lost(&result, 0).unwrap_or(0),
        None => seq,
    };
    Ok(FullJournal {
        seq,
        lost,
        entries: result.entries,
    })
}

/// Fetches the entries after a seq, page by page.
async fn fetch(client: &Client, swarm: &str, after: u64) -> Result<Reply<Journal>, Failure> {
    let page = async |after: u64| -> Result<Reply<Journal>, Failure> {
        let noun = format!("journal?after={after};limit=1000");
        Ok(client.get(swarm, &noun).await?.read()?)
    };
    let mut whole = page(after).await?;
    while let Some(last) = whole.result.entries.last() {
        if last.seq >= whole.result.newest {
            break;
        }
        let mut next = page(last.seq).await?;
        if next.result.entries.is_empty() {
            break;
        }
        let mut entries = std::mem::take(&mut whole.result.entries);
        entries.append(&mut next.result.entries);
        whole = next;
        whole.result.entries = entries;
    }
    Ok(whole)
}

/// The last seq after `after` that is no longer kept.
fn lost(journal: &Journal, after: u64) -> Option<u64> {
    let first = journal.entries.first()?;
    let kept_from = first.seq - (changes(first) - 1).min(first.seq);
    (kept_from > after + 1).then(|| kept_from - 1)
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
