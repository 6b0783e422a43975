"""The package for asyncio: calls that block are awaited, and streams are `async for`.

    from jostle import aio

    async with aio.connect() as client:
        swarm = await client.create("school", jostle.Spec(n=50, seed=1))
        await swarm.run(until=100.0, rate=None)
        async for state in swarm.states():
            print(state.time, state.order.order)
            if state.phase == "paused":
                break

Every method has the arguments, results and errors of the method of the same name in `jostle`. It
runs in a thread, so the event loop never blocks. A cancelled `await` ends at once; its command may
or may not be executed, as after `Unavailable`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Coroutine, Generator
from pathlib import Path
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, Self, SupportsIndex, TypeVar

import jostle

from ._async_stream import Stream
from ._experiment import Source
from ._to_thread import call, finish

__all__ = [
    "AtStep",
    "Client",
    "Controller",
    "Experiment",
    "Local",
    "Opening",
    "Stream",
    "Swarm",
    "connect",
    "experiment",
    "local",
]

P = ParamSpec("P")
T = TypeVar("T")
R = TypeVar("R")
S = TypeVar("S")
S_co = TypeVar("S_co", covariant=True)
X_co = TypeVar("X_co", bound="_Exitable", covariant=True)
C = TypeVar("C", bound="_Context[Any]")


class _Exitable(Protocol):
    """A context manager."""

    def __exit__(self, kind: object, error: object, traceback: object, /) -> None: ...


class _Wrapper(Generic[S_co]):
    """Wraps an object of `jostle`."""

    def __init__(self, sync: S_co) -> None:
        self._sync = sync

    def __repr__(self) -> str:
        return f"aio.{self._sync!r}"


class _Context(_Wrapper[X_co]):
    """Wraps a context manager of `jostle`."""

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, kind: object, error: object, traceback: object) -> None:
        await finish(functools.partial(self._sync.__exit__, kind, error, traceback))


def _awaited(
    method: Callable[Concatenate[S, P], T],
) -> Callable[Concatenate[_Wrapper[S], P], Coroutine[Any, Any, T]]:
    """The method, awaited."""

    @functools.wraps(method)
    async def awaited(self: _Wrapper[S], /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await call(functools.partial(method, self._sync, *args, **kwargs))

    return awaited


def _made(
    method: Callable[Concatenate[S, P], T], make: Callable[[T], R]
) -> Callable[Concatenate[_Wrapper[S], P], Coroutine[Any, Any, R]]:
    """The method, awaited; `make` wraps its result."""

    @functools.wraps(method)
    async def awaited(self: _Wrapper[S], /, *args: P.args, **kwargs: P.kwargs) -> R:
        return make(await call(functools.partial(method, self._sync, *args, **kwargs)))

    return awaited


def _streamed(
    method: Callable[Concatenate[S, P], jostle.Stream[T]],
) -> Callable[Concatenate[_Wrapper[S], P], Stream[T]]:
    """The method; its stream subscribes when it is first used."""

    @functools.wraps(method)
    def streamed(self: _Wrapper[S], /, *args: P.args, **kwargs: P.kwargs) -> Stream[T]:
        return Stream(functools.partial(method, self._sync, *args, **kwargs))

    return streamed


def _opened(
    function: Callable[P, T], make: Callable[[T], C], discard: Callable[[T], object]
) -> Callable[P, Opening[C]]:
    """The function, awaited or entered; `discard` receives the result of a cancelled call."""

    @functools.wraps(function)
    def opened(*args: P.args, **kwargs: P.kwargs) -> Opening[C]:
        async def open_() -> C:
            return make(await call(functools.partial(function, *args, **kwargs), discard))

        return Opening(open_)

    return opened


def _joined(
    method: Callable[Concatenate[S, P], T], make: Callable[[T], C], discard: Callable[[T], object]
) -> Callable[Concatenate[_Wrapper[S], P], Opening[C]]:
    """The method, awaited or entered; `discard` receives the result of a cancelled call."""

    @functools.wraps(method)
    def joined(self: _Wrapper[S], /, *args: P.args, **kwargs: P.kwargs) -> Opening[C]:
        work = functools.partial(method, self._sync, *args, **kwargs)
        return _opened(work, make, discard)()

    return joined


class Opening(Coroutine[Any, Any, C]):
    """A client or a controller to be opened: `await` it, or enter it with `async with`.

    It is a coroutine, so that `asyncio.create_task` and `asyncio.run` accept it, too.
    """

    def __init__(self, open_: Callable[[], Coroutine[Any, Any, C]]) -> None:
        self._open = open_
        self._opened: C | None = None

    def __await__(self) -> Generator[Any, None, C]:
        return self._open().__await__()

    @functools.cached_property
    def _coroutine(self) -> Coroutine[Any, Any, C]:
        """What a task runs; made when it begins, as one that is never awaited causes a warning."""
        return self._open()

    def send(self, value: Any) -> Any:
        """Continues it; a task calls this."""
        return self._coroutine.send(value)

    def throw(self, *error: Any) -> Any:
        """Continues it with an error; a task that is cancelled calls this."""
        return self._coroutine.throw(*error)

    def close(self) -> None:
        """Ends it, if a task began it."""
        if "_coroutine" in self.__dict__:
            self._coroutine.close()

    async def __aenter__(self) -> C:
        self._opened = await self._open()
        return self._opened

    async def __aexit__(self, kind: object, error: object, traceback: object) -> None:
        if self._opened is not None:
            await self._opened.__aexit__(kind, error, traceback)


class Experiment(_Wrapper[jostle.Experiment]):
    """An experiment on a daemon, see `jostle.Experiment`."""

    @property
    def name(self) -> str:
        """Its name."""
        return self._sync.name

    async def wait(self, timeout: float | None = None, *, show: bool | None = None) -> Self:
        """Waits until it is finished, see `jostle.Experiment.wait`."""
        await call(functools.partial(self._sync.wait, timeout, show=show))
        return self

    progress = _awaited(jostle.Experiment.progress)
    pause = _awaited(jostle.Experiment.pause)
    resume = _awaited(jostle.Experiment.resume)
    cancel = _awaited(jostle.Experiment.cancel)
    delete = _awaited(jostle.Experiment.delete)
    rows = _awaited(jostle.Experiment.rows)
    frame = _awaited(jostle.Experiment.frame)
    order = _awaited(jostle.Experiment.order)
    series = _awaited(jostle.Experiment.series)
    trajectory = _awaited(jostle.Experiment.trajectory)


class Controller(_Context[jostle.Controller]):
    """A controller of a swarm, see `jostle.Controller`; `Swarm.join` makes one."""

    @property
    def name(self) -> str:
        """Its name."""
        return self._sync.name

    @property
    def swarm(self) -> str:
        """The name of the swarm that it steers."""
        return self._sync.swarm

    @property
    def ids(self) -> list[int]:
        """The ids of the individuals that it steers, ascending; a new list."""
        return self._sync.ids

    @property
    def step(self) -> int:
        """The step that the next `advance` is for."""
        return self._sync.step

    @property
    def epoch(self) -> int:
        """The epoch in the last reply."""
        return self._sync.epoch

    @property
    def news(self) -> jostle.News:
        """Missed deadlines, departures and removed individuals in the last reply."""
        return self._sync.news

    advance = _awaited(jostle.Controller.advance)
    put = _awaited(jostle.Controller.put)
    sync = _awaited(jostle.Controller.sync)
    cancel = _awaited(jostle.Controller.cancel)
    leave = _awaited(jostle.Controller.leave)


class AtStep(_Wrapper[jostle.AtStep]):
    """The commands of a swarm at one step, see `jostle.AtStep`; `Swarm.at` makes one."""

    run = _awaited(jostle.AtStep.run)
    pause = _awaited(jostle.AtStep.pause)
    step = _awaited(jostle.AtStep.step)
    reset = _awaited(jostle.AtStep.reset)
    set = _awaited(jostle.AtStep.set)
    inform = _awaited(jostle.AtStep.inform)
    uninform = _awaited(jostle.AtStep.uninform)
    inject = _awaited(jostle.AtStep.inject)
    remove = _awaited(jostle.AtStep.remove)
    batch = _awaited(jostle.AtStep.batch)
    annotate = _awaited(jostle.AtStep.annotate)
    protect = _awaited(jostle.AtStep.protect)
    when = _awaited(jostle.AtStep.when)
    delete = _awaited(jostle.AtStep.delete)


class Swarm(_Context[jostle.Swarm]):
    """A swarm on a daemon, see `jostle.Swarm`."""

    @property
    def name(self) -> str:
        """The swarm's name."""
        return self._sync.name

    status = _awaited(jostle.Swarm.status)
    spec = _awaited(jostle.Swarm.spec)
    state = _awaited(jostle.Swarm.state)
    parameters = _awaited(jostle.Swarm.parameters)
    measure = _awaited(jostle.Swarm.measure)
    measures = _awaited(jostle.Swarm.measures)
    histogram = _awaited(jostle.Swarm.histogram)
    controllers = _awaited(jostle.Swarm.controllers)
    history = _awaited(jostle.Swarm.history)
    journal = _awaited(jostle.Swarm.journal)
    snapshot = _awaited(jostle.Swarm.snapshot)
    as_experiment = _awaited(jostle.Swarm.as_experiment)
    verify = _awaited(jostle.Swarm.verify)
    wait = _awaited(jostle.Swarm.wait)

    def at(self, step: SupportsIndex) -> AtStep:
        """The commands of this swarm at a step, see `jostle.Swarm.at`."""
        return AtStep(self._sync.at(step))

    run = _awaited(jostle.Swarm.run)
    pause = _awaited(jostle.Swarm.pause)
    step = _awaited(jostle.Swarm.step)
    reset = _awaited(jostle.Swarm.reset)
    set = _awaited(jostle.Swarm.set)
    inform = _awaited(jostle.Swarm.inform)
    uninform = _awaited(jostle.Swarm.uninform)
    inject = _awaited(jostle.Swarm.inject)
    remove = _awaited(jostle.Swarm.remove)
    batch = _awaited(jostle.Swarm.batch)
    annotate = _awaited(jostle.Swarm.annotate)
    protect = _awaited(jostle.Swarm.protect)
    when = _awaited(jostle.Swarm.when)
    delete = _awaited(jostle.Swarm.delete)
    seek = _awaited(jostle.Swarm.seek)
    fork = _made(jostle.Swarm.fork, lambda sync: Swarm(sync))

    join = _joined(jostle.Swarm.join, Controller, jostle.Controller.leave)

    states = _streamed(jostle.Swarm.states)
    orders = _streamed(jostle.Swarm.orders)
    events = _streamed(jostle.Swarm.events)

    frame = _awaited(jostle.Swarm.frame)

    def view(self, seconds: float = 60.0, *, hz: float = 10.0) -> jostle.View:
        """A live picture of it for a notebook, see `jostle.Swarm.view`."""
        return self._sync.view(seconds, hz=hz)

    async def close(self) -> None:
        """Closes its streams; the swarm itself remains on the daemon."""
        await finish(self._sync.close)


class Client(_Context[jostle.Client]):
    """A connection to a daemon, see `jostle.Client`; `connect` makes one."""

    @property
    def node(self) -> str:
        """The daemon's name."""
        return self._sync.node

    @property
    def endpoint(self) -> str:
        """The endpoint of the daemon."""
        return self._sync.endpoint

    create = _made(jostle.Client.create, Swarm)
    restore = _made(jostle.Client.restore, Swarm)
    discard = _awaited(jostle.Client.discard)
    replay = _made(jostle.Client.replay, Swarm)
    submit = _made(jostle.Client.submit, Experiment)
    play = _made(jostle.Client.play, Swarm)
    experiments = _awaited(jostle.Client.experiments)
    record = _awaited(jostle.Client.record)
    fetch_recording = _awaited(jostle.Client.fetch_recording)
    stop_recording = _awaited(jostle.Client.stop_recording)
    delete_recording = _awaited(jostle.Client.delete_recording)
    recordings = _awaited(jostle.Client.recordings)
    swarms = _awaited(jostle.Client.swarms)
    hello = _awaited(jostle.Client.hello)
    whoami = _awaited(jostle.Client.whoami)
    status = _awaited(jostle.Client.status)
    schema = _awaited(jostle.Client.schema)
    metrics = _awaited(jostle.Client.metrics)
    audit = _awaited(jostle.Client.audit)

    def swarm(self, name: str) -> Swarm:
        """The swarm of that name; sends nothing, so it may not exist."""
        return Swarm(self._sync.swarm(name))

    def experiment(self, name: str) -> Experiment:
        """The experiment of that name; sends nothing, so it may not exist."""
        return Experiment(self._sync.experiment(name))

    async def close(self) -> None:
        """Closes every stream and the connection; a second call does nothing."""
        await finish(self._sync.close)


class Local(Client):
    """A client with a private daemon, see `jostle.Local`; `local` makes one."""

    _sync: jostle.Local

    @property
    def folder(self) -> Path:
        """The data directory of the daemon; a temporary one is deleted with it."""
        return self._sync.folder

    @property
    def log(self) -> Path:
        """The log file of the daemon, in its folder."""
        return self._sync.log

    @property
    def pid(self) -> int:
        """The process id of the daemon."""
        return self._sync.pid


connect = _opened(jostle.connect, Client, jostle.Client.close)
local = _opened(jostle.local, Local, jostle.Local.close)


async def experiment(
    source: Source,
    *,
    name: str | None = None,
    again: bool = False,
    client: Client | None = None,
    endpoint: str | None = None,
) -> Experiment:
    """Submits an experiment to a daemon, see `jostle.experiment`."""
    sync = None if client is None else client._sync
    work = functools.partial(
        jostle.experiment, source, name=name, again=again, client=sync, endpoint=endpoint
    )
    return Experiment(await call(work))
