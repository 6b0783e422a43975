//! Set-points that a controller puts while the swarm runs, without a reply.

use std::sync::Arc;

use jostle_convert::change::set_points;
use jostle_proto::verbs::{Control, SetPoints};
use jostle_proto::{Request, RequestError};
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use crate::convert::commands::{CommandError, check_name};
use crate::swarm::command::Command;
use crate::swarm::membership::Put;
use crate::swarm::sender::Sender;

/// Set-points in the journal.
#[derive(Serialize, Deserialize)]
struct Applied {
    controller: String,
    sequence: u64,
    set: SetPoints,
}

/// Parses set-points and the epoch for which they are meant.
pub fn read(controller: &str, bytes: &[u8], is_cbor: bool) -> Result<(Option<u64>, Put), String> {
    let control = parse(bytes, is_cbor)?;
    let applied = Applied {
        controller: controller.to_owned(),
        sequence: control.sequence,
        set: control.set,
    };
    // NaN and infinity become null here, and are rejected below.
    let args = serde_json::to_string(&applied).map_err(|error| error.to_string())?;
    let set = set_points(applied.set).map_err(|error| error.to_string())?;
    let is_finite = |column: &[f64]| column.iter().all(|value| value.is_finite());
    let drives = set.drives.iter().flatten();
    let mut driven = drives.flat_map(|drive| [drive.turn, drive.speed]).flatten();
    if !is_finite(&set.direction)
        || !set.weight.as_deref().is_none_or(is_finite)
        || !driven.all(f64::is_finite)
    {
        return Err("has a number that is not finite".into());
    }
    let put = Put {
        sequence: applied.sequence,
        set,
        sender: Arc::new(Sender {
            verb: "control",
            args,
            ..Sender::default()
        }),
    };
    Ok((control.epoch, put))
}

fn parse(bytes: &[u8], is_cbor: bool) -> Result<Control, String> {
    match is_cbor {
        true => ciborium::from_reader(bytes).map_err(|error| error.to_string()),
        false => serde_json::from_slice(bytes).map_err(|error| error.to_string()),
    }
}

/// Parses set-points from the journal.
pub fn parse_journaled(request: &Request) -> Result<Command, CommandError> {
    let args = request.args.as_deref().map_or("{}", RawValue::get);
    let applied: Applied = serde_json::from_str(args).map_err(|error| RequestError {
        field: "args".to_owned(),
        problem: error.to_string(),
    })?;
    check_name("controller", &applied.controller)?;
    Ok(Command::Control {
        controller: applied.controller,
        sequence: applied.sequence,
        set: set_points(applied.set)?,
    })
}
