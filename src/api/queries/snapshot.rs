//! `get/snapshot`: everything that the future of a swarm depends on.

use std::sync::Arc;

use jostle_convert::Place;

use crate::api::context::Context;
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, DEFAULT_TIMEOUT};
use crate::convert::{self, Payload};
use crate::swarm::handle::{Handle, Message, Rejection, ReplyTo};

/// The bytes around a snapshot in a request that restores it.
const RESTORE_BYTES: usize = 4096;

impl Context {
    pub(super) fn snapshot(&self, swarm: &Arc<str>, handle: &Handle, responder: &Responder) {
        responder.set_deadline(
            DEFAULT_TIMEOUT,
            CommandError::read_deadline,
            Some(handle.last_step()),
        );
        // A daemon with the same limits must accept it: in base64, with a name.
        let max_bytes = self.max_request_bytes() / 4 * 3 - RESTORE_BYTES;
        let (name, responder) = (swarm.clone(), responder.clone());
        handle.send(Message::TakeCheckpoint(ReplyTo::new(
            move |answered| match answered {
                Ok((stamp, outcome)) => responder.complete(move || {
                    let payload = convert::outcome(&name, &stamp, outcome, None);
                    let bytes = payload.bytes.len();
                    if bytes > max_bytes {
                        let error = CommandError::SnapshotTooLong { bytes, max_bytes };
                        return Err(Payload::json(
                            &error.to_wire(Some(stamp.step), &Place::default()),
                        ));
                    }
                    Ok(payload)
                }),
                Err(Rejection { step, error }) => responder.reject(&error.into(), step),
            },
        )));
    }
}
