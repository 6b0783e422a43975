"""What a swarm publishes, as an asynchronous iterator."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Generator
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from . import _stream
from ._cancel import Cancelled, Canceller
from ._errors import Unavailable
from ._offload import finish, start
from ._workers import workers

T = TypeVar("T")


class Stream(Generic[T]):
    """What a swarm publishes, as `jostle.Stream`.

    It listens from its first item on, or from when it is awaited or its `async with` block is
    entered. A cancelled `anext` loses nothing: what it was waiting for is there for the next.
    """

    def __init__(self, open_: Callable[[], _stream.Stream[T]]) -> None:
        self._source = _Source(open_)
        self._coming: asyncio.Future[T | _End] | None = None
        self._turn = asyncio.Lock()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> T:
        async with self._turn:
            if self._coming is None:
                self._coming = start(self._source.next, self._source.canceller)
            coming = self._coming
            try:
                item = await asyncio.shield(coming)
            except asyncio.CancelledError:
                # Also if it has come at just that moment.
                raise
            except BaseException:
                self._coming = None
                raise
            self._coming = None
        if isinstance(item, _End):
            raise StopAsyncIteration
        return item

    def __await__(self) -> Generator[Any, None, Self]:
        return self._opened().__await__()

    async def _opened(self) -> Self:
        await start(self._source.open, self._source.canceller)
        return self

    async def close(self) -> None:
        """Stops listening, and ends a loop over it; harmless when done already."""
        await finish(self._source.close)

    async def __aenter__(self) -> Self:
        return await self._opened()

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()

    def __del__(self) -> None:
        # Whoever left a loop over it with `break` holds it no more.
        # At the interpreter's end every link is closed already.
        if hasattr(self, "_source") and not self._source.is_closed and not workers.is_over:
            workers.start(self._source.close)


class _End:
    """The end of a stream: no future takes a `StopIteration`."""


class _Source(Generic[T]):
    """What the threads of a `Stream` hold, so that a stream nobody holds is collected."""

    def __init__(self, open_: Callable[[], _stream.Stream[T]]) -> None:
        self._open = open_
        self._opening = threading.Lock()
        self._stream: _stream.Stream[T] | None = None
        self.canceller = Canceller()
        self.is_closed = False

    def open(self) -> _stream.Stream[T]:
        """The stream, opened now if it is not yet."""
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
        """What comes next."""
        if self.is_closed:
            return _End()
        try:
            return next(self.open(), _End())
        except (Cancelled, Unavailable):
            if self.is_closed:
                return _End()
            raise

    def close(self) -> None:
        """Ends it, also while it is being opened, which looks at `is_closed` afterwards."""
        self.is_closed = True
        self.canceller.cancel()
        if self._stream is not None:
            self._stream.close()
