"""Awaits calls that block: each runs in a thread."""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
from collections.abc import Callable
from typing import TypeVar

from . import _cancel
from ._cancel import Canceller
from ._threads import call_in_thread

T = TypeVar("T")


async def call(work: Callable[[], T], discard: Callable[[T], object] | None = None) -> T:
    """Calls `work` in a thread and returns its result.

    If this is cancelled, `work` is cancelled too. If it returns nevertheless, its result is passed
    to `discard`.
    """
    canceller = Canceller()
    future = start(work, canceller, discard)
    try:
        return await future
    except asyncio.CancelledError:
        # At once, for the next call on the same object; zenoh may block until a running callback
        # returns, which the event loop must not.
        canceller.event.set()
        call_in_thread(canceller.cancel)
        raise


async def finish(work: Callable[[], T]) -> T:
    """Calls `work` in a thread; it runs to its end even if this is cancelled."""
    return await start(work, Canceller())


def start(
    work: Callable[[], T],
    canceller: Canceller,
    discard: Callable[[T], object] | None = None,
) -> asyncio.Future[T]:
    """Calls `work` in a thread, where `canceller` cancels it, and returns its future.

    The future may be ignored or cancelled. If it is cancelled, the result is passed to `discard`.
    """
    loop = asyncio.get_running_loop()
    future: asyncio.Future[T] = loop.create_future()
    context = contextvars.copy_context()
    context.run(_cancel.current.set, canceller)

    def set_result(result: T) -> None:
        if not future.done():
            future.set_result(result)
        elif discard is not None:
            call_in_thread(lambda: _ignore_errors(discard, result))

    def set_exception(error: BaseException) -> None:
        if not future.done():
            future.set_exception(error)
            # Retrieving it once keeps asyncio from logging that it was never retrieved.
            future.exception()

    def run() -> None:
        try:
            result = context.run(work)
        except BaseException as error:
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(set_exception, error)
            return
        try:
            loop.call_soon_threadsafe(set_result, result)
        except RuntimeError:
            # The loop was closed meanwhile.
            if discard is not None:
                _ignore_errors(discard, result)

    call_in_thread(run)
    return future


def _ignore_errors(discard: Callable[[T], object], result: T) -> None:
    """Discards a result; no caller is left to receive an error."""
    with contextlib.suppress(Exception):
        discard(result)
