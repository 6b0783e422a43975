"""A swarm on a daemon."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any, Self, SupportsIndex, TypeVar, Unpack

from ._arguments import Select, check_seconds, whole, whole_from_0
from ._at_step import AtStep
from ._commands import MAX_TIMEOUT_SECS, Commands
from ._controller import Controller
from ._decode import read_json
from ._errors import JostleError, invalid
from ._extras import import_extra
from ._frame import of_states
from ._history import EventReader
from ._options import Options
from ._progress import Bar
from ._repr import error_html
from ._session import Session
from ._state import FrameReader, State, read_state
from ._stream import Reader, Stream
from ._view import View
from ._wire import CreateResult, Event, Mode, OnTimeout, OrderSample, Reply

if TYPE_CHECKING:
    import pandas

T = TypeVar("T")

# Events are rare and each one matters: so many unread ones are queued, and others are requested.
_EVENT_CAPACITY = 10_000


class Swarm(Commands):
    """A swarm on a daemon; `Client.create` and `Client.swarm` make one.

        with jostle.connect() as client:
            swarm = client.create("school", jostle.Spec(n=50, seed=1))
            swarm.inform(jostle.fraction(0.1), direction=0.0)
            print(swarm.step(500, state=True).order.order)

    It holds the name and the open streams. Leaving its `with` block closes the streams; the swarm
    remains on the daemon until `delete`.

    Every command takes `expect_step`, `expect_epoch`, `timeout` and `request_id` (see `Options`)
    and raises a `JostleError`. It is executed once, even if its reply is lost or the daemon is
    busy: within its timeout the client sends it again under the same id, and the daemon repeats
    the first reply. `at` sends commands for a later step.

    Numbers and columns may be NumPy's. Lengths are in body sizes, speeds in free speeds, times in
    body sizes over free speed, angles in radians, counter-clockwise from +x.
    """

    def __init__(self, session: Session, name: str) -> None:
        super().__init__(session, name)
        self._streams: weakref.WeakSet[Stream[Any]] = weakref.WeakSet()

    def __repr__(self) -> str:
        return f"Swarm({self._name!r} at {self._session.endpoint})"

    def at(self, step: SupportsIndex) -> AtStep:
        """The commands of this swarm at a step.

            swarm.at(1000).inform(jostle.ids([0, 1]), direction=0.0)
            swarm.at(2000).pause()
            swarm.run()

        A command that is sent while a swarm runs takes effect at whichever step that is. At a step
        of its own it has the same effect whenever it was sent, so the run can be repeated exactly.

        Args:
            step: The step, not before the swarm's.

        Returns:
            An object with the methods `run`, `pause`, `step`, `reset`, `set`, `inform`,
            `uninform`, `inject`, `remove`, `batch`, `annotate`, `protect`, `when` and `delete`,
            each of which returns a `Scheduled`.

        Raises:
            InvalidArgument: It is not a whole number.
        """
        number = whole("at_step", step)
        return AtStep(Commands(self._session, self._name, self._shape, number), number)

    def fork(
        self,
        name: str,
        step: SupportsIndex | None = None,
        *,
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> Swarm:
        """Creates a copy of this swarm on the same daemon, paused.

            twin = swarm.fork("twin", step=500)
            twin.set(pi3=2.0)

        Both have the same future until a command changes one of them.

        Args:
            name: The name of the copy: 1 to 64 of a-z, 0-9, - and _, the first a letter or digit.
            step: The state when the swarm reached this step of its present epoch, before the
                commands at that step; None is the present state.
            timeout: Seconds it may take; None is the client's, with a `step` an hour.
            request_id: The id of the request, see `Options`; None is a new one.

        Raises:
            AlreadyExists: The name is taken.
            Conflict: The swarm has not reached that step, its stored history begins later, or an
                earlier version of the model, `details["model_version"]`, computed that step.
        """
        fork = Swarm(self._session, name)
        args: dict[str, Any] = {"name": name}
        if step is not None:
            args["step"] = step
            timeout = MAX_TIMEOUT_SECS if timeout is None else timeout
        options = {"timeout": timeout, "request_id": request_id}
        self._session.swarm_command(self._name, "fork", args, CreateResult, **options)
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
        """Moves a playback to the last frame at or before a position; see `Client.replay`.

        Give exactly one of `step`, `time` and `fraction`. If the recorded swarm was reset, steps
        and times are those of the run that is shown.

        Args:
            step: The step.
            time: The time, body sizes over free speed.
            fraction: The fraction of the recording: 0 to 1.
            timeout: Seconds it may take; None is the client's.
            request_id: The id of the request, see `Options`; None is a new one.

        Raises:
            IncorrectState: The swarm is no playback.
            InvalidArgument: Not exactly one position is given.
        """
        positions = {"step": step, "time": time, "fraction": fraction}
        args = {name: position for name, position in positions.items() if position is not None}
        options = {"timeout": timeout, "request_id": request_id}
        return self._session.swarm_command(self._name, "seek", args, Reply, **options)

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
        """Joins a controller, which alone steers the individuals that it selects.

            with swarm.join("ada", jostle.ids([0, 1])) as ada:
                state = ada.advance(direction=0.5, state=True).state

        In lock-step the swarm pauses, and steps when every controller has advanced.

        Args:
            controller: Its name: 1 to 64 of a-z, 0-9, - and _, the first a letter or digit.
            select: The individuals that it steers; the daemon draws from those that no other
                controller steers. None selects none, or those it had if it rejoins.
            mode: `lockstep`, or `free_running` for set-points `put` while the swarm runs.
            deadline: Seconds, above 0, at most 60. In lock-step, how long others wait for it; in
                `free_running`, how long its set-points apply after the last `put`.
            on_timeout: What happens when it is late: its individuals `hold` their set-points, also
                after it has left; or are `free` of them; or the swarm is to `pause`. In lock-step
                it leaves after three misses in a row.
            driving: It may set the turning rate and speed of its individuals; beyond the paper.
            again: It rejoins, such as after a crash of its process: it replaces the controller of
                its name, if there is one. If the old process still runs, it can advance until this
                one has advanced, and its `leave` removes this one: end it first.
            options: See `Options`.

        Raises:
            AlreadyExists: A controller of this name has joined.
            Conflict: Another controller steers one of the individuals.
            IncorrectState: The swarm is faulted.
            InvalidArgument: There are fewer individuals, or an argument is out of range.
        """
        terms = {
            **({} if select is None else {"select": select}),
            "mode": mode,
            "deadline_secs": check_seconds("deadline", deadline),
            "on_timeout": on_timeout,
            "driving": driving,
            "again": again,
        }
        return Controller(self._session, self._name, controller, terms, options)

    def states(self, *, timeout: float | None = None) -> Stream[State]:
        """Its states: first the present one, then each when it is published, always the newest.

            for state in swarm.states(timeout=10.0):
                print(state.step, state.order.order)
                if state.phase == "paused":
                    break

        A loop that is slower than the states skips some, and `state.skipped` counts them. A paused
        swarm publishes only what commands change.

        Args:
            timeout: Raise `DeadlineExceeded` if no state is published for so many seconds; the
                stream can be iterated over again after that. None is no timeout. Subscribing takes
                at most the client's `timeout`.

        Raises:
            NotFound: There is no such swarm. `Stream` lists the errors of iteration.
        """
        reader = FrameReader(lambda payload: self._with_pi1(read_state(payload)), self.state)
        return self._stream("state", reader, capacity=1, timeout=timeout)

    def orders(self, *, timeout: float | None = None) -> Stream[OrderSample]:
        """Its order and drift when they are published, always the newest.

            for sample in swarm.orders():
                print(sample.time, sample.order.order, sample.order.drift)

        Args:
            timeout: As in `states`.

        Raises:
            NotFound: There is no such swarm. `Stream` lists the errors of iteration.
        """

        def check_exists() -> None:
            self.status()

        reader = FrameReader(lambda payload: read_json(payload, OrderSample), check_exists)
        return self._stream("order", reader, capacity=1, timeout=timeout)

    def events(
        self, *, after: SupportsIndex | None = None, timeout: float | None = None
    ) -> Stream[Event]:
        """Its events, each once and in order; the last one of a deleted swarm is `deleted`.

            for event in swarm.events(after=0):
                print(event.step, event.kind, event.verb)

        Events that were lost in transit are requested again; `event.skipped` counts those that the
        daemon no longer stores.

        Args:
            after: Begin with the stored events of higher numbers: 0 is all of them, the last
                `event.number` resumes. None begins with the next event.
            timeout: As in `states`.

        Raises:
            NotFound: There is no such swarm. `Stream` lists the errors of iteration.
            Conflict: The swarm has had fewer events than `after`: it is another one of that name.
            InvalidArgument: `after` is not a whole number, or below 0.
        """
        known = None if after is None else whole_from_0("after", after)
        reader = EventReader(self._events_after, known)
        return self._stream("event", reader, capacity=_EVENT_CAPACITY, timeout=timeout)

    def frame(
        self,
        steps: SupportsIndex | None = None,
        *,
        every: SupportsIndex = 1,
        show: bool | None = None,
    ) -> pandas.DataFrame:
        """A table of its present state, or of the states while it is stepped.

            swarm.frame(steps=1000, every=50).groupby("step").order.first().plot()

        It has a row for each individual in each state; `jostle.frame` lists the columns. Each state
        is reached by a `step` command. For a running swarm, pass the states that `states` yields
        to `jostle.frame`.

        Args:
            steps: Number of steps; the table has the state before the first and after the last.
            every: Number of steps between two states.
            show: Show a progress bar; None shows it on a terminal and in a notebook.

        Raises:
            Conflict: Another client stepped it meanwhile.
            ImportError: pandas is missing: `pip install jostle[pandas]`.
            IncorrectState: The swarm is running or faulted.
            InvalidArgument: `every` is 0, or a number is not whole.
        """
        import_extra("pandas", "pandas")
        total, stride = whole_from_0("steps", steps or 0), whole_from_0("every", every)
        if stride == 0:
            raise invalid("every", "`every` is 0: use 1 or more")
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
        """A live picture of it for a notebook, as the last expression of a cell.

            swarm.view()           # continues while other cells run
            swarm.view(5).show()   # the cell ends when the view does

        Args:
            seconds: Its duration; it ends earlier when the swarm is deleted.
            hz: Largest number of updates per second.

        Raises:
            InvalidArgument: A number is not finite, or not above 0.
        """
        return View(self, seconds, hz)

    def _repr_html_(self) -> str:
        try:
            self.status()
            return self.state()._repr_html_()
        except JostleError as error:
            return error_html(error)

    def close(self) -> None:
        """Closes its streams; the swarm itself remains on the daemon."""
        for stream in list(self._streams):
            stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, traceback: object) -> None:
        self.close()

    def _stream(
        self, noun: str, reader: Reader[T], *, capacity: int, timeout: float | None
    ) -> Stream[T]:
        stream = Stream(self._session, self._name, noun, reader, capacity=capacity, timeout=timeout)
        self._streams.add(stream)
        return stream
