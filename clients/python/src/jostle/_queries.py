"""The queries of a swarm: requests that do not change it."""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import dataclass, replace
from typing import SupportsIndex, overload

import numpy as np
from numpy.typing import NDArray

from . import _cancel
from ._arguments import (
    check_condition,
    check_measure,
    check_name,
    check_seconds,
    whole,
)
from ._decode import read_json, read_reply
from ._errors import (
    DeadlineExceeded,
    Faulted,
    IncorrectState,
    InvalidArgument,
    JostleError,
    Unavailable,
    late,
)
from ._messages import SpecReply
from ._outage import RECONNECT_TIMEOUT_SECS, Outage
from ._past import Past
from ._progress import Bar
from ._repr import HtmlList
from ._retry import FAILED, Backoff
from ._session import Session
from ._snapshot import Snapshot, read_snapshot
from ._state import State, read_state
from ._wire import (
    ControllerList,
    ControllerSummary,
    Measures,
    Parameter,
    Parameters,
    Phase,
    Spec,
    Status,
    Verified,
)

# The daemon replies to a `get/wait` within this time; it is sent again until the deadline.
_MAX_WAIT_SECS = 30.0
# The daemon replies early if too many clients wait for the swarm; it is sent again after this.
_DISPLACED_WAIT_SECS = 0.5
# That of the first `get/wait` after an outage.
_FIRST_WAIT_SECS = 0.05
# How long after the last success queries are repeated that the daemon rejects without their token.
_TOKEN_TIMEOUT_SECS = 10.0
# The interval of `get/wait` while a progress bar is shown.
_BAR_INTERVAL_SECS = 0.25
# How long a verification may take: the most that the daemon accepts.
_MAX_VERIFY_SECS = 3600.0


@dataclass
class BodyShape:
    """The length over width of a swarm's bodies as last received, which pictures show.

    Attributes:
        pi1: The value; None if it is not known.
        epoch: The epoch of the status it was read from: a reset may change it.
    """

    pi1: float | None = None
    epoch: int | None = None


def stopped(status: Status, message: str) -> Faulted | IncorrectState:
    """The error if a swarm does not run any more, before what was waited for."""
    kind = Faulted if status.phase == "faulted" else IncorrectState
    return kind(message, details={"phase": status.phase, "reason": status.reason}, step=status.step)


class Queries(Past):
    """The part of a `Swarm` that queries its daemon."""

    def __init__(self, session: Session, name: str, shape: BodyShape | None = None) -> None:
        self._session = session
        self._name = check_name("swarm", name)
        self._shape = BodyShape() if shape is None else shape

    @property
    def name(self) -> str:
        """The swarm's name."""
        return self._name

    def status(self) -> Status:
        """The phase, step, parameters, order and certificate of the swarm.

            status = swarm.status()
            print(status.phase, status.step, status.order.mean_order)

        Raises:
            NotFound: There is no such swarm.
        """
        return self._remember(read_reply(self._get("get/status"), Status))

    def spec(self) -> Spec:
        """The spec that the swarm was created from, with all defaults.

        Raises:
            NotFound: There is no such swarm.
        """
        return read_json(self._get("get/spec"), SpecReply).result

    def state(self) -> State:
        """The state of the swarm now: positions and headings, shape (n,), order and certificate.

            state = swarm.state()
            centroid = state.position.mean(axis=0)    # body sizes

        It is at least as new as every reply that was received before.

        Raises:
            NotFound: There is no such swarm.
        """
        return self._with_pi1(read_state(self._get("state")))

    def parameters(self) -> dict[str, Parameter]:
        """Every parameter except the start, by name, in the order of the spec.

        Each has its value, range, unit and default, and the verbs that change it.

        Raises:
            NotFound: There is no such swarm.
        """
        reply = read_reply(self._get("get/parameters"), Parameters)
        return {parameter.name: parameter for parameter in reply.parameters}

    def measure(self, name: str) -> float | None:
        """A measure of the swarm now: a number that is computed from its state, such as `milling`.

            swarm.measure("milling")                # 0 to 1
            swarm.measure("clusters.count(0.1)")    # clusters with gaps of at most 0.1 body sizes

        `jostle measures` lists the measures with their units and definitions. Lengths are in body
        sizes, speeds in the free speed, angles in radians.

        Args:
            name: A measure that needs no earlier state, with its argument in parentheses, if it
                has one. `msd`, `turning_rate` and the speeds need earlier states: they are for
                conditions and columns of experiments.

        Returns:
            Its value; None where it is undefined, such as `drift` without informed individuals.

        Raises:
            InvalidArgument: There is no such measure, its argument is invalid, or it needs earlier
                states.
            NotFound: There is no such swarm.
            ResourceExhausted: The group is too large for it: more than 20,000 individuals.
        """
        return self.measures(name)[name]

    def measures(self, *names: str) -> dict[str, float | None]:
        """Several measures of one state of the swarm, by name; see `measure`.

            now = swarm.measures("order", "milling", "clusters.largest")
            print(now["milling"])

        Args:
            names: The measures; by default all that need no earlier state. With more than 20,000
                individuals the default leaves out those that cost more than a sum over them.

        Returns:
            The values by the given names, in their order; None where a measure is undefined.

        Raises:
            InvalidArgument: As `measure`, or a measure is named twice.
            NotFound: There is no such swarm.
            ResourceExhausted: As `measure`.
        """
        for name in names:
            check_measure(name)
        query = f"get/measures?names={','.join(names)}" if names else "get/measures"
        found = read_reply(self._get(query), Measures).measures
        keys = names or tuple(measure.name for measure in found)
        return {key: measure.value for key, measure in zip(keys, found, strict=True)}

    def histogram(
        self, name: str, *, bins: SupportsIndex = 50, max: float = 10.0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A histogram of the neighbours in the newest state.

            edges, g = swarm.histogram("pair_correlation", bins=50, max=10)

        Args:
            name: `pair_correlation`, g(r) of the centres, without unit, normalised with the area of
                the convex hull of the centres; or `neighbour_density`, neighbours per body and
                squared body size around a body, in the frame of its heading.
            bins: Number of bins of an axis: 1 to 10,000, of `neighbour_density` to 200.
            max: The largest distance, body sizes: above 0, to 10⁶.

        Returns:
            The edges, of shape (bins + 1,), body sizes: of `pair_correlation` from 0 to `max`, of
            both axes of `neighbour_density` from -`max` to `max`. The values, of shape (bins,), or
            (bins, bins) of `neighbour_density`: the first index grows towards the front of the
            body, the second towards its left.

        Raises:
            InvalidArgument: There is no such histogram, or `bins` or `max` is out of range.
            IncorrectState: All centres are on a line, and the hull has no area.
            NotFound: There is no such swarm.
            ResourceExhausted: The group has more than 20,000 individuals.
        """
        check_measure(name)
        query = f"get/measures?histogram={name};bins={whole('bins', bins)};max={float(max)!r}"
        found = read_reply(self._get(query), Measures).histogram
        if found is None:
            raise Unavailable("the daemon is of an earlier version, which serves no histograms")
        values = np.array(found.values)
        if name == "neighbour_density":
            values = values.reshape(len(found.edges) - 1, -1)
        return np.array(found.edges), values

    def controllers(self) -> HtmlList[ControllerSummary]:
        """The controllers that have joined, by name.

        Raises:
            NotFound: There is no such swarm.
        """
        return HtmlList(read_reply(self._get("get/controllers"), ControllerList).controllers)

    def snapshot(self) -> Snapshot:
        """A snapshot: everything that determines the swarm's future.

            swarm.snapshot().save("school.snapshot")
            other.restore("school.snapshot", "school")

        A daemon of the same or a later `model_version` restores it; a later one marks the
        swarm by `earlier_models`.

        Raises:
            NotFound: There is no such swarm.
            ResourceExhausted: It does not fit into a message; some thousand individuals do.
        """
        return read_snapshot(self._get("get/snapshot"))

    def verify(self, timeout: float | None = None) -> Verified:
        """Replays the stored history beside the swarm and compares the hashes.

        Args:
            timeout: Seconds it may take, at most an hour; None is an hour. The daemon ends the
                replay then, also if this process has ended.

        Raises:
            Busy: Too many verifications are queued.
            Conflict: The history is damaged, or an earlier version of the model,
                `details["model_version"]`, computed steps of it.
            DeadlineExceeded: It takes longer than `timeout`.
        """
        seconds = _MAX_VERIFY_SECS if timeout is None else check_seconds("timeout", timeout)
        seconds = max(min(seconds, _MAX_VERIFY_SECS), 0.001)
        try:
            payload = self._get(f"get/verify?timeout_secs={seconds:.3f}", timeout=seconds)
        except InvalidArgument as error:
            # A daemon of an earlier version has no such parameter, and replays for up to an hour.
            if "known" not in error.details:
                raise
            payload = self._get("get/verify", timeout=seconds)
        return read_reply(payload, Verified)

    @overload
    def wait(
        self, *, step: SupportsIndex, timeout: float | None = None, show: bool | None = None
    ) -> Status: ...
    @overload
    def wait(self, *, phase: Phase, timeout: float | None = None) -> Status: ...
    @overload
    def wait(self, condition: str, *, timeout: float | None = None) -> Status: ...
    def wait(
        self,
        condition: str | None = None,
        *,
        step: SupportsIndex | None = None,
        phase: Phase | None = None,
        timeout: float | None = None,
        show: bool | None = None,
    ) -> Status:
        """Waits until a condition holds, or until the swarm reaches a step or enters a phase.

            swarm.run(rate=None)
            swarm.wait("drift > 0.9 for 20", timeout=60.0)
            swarm.wait(step=10_000, timeout=60.0)

        Give exactly one of the three. If the daemon is not reachable, such as during a restart, the
        wait goes on when it is back within a minute, and logs both to the logger `jostle`. The wait
        for a condition changes nothing, and the daemon forgets it when this call or its process
        ends. After an outage it starts again: a moment at which the condition held may be missed,
        and a duration starts again.

        Args:
            condition: Return when this condition holds in the present state or after a later step,
                see `when`; a duration begins with the present state.
            step: Return at this step or a later one.
            phase: Return in this phase.
            timeout: Seconds; None is no timeout.
            show: For a step: show a progress bar; None shows it on a terminal and in a notebook.

        Raises:
            DeadlineExceeded: Not within `timeout`.
            Faulted: The swarm faulted before `step`, or before the condition held.
            IncorrectState: The swarm was paused before `step`.
            InvalidArgument: The condition is invalid.
            NotFound: There is no such swarm.
            ResourceExhausted: 16 clients wait for conditions of the swarm, 4 of one user, or
                the measures of all these conditions cost too much together, or a user who is no
                operator compares more than four of them.
            Unavailable: The daemon is not reachable for more than a minute.
        """
        if (condition is not None) + (step is not None) + (phase is not None) != 1:
            what = "wait for a condition, for a `step` or for a `phase`: exactly one of them"
            raise InvalidArgument(what)
        if condition is not None:
            return self._wait_for(condition, timeout)
        target = None if step is None else whole("step", step)
        awaited = f"phase={phase}" if target is None else f"step={target}"
        seconds = None if timeout is None else check_seconds("timeout", timeout)
        with Bar(self._name, False if target is None else show) as bar:
            status = self._wait(awaited, seconds, bar, target or 0, awaited)
            if target is not None and status.step >= target:
                bar.end(f"step {target}")
        if target is not None and status.step < target:
            raise stopped(
                status,
                f"swarm {self._name!r} is {status.phase} at step {status.step} and will not "
                f"reach step {target} by itself: {status.reason or 'no reason given'}",
            )
        return self._remember(status)

    def _wait_for(self, condition: str, timeout: float | None) -> Status:
        """Waits for a condition; the daemon forgets the wait shortly after its liveliness token."""
        seconds = None if timeout is None else check_seconds("timeout", timeout)
        check_condition(condition)
        wait_id = self._session.wait_ids.take()
        token = None
        try:
            token = self._session.declare_token(
                self._session.swarm_key(self._name, f"wait/{wait_id}/alive")
            )
            with Bar(self._name, False) as bar:
                selector = f"condition={condition};id={wait_id}"
                status = self._wait(selector, seconds, bar, 0, condition)
        finally:
            self._session.wait_ids.give_back(wait_id)
            if token is not None and self._session.is_open():
                token.undeclare()
        if status.phase == "faulted":
            raise stopped(
                status,
                f"swarm {self._name!r} faulted at step {status.step} before {condition} held: "
                f"{status.reason or 'no reason given'}",
            )
        return self._remember(status)

    def _wait(
        self, awaited: str, seconds: float | None, bar: Bar, target: int, condition: str
    ) -> Status:
        """Sends `get/wait` until `awaited` is reached; `bar` shows the progress to `target`."""
        began = time.monotonic()
        deadline = math.inf if seconds is None else began + seconds
        outage = Outage(self._session.endpoint, f"the wait for {condition} of swarm {self._name!r}")
        backoff = Backoff(began, deadline - began, RECONNECT_TIMEOUT_SECS)
        first: int | None = None
        tokenless_since: float | None = None
        longest = _BAR_INTERVAL_SECS if bar.is_wanted else _MAX_WAIT_SECS
        while True:
            # After an outage the daemon replies at once, so that its end is logged.
            most = _FIRST_WAIT_SECS if outage.is_ongoing else longest
            wait = max(min(most, deadline - time.monotonic()), 0.001)
            selector = f"get/wait?{awaited};timeout_secs={wait:.3f}"
            end = time.monotonic() + wait
            key = self._session.swarm_key(self._name, selector)
            try:
                payload = self._session.get_once(key, swarm=self._name, timeout=wait)
            except FAILED as error:
                self._session.pause(backoff, error, outage)
                continue
            except IncorrectState as error:
                # After a lost connection the token may reach the daemon later than the query.
                now = time.monotonic()
                tokenless_since = now if tokenless_since is None else tokenless_since
                if "token" not in error.details or now - tokenless_since > _TOKEN_TIMEOUT_SECS:
                    raise
                _cancel.sleep(_FIRST_WAIT_SECS)
                continue
            except DeadlineExceeded as error:
                tokenless_since = None
                outage.end()
                backoff.reset()
                if seconds is not None and time.monotonic() >= deadline:
                    where = "" if error.step is None else f" (it is at step {error.step})"
                    what = f"swarm {self._name!r} did not reach {condition}{where}"
                    remedy = "a longer `timeout=` waits longer"
                    raise late(what, seconds, remedy, error) from error
                step = error.step
            else:
                outage.end()
                return read_reply(payload, Status)
            # The reply is early if too many clients wait for the swarm: let others wait.
            if (early := end - time.monotonic()) > 0.0:
                _cancel.sleep(min(early, _DISPLACED_WAIT_SECS))
            if bar.is_wanted and step is not None:
                first = step if first is None else first
                share = (step - first) / max(target - first, 1)
                bar.show(share, f"step {step} of {target}")

    def _remember(self, status: Status) -> Status:
        self._shape.pi1, self._shape.epoch = status.parameters.pi1, status.epoch
        return status

    def _with_pi1(self, state: State) -> State:
        """The state with the length of its bodies, which the daemon does not send with it."""
        if state.pi1 is not None:
            return state
        if self._shape.epoch != state.epoch:
            # A state without it is better than an error.
            with contextlib.suppress(JostleError):
                self.status()
        return state if self._shape.pi1 is None else replace(state, pi1=self._shape.pi1)

    def _get(self, rest: str, timeout: float | None = None) -> bytes:
        return self._session.get(
            self._session.swarm_key(self._name, rest), swarm=self._name, timeout=timeout
        )
