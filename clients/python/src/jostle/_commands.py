"""The commands of a swarm: requests that change it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Mapping
from types import EllipsisType
from typing import Any, Literal, SupportsIndex, TypeVar, Unpack, overload

import msgspec
from numpy.typing import ArrayLike

from ._arguments import (
    Region,
    Select,
    check_condition,
    check_select,
    measure_names,
    poses,
    whole_from_0,
    whole_or_none,
)
from ._batch import encode_changes
from ._changes import Change, Inform, Inject, Remove, Set, Uninform
from ._decode import read_batch, read_reply, read_scheduled
from ._errors import DeadlineExceeded, Internal, JostleError, Unavailable, invalid, late
from ._options import Options, check_options
from ._queries import BodyShape, Queries, stopped
from ._session import Session
from ._set import SetCommand
from ._state import State, fetch_state, read_step_reply
from ._wire import (
    BatchResult,
    IdsResult,
    Reply,
    ResetResult,
    RunResult,
    SetResult,
    Status,
    StepResult,
    WhenResult,
)

T = TypeVar("T")

# The daemon's limit of `timeout_secs`.
MAX_TIMEOUT_SECS = 3600.0


def _left(id: str | None) -> str:
    """How to remove a condition of this id."""
    return "" if id is None else f"; `when(cancel=True, id={id!r})` removes the condition"


class Pending(Exception):
    """The reply to a command that waits for its step; its argument is the `Scheduled`."""


class Commands(SetCommand, Queries):
    """The part of a `Swarm` that sends commands."""

    def __init__(
        self,
        session: Session,
        name: str,
        shape: BodyShape | None = None,
        at_step: int | None = None,
    ) -> None:
        super().__init__(session, name, shape)
        # The step of all its commands, which then raise `Pending`; None is the current step.
        self._at_step = at_step

    @overload
    def run(
        self,
        until: float | str | None = None,
        *,
        until_step: SupportsIndex | None = None,
        rate: float | EllipsisType | None = ...,
        wait: Literal[False] = False,
        **options: Unpack[Options],
    ) -> RunResult: ...
    @overload
    def run(
        self,
        until: float | str | None = None,
        *,
        until_step: SupportsIndex | None = None,
        rate: float | EllipsisType | None = ...,
        wait: Literal[True],
        show: bool | None = None,
        **options: Unpack[Options],
    ) -> Status: ...
    def run(
        self,
        until: float | str | None = None,
        *,
        until_step: SupportsIndex | None = None,
        rate: float | EllipsisType | None = ...,
        wait: bool = False,
        show: bool | None = None,
        **options: Unpack[Options],
    ) -> RunResult | Status:
        """Runs the swarm until an end or until it is paused.

            swarm.run(until=100.0, rate=None, wait=True)   # as fast as possible

        If the swarm is running, this changes its end and its rate.

        Args:
            until: Pause at the first step at or after this time, body sizes over free speed; or
                at the first step after which this condition holds, such as
                `"order > 0.9 for 20"`, see `when`.
            until_step: Pause at this step; at most one of the two.
            rate: Time units per second of wall clock; None is as fast as possible; left out, the
                rate does not change.
            wait: Return when the end is reached; requires an end. Without a `timeout` it has no
                limit.
            show: With `wait` and a step or time: show a progress bar; None shows it on a terminal
                and in a notebook.
            options: See `Options`.

        Returns:
            The end and the rate; with `wait`, the status at the end.

        Raises:
            DeadlineExceeded: With `wait`: the end is not reached within `timeout`; the swarm runs
                on, and `pause` pauses it. A condition is not removed.
            Faulted: With `wait`: the swarm faulted before the end.
            IncorrectState: The swarm is faulted, or controllers hold it: then its condition is
                removed again; or, with `wait`, it was paused or reset before the end.
            InvalidArgument: An argument is out of range, or `wait` without an end.
        """
        if wait and until is None and until_step is None:
            raise invalid(
                "wait",
                "waiting for a run without an end would never end: give `until` or `until_step`",
            )
        if isinstance(until, str):
            return self._run_until(until, until_step, rate, wait, options)
        args = _given(until_time=until, until_step=until_step)
        if not isinstance(rate, EllipsisType):
            args["rate"] = rate
        began = time.monotonic()
        result = self._command("run", args, RunResult, options)
        if not wait:
            return result
        end = result.until_step
        if end is None:
            return self.status()
        seconds = options.get("timeout")
        if seconds is None:
            return self.wait(step=end, show=show)
        try:
            left = max(began + seconds - time.monotonic(), 0.001)
            return self.wait(step=end, timeout=left, show=show)
        except DeadlineExceeded as error:
            raise self._runs_on(f"step {end}", seconds, error) from error

    def _run_until(
        self,
        condition: str,
        until_step: SupportsIndex | None,
        rate: float | EllipsisType | None,
        wait: bool,
        options: Options,
    ) -> RunResult | Status:
        """Runs the swarm until a condition holds: a `when`, then a `run`."""
        if until_step is not None:
            raise invalid("until", "until and until_step are both given: name one end")
        if "request_id" in options:
            raise invalid(
                "request_id",
                "request_id names one request, and a run until a condition sends two: leave it out",
            )
        began = time.monotonic()
        check_condition(condition)
        id = None
        # If it is scheduled, the `run` is scheduled for the same step, after it.
        with contextlib.suppress(Pending):
            args: dict[str, Any] = {"condition": condition, "pause": True}
            id = self._command("when", args, WhenResult, {**options}).id
        args = {} if isinstance(rate, EllipsisType) else {"rate": rate}
        try:
            result = self._command("run", args, RunResult, options)
        except (DeadlineExceeded, Internal, Unavailable):
            # It may have been executed.
            raise
        except JostleError:
            if id is not None:
                with contextlib.suppress(JostleError):
                    self.when(cancel=True, id=id)
            raise
        if not wait:
            return result
        seconds = options.get("timeout")
        try:
            left = None if seconds is None else max(began + seconds - time.monotonic(), 0.001)
            status = self.wait(phase="paused", timeout=left)
        except DeadlineExceeded as error:
            if seconds is None:
                raise
            raise self._runs_on(condition, seconds, error, id) from error
        is_waiting = any(it.id == id for it in status.conditions or ())
        if status.reason == "condition" and not is_waiting:
            return status
        raise stopped(
            status,
            f"swarm {self._name!r} is {status.phase} at step {status.step}, before {condition} "
            f"held: {status.reason or 'no reason given'}{_left(id) if is_waiting else ''}",
        )

    def _runs_on(
        self, end: str, seconds: float, error: DeadlineExceeded, id: str | None = None
    ) -> DeadlineExceeded:
        """The error when a run has not reached its end within the timeout."""
        what = f"swarm {self._name!r} did not reach {end}"
        remedy = "it runs on; `pause()` pauses it, `wait` waits for it"
        return late(what, seconds, remedy + _left(id), error)

    def pause(self, **options: Unpack[Options]) -> Reply:
        """Pauses the swarm after its current step; a paused swarm does not change.

        Args:
            options: See `Options`.

        Raises:
            IncorrectState: The swarm is faulted.
        """
        return self._command("pause", {}, Reply, options)

    @overload
    def step(
        self, steps: SupportsIndex = 1, *, state: Literal[False] = False, **options: Unpack[Options]
    ) -> StepResult: ...
    @overload
    def step(
        self, steps: SupportsIndex = 1, *, state: Literal[True], **options: Unpack[Options]
    ) -> State: ...
    def step(
        self, steps: SupportsIndex = 1, *, state: bool = False, **options: Unpack[Options]
    ) -> StepResult | State:
        """Steps a paused swarm, as fast as possible whatever its rate, and returns when it has.

            state = swarm.step(50, state=True)
            print(state.time, state.position.mean(axis=0))

        Each step solves the quadratic program of Principle 1, eq. (7), and takes `dt`.

        Args:
            steps: Number of steps: 1 to 10⁹.
            state: Return the state reached, with its `state_hash`.
            options: See `Options`; without a `timeout` it may take an hour, whatever the client's.

        Returns:
            The step reached: `steps` further, unless another command interrupted it.

        Raises:
            DeadlineExceeded: It takes longer than `timeout`. The swarm continues; `wait` waits.
            IncorrectState: The swarm is running or faulted.
            Conflict: The reply was lost, the daemon sent it again without its state (it stores
                replies of at most 4 KiB), and the swarm had changed since.
            Faulted: A step failed.
        """
        result, reached = self._step(steps, state, options)
        return result if reached is None else reached

    def _step(
        self, steps: SupportsIndex, state: bool, options: Options
    ) -> tuple[StepResult, State | None]:
        options.setdefault("timeout", MAX_TIMEOUT_SECS)
        if not state:
            return self._command("step", {"steps": steps}, StepResult, options), None
        payload = self._request("step", {"steps": steps, "return": "state"}, options)
        result, reached = read_step_reply(payload)
        if reached is None:
            reached = fetch_state(self._get, result)
        return result, self._with_pi1(reached)

    def reset(self, seed: SupportsIndex | None = None, **options: Unpack[Options]) -> ResetResult:
        """Resets the swarm to the start of its spec: step 0 of a new epoch, paused.

        Scheduled commands are rejected: each becomes an event `refused`.

        Args:
            seed: A new seed: 0 to 2⁵³ - 1; None keeps the seed.
            options: See `Options`.

        Raises:
            InvalidArgument: The seed is out of range.
            IncorrectState: The swarm is protected; see `protect`.
        """
        return self._command("reset", _given(seed=seed), ResetResult, options)

    def _set(self, change: Set, options: Options) -> SetResult:
        check_options("set", options)
        if change.measures is not None:
            change = msgspec.structs.replace(change, measures=measure_names(change.measures))
        if change == Set():
            *others, last = (it for it in Set.__struct_fields__ if it != "make_room")
            raise invalid(
                "args",
                f"nothing to set: give {', '.join(others)} or {last}; None leaves a parameter as "
                "it is",
            )
        result = self._change(change, SetResult, options)
        self._shape.pi1 = result.now.pi1
        return result

    def inform(
        self,
        select: Select,
        direction: float,
        *,
        weight: float | None = None,
        for_time: float | None = None,
        **options: Unpack[Options],
    ) -> IdsResult:
        """Informs individuals: each gets a preferred direction of its own.

            # A tenth of the group walks east, for 50 time units.
            leaders = swarm.inform(jostle.fraction(0.1), direction=0.0, for_time=50.0).ids
            # Then the same individuals turn north, with twice the weight.
            swarm.inform(jostle.ids(leaders), direction=math.pi / 2, weight=2.0)

        An informed individual turns towards `p_s + weight · p_p`, eq. (3): `p_s` is the mean of
        the unit vectors to the others, eq. (4), and `p_p` the unit vector of `direction`. If it is
        informed already, the new direction, weight and time replace the old ones.

        Args:
            select: Which individuals, such as `jostle.fraction(0.1)`; the daemon draws from the
                whole group.
            direction: The preferred direction, radians, counter-clockwise from +x.
            weight: Weight of the direction beside attraction: above 0; None is `pi2`.
            for_time: Uninform them after this time, body sizes over free speed; None is never.
            options: See `Options`.

        Returns:
            The ids of the individuals, and the size of the group.

        Raises:
            InvalidArgument: An argument is out of range, or an individual does not exist.
            IncorrectState: The swarm is faulted.
        """
        change = Inform(check_select(select), direction, weight, for_time)
        return self._change(change, IdsResult, options)

    def uninform(self, select: Select, **options: Unpack[Options]) -> IdsResult:
        """Removes the preferred direction of individuals.

            swarm.uninform(jostle.fraction(1.0))   # all of them

        Args:
            select: Which individuals, such as `jostle.ids([1, 2])`; the daemon draws from the
                informed ones.
            options: See `Options`.

        Returns:
            The ids of the individuals, and the size of the group.

        Raises:
            InvalidArgument: An individual does not exist.
            IncorrectState: The swarm is faulted.
        """
        return self._change(Uninform(check_select(select)), IdsResult, options)

    def inject(
        self,
        count: SupportsIndex | None = None,
        *,
        at: ArrayLike | None = None,
        within: Region | tuple[float, float, float] | None = None,
        direction: float | None = None,
        weight: float | None = None,
        **options: Unpack[Options],
    ) -> IdsResult:
        """Adds individuals where they overlap no other body.

            swarm.inject(5, within=(0.0, 0.0, 10.0))          # five, in a disc
            swarm.inject(at=[[12.0, 0.0, math.pi]], direction=math.pi)

        Args:
            count: Number of individuals, drawn at the border of the group, or `within` a disc.
            at: Their poses instead: rows of x, y, alpha, shape (m, 3), absolute positions in body
                sizes and headings in radians.
            within: With `count`: the disc, absolute centre and radius in body sizes.
            direction: Informs them: their preferred direction, radians from +x; None does not.
            weight: With `direction`: its weight beside attraction, above 0; None is `pi2`.
            options: See `Options`.

        Returns:
            The ids of the new individuals, and the size of the group.

        Raises:
            InvalidArgument: An argument is out of range, or a pose overlaps a body.
            IncorrectState: The swarm is faulted.
            ResourceExhausted: The disc has no space, or the daemon's `max_individuals` is reached.
        """
        if isinstance(within, tuple):
            x, y, radius = within
            within = Region(x=x, y=y, radius=radius)
        poses_ = None if at is None else poses(at)
        change = Inject(whole_or_none("count", count), poses_, within, direction, weight)
        return self._change(change, IdsResult, options)

    def remove(self, select: Select, **options: Unpack[Options]) -> IdsResult:
        """Removes individuals from the group. The last one cannot be removed.

            swarm.remove(jostle.within(0.0, 0.0, 5.0))

        Args:
            select: Which individuals, such as `jostle.count(3)`; the daemon draws from the whole
                group.
            options: See `Options`.

        Returns:
            The ids of the removed individuals, and the size of the group.

        Raises:
            InvalidArgument: An individual does not exist, or none would be left.
        """
        return self._change(Remove(check_select(select)), IdsResult, options)

    def batch(
        self,
        changes: Iterable[Change | Mapping[str, Any]],
        *,
        draw: SupportsIndex | None = None,
        protocol: bool = False,
        **options: Unpack[Options],
    ) -> BatchResult:
        """Applies several changes at one step, or none of them.

            swarm.batch([jostle.Set(pi3=2.0), jostle.Inform(jostle.fraction(0.1), 0.0)])

        Args:
            changes: 1 to 256 of `Set`, `Inform`, `Uninform`, `Inject` and `Remove`, applied in this
                order; or mappings with `verb` and `args`, as on the wire.
            draw: With the seed of the swarm, the key of the random draws of the first change; each
                further change adds 1. None is the `seq` of the change.
            protocol: The command is part of a protocol: without `draw` the key is the number of the
                swarm's changes so far by such commands without `draw`, plus 1.
            options: See `Options`.

        Returns:
            The result of each change.

        Raises:
            JostleError: The error of the first invalid change; `details["field"]` names it, such
                as `commands[1].args.pi1`. No change was applied.
        """
        args: dict[str, Any] = {"commands": encode_changes(changes)}
        if draw is not None:
            args["draw"] = whole_from_0("draw", draw)
        if protocol:
            args["protocol"] = True
        payload = self._request("batch", args, options)
        result = read_batch(payload)
        for changed in result.results:
            if changed.now is not None:
                self._shape.pi1 = changed.now.pi1
        return result

    def annotate(self, text: str, **options: Unpack[Options]) -> Reply:
        """Writes a note into the swarm's journal and events, in every phase.

            swarm.annotate("camera 2 replaced")
            notes = [entry.args["text"] for entry in swarm.journal() if entry.verb == "annotate"]

        The state and the random draws of later commands do not change.

        Args:
            text: The note: 1 to 1000 characters in one line, without control characters.
            options: See `Options`.

        Raises:
            InvalidArgument: The text is empty, too long, or not one line.
        """
        return self._command("annotate", {"text": text}, Reply, options)

    def protect(self, *, on: bool = True, **options: Unpack[Options]) -> Reply:
        """Protects the swarm from `delete` and `reset`, or ends that, in every phase.

            swarm.protect()
            swarm.protect(on=False)

        While it is protected, `delete` and `reset` of every client raise `IncorrectState`; all
        else works as before. `Status.protected` and `SwarmSummary.protected` say it. A fork, and a
        swarm restored from a snapshot, begin unprotected. The state and the random draws of later
        commands do not change.

        Args:
            on: Whether it is protected from now on.
            options: See `Options`.

        Raises:
            IncorrectState: The swarm is a playback.
        """
        return self._command("protect", {"on": on}, Reply, options)

    def when(
        self,
        condition: str | None = None,
        *,
        pause: bool = False,
        commands: Iterable[Change | Mapping[str, Any]] | None = None,
        event: str | None = None,
        from_step: SupportsIndex | None = None,
        before_step: SupportsIndex | None = None,
        draw: SupportsIndex | None = None,
        protocol: bool = False,
        cancel: bool = False,
        id: str | None = None,
        **options: Unpack[Options],
    ) -> WhenResult:
        """Pauses or changes the swarm once, at the first step after which a condition holds.

            swarm.when("order > 0.9 for 20", pause=True)
            swarm.when("drift < 0.1", commands=[jostle.Inform(jostle.fraction(0.1), 0.0)])
            swarm.when(cancel=True)  # removes all waiting conditions
            for it in swarm.status().conditions or []:
                swarm.when(cancel=True, id=it.id)  # removes one

        `Status.conditions` lists the waiting conditions and who sent them, at most 16. When one
        holds, it is removed, and an event `command` or `refused` of the verb `fired` reports the
        outcome. `reset` removes all.

        Args:
            condition: The condition, such as `drift > 0.9 for 20 and order > 0.5`; times are in
                body sizes over free speed.
            pause: Pause the swarm; give exactly one of `pause`, `commands` and `event`.
            commands: Apply these changes, as `batch` does: all at one step, or none.
            event: Only publish the event `fired`, with this name of 1 to 64 characters; it changes
                no random draw. See `wait`.
            from_step: Evaluate states from this step on; if the swarm is there already, its
                present state is the first. None is the step after the next one.
            before_step: Remove the condition at this step.
            draw: With `commands`: as in `batch`.
            protocol: With `commands`: as in `batch`. With `pause`: end the protocol; the scheduled
                commands and the other conditions without `event` are removed.
            cancel: Remove all waiting conditions, or with `event` or `id` that one; give it without
                others.
            id: With `cancel`: the id of a condition, in `Status.conditions`.
            options: See `Options`.

        Returns:
            The reply with the id of the condition, by which `cancel` removes it.

        Raises:
            Conflict: With `from_step`: the condition holds in the present state already.
            InvalidArgument: The condition is invalid (the message has the column), a measure in it
                needs too many earlier states, or a change is invalid.
            NotFound: With `id`: no condition of this id waits.
            ResourceExhausted: 16 conditions wait already, or their measures cost too much together.
            IncorrectState: The swarm is faulted.
        """
        steps = _given(from_step=from_step, before_step=before_step, draw=draw)
        args = _given(condition=condition, event=event, id=id)
        args.update({name: whole_from_0(name, step) for name, step in steps.items()})
        if protocol:
            args["protocol"] = True
        if pause:
            args["pause"] = True
        if commands is not None:
            args["commands"] = encode_changes(commands)
        if cancel:
            args["cancel"] = True
        return self._command("when", args, WhenResult, options)

    def delete(self, **options: Unpack[Options]) -> Reply:
        """Deletes the swarm and its history from the daemon, permanently.

        Args:
            options: See `Options`.

        Raises:
            Contested: Several daemons have a swarm of this name; see `Client.discard`.
            IncorrectState: The swarm is protected; see `protect`.
        """
        return self._command("delete", {}, Reply, options)

    def _change(self, change: Change, kind: type[T], options: Options) -> T:
        return self._command(change.verb, change, kind, options)

    def _command(
        self, verb: str, args: dict[str, Any] | Change, kind: type[T], options: Options
    ) -> T:
        return read_reply(self._request(verb, args, options), kind)

    def _request(self, verb: str, args: dict[str, Any] | Change, options: Options) -> bytes:
        """Sends a command and returns the payload of the reply.

        Raises:
            Pending: It is for a later step.
        """
        check_options(verb, options)
        key = self._session.swarm_key(self._name, f"cmd/{verb}")
        payload = self._session.command(
            key, args, swarm=self._name, at_step=self._at_step, **options
        )
        if self._at_step is not None and (scheduled := read_scheduled(payload)) is not None:
            raise Pending(scheduled)
        return payload


def _given(**arguments: object) -> dict[str, Any]:
    """The arguments that are not None."""
    return {name: value for name, value in arguments.items() if value is not None}
