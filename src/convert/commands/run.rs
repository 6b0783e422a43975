//! `run`: steps at a rate, until a step or time, or without end.

use jostle_proto::verbs::RunArgs;

use crate::convert::commands::CommandError;
use crate::swarm::command::{Command, Until};
use jostle_convert::WireError;

/// Maximum end of a run: longer than any run, and exact as a number of steps.
const MAX_TIME: f64 = 1e12;

/// Converts the arguments.
///
/// # Errors
///
/// [`CommandError`] for an end or a rate out of range, and for two ends.
pub fn order(args: RunArgs) -> Result<Command, CommandError> {
    let until = match (args.until_step, args.until_time) {
        (Some(_), Some(_)) => {
            return Err(CommandError::Field {
                field: "until_time",
                problem: "and until_step are both given: name one end",
            });
        }
        (Some(step), None) => Some(Until::Step(jostle_convert::value::whole(
            "until_step",
            step,
        )?)),
        (None, Some(time)) if (0.0..=MAX_TIME).contains(&time) => Some(Until::Time(time)),
        (None, Some(time)) => return Err(WireError::out_of_range("until_time", time).into()),
        (None, None) => None,
    };
    let rate = args.rate.map(jostle_convert::value::rate).transpose()?;
    Ok(Command::Run { until, rate })
}
