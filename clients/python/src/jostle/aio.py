"""The same for asyncio: what blocks in `jostle` is awaited here, and streams are `async for`.

    from jostle import aio

    async with aio.connect() as client:
        swarm = await client.create("school", jostle.Spec(n=50, seed=1))
        await swarm.run(until=100.0, rate=None)
        async for state in swarm.states():
            print(state.time, state.order.order)
            if state.phase == "paused":
                break

Every method is the one of the same name in `jostle`, with its arguments, results and errors; it
is called in a thread, and the loop never waits. A cancelled `await` ends at once; whether its
command was carried out is then as unknown as after `Unavailable`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Coroutine, Generator
from pathlib import Path
from types import TracebackType
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, Self, TypeVar

import jostle

from ._async_stream import Stream
from ._experiment import Source
from ._offload import call, finish

__all__ = [
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
C = TypeVar("C", bound="_Entered")
D = TypeVar("D", bound=jostle.Client)
S_co = TypeVar("S_co", covariant=True)


class _Of(Protocol[S_co]):
    """Stands for something of `jostle` and has its methods."""

    @property
    def _sync(self) -> S_co: ...


class _Entered(Protocol):
    """Has an end to its `async with` block."""

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
        /,
    ) -> None: ...


def _awaited(
    method: Callable[Concatenate[S, P], T],
) -> Callable[Concatenate[_Of[S], P], Coroutine[Any, Any, T]]:
    """The method, to be awaited."""

    @functools.wraps(method)
    async def awaited(self: _Of[S], /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await call(functools.partial(method, self._sync, *args, **kwargs))

    return awaited


def _made(
    method: Callable[Concatenate[S, P], T], make: Callable[[T], R]
) -> Callable[Concatenate[_Of[S], P], Coroutine[Any, Any, R]]:
    """The method, to be awaited, with what it returns made into what there is here for it."""

    @functools.wraps(method)
    async def awaited(self: _Of[S], /, *args: P.args, **kwargs: P.kwargs) -> R:
        return make(await call(functools.partial(method, self._sync, *args, **kwargs)))

    return awaited


def _streamed(
    method: Callable[Concatenate[S, P], jostle.Stream[T]],
) -> Callable[Concatenate[_Of[S], P], Stream[T]]:
    """The method, whose stream is opened when it is first asked for something."""

    @functools.wraps(method)
    def streamed(self: _Of[S], /, *args: P.args, **kwargs: P.kwargs) -> Stream[T]:
        return Stream(functools.partial(method, self._sync, *args, **kwargs))

    return streamed


def _opened(function: Callable[P, D], make: Callable[[D], C]) -> Callable[P, Opening[C]]:
    """The function, to be awaited or entered."""

    @functools.wraps(function)
    def opened(*args: P.args, **kwargs: P.kwargs) -> Opening[C]:
        async def open_() -> C:
            work = functools.partial(function, *args, **kwargs)
            return make(await call(work, lambda sync: sync.close()))

        return Opening(open_)

    return opened


def _joined(
    method: Callable[Concatenate[S, P], T], make: Callable[[T], C], discard: Callable[[T], object]
) -> Callable[Concatenate[_Of[S], P], Opening[C]]:
    """The method, to be awaited or entered; what nobody waits for any more is discarded."""

    @functools.wraps(method)
    def joined(self: _Of[S], /, *args: P.args, **kwargs: P.kwargs) -> Opening[C]:
        async def open_() -> C:
            work = functools.partial(method, self._sync, *args, **kwargs)
            return make(await call(work, discard))

        return Opening(open_)

    return joined


class Opening(Generic[C]):
    """A client or a controller that is yet to be there: `await` it, or `async with` it."""

    def __init__(self, open_: Callable[[], Coroutine[Any, Any, C]]) -> None:
        self._open = open_
        self._opened: C | None = None

    def __await__(self) -> Generator[Any, None, C]:
        return self._open().__await__()

    async def __aenter__(self) -> C:
        self._opened = await self._open()
        return self._opened

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._opened is not None:
            await self._opened.__aexit__(kind, error, traceback)


class Experiment:
    """An experiment on a daemon, as `jostle.Experiment`."""

    def __init__(self, sync: jostle.Experiment) -> None:
        self._sync = sync

    @property
    def name(self) -> str:
        """Its name."""
        return self._sync.name

    def __repr__(self) -> str:
        return f"aio.{self._sync!r}"

    async def wait(self, timeout: float | None = None, *, show: bool | None = None) -> Self:
        """Waits until it is finished, as `jostle.Experiment.wait`."""
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


class Controller:
    """A controller of a swarm, as `jostle.Controller`; `Swarm.join` makes one."""

    def __init__(self, sync: jostle.Controller) -> None:
        self._sync = sync

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
        """Whom it steers, ascending; a new list."""
        return self._sync.ids

    @property
    def step(self) -> int:
        """The step that it takes the swarm to be at, and makes its next advance for."""
        return self._sync.step

    @property
    def epoch(self) -> int:
        """The epoch it last heard of."""
        return self._sync.epoch

    @property
    def news(self) -> jostle.News:
        """What it was last told beside the step: who was late, who has left, who was removed."""
        return self._sync.news

    def __repr__(self) -> str:
        return f"aio.{self._sync!r}"

    advance = _awaited(jostle.Controller.advance)
    put = _awaited(jostle.Controller.put)
    sync = _awaited(jostle.Controller.sync)
    leave = _awaited(jostle.Controller.leave)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await finish(functools.partial(self._sync.__exit__, kind, error, traceback))


class Swarm:
    """A swarm on a daemon, as `jostle.Swarm`."""

    def __init__(self, sync: jostle.Swarm) -> None:
        self._sync = sync

    @property
    def name(self) -> str:
        """The swarm's name."""
        return self._sync.name

    def __repr__(self) -> str:
        return f"aio.{self._sync!r}"

    status = _awaited(jostle.Swarm.status)
    spec = _awaited(jostle.Swarm.spec)
    state = _awaited(jostle.Swarm.state)
    parameters = _awaited(jostle.Swarm.parameters)
    controllers = _awaited(jostle.Swarm.controllers)
    history = _awaited(jostle.Swarm.history)
    journal = _awaited(jostle.Swarm.journal)
    snapshot = _awaited(jostle.Swarm.snapshot)
    verify = _awaited(jostle.Swarm.verify)
    wait = _awaited(jostle.Swarm.wait)

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
    delete = _awaited(jostle.Swarm.delete)
    seek = _awaited(jostle.Swarm.seek)
    fork = _made(jostle.Swarm.fork, lambda sync: Swarm(sync))

    join = _joined(jostle.Swarm.join, Controller, lambda sync: sync.leave())

    states = _streamed(jostle.Swarm.states)
    orders = _streamed(jostle.Swarm.orders)
    events = _streamed(jostle.Swarm.events)

    frame = _awaited(jostle.Swarm.frame)

    def view(self, seconds: float = 60.0, *, hz: float = 10.0) -> jostle.View:
        """A live view of it for a notebook, as `jostle.Swarm.view`."""
        return self._sync.view(seconds, hz=hz)

    async def close(self) -> None:
        """Closes its streams; the swarm itself lives on."""
        await finish(self._sync.close)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()


class Client:
    """A connection with a daemon, as `jostle.Client`; `connect` makes one."""

    def __init__(self, sync: jostle.Client) -> None:
        self._sync = sync

    @property
    def node(self) -> str:
        """The daemon's name."""
        return self._sync.node

    @property
    def endpoint(self) -> str:
        """Where the daemon is."""
        return self._sync.endpoint

    def __repr__(self) -> str:
        return f"aio.{self._sync!r}"

    create = _made(jostle.Client.create, Swarm)
    restore = _made(jostle.Client.restore, Swarm)
    discard = _awaited(jostle.Client.discard)
    replay = _made(jostle.Client.replay, Swarm)
    submit = _made(jostle.Client.submit, Experiment)
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

    def swarm(self, name: str) -> Swarm:
        """The swarm of that name; whether it is there shows when it is asked something."""
        return Swarm(self._sync.swarm(name))

    def experiment(self, name: str) -> Experiment:
        """The experiment of that name; whether it is there shows when it is asked something."""
        return Experiment(self._sync.experiment(name))

    async def close(self) -> None:
        """Ends every stream and the connection; harmless when done already."""
        await finish(self._sync.close)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()


class Local(Client):
    """A client and a daemon of its own, as `jostle.Local`; `local` makes one."""

    def __init__(self, sync: jostle.Local) -> None:
        super().__init__(sync)
        self._local = sync

    @property
    def folder(self) -> Path:
        """Where the daemon keeps everything; a temporary one goes with it."""
        return self._local.folder

    @property
    def log(self) -> Path:
        """What the daemon has to say, a file in its folder."""
        return self._local.log

    @property
    def pid(self) -> int:
        """The daemon's process."""
        return self._local.pid


connect = _opened(jostle.connect, Client)
local = _opened(jostle.local, Local)


async def experiment(
    source: Source,
    *,
    name: str | None = None,
    client: Client | None = None,
    endpoint: str | None = None,
) -> Experiment:
    """Has a daemon carry out an experiment, as `jostle.experiment`."""
    sync = None if client is None else client._sync
    work = functools.partial(jostle.experiment, source, name=name, client=sync, endpoint=endpoint)
    return Experiment(await call(work))
