//! `seek`: moves the playback of a recording to another step or time.

use std::sync::Arc;

use jostle_proto::SeekArgs;

use crate::api::context::{Context, reject_preconditions};
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::convert;
use crate::convert::commands::{self, CommandError};
use crate::swarm::handle::Message;

impl Context {
    pub(super) fn seek(
        &self,
        swarm: &Arc<str>,
        incoming: &Incoming,
        responder: &Responder,
    ) -> Result<(), CommandError> {
        let request = self.request(incoming)?;
        reject_preconditions(&request)?;
        let to = commands::swarm::seek(request.args::<SeekArgs>()?)?;
        let sender = Arc::new(commands::sender("seek", &request)?);
        let timeout = commands::timeout(&request)?;
        let name = swarm.clone();
        responder.send_to_swarm(
            &self.find(swarm)?,
            (timeout, CommandError::deadline),
            |answer| Message::Seek(to, sender, answer),
            move |stamp, outcome| convert::outcome(&name, &stamp, outcome, None),
        );
        Ok(())
    }
}
