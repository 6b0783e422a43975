"""A swarm on a daemon, by name."""

from __future__ import annotations

import weakref
from dataclasses import replace
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, SupportsIndex, TypeVar, Unpack

from ._arguments import Select, whole_from_0
from ._commands import PATIENT_SECS, Commands, Options
from ._controller import Controller, terms
from ._errors import InvalidArgument, JostleError
from ._events import Event
from ._exchange import Mode, OnTimeout
from ._extras import need
from ._frame import of_states
from ._history import EventReader
from ._link import Link
from ._messages import CreateResult, OrderSample, Reply
from ._progress import Bar
from ._reading import read_json, read_reply
from ._show import trouble
from ._state import FrameReader, State, read_state
from ._stream import Reader, Stream
from ._view import View

if TYPE_CHECKING:
    import pandas

T = TypeVar("T")

# Events are rare and each counts; this many unread ones are kept, and the others asked for.
_EVENTS_KEPT = 10_000


class Swarm(Commands):
    """A swarm on a daemon, by name; `Client.create` and `Client.swarm` make one.

    It holds nothing but the name and its open streams. Leaving its `with` block closes those
    streams; the swarm itself lives on in the daemon until `delete`.

    Every command takes `expect_step`, `expect_epoch`, `timeout` and `request_id` (see `Options`)
    and raises a `JostleError`. It is carried out once, even if its answer is lost or the daemon is
    busy: it is sent again under the same id, within its deadline, and answered as it first was.

    Every command takes `at_step` too. At that step it is carried out, so that an experiment on a
    running swarm can be repeated exactly. If the step lies ahead the result is a `Scheduled`, and
    an event `command` or `refused` of the same `request_id` tells what came of it; if the swarm
    is there already, the result is the ordinary one; if it lies behind, `Conflict` is raised.

    Wherever a number or a column of numbers is taken, NumPy's are too. Lengths are in body sizes,
    speeds in free speeds, times in their quotient, angles in radians, counter-clockwise from +x.
    """

    def __init__(self, link: Link, name: str) -> None:
        super().__init__(link, name)
        self._streams: weakref.WeakSet[Stream[Any]] = weakref.WeakSet()

    def __repr__(self) -> str:
        return f"Swarm({self._name!r} at {self._link.endpoint})"

    def fork(
        self,
        name: str,
        step: SupportsIndex | None = None,
        *,
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> Swarm:
        """Makes another swarm as this one is or was, on the same daemon, paused.

        Both have one future until they are treated differently.

        Args:
            name: The new swarm's name.
            step: As it was on arriving at this step of its present run, before the commands given
                there; None is as it is now.
            timeout: Seconds it may take; None is the client's, with a `step` an hour.
            request_id: What to call it, see `Options`; None is a new one.

        Raises:
            AlreadyExists: The name is taken.
            Conflict: It has not reached that step, or its history is kept from a later one on.
        """
        fork = Swarm(self._link, name)
        args: dict[str, Any] = {"name": name}
        if step is not None:
            args["step"] = step
            timeout = PATIENT_SECS if timeout is None else timeout
        key = self._link.swarm_key(self._name, "cmd/fork")
        payload = self._link.command(
            key, args, swarm=self._name, timeout=timeout, request_id=request_id
        )
        read_reply(payload, CreateResult)
        return fork

    def seek(
        self,
        *,
        step: SupportsIndex | None = None,
        time: float | None = None,
        fraction: float | None = None,
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> Reply:
        """Has a replay go to the last frame that is not later; see `Client.replay`.

        Args:
            step: A step; where the swarm was reset, of the run that is shown.
            time: A time; where the swarm was reset, of the run that is shown.
            fraction: A share of the whole recording: 0 to 1.
            timeout: Seconds it may take; None is the client's.
            request_id: What to call it, see `Options`; None is a new one.

        Raises:
            IncorrectState: This is no replay.
            InvalidArgument: Not exactly one place is named.
        """
        places = {"step": step, "time": time, "fraction": fraction}
        args = {name: place for name, place in places.items() if place is not None}
        key = self._link.swarm_key(self._name, "cmd/seek")
        payload = self._link.command(
            key, args, swarm=self._name, timeout=timeout, request_id=request_id
        )
        return read_reply(payload, Reply)

    def join(
        self,
        controller: str,
        select: Select | None = None,
        *,
        mode: Mode = "lockstep",
        deadline: float = 5.0,
        on_timeout: OnTimeout = "hold",
        driving: bool = False,
        again: bool = False,
        **options: Unpack[Options],
    ) -> Controller:
        """Has a controller join, which alone steers some of the individuals.

            with swarm.join("ada", jostle.ids([0, 1])) as ada:
                state = ada.advance(direction=0.5, state=True).state

        In lock-step the swarm pauses, and steps when every controller has advanced.

        Args:
            controller: Its name: 1 to 64 of a-z, 0-9, - and _, the first a letter or digit.
            select: Whom it is to steer; draws are from those that no other controller does.
                None is nobody, or whom it had if it comes back.
            mode: `lockstep`, or `free_running` for set-points `put` while the swarm runs.
            deadline: In lock-step, how long others wait for it; running freely, how long its
                set-points hold after the last `put`. Seconds: above 0, at most 60.
            on_timeout: When it is late its individuals `hold` their set-points, also when it has
                left, or are `free` of them, or the swarm is to `pause`. In lock-step it has left
                after three misses in a row.
            driving: It may drive its individuals directly, by turning rate and speed; beyond the
                paper.
            again: It comes back, as after a crash of its process: it takes the place of the
                controller of its name, if there is one.
            options: See `Options`.

        Raises:
            AlreadyExists: A controller of this name has joined.
            Conflict: Another controller steers one of them.
            InvalidArgument: There are not as many, or an argument is wrong.
        """
        return Controller(
            self._link,
            self._name,
            controller,
            terms(select, mode, deadline, on_timeout, driving, again),
            options,
        )

    def states(self, *, timeout: float | None = None) -> Stream[State]:
        """Its states: first the one now, then each as it is published, always the newest.

        A loop slower than the states misses those in between, and `state.skipped` counts them; it
        never falls behind. A paused swarm publishes only what commands change.

        Args:
            timeout: Raise `DeadlineExceeded` when none comes for so many seconds; the stream may
                be iterated on after that. None waits for ever. The stream is opened within the
                client's `timeout`.

        Raises:
            NotFound: No such swarm. On the way `Unavailable` is raised if the daemon goes away.
        """
        reader = FrameReader(
            lambda payload: self._shaped(read_state(payload)),
            self.state,
            lambda state, skipped: replace(state, skipped=skipped),
        )
        return self._stream("state", reader, capacity=1, timeout=timeout)

    def orders(self, *, timeout: float | None = None) -> Stream[OrderSample]:
        """Its order and drift as they are published, always the newest; see `states`."""

        def look() -> None:
            # Raises `NotFound` unless the swarm is there.
            self.status()

        reader = FrameReader(
            lambda payload: read_json(payload, OrderSample), look, lambda sample, skipped: sample
        )
        return self._stream("order", reader, capacity=1, timeout=timeout)

    def events(
        self, *, after: SupportsIndex | None = None, timeout: float | None = None
    ) -> Stream[Event]:
        """What happens to it, every event once and in order.

        Events that were lost on the way are asked for; `event.skipped` counts those that could
        not be had any more. The last one of a deleted swarm is `deleted`.

        Args:
            after: Begin with the events of higher numbers that were before, as far back as the
                daemon remembers: 0 is the whole history, `event.number` goes on where a reader
                ended. None begins with what happens from now on.
            timeout: Raise `DeadlineExceeded` when none comes for so many seconds; the stream may
                be iterated on after that. None waits for ever. The stream is opened within the
                client's `timeout`.

        Raises:
            NotFound: No such swarm. On the way `Unavailable` is raised if the daemon goes away.
            Conflict: The swarm never had an event `after`: it is another one of the same name.
        """
        known = None if after is None else whole_from_0("after", after)
        reader = EventReader(self._events_after, known)
        return self._stream("event", reader, capacity=_EVENTS_KEPT, timeout=timeout)

    def frame(
        self,
        steps: SupportsIndex | None = None,
        *,
        every: SupportsIndex = 1,
        show: bool | None = None,
    ) -> pandas.DataFrame:
        """A table of its state now, or of what a paused swarm does in the next steps.

            swarm.frame(steps=1000, every=50).groupby("step").order.first().plot()

        It has a row for each individual in each state, see `jostle.frame`. Each state is reached
        by a `step` of its own, as its journal tells. Of a swarm that runs by itself the same is
        made of what `states` yields.

        Args:
            steps: Step it so far; the table has the state before the first and after the last.
            every: Have a state after so many steps each.
            show: Show a bar; None is if it is seen, on a terminal or in a notebook.

        Raises:
            Conflict: Somebody else stepped it meanwhile.
            ImportError: pandas is missing; `pip install jostle[pandas]` brings it.
            IncorrectState: It runs or is faulted.
        """
        need("pandas", "pandas")
        total, stride = whole_from_0("steps", steps or 0), whole_from_0("every", every)
        if stride == 0:
            raise InvalidArgument("`every` is 0: 1 or more", details={"field": "every"})
        states = [self.state()]
        first = states[0].step
        with Bar(self._name, show) as bar:
            while (done := states[-1].step - first) < total:
                last = states[-1]
                steps = min(stride, total - done)
                states.append(
                    self.step(steps, state=True, expect_step=last.step, expect_epoch=last.epoch)
                )
                bar.show((done + steps) / total, f"step {last.step + steps}")
        return of_states(states)

    def view(self, seconds: float = 60.0, *, hz: float = 10.0) -> View:
        """A live view of it for a notebook, as the last thing in a cell.

            swarm.view()           # goes on while other cells steer it
            swarm.view(5).show()   # this cell ends when the view does

        Args:
            seconds: How long it lasts; it ends before when the swarm is deleted.
            hz: How often a second the picture changes, at most.
        """
        return View(self, seconds, hz)

    def _repr_html_(self) -> str:
        try:
            self.status()
            return self.state()._repr_html_()
        except JostleError as error:
            return trouble(error)

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

    def _stream(
        self, noun: str, reader: Reader[T], *, capacity: int, timeout: float | None
    ) -> Stream[T]:
        stream = Stream(self._link, self._name, noun, reader, capacity=capacity, timeout=timeout)
        self._streams.add(stream)
        return stream
