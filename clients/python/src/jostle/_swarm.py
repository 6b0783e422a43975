"""A swarm on a daemon, by name."""

from __future__ import annotations

import time
import weakref
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import EllipsisType, TracebackType
from typing import Any, Literal, Self, SupportsIndex, TypedDict, TypeVar, Unpack, overload

from numpy.typing import ArrayLike

from ._arguments import Region, Select, check_name, check_seconds, poses, whole
from ._errors import DeadlineExceeded, Faulted, IncorrectState, InvalidArgument
from ._link import Link
from ._messages import (
    Event,
    IdsResult,
    OrderSample,
    Phase,
    Reply,
    ResetResult,
    RunResult,
    SetResult,
    Spec,
    SpecReply,
    Status,
    StepResult,
    read_event,
    read_json,
    read_reply,
)
from ._state import Newest, State, read_state, read_state_reply
from ._stream import Stream

T = TypeVar("T")

# The longest that the daemon takes for a `timeout_secs`.
_PATIENT_SECS = 3600.0
# The daemon holds a `get/wait` no longer than this; it is asked again until the caller's deadline.
_HOLD_SECS = 30.0
# Events are rare and each counts; this many unread ones are kept, and a gap in their numbers shows.
_EVENTS_KEPT = 10_000


class Options(TypedDict, total=False):
    """What any command may be given besides its own arguments.

    Attributes:
        expect_step: Raise `Conflict` and change nothing unless the swarm is at this step.
        expect_epoch: Raise `Conflict` and change nothing unless the swarm is in this epoch.
        timeout: Seconds the command may take; the client's `timeout` if left out.
    """

    expect_step: SupportsIndex
    expect_epoch: SupportsIndex
    timeout: float


class Swarm:
    """A swarm on a daemon, by name; `Client.create` and `Client.swarm` make one.

    It holds nothing but the name and its open streams. Leaving its `with` block closes those
    streams; the swarm itself lives on in the daemon until `delete`.

    Every command takes `expect_step`, `expect_epoch` and `timeout` (see `Options`) and raises a
    `JostleError`. Wherever a number or a column of numbers is taken, NumPy's are too. Lengths are
    in body sizes, speeds in free speeds, times in their quotient, angles in radians,
    counter-clockwise from +x.
    """

    def __init__(self, link: Link, name: str) -> None:
        self._link = link
        self._name = check_name("swarm", name)
        self._streams: weakref.WeakSet[Stream[Any]] = weakref.WeakSet()

    @property
    def name(self) -> str:
        """The swarm's name."""
        return self._name

    def __repr__(self) -> str:
        return f"Swarm({self._name!r} at {self._link.endpoint})"

    # Commands: they change something.

    @overload
    def run(
        self,
        until: float | None = None,
        *,
        until_step: SupportsIndex | None = None,
        rate: float | EllipsisType | None = ...,
        wait: Literal[False] = False,
        **options: Unpack[Options],
    ) -> RunResult: ...
    @overload
    def run(
        self,
        until: float | None = None,
        *,
        until_step: SupportsIndex | None = None,
        rate: float | EllipsisType | None = ...,
        wait: Literal[True],
        **options: Unpack[Options],
    ) -> Status: ...
    def run(
        self,
        until: float | None = None,
        *,
        until_step: SupportsIndex | None = None,
        rate: float | EllipsisType | None = ...,
        wait: bool = False,
        **options: Unpack[Options],
    ) -> RunResult | Status:
        """Lets it run, to an end or until paused; changes end and rate if it runs already.

        Args:
            until: Pause at the first step at or after this time.
            until_step: Pause at this step; at most one of the two.
            rate: Time units per second of wall clock; None is as fast as possible; left out, no
                change.
            wait: Return when it has arrived, however long that takes. It needs an end.
            options: See `Options`.

        Returns:
            How it now runs; with `wait`, the status when it has arrived.

        Raises:
            Faulted: With `wait`: it faulted on the way.
            IncorrectState: It is faulted; or, with `wait`, it was paused on the way.
        """
        if wait and until is None and until_step is None:
            raise InvalidArgument(
                "waiting for a run without an end would never end: give `until` or `until_step`",
                details={"field": "wait"},
            )
        args = _named(until_time=until, until_step=until_step)
        if not isinstance(rate, EllipsisType):
            args["rate"] = rate
        result = self._command("run", args, RunResult, options)
        if not wait or result.until_step is None:
            return result if not wait else self.status()
        return self.wait(step=result.until_step)

    def pause(self, **options: Unpack[Options]) -> Reply:
        """Stops it after the step it is at; no change if it is paused."""
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
        """Runs a paused swarm some steps on, as fast as it can whatever its rate.

        Args:
            steps: How many: 1 to 10⁹.
            state: Return the state reached, its `state_hash` filled in.
            options: See `Options`; without a `timeout` it may take an hour, whatever the client's.

        Returns:
            Where it arrived: that many steps on, unless another command came between.

        Raises:
            DeadlineExceeded: It takes longer than `timeout`; it goes on and can be waited for.
            IncorrectState: It runs or is faulted.
            Faulted: A step failed.
        """
        options.setdefault("timeout", _PATIENT_SECS)
        if not state:
            return self._command("step", {"steps": steps}, StepResult, options)
        payload = self._send("step", {"steps": steps, "return": "state"}, options)
        return read_state_reply(payload)

    def reset(self, seed: SupportsIndex | None = None, **options: Unpack[Options]) -> ResetResult:
        """Puts it back to the start of its spec, at step 0 of a new epoch, paused.

        Args:
            seed: A new one: 0 to 2⁵³ - 1; None keeps the old one.
            options: See `Options`.
        """
        return self._command("reset", _named(seed=seed), ResetResult, options)

    def set(
        self,
        *,
        pi1: float | None = None,
        pi2: float | None = None,
        pi3: float | None = None,
        pi4: float | None = None,
        publish_every: SupportsIndex | None = None,
        make_room: bool = False,
        **options: Unpack[Options],
    ) -> SetResult:
        """Changes the parameters named, and no others, between two steps.

        Args:
            pi1: Length over width of a body: 1 to 32.
            pi2: Weight of individuals informed without one; those informed keep theirs.
            pi3: Body size over turning radius: above 0.
            pi4: Translational over rotational drag: above 0.
            publish_every: Steps between two published states: 1 or more.
            make_room: With `pi1`: scale positions about the centroid by the least factor that
                lets the longer bodies in.
            options: See `Options`.
        """
        args = _named(pi1=pi1, pi2=pi2, pi3=pi3, pi4=pi4, publish_every=publish_every)
        if make_room:
            args["make_room"] = True
        return self._command("set", args, SetResult, options)

    def inform(
        self,
        select: Select,
        direction: float,
        *,
        weight: float | None = None,
        for_time: float | None = None,
        **options: Unpack[Options],
    ) -> IdsResult:
        """Gives individuals a direction of their own.

        Args:
            select: Whom, such as `jostle.fraction(0.1)`; draws are from the whole group.
            direction: Theirs, radians, counter-clockwise from +x.
            weight: How much it counts beside attraction: above 0; None is `pi2`.
            for_time: After so many time units they are uninformed again; None is for good.
            options: See `Options`.
        """
        args = {"select": select, "direction": direction}
        args |= _named(weight=weight, for_time=for_time)
        return self._command("inform", args, IdsResult, options)

    def uninform(self, select: Select, **options: Unpack[Options]) -> IdsResult:
        """Takes individuals' direction away; draws are from the informed."""
        return self._command("uninform", {"select": select}, IdsResult, options)

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
        """Adds individuals, informed or not, where they overlap nobody.

        Args:
            count: How many, drawn at the border of the group or `within` a disc.
            at: Exactly there instead: rows of x, y, alpha, shape (m, 3), absolute positions in
                body sizes and headings in radians.
            within: With `count`: absolute centre and radius of the disc, body sizes.
            direction: Informs them: their preferred direction in radians.
            weight: With `direction`: how much it counts beside attraction; None is `pi2`.
            options: See `Options`.

        Returns:
            Their ids.
        """
        args = _named(count=count, direction=direction, weight=weight)
        if at is not None:
            args["at"] = poses(at)
        if within is not None:
            args["within"] = (
                within
                if isinstance(within, Mapping)
                else dict(zip(("x", "y", "radius"), within, strict=True))
            )
        return self._command("inject", args, IdsResult, options)

    def remove(self, select: Select, **options: Unpack[Options]) -> IdsResult:
        """Takes individuals out of the group. The last one cannot be removed."""
        return self._command("remove", {"select": select}, IdsResult, options)

    def delete(self, **options: Unpack[Options]) -> Reply:
        """Deletes the swarm from its daemon, for good."""
        return self._command("delete", {}, Reply, options)

    # Questions: they change nothing.

    def status(self) -> Status:
        """What it is and does now."""
        return read_reply(self._get("get/status"), Status)

    def spec(self) -> Spec:
        """What it was made from, with every default filled in."""
        return read_json(self._get("get/spec"), SpecReply).result

    def state(self) -> State:
        """Its state now, never older than an answer already given."""
        return read_state(self._get("state"))

    @overload
    def wait(self, *, step: SupportsIndex, timeout: float | None = None) -> Status: ...
    @overload
    def wait(self, *, phase: Phase, timeout: float | None = None) -> Status: ...
    def wait(
        self,
        *,
        step: SupportsIndex | None = None,
        phase: Phase | None = None,
        timeout: float | None = None,
    ) -> Status:
        """Waits until it has reached a step or entered a phase.

        Args:
            step: Return at this step or a later one.
            phase: Return in this phase; exactly one of the two.
            timeout: Seconds; None is however long it takes.

        Raises:
            DeadlineExceeded: Not within `timeout`.
            Faulted: It faulted before `step`.
            IncorrectState: It was paused before `step`, and gets no further by itself.
        """
        if (step is None) == (phase is None):
            raise InvalidArgument("wait for a `step` or for a `phase`: exactly one of them")
        target = None if step is None else whole("step", step)
        condition = f"phase={phase}" if target is None else f"step={target}"
        seconds = None if timeout is None else check_seconds("timeout", timeout)
        deadline = None if seconds is None else time.monotonic() + seconds
        while True:
            hold = _HOLD_SECS if deadline is None else min(_HOLD_SECS, deadline - time.monotonic())
            hold = max(hold, 0.001)
            selector = f"get/wait?{condition};timeout_secs={hold:.3f}"
            try:
                status = read_reply(self._get(selector, timeout=hold), Status)
            except DeadlineExceeded:
                if deadline is not None and time.monotonic() >= deadline:
                    raise
                continue
            if target is not None and status.step < target:
                kind = Faulted if status.phase == "faulted" else IncorrectState
                raise kind(
                    f"swarm {self._name!r} is {status.phase} at step {status.step} and will not "
                    f"reach step {target} by itself: {status.reason or 'no reason given'}",
                    details={"phase": status.phase, "reason": status.reason},
                    step=status.step,
                )
            return status

    # Streams: what it publishes.

    def states(self, *, timeout: float | None = None) -> Stream[State]:
        """Its states: first the one now, then each as it is published, always the newest.

        A loop slower than the states misses those in between, and `state.skipped` counts them; it
        never falls behind. A paused swarm publishes only what commands change.

        Args:
            timeout: Raise `DeadlineExceeded` when none comes for so many seconds; the stream may
                be iterated on after that. None waits for ever.

        Raises:
            NotFound: No such swarm. On the way `Unavailable` is raised if the daemon goes away.
        """
        newest = Newest()

        def read(payload: bytes) -> State | None:
            state = read_state(payload)
            skipped = newest.admit(state)
            return None if skipped is None else replace(state, skipped=skipped)

        def first() -> State:
            state = self.state()
            newest.admit(state)
            return state

        return self._stream("state", read, first, capacity=1, timeout=timeout)

    def orders(self, *, timeout: float | None = None) -> Stream[OrderSample]:
        """Its order and drift as they are published, always the newest; see `states`."""
        newest = Newest()

        def read(payload: bytes) -> OrderSample | None:
            sample = read_json(payload, OrderSample)
            return None if newest.admit(sample) is None else sample

        return self._stream("order", read, self._look, capacity=1, timeout=timeout)

    def events(self, *, timeout: float | None = None) -> Stream[Event]:
        """What happens to it from now on, every event in order.

        The last one of a deleted swarm is `deleted`.
        """
        return self._stream("event", read_event, self._look, capacity=_EVENTS_KEPT, timeout=timeout)

    def close(self) -> None:
        """Closes its streams; the swarm itself lives on."""
        for stream in list(self._streams):
            stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _command(self, verb: str, args: dict[str, Any], kind: type[T], options: Options) -> T:
        return read_reply(self._send(verb, args, options), kind)

    def _send(self, verb: str, args: dict[str, Any], options: Options) -> bytes:
        key = self._link.swarm_key(self._name, f"cmd/{verb}")
        return self._link.command(key, args, swarm=self._name, **options)

    def _get(self, rest: str, timeout: float | None = None) -> bytes:
        return self._link.ask(
            self._link.swarm_key(self._name, rest),
            swarm=self._name,
            timeout=self._link.timeout if timeout is None else timeout,
        )

    def _look(self) -> None:
        """Raises `NotFound` unless the swarm is there."""
        self._get("get/status")

    def _stream(
        self,
        noun: str,
        read: Callable[[bytes], T | None],
        first: Callable[[], T | None],
        *,
        capacity: int,
        timeout: float | None,
    ) -> Stream[T]:
        stream = Stream(
            self._link, self._name, noun, read, first, capacity=capacity, timeout=timeout
        )
        self._streams.add(stream)
        return stream


def _named(**arguments: object) -> dict[str, Any]:
    """The arguments that were given; what is left out changes nothing."""
    return {name: value for name, value in arguments.items() if value is not None}
