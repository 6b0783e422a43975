//! Set-points that a controller puts while the swarm runs, without a reply.

use std::sync::Arc;

use jostle_convert::change::set_points;
use jostle_proto::verbs::{Control, SetPoints};
use jostle_proto::{Request, RequestError};
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use crate::convert;
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
///
/// # Errors
///
/// What is wrong with them.
pub fn read(controller: &str, bytes: &[u8], is_cbor: bool) -> Result<(Option<u64>, Put), String> {
    let Control {
        sequence,
        epoch,
        set,
    } = convert::control(bytes, is_cbor)?;
    let applied = Applied {
        controller: controller.to_owned(),
        sequence,
        set,
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
        sequence,
        set,
        sender: Arc::new(Sender {
            verb: "control",
            args,
            ..Sender::default()
        }),
    };
    Ok((epoch, put))
}

/// Parses set-points from the journal.
///
/// # Errors
///
/// [`CommandError`] if the journal is damaged.
pub fn order(request: &Request) -> Result<Command, CommandError> {
    let args = request.args.as_deref().map_or("{}", RawValue::get);
    let Applied {
        controller,
        sequence,
        set,
    } = serde_json::from_str(args).map_err(|error| RequestError {
        field: "args".to_owned(),
        problem: error.to_string(),
    })?;
    check_name("controller", &controller)?;
    Ok(Command::Control {
        controller,
        sequence,
        set: set_points(set)?,
    })
}
