//! `get/wait`: an answer when something has come about.

use std::time::Duration;

use crate::convert::commands::{CommandError, selector};
use crate::swarm::command::WaitCondition;

/// The longest that one `wait` is held; libraries ask again.
pub const LONGEST_WAIT: Duration = Duration::from_secs(30);

/// Reads what is waited for, and for how long, from a selector's parameters.
///
/// # Errors
///
/// [`CommandError`] when not exactly one of `step` and `phase` is given, or one is wrong.
pub fn read<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<(WaitCondition, Duration), CommandError> {
    let (mut step, mut phase, mut timeout) = (None, None, LONGEST_WAIT);
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
                timeout = held(secs)?;
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

/// How long a wait is held.
fn held(secs: f64) -> Result<Duration, CommandError> {
    if secs > 0.0 && secs <= LONGEST_WAIT.as_secs_f64() {
        return Ok(super::duration(secs));
    }
    Err(CommandError::Field {
        field: "timeout_secs",
        problem: "of a wait is above 0 and at most 30: ask again for longer",
    })
}
