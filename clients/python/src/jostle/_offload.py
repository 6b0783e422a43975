"""How what blocks is awaited: in a thread, which ends soon when nobody awaits it any more."""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
from collections.abc import Callable
from typing import TypeVar

from ._cancel import Canceller, call_with
from ._workers import workers

T = TypeVar("T")


async def call(work: Callable[[], T], discard: Callable[[T], object] | None = None) -> T:
    """Calls `work` in a thread and returns what it returns.

    Cancelled, it has `work` end soon. What comes of it all the same is given to `discard`.
    """
    canceller = Canceller()
    future = start(work, canceller, discard)
    try:
        return await future
    except asyncio.CancelledError:
        # zenoh may wait for whoever is being called by it just now, the loop must not.
        workers.start(canceller.cancel)
        raise


async def finish(work: Callable[[], T]) -> T:
    """Calls `work` in a thread; it is done to its end even if this is cancelled."""
    return await start(work, Canceller())


def start(
    work: Callable[[], T],
    canceller: Canceller,
    discard: Callable[[T], object] | None = None,
) -> asyncio.Future[T]:
    """Has `work` called in a thread, so that `canceller` ends it.

    Nobody needs to look at the future, and it may be cancelled: then what comes is given to
    `discard`.
    """
    loop = asyncio.get_running_loop()
    future: asyncio.Future[T] = loop.create_future()
    context = contextvars.copy_context()

    def settle(result: T) -> None:
        if not future.done():
            future.set_result(result)
        elif discard is not None:
            workers.start(lambda: _quietly(discard, result))

    def fail(error: BaseException) -> None:
        if not future.done():
            future.set_exception(error)
            # Asked for once, it is not complained of when nobody else asks.
            future.exception()

    def run() -> None:
        try:
            result = context.run(call_with, canceller, work)
        except BaseException as error:
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(fail, error)
            return
        try:
            loop.call_soon_threadsafe(settle, result)
        except RuntimeError:
            # The loop was closed meanwhile.
            if discard is not None:
                _quietly(discard, result)

    workers.start(run)
    return future


def _quietly(discard: Callable[[T], object], result: T) -> None:
    """Nobody is left to be told of what fails here."""
    with contextlib.suppress(Exception):
        discard(result)
