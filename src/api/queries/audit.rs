//! `get/audit`: who sent which commands.

use jostle_proto::NodeReply;

use crate::api::context::Context;
use crate::api::incoming::{Incoming, page_of_audit};
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, DEFAULT_TIMEOUT};
use crate::convert::{self, Payload};
use crate::lanes::Lane;

impl Context {
    /// Replies with a page of the audit log, if the client is an operator.
    pub(super) fn audit_page(
        &self,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        self.rights.current().permit(&incoming.token, "audit")?;
        let filter = page_of_audit(incoming.parameters())?;
        responder.set_deadline(DEFAULT_TIMEOUT, CommandError::read_deadline, None);
        let (node, store, reader) = (self.node.clone(), self.store.clone(), responder.clone());
        let turn = self.turn(incoming, "");
        self.queue_read(Lane::Files, &turn, responder, move || {
            // Waits for the queued lines. If they cannot be written, the page ends before them.
            let _ = store.commit(Vec::new());
            reader.finish(store.audit(&filter), move |page| {
                let result = convert::audit(page);
                Payload::json(&NodeReply { node, result })
            });
        })
    }
}
