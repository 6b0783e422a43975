//! `get/wait`: replies when a condition becomes true.

use std::time::Duration;

use crate::convert::commands::swarm::check_event;
use crate::convert::commands::{CommandError, selector};
use crate::swarm::command::WaitCondition;

/// Maximum timeout of one `wait`; client libraries repeat it.
pub const MAX_WAIT: Duration = Duration::from_secs(30);

/// Parses the condition and the timeout from the parameters of a selector.
pub fn read<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<(WaitCondition, Duration), CommandError> {
    let (mut step, mut phase, mut event, mut timeout) = (None, None, None, MAX_WAIT);
    for (name, value) in selector(parameters, &["step", "phase", "event", "timeout_secs"])? {
        match name {
            "step" => {
                let wrong = |_| CommandError::field("step", "is not a whole number");
                step = Some(WaitCondition::Step(value.parse().map_err(wrong)?));
            }
            "event" => {
                check_event(value)?;
                event = Some(WaitCondition::Event(value.into()));
            }
            "phase" => {
                phase = Some(match value {
                    "paused" => WaitCondition::Paused,
                    "running" => WaitCondition::Running,
                    "faulted" => WaitCondition::Faulted,
                    _ => {
                        let problem = "is not paused, running or faulted";
                        return Err(CommandError::field("phase", problem));
                    }
                });
            }
            _ => {
                let wrong = |_| CommandError::field("timeout_secs", "is not a number");
                timeout = check_timeout(value.parse().map_err(wrong)?)?;
            }
        }
    }
    match (step, phase, event) {
        (Some(awaited), None, None) | (None, Some(awaited), None) | (None, None, Some(awaited)) => {
            Ok((awaited, timeout))
        }
        _ => {
            let problem = "phase or event is required, and only one of them: wait?step=100";
            Err(CommandError::field("step", problem))
        }
    }
}

fn check_timeout(secs: f64) -> Result<Duration, CommandError> {
    if secs > 0.0 && secs <= MAX_WAIT.as_secs_f64() {
        return Ok(super::duration(secs));
    }
    let problem = "of a wait must be above 0 and at most 30: repeat it to wait longer";
    Err(CommandError::field("timeout_secs", problem))
}
