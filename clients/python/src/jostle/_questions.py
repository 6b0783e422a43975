"""What a swarm can be asked: it changes nothing."""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace
from typing import SupportsIndex, overload

from . import _cancel
from ._arguments import check_name, check_seconds, whole, whole_from_0
from ._errors import DeadlineExceeded, Faulted, IncorrectState, InvalidArgument, JostleError
from ._events import Event, Journal, JournalEntry
from ._exchange import Controllers, ControllerSummary
from ._history import mark_entry_gaps, mark_event_gaps, pages
from ._link import Link
from ._messages import Parameter, Parameters, Phase, SpecReply, Status, Verified
from ._progress import Bar
from ._reading import read_events, read_json, read_reply
from ._show import Listed
from ._snapshot import Snapshot, read_snapshot
from ._spec import Spec
from ._state import State, read_state

# The daemon holds a `get/wait` no longer than this; it is asked again until the caller's deadline.
_HOLD_SECS = 30.0
# So long after an answer that came early, because too many wait for the swarm, it is asked again.
_DISPLACED_SECS = 0.5
# With somebody looking on it is asked so often.
_LOOK_SECS = 0.25
# Longer than the daemon tells a past before it says that it takes longer.
_RETELLING_SECS = 3610.0


class Questions:
    """The part of a `Swarm` that asks its daemon."""

    def __init__(self, link: Link, name: str) -> None:
        self._link = link
        self._name = check_name("swarm", name)
        # How long the bodies are, as far as this client has heard, and since which epoch, as a
        # reset may change it; pictures show it.
        self._pi1: float | None = None
        self._pi1_epoch: int | None = None

    @property
    def name(self) -> str:
        """The swarm's name."""
        return self._name

    def status(self) -> Status:
        """What it is and does now."""
        return self._heard(read_reply(self._get("get/status"), Status))

    def spec(self) -> Spec:
        """What it was made from, with every default filled in."""
        return read_json(self._get("get/spec"), SpecReply).result

    def state(self) -> State:
        """Its state now, never older than an answer already given."""
        return self._shaped(read_state(self._get("state")))

    def parameters(self) -> dict[str, Parameter]:
        """Every parameter but the start, by name, in the order of the spec.

        Each tells its value now, range, unit, default, and what changes it while the swarm lives.
        """
        reply = read_reply(self._get("get/parameters"), Parameters)
        return {parameter.name: parameter for parameter in reply.parameters}

    def history(self, after: SupportsIndex = 0) -> Listed[Event]:
        """What happened to it, oldest first, as far back as its daemon remembers.

        Args:
            after: The number of the last event known already; 0 is none. What the daemon no
                longer has is counted by `skipped` of the first event returned.

        Raises:
            InvalidArgument: `after` is no whole number, or below 0.
        """
        known = whole_from_0("after", after)
        return Listed(mark_event_gaps(self._events_after(known)[0], known))

    def journal(self, after: SupportsIndex = 0) -> Listed[JournalEntry]:
        """The commands it applied, oldest first, as far back as its daemon remembers.

        With its spec that is all that its present state comes from. The daemon remembers some
        thousand of them.

        Args:
            after: Only commands of a higher `seq`. What the daemon no longer has is counted by
                `skipped` of the first entry returned.

        Raises:
            InvalidArgument: `after` is no whole number, or below 0.
        """

        def ask(seq: int) -> tuple[list[JournalEntry], int]:
            page = read_reply(self._get(f"get/journal?after={seq};limit=1000"), Journal)
            return page.entries, page.newest

        known = whole_from_0("after", after)
        return Listed(mark_entry_gaps(pages(ask, lambda entry: entry.seq, known)[0], known))

    def controllers(self) -> Listed[ControllerSummary]:
        """Every controller that has joined, by name: whom it steers, and how it fares."""
        return Listed(read_reply(self._get("get/controllers"), Controllers).controllers)

    def snapshot(self) -> Snapshot:
        """All that its future depends on, to be kept and restored.

        A daemon of the same `model_version` restores it, if one message holds it.

            swarm.snapshot().save("school.snapshot")
            other.restore("school.snapshot", "school")

        Raises:
            ResourceExhausted: It is longer than one message; some thousand individuals are not.
        """
        return read_snapshot(self._get("get/snapshot"))

    def verify(self, timeout: float | None = None) -> Verified:
        """Tells its kept history again, beside it, and says whether it comes out the same.

        Args:
            timeout: Seconds it may take; None is an hour.

        Raises:
            Conflict: The history is damaged.
        """
        seconds = _RETELLING_SECS if timeout is None else check_seconds("timeout", timeout)
        return read_reply(self._get("get/verify", timeout=seconds), Verified)

    @overload
    def wait(
        self, *, step: SupportsIndex, timeout: float | None = None, show: bool | None = None
    ) -> Status: ...
    @overload
    def wait(self, *, phase: Phase, timeout: float | None = None) -> Status: ...
    def wait(
        self,
        *,
        step: SupportsIndex | None = None,
        phase: Phase | None = None,
        timeout: float | None = None,
        show: bool | None = None,
    ) -> Status:
        """Waits until it has reached a step or entered a phase.

        Args:
            step: Return at this step or a later one.
            phase: Return in this phase; exactly one of the two.
            timeout: Seconds; None is however long it takes.
            show: For a step: show a bar; None is if it is seen, on a terminal or in a notebook.

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
        with Bar(self._name, False if target is None else show) as bar:
            status = self._wait(condition, deadline, bar, target or 0)
            if target is not None and status.step >= target:
                bar.end(f"step {target}")
        if target is not None and status.step < target:
            kind = Faulted if status.phase == "faulted" else IncorrectState
            raise kind(
                f"swarm {self._name!r} is {status.phase} at step {status.step} and will not "
                f"reach step {target} by itself: {status.reason or 'no reason given'}",
                details={"phase": status.phase, "reason": status.reason},
                step=status.step,
            )
        return self._heard(status)

    def _wait(self, condition: str, deadline: float | None, bar: Bar, target: int) -> Status:
        """Asks until the condition holds; `bar` shows how far it is to the step `target`."""
        first: int | None = None
        longest = _LOOK_SECS if bar.is_wanted else _HOLD_SECS
        while True:
            hold = longest if deadline is None else min(longest, deadline - time.monotonic())
            hold = max(hold, 0.001)
            selector = f"get/wait?{condition};timeout_secs={hold:.3f}"
            over = time.monotonic() + hold
            try:
                return read_reply(self._get(selector, timeout=hold), Status)
            except DeadlineExceeded as error:
                if deadline is not None and time.monotonic() >= deadline:
                    raise
                step = error.step
            # Early if too many wait for the swarm: then others wait, too, and ask again.
            if (early := over - time.monotonic()) > 0.0:
                _cancel.rest(min(early, _DISPLACED_SECS))
            if bar.is_wanted and step is not None:
                first = step if first is None else first
                share = (step - first) / max(target - first, 1)
                bar.show(share, f"step {step} of {target}")

    def _heard(self, status: Status) -> Status:
        self._pi1, self._pi1_epoch = status.parameters.pi1, status.epoch
        return status

    def _shaped(self, state: State) -> State:
        """The state with how long its bodies are, which no daemon says with it so far."""
        if state.pi1 is not None:
            return state
        if self._pi1_epoch != state.epoch:
            # What can be had without it is not to fail for want of it.
            with contextlib.suppress(JostleError):
                self.status()
        return state if self._pi1 is None else replace(state, pi1=self._pi1)

    def _events_after(self, number: int) -> tuple[list[Event], int]:
        """The events of higher numbers, and the newest number there is."""

        def ask(after: int) -> tuple[list[Event], int]:
            page = read_events(self._get(f"get/events?after={after};limit=1000"))
            return page.events, page.newest

        return pages(ask, lambda event: event.number, number)

    def _get(self, rest: str, timeout: float | None = None) -> bytes:
        return self._link.get(
            self._link.swarm_key(self._name, rest), swarm=self._name, timeout=timeout
        )
