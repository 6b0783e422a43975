//! Set-points that a controller puts while the swarm runs: what has no reply.

use std::sync::Arc;

use jostle_convert::change::set_points;
use jostle_proto::verbs::{Control, SetPoints};
use serde::{Deserialize, Serialize};

use crate::convert;
use crate::convert::commands::{CommandError, check_name};
use crate::swarm::command::Command;
use crate::swarm::membership::Put;
use crate::swarm::sender::Sender;

/// Set-points as the journal has them.
#[derive(Serialize, Deserialize)]
struct Applied {
    controller: String,
    sequence: u64,
    set: SetPoints,
}

/// Reads what a controller put, with the epoch that it is meant for.
///
/// # Errors
///
/// What is wrong with it.
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
    // A number that JSON has none for is refused by the swarm's own bounds.
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

/// What the journal says was applied.
///
/// # Errors
///
/// [`CommandError`] when it is not as it was written.
pub fn order(request: &jostle_proto::Request) -> Result<Command, CommandError> {
    let Applied {
        controller,
        sequence,
        set,
    } = request.args()?;
    check_name("controller", &controller)?;
    Ok(Command::Control {
        controller,
        sequence,
        set: set_points(set)?,
    })
}
