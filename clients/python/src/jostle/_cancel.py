"""Cancellation of a call that blocks in a thread, by `jostle.aio`."""

from __future__ import annotations

import threading
import time
from contextvars import ContextVar

import zenoh


class Cancelled(BaseException):
    """The call was cancelled; like asyncio's own error it is no `Exception`."""


class Canceller:
    """Cancels the calls in whose context it is `current`: their queries and their pauses."""

    def __init__(self) -> None:
        self.token = zenoh.CancellationToken()
        self.event = threading.Event()

    def cancel(self) -> None:
        """Makes these calls raise `Cancelled` soon; may block within zenoh for a moment."""
        self.event.set()
        self.token.cancel()


current: ContextVar[Canceller | None] = ContextVar("jostle_canceller", default=None)
"""The canceller of the running call; None if it cannot be cancelled."""


def token() -> zenoh.CancellationToken | None:
    """The token that cancels the queries of this call; None if it cannot be cancelled."""
    canceller = current.get()
    return None if canceller is None else canceller.token


def check() -> None:
    """Raises if this call was cancelled.

    Raises:
        Cancelled: It was.
    """
    canceller = current.get()
    if canceller is not None and canceller.event.is_set():
        raise Cancelled


def sleep(seconds: float) -> None:
    """Sleeps.

    Raises:
        Cancelled: The call was cancelled meanwhile.
    """
    canceller = current.get()
    if canceller is None:
        time.sleep(seconds)
    elif canceller.event.wait(seconds):
        raise Cancelled
