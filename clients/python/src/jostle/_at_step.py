"""The commands of a swarm at a later step."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from types import EllipsisType
from typing import Any, Concatenate, ParamSpec, SupportsIndex, TypeVar, Unpack

from ._commands import Commands, Pending
from ._messages import Scheduled
from ._options import Options, check_options
from ._state import State
from ._wire import Reply, RunResult, StepResult

P = ParamSpec("P")
R = TypeVar("R", bound=Reply)


def _scheduled(
    method: Callable[Concatenate[Commands, P], R],
) -> Callable[Concatenate[AtStep, P], Scheduled[R]]:
    """The command of a swarm, as a method of `AtStep`."""

    @functools.wraps(method)
    def scheduled(self: AtStep, /, *args: P.args, **kwargs: P.kwargs) -> Scheduled[R]:
        return self._schedule(lambda: method(self._commands, *args, **kwargs))

    signature = inspect.signature(method)
    annotation = f"Scheduled[{signature.return_annotation}]"
    vars(scheduled)["__signature__"] = signature.replace(return_annotation=annotation)
    return scheduled


class AtStep:
    """The commands of a swarm at one step; `Swarm.at` makes one.

        at_1000 = swarm.at(1000)
        at_1000.batch([jostle.Set(pi3=1.5), jostle.Inform(jostle.ids([0, 1]), direction=0.0)])
        swarm.at(2000).pause()

    Each method takes the arguments of the method of the same name of `Swarm`, and raises what that
    raises; `run` does not take `wait`. If the step lies ahead, the daemon stores the command and
    executes it at that step, so that an experiment on a running swarm can be repeated exactly.

    Each returns a `Scheduled`, and raises `Conflict` if the swarm has passed the step. While a
    command waits, `Status.scheduled` counts it; at its step an event `command` or `refused` of the
    same `request_id` reports the outcome.
    """

    def __init__(self, commands: Commands, step: int) -> None:
        self._commands = commands
        self._step = step

    def __repr__(self) -> str:
        return f"AtStep({self._step} of {self._commands.name!r})"

    def run(
        self,
        until: float | str | None = None,
        *,
        until_step: SupportsIndex | None = None,
        rate: float | EllipsisType | None = ...,
        **options: Unpack[Options],
    ) -> Scheduled[RunResult]:
        """Runs the swarm from this step on, as `Swarm.run`.

        Args:
            until: As in `Swarm.run`.
            until_step: As in `Swarm.run`.
            rate: As in `Swarm.run`.
            options: See `Options`.
        """
        check_options("run", options)
        return self._schedule(
            lambda: self._commands.run(until, until_step=until_step, rate=rate, **options)
        )

    def step(
        self, steps: SupportsIndex = 1, *, state: bool = False, **options: Unpack[Options]
    ) -> Scheduled[StepResult | State]:
        """Steps the swarm when it is at this step, as `Swarm.step`.

        Args:
            steps: As in `Swarm.step`.
            state: Have the state reached as the `outcome`, if the swarm is at the step now.
            options: See `Options`.
        """
        return self._schedule(lambda: self._commands._step(steps, state, options))

    pause = _scheduled(Commands.pause)
    reset = _scheduled(Commands.reset)
    set = _scheduled(Commands.set)
    inform = _scheduled(Commands.inform)
    uninform = _scheduled(Commands.uninform)
    inject = _scheduled(Commands.inject)
    remove = _scheduled(Commands.remove)
    batch = _scheduled(Commands.batch)
    annotate = _scheduled(Commands.annotate)
    protect = _scheduled(Commands.protect)
    when = _scheduled(Commands.when)
    delete = _scheduled(Commands.delete)

    def _schedule(
        self, send: Callable[[], Reply | tuple[StepResult, State | None]]
    ) -> Scheduled[Any]:
        """Sends a command; it is executed at once if the swarm is at the step."""
        try:
            result = send()
        except Pending as pending:
            scheduled: Scheduled[Any] = pending.args[0]
            return scheduled
        reply, state = result if isinstance(result, tuple) else (result, None)
        fields = {name: getattr(reply, name) for name in Reply.__struct_fields__}
        outcome = reply if state is None else state
        return Scheduled(**fields, applies_at_step=self._step, outcome=outcome)
