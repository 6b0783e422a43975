//! `get/journal`: the commands that were applied to a swarm.

use std::sync::Arc;

use crate::api::context::Context;
use crate::api::incoming::{Incoming, page_of_journal};
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, DEFAULT_TIMEOUT};
use crate::convert::{self, Payload};
use crate::lanes::Lane;
use crate::persistence::journal_page::{JournalFilter, JournalPage, read_page};
use crate::store::Store;
use crate::swarm::handle::{Handle, Message, ReplyTo};

impl Context {
    /// Replies with a page of the journal.
    pub(super) fn journal(
        &self,
        swarm: &Arc<str>,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        let filter = page_of_journal(incoming.parameters())?;
        let handle = self.find(swarm)?;
        responder.set_deadline(
            DEFAULT_TIMEOUT,
            CommandError::read_deadline,
            Some(handle.last_step()),
        );
        let (store, reader, swarm) = (self.store.clone(), responder.clone(), swarm.clone());
        let turn = self.turn(incoming, &swarm);
        self.queue_read(Lane::Files, &turn, responder, move || {
            // Before the page is read: the page has everything up to there that is durable.
            let newest = handle.history.newest();
            match page(&store, &swarm, &handle, &filter) {
                Ok(page) => handle.send(Message::Query(ReplyTo::new(move |answered| {
                    reader.respond(answered, move |stamp, _| {
                        let journal = convert::journal(page, newest);
                        Payload::json(&convert::reply(&swarm, &stamp, journal))
                    });
                }))),
                Err(error) => reader.reject(&error, handle.step()),
            }
        })
    }
}

fn page(
    store: &Store,
    swarm: &str,
    handle: &Handle,
    filter: &JournalFilter,
) -> Result<JournalPage, CommandError> {
    if handle.summary().is_some_and(|it| it.is_replay) {
        // A playback is not stored: the number of a line is that of its command.
        let all = handle
            .history
            .entries(filter.line.map_or(0, |it| it.saturating_sub(1)), usize::MAX);
        let mut selected = all.records.into_iter().filter(|it| filter.selects(it));
        let entries = selected.by_ref().take(filter.limit).collect();
        return Ok(JournalPage {
            entries,
            oldest: all.oldest,
            next: selected.next().map(|it| it.stamp.seq),
        });
    }
    Ok(read_page(store, swarm, handle.spec.parameters.dt, filter)?)
}
