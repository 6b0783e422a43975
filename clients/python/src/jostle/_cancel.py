"""How a call that waits in a thread is told to give up: by `jostle.aio`, when nobody awaits it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextvars import ContextVar
from typing import TypeVar

import zenoh

T = TypeVar("T")


class Cancelled(BaseException):
    """Nobody waits for this call any more; like asyncio's own it is no `Exception`."""


class Canceller:
    """Ends the calls that were made with it: their queries, and their rests between two tries."""

    def __init__(self) -> None:
        self.token = zenoh.CancellationToken()
        self.told = threading.Event()

    def cancel(self) -> None:
        """Has every call with this end soon, with `Cancelled`; may wait for zenoh a moment."""
        self.told.set()
        self.token.cancel()


_current: ContextVar[Canceller | None] = ContextVar("jostle_canceller", default=None)


def call_with(canceller: Canceller, work: Callable[[], T]) -> T:
    """Calls `work` so that `canceller` ends it; within a context of its own."""
    _current.set(canceller)
    return work()


def token() -> zenoh.CancellationToken | None:
    """What ends the queries of this call; None if nothing does."""
    canceller = _current.get()
    return None if canceller is None else canceller.token


def check() -> None:
    """Goes no further in a call that was cancelled.

    Raises:
        Cancelled: It was.
    """
    canceller = _current.get()
    if canceller is not None and canceller.told.is_set():
        raise Cancelled


def rest(seconds: float) -> None:
    """Waits so long.

    Raises:
        Cancelled: The call was cancelled meanwhile.
    """
    canceller = _current.get()
    if canceller is None:
        time.sleep(seconds)
    elif canceller.told.wait(seconds):
        raise Cancelled
