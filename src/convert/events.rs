//! Events, and the history of executed commands.

use jostle_convert::Place;
use jostle_proto as proto;

use crate::convert::error::CommandError;
use crate::convert::states::phase;
use crate::persistence::journal_page::JournalPage;
use crate::swarm::frame::{Event, EventKind};
use crate::swarm::history::Page;
use crate::swarm::sender::Sender;

pub fn event(swarm: &str, event: Event) -> proto::Event {
    let stamp = event.stamp;
    proto::Event {
        swarm: swarm.to_owned(),
        number: event.number,
        epoch: stamp.epoch,
        step: stamp.step,
        time: stamp.time,
        phase: phase(&stamp.phase),
        unix_secs: event.unix_secs,
        event: match event.kind {
            EventKind::Created(creation) => {
                let creation = creation.as_deref();
                proto::EventKind::Created {
                    verb: creation.map(|it| it.verb.clone()),
                    client: creation.and_then(|it| it.client.clone()),
                    request_id: creation.and_then(|it| it.request_id.clone()),
                }
            }
            EventKind::Phase => proto::EventKind::Phase {
                reason: stamp.phase.reason(),
            },
            EventKind::Command(sender) => proto::EventKind::Command {
                seq: stamp.seq,
                verb: sender.verb.to_owned(),
                args: args(&sender),
                client: sender.client.clone(),
                request_id: sender.request_id.clone(),
            },
            EventKind::Scheduled(applies_at_step, sender) => proto::EventKind::Scheduled {
                applies_at_step,
                verb: sender.verb.to_owned(),
                args: args(&sender),
                client: sender.client.clone(),
                request_id: sender.request_id.clone(),
            },
            EventKind::Rejected(sender, error) => proto::EventKind::Refused {
                verb: sender.verb.to_owned(),
                args: args(&sender),
                client: sender.client.clone(),
                request_id: sender.request_id.clone(),
                error: CommandError::from(error)
                    .to_wire(Some(stamp.step), &Place::of_verb(sender.verb)),
            },
            EventKind::Lapsed(ids) => proto::EventKind::Lapsed { ids },
            EventKind::Model { from, to } => proto::EventKind::Model { from, to },
            EventKind::Fault(reason) => proto::EventKind::Fault { reason },
            EventKind::RecordingFailed(recording, reason) => proto::EventKind::RecordingFailed {
                recording: recording.to_string(),
                reason: reason.to_string(),
            },
            // The JSON of an event in a recording.
            EventKind::Recorded(what) => {
                serde_json::from_str(&what).unwrap_or(proto::EventKind::Phase { reason: None })
            }
            EventKind::Deleted(sender) => proto::EventKind::Deleted {
                client: sender.client.clone(),
                request_id: sender.request_id.clone(),
            },
        },
    }
}

pub fn events(swarm: &str, page: Page<Event>) -> proto::Events {
    let events = page.records.into_iter();
    proto::Events {
        events: events.map(|it| event(swarm, it)).collect(),
        oldest: page.oldest,
        newest: page.newest,
    }
}

pub fn journal(page: JournalPage, newest: u64) -> proto::Journal {
    let entries = page.entries.into_iter().map(|entry| proto::JournalEntry {
        seq: entry.stamp.seq,
        epoch: entry.stamp.epoch,
        step: entry.stamp.step,
        time: entry.stamp.time,
        unix_secs: entry.unix_secs,
        verb: entry.sender.verb.to_owned(),
        args: args(&entry.sender),
        client: entry.sender.client.clone(),
        request_id: entry.sender.request_id.clone(),
    });
    proto::Journal {
        entries: entries.collect(),
        oldest: page.oldest,
        newest,
        next: page.next,
    }
}

/// Returns the arguments of a command, which were parsed before and are valid JSON.
fn args(sender: &Sender) -> serde_json::Value {
    serde_json::from_str(&sender.args).unwrap_or_default()
}
