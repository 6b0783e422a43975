//! `journal`: the commands a swarm has applied.

use jostle_proto::{Journal, JournalEntry, Reply};
use serde_json::Value;

use crate::arguments::JournalArguments;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::table;
use crate::verbs::look::Sight;

/// The commands that were asked for.
///
/// # Errors
///
/// Why there is no journal.
pub async fn sight(
    bus: &Bus,
    output: Output,
    arguments: &JournalArguments,
) -> Result<Sight, Failure> {
    let mut reply = journal(bus, &arguments.name, arguments.after).await?;
    let lost = lost(&reply.result, arguments.after);
    let entries = &mut reply.result.entries;
    if let Some(limit) = arguments.limit {
        entries.drain(..entries.len().saturating_sub(limit));
    }
    if output.json {
        // What came in several answers is put together.
        let whole = serde_json::to_string(&reply).map_err(Failure::defect)?;
        return Ok(Sight::of(whole));
    }
    if entries.is_empty() {
        let note = match arguments.after {
            0 => format!("{} has applied no command yet", reply.swarm),
            after => format!("{} has applied no command after seq {after}", reply.swarm),
        };
        return Ok(Sight {
            data: None,
            note: Some(note),
        });
    }
    let rows = reply.result.entries.iter().map(|entry| {
        [
            entry.seq.to_string(),
            format::when(entry.unix_secs),
            entry.epoch.to_string(),
            entry.step.to_string(),
            format::time(entry.time),
            entry.client.clone().unwrap_or_else(|| format::NONE.into()),
            format::command(&entry.verb, &entry.args),
        ]
    });
    let header = ["seq", "when", "epoch", "step", "time", "client", "command"];
    Ok(Sight {
        data: Some(table::table(header, rows.collect())),
        note: lost.map(|seq| format!("the commands up to seq {seq} are no longer kept")),
    })
}

/// All that is known of what a swarm was told.
pub struct Whole {
    /// How many commands it has applied.
    pub seq: u64,
    /// Those up to this one are not known.
    pub lost: u64,
    /// The others.
    pub entries: Vec<JournalEntry>,
}

/// All that is known of what a swarm was told.
///
/// # Errors
///
/// Why there is no journal.
pub async fn whole(bus: &Bus, swarm: &str) -> Result<Whole, Failure> {
    let Reply { seq, result, .. } = journal(bus, swarm, 0).await?;
    let lost = match result.entries.first() {
        Some(_) => lost(&result, 0).unwrap_or(0),
        None => seq,
    };
    Ok(Whole {
        seq,
        lost,
        entries: result.entries,
    })
}

/// All after a seq, however many answers that takes.
async fn journal(bus: &Bus, swarm: &str, after: u64) -> Result<Reply<Journal>, Failure> {
    let page = async |after: u64| -> Result<Reply<Journal>, Failure> {
        bus.get(swarm, &format!("journal?after={after};limit=1000"))
            .await?
            .read()
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

/// The last seq of those asked for that are no longer kept.
fn lost(journal: &Journal, after: u64) -> Option<u64> {
    let first = journal.entries.first()?;
    let kept_from = first.seq - (changes(first) - 1).min(first.seq);
    (kept_from > after + 1).then(|| kept_from - 1)
}

/// How many changes an entry counts for.
fn changes(entry: &JournalEntry) -> u64 {
    let commands = entry.args.get("commands").and_then(Value::as_array);
    match commands {
        Some(commands) if entry.verb == "batch" => (commands.len() as u64).max(1),
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
    fn what_is_no_longer_kept_is_told_and_a_batch_is_no_gap() {
        let set = json!({"pi3": 2});
        assert_eq!(lost(&journal_from(1, "set", &set), 0), None);
        assert_eq!(lost(&journal_from(5, "set", &set), 0), Some(4));
        assert_eq!(lost(&journal_from(5, "set", &set), 4), None);
        let batch = json!({"commands": [{"verb": "set"}, {"verb": "set"}, {"verb": "set"}]});
        assert_eq!(lost(&journal_from(3, "batch", &batch), 0), None);
        assert_eq!(lost(&journal_from(4, "batch", &batch), 0), Some(1));
    }
}
