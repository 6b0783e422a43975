"""What a swarm can be told: it changes something."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import EllipsisType
from typing import Any, Literal, SupportsIndex, TypedDict, TypeVar, Unpack, overload

from numpy.typing import ArrayLike

from ._arguments import Region, Select, check_select, poses
from ._changes import Change, commands
from ._errors import InvalidArgument
from ._messages import (
    BatchResult,
    IdsResult,
    Reply,
    ResetResult,
    RunResult,
    Scheduled,
    SetResult,
    Status,
    StepResult,
)
from ._questions import Questions
from ._reading import read_batch, read_reply, read_scheduled
from ._state import State, fetch_state, read_step_reply

T = TypeVar("T")

# The longest that the daemon takes for a `timeout_secs`.
PATIENT_SECS = 3600.0


class Options(TypedDict, total=False):
    """What any command may be given besides its own arguments and `at_step`.

    Attributes:
        expect_step: Raise `Conflict` and change nothing unless the swarm is at this step.
        expect_epoch: Raise `Conflict` and change nothing unless the swarm is in this epoch.
        timeout: Seconds the command may take; the client's `timeout` if left out.
        request_id: What to call it, 1 to 256 bytes; a new one if left out. A command that was
            carried out is not carried out again under the same id by a `client` of the same
            name: its first answer comes again. Another command under that id is a `Conflict`.
    """

    expect_step: SupportsIndex
    expect_epoch: SupportsIndex
    timeout: float
    request_id: str


class Commands(Questions):
    """The part of a `Swarm` that commands it."""

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
        wait: Literal[False] = False,
        at_step: SupportsIndex | None,
        **options: Unpack[Options],
    ) -> RunResult | Scheduled: ...
    @overload
    def run(
        self,
        until: float | None = None,
        *,
        until_step: SupportsIndex | None = None,
        rate: float | EllipsisType | None = ...,
        wait: Literal[True],
        show: bool | None = None,
        **options: Unpack[Options],
    ) -> Status: ...
    def run(
        self,
        until: float | None = None,
        *,
        until_step: SupportsIndex | None = None,
        rate: float | EllipsisType | None = ...,
        wait: bool = False,
        show: bool | None = None,
        at_step: SupportsIndex | None = None,
        **options: Unpack[Options],
    ) -> RunResult | Status | Scheduled:
        """Lets it run, to an end or until paused; changes end and rate if it runs already.

        Args:
            until: Pause at the first step at or after this time.
            until_step: Pause at this step; at most one of the two.
            rate: Time units per second of wall clock; None is as fast as possible; left out, no
                change.
            wait: Return when it has arrived, however long that takes. It needs an end, and no
                `at_step`.
            show: With `wait`: show a bar; None is if it is seen, on a terminal or in a notebook.
            at_step: Carry it out at this step, see `Swarm`.
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
        if wait and at_step is not None:
            raise InvalidArgument(
                "a run that is yet to begin cannot be waited for: leave out `wait`, and "
                "`wait(step=…)` for its end",
                details={"field": "wait"},
            )
        args = _named(until_time=until, until_step=until_step)
        if not isinstance(rate, EllipsisType):
            args["rate"] = rate
        result = self._command("run", args, RunResult, at_step, options)
        if not wait or isinstance(result, Scheduled):
            return result
        if result.until_step is None:
            return self.status()
        return self.wait(step=result.until_step, show=show)

    def pause(self, *, at_step: SupportsIndex | None = None, **options: Unpack[Options]) -> Reply:
        """Stops it after the step it is at; no change if it is paused.

        Args:
            at_step: Carry it out at this step, see `Swarm`; a `Scheduled` if that lies ahead.
            options: See `Options`.
        """
        return self._command("pause", {}, Reply, at_step, options)

    @overload
    def step(
        self, steps: SupportsIndex = 1, *, state: Literal[False] = False, **options: Unpack[Options]
    ) -> StepResult: ...
    @overload
    def step(
        self, steps: SupportsIndex = 1, *, state: Literal[True], **options: Unpack[Options]
    ) -> State: ...
    @overload
    def step(
        self,
        steps: SupportsIndex = 1,
        *,
        state: bool = False,
        at_step: SupportsIndex | None = None,
        **options: Unpack[Options],
    ) -> StepResult | State | Scheduled: ...
    def step(
        self,
        steps: SupportsIndex = 1,
        *,
        state: bool = False,
        at_step: SupportsIndex | None = None,
        **options: Unpack[Options],
    ) -> StepResult | State | Scheduled:
        """Runs a paused swarm some steps on, as fast as it can whatever its rate.

        Args:
            steps: How many: 1 to 10⁹.
            state: Return the state reached, its `state_hash` filled in.
            at_step: Carry it out at this step, see `Swarm`.
            options: See `Options`; without a `timeout` it may take an hour, whatever the client's.

        Returns:
            Where it arrived: that many steps on, unless another command came between.

        Raises:
            DeadlineExceeded: It takes longer than `timeout`; it goes on and can be waited for.
            IncorrectState: It runs or is faulted.
            Conflict: The reply was lost, and when the daemon sent it again without its state
                (more than 4 KiB are not remembered), the swarm had changed.
            Faulted: A step failed.
        """
        options.setdefault("timeout", PATIENT_SECS)
        if not state:
            return self._command("step", {"steps": steps}, StepResult, at_step, options)
        payload = self._send("step", {"steps": steps, "return": "state"}, at_step, options)
        scheduled = None if at_step is None else read_scheduled(payload)
        if scheduled is not None:
            return scheduled
        result, reached = read_step_reply(payload)
        return self._shaped(fetch_state(self._get, result) if reached is None else reached)

    @overload
    def reset(
        self, seed: SupportsIndex | None = None, **options: Unpack[Options]
    ) -> ResetResult: ...
    @overload
    def reset(
        self,
        seed: SupportsIndex | None = None,
        *,
        at_step: SupportsIndex | None,
        **options: Unpack[Options],
    ) -> ResetResult | Scheduled: ...
    def reset(
        self,
        seed: SupportsIndex | None = None,
        *,
        at_step: SupportsIndex | None = None,
        **options: Unpack[Options],
    ) -> ResetResult | Scheduled:
        """Puts it back to the start of its spec, at step 0 of a new epoch, paused.

        Commands that wait for their step are refused.

        Args:
            seed: A new one: 0 to 2⁵³ - 1; None keeps the old one.
            at_step: Carry it out at this step, see `Swarm`.
            options: See `Options`.
        """
        return self._command("reset", _named(seed=seed), ResetResult, at_step, options)

    @overload
    def set(
        self,
        *,
        pi1: float | None = None,
        pi2: float | None = None,
        pi3: float | None = None,
        pi4: float | None = None,
        contacts: str | None = None,
        stepping: str | None = None,
        relinearise: SupportsIndex | None = None,
        attraction: dict[str, Any] | None = None,
        noise: float | None = None,
        publish_every: SupportsIndex | None = None,
        make_room: bool = False,
        **options: Unpack[Options],
    ) -> SetResult: ...
    @overload
    def set(
        self,
        *,
        pi1: float | None = None,
        pi2: float | None = None,
        pi3: float | None = None,
        pi4: float | None = None,
        contacts: str | None = None,
        stepping: str | None = None,
        relinearise: SupportsIndex | None = None,
        attraction: dict[str, Any] | None = None,
        noise: float | None = None,
        publish_every: SupportsIndex | None = None,
        make_room: bool = False,
        at_step: SupportsIndex | None,
        **options: Unpack[Options],
    ) -> SetResult | Scheduled: ...
    def set(
        self,
        *,
        pi1: float | None = None,
        pi2: float | None = None,
        pi3: float | None = None,
        pi4: float | None = None,
        contacts: str | None = None,
        stepping: str | None = None,
        relinearise: SupportsIndex | None = None,
        attraction: dict[str, Any] | None = None,
        noise: float | None = None,
        publish_every: SupportsIndex | None = None,
        make_room: bool = False,
        at_step: SupportsIndex | None = None,
        **options: Unpack[Options],
    ) -> SetResult | Scheduled:
        """Changes the parameters named, and no others, between two steps.

        A parameter that is None stays as it is.

        Args:
            pi1: Length over width of a body: 1 to 32.
            pi2: Weight of individuals informed without one; those informed keep theirs.
            pi3: Body size over turning radius: above 0.
            pi4: Translational over rotational drag: above 0.
            contacts: `endpoints`, `closest` or `clamped`; all but `closest` need that no axes
                cross.
            stepping: `position` or `velocity`.
            relinearise: How many more programs a step solves: 0 or 1.
            attraction: What an individual turns towards, such as `{"kind": "voronoi"}`; see
                `Spec`.
            noise: Intensity of white noise on the turning rate: 0 or more.
            publish_every: Steps between two published states: 1 or more.
            make_room: With `pi1`: scale positions about the centroid by the least factor that
                lets the longer bodies in.
            at_step: Carry it out at this step, see `Swarm`.
            options: See `Options`.
        """
        args = _named(
            pi1=pi1,
            pi2=pi2,
            pi3=pi3,
            pi4=pi4,
            contacts=contacts,
            stepping=stepping,
            relinearise=relinearise,
            attraction=attraction,
            noise=noise,
            publish_every=publish_every,
        )
        _check_options("set", options)
        if not args and not make_room:
            raise InvalidArgument(
                "nothing to set: give pi1, pi2, pi3, pi4, contacts, stepping, relinearise, "
                "attraction, noise or publish_every; None leaves a parameter as it is",
                details={"field": "args"},
            )
        if make_room:
            args["make_room"] = True
        result = self._command("set", args, SetResult, at_step, options)
        if isinstance(result, SetResult):
            self._pi1 = result.now.pi1
        return result

    @overload
    def inform(
        self,
        select: Select,
        direction: float,
        *,
        weight: float | None = None,
        for_time: float | None = None,
        **options: Unpack[Options],
    ) -> IdsResult: ...
    @overload
    def inform(
        self,
        select: Select,
        direction: float,
        *,
        weight: float | None = None,
        for_time: float | None = None,
        at_step: SupportsIndex | None,
        **options: Unpack[Options],
    ) -> IdsResult | Scheduled: ...
    def inform(
        self,
        select: Select,
        direction: float,
        *,
        weight: float | None = None,
        for_time: float | None = None,
        at_step: SupportsIndex | None = None,
        **options: Unpack[Options],
    ) -> IdsResult | Scheduled:
        """Gives individuals a direction of their own.

        Args:
            select: Whom, such as `jostle.fraction(0.1)`; draws are from the whole group.
            direction: Theirs, radians, counter-clockwise from +x.
            weight: How much it counts beside attraction: above 0; None is `pi2`.
            for_time: After so many time units they are uninformed again; None is for good.
            at_step: Carry it out at this step, see `Swarm`.
            options: See `Options`.
        """
        args = {"select": check_select(select), "direction": direction}
        args |= _named(weight=weight, for_time=for_time)
        return self._command("inform", args, IdsResult, at_step, options)

    @overload
    def uninform(self, select: Select, **options: Unpack[Options]) -> IdsResult: ...
    @overload
    def uninform(
        self, select: Select, *, at_step: SupportsIndex | None, **options: Unpack[Options]
    ) -> IdsResult | Scheduled: ...
    def uninform(
        self, select: Select, *, at_step: SupportsIndex | None = None, **options: Unpack[Options]
    ) -> IdsResult | Scheduled:
        """Takes individuals' direction away.

        Args:
            select: Whose, such as `jostle.ids([1, 2])`; draws are from the informed.
            at_step: Carry it out at this step, see `Swarm`.
            options: See `Options`.
        """
        return self._command(
            "uninform", {"select": check_select(select)}, IdsResult, at_step, options
        )

    @overload
    def inject(
        self,
        count: SupportsIndex | None = None,
        *,
        at: ArrayLike | None = None,
        within: Region | tuple[float, float, float] | None = None,
        direction: float | None = None,
        weight: float | None = None,
        **options: Unpack[Options],
    ) -> IdsResult: ...
    @overload
    def inject(
        self,
        count: SupportsIndex | None = None,
        *,
        at: ArrayLike | None = None,
        within: Region | tuple[float, float, float] | None = None,
        direction: float | None = None,
        weight: float | None = None,
        at_step: SupportsIndex | None,
        **options: Unpack[Options],
    ) -> IdsResult | Scheduled: ...
    def inject(
        self,
        count: SupportsIndex | None = None,
        *,
        at: ArrayLike | None = None,
        within: Region | tuple[float, float, float] | None = None,
        direction: float | None = None,
        weight: float | None = None,
        at_step: SupportsIndex | None = None,
        **options: Unpack[Options],
    ) -> IdsResult | Scheduled:
        """Adds individuals, informed or not, where they overlap nobody.

        Args:
            count: How many, drawn at the border of the group or `within` a disc.
            at: Exactly there instead: rows of x, y, alpha, shape (m, 3), absolute positions in
                body sizes and headings in radians.
            within: With `count`: absolute centre and radius of the disc, body sizes.
            direction: Informs them: their preferred direction in radians.
            weight: With `direction`: how much it counts beside attraction; None is `pi2`.
            at_step: Carry it out at this step, see `Swarm`.
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
        return self._command("inject", args, IdsResult, at_step, options)

    @overload
    def remove(self, select: Select, **options: Unpack[Options]) -> IdsResult: ...
    @overload
    def remove(
        self, select: Select, *, at_step: SupportsIndex | None, **options: Unpack[Options]
    ) -> IdsResult | Scheduled: ...
    def remove(
        self, select: Select, *, at_step: SupportsIndex | None = None, **options: Unpack[Options]
    ) -> IdsResult | Scheduled:
        """Takes individuals out of the group. The last one cannot be removed.

        Args:
            select: Whom, such as `jostle.count(3)`; draws are from the whole group.
            at_step: Carry it out at this step, see `Swarm`.
            options: See `Options`.
        """
        return self._command(
            "remove", {"select": check_select(select)}, IdsResult, at_step, options
        )

    @overload
    def batch(
        self, changes: Iterable[Change | Mapping[str, Any]], **options: Unpack[Options]
    ) -> BatchResult: ...
    @overload
    def batch(
        self,
        changes: Iterable[Change | Mapping[str, Any]],
        *,
        at_step: SupportsIndex | None,
        **options: Unpack[Options],
    ) -> BatchResult | Scheduled: ...
    def batch(
        self,
        changes: Iterable[Change | Mapping[str, Any]],
        *,
        at_step: SupportsIndex | None = None,
        **options: Unpack[Options],
    ) -> BatchResult | Scheduled:
        """Applies several changes at one step, or none of them.

            swarm.batch([jostle.Set(pi3=2.0), jostle.Inform(jostle.fraction(0.1), 0.0)])

        Args:
            changes: 1 to 256 of `Set, Inform, Uninform, Inject, Remove`, applied in this order as
                if each had come alone; or what the wire has for one, a dictionary of `verb` and
                `args`.
            at_step: Carry it out at this step, see `Swarm`.
            options: See `Options`.

        Raises:
            JostleError: What is wrong with the first change that is; `details["field"]` says
                which, such as `commands[1].args.pi1`. Nothing has changed then.
        """
        payload = self._send("batch", {"commands": commands(changes)}, at_step, options)
        scheduled = None if at_step is None else read_scheduled(payload)
        if scheduled is not None:
            return scheduled
        result = read_batch(payload)
        # What was set on the way.
        for changed in result.results:
            self._pi1 = self._pi1 if changed.now is None else changed.now.pi1
        return result

    @overload
    def annotate(self, text: str, **options: Unpack[Options]) -> Reply: ...
    @overload
    def annotate(
        self, text: str, *, at_step: SupportsIndex | None, **options: Unpack[Options]
    ) -> Reply | Scheduled: ...
    def annotate(
        self, text: str, *, at_step: SupportsIndex | None = None, **options: Unpack[Options]
    ) -> Reply | Scheduled:
        """Writes a note into its journal and its events, in every phase.

            swarm.annotate("camera 2 replaced")
            notes = [entry.args["text"] for entry in swarm.journal() if entry.verb == "annotate"]

        The state and the random draws of later commands do not change.

        Args:
            text: The note: 1 to 1000 characters in one line, without control characters.
            at_step: Carry it out at this step, see `Swarm`.
            options: See `Options`.
        """
        return self._command("annotate", {"text": text}, Reply, at_step, options)

    def delete(self, *, at_step: SupportsIndex | None = None, **options: Unpack[Options]) -> Reply:
        """Deletes the swarm from its daemon, for good.

        Args:
            at_step: Carry it out at this step, see `Swarm`; a `Scheduled` if that lies ahead.
            options: See `Options`.
        """
        return self._command("delete", {}, Reply, at_step, options)

    def _command(
        self,
        verb: str,
        args: dict[str, Any],
        kind: type[T],
        at_step: SupportsIndex | None,
        options: Options,
    ) -> T | Scheduled:
        payload = self._send(verb, args, at_step, options)
        scheduled = None if at_step is None else read_scheduled(payload)
        return read_reply(payload, kind) if scheduled is None else scheduled

    def _send(
        self, verb: str, args: dict[str, Any], at_step: SupportsIndex | None, options: Options
    ) -> bytes:
        _check_options(verb, options)
        key = self._link.swarm_key(self._name, f"cmd/{verb}")
        return self._link.command(key, args, swarm=self._name, at_step=at_step, **options)


def _check_options(verb: str, options: Options) -> None:
    """Refuses what no command takes.

    Raises:
        TypeError: One of them is unknown.
    """
    for name in options:
        if name not in Options.__annotations__:
            raise TypeError(f"{verb}() got an unexpected keyword argument {name!r}")


def _named(**arguments: object) -> dict[str, Any]:
    """The arguments that were given; what is left out changes nothing."""
    return {name: value for name, value in arguments.items() if value is not None}
