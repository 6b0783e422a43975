"""A stream of what a swarm publishes, as an asynchronous iterator."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Generator
from typing import Any, Generic, Self, TypeVar

from . import _stream
from ._cancel import Cancelled, Canceller
from ._errors import Unavailable
from ._threads import call_in_thread, is_exiting
from ._to_thread import finish, start

T = TypeVar("T")


class Stream(Generic[T]):
    """The messages that a swarm publishes; the asynchronous form of `jostle.Stream`.

        async for state in swarm.states(timeout=10.0):
            print(state.step, state.order.order)

    It subscribes when it is first iterated over, awaited, or entered as an `async with` block. A
    cancelled `anext` loses no message: the next `anext` returns it.
    """

    def __init__(self, open_: Callable[[], _stream.Stream[T]]) -> None:
        self._source = _Source(open_)
        self._pending: asyncio.Future[T | _End] | None = None
        self._lock = asyncio.Lock()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        async with self._lock:
            if self._pending is None:
                self._pending = start(self._source.next, self._source.canceller)
            pending = self._pending
            try:
                item = await asyncio.shield(pending)
            except asyncio.CancelledError:
                # `_pending` is kept, even if its result arrived at this moment.
                raise
            except BaseException:
                self._pending = None
                raise
            self._pending = None
        if isinstance(item, _End):
            raise StopAsyncIteration
        return item

    def __await__(self) -> Generator[Any, None, Self]:
        return self._opened().__await__()

    async def _opened(self) -> Self:
        await start(self._source.open, self._source.canceller)
        return self

    async def close(self) -> None:
        """Unsubscribes, and ends a loop over it; a second call does nothing."""
        await finish(self._source.close)

    async def __aenter__(self) -> Self:
        return await self._opened()

    async def __aexit__(self, kind: object, error: object, traceback: object) -> None:
        await self.close()

    def __del__(self) -> None:
        # After a `break` the loop drops the last reference. Closing may block, so a thread does it.
        if hasattr(self, "_source") and not self._source.is_closed and not is_exiting():
            call_in_thread(self._source.close)


class _End:
    """The end of a stream: a future cannot hold a `StopIteration`."""


class _Source(Generic[T]):
    """What the threads of a `Stream` reference, so that an unreferenced stream is collected."""

    def __init__(self, open_: Callable[[], _stream.Stream[T]]) -> None:
        self._open = open_
        self._opening = threading.Lock()
        self._stream: _stream.Stream[T] | None = None
        self.canceller = Canceller()
        self.is_closed = False

    def open(self) -> _stream.Stream[T]:
        """Returns the stream, and opens it first if it is not open."""
        with self._opening:
            if self._stream is None:
                try:
                    self._stream = self._open()
                except Cancelled:
                    raise Unavailable("this stream is closed") from None
                if self.is_closed:
                    self._stream.close()
            return self._stream

    def next(self) -> T | _End:
        """Returns the next message."""
        if self.is_closed:
            return _End()
        try:
            return next(self.open(), _End())
        except (Cancelled, Unavailable):
            if self.is_closed:
                return _End()
            raise

    def close(self) -> None:
        """Closes it, also while it is being opened: `open` checks `is_closed` afterwards."""
        self.is_closed = True
        self.canceller.cancel()
        if self._stream is not None:
            self._stream.close()
