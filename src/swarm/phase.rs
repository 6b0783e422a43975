//! The phases of a swarm: a pure state machine.

use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The phase of a swarm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Not moving; every command is accepted.
    Paused(PauseReason),
    /// Stepping, at its rate.
    Running {
        /// The step at which it pauses; without it the swarm runs until a command.
        until: Option<u64>,
    },
    /// Stepping as fast as possible, whatever the rate, to the step that a command waits for.
    Stepping {
        /// The step at which it pauses.
        until: u64,
    },
    /// A step failed; the state is the last good one.
    Faulted(String),
}

/// Why a swarm is paused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PauseReason {
    /// It was just created.
    Created,
    /// A client paused it.
    Requested,
    /// It reached the end of its run.
    Finished,
    /// It was reset.
    Reset,
    /// It was just forked from another swarm.
    Forked,
    /// It was just restored from a snapshot.
    Restored,
    /// It waits for its controllers.
    Lockstep,
    /// A controller that joined with `on_timeout: pause` missed its deadline.
    Deadline,
    /// A condition of `when` holds.
    Condition,
}

impl fmt::Display for PauseReason {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(formatter)
    }
}

/// An input of the state machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhaseInput {
    /// Run, to a step or without an end.
    Run(Option<u64>),
    /// Pause.
    Pause,
    /// Step to this step as fast as possible.
    Step(u64),
    /// Change parameters or the group.
    Change,
    /// Return to the start.
    Reset,
    /// This step has been reached.
    Reached(u64),
}

/// Why the phase does not allow a command.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[expect(missing_docs, reason = "the messages say when each is returned")]
pub enum PhaseError {
    #[error("the swarm is running: pause it first")]
    Running,
    #[error("the swarm is stepping already: wait for that reply, or pause it first")]
    Stepping,
    /// A command other than `reset`, `delete`, `annotate` and `protect` after a fault.
    #[error("the swarm has faulted and keeps its last good state: reset or delete it")]
    Faulted,
}

/// The phase that follows `phase` after `input`.
pub fn next(phase: &Phase, input: PhaseInput) -> Result<Phase, PhaseError> {
    use Phase::{Faulted, Paused, Running, Stepping};
    match (phase, input) {
        (_, PhaseInput::Reset) => Ok(Paused(PauseReason::Reset)),
        (Faulted(_), PhaseInput::Reached(_)) => Ok(phase.clone()),
        (Faulted(_), _) => Err(PhaseError::Faulted),

        (Paused(_) | Running { .. } | Stepping { .. }, PhaseInput::Run(until)) => {
            Ok(Running { until })
        }
        (Running { .. } | Stepping { .. }, PhaseInput::Pause) => Ok(Paused(PauseReason::Requested)),
        (Paused(_), PhaseInput::Step(until)) => Ok(Stepping { until }),
        (Running { .. }, PhaseInput::Step(_)) => Err(PhaseError::Running),
        (Stepping { .. }, PhaseInput::Step(_)) => Err(PhaseError::Stepping),
        (Running { until: Some(until) } | Stepping { until }, PhaseInput::Reached(step))
            if step >= *until =>
        {
            Ok(Paused(PauseReason::Finished))
        }
        (Paused(_), PhaseInput::Pause) | (_, PhaseInput::Change | PhaseInput::Reached(_)) => {
            Ok(phase.clone())
        }
    }
}

impl Phase {
    /// Whether it is running or stepping.
    pub fn is_moving(&self) -> bool {
        matches!(self, Phase::Running { .. } | Phase::Stepping { .. })
    }

    /// The step at which it pauses by itself.
    pub fn until(&self) -> Option<u64> {
        match self {
            Phase::Running { until } => *until,
            Phase::Stepping { until } => Some(*until),
            Phase::Paused(_) | Phase::Faulted(_) => None,
        }
    }

    /// Why the swarm does not move.
    pub fn reason(&self) -> Option<String> {
        match self {
            Phase::Paused(reason) => Some(reason.to_string()),
            Phase::Faulted(reason) => Some(reason.clone()),
            Phase::Running { .. } | Phase::Stepping { .. } => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every cell of the table of phases and inputs.
    #[test]
    fn every_input_in_every_phase_does_what_the_table_says() {
        let paused = Phase::Paused(PauseReason::Created);
        let running = Phase::Running { until: Some(9) };
        let stepping = Phase::Stepping { until: 9 };
        let faulted = Phase::Faulted("bodies crossed".into());
        let requested = Phase::Paused(PauseReason::Requested);
        let finished = Phase::Paused(PauseReason::Finished);
        let reset = Phase::Paused(PauseReason::Reset);
        let on = Phase::Running { until: None };
        let to_20 = Phase::Stepping { until: 20 };
        let rejected = Err(PhaseError::Faulted);

        let table = [
            (&paused, PhaseInput::Run(None), Ok(&on)),
            (&paused, PhaseInput::Pause, Ok(&paused)),
            (&paused, PhaseInput::Step(20), Ok(&to_20)),
            (&paused, PhaseInput::Change, Ok(&paused)),
            (&paused, PhaseInput::Reset, Ok(&reset)),
            (&paused, PhaseInput::Reached(9), Ok(&paused)),
            (&running, PhaseInput::Run(None), Ok(&on)),
            (&running, PhaseInput::Pause, Ok(&requested)),
            (&running, PhaseInput::Step(20), Err(PhaseError::Running)),
            (&running, PhaseInput::Change, Ok(&running)),
            (&running, PhaseInput::Reset, Ok(&reset)),
            (&running, PhaseInput::Reached(8), Ok(&running)),
            (&running, PhaseInput::Reached(9), Ok(&finished)),
            (&on, PhaseInput::Reached(u64::MAX), Ok(&on)),
            (&stepping, PhaseInput::Run(None), Ok(&on)),
            (&stepping, PhaseInput::Pause, Ok(&requested)),
            (&stepping, PhaseInput::Step(20), Err(PhaseError::Stepping)),
            (&stepping, PhaseInput::Change, Ok(&stepping)),
            (&stepping, PhaseInput::Reset, Ok(&reset)),
            (&stepping, PhaseInput::Reached(8), Ok(&stepping)),
            (&stepping, PhaseInput::Reached(9), Ok(&finished)),
            (&faulted, PhaseInput::Run(None), rejected),
            (&faulted, PhaseInput::Pause, rejected),
            (&faulted, PhaseInput::Step(20), rejected),
            (&faulted, PhaseInput::Change, rejected),
            (&faulted, PhaseInput::Reset, Ok(&reset)),
            (&faulted, PhaseInput::Reached(9), Ok(&faulted)),
        ];
        for (phase, input, expected) in table {
            assert_eq!(
                next(phase, input).as_ref().map_err(|error| *error),
                expected,
                "{phase:?} at {input:?}"
            );
        }
    }
}
