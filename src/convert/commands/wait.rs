//! `get/wait`: replies when a condition becomes true.

use std::time::Duration;

use jostle_conditions::Condition;
use jostle_proto::contract::selectors;

use crate::convert::commands::swarm::check_event;
use crate::convert::commands::{CommandError, check_name, selector};
use crate::swarm::command::WaitCondition;

/// Maximum timeout of one `wait`; client libraries repeat it.
pub const MAX_WAIT: Duration = Duration::from_secs(30);

/// What a query waits for.
pub enum Awaited {
    /// A step, a phase or an event.
    Of(WaitCondition),
    /// A condition on measures, and the id that the client gave its wait.
    Holds(Box<Condition>, Option<String>),
}

/// Parses what is awaited and the timeout from the parameters of a selector.
pub fn read<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<(Awaited, Duration), CommandError> {
    let (mut awaited, mut id, mut timeout) = (Vec::new(), None, MAX_WAIT);
    for (name, value) in selector(parameters, selectors::WAIT)? {
        match name {
            "step" => {
                let wrong = |_| CommandError::field("step", "is not a whole number");
                let step = value.parse().map_err(wrong)?;
                awaited.push(Awaited::Of(WaitCondition::Step(step)));
            }
            "event" => {
                check_event(value)?;
                awaited.push(Awaited::Of(WaitCondition::Event(value.into())));
            }
            "phase" => {
                awaited.push(Awaited::Of(match value {
                    "paused" => WaitCondition::Paused,
                    "running" => WaitCondition::Running,
                    "faulted" => WaitCondition::Faulted,
                    _ => {
                        let problem = "is not paused, running or faulted";
                        return Err(CommandError::field("phase", problem));
                    }
                }));
            }
            "condition" => {
                let condition = Condition::parse(value)?;
                if let Some(reason) = condition.never_holds() {
                    return Err(CommandError::NeverHolds(reason));
                }
                awaited.push(Awaited::Holds(Box::new(condition), None));
            }
            "id" => {
                check_name("id", value)?;
                id = Some(value.to_owned());
            }
            _ => timeout = read_timeout(value)?,
        }
    }
    match (awaited.pop(), awaited.pop(), id) {
        (Some(Awaited::Holds(condition, _)), None, id) => {
            Ok((Awaited::Holds(condition, id), timeout))
        }
        (Some(Awaited::Of(_)), None, Some(_)) => {
            let problem = "is that of a wait for a condition: leave it out";
            Err(CommandError::field("id", problem))
        }
        (Some(of), None, None) => Ok((of, timeout)),
        _ => {
            let problem = "or one of phase, condition and event is required, and only one of them: \
                           wait?step=100";
            Err(CommandError::field("step", problem))
        }
    }
}

fn read_timeout(value: &str) -> Result<Duration, CommandError> {
    let secs = value.parse::<f64>().ok();
    let secs = secs.filter(|secs| *secs > 0.0 && *secs <= MAX_WAIT.as_secs_f64());
    secs.map(super::duration).ok_or(CommandError::WaitTimeout {
        max: MAX_WAIT.as_secs(),
    })
}
