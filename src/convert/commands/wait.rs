//! `get/wait`: replies when a condition becomes true.

use std::time::Duration;

use crate::convert::commands::{CommandError, selector};
use crate::swarm::command::WaitCondition;

/// Maximum timeout of one `wait`; client libraries repeat it.
pub const MAX_WAIT: Duration = Duration::from_secs(30);

/// Parses the condition and the timeout from the parameters of a selector.
///
/// # Errors
///
/// [`CommandError`] unless exactly one of `step` and `phase` is given, and valid.
pub fn read<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<(WaitCondition, Duration), CommandError> {
    let (mut step, mut phase, mut timeout) = (None, None, MAX_WAIT);
    for (name, value) in selector(parameters, &["step", "phase", "timeout_secs"])? {
        match name {
            "step" => {
                let wrong = |_| CommandError::Field {
                    field: "step",
                    problem: "is not a whole number",
                };
                step = Some(WaitCondition::Step(value.parse().map_err(wrong)?));
            }
            "phase" => {
                phase = Some(match value {
                    "paused" => WaitCondition::Paused,
                    "running" => WaitCondition::Running,
                    "faulted" => WaitCondition::Faulted,
                    _ => {
                        return Err(CommandError::Field {
                            field: "phase",
                            problem: "is not paused, running or faulted",
                        });
                    }
                });
            }
            _ => {
                let secs = value.parse().map_err(|_| CommandError::Field {
                    field: "timeout_secs",
                    problem: "is not a number",
                })?;
                timeout = check_timeout(secs)?;
            }
        }
    }
    match (step, phase) {
        (Some(awaited), None) | (None, Some(awaited)) => Ok((awaited, timeout)),
        _ => Err(CommandError::Field {
            field: "step",
            problem: "or phase is to be given, and only one of them: wait?step=100",
        }),
    }
}

/// Checks a timeout.
fn check_timeout(secs: f64) -> Result<Duration, CommandError> {
    if secs > 0.0 && secs <= MAX_WAIT.as_secs_f64() {
        return Ok(super::duration(secs));
    }
    Err(CommandError::Field {
        field: "timeout_secs",
        problem: "of a wait is above 0 and at most 30: ask again for longer",
    })
}
