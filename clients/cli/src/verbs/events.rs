//! `events`: what happened to a swarm and, if followed, what happens.

use std::time::Duration;

use jostle_proto::{Event, EventKind, Events, Reply, keys};
use serde::Deserialize;
use serde_json::value::RawValue;
use tokio::time::interval;

use crate::arguments::EventsArguments;
use crate::bus::{Answer, Bus};
use crate::failure::Failure;
use crate::format;
use crate::output::{self, Output};
use crate::verbs::individuals::whom;
use crate::verbs::lookout::{BACK, GONE, Lookout, News};

/// How many events may wait to be looked at.
const BACKLOG: usize = 64;
/// How often the daemon is asked whether the last event was missed.
const BETWEEN_QUESTIONS: Duration = Duration::from_secs(5);

/// Shows what happened.
///
/// # Errors
///
/// Why there is nothing to show.
pub async fn events(bus: &Bus, output: Output, arguments: &EventsArguments) -> Result<(), Failure> {
    let EventsArguments {
        name,
        after,
        limit,
        follow,
    } = arguments;
    let mut told = Told {
        output,
        swarm: name,
        last: *after,
        is_begun: false,
    };
    if !follow {
        return told.catch_up(bus, *limit).await;
    }
    // Subscribes first and asks then, so that nothing falls in between.
    let samples = bus
        .subscribe(&keys::event(bus.prefix(), name), BACKLOG)
        .await?;
    let mut lookout = Lookout::begin(bus, name).await?;
    told.catch_up(bus, *limit).await?;
    let mut ticks = interval(BETWEEN_QUESTIONS);
    ticks.tick().await;
    let mut is_there = true;
    loop {
        tokio::select! {
            biased;
            sample = samples.recv_async() => {
                let answer = Answer::from(&sample.map_err(Failure::defect)?);
                let event: Event = answer.read()?;
                if event.number > told.last + 1 {
                    told.catch_up_if_there(bus).await?;
                }
                if told.tell(&event, answer.json()?)? {
                    return Ok(());
                }
            }
            news = lookout.news() => {
                is_there = match news {
                    // Its last event has told so, or was lost.
                    Err(Failure::Deleted { .. }) => return Ok(()),
                    Err(failure) => return Err(failure),
                    Ok(news) => news == News::Back,
                };
                output.note(if is_there { BACK } else { GONE });
                if is_there {
                    told.catch_up_if_there(bus).await?;
                }
            }
            _ = ticks.tick() => {
                if is_there {
                    told.catch_up_if_there(bus).await?;
                }
            }
        }
    }
}

/// Events to be passed on: a newer daemon may say more than this version knows.
#[derive(Deserialize)]
struct AsTheyCame {
    events: Vec<Box<RawValue>>,
}

/// What was told so far.
struct Told<'a> {
    output: Output,
    swarm: &'a str,
    last: u64,
    is_begun: bool,
}

impl Told<'_> {
    /// Asks for what is past and not told yet, and tells the newest `limit` of it.
    async fn catch_up(&mut self, bus: &Bus, limit: Option<usize>) -> Result<(), Failure> {
        let mut past: Vec<(Event, Box<RawValue>)> = Vec::new();
        let mut after = self.last;
        loop {
            let noun = format!("events?after={after};limit=1000");
            let answer = bus.get(self.swarm, &noun).await?;
            let page: Events = answer.read::<Reply<Events>>()?.result;
            if page.newest < after && self.is_begun {
                // A daemon that came back counts anew.
                (self.last, after) = (0, 0);
                continue;
            }
            let raw: Reply<AsTheyCame> = answer.read()?;
            let is_first = past.is_empty();
            past.extend(page.events.into_iter().zip(raw.result.events));
            let (Some((first, _)), Some((last, _))) = (past.first(), past.last()) else {
                break;
            };
            if is_first && first.number > self.last + 1 && limit.is_none() && !self.output.json {
                let lost = first.number - 1;
                self.output.note(&format!(
                    "the events up to number {lost} are no longer kept"
                ));
            }
            if last.number >= page.newest || last.number <= after {
                break;
            }
            after = last.number;
        }
        let skipped = limit.map_or(0, |limit| past.len().saturating_sub(limit));
        for (event, raw) in past.iter().skip(skipped) {
            self.tell(event, raw.get())?;
        }
        if past.is_empty() && !self.is_begun && !self.output.json {
            self.output.note("no events after that");
        }
        Ok(())
    }

    /// The same, content with nobody to ask: whether they come back the tokens tell.
    async fn catch_up_if_there(&mut self, bus: &Bus) -> Result<(), Failure> {
        match self.catch_up(bus, None).await {
            Err(failure) if failure.is_passing() || failure.code() == "not_found" => Ok(()),
            outcome => outcome,
        }
    }

    /// Tells an event unless it was told; whether it is the last there will be.
    fn tell(&mut self, event: &Event, raw: &str) -> Result<bool, Failure> {
        let is_last = event.event == EventKind::Deleted {};
        if event.number <= self.last {
            return Ok(is_last);
        }
        self.last = event.number;
        if self.output.json {
            output::write(&format!("{raw}\n"))?;
        } else {
            if !self.is_begun {
                output::write(&header())?;
            }
            output::write(&line(event))?;
        }
        self.is_begun = true;
        Ok(is_last)
    }
}

fn header() -> String {
    format!(
        "{:>7}  {:24} {:>5} {:>9} {:>10} {:7}  {}\n",
        "number", "when", "epoch", "step", "time", "phase", "what"
    )
}

fn line(event: &Event) -> String {
    format!(
        "{:>7}  {:24} {:>5} {:>9} {:>10} {:7}  {}\n",
        event.number,
        format::when(event.unix_secs),
        event.epoch,
        event.step,
        format::time(event.time),
        format::phase(event.phase),
        what(&event.event),
    )
}

/// What happened, in a line.
pub fn what(kind: &EventKind) -> String {
    let by = |client: &Option<String>| match client {
        Some(client) => format!(", by {client}"),
        None => String::new(),
    };
    match kind {
        EventKind::Created {} => "created".into(),
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
        EventKind::Lapsed { ids } => format!("no longer informed: {}", whom(ids)),
        EventKind::Fault { reason } => format!("fault: {reason}"),
        EventKind::RecordingFailed { recording, reason } => {
            format!("recording {recording} failed: {reason}")
        }
        EventKind::Deleted {} => "deleted".into(),
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use serde_json::{Value, json};

    use super::*;

    #[test]
    fn every_kind_of_event_is_a_line() {
        let said = |event: Value| what(&serde_json::from_value(event).unwrap());
        let of = |kind: &str| {
            json!({
                "kind": kind, "verb": "set", "args": {"pi3": 2}, "client": "ada", "seq": 3,
                "request_id": null, "applies_at_step": 9, "ids": [4, 7], "reason": "finished",
                "error": {"code": "conflict", "message": "the swarm was reset"},
            })
        };
        assert_eq!(said(of("created")), "created");
        assert_eq!(said(of("phase")), "phase changed: finished");
        assert_eq!(said(of("command")), "set pi3=2 (seq 3, by ada)");
        assert_eq!(
            said(of("scheduled")),
            "set pi3=2 scheduled (for step 9, by ada)"
        );
        assert_eq!(
            said(of("refused")),
            "set pi3=2 refused: the swarm was reset (scheduled, by ada)"
        );
        assert_eq!(said(of("lapsed")), "no longer informed: 2 (4,7)");
        assert_eq!(said(of("fault")), "fault: finished");
        assert_eq!(said(of("deleted")), "deleted");
    }
}
