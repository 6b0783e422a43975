//! `seek`: moves a playback to another frame.

use jostle_proto::SeekArgs;

use crate::convert::commands::CommandError;
use crate::swarm::command::Seek;
use jostle_convert::WireError;

/// Maximum time to seek.
const MAX_TIME: f64 = 1e12;

/// Converts the arguments.
pub fn seek(args: SeekArgs) -> Result<Seek, CommandError> {
    match (args.step, args.time, args.fraction) {
        (Some(step), None, None) => Ok(Seek::Step(jostle_convert::value::whole("step", step)?)),
        (None, Some(time), None) if (0.0..=MAX_TIME).contains(&time) => Ok(Seek::Time(time)),
        (None, Some(time), None) => Err(WireError::out_of_range("time", time).into()),
        (None, None, Some(share)) if (0.0..=1.0).contains(&share) => Ok(Seek::Fraction(share)),
        (None, None, Some(share)) => Err(WireError::out_of_range("fraction", share).into()),
        _ => Err(CommandError::Field {
            field: "args",
            problem: "must have exactly one of step, time and fraction",
        }),
    }
}
