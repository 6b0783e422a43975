//! `events`: the past events of a swarm and, with `--follow`, the next ones.

use jostle_client::{EventsFrom, FollowOptions, Message, Update};
use jostle_proto::{Event, EventKind};

use crate::arguments::EventsArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::output::{self, Output};
use crate::verbs::individuals::individuals;
use crate::verbs::outage::{DAEMON_AWAY, DAEMON_BACK};

/// Prints events.
pub async fn events(context: &Context, arguments: &EventsArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let EventsArguments {
        name,
        after,
        limit,
        follow,
    } = arguments;
    let mut printer = Printer {
        output: *output,
        last: *after,
        has_header: false,
    };
    if !follow {
        return printer.print_past(&client.events(name, *after).await?, *limit);
    }
    let options = FollowOptions {
        events: Some(EventsFrom::After(*after)),
        ..FollowOptions::default()
    };
    let mut updates = client.follow(name, options).await?;
    // The past events are available at once.
    let (mut past, mut update) = (Vec::new(), updates.try_next());
    while let Some(Ok(Update::Event(event))) = update {
        past.push(*event);
        update = updates.try_next();
    }
    printer.print_past(&past, *limit)?;
    loop {
        if update.is_none() {
            update = updates.next().await;
        }
        match update.take().transpose()? {
            Some(Update::Event(event)) => printer.print(&event)?,
            Some(Update::Away) => output.note(DAEMON_AWAY),
            Some(Update::Back) => output.note(DAEMON_BACK),
            Some(Update::Deleted) | None => return Ok(()),
            Some(_) => {}
        }
    }
}

struct Printer {
    output: Output,
    /// The number of the last event.
    last: u64,
    has_header: bool,
}

impl Printer {
    /// Prints the newest `limit` of the past events.
    fn print_past(
        &mut self,
        events: &[Message<Event>],
        limit: Option<usize>,
    ) -> Result<(), Failure> {
        let skipped = limit.map_or(0, |limit| events.len().saturating_sub(limit));
        if limit.is_some()
            && let Some(first) = events.get(skipped)
        {
            self.last = first.number - 1;
        }
        for event in &events[skipped..] {
            self.print(event)?;
        }
        if events.is_empty() && !self.output.json {
            self.output.note("no events after that");
        }
        Ok(())
    }

    fn print(&mut self, event: &Message<Event>) -> Result<(), Failure> {
        let before = std::mem::replace(&mut self.last, event.number);
        if self.output.json {
            return output::write(&format!("{}\n", event.payload.json()?));
        }
        if event.number > before + 1 {
            let (first, last) = (before + 1, event.number - 1);
            self.output.note(&format!(
                "the events with the numbers {first} to {last} are no longer kept"
            ));
        }
        if !std::mem::replace(&mut self.has_header, true) {
            let header = ["number", "when", "epoch", "step", "time", "phase", "what"];
            output::write(&line(header))?;
        }
        output::write(&line([
            &event.number.to_string(),
            &format::when(event.unix_secs),
            &event.epoch.to_string(),
            &event.step.to_string(),
            &format::time(event.time),
            event.phase.name(),
            &describe(&event.event),
        ]))
    }
}

fn line([number, when, epoch, step, time, phase, what]: [&str; 7]) -> String {
    format!("{number:>7}  {when:24} {epoch:>5} {step:>9} {time:>10} {phase:7}  {what}\n")
}

/// What happened, in a line.
pub fn describe(kind: &EventKind) -> String {
    let by = |client: &Option<String>| match client {
        Some(client) => format!(", by {client}"),
        None => String::new(),
    };
    let what = match kind {
        EventKind::Created { verb, client, .. } => {
            let verb = verb.as_deref().filter(|it| *it != "create");
            let verb = verb.map_or(String::new(), |verb| format!(" ({verb})"));
            format!("created{verb}{}", by(client))
        }
        EventKind::Phase { reason: None } => "phase changed".into(),
        EventKind::Phase {
            reason: Some(reason),
        } => format!("phase changed: {reason}"),
        EventKind::Command {
            seq,
            verb,
            args,
            client,
            ..
        } => format!("{} (seq {seq}{})", format::command(verb, args), by(client)),
        EventKind::Scheduled {
            applies_at_step,
            verb,
            args,
            client,
            ..
        } => format!(
            "{} scheduled (for step {applies_at_step}{})",
            format::command(verb, args),
            by(client)
        ),
        EventKind::Refused {
            verb,
            args,
            client,
            error,
            ..
        } => format!(
            "{} refused: {} (scheduled{})",
            format::command(verb, args),
            error.message,
            by(client)
        ),
        EventKind::Lapsed { ids } => format!("no longer informed: {}", individuals(ids)),
        EventKind::Model { from, to } => {
            format!("model version {to} goes on, after version {from}")
        }
        EventKind::Fault { reason } => format!("fault: {reason}"),
        EventKind::RecordingFailed { recording, reason } => {
            format!("recording {recording} failed: {reason}")
        }
        EventKind::Deleted { client, .. } => format!("deleted{}", by(client)),
    };
    format::printable(&what)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use serde_json::{Value, json};

    use super::*;

    #[test]
    fn every_kind_of_event_is_a_line() {
        let described = |event: Value| describe(&serde_json::from_value(event).unwrap());
        let of = |kind: &str| {
            json!({
                "kind": kind, "verb": "set", "args": {"pi3": 2}, "client": "ada", "seq": 3,
                "request_id": null, "applies_at_step": 9, "ids": [4, 7], "reason": "finished",
                "error": {"code": "conflict", "message": "the swarm was reset"},
            })
        };
        assert_eq!(described(of("created")), "created (set), by ada");
        let note = json!({
            "kind": "command", "verb": "annotate", "args": {"text": "a\nb\u{202e}c"},
            "client": "ada\u{9b}2J", "seq": 3, "request_id": null,
        });
        let line = r#"annotate "a\nb\u{202e}c" (seq 3, by ada\u{9b}2J)"#;
        assert_eq!(described(note), line);
        // As earlier versions send it.
        assert_eq!(described(json!({"kind": "created"})), "created");
        assert_eq!(described(json!({"kind": "deleted"})), "deleted");
        let create = json!({"kind": "created", "verb": "create", "client": "olga:nb"});
        assert_eq!(described(create), "created, by olga:nb");
        assert_eq!(described(of("phase")), "phase changed: finished");
        assert_eq!(described(of("command")), "set pi3=2 (seq 3, by ada)");
        assert_eq!(
            described(of("scheduled")),
            "set pi3=2 scheduled (for step 9, by ada)"
        );
        assert_eq!(
            described(of("refused")),
            "set pi3=2 refused: the swarm was reset (scheduled, by ada)"
        );
        assert_eq!(described(of("lapsed")), "no longer informed: 2 (4,7)");
        assert_eq!(described(of("fault")), "fault: finished");
        assert_eq!(described(of("deleted")), "deleted, by ada");
    }
}
