//! What a swarm is doing, and what an order makes of it: a pure state machine.

use std::fmt;

use thiserror::Error;

/// What a swarm is doing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Standing still, open to every command.
    Paused(PauseReason),
    /// Stepping, at its rate.
    Running {
        /// The step it pauses at; without one it runs until told otherwise.
        until: Option<u64>,
    },
    /// Stepping as fast as it can, whatever its rate, to a step that a command waits for.
    Stepping {
        /// The step it pauses at.
        until: u64,
    },
    /// A step failed; the last good state is kept.
    Faulted(String),
}

/// Why a swarm is paused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PauseReason {
    /// It was just created.
    Created,
    /// It was told to.
    Requested,
    /// It reached the step it was to run to.
    Finished,
    /// It was put back to its start.
    Reset,
    /// It was just made as another swarm was.
    Forked,
    /// It was just made from a snapshot.
    Restored,
    /// It waits for its controllers.
    Lockstep,
    /// A controller was late that joined to have it paused then.
    Deadline,
}

impl PauseReason {
    /// Every reason.
    pub const ALL: [PauseReason; 8] = [
        PauseReason::Created,
        PauseReason::Requested,
        PauseReason::Finished,
        PauseReason::Reset,
        PauseReason::Forked,
        PauseReason::Restored,
        PauseReason::Lockstep,
        PauseReason::Deadline,
    ];
}

impl fmt::Display for PauseReason {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            PauseReason::Created => "created",
            PauseReason::Requested => "requested",
            PauseReason::Finished => "finished",
            PauseReason::Reset => "reset",
            PauseReason::Forked => "forked",
            PauseReason::Restored => "restored",
            PauseReason::Lockstep => "lockstep",
            PauseReason::Deadline => "deadline",
        })
    }
}

/// What may change a phase.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PhaseInput {
    /// Run, to a step or for good.
    Run(Option<u64>),
    /// Stand still.
    Pause,
    /// Go to this step as fast as possible.
    Step(u64),
    /// A change of parameters or of the group is to be applied.
    Change,
    /// Go back to the start.
    Reset,
    /// This step has been reached.
    Reached(u64),
    /// A step failed.
    Fault(String),
}

/// An order that the phase does not allow.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum PhaseError {
    /// `step` while it runs.
    #[error("the swarm is running: pause it first")]
    Running,
    /// `step` while steps are being taken.
    #[error("the swarm is stepping already: wait for that answer, or pause it first")]
    Stepping,
    /// Anything but `reset`, `delete` and the gets after a fault.
    #[error("the swarm has faulted and keeps its last good state: reset or delete it")]
    Faulted,
}

/// The phase that `cue` makes of `phase`.
///
/// # Errors
///
/// [`PhaseError`] when the phase does not allow it; nothing has changed then.
pub fn next(phase: &Phase, cue: PhaseInput) -> Result<Phase, PhaseError> {
    use Phase::{Faulted, Paused, Running, Stepping};
    match (phase, cue) {
        (_, PhaseInput::Reset) => Ok(Paused(PauseReason::Reset)),
        (_, PhaseInput::Fault(reason)) => Ok(Faulted(reason)),
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
    /// Whether steps are being taken.
    pub fn is_moving(&self) -> bool {
        matches!(self, Phase::Running { .. } | Phase::Stepping { .. })
    }

    /// The step it will pause at by itself.
    pub fn until(&self) -> Option<u64> {
        match self {
            Phase::Running { until } => *until,
            Phase::Stepping { until } => Some(*until),
            Phase::Paused(_) | Phase::Faulted(_) => None,
        }
    }

    /// Why it does not move.
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

    /// The table of DESIGN.md, cell by cell.
    #[test]
    fn every_order_in_every_phase_does_what_the_table_says() {
        let paused = Phase::Paused(PauseReason::Created);
        let running = Phase::Running { until: Some(9) };
        let stepping = Phase::Stepping { until: 9 };
        let faulted = Phase::Faulted("bodies crossed".into());
        let requested = Phase::Paused(PauseReason::Requested);
        let finished = Phase::Paused(PauseReason::Finished);
        let reset = Phase::Paused(PauseReason::Reset);
        let on = Phase::Running { until: None };
        let to_20 = Phase::Stepping { until: 20 };
        let broken = Phase::Faulted("no solution".into());
        let fault = || PhaseInput::Fault("no solution".into());
        let refused = Err(PhaseError::Faulted);

        let table = [
            (&paused, PhaseInput::Run(None), Ok(&on)),
            (&paused, PhaseInput::Pause, Ok(&paused)),
            (&paused, PhaseInput::Step(20), Ok(&to_20)),
            (&paused, PhaseInput::Change, Ok(&paused)),
            (&paused, PhaseInput::Reset, Ok(&reset)),
            (&paused, PhaseInput::Reached(9), Ok(&paused)),
            (&paused, fault(), Ok(&broken)),
            (&running, PhaseInput::Run(None), Ok(&on)),
            (&running, PhaseInput::Pause, Ok(&requested)),
            (&running, PhaseInput::Step(20), Err(PhaseError::Running)),
            (&running, PhaseInput::Change, Ok(&running)),
            (&running, PhaseInput::Reset, Ok(&reset)),
            (&running, PhaseInput::Reached(8), Ok(&running)),
            (&running, PhaseInput::Reached(9), Ok(&finished)),
            (&on, PhaseInput::Reached(u64::MAX), Ok(&on)),
            (&running, fault(), Ok(&broken)),
            (&stepping, PhaseInput::Run(None), Ok(&on)),
            (&stepping, PhaseInput::Pause, Ok(&requested)),
            (&stepping, PhaseInput::Step(20), Err(PhaseError::Stepping)),
            (&stepping, PhaseInput::Change, Ok(&stepping)),
            (&stepping, PhaseInput::Reset, Ok(&reset)),
            (&stepping, PhaseInput::Reached(8), Ok(&stepping)),
            (&stepping, PhaseInput::Reached(9), Ok(&finished)),
            (&stepping, fault(), Ok(&broken)),
            (&faulted, PhaseInput::Run(None), refused),
            (&faulted, PhaseInput::Pause, refused),
            (&faulted, PhaseInput::Step(20), refused),
            (&faulted, PhaseInput::Change, refused),
            (&faulted, PhaseInput::Reset, Ok(&reset)),
            (&faulted, PhaseInput::Reached(9), Ok(&faulted)),
        ];
        for (phase, cue, expected) in table {
            assert_eq!(
                next(phase, cue.clone()).as_ref().map_err(|error| *error),
                expected,
                "{phase:?} at {cue:?}"
            );
        }
    }
}
